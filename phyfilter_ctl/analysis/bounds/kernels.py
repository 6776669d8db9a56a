"""Impulse responses from what is bounded to the error, and the certified integral of their absolute value.

The largest output that an input bounded by 1 can force is the L1 norm of the impulse response, its peak-to-peak gain;
for vectors in the 2-norm as well, where all channels share the kernel. The integral is enclosed from both sides:

* below: sum |S(t_{i+1}) - S(t_i)| with the antiderivative S, for any partition;
* above: the same plus what a change of sign may hide in an interval, from the Bernstein coefficients of K's Taylor
  polynomial there, plus a bound of the tail. Remainder and tail come from V = x' P x, which falls at least as
  exp(-2 beta t).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from ... import _sections
from ..._sections import FloatArray
from ...filter import PhyFilter

__all__ = ["Certificate", "Kernel", "error_kernel", "estimate_kernel", "noise_kernel"]

# Width to which a bound is enclosed, relative; the promise is 1e-6.
_GAP = 2e-7
# First grid, in units of the fastest pole; and the most points before the enclosure is left wider than _GAP.
_FIRST_STEP = 0.5
_MOST_POINTS = 2_000_000
# Knots of an envelope over time, whose excess over the exact one is some 1e-4.
_ENVELOPE_POINTS = 4001
# Taylor polynomials of this degree, and the matrix from their coefficients to Bernstein's.
_DEGREE = 10
_BERNSTEIN = np.array(
    [[comb(i, j) / comb(_DEGREE, j) for i in range(_DEGREE + 1)] for j in range(_DEGREE + 1)]
)


class Certificate(NamedTuple):
    """What is known of an integral: it lies between ``lower`` and ``upper``."""

    lower: float
    upper: float
    tail: float  # part of ``upper`` that stands for all times after the horizon
    horizon: float  # seconds
    points: int

    @property
    def gap(self) -> float:
        """(upper - lower) / upper."""
        return (self.upper - self.lower) / self.upper if self.upper else 0.0


@dataclass(frozen=True, eq=False)
class Kernel:
    """gain * (direct * delta(t) + C e^(A t) B) with t in units of ``unit`` seconds.

    Parameters
    ----------
    A : (n, n) array
    B, C : (n,) arrays
    direct, gain, unit : float
    numerator : (n,) array
        Ascending coefficients of C (s - A)^-1 B over those of the scaled D.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    direct: float
    gain: float
    unit: float
    numerator: FloatArray

    @cached_property
    def _storage(self) -> tuple[FloatArray, float]:
        """P and beta with d/dt x' P x <= -2 beta x' P x."""
        beta = -0.5 * float(np.linalg.eigvals(self.A).real.max())
        n = len(self.A)
        shifted = self.A + beta * np.eye(n)
        return np.asarray(solve_continuous_lyapunov(shifted.T, -np.eye(n))), beta

    def _gain_of_storage(self, row: FloatArray) -> float:
        """Largest |row x| over V(x) <= 1."""
        P, _ = self._storage
        return float(np.sqrt(row @ np.linalg.solve(P, row)))

    def states(self, step: float, count: int) -> FloatArray:
        """e^(A step i) B for i = 0 ... count - 1, shape (count, n); step in ``unit`` seconds."""
        X = np.empty((count, len(self.B)))
        X[0] = self.B
        filled, delta = 1, _sections.expm1(self.A, step)
        while filled < count:
            more = min(filled, count - filled)
            X[filled : filled + more] = X[:more] + X[:more] @ delta.T
            filled, delta = filled + more, 2.0 * delta + delta @ delta
        return X

    @cached_property
    def _enclosed(self) -> tuple[Certificate, FloatArray]:
        P, beta = self._storage
        tail_gain = self._gain_of_storage(self.C) / beta
        to_integral = np.linalg.solve(self.A.T, self.C)
        step = _FIRST_STEP / float(np.abs(np.linalg.eigvals(self.A)).max())
        count = 2 + int(10.0 / (beta * step))
        if count > _MOST_POINTS:
            raise ValueError(
                f"the slowest pole decays over {count:.1e} steps of the fastest one: too many to enclose the bound; "
                "use method='ellipsoid', or place the poles closer together or further from the axis"
            )
        while True:
            X = self.states(step, count)
            total = float(np.abs(np.diff(X @ to_integral)).sum())
            tail = tail_gain * float(np.sqrt(max(X[-1] @ P @ X[-1], 0.0)))
            if tail <= 0.1 * _GAP * total or 2 * count > _MOST_POINTS:
                break
            count *= 2
        horizon, points = step * (count - 1), count
        left, starts = X[:-1], step * np.arange(count - 1)
        below = above = 0.0
        while True:
            delta = _sections.expm1(self.A, step)
            area = np.abs(left @ (delta.T @ to_integral))
            excess = self._possible_excess(left, step)
            # What a sign change may hide: final where it is negligible, else the interval is halved.
            final = excess <= 0.1 * _GAP * max(total, 1e-300) / count
            below += float(area[final].sum())
            above += float((area + excess)[final].sum())
            left, starts, area, excess = left[~final], starts[~final], area[~final], excess[~final]
            if above + float((area + excess).sum()) - below - float(area.sum()) <= 0.5 * _GAP * total:
                break
            if points > _MOST_POINTS or len(left) > _MOST_POINTS:
                break
            step *= 0.5
            middle = left + left @ _sections.expm1(self.A, step).T
            left, starts = np.concatenate([left, middle]), np.concatenate([starts, starts + step])
            points += len(middle)
        ends = left + left @ _sections.expm1(self.A, step).T
        changes = (left @ self.C) * (ends @ self.C) < 0.0
        switches = np.sort(starts[changes] + 0.5 * step) * self.unit
        below, above = below + float(area.sum()), above + float((area + excess).sum()) + tail
        scale, direct = abs(self.gain), abs(self.direct)
        certificate = Certificate(
            scale * (direct + below), scale * (direct + above), scale * tail, horizon * self.unit, points
        )
        return certificate, np.asarray(switches, dtype=float)

    def _possible_excess(self, left: FloatArray, step: float) -> FloatArray:
        """Bound of integral |K| - |integral K| over [0, step] from each of the states (N, n).

        The Taylor polynomial of K there lies between its Bernstein coefficients; the remainder is bounded too.
        """
        P, _ = self._storage
        rows, row = [], self.C
        for j in range(_DEGREE + 1):
            rows.append(row)
            row = row @ self.A * (step / (j + 1))
        hull = left @ (np.array(rows).T @ _BERNSTEIN)
        size = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", left, P, left), 0.0))
        rest = self._gain_of_storage(row) * size
        positive = np.maximum(hull.max(axis=1) + rest, 0.0)
        negative = np.maximum(rest - hull.min(axis=1), 0.0)
        return 2.0 * step * np.minimum(positive, negative)

    @property
    def l1(self) -> Certificate:
        """Integral of |K| over all times, the direct part included."""
        return self._enclosed[0]

    @property
    def switches(self) -> FloatArray:
        """Times in seconds at which K changes its sign."""
        return self._enclosed[1]

    def at(self, times: FloatArray) -> FloatArray:
        """K without its direct part, shape (N,), at times in seconds."""
        delta = _sections.expm1(self.A, times / self.unit)
        return self.gain / self.unit * (self.B + delta @ self.B) @ self.C

    def running(self, times: FloatArray) -> FloatArray:
        """Bound of the integral of |K| from 0 to each of the times in seconds, the direct part included, (N,)."""
        certificate = self.l1
        grid = np.linspace(0.0, certificate.horizon, _ENVELOPE_POINTS)
        knots = np.unique(np.concatenate([grid, np.minimum(times, certificate.horizon)])) / self.unit
        X = self.B + _sections.expm1(self.A, knots) @ self.B
        pieces = np.abs(np.diff(X @ np.linalg.solve(self.A.T, self.C)))
        pieces += self._possible_excess(X[:-1], float(np.diff(knots).max()))
        sums = np.concatenate([[0.0], np.cumsum(pieces)])
        inside = sums[np.minimum(np.searchsorted(knots, times / self.unit), len(knots) - 1)]
        return np.minimum(abs(self.gain) * (abs(self.direct) + inside), certificate.upper)


def _scaled(filter: PhyFilter) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Speed w, poles / w, and a, b, c (c_n = 1 included) in powers of s / w."""
    w = float(np.exp(np.mean(np.log(np.abs(filter.poles)))))
    powers = w ** np.arange(filter.order, 0, -1.0)
    return w, filter.a / powers, filter.b / powers, np.append(filter.error_numerator[:-1] / powers, 1.0)


def _kernel(
    filter: PhyFilter, w: float, a: FloatArray, numerator: FloatArray, direct: float, gain: float
) -> Kernel:
    poles = filter.poles / w
    A, equilibrium = _sections.chain(poles)
    padded = np.zeros(filter.order)
    padded[: len(numerator)] = numerator
    C = _sections.chain_output(poles, a, padded)
    return Kernel(A, -A @ equilibrium, C, direct, gain, 1.0 / w, padded)


def error_kernel(filter: PhyFilter, derivative: int) -> Kernel:
    """(1 - F) / s^k: from the k-th derivative of the residual to the error."""
    w, a, b, c = _scaled(filter)
    if derivative == 0:
        return _kernel(filter, w, a, -b, 1.0, 1.0)
    return _kernel(filter, w, a, c[derivative:], 0.0, w**-derivative)


def estimate_kernel(filter: PhyFilter) -> Kernel:
    """F: from an error of the residual to the estimate."""
    w, a, b, _ = _scaled(filter)
    return _kernel(filter, w, a, b, 0.0, 1.0)


def noise_kernel(filter: PhyFilter) -> Kernel:
    """s F: from noise of M x to the estimate."""
    w, a, b, _ = _scaled(filter)
    numerator = np.concatenate([[0.0], b[:-1]]) - b[-1] * a
    return _kernel(filter, w, a, numerator, float(b[-1]), w)
