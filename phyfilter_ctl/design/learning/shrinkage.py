"""A pull towards the filter of the order below, as data that never were.

    rho sum_k u_k^2 E |(F - F_lower) e|^2,    e white, of unit variance

is what a share rho of further samples would add in which the residual is white, as strong as the measured one, and the
lower order right. It acts where the data say little, most of all at low frequency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from ..._sections import FloatArray
from ...filter.recursion import transition
from ...filter.sampling import Method
from .parametrisation import Chain

__all__ = ["Shrinkage"]


@dataclass(frozen=True, eq=False)
class Shrinkage:
    """Moments of white residuals with the output of a lower order as target.

    Attributes
    ----------
    chain : Chain
    c : (n,) array
        The lower order, F = c xi.
    strength : float
        rho sum_k u_k^2.
    dt : float
    method : {"exact", "matched", "euler", "tustin"}
    """

    chain: Chain
    c: FloatArray
    strength: float
    dt: float
    method: Method

    @property
    def energy(self) -> float:
        """Strength times the variance of the lower order's output."""
        own = self._covariance(np.zeros((1, 1)))
        return self.strength * float(self.c @ own @ self.c)

    @property
    def weight(self) -> float:
        """Samples that it adds: none, the mean stays that of the data."""
        return 0.0

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """See :class:`~phyfilter_ctl.design.learning.sensitivity.Data`."""
        size = len(doubled) - 1
        joint = self._covariance(doubled)
        return self.strength * joint[:size, :size], self.strength * joint[:size, size:] @ self.c

    def _covariance(self, doubled: FloatArray) -> FloatArray:
        """Covariance of [xi; eta] of another chain and the states of this one, one white input for both."""
        n, size = self.chain.order, len(doubled) - 1
        lower = self.chain.doubled[[*range(n), -1]][:, [*range(n), -1]]
        steps = [transition(M, self.method, self.dt) for M in (doubled, lower)]
        E, beta = np.eye(size + n), np.concatenate([steps[0][:-1, -1], steps[1][:-1, -1]])
        E[:size, :size] += steps[0][:-1, :-1]
        E[size:, size:] += steps[1][:-1, :-1]
        return np.asarray(solve_discrete_lyapunov(E, np.outer(beta, beta), method="bilinear"), dtype=float)
