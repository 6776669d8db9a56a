"""Rotor thrusts for a wanted total thrust and torque, within what the rotors can."""

from __future__ import annotations

from functools import reduce

import numpy as np

from ..plants.algebra import Array, Scalar
from ..plants.quadrotor import allocation_matrix

__all__ = ["allocate"]

# The pattern of signs alone: rows T, tau_x, tau_y, tau_z, columns rotors. Its rows are orthogonal, each of length 2.
_SIGNS = allocation_matrix(np.sqrt(2.0), 1.0)
# N: far below any thrust, yet its square divides without overflow where the law is linearised.
_TINY = 1e-9


def allocate(thrust: Scalar, torque: Array, *, arm: Scalar, torque_ratio: Scalar, rotor_max: Scalar) -> Array:
    """Thrusts of the four rotors within 0 and rotor_max for (thrust, torque), tilt first, then thrust, then yaw.

    Within the limits it is A^-1 (T, tau) with A of :func:`phyfilter_ctl.plants.allocation_matrix`. Beyond them, in this
    order: the torque about x and y is scaled down until it fits into the range of a rotor; the thrust is moved to where
    that torque has room, beside as much of the wanted torque about z as makes room; the torque about z takes what is
    left.

    Parameters
    ----------
    thrust : number
        T in N.
    torque : (3,) array
        tau in N m, body frame.
    arm, torque_ratio : number
        As for :func:`phyfilter_ctl.plants.allocation_matrix`, in m.
    rotor_max : number
        Largest thrust of a rotor in N.

    Returns
    -------
    (4,) array
        N. CasADi or numpy, as the arguments are.

    Notes
    -----
    The order is that of M. Faessler, D. Falanga, D. Scaramuzza, "Thrust mixing, saturation, and body-rate control for
    accurate aggressive quadrotor flight", IEEE Robotics and Automation Letters 2(2), 2017: tilt turns the thrust, so a
    loss of it moves the vehicle, while yaw only turns it about the thrust.

    Examples
    --------
    >>> limits = {"arm": 0.25, "torque_ratio": 0.016, "rotor_max": 16.0}
    >>> allocate(30.0, np.array([1.0, 0.0, 0.0]), **limits).round(3).tolist()
    [8.914, 8.914, 6.086, 6.086]
    >>> allocate(30.0, np.array([5.0, 0.0, 1.0]), **limits).round(3).tolist()
    [15.0, 14.142, 0.858, 0.0]
    """
    lever = arm / np.sqrt(2.0)
    tilt = (_SIGNS[1] * torque[0] + _SIGNS[2] * torque[1]) / (4.0 * lever)
    # Opposite rotors differ by twice their share, so that a share beyond half the range does not fit.
    tilt = tilt * np.fmin(1.0, 0.5 * rotor_max / np.fmax(_largest([tilt[i] for i in range(4)]), _TINY))
    turning = _SIGNS[3] > 0.0
    with_it, against = (_largest([tilt[i] for i in range(4) if turning[i] == sign]) for sign in (True, False))
    wanted = 0.25 * torque[2] / torque_ratio
    least = _room(with_it, against, wanted)
    most = rotor_max - _room(against, with_it, wanted)
    base = np.fmin(np.fmax(0.25 * thrust, least), most) + tilt
    up, down = rotor_max - base, base
    highest = _least([up[i] if turning[i] else down[i] for i in range(4)])
    lowest = _least([down[i] if turning[i] else up[i] for i in range(4)])
    yaw = np.fmin(np.fmax(wanted, -lowest), highest)
    # Rounding alone can leave the range here.
    return np.fmin(np.fmax(base + _SIGNS[3] * yaw, 0.0), rotor_max)


def _room(helped: Array, burdened: Array, wanted: Array) -> Array:
    """What a rotor needs towards a limit, with the part of the wanted yaw that helps one diagonal more than it burdens
    the other."""
    even = 0.5 * (helped - burdened)
    yaw = np.fmin(np.fmax(even, np.fmin(wanted, 0.0)), np.fmax(wanted, 0.0))
    return np.fmax(helped - yaw, burdened + yaw)


def _largest(values: list[Array]) -> Array:
    return reduce(np.fmax, [np.fabs(value) for value in values])


def _least(values: list[Array]) -> Array:
    return reduce(np.fmin, values)
