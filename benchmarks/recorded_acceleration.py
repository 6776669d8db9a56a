"""Acceleration from velocity on recorded flights, all methods, over several splits; paired intervals over flights.

    python benchmarks/recorded_acceleration.py FOLDER [--splits 3] [--unseen CHECKOUT] [--seed 0] [--quick]

FOLDER holds CSV files with the columns t [s], vx vy vz [m/s], ax ay az [m/s^2], one a flight. The first split trains on
the slower half (99th percentile of the speed) and tests on the faster; the others draw halves at random. Prints test
RMSE by method, and each over the network and over the best method that has no PhyFilter in it, with a 95 % bootstrap
interval over the test flights: a flight is what is independent. A filter is ahead where that lies below 0. Last all
splits together, every flight with all its errors as a test flight. Of the first split also: where the tuning of a rival
ended at a bound, a FIR of 64 taps fitted to the test flights themselves, which no filter shared by the axes undercuts
there but by a longer memory, and the Wiener filter of the training flights.

CHECKOUT is one of the public repository aerorobotics/neural-swarm. What was fitted in the first split is tested on the
logs of data/training there that FOLDER does not hold under names such as dc21_06_16_2020_swap_sss_cf50_02: those with
no step above three median ones, and whose label, less its mean, correlates with dv/dt by more than 0.9 on every axis. A
folder that is not there is not evaluated, which is no pass.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import models
from phyfilter_ctl.design.learning import learn
from phyfilter_ctl.recording import Recording
from phyfilter_ctl.recording import split as split_recordings

FLOOR = 64
LONGEST_STEP, CORRELATION = 3.01, 0.9
Array = NDArray[np.float64]
experiment, linear, scores, tuning = (
    importlib.import_module(f"{models.__name__}.acceleration.{name}")
    for name in ("experiment", "linear", "scores", "tuning")
)


def halves(logs: Sequence[Recording], split: int) -> tuple[list[Recording], list[Recording]]:
    """Training and test flights: by speed for split 0, else at random."""
    if split == 0:
        slower, faster = split_recordings(logs)
        return list(slower), list(faster)
    order = np.random.default_rng(split).permutation(len(logs))
    return [logs[i] for i in order[: len(logs) // 2]], [logs[i] for i in order[len(logs) // 2 :]]


def unseen(checkout: Path, known: set[str]) -> list[Recording]:
    """Flights of the public repository that are not known: its times are in us, its labels hold gravity."""
    found = []
    for path in sorted(checkout.glob("data/training/datacollection*/*/cf*.csv")):
        series, folder = path.parts[-3:-1]
        name = f"{series.replace('datacollection', 'dc')}_{folder}_{path.stem}"
        if name in known:
            continue
        table = np.loadtxt(path, delimiter=",", skiprows=1, usecols=(0, 4, 5, 6, 7, 8, 9))
        t, v, label = 1e-6 * table[:, 0], table[:, 1:4], table[:, 4:] - table[:, 4:].mean(axis=0)
        step = np.diff(t)
        slope = np.gradient(v, t, axis=0)
        agree = [np.corrcoef(slope[:, i], label[:, i])[0, 1] for i in range(3)]
        if step.max() <= LONGEST_STEP * np.median(step) and min(agree) > CORRELATION:
            found.append(Recording(t, v, label=label, name=name, channels=("vx", "vy", "vz")))
    return found


def table(squares: Mapping[str, Array], training: Mapping[str, float] | None = None) -> None:
    """Print it; ``squares`` (flights, 2) by method."""
    best = scores.best_rival({name: scores.root_mean(values) for name, values in squares.items()})
    print(f"{'RMSE in m/s^2':<26}{'training':>10}{'test':>10}   {'over network':<24}over {best}")
    for name, values in squares.items():
        network, rival = (scores.over(values, squares[other]) for other in ("network", best))
        ahead = "  ahead" if rival.is_ahead and name in scores.OURS else ""
        before = f"{training[name]:>10.4f}" if training else f"{'':>10}"
        print(
            f"{name:<26}{before}{scores.root_mean(values):>10.4f}   {network!s:<24}{rival}{ahead}", flush=True
        )


def limits(
    train: Sequence[Recording], test: Sequence[Recording], messages: Mapping[str, str], taps: int, order: int
) -> None:
    """Print what bounds the rivals' tuning, the FIR and the learned filter."""
    for name, message in messages.items():
        print(f"{name}: {message}")
    print(f"FIR: {taps} taps; 16 have {fir_rmse(train, test, 16):.4f}")
    print(f"FIR of {FLOOR} taps fitted to the test flights: {fir_rmse(test, test, FLOOR):.4f}")
    bare = [log.with_signals(f_theta=None) for log in train]
    floor = learn(bare, order, shape="general").wiener
    assert floor is not None
    low, high = floor.interval
    print(
        f"learned filter, order {order}, over the Wiener filter of the training flights: {floor.ratio:.3f} "
        f"[{low:.3f}, {high:.3f}]; held out, its {len(floor.taps)} taps err {floor.overfit:.3f} times what they do "
        "where they were fitted",
        flush=True,
    )


def fir_rmse(train: Sequence[Recording], test: Sequence[Recording], taps: int) -> float:
    fir = linear.SlopeFIR.fit(train, taps)
    return float(tuning.rmse([fir.estimate(log) for log in test], test))


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of CSV files")
    parser.add_argument(
        "--splits", type=int, default=3, help="halves: by speed, then random ones (default 3)"
    )
    parser.add_argument("--unseen", type=Path, help="checkout of aerorobotics/neural-swarm")
    parser.add_argument("--seed", type=int, default=0, help="of the network's first weights (default 0)")
    parser.add_argument("--quick", action="store_true", help="coarser training and tuning")
    options = parser.parse_args()
    paths = sorted(options.folder.glob("*.csv")) if options.folder.is_dir() else []
    if len(paths) < 2:
        print(f"not evaluated: expected at least 2 CSV files in {options.folder}, found {len(paths)}")
        return 0
    logs = [Recording.read(path) for path in paths]
    effort = experiment.QUICK if options.quick else experiment.Effort()
    pooled: dict[str, dict[str, Array]] = {}
    for split in range(options.splits):
        train, test = halves(logs, split)
        found = experiment.compare(train, test, data="recorded", seed=options.seed, effort=effort)
        squares = found.test_squares
        for name, values in squares.items():
            flights = pooled.setdefault(name, {})
            for log, value in zip(test, values, strict=True):
                flights[log.name] = flights.get(log.name, np.zeros(2)) + value
        print("slower half, faster half" if split == 0 else f"random halves {split}", flush=True)
        table(squares, found.train_rmse)
        if split == 0:
            unsettled = {name: r.message for name, r in found.baselines.items() if r.status != "converged"}
            limits(train, test, unsettled, found.linear.fir.length, found.linear.result.filter.order)
            if options.unseen is not None:
                others = unseen(options.unseen, {path.stem for path in paths})
                print(f"slower half, {len(others)} flights that are not in the folder")
                if others:
                    table(found.tested_on(others).test_squares)
                else:
                    print(f"not evaluated: no such flights in {options.unseen}")
    if options.splits > 1:
        print(f"all splits, {len(pooled['network'])} flights tested")
        table({name: np.array(list(flights.values())) for name, flights in pooled.items()})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
