"""The quadruped: a policy trained on flat ground, and the filter in its joint loop under loads it never saw.

M q'' = g + f,   f_hat = F(s) f,   tau = Kp (q_d - f_hat/Kp - q) - Kd q',   q_d from the policy
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from phyfilter_ctl.study import Outputs, add_output_options

if TYPE_CHECKING:
    from .comparison import Plan
    from .loop import FilterChoice
    from .methods import Method

__all__ = ["add_arguments", "main"]

_DESCRIPTION = """Let trained policies walk under payloads, speeds, grounds, weak motors and pushes that they never saw.

Residual PPO on a trot was trained on flat ground, with the filter in the joint loop and without; both ship as plain
numbers. The same filter put on the policy that was trained without it, and taken from the one that was trained with it,
show what training and what running it does. Needs the extra mujoco; --train needs the extra train too."""

_EXAMPLES = """examples:
  phyfilter-ctl run quadruped
  phyfilter-ctl run quadruped --quick --json figures.json --picture quadruped.pdf
  phyfilter-ctl run quadruped --payload 0 0.3 0.5 --terrain stairs --difficulty 0.5
  phyfilter-ctl run quadruped --contact estimated                  # forces on the feet in the filters' g
  phyfilter-ctl run quadruped --animation walk.gif --terrain stairs
  phyfilter-ctl run quadruped --choose                             # the improved filter, from walks kept apart for it
  phyfilter-ctl run quadruped --stance                             # the joint loop of the standing robot, linear
  phyfilter-ctl run quadruped --cosimulate                         # robot and joint loop as FMUs (needs a C compiler)
  phyfilter-ctl run quadruped --train --seed 7 --filter --out filter-7.json
  phyfilter-ctl run quadruped --robustness --parts folder          # Go1, all arms and seeds; goes on after a stop
  phyfilter-ctl run quadruped --tune --policies folder             # Go1: variants of the adaptive rival and the filter
  phyfilter-ctl run quadruped --train --robot go1 --velocity 3 --full --checkpoint go1.npz
  phyfilter-ctl run quadruped --train --measure                    # steps per second, with learning
  phyfilter-ctl run quadruped --policy filter-7.json               # judge a policy of one's own"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run quadruped``."""
    parser.add_argument("--quick", action="store_true", help="one policy, few walks: a try-out, in seconds")
    parser.add_argument(
        "--payload", type=float, nargs="+", metavar="P", help="parts of the weight (default 0 to 0.6)"
    )
    parser.add_argument(
        "--speed", type=float, nargs="+", metavar="V", help="commands, m/s (default 0.5 1 1.5 2 2.4 2.83)"
    )
    parser.add_argument(
        "--terrain",
        nargs="+",
        metavar="KIND",
        help="of stairs, rough, wave, gravel; none: flat only; with --train curriculum: tiles of growing difficulty",
    )
    parser.add_argument("--difficulty", type=float, nargs="+", metavar="D", help="of the terrains, in [0, 1]")
    parser.add_argument(
        "--methods", nargs="+", metavar="NAME", help="rows of the table (unknown names: the list is printed)"
    )
    parser.add_argument("--policy", nargs="+", metavar="FILE", help="judge these policies instead")
    parser.add_argument(
        "--contact",
        choices=("omitted", "known", "estimated"),
        help="forces on the feet in the g of the filters (default: none): the simulator's, or what a robot can know",
    )
    job = parser.add_mutually_exclusive_group()
    job.add_argument(
        "--choose", action="store_true", help="compare variants of the filter on validation walks"
    )
    job.add_argument(
        "--robustness",
        action="store_true",
        help="policies of --robot, trained with several seeds, under everything that they may meet",
    )
    job.add_argument(
        "--tune",
        action="store_true",
        help="compare variants of the adaptive rival and of the filter on walks that --robustness does not have",
    )
    job.add_argument(
        "--stance", action="store_true", help="loop transfer functions of the standing robot instead"
    )
    job.add_argument(
        "--cosimulate", action="store_true", help="a walk as FMUs, robot and joint loop, instead"
    )
    job.add_argument("--train", action="store_true", help="train a policy instead")
    parser.add_argument(
        "--robot",
        metavar="NAME",
        help="of --train (default lite3-primitives), --robustness and --tune (default go1)",
    )
    parser.add_argument(
        "--policies",
        type=Path,
        metavar="FOLDER",
        help="of --robustness and --tune: base-0.json, filter-0.json, basefull-0.json, ...",
    )
    parser.add_argument(
        "--parts",
        type=Path,
        metavar="FOLDER",
        help="of --robustness: kept here, and gone on from after a stop",
    )
    training = parser.add_argument_group("training")
    training.add_argument("--seed", type=int, default=0, metavar="N", help="of training (default 0)")
    training.add_argument("--filter", action="store_true", help="with the paper's filter in the loop")
    training.add_argument("--full", action="store_true", help="full domain randomisation: loads, pushes")
    training.add_argument("--velocity", type=float, default=1.0, metavar="V", help="largest command, m/s")
    training.add_argument("--iterations", type=int, metavar="N", help="default: see params.toml")
    training.add_argument("--out", metavar="FILE", help="the policy, JSON (default KIND-SEED.json)")
    training.add_argument(
        "--checkpoint", metavar="FILE", help="npz: written now and then, gone on from if there"
    )
    training.add_argument("--measure", action="store_true", help="a few iterations only: steps per second")
    parser.add_argument(
        "--animation", metavar="FILE", help="a walk with the heaviest payload as GIF, instead"
    )
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="of the simulator (default 2)")
    add_output_options(parser, "quadruped", description=_DESCRIPTION, examples=_EXAMPLES)


def main(options: Namespace) -> int:
    """Run the job; return the exit status.

    Raises
    ------
    ValueError, OSError
        If options or policies are wrong, the legs cannot carry a payload, an extra is missing, or a file cannot be
        written.
    """
    from phyfilter_ctl._output import check_target

    if options.threads < 1:
        raise ValueError(f"--threads: expected 1 or more, got {options.threads}")
    judged = ("choose", "robustness", "tune", "stance", "cosimulate")
    alone = next((name for name in judged if getattr(options, name)), None)
    if options.contact and alone:
        raise ValueError(f"--contact: --{alone} has filters of its own; leave one of the two out")
    if options.contact and options.train and not options.filter:
        raise ValueError("--contact: nobody is told of it without a filter; add --filter")
    outputs = Outputs.of(options)
    check_target(options.out, suffixes=(".json",))
    check_target(options.checkpoint, suffixes=(".npz",))
    check_target(options.animation, suffixes=(".gif",))
    several = options.robustness or options.tune or (options.animation and options.robot)
    if (options.robot and not (options.train or several)) or (options.policies and not several):
        raise ValueError(
            "--robot goes with --train, --robustness, --tune or --animation, --policies with --robustness, --tune or "
            "an --animation of a --robot"
        )
    if options.parts and not options.robustness:
        raise ValueError("--parts goes with --robustness")
    chosen = (name for name in _JOBS if getattr(options, name, False))
    try:
        _JOBS[next(chosen, "compare")](options, outputs)
    except ImportError as error:  # the command line shows one line, and which extra
        raise ValueError(str(error)) from error
    return 0


def _filter(options: Namespace) -> FilterChoice | None:
    from .loop import paper_filter

    return paper_filter(options.contact or "omitted") if options.filter else None


def _plan(options: Namespace) -> Plan:
    from .comparison import TERRAINS, Plan
    from .methods import SEEDS, USUAL
    from .params import params
    from .terrain import Kind

    test = params().test
    asked = TERRAINS if options.terrain is None else options.terrain
    unknown = [kind for kind in asked if kind not in (*TERRAINS, "none")]
    if unknown:
        raise ValueError(
            f"--terrain: expected some of {', '.join(TERRAINS)} or none, got {', '.join(unknown)}"
        )
    kinds: tuple[Kind, ...] = tuple(kind for kind in TERRAINS if kind in asked)
    quick = options.quick
    return Plan(
        methods=tuple(options.methods or USUAL),
        seeds=SEEDS[:1] if quick else SEEDS,
        phases=2 if quick else test.phases,
        payloads=tuple(options.payload or ((0.0, 0.3, 0.6) if quick else test.payloads)),
        speeds=tuple(options.speed or ((0.5, 1.5) if quick else test.speeds)),
        difficulties=tuple(options.difficulty or ((0.4,) if quick else test.difficulties)),
        duration=test.duration,
        terrains=kinds[:1] if quick and options.terrain is None else kinds,
        grounds=2 if quick else test.grounds,
        contact=options.contact,
    )


def _compare(options: Namespace, outputs: Outputs) -> None:
    from . import comparison, report
    from .picture import draw

    plan = _plan(options)
    own = _own(options)
    with outputs.progress(comparison.steps(plan)) as say:
        found = comparison.compare(plan, own=own, report=say, threads=options.threads)
    outputs.publish(report.table(found), report.figures(found), lambda: draw(found))


def _own(options: Namespace) -> dict[str, Method]:
    """Policies of the user's own, with the filter they were trained with."""
    from .methods import of_policies

    if not options.policy:
        return {}
    from .policy import load

    return of_policies([load(Path(name)) for name in options.policy])


def _animate(options: Namespace, outputs: Outputs) -> None:
    if options.robot:
        _beside(options, outputs)
        return
    from .animation import animate
    from .evaluation import Case, Group, walk
    from .methods import METHODS, told
    from .params import params
    from .terrain import Terrain

    plan = _plan(options)
    terrain = Terrain(plan.terrains[0], plan.difficulties[0]) if options.terrain and plan.terrains else None
    method = next(iter(_own(options).values()), METHODS[SHOWN])
    method = method if plan.contact is None else told(method, plan.contact)
    payload = max(options.payload or (0.0,)) * params().robot.mass
    speed = max(options.speed or (1.0,))
    policies = method.policies(plan.seeds[:1])
    [found] = walk([Group(policies, method.choice)], [Case(payload, speed)], terrain=terrain, duration=6.0)
    how = animate(Path(options.animation), [found.trace.qpos[:, 0]], terrain=terrain)
    fell = ", fell" if found.fallen[0, 0, 0] else ""
    outputs.publish(
        f"{options.animation}: {method.label}, {payload:.1f} kg, {speed:g} m/s{fell}; drawn by {how}",
        {"fallen": bool(found.fallen[0, 0, 0]), "drawn_by": how},
    )


# The method that an animation shows.
SHOWN = "filter"


def _beside(options: Namespace, outputs: Outputs) -> None:
    """Arms of one robot side by side, policies of the same seed."""
    from .animation import animate
    from .evaluation import Case, Group, phases, walk
    from .params import params
    from .robustness import ARMS, policies

    names = options.methods or ["base", "filter"]
    unknown = [name for name in names if name not in ARMS]
    if unknown:
        raise ValueError(f"--methods: expected some of {', '.join(ARMS)}, got {', '.join(unknown)}")
    p = params(options.robot)
    found = policies(options.robot, folder=options.policies, families=[ARMS[name].family for name in names])
    seed = next(iter(found.values()))[0].record["seed"]
    part, speed = max(options.payload or (0.0,)), max(options.speed or (1.0,))
    case = Case(part * p.robot.mass, speed, robot=options.robot)
    groups = [Group(found[ARMS[name].family][:1], ARMS[name].choice) for name in names]
    outcomes = walk(groups, [case], starts=phases(count=1), duration=6.0)
    ends = ["fell" if each.fallen[0, 0, 0] else f"{each.distance[0, 0, 0]:.1f} m" for each in outcomes]
    words = [ARMS[name].label.split(",")[0] for name in names]
    labels = [
        f"{name}: {what}, {end}, {100 * part:.0f} % payload"
        for name, what, end in zip(names, words, ends, strict=True)
    ]
    walks = [each.trace.qpos[:, 0] for each in outcomes]
    how = animate(Path(options.animation), walks, labels=labels, parameters=p)
    told = "; ".join(f"{name}: {end} in 6 s" for name, end in zip(names, ends, strict=True))
    outputs.publish(
        f"{options.animation}: seed {seed}, {100 * part:.0f} % payload, {speed:g} m/s; {told}; drawn by {how}",
        {"ends": ends, "drawn_by": how},
    )


def _choose(options: Namespace, outputs: Outputs) -> None:
    from . import choice

    with outputs.progress(choice.steps()) as say:
        found = choice.choose(quick=options.quick, report=say, threads=options.threads)
    outputs.publish(choice.table(found), choice.figures(found))


def _robustness(options: Namespace, outputs: Outputs) -> None:
    from . import robustness
    from .robustness_picture import draw

    robot, quick = options.robot or "go1", options.quick
    wanted = robustness.conditions(robot, quick=quick)
    found = robustness.policies(robot, folder=options.policies)
    grounds = sum(entry.ground is not None for entry in wanted)
    with outputs.progress((1 + grounds) * len(found["base"])) as say:
        judged = robustness.judge_each(
            found,
            wanted,
            starts=1 if quick else 2,
            duration=2.0 if quick else None,
            report=say,
            threads=options.threads,
            folder=options.parts,
        )
    outputs.publish(robustness.table(judged), robustness.figures(judged), lambda: draw(judged, found))


def _tune(options: Namespace, outputs: Outputs) -> None:
    from . import robustness, tuning

    found = robustness.policies(options.robot or "go1", folder=options.policies, families=["base"])["base"]
    with outputs.progress(1 + sum(c.ground is not None for c in tuning.conditions(found[0].robot))) as say:
        judged = tuning.tune(found, quick=options.quick, report=say, threads=options.threads)
    outputs.publish(tuning.table(judged), tuning.figures(judged))


def _stance(options: Namespace, outputs: Outputs) -> None:
    from . import stance
    from .stance_picture import draw

    plant = stance.linearized()
    rows, limits = stance.study(plant=plant), stance.largest_poles(plant)
    outputs.publish(stance.table(rows, limits), stance.figures(rows, limits), lambda: draw(plant=plant))


def _cosimulate(options: Namespace, outputs: Outputs) -> None:
    from . import cosimulation

    found = cosimulation.cosimulation(policy="filter-0", duration=1.0 if options.quick else 2.0)
    outputs.publish(cosimulation.table(found), cosimulation.figures(found))


def _train(options: Namespace, outputs: Outputs) -> None:
    from . import training
    from .policy import save

    if options.terrain not in (None, ["none"], ["curriculum"]):
        raise ValueError(f"--terrain: training knows curriculum or none, got {', '.join(options.terrain)}")
    wanted = training.Training(
        options.seed,
        choice=_filter(options),
        iterations=options.iterations,
        velocity=options.velocity,
        robot=options.robot or "lite3-primitives",
        full=options.full,
        curriculum=options.terrain == ["curriculum"],
    )
    if options.measure:
        found = training.measure(wanted, threads=options.threads)
        outputs.publish(training.throughput_text(found), found)
        return
    family = "filter" if options.filter else "base"
    family += ("full" if options.full else "") + ("tiles" if wanted.curriculum else "")
    name = options.out or f"{family}-{options.seed}.json"
    trainer = training.Trainer(wanted, threads=options.threads)
    with outputs.progress(trainer.iterations) as say:
        policy = training.train(
            trainer, checkpoint=None if options.checkpoint is None else Path(options.checkpoint), report=say
        )
    save(policy, Path(name))
    record = policy.record
    table = (
        f"{name}: {record['steps']} steps in {record['seconds']:.0f} s, "
        f"{record['steps'] / record['seconds']:.0f} steps/s; reward per second, from first to last:\n"
        + training.curve_text(record["reward"])
    )
    if wanted.curriculum:
        table += "\nmean level of the curriculum: " + " ".join(
            f"{v:.2f}" for v in trainer.levels[::-10][::-1]
        )
    outputs.publish(table, dict(record))


# In the order in which they are looked for; without any: compare.
_JOBS = {
    "train": _train,
    "choose": _choose,
    "robustness": _robustness,
    "tune": _tune,
    "stance": _stance,
    "cosimulate": _cosimulate,
    "animation": _animate,
    "compare": _compare,
}
