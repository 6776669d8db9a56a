"""The quadruped: a policy trained on flat ground, and the filter in its joint loop under loads it never saw.

M q'' = g + f,   f_hat = F(s) f,   tau = Kp (q_d - f_hat/Kp - q) - Kd q',   q_d from the policy
"""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from pathlib import Path
from typing import TYPE_CHECKING

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
  phyfilter-ctl run quadruped --animation walk.gif --terrain stairs
  phyfilter-ctl run quadruped --choose                             # the improved filter, from walks kept apart for it
  phyfilter-ctl run quadruped --stance                             # the joint loop of the standing robot, linear
  phyfilter-ctl run quadruped --cosimulate                         # robot and joint loop as FMUs (needs a C compiler)
  phyfilter-ctl run quadruped --train --seed 7 --filter --out filter-7.json
  phyfilter-ctl run quadruped --train --measure                    # steps per second, with learning
  phyfilter-ctl run quadruped --policy filter-7.json               # judge a policy of one's own"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run quadruped``."""
    parser.description = _DESCRIPTION
    parser.epilog = _EXAMPLES
    parser.formatter_class = RawDescriptionHelpFormatter
    parser.add_argument("--quick", action="store_true", help="one policy, few walks: a try-out, in seconds")
    parser.add_argument(
        "--payload",
        type=float,
        nargs="+",
        metavar="P",
        help="parts of the weight (default 0 0.15 0.3 0.45 0.6)",
    )
    parser.add_argument(
        "--speed", type=float, nargs="+", metavar="V", help="commands, m/s (default 0.5 1 1.5 2 2.4 2.83)"
    )
    parser.add_argument(
        "--terrain", nargs="+", metavar="KIND", help="of stairs, rough, wave, gravel; none: flat only"
    )
    parser.add_argument("--difficulty", type=float, nargs="+", metavar="D", help="of the terrains, in [0, 1]")
    parser.add_argument(
        "--methods", nargs="+", metavar="NAME", help="rows of the table (unknown names: the list is printed)"
    )
    parser.add_argument("--policy", nargs="+", metavar="FILE", help="judge these policies instead")
    job = parser.add_mutually_exclusive_group()
    job.add_argument(
        "--choose", action="store_true", help="compare variants of the filter on validation walks"
    )
    job.add_argument(
        "--stance", action="store_true", help="loop transfer functions of the standing robot instead"
    )
    job.add_argument(
        "--cosimulate", action="store_true", help="a walk as FMUs, robot and joint loop, instead"
    )
    job.add_argument("--train", action="store_true", help="train a policy instead")
    training = parser.add_argument_group("training")
    training.add_argument("--seed", type=int, default=0, metavar="N", help="of training (default 0)")
    training.add_argument("--filter", action="store_true", help="with the paper's filter in the loop")
    training.add_argument(
        "--velocity", type=float, default=1.0, metavar="V", help="largest command (default 1 m/s)"
    )
    training.add_argument("--iterations", type=int, metavar="N", help="default: see params.toml")
    training.add_argument("--out", metavar="FILE", help="the policy, JSON (default KIND-SEED.json)")
    training.add_argument(
        "--checkpoint", metavar="FILE", help="npz: written now and then, gone on from if there"
    )
    training.add_argument("--measure", action="store_true", help="a few iterations only: steps per second")
    output = parser.add_argument_group("output")
    output.add_argument(
        "--json", metavar="FILE", help="write the figures; - for standard output instead of the table"
    )
    output.add_argument(
        "--picture",
        metavar="FILE",
        default="quadruped.png",
        help="png, pdf or svg (default quadruped.png; none: no picture)",
    )
    output.add_argument(
        "--animation", metavar="FILE", help="a walk with the heaviest payload as GIF, instead"
    )
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="of the simulator (default 2)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


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
    check_target(options.json)
    check_target(options.out, suffixes=(".json",))
    check_target(options.checkpoint, suffixes=(".npz",))
    check_target(options.animation, suffixes=(".gif",))
    target = None if options.picture == "none" else options.picture
    check_target(target, suffixes=(".png", ".pdf", ".svg"))
    try:
        if options.train:
            return _train(options)
        if options.choose:
            return _choose(options)
        if options.stance:
            return _stance(options, target)
        if options.cosimulate:
            return _cosimulate(options)
        return _animate(options) if options.animation else _compare(options, target)
    except ImportError as error:  # the command line shows one line, and which extra
        raise ValueError(str(error)) from error


def _filter(options: Namespace) -> FilterChoice | None:
    from .loop import paper_filter

    return paper_filter() if options.filter else None


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
    )


def _compare(options: Namespace, target: str | None) -> int:
    from phyfilter_ctl._output import write_figure
    from phyfilter_ctl.models.progress import progress

    from . import comparison, report
    from .picture import draw

    plan = _plan(options)
    own = _own(options)
    with progress(comparison.steps(plan), options.quiet) as say:
        found = comparison.compare(plan, own=own, report=say, threads=options.threads)
    if options.json != "-":
        print(report.table(found))
    _write_json(options, report.figures(found))
    if target is not None:
        write_figure(target, draw(found))
    return 0


def _own(options: Namespace) -> dict[str, Method]:
    """Policies of the user's own, with the filter they were trained with."""
    from .methods import of_policies

    if not options.policy:
        return {}
    from .policy import load

    return of_policies([load(Path(name)) for name in options.policy])


def _animate(options: Namespace) -> int:
    from .animation import animate, prefer_off_screen
    from .evaluation import Case, Group, walk
    from .methods import METHODS
    from .params import params
    from .terrain import Terrain

    prefer_off_screen()
    plan = _plan(options)
    terrain = Terrain(plan.terrains[0], plan.difficulties[0]) if options.terrain and plan.terrains else None
    method = next(iter(_own(options).values()), METHODS[SHOWN])
    payload = max(options.payload or (0.0,)) * params().robot.mass
    speed = max(options.speed or (1.0,))
    policies = method.policies(plan.seeds[:1])
    [found] = walk([Group(policies, method.choice)], [Case(payload, speed)], terrain=terrain, duration=6.0)
    how = animate(Path(options.animation), found.trace.qpos[:, 0], terrain=terrain)
    if options.json != "-":
        fell = ", fell" if found.fallen[0, 0, 0] else ""
        print(f"{options.animation}: {method.label}, {payload:.1f} kg, {speed:g} m/s{fell}; drawn by {how}")
    _write_json(options, {"fallen": bool(found.fallen[0, 0, 0]), "drawn_by": how})
    return 0


# The method that an animation shows.
SHOWN = "filter"


def _choose(options: Namespace) -> int:
    from phyfilter_ctl.models.progress import progress

    from . import choice

    with progress(choice.steps(), options.quiet) as say:
        found = choice.choose(quick=options.quick, report=say, threads=options.threads)
    if options.json != "-":
        print(choice.table(found))
    _write_json(options, choice.figures(found))
    return 0


def _stance(options: Namespace, target: str | None) -> int:
    from phyfilter_ctl._output import write_figure

    from . import stance
    from .stance_picture import draw

    plant = stance.linearized()
    rows, limits = stance.study(plant=plant), stance.largest_poles(plant)
    if options.json != "-":
        print(stance.table(rows, limits))
    _write_json(options, stance.figures(rows, limits))
    if target is not None:
        write_figure(target, draw(plant=plant))
    return 0


def _cosimulate(options: Namespace) -> int:
    from . import cosimulation

    found = cosimulation.cosimulation(policy="filter-0", duration=1.0 if options.quick else 2.0)
    if options.json != "-":
        print(cosimulation.table(found))
    _write_json(options, cosimulation.figures(found))
    return 0


def _train(options: Namespace) -> int:
    from phyfilter_ctl.models.progress import progress

    from . import training
    from .policy import save

    wanted = training.Training(
        options.seed, _filter(options), iterations=options.iterations, velocity=options.velocity
    )
    if options.measure:
        found = training.measure(wanted, threads=options.threads)
        if options.json != "-":
            print(training.throughput_text(found))
        _write_json(options, found)
        return 0
    name = options.out or f"{'filter' if options.filter else 'base'}-{options.seed}.json"
    trainer = training.Trainer(wanted, threads=options.threads)
    with progress(trainer.iterations, options.quiet) as say:
        policy = training.train(
            trainer, checkpoint=None if options.checkpoint is None else Path(options.checkpoint), report=say
        )
    save(policy, Path(name))
    record = policy.record
    if options.json != "-":
        print(
            f"{name}: {record['steps']} steps in {record['seconds']:.0f} s, "
            f"{record['steps'] / record['seconds']:.0f} steps/s; reward per second, from first to last:"
        )
        print(training.curve_text(record["reward"]))
    _write_json(options, dict(record))
    return 0


def _write_json(options: Namespace, figures: object) -> None:
    from phyfilter_ctl._output import write_text

    if options.json is not None:
        write_text(options.json, json.dumps(figures, indent=2, allow_nan=False) + "\n")
