"""The same for sampled filters, as they act on a residual that goes on between the samples.

y_k = sum_i h_i u_{k-i}, where u is the mean of gamma over a step, so that for gamma' bounded the kernel is
K(tau) = 1 - (s_i on straight lines) with s the step response of the recursion: piecewise linear. Its integral over
tau, not a sum over samples, bounds the error.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgWarning, solve_discrete_lyapunov

from ..._sections import FloatArray
from ...filter import SampledPhyFilter
from .kernels import Certificate

__all__ = ["SampledKernels"]

_GAP = 1e-8
_MOST_SAMPLES = 4_000_000
# A filter that forgets faster than by this in a sample is taken to forget by as much: nothing is divided by zero.
_DEADBEAT = 1e-2


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
        """Impulse response h_i and error step response 1 - s_i with s_0 = 0, (m,) each; bound of the rest of both."""
        dA, equilibrium, C = self.sampled.transition
        M = np.eye(len(dA)) + dA
        radius = float(np.abs(np.linalg.eigvals(M)).max())
        if radius >= 1.0:
            raise ValueError(f"the sampled filter is unstable: a pole of magnitude {radius:.6g}")
        slow = np.sqrt(max(radius, _DEADBEAT))  # V = x' P x falls at least by this factor squared in a step
        P = _lyapunov(M / slow)
        count = 64 + int(np.ceil(20.0 / -np.log(radius))) if radius > 0.0 else 64
        if count > _MOST_SAMPLES:
            raise ValueError(
                f"the slowest pole decays over {count:.1e} samples: too many to add up; take a longer step, or "
                "the bound of the continuous filter"
            )
        while True:
            X = _powers(M, -equilibrium, count)
            rest = np.sqrt(max(X[-1] @ P @ X[-1], 0.0)) / (1.0 - slow)
            step, impulse = X @ C, X @ (dA.T @ C)
            rest_step = float(np.sqrt(C @ np.linalg.solve(P, C)) * rest)
            row = C @ dA
            rest_impulse = float(np.sqrt(row @ np.linalg.solve(P, row)) * rest)
            enough = rest_step <= _GAP * np.abs(step).sum() and rest_impulse <= _GAP * np.abs(impulse).sum()
            if enough or 2 * count > _MOST_SAMPLES:
                break
            count *= 2
        # s_i = F(0) + C M^i (-equilibrium), so 1 - s_i loses no digits where F(0) = 1.
        miss = self.sampled.filter.error_numerator[0] / self.sampled.filter.a[0]
        return impulse, miss - step, max(rest_step, rest_impulse)

    def error(self, derivative: int) -> Certificate:
        """From gamma (0) or its first derivative (1) to the error at the samples."""
        h, (impulse, distance, rest) = self.sampled.dt, self._series
        if derivative == 0:
            total = 1.0 + float(np.abs(impulse).sum())
            return Certificate(total, total + rest, rest, h * len(impulse), len(impulse))
        a, b = np.abs(distance[:-1]), np.abs(distance[1:])
        same = distance[:-1] * distance[1:] >= 0.0
        with np.errstate(invalid="ignore"):
            pieces = np.where(same, 0.5 * (a + b), 0.5 * (a**2 + b**2) / np.where(same, 1.0, a + b))
        total = h * float(pieces.sum()) + self.sampled.sampling.delay
        return Certificate(total, total + h * rest, h * rest, h * len(impulse), len(impulse))

    def estimate(self) -> Certificate:
        """From an error of the residual to the estimate."""
        impulse, _, rest = self._series
        total = float(np.abs(impulse).sum())
        return Certificate(total, total + rest, rest, self.sampled.dt * len(impulse), len(impulse))

    def noise(self) -> Certificate:
        """From noise of M x at the samples to the estimate."""
        impulse, _, rest = self._series
        total = float(np.abs(np.diff(impulse, prepend=0.0)).sum()) / self.sampled.dt
        rest = 2.0 * rest / self.sampled.dt
        return Certificate(total, total + rest, rest, self.sampled.dt * len(impulse), len(impulse))


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
