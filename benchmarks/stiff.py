"""Stiff diagrams beside SciPy's LSODA: time and error over tolerances, and the time for equal errors.

Van der Pol's oscillator (mu = 1000, two of its jumps) and Robertson's reaction (to 1e11 s). Both integrators get the
equations of the same diagram, LSODA as a Python function as its users write it. The reference is the stiff method at
its tightest; that it is right, tests/simulation/test_stiff.py shows by published values. Times are the least of some
runs, the making of functions left out; the ratio at equal error is read off the lines between tolerances in log-log
scales.

    python benchmarks/stiff.py [--quick] [--limit 3]

Exits 1 where van der Pol's oscillator takes longer than ``limit`` times LSODA at equal error.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import control as ct
import numpy as np
from scipy.integrate import solve_ivp

import phyfilter_ctl as pf

Slope = Callable[[float, np.ndarray], Sequence[float]]


def van_der_pol(t: float, x: np.ndarray) -> list[float]:
    return [x[1], 1000.0 * (1.0 - x[0] ** 2) * x[1] - x[0]]


def robertson(t: float, x: np.ndarray) -> list[float]:
    slow, quick, gone = 0.04 * x[0], 1e4 * x[1] * x[2], 3e7 * x[1] ** 2
    return [quick - slow, slow - quick - gone, gone]


# Equations, start, end in s, scales of the states.
PROBLEMS: dict[str, tuple[Slope, list[float], float, list[float]]] = {
    "van der Pol": (van_der_pol, [2.0, 0.0], 2000.0, [1.0, 1.0]),
    "Robertson": (robertson, [1.0, 0.0, 0.0], 1e11, [1e-7, 1e-13, 1.0]),
}


def least(work: Callable[[], np.ndarray], runs: int) -> tuple[float, np.ndarray]:
    """Seconds of the quickest run, and the state it ends in."""
    seconds, end = np.inf, np.zeros(0)
    for _ in range(runs):
        begin = time.perf_counter()
        end = work()
        seconds = min(seconds, time.perf_counter() - begin)
    return seconds, end


def measured(name: str, runs: int, tolerances: Sequence[float]) -> float:
    """Prints the table of a problem; the time at equal error, LSODA = 1, in the geometric mean."""
    slope, start, end, scales = PROBLEMS[name]
    n = len(start)
    flat = pf.flatten(
        ct.nlsys(lambda t, x, u, p: slope(t, x), None, inputs=1, outputs=n, states=n, name="plant")
    )
    floor = min(scales) * 1e-2

    def ours(rtol: float) -> np.ndarray:
        answer = pf.simulate(
            flat, [0.0, end], 0.0, start, method="auto", backend="vm", rtol=rtol, atol=rtol * floor
        )
        assert answer.success, answer.message
        return np.asarray(answer.states)[:, -1]

    def lsoda(rtol: float) -> np.ndarray:
        return solve_ivp(slope, [0.0, end], start, method="LSODA", rtol=rtol, atol=rtol * floor).y[:, -1]

    exact = ours(1e-12)
    print(f"\n{name}, to {end:g} s\n{'rtol':>8} {'error':>9} {'ms':>8}   {'LSODA: error':>12} {'ms':>8}")
    points: list[list[tuple[float, float]]] = [[], []]
    for rtol in tolerances:
        row = [least(lambda way=way, rtol=rtol: way(rtol), runs) for way in (ours, lsoda)]
        errors = [float(np.abs((x - exact) / scales).max()) for _, x in row]
        for line, error, (seconds, _) in zip(points, errors, row, strict=True):
            line.append((np.log(error), np.log(seconds)))
        print(
            f"{rtol:8.0e} {errors[0]:9.1e} {1e3 * row[0][0]:8.2f}   {errors[1]:12.1e} {1e3 * row[1][0]:8.2f}"
        )
    mine, theirs = (np.array(sorted(line)) for line in points)
    low, high = max(mine[0, 0], theirs[0, 0]), min(mine[-1, 0], theirs[-1, 0])
    at = np.linspace(low, high, 9)
    lines = [np.interp(at, line[:, 0], line[:, 1]) for line in (mine, theirs)]
    ratio = float(np.exp(np.mean(lines[0] - lines[1])))
    print(f"at equal error, {np.exp(high):.0e} to {np.exp(low):.0e}: {ratio:.2f} times LSODA's time")
    return ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="fewer tolerances and runs")
    parser.add_argument("--limit", type=float, default=3.0)
    arguments = parser.parse_args()
    tolerances = (1e-4, 1e-6, 1e-8) if arguments.quick else tuple(10.0 ** -np.arange(3.0, 10.0))
    ratios = {name: measured(name, 2 if arguments.quick else 7, tolerances) for name in PROBLEMS}
    return int(ratios["van der Pol"] > arguments.limit)


if __name__ == "__main__":
    sys.exit(main())
