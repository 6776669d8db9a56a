"""``phyfilter-ctl estimate``: from recordings to the force that the model missed, and the filter that shows it."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from .._output import add_json, check_target, replacing, write_figure, write_json, write_text
from .columns import COLUMNS, add_columns, for_signals_of, plausibility, read_columns
from .frequencies import add_picture_units
from .unused import refuse_units

if TYPE_CHECKING:
    from .._sections import FloatArray
    from ..analysis import FilterMargins
    from ..baselines import EstimatorComparison
    from ..estimation import Estimate
    from ..recording import Recording

__all__ = ["add_arguments", "main"]

_TABLES = (".csv", ".json", ".parquet")

_DESCRIPTION = """The force (or torque, or acceleration) that your model missed in recordings: how large, at which
frequencies, how sure, and which filter shows it best. No label is needed: the noise is separated from the force by the
spectrum, and the answer is tested by how well it predicts what x does next. f has the unit of M x': m/s^2 where x is a
velocity in m/s and no --inertia is given, N with a mass in kg."""

_EPILOG = """columns looked for in a CSV file, unless an option names others:
  t [s]; x: vx vy vz [m/s]; g_<x>; f_theta_<x>; inertia_<i> or inertia_<i>_<j>; label: ax ay az, or label_<x>

examples:
  phyfilter-ctl estimate flight.csv
  phyfilter-ctl estimate flight_*.csv --g ux,uy,uz --inertia 1.5 --lag 0.05 --save-filter filter.toml
  phyfilter-ctl estimate flight.csv --filter filter.toml --compare    is my filter good, and is another way better
  phyfilter-ctl estimate flight.ulg --robot robot.toml                a log as it is; robot.toml says what is in it
  phyfilter-ctl estimate flight.csv --picture missed.png --out f_hat.csv --json -"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl estimate``."""
    parser.description, parser.epilog = _DESCRIPTION, _EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("logs", nargs="+", metavar="LOG", help="recordings of one robot")
    parser.add_argument("--filter", metavar="FILTER.toml", help="judge this filter (default: suggest one)")
    parser.add_argument(
        "--order",
        nargs="+",
        type=int,
        default=[1, 2],
        metavar="N",
        help="orders to suggest from (default 1 2)",
    )
    parser.add_argument(
        "--horizon", type=float, default=0.2, metavar="S", help="of the prediction test (default 0.2)"
    )
    parser.add_argument(
        "--noise",
        nargs="+",
        type=float,
        metavar="S",
        help="deviation of the white noise of M x, one for all or one each, instead of what the recordings show",
    )
    parser.add_argument("--compare", action="store_true", help="other estimators on the same recordings")
    parser.add_argument(
        "--robot", metavar="ROBOT.toml", help="what the signals of the logs are, instead of columns"
    )
    loop = parser.add_argument_group("the loop that f_hat shall be fed back in")
    loop.add_argument("--lag", type=float, metavar="S", help="first-order lag of the actuator in s")
    loop.add_argument("--delay", type=float, default=0.0, metavar="S", help="delay of the command in s")
    add_columns(parser)
    output = parser.add_argument_group("output")
    output.add_argument("--save-filter", metavar="FILTER.toml", help="write the filter")
    output.add_argument("--out", metavar="FILE", help="f_hat and its noise band as csv, json or parquet")
    output.add_argument(
        "--picture", metavar="FILE", help="f_hat and spectrum of the first one: png, pdf, svg"
    )
    add_picture_units(output, magnitudes=False)
    add_json(output)


def main(options: argparse.Namespace) -> int:
    """Run ``phyfilter-ctl estimate``; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options or the recordings are wrong, or a file cannot be read or written.
    """
    check_target(options.out, suffixes=_TABLES)
    check_target(options.save_filter, suffixes=(".toml",))
    check_target(options.picture, suffixes=(".png", ".pdf", ".svg"))
    refuse_units(options)
    from .. import filterfile
    from ..baselines import compare
    from ..estimation import estimate

    given = None if options.filter is None else filterfile.load(options.filter)
    logs, doubts = _read(options)
    rules = {"g": options.g_rule, "f_theta": options.f_theta_rule}
    found = estimate(logs, given, orders=options.order, horizon=options.horizon, noise=options.noise, **rules)
    others = None
    if options.compare:
        others = compare(logs, given, horizon=options.horizon, **rules)
    margin = _margin(found, options)
    if options.save_filter is not None:
        filterfile.save(options.save_filter, for_signals_of(found.filter, logs))
    if options.out is not None:
        _write_table(options.out, found)
    if options.json is not None:
        figures = {"estimate": found, "findings": doubts, "inner_loop": margin, "others": others}
        write_json(options.json, figures)
    if options.json != "-":
        print("\n".join(_text(found, options, margin, others, doubts)))
    if options.picture is not None:
        import matplotlib

        matplotlib.use("Agg")
        write_figure(options.picture, found.plot(Hz=options.hz).figure)
    return 0


def _read(options: argparse.Namespace) -> tuple[list[Recording], list[str]]:
    """Recordings, and what is not plausible about them."""
    if options.robot is None:
        logs = [read_columns(path, options) for path in options.logs]
        return logs, plausibility(logs, options)
    given = [name for name in COLUMNS if getattr(options, name.replace("-", "_")) is not None]
    if given:
        raise ValueError(
            f"--robot and --{given[0]}: expected one of them; the robot file says what the signals are"
        )
    from ..robot import Robot

    robot = Robot.load(options.robot)
    checks = [robot.check(robot.opened(path, options.largest)) for path in options.logs]
    doubts = [f"{check.recording.name}: {finding}" for check in checks for finding in check.findings]
    return [check.recording for check in checks], doubts


def _margin(found: Estimate, options: argparse.Namespace) -> FilterMargins | None:
    """None where the loop is not one that can be told: g known at both ends of a step, a filter for each channel."""
    if found.filter.sampling.g == "average" or len(found.filter.filters) > 1:
        return None
    from ..analysis.margins import filter_margins
    from ..values import Loop

    return filter_margins(found.filter, Loop(actuator=options.lag, delay=options.delay))


# -- table ------------------------------------------------------------------------------------------------------


def _write_table(path: str, found: Estimate) -> None:
    import numpy as np

    from ..recording.csvfile import write_csv
    from ..results import plain

    several, names = len(found.recordings) > 1, found.recordings[0].channels
    header = ["recording"] * several + ["t"] + [f"f_hat_{name}" for name in names]
    header += [f"deviation_{name}" for name in names]
    table = np.vstack(
        [
            np.hstack(
                [
                    np.full((log.n, int(several)), float(i)),
                    log.times[:, None],
                    f_hat,
                    np.broadcast_to(found.noise_deviation, f_hat.shape),
                ]
            )
            for i, (log, f_hat) in enumerate(zip(found.recordings, found.f_hat, strict=True))
        ]
    )
    columns: dict[str, FloatArray] = dict(zip(header, table.T, strict=True))
    if path.endswith(".parquet"):
        try:
            import polars
        except ImportError:
            raise ValueError(
                f"{path}: parquet needs polars: pip install 'phyfilter-ctl[containers]'"
            ) from None
        with replacing(path) as file:
            polars.DataFrame(columns).write_parquet(file)
    elif path.endswith(".json"):
        write_text(path, json.dumps(plain(columns, infinite=True), allow_nan=False) + "\n")
    else:
        write_csv(Path(path), header, table, ",")


# -- text -------------------------------------------------------------------------------------------------------


def _text(
    found: Estimate,
    options: argparse.Namespace,
    margin: FilterMargins | None,
    others: EstimatorComparison | None,
    doubts: list[str],
) -> list[str]:
    lines = [*map(repr, found.recordings), ""]
    lines += _missed(found)
    lines += ["", *_filter(found, options)]
    lines += ["", *_test(found)]
    if others is not None:
        lines += ["", *_others(others)]
    lines += ["", *_loop(margin, options), "", *_handover(found, options)]
    if notes := [*doubts, *found.notes]:
        lines += ["", "look at this first", *(f"  {note}" for note in notes)]
    return lines


def _missed(found: Estimate) -> list[str]:
    log, noise = found.recordings[0], found.noise
    lines = [f"{'what the model misses':<24}{'rms':>10}{'noise of M x':>16}"]
    for i, name in enumerate(log.channels):
        span = f"{noise.value[i]:>16.3g}  ({noise.low[i]:.3g} to {noise.high[i]:.3g})"
        lines.append(f"  {name:<22}{found.missed[i]:>10.4g}{span}")
    bands = "; ".join(f"{band} rad/s: {rms:.3g}" for band, rms in found.spectrum.bands.items() if rms > 0.0)
    model = ""
    if any(log.f_theta is not None for log in found.recordings):
        model = f"; f_theta alone {100.0 * found.explained_by_model:.3g} %"
    return [
        *lines,
        _line("by frequency", bands or "nothing above the noise"),
        _line("f_hat explains", f"{100.0 * found.explained:.3g} % of the mean square of f{model}"),
    ]


def _filter(found: Estimate, options: argparse.Namespace) -> list[str]:
    from .._signals import in_both
    from .channels import text_of

    best, mine = found.suggestion, found.error
    low, high = mine.low, mine.high
    tried = ", ".join(f"order {n}: {error:.4g} at {in_both(w)}" for n, (w, error) in best.orders.items())
    crossing = (
        in_both(found.spectrum.crossing)
        if math.isfinite(found.spectrum.crossing)
        else "above what the samples show"
    )
    deviation = ", ".join(f"{value:.3g}" for value in found.noise_deviation)
    names = found.recordings[0].channels if len(found.filter.filters) > 1 else ("",)
    described = {name: F.describe() for name, F in zip(names, found.filter.filters, strict=True)}
    return [
        "the filter" if options.filter is None else f"your filter, {options.filter}",
        *(f"  {line}" for line in text_of(described).splitlines()),
        _line(
            "expected error",
            f"{mine.value:.4g} rms of f - f_hat ({low:.3g} to {high:.3g}), lag and noise together",
        ),
        _line("noise of f_hat", f"{deviation} (standard deviation)"),
        _line("best without label", tried),
        _line("second opinion", f"force and noise are equally strong at {crossing}"),
    ]


def _test(found: Estimate) -> list[str]:
    test, unit = found.prediction, found.recordings[0].unit
    less = test.reduction
    verdict = "f_hat helps" if test.improves else "f_hat does not help"
    return [
        f"test: x {test.horizon:g} s ahead, rms of the error{f' in {unit}' if unit else ''}",
        _line("x stays as it is", f"{test.still:.4g}"),
        _line("model alone", f"{test.model:.4g}"),
        _line("model and f_hat held", f"{test.filter:.4g}"),
        _line(
            "less by", f"{100 * less.value:.3g} % ({100 * less.low:.3g} to {100 * less.high:.3g}): {verdict}"
        ),
    ]


def _others(others: EstimatorComparison) -> list[str]:
    lines = [f"{'other estimators, each tuned on the first half':<50}{'RMSE':>8}   over the filter's"]
    for name, rmse in others.rmse.items():
        ratio = others.ratio.get(name)
        beside = "" if ratio is None else f"   {ratio.value:.3f} ({ratio.low:.3f} to {ratio.high:.3f})"
        lines.append(f"  {name.split(' (')[0]:<48}{rmse:>8.4g}{beside}")
    return [
        *lines,
        _line("against", f"{others.against}, second halves"),
        _line("verdict", others.verdict),
        _line("the same thing", "a momentum observer is the filter of order 1 without f_theta"),
    ]


def _loop(margin: FilterMargins | None, options: argparse.Namespace) -> list[str]:
    if margin is None:
        return ["in a loop: not told for g known at both ends of a step, or a filter for each channel"]
    actuator = "an ideal actuator" if options.lag is None else f"a lag of {options.lag:g} s"
    late = f" and a delay of {options.delay:g} s" if options.delay else ""
    if math.isnan(margin.min_ratio):
        answer = "unstable even at the right mass; take a lower bandwidth (--filter)"
    else:
        low, high = margin.min_ratio, margin.max_ratio
        answer = f"stable while the mass you assume is {low:.3g} to {high:.3g} times the true one"
    lines = [f"fed back as tau = tau_0 - f_hat, {actuator}{late}", f"  {answer}"]
    if options.lag is None:
        lines.append(
            "  a real actuator lags and allows less: give --lag, and see phyfilter-ctl analyze --kp --kd"
        )
    return lines


def _handover(found: Estimate, options: argparse.Namespace) -> list[str]:
    from .. import filterfile
    from ..filter import SampledPhyFilter

    file, channels = options.save_filter or options.filter, found.recordings[0].n_x
    first = [] if file else ["  (write it first: --save-filter filter.toml)"]
    file, words = file or "filter.toml", f"--channels {channels}"
    if file == options.filter and not isinstance(filterfile.load(file), SampledPhyFilter):
        words += f" --dt {found.filter.dt}"
    return [
        "hand it over",
        *first,
        f"  phyfilter-ctl export {file} --c firmware {words}",
        f"  phyfilter-ctl export {file} --fmu filter.fmu {words}",
    ]


def _line(name: str, text: str) -> str:
    return f"  {name:<22}{text}"
