"""The humanoid: it stands while a lateral force pulls at one hand, and leans into what the filter has estimated.

M q'' = g + f,   g from a nominal twin that is simulated one step from the true state,   f = J_hand' F
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from phyfilter_ctl.study import Outputs, add_output_options

if TYPE_CHECKING:
    import control as ct

    from phyfilter_ctl.study import Executor

__all__ = ["add_arguments", "build", "main"]

_DESCRIPTION = """Let dm_control's humanoid (40.8 kg) stand under a constant lateral force on its right hand.

An LQR holds each stance. A PhyFilter estimates the force from what the robot does beyond a nominal twin, and moves the
LQR's target: the body leans into the force. Bisection finds the largest force held, without the filter and with it."""

_EXAMPLES = """examples:
  phyfilter-ctl run humanoid
  phyfilter-ctl run humanoid --quick --json figures.json --picture none
  phyfilter-ctl run humanoid --forces 20 -90 --stances normal --animation standing.gif
  phyfilter-ctl run humanoid --gears 2          # the variant with doubled motor torques
  phyfilter-ctl run humanoid --friction pyramidal --duration 10   # contacts as in dm_control: feet creep
  phyfilter-ctl run humanoid --robot berkeley             # a real robot's masses, motors and friction, no arms
  phyfilter-ctl run humanoid --robot berkeley --grips torso --profiles slow --workers 4
  phyfilter-ctl run humanoid --robot berkeley --policy berkeley-0 --grips torso   # a trained policy
  phyfilter-ctl run humanoid --robot berkeley --train --seed 7 --checkpoint 7.npz --out 7.json
  phyfilter-ctl run humanoid --study --stances wider      # filters, what f_hat does, noise

needs the extra mujoco: pip install 'phyfilter-ctl[mujoco]'; --train needs the extra train too"""


def build(stance: str = "normal") -> ct.StateSpace:
    """The linearised loop; see ``diagram.py``.

    Parameters
    ----------
    stance : {"normal", "wide", "wider"}
    """
    from . import diagram

    return diagram.build(stance)


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run humanoid``.

    Parameters
    ----------
    parser : ArgumentParser
    """
    parser.add_argument(
        "--robot",
        choices=("suite", "berkeley"),
        default="suite",
        help="dm_control's, pulled at a hand, or the Berkeley Humanoid, pulled at torso and pelvis from eight sides",
    )
    parser.add_argument(
        "--grips", nargs="+", metavar="NAME", help="of the Berkeley Humanoid: torso, pelvis (default: both)"
    )
    parser.add_argument(
        "--profiles", nargs="+", choices=("sudden", "slow"), help="of its forces (default: both)"
    )
    walking = parser.add_argument_group("policies of the Berkeley Humanoid")
    walking.add_argument(
        "--policy",
        nargs="+",
        metavar="NAME",
        help="trained policies in place of the LQR, files or shipped ones; steps: the clocked steps without any",
    )
    walking.add_argument("--train", action="store_true", help="train a policy instead")
    walking.add_argument("--seed", type=int, metavar="N", help="of training (default 0)")
    walking.add_argument("--iterations", type=int, metavar="N", help="default: see berkeley/walk.toml")
    walking.add_argument("--out", metavar="FILE", help="the policy, JSON (default berkeley-SEED.json)")
    walking.add_argument(
        "--checkpoint", metavar="FILE", help="npz: written now and then, gone on from if there"
    )
    parser.add_argument("--stances", nargs="+", metavar="NAME", help="of normal, wide, wider (default: all)")
    parser.add_argument(
        "--forces",
        type=float,
        nargs="+",
        metavar="N",
        help="trials at these forces: positive across the body, negative away from it (default 20 90 -90); with "
        "--policy: sizes (default 5 10 15 20)",
    )
    parser.add_argument(
        "--gears", type=float, default=1.0, metavar="K", help="factor on the motor torques (default 1)"
    )
    parser.add_argument(
        "--friction",
        choices=("pyramidal", "elliptic"),
        default="elliptic",
        help="MuJoCo's friction cones: elliptic, or the model's own pyramids, in which feet creep (default elliptic)",
    )
    parser.add_argument(
        "--noise",
        type=float,
        metavar="V",
        help="of the measured velocities, standard deviation in rad/s and m/s (default 0.003)",
    )
    parser.add_argument(
        "--duration", type=float, metavar="S", help="of a trial, s (default 61, of the study 16)"
    )
    speed = parser.add_mutually_exclusive_group()
    speed.add_argument("--a0", type=float, metavar="A", help="the filter's poles lie at -A rad/s (default 3)")
    speed.add_argument(
        "--a0-hz", dest="a0", type=lambda text: math.tau * float(text), metavar="A", help="the same in Hz"
    )
    parser.add_argument("--order", type=int, metavar="N", help="of the filter (default 1)")
    parser.add_argument(
        "--study", action="store_true", help="variants of the filter and its use, in each stance"
    )
    parser.add_argument("--quick", action="store_true", help="the normal stance and 8 s trials: a try-out")
    parser.add_argument(
        "--animation",
        metavar="FILE",
        help="gif of the last force, slow, first stance, without and with the filter",
    )
    parser.add_argument(
        "--workers", type=int, metavar="K", help="processes that simulate (default one a core)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a Dask scheduler whose workers simulate instead; it must have one within 30 s",
    )
    add_output_options(parser, "humanoid", description=_DESCRIPTION, examples=_EXAMPLES)


def main(options: Namespace) -> int:
    """Run the job; return the exit status.

    Parameters
    ----------
    options : Namespace
        As parsed.

    Raises
    ------
    ValueError, OSError
        If options are wrong, the extra ``mujoco`` is missing, or a file cannot be written.
    """
    from phyfilter_ctl._output import check_target

    stances, duration = _checked(options)
    outputs = Outputs.of(options)
    check_target(options.animation, suffixes=(".gif",))
    check_target(options.out, suffixes=(".json",))
    check_target(options.checkpoint, suffixes=(".npz",))
    if options.train:
        _train(options, outputs)
    elif options.policy:
        _walk(options, duration, outputs)
    elif options.robot == "berkeley":
        _around(options, duration, outputs)
    else:
        (_study if options.study else _compare)(options, stances, duration, outputs)
    return 0


def _checked(options: Namespace) -> tuple[tuple[str, ...], float | None]:
    from .params import STANCES, params, stance
    from .robot import load
    from .walk_params import walk_params

    quick = STANCES[:1] if options.quick else STANCES
    stances = tuple(dict.fromkeys(options.stances or quick))
    for name in stances:
        stance(name)
    others = ("stances", "study", "animation", *(() if options.policy else ("forces",)))
    only = [name for name in others if getattr(options, name)]
    if options.robot == "berkeley" and only:
        raise ValueError(f"--robot berkeley: it has no {', '.join(f'--{name}' for name in only)}")
    if options.robot == "suite" and (options.policy or options.train):
        raise ValueError("--policy, --train: they are those of --robot berkeley")
    if options.policy and options.train:
        raise ValueError("--policy, --train: one or the other")
    names = ("seed", "iterations", "out", "checkpoint")
    loose = [f"--{name}" for name in names if getattr(options, name) is not None]
    if loose and not options.train:
        raise ValueError(f"{', '.join(loose)}: they go with --train")
    if options.policy and (options.gears != 1.0 or options.friction != "elliptic"):
        raise ValueError(
            "--gears, --friction: policies were not trained for other motors, and run with elliptic cones"
        )
    if options.robot == "suite" and (options.grips or options.profiles):
        raise ValueError("--grips, --profiles: they are those of --robot berkeley")
    for name in options.grips or ():
        load(robot="berkeley", grip=name)
    if options.forces is None:
        options.forces = list(walk_params().trial.forces) if options.policy else [20.0, 90.0, -90.0]
    if not all(map(math.isfinite, options.forces)):
        raise ValueError(f"--forces: expected finite forces in N, got {options.forces}")
    if options.a0 is not None and not (math.isfinite(options.a0) and options.a0 > 0.0):
        raise ValueError(f"--a0: expected a positive number in rad/s, got {options.a0}")
    if options.order is not None and options.order < 1:
        raise ValueError(f"--order: expected 1 or more, got {options.order}")
    if options.noise is not None and not (math.isfinite(options.noise) and options.noise >= 0.0):
        raise ValueError(f"--noise: expected 0 or more, got {options.noise}")
    if options.noise is not None and options.study:
        raise ValueError("--noise: the study has its own levels of noise; leave it out")
    load(options.gears, options.friction, robot=options.robot)
    rules = params().trial
    full = rules.onset + rules.rise
    if options.duration is not None and not (math.isfinite(options.duration) and options.duration > full):
        raise ValueError(
            f"--duration: expected more than {full:g} s, when the slow force is there, got {options.duration}"
        )
    return stances, full + 5.0 if options.quick and options.duration is None else options.duration


def _executor(options: Namespace) -> Executor:
    from phyfilter_ctl.study import Executor

    return Executor(None if options.scheduler else options.workers, scheduler=options.scheduler)


def _compare(options: Namespace, stances: tuple[str, ...], duration: float | None, outputs: Outputs) -> None:
    from . import limits, picture, report
    from .trial import phyfilter

    forces = tuple(dict.fromkeys(options.forces))
    law = phyfilter(options.a0, options.order)
    with outputs.progress(limits.steps(stances, forces)) as say, _executor(options) as executor:
        found = limits.compare(
            stances,
            forces,
            gears=options.gears,
            friction=options.friction,
            filter=law,
            noise=options.noise,
            duration=duration,
            report=say,
            executor=executor,
        )
    outputs.publish(report.table(found), report.figures(found), lambda: picture.draw(found))
    if options.animation is not None:
        chosen = {
            f"{forces[-1]:g} N, LQR alone": found.trials[stances[0], "slow", forces[-1], "alone"],
            f"{forces[-1]:g} N, with PhyFilter": found.trials[stances[0], "slow", forces[-1], "filter"],
        }
        picture.animate(found.humanoid, chosen, options.animation)


def _around(options: Namespace, duration: float | None, outputs: Outputs) -> None:
    from . import around, picture
    from .limits import PROFILES
    from .params import params
    from .robot import GRIPS
    from .trial import phyfilter

    quick = slice(1) if options.quick else slice(None)
    grips = tuple(dict.fromkeys(options.grips or tuple(GRIPS["berkeley"])[quick]))
    profiles = tuple(dict.fromkeys(options.profiles or PROFILES))
    headings = ("front",) if options.quick else tuple(around.HEADINGS)
    a0 = params().berkeley.a0 if options.a0 is None else options.a0
    with outputs.progress(around.steps(grips, headings, profiles)) as say, _executor(options) as executor:
        found = around.around(
            grips,
            headings,
            profiles,
            gears=options.gears,
            friction=options.friction,
            filter=phyfilter(a0, options.order),
            noise=options.noise,
            duration=duration,
            report=say,
            executor=executor,
        )
    outputs.publish(around.table(found), around.figures(found), lambda: picture.draw_around(found))


def _walk(options: Namespace, duration: float | None, outputs: Outputs) -> None:
    from . import walk_study
    from .limits import PROFILES
    from .params import params
    from .robot import GRIPS
    from .trial import phyfilter

    grips = tuple(dict.fromkeys(options.grips or tuple(GRIPS["berkeley"])[: 1 if options.quick else None]))
    profiles = tuple(dict.fromkeys(options.profiles or PROFILES))
    policies, forces = tuple(dict.fromkeys(options.policy)), tuple(dict.fromkeys(options.forces))
    a0 = params().berkeley.a0 if options.a0 is None else options.a0
    count = walk_study.steps(policies, grips, profiles, forces)
    with outputs.progress(count) as say, _executor(options) as executor:
        found = walk_study.study(
            policies,
            grips,
            profiles,
            forces,
            filter=phyfilter(a0, options.order),
            noise=options.noise,
            duration=duration,
            report=say,
            executor=executor,
        )
    outputs.publish(walk_study.table(found), walk_study.figures(found))


def _train(options: Namespace, outputs: Outputs) -> None:
    from ..quadruped.network import save
    from ..quadruped.ppo import Job, train
    from ..quadruped.training import curve_text
    from . import walking

    seed = 0 if options.seed is None else options.seed
    trainer = walking.Trainer(Job(seed, options.iterations))
    checkpoint = None if options.checkpoint is None else Path(options.checkpoint)
    with outputs.progress(trainer.iterations) as say:
        policy = train(trainer, checkpoint=checkpoint, every=20, report=say)
    name, record = options.out or f"berkeley-{seed}.json", policy.record
    save(policy, Path(name))
    table = (
        f"{name}: {record['steps']} steps in {record['seconds']:.0f} s; reward per second, from first to last:\n"
        + curve_text(record["reward"])
    )
    outputs.publish(table, dict(record))


def _study(options: Namespace, stances: tuple[str, ...], duration: float | None, outputs: Outputs) -> None:
    from . import limits, report

    found = {}
    with outputs.progress(limits.study_steps(stances)) as say, _executor(options) as executor:
        for name in stances:
            found[name] = limits.study(
                name, friction=options.friction, duration=duration, report=say, executor=executor
            )
    outputs.publish(
        "\n\n".join(report.study_table(name, rows) for name, rows in found.items()),
        [report.study_figures(name, rows) for name, rows in found.items()],
    )
