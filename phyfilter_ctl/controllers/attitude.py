"""Attitude error with tilt and heading apart, and gains for an attitude loop with motor lag and delay."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np
from scipy.optimize import brentq

from .. import _signals
from ..plants.algebra import Array, quaternion_product, stack, where

__all__ = ["AttitudeGains", "attitude_error", "attitude_gains"]

# Square of the cosine of half a tilt error that cannot be told from a half turn.
_HALF_TURN = 1e-18
# In units of 1/lag: frequencies on which the least distance is looked for, and rate gains, of which the first that is
# too high counts, since the distance grows again beyond the limit of stability.
_GRID = np.geomspace(1e-3, 1e2, 2000)
_GAINS = np.geomspace(1e-2, 4.0, 40)


def attitude_error(q: Array, wanted: Array) -> Array:
    """Rotation from an attitude to a wanted one, about the body's axes: tilt first, then heading, each by itself.

        conj(q) wanted = (cos(a/2), sin(a/2) n_x, sin(a/2) n_y, 0) (cos(c/2), 0, 0, sin(c/2))
        error = 2 (sin(a/2) n_x, sin(a/2) n_y, sin(c/2)),      -pi <= c <= pi

    Parameters
    ----------
    q, wanted : (4,) array
        Unit quaternions from the body to the world frame.

    Returns
    -------
    (3,) array
        rad, for small angles: x and y turn the body's z axis to the wanted one the shortest way, whatever the heading
        is; z is the heading that is then missing. Both signs of a quaternion give the same error. For z axes that are
        opposite, where every way is the shortest, it turns about x.

    Notes
    -----
    D. Brescianini, R. D'Andrea, "Tilt-prioritized quadrocopter attitude control", IEEE Transactions on Control Systems
    Technology 28(2), 2020.

    Examples
    --------
    >>> level, rolled = np.array([1.0, 0.0, 0.0, 0.0]), np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])
    >>> attitude_error(level, rolled).round(6).tolist()
    [0.199667, 0.0, 0.0]
    """
    missing = quaternion_product(stack(q[0], -q[1:]), wanted)
    w, x, y, z = (missing[i] for i in range(4))
    square = w * w + z * z
    regular = square > _HALF_TURN
    size = np.sqrt(where(regular, square, 1.0))
    tilt_x = where(regular, (w * x - y * z) / size, 1.0)
    tilt_y = where(regular, (w * y + x * z) / size, 0.0)
    heading = where(regular, where(w < 0.0, -z, z) / size, 0.0)
    return 2.0 * stack(tilt_x, tilt_y, heading)


class AttitudeGains(NamedTuple):
    """Gains for :func:`attitude_controller`, made by :meth:`Multirotor.gains`.

    Parameters
    ----------
    kR : tuple of float
        Gains of attitude error in 1/s^2, tilt and yaw.
    kw : tuple of float
        Gains of angular rate in 1/s, tilt and yaw.
    lead_filter : float
        Time constant in s that the lead puts in the place of the motor lag.
    """

    kR: tuple[float, float]
    kw: tuple[float, float]
    lead_filter: float


def attitude_gains(
    *,
    motor_lag: float,
    delay: float,
    sharpness: float = 4.0,
    damping: float = 1.0,
    modulus_margin: float = 0.6,
    yaw_ratio: float = 0.25,
) -> AttitudeGains:
    """The fastest attitude loop of a given modulus margin behind motor lag and delay.

        L(s) = (kw s + kR)/s^2  e^(-delay s)/(1 + motor_lag/sharpness s),     kR = (kw/(2 damping))^2

    and kw the largest for which |1 + L(j omega)| >= modulus_margin.

    Parameters
    ----------
    motor_lag : float
        Time constant of the rotors' thrust in s.
    delay : float
        Dead time from a measurement to the rotors in s: the delay of the commands and half a sampling period, for which
        they are held.
    sharpness : float
        How many times faster than the motor lag the lead makes the loop's lag; it multiplies the gyroscope's noise by
        as much. 1 is no lead.
    damping : float
        Damping ratio of s^2 + kw s + kR, 0.75 or more.
    modulus_margin : float
        Least distance of L from -1, between 0 and 1; 0.6 leaves room for the position loop around this one.
    yaw_ratio : float
        Bandwidth of the heading as a share of that of the tilt: the torque about z is weak.

    Returns
    -------
    AttitudeGains

    Raises
    ------
    ValueError
        For times that are negative, or both 0; a sharpness below 1, a damping ratio below 0.75; a margin that no gain
        gives.

    Notes
    -----
    L is the loop at a small tilt. It depends on omega (motor_lag/sharpness + delay) and on the share of the two alone,
    so the gain is found in that unit by Brent's method on a grid of 2000 frequencies.

    Examples
    --------
    >>> gains = attitude_gains(motor_lag=0.04, delay=0.011)
    >>> [round(gain, 2) for gain in (*gains.kR, *gains.kw)]
    [163.43, 10.21, 25.57, 6.39]
    """
    _signals.number("motor_lag", motor_lag, "s", least=0.0)
    _signals.number("delay", delay, "s", least=0.0)
    _signals.number("yaw_ratio", yaw_ratio, "bandwidths of the tilt", above=0.0)
    _signals.number("sharpness", sharpness, least=1.0)
    _signals.number("damping", damping, least=0.75)
    lag = motor_lag / sharpness
    total = lag + delay
    if total <= 0.0:
        raise ValueError(
            "motor_lag and delay: expected one of them above 0 s; without lag every gain will do"
        )
    s = 1j * _GRID
    rest = np.exp(-s * delay / total) / (1.0 + s * lag / total)

    def excess(kw: float) -> float:
        distance = np.abs(1.0 + (kw * s + (0.5 * kw / damping) ** 2) / s**2 * rest).min()
        return float(distance) - modulus_margin

    above = [excess(gain) for gain in _GAINS]
    first = int(np.argmax(np.array(above) < 0.0))
    if first == 0:
        raise ValueError(
            f"modulus_margin: expected one between {min(above) + modulus_margin:.2g} and "
            f"{above[0] + modulus_margin:.2g}, got {modulus_margin}; 0.5 to 0.7 is usual"
        )
    kw = cast(float, brentq(excess, _GAINS[first - 1], _GAINS[first])) / total
    kR = (0.5 * kw / damping) ** 2
    return AttitudeGains((kR, yaw_ratio**2 * kR), (kw, yaw_ratio * kw), lag)
