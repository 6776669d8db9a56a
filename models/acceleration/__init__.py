"""Acceleration from velocity: a small network that fails outside its training speeds, and the filter that repairs it.

x = v,   x' = f,   g = 0,   M = 1,   f_theta a network on a window of past velocities
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader

from phyfilter_ctl.study import Outputs, add_output_options

if TYPE_CHECKING:
    from phyfilter_ctl.filter import FilterBank, PhyFilter, SampledPhyFilter
    from phyfilter_ctl.recording import Recording

    from .diagram import build
    from .experiment import Comparison
    from .learning import Convergence, Descent
    from .study import IntervalStudy, LearnedPoint, PoleMap
    from .tuning import Case

__all__ = ["add_arguments", "build", "main"]
__getattr__: Callable[[str], object] = lazy_loader.attach(__name__, submod_attrs={"diagram": ["build"]})[0]

# Of the samples of the full generated flights, in --quick.
_QUICK_SHARE = 0.25

_DESCRIPTION = """Estimate the acceleration of a quadrotor from its measured velocity.

A network of two hidden layers of 20 learns it on slow flights and is tested on faster ones; PhyFilters of order 1
to 3 repair it, and five differentiators that learn nothing are tuned to compare. All tuning is on the training flights.
Without --train and --test the flights are generated: simulated, seeded, 0 to 2 m/s in training, 0 to 3 m/s in the test,
500 Hz."""

_EXAMPLES = """examples:
  phyfilter-ctl run acceleration
  phyfilter-ctl run acceleration --study --json figures.json --picture study.pdf
  phyfilter-ctl run acceleration --train slow_*.csv --test fast_*.csv
  phyfilter-ctl run acceleration --filter filter.toml           # a filter of `design` or `learn` beside the tuned ones

a recording is a CSV file with the columns t [s], vx vy vz [m/s] (measured) and ax ay az [m/s^2] (true acceleration)"""


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of ``phyfilter-ctl run acceleration``."""
    parser.add_argument(
        "--train", nargs="+", metavar="FILE", help="recorded flights to train on; needs --test"
    )
    parser.add_argument(
        "--test", nargs="+", metavar="FILE", help="recorded flights to test on; needs --train"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of the generated flights and of the network (default 0)"
    )
    parser.add_argument(
        "--study",
        action="store_true",
        help="also study order and poles, with learned filters, and the sampling interval (takes about twice as long)",
    )
    parser.add_argument(
        "--convergence",
        action="store_true",
        help="also compare how fast learning and the paper's Algorithm 2 come down (a minute more)",
    )
    parser.add_argument(
        "--quick", action="store_true", help="less data and coarser tuning: a try-out, in seconds"
    )
    parser.add_argument(
        "--filter",
        nargs="+",
        default=[],
        metavar="FILE",
        help="filters on disk (of design --out or learn --out) to score beside the tuned ones",
    )
    add_output_options(parser, "acceleration", description=_DESCRIPTION, examples=_EXAMPLES)


def main(options: Namespace) -> int:
    """Run the comparison; return the exit status.

    Raises
    ------
    ValueError, OSError
        If the options or the recordings are wrong, or a file cannot be read or written.
    """
    from phyfilter_ctl.filterfile import load

    from . import learning, study
    from .experiment import QUICK, Effort, compare, steps
    from .params import params
    from .picture import draw

    _check(options)
    outputs = Outputs.of(options)
    given = {name: load(name) for name in options.filter}
    train_logs, test_logs, data = _flights(options)
    effort = QUICK if options.quick else Effort()
    # A try-out takes two starts of the lower orders, and leaves Adam a tenth of a second.
    few = {"orders": (1, 2, 3), "starts": 2, "seconds": 0.1} if options.quick else {}
    total = steps() + (1 + len(study.intervals(train_logs[0].dt)) if options.study else 0)
    total += len(few.get("orders", params().convergence.orders)) if options.convergence else 0
    poles, intervals, convergence = None, None, None
    with outputs.progress(total) as report:
        comparison = compare(
            train_logs, test_logs, data=data, seed=options.seed, effort=effort, report=report
        )
        if options.study:
            report("order and poles")
            poles = study.order_by_pole(comparison)
            intervals = study.sampling_intervals(comparison, effort=effort, report=report)
        if options.convergence:
            convergence = learning.convergence(
                comparison.learned.cases, comparison.dt, seed=options.seed, report=report, **few
            )
    scores = _scores(comparison, given)
    figures = _figures(comparison, poles, intervals, convergence)
    if scores:
        figures["given"] = {name: {"train": train, "test": test} for name, (train, test) in scores.items()}
    outputs.publish(
        _table(comparison, scores),
        figures,
        lambda: draw(comparison, poles=poles, intervals=intervals, convergence=convergence),
    )
    return 0


def _check(options: Namespace) -> None:
    if (options.train is None) != (options.test is None):
        given, missing = ("--train", "--test") if options.test is None else ("--test", "--train")
        raise ValueError(f"{given} without {missing}: recordings are needed for both")
    if options.seed < 0:
        raise ValueError(f"--seed: expected 0 or more, got {options.seed}")
    if options.train is not None:
        seen: set[Path] = set()
        for name in (*options.train, *options.test):
            if (path := Path(name).resolve()) in seen:
                raise ValueError(f"{name}: given twice; a test on training data says nothing")
            seen.add(path)


def _flights(options: Namespace) -> tuple[tuple[Recording, ...], tuple[Recording, ...], str]:
    """Training flights, test flights, and what they are."""
    if options.train is not None:
        from phyfilter_ctl.recording import Recording

        train_logs, test_logs = (
            tuple(Recording.read(path) for path in paths) for paths in (options.train, options.test)
        )
        return train_logs, test_logs, "recorded"
    from .flights import generate

    share = _QUICK_SHARE if options.quick else 1.0
    train_logs, test_logs = (generate(kind, options.seed, share=share) for kind in ("train", "test"))
    return train_logs, test_logs, "generated"


def _scores(
    comparison: Comparison, given: Mapping[str, PhyFilter | FilterBank | SampledPhyFilter]
) -> dict[str, tuple[float, float]]:
    """Training and test RMSE of filters that were handed in, behind the same network."""
    from .tuning import filtered, rmse

    def score(name: str, cases: Sequence[Case]) -> float:
        try:
            return rmse(filtered(given[name], cases, comparison.dt), [case.log for case in cases])
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error

    train, test = comparison.train_cases(), comparison.test_cases()
    return {name: (score(name, train), score(name, test)) for name in given}


def _table(comparison: Comparison, given: Mapping[str, tuple[float, float]]) -> str:
    """The scores as text, in the order of the JSON."""
    from .picture import NAMES
    from .scores import best_rival, over

    train, test, squares = comparison.train_rmse, comparison.test_rmse, comparison.test_squares
    best, rival = min(test.values()), best_rival(test)
    made = " (simulated, not recorded)" if comparison.data == "generated" else ""
    lines = [
        f"{comparison.data} flights{made}: {len(comparison.train)} training, {len(comparison.test)} test, every "
        f"{1e3 * comparison.dt:.3g} ms",
        "",
        f"{'RMSE in m/s^2':<26}{'training':>10}{'test':>10}   over {NAMES[rival]}",
    ]
    lines += [
        f"{NAMES[name]:<26}{train[name]:>10.4f}{test[name]:>10.4f}   {over(squares[name], squares[rival])}"
        f"{'  least' if test[name] == best else ''}"
        for name in test
    ]
    lines += [f"{Path(name).name:<26}{one:>10.4f}{other:>10.4f}" for name, (one, other) in given.items()]
    for order, found in comparison.learned.filters.items():
        poles = ", ".join(f"{p:.4g}" if p.imag else f"{p.real:.4g}" for p in found.filter.poles)
        form = "low-pass form" if found.form == "lowpass" else "general form"
        lines += ["" if order == 1 else None, f"n = {order}: poles {poles} rad/s, {form}"]
    return "\n".join(line for line in lines if line is not None)


def _figures(
    comparison: Comparison,
    poles: PoleMap | None,
    intervals: IntervalStudy | None,
    convergence: Convergence | None,
) -> dict[str, object]:
    """The content of the JSON file."""
    learned = comparison.learned
    figures: dict[str, object] = {
        "data": comparison.data,
        "seed": comparison.seed,
        "n_train": sum(log.n for log in comparison.train),
        "n_test": sum(log.n for log in comparison.test),
        "rmse": comparison.test_rmse,
        "filters": {
            f"phyfilter_{order}": {
                "a": found.filter.a.tolist(),
                "b": found.filter.b.tolist(),
                "poles": [[p.real, p.imag] for p in found.filter.poles.tolist()],
                "dt": comparison.dt,
                "form": found.form,
                "tuning_rmse": found.tuning_rmse,
            }
            for order, found in learned.filters.items()
        },
        "train_rmse": comparison.train_rmse,
        "tuned": {
            "network": {"length": learned.network.length, "stride": learned.network.stride},
            **{
                name: {**vars(result.differentiator), "status": result.status}
                for name, result in comparison.baselines.items()
            },
        },
    }
    study: dict[str, object] = {}
    if poles is not None:
        study["order_by_pole"] = {
            "poles": poles.poles.tolist(),
            "rmse": {str(n): scores.tolist() for n, scores in zip(poles.orders, poles.rmse, strict=True)},
            "learned": [_learned_point(point) for point in poles.learned],
        }
    if intervals is not None:
        scores = {name: values.tolist() for name, values in intervals.rmse.items()}
        study["sampling_interval"] = {"dt": intervals.dt.tolist(), "rmse": scores}
    if convergence is not None:
        study["convergence"] = {
            "rates": {str(n): rate for n, rate in convergence.rates.items()},
            "learned": [_descent(descent) for descent in convergence.learned],
            "adam": [_descent(descent) for descent in convergence.adam],
        }
    return {**figures, "study": study} if study else figures


def _learned_point(point: LearnedPoint) -> dict[str, object]:
    result = point.result
    return {
        "order": point.order,
        "form": point.form,
        "order_used": result.order_used,
        "status": result.status,
        "a": result.filter.a.tolist(),
        "b": result.filter.b.tolist(),
        "pole": point.pole,
        "tuning_rmse": point.tuning_rmse,
        "test_rmse": point.test_rmse,
        "wiener_ratio": result.wiener_ratio,
    }


def _descent(descent: Descent) -> dict[str, object]:
    return {
        "order": descent.order,
        "start": descent.start,
        "times": descent.times.tolist(),
        "rmse": descent.rmse.tolist(),
        "status": descent.status,
    }
