"""Learned filters against a dense sweep of poles on recorded flights.

    python benchmarks/learned_acceleration.py FOLDER [--points 400] [--quick]

FOLDER holds CSV files with the columns t [s], vx vy vz [m/s], ax ay az [m/s^2], one a flight. The flights are ordered
by the 99th percentile of their speed. Two cases: f_theta = 0 on the slower half; and f_theta a network that has learned
from the slower half of those, on the rest of them. In each, the low-pass and the general filter of order 1 to 3 are
learned, and the best of a sweep of n equal poles is found by running the filter, which shares no code with learning.
Learning must be no worse on the flights learned from; the faster half of all flights is scored as well, and nothing is
chosen by it. Exits with 1 where it does not hold. A folder that is not there is not evaluated, which is no pass.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phyfilter_ctl import PhyFilter, Recording, models, split
from phyfilter_ctl.design.learning import learn

ORDERS = (1, 2, 3)
SPAN = 0.07  # s, of the network's window
# Two routes through the same arithmetic; far below what a pole more or less is worth.
ROUNDING = 1e-9
# The sweep ends where one pole is faster than the sampling can show.
SLOWEST, FASTEST = 0.5, 6.0  # rad/s; over the step


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, nargs="?", help="folder of CSV files")
    parser.add_argument("--points", type=int, default=400, help="poles in the sweep (default 400)")
    parser.add_argument("--quick", action="store_true", help="40 poles, a network of little training")
    options = parser.parse_args()
    folder: Path | None = options.folder
    paths = [] if folder is None or not folder.is_dir() else sorted(folder.glob("*.csv"))
    if len(paths) < 4:
        print(f"not evaluated: expected at least 4 CSV files in {folder or 'FOLDER'}, found {len(paths)}")
        return 0
    points = 40 if options.quick else options.points
    slower, faster = split([Recording.read(path) for path in paths])
    holds = compare("f_theta = 0, slower half of all flights", slower, faster, points)
    training, rest, test = with_network(slower, faster, 20 if options.quick else 100)
    holds &= compare(f"f_theta a network of the {training} slowest flights, on the next", rest, test, points)
    print("\nlearned no worse than the best of the sweep:", "holds" if holds else "DOES NOT HOLD")
    return 0 if holds else 1


def with_network(
    slower: Sequence[Recording], faster: Sequence[Recording], iterations: int
) -> tuple[int, list[Recording], list[Recording]]:
    """Flights the network learned from (their number), and the others with its estimate."""
    room = importlib.import_module(f"{models.__name__}.acceleration.differentiator")
    slowest, rest = split(slower)
    stride = room.stride_of(SPAN, slower[0].dt)
    network = room.train(slowest, stride=stride, seed=0, iterations=iterations)
    estimated = [
        [log.with_signals(f_theta=network.predict(log.x)) for log in part] for part in (rest, faster)
    ]
    return len(slowest), estimated[0], estimated[1]


def compare(title: str, train: Sequence[Recording], test: Sequence[Recording], points: int) -> bool:
    """Print the table; return whether learning was nowhere worse."""
    print(
        f"\n{title}: {len(train)} flights to learn from, {len(test)} to test on\n"
        f"{'RMSE in m/s^2':<28}{'training':>10}{'test':>10}{'against sweep':>15}  time and what was found"
    )
    holds = True
    for n in ORDERS:
        begun = time.perf_counter()
        pole, best = swept(train, n, points)
        took = time.perf_counter() - begun
        score = rmse(PhyFilter.from_poles([-pole] * n), test)
        print(
            f"{f'n = {n}, sweep':<28}{best:>10.5f}{score:>10.5f}{'':>15}  {took:.1f} s, {n} x {pole:.4g} rad/s"
        )
        for form in ("lowpass", "general"):
            begun = time.perf_counter()
            result = learn(train, n, shape=form)
            took = time.perf_counter() - begun
            trained, score = rmse(result.filter, train), rmse(result.filter, test)
            holds &= trained <= (1.0 + ROUNDING) * best
            poles = ", ".join(f"{p:.4g}" if p.imag else f"{p.real:.4g}" for p in result.filter.poles)
            print(
                f"{f'n = {n}, learned, {form}':<28}{trained:>10.5f}{score:>10.5f}{trained / best - 1.0:>+15.3%}  "
                f"{took:.1f} s, {poles} rad/s ({result.status})"
            )
    return holds


def swept(logs: Sequence[Recording], n: int, points: int) -> tuple[float, float]:
    """Best of n equal poles in rad/s, and its RMSE."""
    dt = float(np.median([log.dt for log in logs]))
    poles = np.geomspace(SLOWEST, FASTEST / dt, points)
    scores = [rmse(PhyFilter.from_poles([-p] * n), logs) for p in poles]
    k = int(np.argmin(scores))
    return float(poles[k]), scores[k]


def rmse(filter: PhyFilter, logs: Sequence[Recording]) -> float:
    """Over all samples but the first of each flight, by running the filter."""
    squares, count = 0.0, 0
    for log in logs:
        assert log.label is not None
        times = None if log.is_uniform else log.times
        f_hat = np.asarray(filter.sampled(log.dt).run(log.x, log.g, log.f_theta, times=times), dtype=float)
        squares += float(np.sum((f_hat - log.label)[1:] ** 2))
        count += f_hat[1:].size
    return float(np.sqrt(squares / count))


if __name__ == "__main__":
    raise SystemExit(main())
