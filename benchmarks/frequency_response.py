"""Frequency response of state-space systems, timed against control.frequency_response in one run.

    python benchmarks/frequency_response.py            10,000 frequencies, half a minute
    python benchmarks/frequency_response.py --quick    500 frequencies

Prints the median time of both, their ratio beside the ratio required, and the largest difference from one dense solve
per frequency, relative to the peak. Exits with status 1 if an answer is off by more than 1e-9, or, unless --quick, if
a ratio is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.analysis import frequency_response

ACCURACY = 1e-9


class Case(NamedTuple):
    name: str
    system: ct.StateSpace
    ratio: float


def diagonalisable() -> ct.StateSpace:
    """60 states, 12 x 12, dense, distinct poles."""
    rng = np.random.default_rng(1)
    A = 3.0 * rng.standard_normal((60, 60))
    A -= (np.max(np.linalg.eigvals(A).real) + 2.0) * np.eye(60)
    return ct.StateSpace(A, rng.standard_normal((60, 12)), rng.standard_normal((12, 60)), np.zeros((12, 12)))


def repeated() -> ct.StateSpace:
    """60 states, 12 x 12: twelve Jordan blocks of five equal poles behind a dense change of state."""
    rng = np.random.default_rng(2)
    J = block_diag(*[np.diag([-5.0 - 3.0 * k] * 5) + 5.0 * np.eye(5, k=1) for k in range(12)])
    S = np.linalg.qr(rng.standard_normal((60, 60)))[0] * np.geomspace(1.0, 10.0, 60)
    inputs, outputs = rng.standard_normal((60, 12)), rng.standard_normal((12, 60))
    A = np.asarray(S @ np.asarray(J) @ np.linalg.inv(S))
    return ct.StateSpace(A, inputs, outputs, np.zeros((12, 12)))


def cases() -> list[Case]:
    return [
        Case("filter, n = 6, equal poles, 3 inputs", PhyFilter.from_poles([-20.0] * 6).state_space(1), 10.0),
        Case("12 channels share n = 5, 36 inputs", PhyFilter.from_poles([-20.0] * 5).state_space(12), 2.0),
        Case("60 states, 12 x 12, distinct poles", diagonalisable(), 2.0),
        Case("60 states, 12 x 12, repeated poles", repeated(), 2.0),
    ]


def median_time(call: Callable[[], object], runs: int) -> float:
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def direct(system: ct.StateSpace, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(N, p, m) by one dense solve per frequency."""
    A, B, C, D = (np.asarray(matrix) for matrix in (system.A, system.B, system.C, system.D))
    resolvent = 1j * omega[:, None, None] * np.eye(len(A)) - A
    states = np.linalg.solve(resolvent, np.broadcast_to(B, (len(omega), *B.shape)))
    return np.asarray(C @ states + D, dtype=np.complex128)


def error(system: ct.StateSpace, omega: NDArray[np.float64]) -> float:
    """Largest difference from direct solves relative to their peak."""
    values = frequency_response(system, omega).frdata
    largest = peak = 0.0
    for first in range(0, len(omega), 256):
        part = slice(first, first + 256)
        exact = direct(system, omega[part])
        peak = max(peak, float(np.max(np.abs(exact))))
        largest = max(largest, float(np.max(np.abs(values[:, :, part] - exact.transpose(1, 2, 0)))))
    return largest / peak


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="500 frequencies; ratios are shown, not required"
    )
    quick = parser.parse_args(arguments).quick
    omega = np.geomspace(1e-1, 1e4, 500 if quick else 10_000)
    print(f"{len(omega)} frequencies, median times")
    print(f"{'system':<38}{'control':>10}{'here':>10}{'ratio':>8}{'needed':>8}{'error':>10}")
    failed = False
    for name, system, needed in cases():
        theirs = median_time(lambda system=system: ct.frequency_response(system, omega), 3)
        ours = median_time(lambda system=system: frequency_response(system, omega), 7)
        ratio, off = theirs / ours, error(system, omega)
        failed |= off > ACCURACY or (ratio < needed and not quick)
        print(
            f"{name:<38}{1e3 * theirs:>7.1f} ms{1e3 * ours:>7.1f} ms{ratio:>8.1f}{needed:>8.1f}{off:>10.1e}",
            flush=True,
        )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
