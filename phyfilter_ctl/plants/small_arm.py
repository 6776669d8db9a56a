"""A light arm of plausible masses and lengths for the aerial manipulator."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from .arm_parts import Link
from .serial_arm import SerialArm

__all__ = ["small_arm"]


def small_arm(*, mount: ArrayLike = (0.06, 0.0, -0.04), rate_limit: float = 6.0) -> SerialArm:
    """A light arm of five joints for a platform of about 3 kg: 0.45 kg, 0.41 m from the shoulder to the gripper.

    Parameters
    ----------
    mount : (3,) array
        P_o, the base yaw's bearing, from the platform's centre of mass in body axes, in m.
    rate_limit : float
        Of every joint, rad/s.

    Returns
    -------
    SerialArm
        Base yaw, shoulder 50 mm below it, upper arm 160 mm, forearm 150 mm, wrist pitch to wrist roll 35 mm, gripper
        65 mm. Masses 0.09, 0.15, 0.11, 0.05 and 0.05 kg: a servo of about 50 g at the near end of each of the first
        three links, the rest tube. Moments of inertia are those of boxes of the links' outer size.

    Notes
    -----
    Plausible values, of no particular product. The base frame hangs: z points down. The paper's world and body frames
    have z down, and only so does its training path,

        [0.28 + 0.1 sin(wt)/sqrt(5), 0.1 sin(wt)/sqrt(5/4), 0.105 + 0.1 cos(wt)] m,

    run below the rotors (5 mm to 205 mm below the mount; with z up it would run as far above it, through the
    platform). The circle of radius 0.1 m is reached at every phase with the gripper level; home is its centre.

    Examples
    --------
    >>> arm = small_arm()
    >>> phase = np.linspace(0.0, 2.0 * np.pi, 100)
    >>> path = 0.1 * np.column_stack([np.sin(phase) / 5**0.5, np.sin(phase) / 1.25**0.5, np.cos(phase)])
    >>> arm.check_reachable([arm.from_base(p) for p in path + [0.28, 0.0, 0.105]])
    """
    lengths = (0.16, 0.15, 0.035, 0.065)
    masses = (0.15, 0.11, 0.05, 0.05)
    centres = (0.06, 0.05, 0.015, 0.03)
    sides = (0.035, 0.03, 0.03, 0.04)
    limits = (1.9, 2.5, 2.2, np.pi)
    y, x = (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)
    base = Link(
        (0.0, 0.0, 1.0),
        (0.0, 0.0, 0.05),
        0.09,
        (0.0, 0.0, 0.025),
        _box(0.09, (0.045, 0.045, 0.05)),
        lower=-2.6,
        upper=2.6,
        rate_limit=rate_limit,
    )
    rest = [
        Link(
            axis,
            (length, 0.0, 0.0),
            mass,
            (centre, 0.0, 0.0),
            _box(mass, (length, side, side)),
            lower=-limit,
            upper=limit,
            rate_limit=rate_limit,
        )
        for axis, length, mass, centre, side, limit in zip(
            (y, y, y, x), lengths, masses, centres, sides, limits, strict=True
        )
    ]
    arm = SerialArm([base, *rest], mount)
    home = np.asarray(arm.inverse(arm.from_base([0.28, 0.0, 0.105])))
    return SerialArm(arm.links, arm.mount, home=home)


def _box(mass: float, sides: tuple[float, float, float]) -> FloatArray:
    """Moments of inertia of a box about its centre."""
    x, y, z = np.square(sides)
    return mass / 12.0 * np.array([y + z, x + z, x + y])
