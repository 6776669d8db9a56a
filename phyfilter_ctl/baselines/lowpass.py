"""Low-pass of the backward difference."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from .. import _signals
from .._sections import FloatArray
from .protocol import SearchRange, of_recordings


@dataclass(frozen=True)
class LowpassDifference:
    """Backward difference through w^n / (s + w)^n, n = 1 or 2, discretised exactly.

        order 1:  a_k = e a_{k-1} + (1 - e) u_k,    u_k = (v_k - v_{k-1}) / h,  e = exp(-w h)
        order 2:  (1 - e z^-1)^2 a = (b1 + b2 z^-1) u,    b1 = 1 - e (1 + w h),  b2 = e (e - 1 + w h)

    u is constant over the interval that ends at k, so the result is the exact response of s w^n / (s + w)^n
    to the samples of v joined by straight lines, started from rest on v_0.

    Parameters
    ----------
    cutoff : float
        Corner frequency w in rad/s: every pole is at -w.
    order : {1, 2}
        Number n of poles.

    Raises
    ------
    ValueError, TypeError
        If ``cutoff`` is not a finite number above zero or ``order`` neither 1 nor 2.

    Notes
    -----
    Zero-order-hold table in K. J. Åström, B. Wittenmark, "Computer-Controlled Systems", Prentice Hall 1997. This is
    PhyFilter at f_theta = g = 0 with all poles at -w.

    Examples
    --------
    >>> v = 2.0 * np.arange(400.0)[:, None] * 0.01
    >>> LowpassDifference(20.0, order=2).estimate(v, 0.01)[-1].round(9).tolist()
    [2.0]
    """

    cutoff: float = 30.0
    order: Literal[1, 2] = 1

    def __post_init__(self) -> None:
        _signals.number("cutoff", self.cutoff, "rad/s", above=0.0)
        if self.order not in (1, 2):
            raise ValueError(f"order: expected 1 or 2, got {self.order!r}")

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """Cutoffs from 0.5 rad/s to 3/dt, where the filter passes nearly everything."""
        return (SearchRange("cutoff", 0.5, max(1.0, 3.0 / _signals.duration("dt", dt))),)

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Derivative of v (N, n_x) every ``dt`` s, or f_hat of a recording; see :class:`TunableDifferentiator`."""
        v, dt = _signals.array("v", v, ("N", "n_x")), _signals.duration("dt", dt)
        u = np.diff(v, axis=0, prepend=v[:1]) / dt
        wh = self.cutoff * dt
        e, one_minus_e = math.exp(-wh), -math.expm1(-wh)
        if self.order == 1:
            return np.asarray(lfilter([one_minus_e], [1.0, -e], u, axis=0))
        b1 = one_minus_e - e * wh
        # Two sections of first order: the square multiplied out loses digits where e is close to 1.
        half = lfilter([one_minus_e], [1.0, -e], u, axis=0)
        return np.asarray(
            lfilter([b1 / one_minus_e, one_minus_e - b1 / one_minus_e], [1.0, -e], half, axis=0)
        )
