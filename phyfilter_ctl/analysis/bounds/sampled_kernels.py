"""The same for sampled filters, as they act on a residual that goes on between the samples.

y_k = sum_i h_i u_{k-i}, where u is the mean of gamma over a step, so that for gamma' bounded the kernel is
K_1(tau) = 1 - (s_i on straight lines) with s the step response of the recursion: piecewise linear. Where ramps leave
no error at the samples, that is where K_2(0) = 0 of K_2(tau) = the integral of K_1 from tau on, K_2 is the kernel for
gamma'' bounded, piecewise quadratic, and so on. The integral over tau, not a sum over samples, bounds the error.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgWarning, solve_discrete_lyapunov

from ..._sections import FloatArray
from ...filter import SampledPhyFilter
from .kernels import Certificate
from .walk import ROUNDOFF

__all__ = ["SampledKernels", "StateGains"]

_GAP = 1e-8
_MOST_SAMPLES = 4_000_000
# A filter that forgets faster than by this in a sample is taken to forget by as much: nothing is divided by zero.
_DEADBEAT = 1e-2
# Roundings on the way to a state, in a product of matrices of size n: n + this.
_OPERATIONS = 8
# What stands for zero beside the terms it is a sum of.
_ROUNDING = 1e-9


class StateGains(NamedTuple):
    """Sums of the magnitudes of impulse responses, for each of n states.

    Attributes
    ----------
    of_u, of_x : (n,) arrays
        Largest |w_j| for |u| <= 1, and for samples |x| <= 1 (of M x).
    to_output, changes : (n,) arrays
        To the estimate: from an error added to w_j at every step, and from the differences of one from step to step.
    """

    of_u: FloatArray
    of_x: FloatArray
    to_output: FloatArray
    changes: FloatArray


@dataclass(frozen=True, eq=False)
class SampledKernels:
    """Kernels of one sampled filter.

    Parameters
    ----------
    sampled : SampledPhyFilter
        Of one filter that all channels share.
    """

    sampled: SampledPhyFilter

    @cached_property
    def _series(self) -> tuple[FloatArray, FloatArray, float]:
        """States M^i e (m, n), e the equilibrium, P of V = x' P x, and what V^(1/2) of the states beyond adds up to."""
        dA, equilibrium, C = self.sampled.transition
        M = np.eye(len(dA)) + dA
        radius = float(np.abs(np.linalg.eigvals(M)).max())
        if radius >= 1.0:
            raise ValueError(f"the sampled filter is unstable: a pole of magnitude {radius:.6g}")
        slow = np.sqrt(max(radius, _DEADBEAT))  # V falls at least by this factor squared in a step
        P = _lyapunov(M / slow)
        count = 64 + int(np.ceil(20.0 / -np.log(radius))) if radius > 0.0 else 64
        if count > _MOST_SAMPLES:
            raise ValueError(
                f"the slowest pole decays over {count:.1e} samples: too many to add up; take a longer step, or "
                "the bound of the continuous filter"
            )
        while True:
            X = _powers(M, equilibrium, count)
            rest = float(np.sqrt(max(X[-1] @ P @ X[-1], 0.0)) / (1.0 - slow))
            enough = all(_size(row, P) * rest <= _GAP * np.abs(X @ row).sum() for row in (C, C @ dA))
            if enough or 2 * count > _MOST_SAMPLES:
                return X, P, rest
            count *= 2

    @cached_property
    def _strayed(self) -> float:
        """What rounding in the states X adds up to in V^(1/2), every error going on as V falls."""
        (X, P, _), dA = self._series, self.sampled.transition[0]
        M = np.abs(np.eye(len(dA)) + dA)
        slow = np.sqrt(max(float(np.abs(np.linalg.eigvals(np.eye(len(dA)) + dA)).max()), _DEADBEAT))
        unit = 2.0 * (len(dA) + _OPERATIONS) * ROUNDOFF
        return unit * float(np.abs(X).sum(axis=0) @ M.T @ np.sqrt(np.diag(P))) / (1.0 - slow)

    def _certificate(
        self, total: float, rest: float, size: float, points: int, scale: float = 1.0
    ) -> Certificate:
        """An enclosure of scale times the sum, with ``size`` what a state of V = 1 adds to it."""
        rounding = (
            size * self._strayed
            + (20.0 + len(self.sampled.transition[2]) + np.sqrt(points)) * ROUNDOFF * total
        )
        low, high, tail, rounding = (
            float(scale * v) for v in (max(total - rounding, 0.0), total + rest + rounding, rest, rounding)
        )
        return Certificate(low, high, tail, self.sampled.dt * points, points, rounding)

    @cached_property
    def _impulse(self) -> tuple[FloatArray, float]:
        """Impulse response h_i (m,), and a bound of the sum of the rest."""
        (X, P, rest), (dA, _, C) = self._series, self.sampled.transition
        return -X @ (C @ dA), _size(C @ dA, P) * rest

    @cached_property
    def pieces(self) -> tuple[FloatArray, ...]:
        """K_1, K_2, ... up to the type, each (k + 1, n): times M^i e polynomials of tau/h - i on [i h, (i + 1) h]."""
        dA, _, C = self.sampled.transition
        found, later = [np.stack([C, C @ dA])], np.linalg.inv(-dA)
        for k in range(1, self.sampled.filter.type):
            whole = found[-1] / np.arange(1.0, k + 2.0)[:, None]
            start = self.sampled.dt * whole.sum(axis=0) @ later
            found.append(np.vstack([start, -self.sampled.dt * whole]))
        return tuple(found)

    @property
    def states(self) -> FloatArray:
        """M^i e, (m, n)."""
        return self._series[0]

    @property
    def impulse(self) -> FloatArray:
        """h_i, (m,)."""
        return self._impulse[0]

    @property
    def highest(self) -> int:
        """Highest derivative k of gamma that bounds the error: t^0 ... t^(k - 1) leave none at the samples."""
        if self.sampled.filter.type == 0 or self.sampled.sampling.delay:
            return min(self.sampled.filter.type, 1)
        equilibrium = self.sampled.transition[1]
        for k, rows in enumerate(self.pieces[1:], start=2):
            if abs(rows[0] @ equilibrium) > _ROUNDING * float(np.abs(rows[0]) @ np.abs(equilibrium)):
                return k - 1
        return self.sampled.filter.type

    def at(self, derivative: int, times: FloatArray) -> FloatArray:
        """Kernel from gamma (0: without the direct part) or a derivative of it to the error, (N,); times in seconds."""
        h, delay, X = self.sampled.dt, self.sampled.sampling.delay, self._series[0]
        since = np.maximum(times - delay, 0.0) / h
        step = np.minimum(since.astype(np.intp), len(X) - 1)
        if derivative == 0:
            return np.where(times < delay, 0.0, -self._impulse[0][step] / h)
        rows = X[step] @ self.pieces[derivative - 1].T
        values = (rows * (since - step)[:, None] ** np.arange(rows.shape[1])).sum(axis=1)
        return np.where(times < delay, 1.0, np.where(since < len(X), values, 0.0))

    def error(self, derivative: int) -> Certificate:
        """From gamma (0) or a derivative of it, up to ``highest``, to the error at the samples."""
        h, (X, P, rest) = self.sampled.dt, self._series
        if derivative == 0:
            impulse, beyond = self._impulse
            return self._certificate(1.0 + float(np.abs(impulse).sum()), beyond, self._of_impulse, len(X))
        rows = self.pieces[derivative - 1]
        total = h * _absolute(X[:-1] @ rows.T) + (self.sampled.sampling.delay if derivative == 1 else 0.0)
        size = h * sum(_size(row, P) for row in rows)
        return self._certificate(total, size * rest, size, len(X))

    def estimate(self) -> Certificate:
        """From an error of the residual to the estimate."""
        impulse, beyond = self._impulse
        return self._certificate(float(np.abs(impulse).sum()), beyond, self._of_impulse, len(impulse))

    @cached_property
    def _of_impulse(self) -> float:
        dA, _, C = self.sampled.transition
        return _size(C @ dA, self._series[1])

    def state_gains(self) -> StateGains:
        """From inputs to the states, and from errors of the states to the estimate."""
        (X, P, rest), (_, _, C) = self._series, self.sampled.transition
        sizes = np.array([_size(row, P) for row in np.eye(len(C))])
        impulse = -np.diff(X, axis=0)
        changes = np.abs(np.diff(impulse, axis=0, prepend=0.0 * X[:1])).sum(axis=0) + np.abs(impulse[-1])
        rows, beyond = self._onward(C)
        return StateGains(
            of_u=np.abs(impulse).sum(axis=0) + 2.0 * rest * sizes,
            of_x=(changes + 4.0 * rest * sizes) / self.sampled.dt,
            to_output=np.abs(rows).sum(axis=0) + beyond,
            changes=np.abs(np.diff(rows, axis=0, prepend=0.0 * rows[:1])).sum(axis=0) + 2.0 * beyond,
        )

    def between_states(self) -> FloatArray:
        """From an error added to w_k at every step to w_j, (n, n)."""
        rows = [self._onward(row) for row in np.eye(self.sampled.order)]
        return np.stack([np.abs(found).sum(axis=0) + beyond for found, beyond in rows])

    def _onward(self, row: FloatArray) -> tuple[FloatArray, FloatArray]:
        """row M^i (m, n), and a bound of the sum of the rest from the last one on."""
        (X, P, _), dA = self._series, self.sampled.transition[0]
        M = np.eye(len(dA)) + dA
        slow = np.sqrt(max(float(np.abs(np.linalg.eigvals(M)).max()), _DEADBEAT))
        rows = _powers(M.T, row, len(X))
        return rows, _size(rows[-1], P) * np.sqrt(np.diag(P)) / (1.0 - slow)

    def noise(self) -> Certificate:
        """From noise of M x at the samples to the estimate."""
        impulse, beyond = self._impulse
        total = float(np.abs(np.diff(impulse, prepend=0.0)).sum())
        return self._certificate(
            total, 2.0 * beyond, 2.0 * self._of_impulse, len(impulse), 1.0 / self.sampled.dt
        )


def _size(row: FloatArray, P: FloatArray) -> float:
    """Largest row @ x for x' P x = 1."""
    return float(np.sqrt(row @ np.linalg.solve(P, row)))


def _absolute(polynomials: FloatArray) -> float:
    """Sum of the integrals over [0, 1] of the absolute values of polynomials, ascending coefficients (m, k + 1)."""
    whole = polynomials / np.arange(1.0, polynomials.shape[1] + 1.0)
    totals = np.abs(whole.sum(axis=1))
    # In Bernstein's form coefficients of one sign mean values of one sign.
    k = polynomials.shape[1] - 1
    bernstein = polynomials @ np.array(
        [[comb(i, j) / comb(k, j) for i in range(k + 1)] for j in range(k + 1)]
    )
    for i in np.flatnonzero((bernstein.min(axis=1) < 0.0) & (bernstein.max(axis=1) > 0.0)):
        roots = np.roots(polynomials[i, ::-1])
        ends = np.concatenate([[0.0], np.sort(roots.real[(roots.real > 0.0) & (roots.real < 1.0)]), [1.0]])
        totals[i] = np.abs(np.diff(np.polynomial.polynomial.polyval(ends, np.append(0.0, whole[i])))).sum()
    return float(totals.sum())


def _lyapunov(M: FloatArray) -> FloatArray:
    """P with M' P M - P <= 0."""
    eye = np.eye(len(M))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LinAlgWarning)  # the residual below judges
        P = np.asarray(solve_discrete_lyapunov(M.T, eye))
    if not np.linalg.norm(M.T @ P @ M - P + eye) < 1.0:
        raise ValueError(
            "the states of the sampled filter are too unlike in size for a certificate: its poles swing too often in a "
            "step; sample faster, or take the bound of the continuous filter"
        )
    return P


def _powers(M: FloatArray, start: FloatArray, count: int) -> FloatArray:
    """M^i start for i = 0 ... count - 1, shape (count, n)."""
    X = np.empty((count, len(start)))
    X[0] = start
    filled, power = 1, M
    while filled < count:
        more = min(filled, count - filled)
        X[filled : filled + more] = X[:more] @ power.T
        filled, power = filled + more, power @ power
    return X
