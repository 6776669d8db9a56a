"""Han's tracking differentiator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _recursion
from .protocol import SearchRange, of_recordings

_ADVICE = "lower r"


@dataclass(frozen=True)
class TrackingDifferentiator:
    """Han's tracking differentiator: x1 follows v time-optimally with |x2'| <= r, and x2 is the estimate.

        x1 <- x1 + h x2,    x2 <- x2 + h fhan(x1 - v, x2, r, h0)

        d = r h0^2,  a0 = h0 x2,  y = (x1 - v) + a0,  a1 = sqrt(d (d + 8 |y|)),
        a2 = a0 + sgn(y) (a1 - d) / 2,  s_y = (sgn(y + d) - sgn(y - d)) / 2,
        a = (a0 + y - a2) s_y + a2,     s_a = (sgn(a + d) - sgn(a - d)) / 2,
        fhan = -r (a / d - sgn(a)) s_a - r sgn(a)

    from x1 = v_0, x2 = 0. Row k is x2 after the step that has seen v_k.

    Parameters
    ----------
    r : float
        Limit of the slope of the estimate, in the unit of v per s^2 (m/s^3).
    h0 : float
        Filter factor as a multiple of the sampling interval: h0 * dt seconds enter fhan. 1 tracks time-optimally;
        more smooths noise and adds lag, one half and less chatters.

    Raises
    ------
    ValueError, TypeError
        If a parameter is not a finite number above zero.

    Notes
    -----
    J. Han, "From PID to Active Disturbance Rejection Control", IEEE Transactions on Industrial Electronics
    56(3), 2009. Time-optimal at h0 = 1. The factor sgn(y) in a2 is easily lost.

    Examples
    --------
    >>> v = 2.0 * np.arange(400.0)[:, None] * 0.01
    >>> TrackingDifferentiator(r=50.0, h0=3.0).estimate(v, 0.01)[-1].round(9).tolist()
    [2.0]
    """

    r: float = 100.0
    h0: float = 5.0

    def __post_init__(self) -> None:
        _signals.number("r", self.r, above=0.0)
        _signals.number("h0", self.h0, above=0.0)

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """Slope limits for robots that move by metres, filter factors from one interval ``dt`` to half a second."""
        longest = 0.5 / _signals.duration("dt", dt)
        return SearchRange("r", 1.0, 1e5), SearchRange("h0", 1.0, min(100.0, max(2.0, longest)))

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Derivative of v (N, n_x) sampled every ``dt`` s, or f_hat of a recording; see :class:`TunableDifferentiator`.

        Raises
        ------
        FloatingPointError
            If the recursion leaves the range of floating-point numbers.
        """
        v, dt = _signals.array("v", v, ("N", "n_x")), _signals.duration("dt", dt)
        channels = v.shape[1]
        start = np.concatenate([v[0], np.zeros(channels)])
        parameters = np.array([dt, self.r, self.h0 * dt])
        return _recursion.run(_block(channels), start, v, parameters, _ADVICE)[:, channels:]


def fhan(x1: ca.SX, x2: ca.SX, r: ca.SX, h0: ca.SX) -> ca.SX:
    """Han's time-optimal feedback of the sampled double integrator (x1 = error, x2 = its slope), by entry."""
    d = r * h0**2
    a0 = h0 * x2
    y = x1 + a0
    a1 = ca.sqrt(d * (d + 8.0 * ca.fabs(y)))
    a2 = a0 + ca.sign(y) * (a1 - d) / 2.0
    near = (ca.sign(y + d) - ca.sign(y - d)) / 2.0
    a = (a0 + y - a2) * near + a2
    linear = (ca.sign(a + d) - ca.sign(a - d)) / 2.0
    return -r * (a / d - ca.sign(a)) * linear - r * ca.sign(a)


@lru_cache(maxsize=32)
def _block(channels: int) -> ca.Function:
    x1, x2 = ca.SX.sym("x1", channels), ca.SX.sym("x2", channels)
    v = ca.SX.sym("v", channels)
    h, r, h0 = ca.SX.sym("h"), ca.SX.sym("r"), ca.SX.sym("h0")
    following = ca.vertcat(x1 + h * x2, x2 + h * fhan(x1 - v, x2, r, h0))
    return _recursion.blocked(
        "tracking_differentiator", ca.vertcat(x1, x2), v, ca.vertcat(h, r, h0), following
    )
