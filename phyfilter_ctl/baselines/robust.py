"""Uniform robust exact differentiator."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _recursion
from .protocol import SearchRange, of_recordings

_ADVICE = "scale v"
# From an upper bound at most four times too large; after so many, over coefficients of 24 decades, it is at rounding.
_NEWTON_STEPS = 6


@dataclass(frozen=True)
class RobustDifferentiator:
    """Uniform robust exact differentiator: exact without noise, after a time that no initial error exceeds.

        z0' = z1 - k1 (|e|^(1/2) + mu |e|^(3/2)) sgn(e),
        z1' =    - k2 (sgn(e) / 2 + 2 mu e + 3/2 mu^2 e^2 sgn(e)),    e = z0 - v

    by backward Euler from z0 = v_0, z1 = 0. Row k is z1 after the step that ends with v_k.

    Parameters
    ----------
    k1, k2 : float
        Gains. For |v''| <= L the estimate converges where k1 > 2 sqrt(L) and k2 > 2 L (sufficient), k1 in
        (m/s^3)^(1/2), k2 in m/s^3 for v in m/s.
    mu : float
        Weight of the terms that pull large errors in, in s/m.

    Raises
    ------
    ValueError, TypeError
        If a gain is not a finite number above zero.

    Notes
    -----
    E. Cruz-Zavala, J. A. Moreno, L. Fridman, "Uniform robust exact differentiator", IEEE Transactions on
    Automatic Control 56(11), 2011; bounds of its convergence time: R. Seeber, H. Haimovich, M. Horn,
    L. Fridman, H. De Battista, "Robust exact differentiators with predefined convergence time", Automatica 134,
    2021.
    Forward Euler diverges where k1 mu |e|^(1/2) dt is large, on flights faster than those it was tuned on. Backward
    Euler holds for all gains and errors, and does not chatter: B. Brogliato, A. Polyakov, D. Efimov, "The implicit
    discretization of the supertwisting sliding-mode control algorithm", IEEE Transactions on Automatic Control 65(8),
    2020. Where |v_k - 2 v_(k-1) + v_(k-2)| stays below k2 dt^2 / 2 it ends on the backward difference.

    Examples
    --------
    >>> v = 2.0 * np.arange(2000.0)[:, None] * 0.002
    >>> RobustDifferentiator(k1=5.0, k2=10.0, mu=1.0).estimate(v, 0.002)[-1].round(9).tolist()
    [2.0]
    """

    k1: float = 6.0
    k2: float = 20.0
    _: KW_ONLY
    mu: float = 1.0

    def __post_init__(self) -> None:
        _signals.number("k1", self.k1, above=0.0)
        _signals.number("k2", self.k2, above=0.0)
        _signals.number("mu", self.mu, above=0.0)

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """Gains for robots that move by metres, whatever ``dt``.

        On noisy data the least RMSE may lie at a large ``mu`` with small ``k1`` and ``k2``, where the terms that
        make the estimate exact without noise are gone. Then only k1 mu and k2 mu^2 count: the upper end of ``mu`` holds
        nothing back.
        """
        _signals.duration("dt", dt)
        return SearchRange("k1", 1e-3, 100.0), SearchRange("k2", 1e-4, 3000.0), SearchRange("mu", 1e-2, 1e5)

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Derivative of v (N, n_x) sampled every ``dt`` s, or f_hat of a recording; see :class:`TunableDifferentiator`.

        Raises
        ------
        FloatingPointError
            If v comes near the range of floating-point numbers.
        """
        v, dt = _signals.array("v", v, ("N", "n_x")), _signals.duration("dt", dt)
        return self._states(v, dt, v[0], np.zeros_like(v[0]))[1]

    def _states(
        self, v: FloatArray, dt: float, z0: FloatArray, z1: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """z0 and z1 after every sample, from a start of one's own."""
        channels = v.shape[1]
        parameters = np.array([dt, self.k1, self.k2, self.mu])
        states = _recursion.run(_block(channels), np.concatenate([z0, z1]), v, parameters, _ADVICE)
        return states[:, :channels], states[:, channels:]


@lru_cache(maxsize=32)
def _block(channels: int) -> ca.Function:
    z0, z1 = ca.SX.sym("z0", channels), ca.SX.sym("z1", channels)
    v = ca.SX.sym("v", channels)
    h, k1, k2, mu = ca.SX.sym("h"), ca.SX.sym("k1"), ca.SX.sym("k2"), ca.SX.sym("mu")
    # With e = y^2 sgn(ahead) after the step, the two equations are one polynomial in y >= 0 that rises from its value
    # at 0. Where that is positive, sgn(e) is what lies between -1 and 1 and makes e = 0: the estimate slides.
    ahead = z0 + h * z1 - v
    side, size = ca.sign(ahead), ca.fabs(ahead)
    p1, p2, p3, p4 = h * k1, 1.0 + 2.0 * mu * h**2 * k2, h * k1 * mu, 1.5 * (mu * h) ** 2 * k2
    target = ca.fmax(size - 0.5 * h**2 * k2, 0.0)
    # Each term alone bounds y from above, and Newton's method comes down from there.
    alone = [target / p1, ca.sqrt(target / p2), (target / p3) ** (1.0 / 3.0), ca.sqrt(ca.sqrt(target / p4))]
    y = ca.fmin(ca.fmin(alone[0], alone[1]), ca.fmin(alone[2], alone[3]))
    for _ in range(_NEWTON_STEPS):
        value = (((p4 * y + p3) * y + p2) * y + p1) * y - target
        y -= value / (((4.0 * p4 * y + 3.0 * p3) * y + 2.0 * p2) * y + p1)
    e = y**2
    pull = ca.fmin(0.5, size / (h**2 * k2)) + 2.0 * mu * e + 1.5 * (mu * e) ** 2
    following = ca.vertcat(v + side * e, z1 - h * k2 * side * pull)
    return _recursion.blocked(
        "robust_differentiator", ca.vertcat(z0, z1), v, ca.vertcat(h, k1, k2, mu), following
    )
