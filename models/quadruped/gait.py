"""A trot by inverse kinematics: what the policy corrects.

Diagonal legs in phase. The standing foot moves back by v T/2 at constant speed, the swinging one forward on a cycloid:

    phi' = 2 pi f(|v|)
    stance   p = p_0 + [stride (1/2 - s), 0, 0]
    swing    p = p_0 + [stride (s - sin(2 pi s)/(2 pi) - 1/2), 0, c (1 - cos(2 pi s))/2]
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .params import Params, params
from .robot import SIDE, hips

__all__ = [
    "OFFSETS",
    "feet",
    "following",
    "frequency",
    "inverse_kinematics",
    "neutral",
    "sent",
    "standing",
    "trot",
]

FloatArray = NDArray[np.float64]

# FL with HR, FR with HL.
OFFSETS: FloatArray = np.array([0.0, np.pi, np.pi, 0.0])
# Of the straight leg: beyond, the inverse kinematics are singular.
_REACH = 0.985
_SHORTEST = 0.08


def frequency(command: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Steps per second and leg, Hz.

    Parameters
    ----------
    command : (..., 3) array
        Forward and sideways speed in m/s, turn rate in rad/s.
    parameters : Params, optional
    """
    gait = (params() if parameters is None else parameters).gait
    speed = np.hypot(*np.moveaxis(np.asarray(command, dtype=float)[..., :2], -1, 0))
    return np.interp(speed, [gait.speed_low, gait.speed_high], [gait.frequency, gait.frequency_high])


def following(phase: ArrayLike, command: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Phase of the gait one step of the policy later, rad.

    Parameters
    ----------
    phase : (...) array
    command : (..., 3) array
    parameters : Params, optional
    """
    p = params() if parameters is None else parameters
    turned = 2.0 * np.pi * frequency(command, parameters=p) * (p.control.dt * p.control.decimation)
    return np.mod(np.asarray(phase) + turned, 2.0 * np.pi)


def _phases(phase: ArrayLike) -> FloatArray:
    """Of each leg, in [0, 2): below 1 it stands."""
    return np.mod(np.asarray(phase, dtype=float)[..., None] + OFFSETS, 2.0 * np.pi) / np.pi


def standing(phase: ArrayLike) -> NDArray[np.bool_]:
    """Which legs stand, (..., 4).

    Parameters
    ----------
    phase : (...) array
        In rad.
    """
    return _phases(phase) < 1.0


def feet(phase: ArrayLike, command: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Feet below their abduction axes.

    Parameters
    ----------
    phase : (...) array
        Of the gait in rad.
    command : (..., 3) array
    parameters : Params, optional

    Returns
    -------
    (..., 4, 3) array
        In the trunk's frame, m.
    """
    p = params() if parameters is None else parameters
    order = np.asarray(command, dtype=float)
    where = hips(p.robot)
    reach_y = where[:, 1] + p.robot.abduction * SIDE
    vx = order[..., 0, None] - order[..., 2, None] * reach_y
    vy = order[..., 1, None] + order[..., 2, None] * where[:, 0]
    stance_time = 0.5 / frequency(order, parameters=p)[..., None]
    s = _phases(phase)
    swing = np.clip(s - 1.0, 0.0, 1.0)
    wave = 2.0 * np.pi * swing
    along = np.where(s < 1.0, 0.5 - s, swing - np.sin(wave) / (2.0 * np.pi) - 0.5) * stance_time
    lift = 0.5 * p.gait.clearance * (1.0 - np.cos(wave))
    return np.stack([vx * along, p.robot.abduction * SIDE + vy * along, lift - p.gait.height], axis=-1)


def inverse_kinematics(feet: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Joint angles that put the feet there.

    Parameters
    ----------
    feet : (..., 4, 3) array
        Below the abduction axes, in the trunk's frame, m. Beyond the reach of a leg: as far as it goes.
    parameters : Params, optional

    Returns
    -------
    (..., 12) array
        In rad, within the joints' limits.
    """
    robot = (params() if parameters is None else parameters).robot
    L1, L2 = robot.thigh, robot.shank
    x, y, z = np.moveaxis(np.asarray(feet, dtype=float), -1, 0)
    out = robot.abduction * SIDE
    down = np.sqrt(np.maximum(y**2 + z**2 - out**2, _SHORTEST**2))
    roll = np.arctan2(z, y) - np.arctan2(-down, out)
    roll = np.mod(roll + np.pi, 2.0 * np.pi) - np.pi
    length = np.clip(np.hypot(x, down), _SHORTEST, _REACH * (L1 + L2))
    knee = -np.arccos(np.clip((length**2 - L1**2 - L2**2) / (2.0 * L1 * L2), -1.0, 1.0))
    hip = np.arctan2(-x, down) - np.arctan2(L2 * np.sin(knee), L1 + L2 * np.cos(knee))
    angles = np.stack([roll, hip, knee], axis=-1)
    return np.clip(angles, robot.lower, robot.upper).reshape(*angles.shape[:-2], 12)


def trot(phase: ArrayLike, command: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Joint angles of the trot, (..., 12) rad.

    Parameters
    ----------
    phase : (...) array
        In rad.
    command : (..., 3) array
    parameters : Params, optional

    Examples
    --------
    >>> trot(0.0, [0.0, 0.0, 0.0]).shape
    (12,)
    """
    return inverse_kinematics(feet(phase, command, parameters=parameters), parameters=parameters)


def sent(angles: ArrayLike, *, parameters: Params | None = None) -> FloatArray:
    """Targets as the drives get them: whole steps of ``resolution``.

    Kernels of linear algebra and of sines round differently from processor to processor, and a walk that stumbles makes
    much of a last digit. Nothing but these steps reaches the robot, so that the same walks come out everywhere.

    Parameters
    ----------
    angles : (..., 12) array
        In rad.
    parameters : Params, optional

    Examples
    --------
    >>> bool(sent(0.7) == sent(0.7 + 1e-15))
    True
    """
    step = (params() if parameters is None else parameters).control.resolution
    return step * np.rint(np.asarray(angles, dtype=float) / step)


def neutral(*, parameters: Params | None = None) -> FloatArray:
    """Joint angles of the stance, (12,) rad.

    Parameters
    ----------
    parameters : Params, optional
    """
    p = params() if parameters is None else parameters
    below = np.stack([np.zeros(4), p.robot.abduction * SIDE, np.full(4, -p.gait.height)], axis=1)
    return inverse_kinematics(below, parameters=p)
