"""What a robot without force sensors knows of the forces on its feet: its weight, its attitude, its motors' torques.

    tau_i + J_i' F_i = 0             statics of a leg without mass: the foot stands where this F_i carries enough
    sum_i [1, p_i x]' F_i = w        forces of least norm on the feet that stand, that carry the nominal weight at rest

The first F_i cannot stand in g: J_i is square, so J_i' F_i cancels the motors, and whatever the legs do under any f is
put down to the feet. The second ones leave f to what the robot does not know of, a payload say.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.plants.legged import balanced_contact

from .params import Params, params
from .robot import GRAVITY, SIDE, hips

__all__ = ["carried", "leg_kinematics"]

FloatArray = NDArray[np.float64]

# A foot stands with more than this part of the weight on it; two of a trot have half each.
_STANDS = 0.15


def leg_kinematics(q: FloatArray, *, parameters: Params | None = None) -> tuple[FloatArray, FloatArray]:
    """Where the legs are, and how the joints move the feet.

    Parameters
    ----------
    q : (E, 12) array
        Joint angles, rad.
    parameters : Params, optional

    Returns
    -------
    points : (3, E, 4, 3) array
        Hip joints, knees and feet in the trunk's frame, m.
    jacobian : (E, 4, 3, 3) array
        Of each foot by abduction, hip and knee of its leg, m/rad.
    """
    robot = (params() if parameters is None else parameters).robot
    roll, hip, knee = np.moveaxis(q.reshape(-1, 4, 3), -1, 0)
    c, s, none = np.cos(roll), np.sin(roll), np.zeros_like(roll)
    out = robot.abduction * SIDE + none

    def turned(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """From the frame that rolls with the leg to the trunk's."""
        return np.stack([x, c * y - s * z, s * y + c * z], axis=-1)

    x_thigh, z_thigh = -robot.thigh * np.sin(hip), -robot.thigh * np.cos(hip)
    x_shank, z_shank = -robot.shank * np.sin(hip + knee), -robot.shank * np.cos(hip + knee)
    x, z = x_thigh + x_shank, z_thigh + z_shank
    points = np.stack([turned(none, out, none), turned(x_thigh, out, z_thigh), turned(x, out, z)])
    foot = points[-1]
    by_roll = np.stack([none, -foot[..., 2], foot[..., 1]], axis=-1)
    jacobian = np.stack([by_roll, turned(z, none, -x), turned(z_shank, none, -x_shank)], axis=-1)
    return points + hips(robot), jacobian


def carried(
    q: FloatArray, up: FloatArray, torque: FloatArray, *, parameters: Params | None = None
) -> FloatArray:
    """J' F_c of the least forces that carry the robot, without payload, on the feet that the motors press down.

    Parameters
    ----------
    q : (E, 12) array
        Joint angles, rad.
    up : (E, 3) array
        The vertical in the trunks' frames.
    torque : (E, 12) array
        Of the motors, N m.
    parameters : Params, optional

    Returns
    -------
    (E, 18) array
        Base rows, in the trunk's frame, first; N and N m.
    """
    robot = (params() if parameters is None else parameters).robot
    (hip, knee, foot), jacobian = leg_kinematics(q, parameters=parameters)
    force = -np.linalg.solve(np.swapaxes(jacobian, -1, -2), torque.reshape(-1, 4, 3, 1))[..., 0]
    standing = np.matmul(force, up[..., None])[..., 0] > _STANDS * robot.mass * GRAVITY

    halves = (
        (robot.hip_mass, hips(robot) + hip),
        (robot.thigh_mass, hip + knee),
        (robot.shank_mass, knee + foot),
    )
    moment = robot.foot_mass * foot.sum(axis=1) + sum(0.5 * mass * ends.sum(axis=1) for mass, ends in halves)
    bias = np.zeros((len(q), 18))
    bias[:, :3], bias[:, 3:6] = GRAVITY * robot.mass * up, GRAVITY * np.cross(moment, up)
    rows = np.zeros((*foot.shape, 18))
    rows[..., :3] = np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # what a turn about i moves
        rows[..., j, 3 + i], rows[..., k, 3 + i] = -foot[..., k], foot[..., j]
    for leg in range(4):
        rows[:, leg, :, 6 + 3 * leg : 9 + 3 * leg] = jacobian[:, leg]
    return balanced_contact(bias, rows, standing.astype(float))
