"""An impulse response C e^(A t) B step by step, where every section has its own pace and its own end.

A is a chain of sections, the fastest first (``_sections.chain``). Left to itself the first section is driven by
nothing, so it forgets at its own rate and then may be dropped: what is left is a chain again, of longer steps. So
poles of any spread take some hundred steps each. What was dropped, what lies behind the last step and what rounding
may have done is bounded by :func:`areas`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from ... import _sections
from ..._sections import FloatArray

__all__ = ["DEGREE", "ROUNDOFF", "Stretch", "areas", "walk"]

# Unit roundoff of double precision.
ROUNDOFF = 2.0**-53
# Steps in units of the fastest pole that is left.
_STEP = 0.5
_FIRST_CHUNK, _LARGEST_CHUNK = 64, 4096
# Taylor polynomials of this degree, and the matrix from their coefficients to Bernstein's.
DEGREE = 10
_BERNSTEIN = np.array([[comb(i, j) / comb(DEGREE, j) for i in range(DEGREE + 1)] for j in range(DEGREE + 1)])
_POWERS = np.arange(DEGREE + 1.0)
# Terms of the series of an integral over one: what is left out is below ROUNDOFF.
_TERMS = 20
# Roundings on the way to a state, in a product of two matrices of size n: n + this, with the doublings' factor of two.
_OPERATIONS = 24


def areas(A: FloatArray, x: FloatArray) -> FloatArray:
    """Bound of the integral of |w_j| over all times, w' = A w from any |w(0)| <= x; linear in x, (n,).

    Section by section: what passes on has at most the area that came in times the gain. For a pair sigma +- j omega,
    |sin(omega t) / omega| <= min(t, 1 / omega).
    """
    out = np.zeros(len(x))
    incoming, i = 0.0, 0
    while i < len(x):
        drive = abs(A[i, i - 1]) * incoming if i else 0.0
        if i + 1 < len(x) and A[i, i + 1] != 0.0:
            damping, r, q = -A[i, i], A[i + 1, i], -A[i, i + 1]
            short = min(1.0 / damping**2, 1.0 / (damping * np.sqrt(q * r)))
            first = x[i] + drive
            out[i] = first / damping + q * x[i + 1] * short
            out[i + 1] = x[i + 1] / damping + r * first * short
            i += 2
        else:
            out[i] = (x[i] + drive) / -A[i, i]
            i += 1
        incoming = float(out[i - 1])
    return out


@dataclass(frozen=True, eq=False)
class Stretch:
    """Intervals of one length on which the same sections are left.

    Parameters
    ----------
    A : (n, n) array
        Of the sections that are left.
    C : (n,) array
    step : float
        Length of each interval.
    starts : (m,) array
        Where they begin.
    left : (m, n) array
        States there.
    """

    A: FloatArray
    C: FloatArray
    step: float
    starts: FloatArray
    left: FloatArray

    @cached_property
    def rows(self) -> FloatArray:
        """From a state to the Taylor coefficients of K over the interval, in units of its length, (DEGREE + 1, n)."""
        found, row = [], self.C
        for j in range(DEGREE + 1):
            found.append(row)
            row = row @ self.A * (self.step / (j + 1))
        return np.array(found)

    @property
    def _integral(self) -> FloatArray:
        """From a state to the integral of K over the interval, (n,)."""
        total, row = self.C, self.C
        for j in range(1, _TERMS):
            row = row @ self.A * (self.step / (j + 1))
            total = total + row
        return self.step * total

    @cached_property
    def _majorant(self) -> FloatArray:
        """e^(|A| step), (n, n)."""
        return np.eye(len(self.C)) + _sections.expm1(np.abs(self.A), self.step)

    @cached_property
    def remainders(self) -> FloatArray:
        """Bound of |K - its Taylor polynomial| on each interval, rounding included, (m,)."""
        row = np.abs(self.rows[-1] @ self.A * (self.step / (DEGREE + 1)))
        row = row + (_OPERATIONS + len(self.C)) * ROUNDOFF * np.abs(self.C)
        return np.abs(self.left) @ (row @ self._majorant)

    @cached_property
    def whole(self) -> tuple[FloatArray, FloatArray]:
        """:meth:`enclosed` of all of each interval."""
        return self.enclosed(None)

    def enclosed(self, share: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """|Integral of K| over the beginning of each interval, and what a change of sign may hide; (m,) each.

        The Taylor polynomial lies between its Bernstein coefficients. ``share`` of the interval: (m,), None for all; of
        shares the integral is rounded up.
        """
        polynomials, rest, length = (
            self.left @ self.rows.T,
            self.remainders,
            np.full(len(self.left), self.step),
        )
        if share is not None:
            polynomials, length = polynomials * share[:, None] ** _POWERS, length * share
            area = length * (np.abs(polynomials @ (1.0 / (_POWERS + 1.0))) + rest)
        else:
            area = np.abs(self.left @ self._integral)
        hull = polynomials @ _BERNSTEIN
        positive = np.maximum(hull.max(axis=1) + rest, 0.0)
        negative = np.maximum(rest - hull.min(axis=1), 0.0)
        return area, 2.0 * length * np.minimum(positive, negative)

    @property
    def roundings(self) -> FloatArray:
        """Bound of what rounding may have done to the states, in all, (n,)."""
        unit = 2.0 * (_OPERATIONS + len(self.C)) * ROUNDOFF
        return unit * np.abs(self.left).sum(axis=0) @ self._majorant.T

    def some(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> Stretch:
        """Only some of the intervals, by an index or a mask."""
        return Stretch(self.A, self.C, self.step, self.starts[which], self.left[which])

    def sorted(self) -> Stretch:
        """In the order of time."""
        return self.some(np.argsort(self.starts))

    def halved(self) -> Stretch:
        """Twice as many, half as long."""
        step = 0.5 * self.step
        middle = self.left + self.left @ _sections.expm1(self.A, step).T
        return Stretch(
            self.A,
            self.C,
            step,
            np.concatenate([self.starts, self.starts + step]),
            np.concatenate([self.left, middle]),
        )


def walk(
    A: FloatArray, B: FloatArray, C: FloatArray, tolerance: float, most: int
) -> tuple[list[Stretch], float, float]:
    """Stretches until all sections have forgotten, what was left out of the integral of |K|, and where the end is.

    Parameters
    ----------
    A, B, C : arrays
        The chain.
    tolerance : float
        What may be left out, relative to the integral.
    most : int
        So many intervals at most.

    Raises
    ------
    ValueError
        If more are needed.
    """
    found: list[Stretch] = []
    x, time, total, left_out, points = B.copy(), 0.0, 0.0, 0.0, 0
    size = _FIRST_CHUNK
    while True:
        step = _STEP / float(np.abs(np.diag(A)).max() if len(A) == 1 else _fastest(A))
        X, end = _states(A, x, step, size)
        stretch = Stretch(A, C, step, np.asarray(time + step * np.arange(size), dtype=float), X)
        found.append(stretch)
        total += float(stretch.whole[0].sum())
        x, time, points = end, time + step * size, points + size
        rest = float(np.abs(C) @ areas(A, np.abs(x)))
        if rest <= tolerance * total:
            return found, left_out + rest, time
        if points > most:
            raise ValueError(
                f"the slowest or least damped pole is still there after {points} steps of the fastest one: too many to "
                "enclose the bound; use method='ellipsoid', or more damping"
            )
        size = min(2 * size, _LARGEST_CHUNK)
        while len(A) > 2 or (len(A) == 2 and A[0, 1] == 0.0):
            first = 2 if A[0, 1] != 0.0 else 1
            alone = np.abs(x)
            alone[first:] = 0.0
            lost = float(np.abs(C) @ areas(A, alone))
            if lost > 0.01 * tolerance * total:
                break
            A, C, x, left_out, size = A[first:, first:], C[first:], x[first:], left_out + lost, _FIRST_CHUNK


def _fastest(A: FloatArray) -> float:
    """Largest |p| of the sections."""
    return float(max(np.abs(np.diag(A)).max(), np.abs(np.diag(A, -1)).max()))


def _states(A: FloatArray, start: FloatArray, step: float, count: int) -> tuple[FloatArray, FloatArray]:
    """e^(A step i) start for i = 0 ... count - 1, shape (count, n), and the one after."""
    X = np.empty((count, len(start)))
    X[0] = start
    once = delta = _sections.expm1(A, step)
    filled = 1
    while filled < count:
        more = min(filled, count - filled)
        X[filled : filled + more] = X[:more] + X[:more] @ delta.T
        filled, delta = filled + more, 2.0 * delta + delta @ delta
    return X, X[-1] + once @ X[-1]
