"""Steady-state Kalman filter with a random walk of acceleration."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from .. import _signals
from .._sections import FloatArray
from .protocol import SearchRange, of_recordings


@dataclass(frozen=True)
class KalmanDifferentiator:
    """Steady-state Kalman filter of velocity and acceleration, the acceleration a random walk.

        v' = a,    a' = white noise of density q,    measured v_k + white noise of variance r

    sampled exactly. The gain (K1, K2) is constant, so the estimate is a linear filter of the difference:

        a = K2 (v_k - v_{k-1}) / (1 + (K1 + K2 h - 2) z^-1 + (1 - K1) z^-2)

    from a = 0 at rest on v_0, that is bumplessly.

    Parameters
    ----------
    q : float
        Spectral density of the noise that drives the acceleration, in (m/s^2)^2/s.
    r : float
        Variance of the measurement noise, in (m/s)^2. Only q/r matters.

    Raises
    ------
    ValueError, TypeError
        If a parameter is not a finite number above zero.

    Notes
    -----
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", Wiley
    2001, section 6.2.2 (white-noise acceleration model). Spectral factors: B. D. O. Anderson, J. B. Moore,
    "Optimal Filtering", Prentice Hall 1979, chapter 9.

    Examples
    --------
    >>> v = 2.0 * np.arange(400.0)[:, None] * 0.01
    >>> KalmanDifferentiator(q=100.0, r=1e-4).estimate(v, 0.01)[-1].round(9).tolist()
    [2.0]
    """

    q: float = 100.0
    r: float = 1e-5

    def __post_init__(self) -> None:
        _signals.number("q", self.q, above=0.0)
        _signals.number("r", self.r, above=0.0)

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        """q for bandwidths from 0.5 rad/s to 3/dt with r at its default: only the ratio matters."""
        dt = _signals.duration("dt", dt)
        variance = cls.r
        return (SearchRange("q", 0.5**4 * variance * dt, max(1.0, 3.0 / dt) ** 4 * variance * dt),)

    def gain(self, dt: float) -> tuple[float, float]:
        """Steady-state gain (K1, K2) on the innovation; K2 in 1/s.

        With L = q h^3 / r and S = 2 - z - 1/z the spectrum of the innovation is

            S^2 - L S / 6 + L = S_1^2 D(z) D(1/z),    D = (1 - z_1 z^-1) (1 - z_2 z^-1), |z_i| < 1

        and D is the denominator of the filter: K1 = 1 - z_1 z_2, K2 h = (1 - z_1)(1 - z_2). This is the solution
        of the discrete-time Riccati equation, in closed form.

        Raises
        ------
        ValueError
            If ``dt`` is not above zero, or q h^3 / r leaves the range of floating-point numbers.

        Examples
        --------
        >>> K1, K2 = KalmanDifferentiator(q=1.0, r=1.0).gain(1.0)
        >>> round(K1, 6), round(K2, 6)
        (0.756738, 0.493216)
        """
        dt = _signals.duration("dt", dt)
        ratio = self.q / self.r * dt**3
        if not (math.isfinite(ratio) and ratio > 0.0):
            raise ValueError(
                f"q, r: expected q dt^3 / r finite and > 0, got {ratio} for dt = {dt:g} s; change q / r"
            )
        large = ratio / 12.0 + cmath.sqrt(ratio) * cmath.sqrt(ratio / 144.0 - 1.0)
        y1, y2 = _one_minus_pole(large), _one_minus_pole(ratio / large)
        product = (y1 * y2).real
        return (y1 + y2).real - product, product / dt

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        """Derivative of v (N, n_x) every ``dt`` s, or f_hat of a recording; see :class:`TunableDifferentiator`."""
        v, dt = _signals.array("v", v, ("N", "n_x")), _signals.duration("dt", dt)
        K1, K2 = self.gain(dt)
        rise = np.diff(v, axis=0, prepend=v[:1])
        return np.asarray(lfilter([K2], [1.0, K1 + K2 * dt - 2.0, 1.0 - K1], rise, axis=0))


def _one_minus_pole(s: complex) -> complex:
    """1 - z for the root z of 2 - z - 1/z = s in the unit circle, without cancellation near z = 1."""
    root = cmath.sqrt(s) * cmath.sqrt(s - 4.0)
    outside = max((s + root) / 2.0, (s - root) / 2.0, key=lambda y: abs(1.0 - y))
    return s / outside
