"""What learning returns by order on few and many flights, and what it is worth on flights it never saw.

    python benchmarks/order_choice.py [FOLDER] [--flights 1 2 8] [--orders 8] [--quick]

FOLDER holds CSV files as for recorded_estimate.py, one a flight; without it flights are generated (noisy x). The
slowest by the 99th percentile of speed are learned from, all others are scored and nothing is chosen by them. For every
number of flights and every N the general form of `learn(flights, range(1, N + 1))`: the order that cross-validation
chooses, F(0), slowest and fastest pole, cross-validated and out-of-sample RMSE, its ratio to that of N - 1 with the
standard error of this ratio over the flights. Then what was returned before, fitted to the training flights alone with
F(0) free. Exits with 1 where F(0) is not 1, a pole lies outside the band, or the ratio exceeds 1 by more than one
standard error.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from recorded_estimate import flight
from scipy.signal import lfilter

from phyfilter_ctl import Recording, Search, Shape, split
from phyfilter_ctl.design.learning import LearnResult, learn

# Fastest pole over the sampling rate that the sum of n decay rates allows, n times.
FASTEST = 3.0
ROUNDING = 1e-9


def generated(flights: int) -> list[Recording]:
    """Gusts of 0.4 s and a slow swing, velocity with 3 mm/s of noise, every 10 ms for 12 to 26 s."""
    found, dt = [], 0.01
    for seed in range(flights):
        rng = np.random.default_rng(seed)
        t = dt * np.arange(1200 + 100 * seed)[:, None]
        keep = np.exp(-dt / 0.4)
        drive = rng.standard_normal((len(t), 3))
        gusts = np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drive, axis=0))
        f = (1.0 + 0.05 * seed) * gusts + np.sin(t * [0.9, 1.7, 2.9])
        x = np.cumsum(dt * f, axis=0) + 3e-3 * rng.standard_normal(f.shape)
        found.append(Recording.from_arrays(x=x, dt=dt, label=f))
    return found


def squares(result: LearnResult, logs: Sequence[Recording]) -> np.ndarray:
    """Sum of squared errors and number of samples (flights, 2), by running the filter."""
    found = []
    for log in logs:
        assert log.label is not None
        times = None if log.is_uniform else log.times
        run = result.filter.sampled(log.dt, result.method)
        errors = (np.asarray(run.run(log.x, log.g, times=times)) - log.label)[1:]
        found.append((float(np.sum(errors**2)), errors.size))
    return np.array(found)


def rmse(scores: np.ndarray) -> float:
    return float(np.sqrt(scores[:, 0].sum() / scores[:, 1].sum()))


def ratio(scores: np.ndarray, below: np.ndarray) -> tuple[float, float]:
    """Ratio of two RMSE on the same flights, and its standard error: jackknife over the flights."""
    count = len(scores)
    left = [np.delete(np.arange(count), i) for i in range(count)]
    ratios = np.array([rmse(scores[rows]) / rmse(below[rows]) for rows in left])
    error = float(np.sqrt((count - 1.0) / count * np.sum((ratios - ratios.mean()) ** 2)))
    return rmse(scores) / rmse(below), error


def row(train: Sequence[Recording], test: Sequence[Recording], N: int, below: np.ndarray | None, starts: int):
    begun = time.perf_counter()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "flights disagree")
        result = learn(
            train, range(1, N + 1), shape="general", search=Search(starts=starts, cross_validate=True)
        )
    took = time.perf_counter() - begun
    poles, scores = result.filter.poles(), squares(result, test)
    slowest, fastest = float(np.min(-poles.real)), float(np.max(-poles.real))
    value, error = (1.0, 0.0) if below is None else ratio(scores, below)
    chosen = next(score for score in result.orders if score.order == result.order_used)
    inside = (
        slowest >= result.slowest * (1.0 - ROUNDING)
        and np.sum(-poles.real) <= N * (FASTEST / result.dt + result.slowest) * (1.0 + ROUNDING)
        and np.max(np.abs(poles.imag)) <= np.pi / result.dt
    )
    holds = bool(inside) and result.filter.dc_gain == 1.0 and value - 1.0 <= error + ROUNDING
    print(
        f"{N:>3}{result.order_used:>8}{result.filter.dc_gain:>8.3f}{slowest:>9.2f}{fastest:>9.1f}{result.rmse:>10.4f}"
        f"{chosen.held_out_rmse:>10.4f}{rmse(scores):>10.4f}{value:>9.4f} +-{error:.4f}  {result.status}, {took:.1f} s"
        f"{'' if holds else '  DOES NOT HOLD'}"
    )
    return holds, scores


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "folder", type=Path, nargs="?", help="folder of CSV files (default: generated flights)"
    )
    parser.add_argument("--flights", type=int, nargs="+", default=[1, 2, 8], help="numbers (default 1 2 8)")
    parser.add_argument("--orders", type=int, default=8, help="highest order (default 8)")
    parser.add_argument("--starts", type=int, default=2, help="random starts (default 2)")
    parser.add_argument("--quick", action="store_true", help="one flight, orders 1 to 3, no random starts")
    options = parser.parse_args()
    paths = [] if options.folder is None else sorted(options.folder.glob("*.csv"))
    if options.folder is not None and len(paths) < 4:
        print(f"not evaluated: expected at least 4 CSV files in {options.folder}, found {len(paths)}")
        return 0
    numbers, orders, starts = options.flights, options.orders, options.starts
    if options.quick:
        numbers, orders, starts = [1], 3, 0
    logs = [flight(path) for path in paths] or generated(4 if options.quick else 16)
    slower, faster = split(logs)
    good = True
    for count in numbers:
        train, test = slower[:count], [*slower[count:], *faster]
        print(
            f"\n{len(train)} flights to learn from, {len(test)} others to score on\n"
            f"{'N':>3}{'chosen':>8}{'F(0)':>8}{'slowest':>9}{'fastest':>9}{'training':>10}{'folds':>10}{'others':>10}"
            f"{'to N - 1':>9}"
        )
        below = None
        for N in range(1, orders + 1):
            holds, below = row(train, test, N, below, starts)
            good &= holds
        free = learn(
            train,
            orders,
            shape=Shape("general", dc_gain=None),
            search=Search(starts=starts, cross_validate=False),
        )
        print(
            f"F(0) free, order {orders} asked for, no folds: F(0) = {free.filter.dc_gain:.3g}, {free.message}"
        )
    print(
        "\nF(0) = 1, poles in the band, no order worse than the one below:",
        "holds" if good else "DOES NOT HOLD",
    )
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
