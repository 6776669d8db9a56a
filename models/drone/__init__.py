"""The drone: a circle at 2 m/s with an unknown mass, in a wind that no model was trained on.

x = m v,   m v' = g + f,   g the thrust that acts, weight and drag,   f_theta SEER-I, trained on masses alone
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import lazy_loader

from phyfilter_ctl.study import Outputs, add_output_options

if TYPE_CHECKING:
    from phyfilter_ctl.study import Executor, Report

    from .comparison import Comparison
    from .diagram import build

__all__ = ["add_arguments", "build", "main"]
__getattr__: Callable[[str], object] = lazy_loader.attach(__name__, submod_attrs={"diagram": ["build"]})[0]

# Of --quick: flights and their length in s.
_QUICK_SEEDS, _QUICK_DURATION = 4, 14.0
# Of the missions' circles, m/s; None: that of params.toml.
_SPEEDS = {"paper": None, "fast": 3.0}

_DESCRIPTION = """Fly a quadrotor on a circle at 2 m/s with an unknown payload, without and with the wind of a fan.

SEER-I, a Chebyshev model with an adaptive law, was trained on payloads in still air. A PhyFilter repairs it in the
wind. PD with and without integral action, observer, INDI and L1 fly beside it, all tuned by one procedure."""

_EXAMPLES = """examples:
  phyfilter-ctl run drone
  phyfilter-ctl run drone --quick --json figures.json --picture flights.pdf
  phyfilter-ctl run drone --mission fast                        # at 3 m/s, where the learned model pays
  phyfilter-ctl run drone --study --picture study.pdf           # what is left open, one thing at a time
  phyfilter-ctl run drone --replay flight_1.csv flight_2.csv    # the residual force on recorded flights
  phyfilter-ctl run drone --tune                                # find the gains of all methods anew (about ten minutes)

a recording is a CSV file with the columns t [s], vx vy vz [m/s], qx qy qz qw, T_sp, hover_throttle, fax fay faz [N]"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run drone``."""
    job = parser.add_mutually_exclusive_group()
    job.add_argument(
        "--study",
        action="store_true",
        help="vary what is left open, one thing at a time, and map who wins where",
    )
    job.add_argument(
        "--replay", nargs="+", metavar="FILE", help="estimate the residual force on recorded flights instead"
    )
    job.add_argument(
        "--cosimulate",
        action="store_true",
        help="fly one flight as FMUs (vehicle, controller, filter) joined by SSP, against the diagram",
    )
    job.add_argument("--tune", action="store_true", help="tune all methods anew and print the result as TOML")
    parser.add_argument("--seeds", type=int, metavar="N", help="number of test flights (default 20)")
    parser.add_argument("--quick", action="store_true", help="four short flights: a try-out, in seconds")
    parser.add_argument(
        "--mission",
        choices=tuple(_SPEEDS),
        default="paper",
        help="the circle at 2 m/s, or at 3 m/s, where the learned model pays in the wind too (default paper)",
    )
    parser.add_argument(
        "--speed", type=float, metavar="V", help="of the circle, m/s (default: the mission's)"
    )
    parser.add_argument("--radius", type=float, metavar="R", help="of the circle, m (default 1.5)")
    parser.add_argument(
        "--payload",
        type=float,
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="range of the unknown mass, kg (default 0.15 0.9)",
    )
    parser.add_argument(
        "--replay-train",
        nargs="+",
        default=[],
        metavar="FILE",
        help="recorded flights to learn a model from, for --replay",
    )
    parser.add_argument(
        "--thrust-delay",
        type=float,
        default=0.0,
        metavar="S",
        help="let the recorded set-point act later, for --replay",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="a Dask scheduler whose workers fly; it must have one within 30 s",
    )
    parser.add_argument(
        "--checkpoint",
        metavar="FILE.jsonl",
        help="keep what the study has found there; given again, it goes on where it was broken off",
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        default="drone_run",
        help="folder of what a run leaves: the picture, unless --picture puts it elsewhere, and the tuned filter as "
        "FMU and C (default drone_run; none: nothing is left)",
    )
    add_output_options(parser, "drone", description=_DESCRIPTION, examples=_EXAMPLES)
    parser.set_defaults(picture=None)  # drone.png, there


def main(options: Namespace) -> int:
    """Run the job; return the exit status.

    Raises
    ------
    ValueError, OSError
        If options or recordings are wrong, the circle cannot be flown, or a file cannot be read or written.
    """
    _check(options)
    outputs = _outputs(options)
    if options.replay:
        _replay(options, outputs)
    elif options.tune:
        _tune(options, outputs)
    elif options.cosimulate:
        _cosimulate(options, outputs)
    elif options.study:
        _study(options, outputs)
    else:
        _compare(options, outputs)
    return 0


def _outputs(options: Namespace) -> Outputs:
    """The picture in the folder of --out, unless it is asked for by its name."""
    if options.picture is not None or options.out == "none":
        return Outputs.of(options)
    return Outputs(options.json, "drone.png", options.quiet, folder=options.out)


def _check(options: Namespace) -> None:
    from .params import params
    from .reference import check_feasible, flown

    if options.seeds is not None and options.seeds < 1:
        raise ValueError(f"--seeds: expected 1 or more, got {options.seeds}")
    if options.scheduler and (options.replay or options.cosimulate):
        raise ValueError("--scheduler: a replay and a co-simulation run here; leave one of the two out")
    if options.checkpoint and not options.study:
        raise ValueError("--checkpoint: only --study is kept; add --study")
    if (options.replay_train or options.thrust_delay) and not options.replay:
        raise ValueError("--replay-train and --thrust-delay belong to --replay; add --replay FILES")
    job = next((name for name in ("study", "tune", "replay", "cosimulate") if getattr(options, name)), None)
    given = {
        "mission": options.mission != "paper",
        "speed": options.speed is not None,
        "radius": options.radius is not None,
        "payload": options.payload is not None,
    }
    changed = [f"--{name}" for name, one in given.items() if one]
    if job and changed:
        raise ValueError(
            f"--{job}: {', '.join(changed)} would change the comparison only; leave one of the two out"
        )
    if options.payload and not 0.0 <= options.payload[0] <= options.payload[1]:
        raise ValueError(
            f"--payload: expected 0 <= LOW <= HIGH, got {options.payload[0]:g} and {options.payload[1]:g} kg"
        )
    mission = flown(_circle(options))
    heaviest = params().vehicle.mass + (options.payload[1] if options.payload else params().mass.high)
    check_feasible(mission.speed, mission.radius, heaviest)


def _seeds(options: Namespace) -> range:
    from .params import params

    count = _QUICK_SEEDS if options.quick else params().seeds.test
    return range(count if options.seeds is None else options.seeds)


def _compare(options: Namespace, outputs: Outputs) -> None:
    from . import comparison, report
    from .picture import draw

    seeds, duration = _seeds(options), _QUICK_DURATION if options.quick else None
    with outputs.progress(comparison.steps() + 2) as say, _executor(options) as executor:
        found = comparison.compare(
            seeds,
            duration=duration,
            payload=tuple(options.payload) if options.payload else None,
            others=_circle(options),
            report=say,
            executor=executor,
        )
        figures = report.figures(found)
        say("real-time factor")
        method = found.methods["phyfilter"]
        factor = comparison.realtime_factor(method, found.training, duration=10.0 if options.quick else 60.0)
        figures["realtime_factor"] = factor
        notes = [f"whole closed loop: {factor:.0f} times real time on one core"]
        notes.append(_hand_over(options, found, figures, say))
    outputs.publish("\n".join([report.table(found), "", *notes]), figures, lambda: draw(found))


def _circle(options: Namespace) -> dict[str, float]:
    """Parameters of the diagram for another circle."""
    speed = _SPEEDS[options.mission] if options.speed is None else options.speed
    given = {"speed": speed, "radius": options.radius}
    return {f"controller.reference.{name}": value for name, value in given.items() if value is not None}


def _hand_over(options: Namespace, found: Comparison, figures: dict[str, object], say: Report) -> str:
    """Export the tuned filter and replay a flight through it; what is to be said about it."""
    from tempfile import TemporaryDirectory

    from .handover import hand_over

    say("filter as FMU and C")
    with TemporaryDirectory() as scratch:
        folder = scratch if options.out == "none" else options.out
        handed = hand_over(found.methods["phyfilter"].method, found.training.model, folder)
    apart = handed.largest
    figures["fmu_max_abs_difference"] = max((apart[form] for form in apart if form != "C"), default=None)
    figures["c_max_abs_difference"] = apart.get("C")
    if handed.worst is None:
        return handed.message
    return f"FMI 2.0, FMI 3.0 and C repeat the flight's {handed.samples} samples of f_hat within {handed.worst:.2g} N"


def _cosimulate(options: Namespace, outputs: Outputs) -> None:
    from . import cosimulation
    from .training import train
    from .tuning import tuned

    found = cosimulation.cosimulation(
        tuned()["phyfilter"].method, train().model, duration=4.0 if options.quick else 20.0
    )
    outputs.publish(cosimulation.table(found), cosimulation.figures(found))


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
        found = tuning.tune_all(train().model, report=say, executor=executor)
    print(tuning.text(found), end="")


def _study(options: Namespace, outputs: Outputs) -> None:
    from . import study
    from .study_picture import draw
    from .study_points import Grid
    from .study_report import figures, table

    grid = Grid()
    if options.quick:
        few = tuple(range(2))
        grid = Grid(few, few, 3, 2, 2, (0, 6), (0.0, 1.0, 2.0), _QUICK_DURATION)
    if options.seeds is not None:
        grid = replace(grid, seeds=tuple(range(options.seeds)))
    with outputs.progress(study.steps(grid=grid)) as say:
        found = study.study(grid=grid, report=say, scheduler=options.scheduler, checkpoint=options.checkpoint)
    outputs.publish(table(found), figures(found), lambda: draw(found))


def _replay(options: Namespace, outputs: Outputs) -> None:
    from . import replay, replay_picture

    found = replay.replay(options.replay, train=options.replay_train, thrust_delay=options.thrust_delay)
    outputs.publish(replay.table(found), replay.figures(found), lambda: replay_picture.draw(found))
