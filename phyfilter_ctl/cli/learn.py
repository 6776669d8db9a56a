"""``phyfilter-ctl learn``: from recorded flights to a table of orders and forms, a picture and the best filter."""

from __future__ import annotations

import argparse
import math
import signal
import threading
import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Protocol, TypeVar, get_args

from .._choices import Form, Method
from .._output import add_json, add_quiet, check_target, write_figure, write_json
from .columns import add_columns, for_signals_of, names_of
from .frequencies import add_picture_units
from .learn_loop import add_loop, loop_of
from .unused import refuse_units

if TYPE_CHECKING:
    from ..design.learning import LearnEvent, LearnResult, Reading, Shape
    from ..execution import Report
    from ..filter import SampledPhyFilter
    from .flights import Flights
    from .learn_report import Row

__all__ = ["add_arguments", "main"]

_Number = TypeVar("_Number", float, complex)
_HIGHEST_ORDER = 12
_STOPPED = 130  # exit status after Ctrl-C, as of a shell

_DESCRIPTION = """Learn filters F = N/D from flights whose true f is known (the label), and compare orders and forms.
The best one is described and saved: least RMSE on --held-out flights (of filters within 0.1 % the one of fewest
coefficients), else on flights or blocks not learned from (the one of fewest coefficients within one standard error, two
of fewer than five flights). Ctrl-C stops and keeps the best so far."""

_EPILOG = """columns looked for in a CSV file, unless an option names others:
  t [s]; x: vx vy vz [m/s]; label: ax ay az, or label_<x>; g_<x>; f_theta_<x>; inertia_<i> or inertia_<i>_<j>

examples:
  phyfilter-ctl learn flight.csv
  phyfilter-ctl learn slow_*.csv --held-out fast_*.csv --order 1 2 3 --out filter.toml --picture learned.png
  phyfilter-ctl learn flight.csv --x px,py --label fx,fy --g ux,uy --f-theta mx,my --inertia 1.2
  phyfilter-ctl learn flight.csv --model network.onnx --features vx,vy,vz
  phyfilter-ctl learn flight.csv --order 3 --form general --method tustin --json -
  phyfilter-ctl learn flight.csv --per-channel --out filters.toml   one filter for each channel
  phyfilter-ctl learn day_1 day_2 --order 2 --skip-bad            folders; files beyond 128 MB are not kept in memory
  phyfilter-ctl learn flight.csv --margin 0.5 --lag 0.05 --loop-delay 0.01 --kp 10 --kd 6   safe in this loop
  phyfilter-ctl design filter.toml                              reads the saved filter"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl learn``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "logs", nargs="+", metavar="LOG.csv", help="flights, or folders of them, to learn from"
    )
    parser.add_argument("--held-out", nargs="+", default=[], metavar="LOG.csv", help="flights to score on")
    kinds = parser.add_argument_group("filters")
    kinds.add_argument(
        "--order", nargs="+", type=int, default=[1, 2, 3], metavar="N", help="orders (default 1 2 3)"
    )
    kinds.add_argument(
        "--form",
        nargs="+",
        choices=get_args(Form),
        help="N = a_0, or N free (default both; general alone with a type, zeros or another gain)",
    )
    _add_structure(parser)
    kinds.add_argument(
        "--method", choices=get_args(Method), default="exact", help="discretisation (default exact)"
    )
    kinds.add_argument("--starts", type=int, default=5, metavar="K", help="random starts (default 5)")
    kinds.add_argument("--seed", type=int, default=0, help="of the random starts (default 0)")
    kinds.add_argument("--channels", metavar="C,C,...", help="of x, that take part (default all)")
    kinds.add_argument(
        "--per-channel",
        action="store_true",
        help="a filter of its own for each channel (default one for all)",
    )
    add_loop(parser)
    add_columns(parser)
    _add_reading(parser)
    output = parser.add_argument_group("output")
    output.add_argument("--out", metavar="FILTER.toml", help="write the best filter")
    output.add_argument("--picture", metavar="FILE", help="costs and frequency response as png, pdf or svg")
    add_json(output)
    add_picture_units(output)
    add_quiet(output)


def _add_structure(parser: argparse.ArgumentParser) -> None:
    kinds = parser.add_argument_group("what F is made to be (general form)")
    kinds.add_argument("--dc-gain", default="1", metavar="G", help='F(0), or "free" (default 1)')
    kinds.add_argument("--type", type=int, metavar="K", help="zeros of 1 - F at s = 0")
    kinds.add_argument("--zeros-at", metavar="W,...", help="rad/s at which 1 - F vanishes: what is followed")
    kinds.add_argument("--blocked-at", metavar="W,...", help="rad/s at which F vanishes: what is not")
    kinds.add_argument("--poles", metavar="P,...", help="given poles in rad/s, as --poles=-5,-3+2j,-3-2j")
    kinds.add_argument("--pole-range", metavar="LOW,HIGH", help="magnitude of the other poles in rad/s")
    kinds.add_argument("--damping", type=float, metavar="Z", help="least damping ratio of the other poles")
    kinds.add_argument(
        "--regularisation", type=float, default=0.0, metavar="R", help="pull to the order below"
    )
    kinds.add_argument("--label-offset", action="store_true", help="labels may be off by a constant a flight")
    kinds.add_argument("--delay", type=float, default=0.0, metavar="S", help="known delay of x in s")
    kinds.add_argument(
        "--compare-axes",
        action="store_true",
        help="one filter for all axes, one each or a matrix: score them",
    )


def _add_reading(parser: argparse.ArgumentParser) -> None:
    reading = parser.add_argument_group("many files")
    reading.add_argument("--skip-bad", action="store_true", help="report flights that are bad, and go on")
    reading.add_argument("--workers", type=int, metavar="K", help="processes that read (default one a core)")
    reading.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster that reads instead, as tcp://host:8786"
    )


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl learn``; return the exit status, 130 after Ctrl-C.

    Raises
    ------
    ValueError, OSError
        If the options or the logs are wrong, or a file cannot be read or written.
    """
    picture = None if options.picture == "none" else options.picture
    check_target(options.out, suffixes=(".toml",))
    check_target(picture, suffixes=(".png", ".pdf", ".svg"))
    _check(options)
    from .. import filterfile
    from ..results import Status
    from .channels import figures_below, text_of
    from .flights import read_flights
    from .learn_report import best_of, figures_of, table_of, worse_than_none

    logs, held_out = read_flights(options.logs, options), read_flights(options.held_out, options)
    found = [text for each in (*logs.summaries, *held_out.summaries) for text in each.findings]
    found += [f"left out: {text}" for part in (logs, held_out) for text in part.skipped.values()]
    channels = (
        list(logs.summaries[0].channels)
        if options.channels is None
        else names_of("--channels", options.channels)
    )
    groups = {name: [name] for name in channels} if options.per_channel else {"": channels}
    with _Interrupt() as interrupt, warnings.catch_warnings():
        # Among the notes and messages.
        warnings.filterwarnings("ignore", "the label of|g of|flights disagree|no filter up to", UserWarning)
        rows = {name: _learned(options, group, logs, held_out, interrupt) for name, group in groups.items()}
    if not all(rows.values()):
        raise KeyboardInterrupt
    best = {name: best_of(entries) for name, entries in rows.items()}
    worse = {
        k: text for k, group in groups.items() if (text := worse_than_none(logs, held_out, group, best[k]))
    }
    found += [f"{name}: {text}" if name else text for name, text in worse.items()]
    if options.compare_axes and not interrupt.asked:
        found.append(_axes(options, channels, logs, best[""]))
    if options.json != "-":
        tables = {k: table_of(logs, held_out, group, rows[k], best[k]) for k, group in groups.items()}
        print(text_of(tables), *(f"note: {text}" for text in found), sep="\n")
    if options.json is not None:
        figures = {k: figures_of(logs, held_out, group, rows[k], best[k]) for k, group in groups.items()}
        below = {"seed": options.seed, **figures_below(figures), "findings": found}
        write_json(options.json, below)
    if options.out is not None:
        if lost := [row.result.message for row in best.values() if row.result.status is Status.INFEASIBLE]:
            raise ValueError(f"{options.out}: not written: {lost[0]}")
        if worse:
            raise ValueError(f"{options.out}: not written: {found[-1]}")
        learned = _sampled([row.result for row in best.values()])
        filterfile.save(options.out, for_signals_of(learned, logs.summaries))
    if picture is not None:
        _draw(picture, options, best)
    return _STOPPED if interrupt.asked else 0


def _axes(options: argparse.Namespace, channels: list[str], logs: Flights, best: Row) -> str:
    """What one filter each, or a matrix, would be worth."""
    from ..design.learning import Search, learn
    from ..filter import Sampling

    if channels != list(logs.summaries[0].channels):
        raise ValueError(
            "--compare-axes is of all channels: choose them by --x and --label instead of --channels"
        )
    found = learn(
        logs.logs,
        best.result.order_used,
        shape=_shape(options, best.form),
        sampling=Sampling(method=options.method, delay=options.delay),
        axes="compare",
        label=_label(options),
        search=Search(starts=0, cross_validate=False, regularisation=options.regularisation),
        reading=_reading(options),
    )
    scores = ", ".join(f"{kind} {score.held_out_rmse:.4g}" for kind, score in found.scores.items())
    advice = {
        "shared": "as it is",
        "each": "learn with --per-channel",
        "coupled": 'use pf.learn(axes="compare")',
    }
    return (
        f"axes, RMSE on what was not learned from: {scores}; chosen: {found.choice} ({advice[found.choice]})"
    )


def _draw(picture: str, options: argparse.Namespace, best: dict[str, Row]) -> None:
    import matplotlib

    from .channels import responses

    matplotlib.use("Agg")  # a file is all that is wanted; there may be no display
    if options.per_channel:
        filters = {name: _sampled([row.result]) for name, row in best.items()}
        plot = responses(filters).plot(dB=options.db, Hz=options.hz)
    else:
        plot = best[""].result.plot(dB=options.db, Hz=options.hz)
    write_figure(picture, plot.figure)


# -- options to flights -----------------------------------------------------------------------------------------


def _check(options: argparse.Namespace) -> None:
    refuse_units(options)
    if wrong := [n for n in options.order if not 1 <= n <= _HIGHEST_ORDER]:
        raise ValueError(f"--order: expected 1 to {_HIGHEST_ORDER}, got {wrong[0]}")
    for name in ("starts", "seed"):
        if getattr(options, name) < 0:
            raise ValueError(f"--{name}: expected 0 or more, got {getattr(options, name)}")
    if options.per_channel and options.channels is not None:
        raise ValueError(
            "--per-channel is of all channels: choose them by --x and --label instead of --channels"
        )
    if options.per_channel and options.compare_axes:
        raise ValueError(
            "--compare-axes scores one filter for all axes against one each: leave --per-channel out"
        )
    seen: set[Path] = set()
    for name in (*options.logs, *options.held_out):
        if (path := Path(name).resolve()) in seen:
            raise ValueError(f"{name}: given twice; a score on flights learned from says nothing")
        seen.add(path)


def _reading(options: argparse.Namespace, report: Report | None = None) -> Reading:
    """How files are read, and by whom."""
    from ..design.learning import Reading
    from ..execution import silent
    from .flights import read_labelled

    workers = options.workers if options.scheduler is None else options.scheduler
    return Reading(partial(read_labelled, options=options), workers=workers, report=report or silent)


def _label(options: argparse.Namespace) -> Literal["given", "offset"]:
    return "offset" if options.label_offset else "given"


def _shape(options: argparse.Namespace, form: Form) -> Shape:
    """What F is made to be."""
    from ..design.learning import Shape

    found: dict[str, Any] = {
        "pole_range": None
        if options.pole_range is None
        else _numbers("--pole-range", options.pole_range, float),
        "damping": options.damping,
        "poles": _numbers("--poles", options.poles, complex),
    }
    if form == "general":
        found |= {
            "dc_gain": _dc_gain(options),
            "type": 1 if options.type is None else options.type,
            "zeros_at": _numbers("--zeros-at", options.zeros_at, float),
            "blocked_at": _numbers("--blocked-at", options.blocked_at, float),
        }
    return Shape(form, **found)


def _dc_gain(options: argparse.Namespace) -> float | None:
    free = options.dc_gain.strip().lower() in ("free", "none")
    return None if free else _numbers("--dc-gain", options.dc_gain, float)[0]


def _numbers(option: str, text: str | None, kind: type[_Number]) -> list[_Number]:
    if text is None:
        return []
    try:
        return [kind(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"{option}: expected numbers with commas between, got {text!r}") from None


def _forms(options: argparse.Namespace) -> tuple[Form, ...]:
    """The forms asked for; by default both, or the general one where the low-pass form has no such choice."""
    given = {
        "--dc-gain": _dc_gain(options) != 1.0,
        "--type": options.type is not None,
        "--zeros-at": bool(options.zeros_at),
        "--blocked-at": bool(options.blocked_at),
    }
    chosen = [option for option, there in given.items() if there]
    if options.form is None:
        return ("general",) if chosen else ("lowpass", "general")
    if chosen and "general" not in options.form:
        raise ValueError(f"{chosen[0]} is a choice of the general form: add --form general, or leave it out")
    return tuple(dict.fromkeys(options.form))


# -- learning ---------------------------------------------------------------------------------------------------


class _Interrupt:
    """The first Ctrl-C asks the search to stop, the second stops it."""

    asked = False

    def __enter__(self) -> _Interrupt:
        # Python delivers signals to the main thread, and lets only that one ask for them.
        self._mine = threading.current_thread() is threading.main_thread()
        if self._mine:
            self._before = signal.signal(signal.SIGINT, self._hear)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._mine:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, number: int, frame: object) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


class _Bar(Protocol):
    def set_description(self, desc: str | None = None) -> None: ...
    def set_postfix_str(self, s: str = "") -> None: ...
    def update(self) -> object: ...


def _learned(
    options: argparse.Namespace,
    channels: list[str],
    logs: Flights,
    held_out: Flights,
    interrupt: _Interrupt,
) -> list[Row]:
    from tqdm import tqdm

    orders, forms = sorted(set(options.order)), _forms(options)
    rows: list[Row] = []
    # disable=None: off where standard error is not a terminal.
    with tqdm(
        total=len(orders) * len(forms), disable=True if options.quiet else None, leave=False, unit="filter"
    ) as bar:
        for order in orders:
            for form in forms:
                row = _row(options, channels, order, form, logs, held_out, interrupt, bar)
                rows += [] if row is None else [row]
                if interrupt.asked:
                    return rows
                bar.update()
    return rows


def _row(
    options: argparse.Namespace,
    channels: list[str],
    order: int,
    form: Form,
    logs: Flights,
    held_out: Flights,
    interrupt: _Interrupt,
    bar: _Bar,
) -> Row | None:
    from ..design.learning import Search, learn
    from ..filter import Sampling
    from .learn_report import Row, form_name

    bar.set_description(f"{form_name(form)}, order {order}")

    def report(event: LearnEvent) -> bool:
        bar.set_postfix_str(f"order {event.order}, RMSE {math.sqrt(max(event.cost, 0.0)):.4g}")
        return interrupt.asked

    try:
        result = learn(
            logs.logs,
            order,
            shape=_shape(options, form),
            sampling=Sampling(
                method=options.method, g=options.g_rule, f_theta=options.f_theta_rule, delay=options.delay
            ),
            channels=channels,
            label=_label(options),
            held_out=held_out.logs or None,
            loop=loop_of(options),
            search=Search(
                starts=options.starts,
                seed=options.seed,
                regularisation=options.regularisation,
                cross_validate=True if len(logs.logs) > 1 else None,
                callback=report,
            ),
            reading=_reading(options, bar.set_postfix_str),
        )
    except ValueError:
        if interrupt.asked:  # before anything was found
            return None
        raise
    return Row(order, form, result)


def _sampled(results: Sequence[LearnResult]) -> SampledPhyFilter:
    from ..filter import stack

    parts = [result.sampled() for result in results]
    return parts[0] if len(parts) == 1 else stack(parts)
