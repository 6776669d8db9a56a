"""Acceleration from velocity on recorded flights, all methods, over several splits; paired intervals over flights.

    python benchmarks/recorded_acceleration.py FOLDER [--splits 3] [--seed 0] [--quick]

FOLDER holds CSV files with the columns t [s], vx vy vz [m/s], ax ay az [m/s^2], one a flight. The first split trains on
the slower half (99th percentile of the speed) and tests on the faster; the others draw halves at random. Prints test
RMSE by method, and each over the best method that is no PhyFilter, with a 95 % bootstrap interval over the test
flights: a flight is what is independent. A filter is ahead where that lies below 0. Last the floor of one split's test
flights: a FIR of 64 taps fitted to those flights themselves, which no filter shared by the axes undercuts there but by
a longer memory. A folder that is not there is not evaluated, which is no pass.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import models
from phyfilter_ctl.recording import Recording, split_by_speed

OURS = ("phyfilter_1", "phyfilter_2", "phyfilter_3", "learned", "learned_axes")
DRAWS, FLOOR = 4000, 64
Array = NDArray[np.float64]


def halves(logs: Sequence[Recording], split: int) -> tuple[list[Recording], list[Recording]]:
    """Training and test flights: by speed for split 0, else at random."""
    if split == 0:
        slower, faster = split_by_speed(logs)
        return list(slower), list(faster)
    order = np.random.default_rng(split).permutation(len(logs))
    return [logs[i] for i in order[: len(logs) // 2]], [logs[i] for i in order[len(logs) // 2 :]]


def rmse(squares: Array) -> float:
    """Of sums (..., 2) of squared errors and their numbers."""
    total, count = squares.sum(axis=0)
    return float(np.sqrt(total / count))


def interval(one: Array, other: Array, rng: np.random.Generator) -> tuple[float, float, float]:
    """RMSE of one over that of the other, less 1, and the ends of its interval: flights drawn with replacement."""
    drawn = rng.integers(len(one), size=(DRAWS, len(one)))
    ratios = np.sqrt(one[drawn, 0].sum(axis=1) / other[drawn, 0].sum(axis=1)) - 1.0
    low, high = np.quantile(ratios, [0.025, 0.975])
    return rmse(one) / rmse(other) - 1.0, float(low), float(high)


def table(squares: Mapping[str, Array], training: Mapping[str, float] | None = None) -> None:
    """Print it; ``squares`` (flights, 2) by method."""
    rivals = {name: rmse(values) for name, values in squares.items() if name not in OURS}
    best = min(rivals, key=lambda name: rivals[name])
    print(f"{'RMSE in m/s^2':<26}{'training':>10}{'test':>10}   over {best}")
    for name, values in squares.items():
        share, low, high = interval(values, squares[best], np.random.default_rng(0))
        ahead = "  ahead" if high < 0.0 and name in OURS else ""
        before = f"{training[name]:>10.4f}" if training else f"{'':>10}"
        print(f"{name:<26}{before}{rmse(values):>10.4f}   {share:+.1%} [{low:+.1%}, {high:+.1%}]{ahead}")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of CSV files")
    parser.add_argument(
        "--splits", type=int, default=3, help="halves: by speed, then random ones (default 3)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the network's first weights (default 0)")
    parser.add_argument("--quick", action="store_true", help="coarser training and tuning")
    options = parser.parse_args()
    paths = sorted(options.folder.glob("*.csv")) if options.folder.is_dir() else []
    if len(paths) < 2:
        print(f"not evaluated: expected at least 2 CSV files in {options.folder}, found {len(paths)}")
        return 0
    logs = [Recording.from_csv(path) for path in paths]
    experiment, linear = (
        importlib.import_module(f"{models.__name__}.acceleration.{name}") for name in ("experiment", "linear")
    )
    effort = experiment.QUICK if options.quick else experiment.Effort()
    pooled: dict[str, list[Array]] = {}
    for split in range(options.splits):
        train, test = halves(logs, split)
        found = experiment.compare(train, test, data="recorded", seed=options.seed, effort=effort)
        squares = found.squares()
        for name, values in squares.items():
            pooled.setdefault(name, []).append(values)
        print("slower half, faster half" if split == 0 else f"random halves {split}", flush=True)
        table(squares, found.train_rmse)
        if split == 0:
            floor = linear.SlopeFIR.fit(test, FLOOR)
            errors = [linear.kept_error(floor.estimate(log.x, log.dt), log) for log in test]
            least = float(np.sqrt(np.mean(np.concatenate([error.ravel() for error in errors]) ** 2)))
            print(f"{'floor, fitted to the test':<26}{'':>10}{least:>10.4f}", flush=True)
    if options.splits > 1:
        count = [len(values) for values in pooled["network"]]
        print(f"all splits, {sum(count)} tests of {len(logs)} flights: mean RMSE")
        for name, several in pooled.items():
            print(f"{name:<26}{'':>10}{np.mean([rmse(values) for values in several]):>10.4f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
