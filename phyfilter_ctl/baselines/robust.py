"""Uniform robust exact differentiator."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from . import _checks, _recursion
from .protocol import SearchRange

_ADVICE = "raise substeps, or lower k1, k2 or mu"


@dataclass(frozen=True)
class RobustDifferentiator:
    """Uniform robust exact differentiator: exact without noise, after a time that no initial error exceeds.

        z0' = z1 - k1 (|e|^(1/2) + mu |e|^(3/2)) sgn(e),
        z1' =    - k2 (sgn(e) / 2 + 2 mu e + 3/2 mu^2 e^2 sgn(e)),    e = z0 - v

    by forward Euler from z0 = v_0, z1 = 0. Row k is z1 after the step that has seen v_k.

    Parameters
    ----------
    k1, k2 : float
        Gains. For |v''| <= L the estimate converges where k1 > 2 sqrt(L) and k2 > 2 L (sufficient), k1 in
        (m/s^3)^(1/2), k2 in m/s^3 for v in m/s.
    mu : float
        Weight of the terms that pull large errors in, in s/m.
    substeps : int
        Euler steps in a sampling interval, v running straight from the sample before to this one. More of
        them allow larger gains and chatter less.

    Raises
    ------
    ValueError, TypeError
        If a gain is not a finite number above zero or ``substeps`` not a whole number of at least 1.

    Notes
    -----
    E. Cruz-Zavala, J. A. Moreno, L. Fridman, "Uniform robust exact differentiator", IEEE Transactions on
    Automatic Control 56(11), 2011; bounds of its convergence time: R. Seeber, H. Haimovich, M. Horn,
    L. Fridman, H. De Battista, "Robust exact differentiators with predefined convergence time", Automatica 134,
    2021.
    Forward Euler keeps the uniform convergence only while k1 mu |e|^(1/2) dt / substeps stays below about 1.

    Examples
    --------
    >>> v = 2.0 * np.arange(2000.0)[:, None] * 0.002
    >>> RobustDifferentiator(k1=5.0, k2=10.0, mu=1.0, substeps=4).estimate(v, 0.002)[-1].round(2).tolist()
    [2.0]
    """

    k1: float = 6.0
    k2: float = 20.0
    _: KW_ONLY
    mu: float = 1.0
    substeps: int = 1

    def __post_init__(self) -> None:
        _checks.positive("k1", self.k1)
        _checks.positive("k2", self.k2)
        _checks.positive("mu", self.mu)
        object.__setattr__(self, "substeps", _checks.count("substeps", self.substeps))

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """Gains for robots that move by metres, whatever ``dt``; ``substeps`` is not sought.

        On noisy data the least RMSE may lie at a large ``mu`` with small ``k1`` and ``k2``, where the terms that
        make the estimate exact without noise are gone.
        """
        _checks.interval(dt)
        return SearchRange("k1", 0.1, 100.0), SearchRange("k2", 0.1, 3000.0), SearchRange("mu", 1e-2, 1e3)

    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Acceleration of v (N, n_x) sampled every ``dt`` seconds; see :class:`Differentiator`.

        Raises
        ------
        FloatingPointError
            If forward Euler diverges; the message says what to change.
        """
        v, dt = _checks.samples("v", v), _checks.interval(dt)
        return self._states(v, dt, v[0], np.zeros_like(v[0]))[1]

    def _states(
        self, v: FloatArray, dt: float, z0: FloatArray, z1: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """z0 and z1 after every sample, from a start of one's own."""
        channels = v.shape[1]
        start = np.concatenate([z0, z1, v[0]])
        parameters = np.array([dt / self.substeps, self.k1, self.k2, self.mu])
        states = _recursion.run(_block(channels, self.substeps), start, v, parameters, _ADVICE)
        return states[:, :channels], states[:, channels : 2 * channels]


@lru_cache(maxsize=32)
def _block(channels: int, substeps: int) -> ca.Function:
    z0_before, z1_before = ca.SX.sym("z0", channels), ca.SX.sym("z1", channels)
    before, v = ca.SX.sym("before", channels), ca.SX.sym("v", channels)
    h, k1, k2, mu = ca.SX.sym("h"), ca.SX.sym("k1"), ca.SX.sym("k2"), ca.SX.sym("mu")
    z0, z1 = z0_before, z1_before
    for j in range(1, substeps + 1):
        e = z0 - (v + (j - substeps) / substeps * (v - before))
        size, side = ca.fabs(e), ca.sign(e)
        slope0 = z1 - k1 * ca.sqrt(size) * (1.0 + mu * size) * side
        slope1 = -k2 * (side / 2.0 + 2.0 * mu * e + 1.5 * mu**2 * size * e)
        z0, z1 = z0 + h * slope0, z1 + h * slope1
    state = ca.vertcat(z0_before, z1_before, before)
    return _recursion.blocked(
        "robust_differentiator", state, v, ca.vertcat(h, k1, k2, mu), ca.vertcat(z0, z1, v)
    )
