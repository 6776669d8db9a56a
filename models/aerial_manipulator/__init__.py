"""The aerial manipulator: pick and place with a moving arm and an unknown load, in the wind of a fan.

Force: x = m v, torque: x = J omega;   f_theta SEER-I, trained on the arm alone in still air
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING

import lazy_loader

from phyfilter_ctl.study import Outputs, add_output_options

if TYPE_CHECKING:
    from phyfilter_ctl.study import Executor

    from .comparison import Comparison
    from .diagram import build
    from .params import Mission

__all__ = ["add_arguments", "build", "main"]
__getattr__: Callable[[str], object] = lazy_loader.attach(__name__, submod_attrs={"diagram": ["build"]})[0]

_QUICK_SEEDS = 4

_DESCRIPTION = """Fly a multirotor with an arm to an object on a stand, pick it and place it, in the jet of a fan.

A cooperative planner shares the way between platform and arm. SEER-I, Chebyshev models of the arm's force and torque,
was trained hovering in still air with an empty gripper. PhyFilters of force and torque repair it under wind and load.
PD with and without integral action and disturbance observers fly beside it, all tuned by one procedure."""

_EXAMPLES = """examples:
  phyfilter-ctl run aerial_manipulator
  phyfilter-ctl run aerial_manipulator --quick --json figures.json --picture mission.pdf
  phyfilter-ctl run aerial_manipulator --mission fast           # the arm turns in hover: the learned model pays
  phyfilter-ctl run aerial_manipulator --place 1.8 0.2 1.0 --payload 0.2
  phyfilter-ctl run aerial_manipulator --study                  # gusts, load transfer, an arm that helps, the planner
  phyfilter-ctl run aerial_manipulator --out fmus_of_the_arm    # FMUs of vehicle, controller and filters as well
  phyfilter-ctl run aerial_manipulator --tune                   # find the gains of all methods anew (ten minutes)"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run aerial_manipulator``."""
    job = parser.add_mutually_exclusive_group()
    job.add_argument("--study", action="store_true", help="vary what is left open, one thing at a time")
    job.add_argument("--tune", action="store_true", help="tune all methods anew and print the result as TOML")
    parser.add_argument("--seeds", type=int, metavar="N", help="number of test missions (default 20)")
    parser.add_argument("--quick", action="store_true", help="four missions, one case: a try-out, in seconds")
    parser.add_argument(
        "--mission",
        choices=("paper", "fast"),
        default="paper",
        help="pick and place, or hovering while the arm turns fast, where the learned model pays (default paper)",
    )
    for name, text in (("pick", "the object"), ("place", "the place")):
        parser.add_argument(
            f"--{name}", type=float, nargs=3, metavar=("X", "Y", "Z"), help=f"where {text} is, m"
        )
    parser.add_argument("--payload", type=float, metavar="KG", help="mass of the object (default 0.3)")
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a Dask scheduler whose workers fly; it must have one within 30 s",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        help="export vehicle, controller and filters as FMUs, and replay a mission through each",
    )
    add_output_options(parser, "aerial_manipulator", description=_DESCRIPTION, examples=_EXAMPLES)


def main(options: Namespace) -> int:
    """Run the job; return the exit status.

    Raises
    ------
    ValueError, OSError
        If options are wrong, the mission cannot be flown, or a file cannot be written.
    """
    mission, outputs = _mission(options), Outputs.of(options)
    if options.out is not None:
        _check_out(options)
    if options.mission == "fast":
        _turn(options, mission, outputs)
    elif options.tune:
        _tune(options, outputs)
    elif options.study:
        _study(options, outputs)
    else:
        _compare(options, mission, outputs)
    return 0


def _check_out(options: Namespace) -> None:
    """A folder that FMUs can go to, and a compiler to make them: before anything flies."""
    from pathlib import Path

    from phyfilter_ctl.codegen import find_compiler

    if options.study or options.tune:
        raise ValueError("--out: FMUs come with the comparison; leave out --study and --tune")
    if not Path(options.out).parent.is_dir():
        raise FileNotFoundError(f"--out: there is no folder {Path(options.out).parent}")
    find_compiler()


def _mission(options: Namespace) -> Mission | None:
    """The mission that is asked for, checked; None for that of the file."""
    from .mission import changed, check
    from .params import params

    if options.seeds is not None and options.seeds < 1:
        raise ValueError(f"--seeds: expected 1 or more, got {options.seeds}")
    mission = changed(pick=options.pick, place=options.place, payload=options.payload)
    check(mission)
    if mission == params().mission:
        return None
    if options.study or options.tune:
        raise ValueError(
            "--pick, --place and --payload change the comparison only; leave out --study and --tune"
        )
    return mission


def _seeds(options: Namespace) -> range:
    from .params import params

    count = _QUICK_SEEDS if options.quick else params().test.seeds
    return range(count if options.seeds is None else options.seeds)


def _compare(options: Namespace, mission: Mission | None, outputs: Outputs) -> None:
    from . import comparison, report
    from .picture import draw

    cases = ("mission",) if options.quick else tuple(comparison.CASES)
    with outputs.progress(comparison.steps(cases=cases) + 1) as say, _executor(options) as executor:
        found = comparison.compare(
            _seeds(options), cases=cases, mission=mission, report=say, executor=executor
        )
        figures = report.figures(found)
        say("real-time factor")
        factor = comparison.realtime_factor(found.methods["phyfilter"], found.training)
    figures["realtime_factor"] = factor
    notes = [f"whole closed loop: {factor:.0f} times real time on one core"]
    if options.out is not None:
        notes.append(_hand_over(options.out, outputs, found, figures))
    outputs.publish("\n".join([report.table(found), "", *notes]), figures, lambda: draw(found))


def _turn(options: Namespace, mission: Mission | None, outputs: Outputs) -> None:
    from . import turning
    from .picture import draw_turning

    if options.study or options.tune or mission is not None or options.out:
        raise ValueError(
            "--mission fast: a table of its own; leave out --study, --tune, --pick, --place, --payload and --out"
        )
    cases = turning.RATES[-1:] if options.quick else turning.CASES
    with outputs.progress(turning.steps(cases)) as say, _executor(options) as executor:
        found = turning.compare(_seeds(options), cases=cases, report=say, executor=executor)
    outputs.publish(turning.table(found), turning.figures(found), lambda: draw_turning(found))


def _hand_over(folder: str, outputs: Outputs, found: Comparison, figures: dict[str, object]) -> str:
    """Export the parts and replay a mission through them; what is to be said about it."""
    from .handover import PARTS, hand_over

    with outputs.progress(2 * len(PARTS)) as say:
        handed = hand_over(found.methods["phyfilter"].method, found.training.seer, folder, report=say)
    figures["fmu_max_abs_difference"] = {part: found.worst for part, found in handed.items()}
    apart = ", ".join(f"{part} {found.worst:.2g}" for part, found in handed.items())
    samples = handed[PARTS[0]].samples
    return f"FMI 2.0 and 3.0 repeat a mission's {samples} samples; largest difference of an output: {apart}"


def _study(options: Namespace, outputs: Outputs) -> None:
    from . import study

    with outputs.progress(study.steps()) as say, _executor(options) as executor:
        rows = study.run(_seeds(options), report=say, executor=executor)
    outputs.publish(study.table(rows), study.figures(rows))


def _executor(options: Namespace) -> Executor:
    """One job after the other here, each over the cores; or the cluster."""
    from phyfilter_ctl.study import Executor

    return Executor(1) if options.scheduler is None else Executor(scheduler=options.scheduler)


def _tune(options: Namespace, outputs: Outputs) -> None:
    from . import tuning
    from .methods import METHODS
    from .training import train

    count = sum(tuning.steps(name) for name in METHODS)
    with outputs.progress(count) as say, _executor(options) as executor:
        found = tuning.tune_all(train().seer, report=say, executor=executor)
    print(tuning.text(found), end="")
