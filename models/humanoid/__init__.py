"""The humanoid: it stands while a lateral force pulls at one hand, and leans into what the filter has estimated.

M q'' = g + f,   g from a nominal twin that is simulated one step from the true state,   f = J_hand' F
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

import numpy as np

from phyfilter_ctl.design import hz
from phyfilter_ctl.study import Executor, Outputs, add_output_options

if TYPE_CHECKING:
    import control as ct

__all__ = ["add_arguments", "build", "main"]

_DESCRIPTION = """Let dm_control's humanoid (40.8 kg) stand under a constant lateral force on its right hand.

An LQR holds each stance. A PhyFilter estimates the force from what the robot does beyond a nominal twin, and moves the
LQR's target: the body leans into the force. Bisection finds the largest force held, without the filter and with it."""

_EXAMPLES = """examples:
  phyfilter-ctl run humanoid
  phyfilter-ctl run humanoid --quick --json figures.json --picture none
  phyfilter-ctl run humanoid --forces 20 -90 --stances normal --animation standing.gif
  phyfilter-ctl run humanoid --gears 2          # the variant with doubled motor torques
  phyfilter-ctl run humanoid --friction elliptic --duration 60    # feet that hardly creep, a minute long
  phyfilter-ctl run humanoid --study --stances wider      # filters, what f_hat does, noise

needs the extra mujoco: pip install 'phyfilter-ctl[mujoco]'"""


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
    parser.add_argument("--stances", nargs="+", metavar="NAME", help="of normal, wide, wider (default: all)")
    parser.add_argument(
        "--forces",
        type=float,
        nargs="+",
        default=[20.0, 90.0, -90.0],
        metavar="N",
        help="trials at these forces: positive across the body, negative away from it (default 20 90 -90)",
    )
    parser.add_argument(
        "--gears", type=float, default=1.0, metavar="K", help="factor on the motor torques (default 1)"
    )
    parser.add_argument(
        "--friction",
        choices=("pyramidal", "elliptic"),
        default="pyramidal",
        help="MuJoCo's friction cones: the model's own, in which feet creep, or elliptic ones (default pyramidal)",
    )
    parser.add_argument("--duration", type=float, metavar="S", help="of a trial, s (default 10)")
    speed = parser.add_mutually_exclusive_group()
    speed.add_argument(
        "--a0", type=float, metavar="A", help="the filter's poles lie at -A rad/s (default 20)"
    )
    speed.add_argument(
        "--a0-hz", dest="a0", type=lambda text: hz(float(text)), metavar="A", help="the same in Hz"
    )
    parser.add_argument("--order", type=int, metavar="N", help="of the filter (default 1)")
    parser.add_argument(
        "--study", action="store_true", help="variants of the filter and its use, in each stance"
    )
    parser.add_argument("--quick", action="store_true", help="the normal stance and 5 s trials: a try-out")
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
    (_study if options.study else _compare)(options, stances, duration, outputs)
    return 0


def _checked(options: Namespace) -> tuple[tuple[str, ...], float | None]:
    from .params import STANCES, params, stance
    from .robot import load

    quick = STANCES[:1] if options.quick else STANCES
    stances = tuple(dict.fromkeys(options.stances or quick))
    for name in stances:
        stance(name)
    if not np.isfinite(options.forces).all():
        raise ValueError(f"--forces: expected finite forces in N, got {options.forces}")
    if options.a0 is not None and not (np.isfinite(options.a0) and options.a0 > 0.0):
        raise ValueError(f"--a0: expected a positive number in rad/s, got {options.a0}")
    if options.order is not None and options.order < 1:
        raise ValueError(f"--order: expected 1 or more, got {options.order}")
    load(options.gears, options.friction)
    rules = params().trial
    full = rules.onset + rules.rise
    if options.duration is not None and not (np.isfinite(options.duration) and options.duration > full):
        raise ValueError(
            f"--duration: expected more than {full:g} s, when the slow force is there, got {options.duration}"
        )
    return stances, full + 2.0 if options.quick and options.duration is None else options.duration


def _executor(options: Namespace) -> Executor:
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
            duration=duration,
            report=say,
            executor=executor,
        )
    outputs.publish(report.table(found), report.figures(found), lambda: picture.draw(found))
    if options.animation is not None:
        chosen = {
            "LQR alone": found.trials[stances[0], "slow", forces[-1], "alone"],
            "PhyFilter": found.trials[stances[0], "slow", forces[-1], "filter"],
        }
        picture.animate(found.humanoid, chosen, options.animation)


def _study(options: Namespace, stances: tuple[str, ...], duration: float | None, outputs: Outputs) -> None:
    from . import limits, report

    found = {}
    with outputs.progress(14 * len(stances)) as say, _executor(options) as executor:
        for name in stances:
            found[name] = limits.study(
                name, friction=options.friction, duration=duration, report=say, executor=executor
            )
    outputs.publish(
        "\n\n".join(report.study_table(name, rows) for name, rows in found.items()),
        [report.study_figures(name, rows) for name, rows in found.items()],
    )
