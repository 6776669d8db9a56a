"""Postures in which the robot stands still, without and with a force on its hand.

With both feet flat on their places, a posture q, the forces of the eight corners of the feet and the motor torques are
sought together, by least squares:

    0 = B u + k(q) - c(q) + sum_i J_i(q)' lambda_i + J_hand(q)' F         (statics; the 21 joint rows give u)

so that the six rows of the base vanish, motors and friction keep their shares, every corner presses, and q stays near
the stance. Against a force that the upright robot cannot resist, it leans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from .params import params, stance
from .robot import FloatArray, HandForce, Humanoid, unit

__all__ = ["Posture", "joint_angles", "stand", "tipping_force"]

# Weights that make the constraints hard: 1e-3 m, 1e-2 rad and 0.2 N count as one unit of the cost.
_PLACE, _TURN, _FORCE = 1e3, 1e2, 5.0
_UNIT = 100.0  # N: forces and angles are then of one size
_EVALUATIONS = 60
_LIMIT_MARGIN = 0.05  # rad to the joints' stops


@dataclass(frozen=True, eq=False)
class Posture:
    """A posture at rest.

    Attributes
    ----------
    q : (28,) array
        Configuration.
    control : (21,) array
        Motors, in shares of their torque.
    force : (3,) tuple
        On the hand, in N.
    feet : (2, 4, 3) array
        Places of the corners.
    corner_forces : (2, 4, 3) array
        N.
    unbalanced : float
        Greatest force or torque on the base that is left over, N or N m: a posture that cannot be held has some.
    centre, hand : (3,) arrays
        Centre of mass and hand in the world.
    """

    q: FloatArray
    control: FloatArray
    force: HandForce
    feet: FloatArray
    corner_forces: FloatArray
    unbalanced: float
    centre: FloatArray
    hand: FloatArray
    unknowns: FloatArray


def joint_angles(humanoid: Humanoid, name: str) -> FloatArray:
    """Joint angles (nv - 6,) that a stance is to have.

    Parameters
    ----------
    humanoid : Humanoid
    name : str
        The stance.
    """
    hip, statics = np.radians(stance(name).hip), params().statics
    if humanoid.robot == "berkeley":
        angles = humanoid.model.key("home").qpos[7:].copy()
        for side, sign in (("LL", 1.0), ("LR", -1.0)):
            angles[humanoid.joint(f"{side}_HAA")] += sign * hip
            angles[humanoid.joint(f"{side}_FAA")] -= sign * hip
        return angles
    angles = np.zeros(21)
    for side, sign in (("right", 1.0), ("left", -1.0)):
        angles[humanoid.joint(f"{side}_hip_x")] = -hip
        angles[humanoid.joint(f"{side}_ankle_x")] = sign * hip
        angles[humanoid.joint(f"{side}_hip_y")] = -statics.hip_flexion
        angles[humanoid.joint(f"{side}_knee")] = -2.0 * statics.hip_flexion
        angles[humanoid.joint(f"{side}_ankle_y")] = -statics.hip_flexion
        angles[humanoid.joint(f"{side}_shoulder1")] = sign * statics.shoulder
    return angles


def stand(
    humanoid: Humanoid,
    name: str,
    force: HandForce = (0.0, 0.0, 0.0),
    *,
    start: Posture | None = None,
) -> Posture:
    """Posture of a stance under a constant force on the hand.

    Parameters
    ----------
    humanoid : Humanoid
    name : str
        The stance.
    force : (3,) tuple
        On the hand, in N, in the world: x forwards, y to the left.
    start : Posture, optional
        One whose feet stay where they are, and from which the search begins. None: the feet are placed too, flat, side
        by side around the origin.

    Returns
    -------
    Posture

    Raises
    ------
    ValueError
        For an unknown stance or a force that is not finite.
    """
    if not np.isfinite(force).all():
        raise ValueError(f"force: expected three finite numbers in N, got {force}")
    angles = joint_angles(humanoid, name)
    problem = _Problem(humanoid, angles, np.array(force, dtype=float), start)
    if start is None:
        height = float(humanoid.model.key("home").qpos[2]) if humanoid.robot == "berkeley" else 1.25
        load = humanoid.weight / (8.0 * _UNIT)
        unknowns = np.concatenate([[0.0, 0.0, height, 0.0, 0.0, 0.0], angles, np.tile([0.0, 0.0, load], 8)])
    else:
        unknowns = start.unknowns
    found = least_squares(problem.residuals, unknowns, max_nfev=_EVALUATIONS).x
    left, forces = problem.statics(found)
    data, shares = problem.data, -left / np.where(humanoid.torque > 0.0, humanoid.torque, np.inf)
    return Posture(
        q=data.qpos.copy(),
        control=shares[humanoid.motor_dof],
        force=force,
        feet=humanoid.corners(data),
        corner_forces=forces,
        unbalanced=float(np.abs(left[:6]).max()),
        centre=data.subtree_com[1].copy(),
        hand=humanoid.point(data),
        unknowns=found,
    )


def tipping_force(
    humanoid: Humanoid, posture: Posture, direction: float = 1.0, *, heading: float = 90.0
) -> float:
    """Horizontal force at which a posture, taken as rigid, tips over the edge of its feet.

    Lateral: the centre of pressure lies at y_c + F z_hand / W; at the edge y_e of the feet F = W (y_e - y_c) / z_hand.
    Other headings: the least F at which it leaves the convex hull of the feet.

    Parameters
    ----------
    humanoid : Humanoid
    posture : Posture
    direction : {1, -1}
        Sign.
    heading : float
        Of the force in degrees: 0 forwards, 90 to the left.

    Returns
    -------
    float
        N.
    """
    along = direction * unit(heading)
    hull = ConvexHull(posture.feet[..., :2].reshape(-1, 2))
    normals, offsets = hull.equations[:, :2], hull.equations[:, 2]
    leaving = normals @ along
    left = -(normals @ posture.centre[:2] + offsets)
    lever = float(np.min(left[leaving > 1e-9] / leaving[leaving > 1e-9]))
    return humanoid.weight * lever / float(posture.hand[2])


class _Problem:
    """The least-squares problem of one posture."""

    def __init__(
        self, humanoid: Humanoid, angles: FloatArray, force: FloatArray, start: Posture | None
    ) -> None:
        self.humanoid, self.angles, self.force = humanoid, angles, force
        self.limits = params().statics
        self.data = humanoid.data()
        self.places: list[tuple[FloatArray, FloatArray]] | None = None
        if start is not None:
            self._place(start.unknowns)
            self.places = self._feet()

    def _place(self, unknowns: FloatArray) -> None:
        data, mujoco = self.data, self.humanoid.mujoco
        data.qpos[:3] = unknowns[:3]
        data.qpos[3:7] = Rotation.from_rotvec(unknowns[3:6]).as_quat()[[3, 0, 1, 2]]
        data.qpos[7:] = unknowns[6 : self.humanoid.nv]
        mujoco.mj_kinematics(self.humanoid.model, data)
        mujoco.mj_comPos(self.humanoid.model, data)

    def _feet(self) -> list[tuple[FloatArray, FloatArray]]:
        return [sole.frame(self.data) for sole in self.humanoid.soles]

    def statics(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What the motors and nobody must balance (nv,), and the forces (2, 4, 3) of the corners."""
        self._place(unknowns)
        humanoid, data, mujoco = self.humanoid, self.data, self.humanoid.mujoco
        mujoco.mj_comVel(humanoid.model, data)
        mujoco.mj_passive(humanoid.model, data)
        bias = np.zeros(humanoid.nv)
        mujoco.mj_rne(humanoid.model, data, 0, bias)
        left = data.qfrc_passive - bias + humanoid.hand_jacobian(data).T @ self.force
        forces = _UNIT * unknowns[humanoid.nv :].reshape(2, 4, 3)
        for sole, places, loads in zip(humanoid.soles, humanoid.corners(data), forces, strict=True):
            for place, load in zip(places, loads, strict=True):
                left = left + humanoid.jacobian(data, place, sole.body).T @ load
        return left, forces

    def residuals(self, unknowns: FloatArray) -> FloatArray:
        limits, humanoid = self.limits, self.humanoid
        left, forces = self.statics(unknowns)
        share = left[6:] / humanoid.torque[6:]
        normal, tangential = forces[..., 2].ravel(), forces[..., :2]
        slip = np.hypot(tangential[..., 0], tangential[..., 1]).ravel()
        friction = float(humanoid.model.geom("floor").friction[0])
        low, high = humanoid.model.jnt_range[1:].T
        joints = unknowns[6 : humanoid.nv]
        return np.concatenate(
            [
                self._foot_errors(),
                _FORCE * left[:6],
                0.5 * share,
                30.0 * np.maximum(0.0, np.abs(share) - limits.torque_share),
                0.3 * np.maximum(0.0, slip - limits.friction_share * friction * normal),
                np.maximum(0.0, limits.foot_share * humanoid.weight - normal),
                0.002 * forces.ravel(),
                limits.posture * (joints - self.angles),
                0.5 * unknowns[3:6],
                50.0 * np.maximum(0.0, low + _LIMIT_MARGIN - joints),
                50.0 * np.maximum(0.0, joints - high + _LIMIT_MARGIN),
            ]
        )

    def _foot_errors(self) -> FloatArray:
        (right, turn_right), (left, turn_left) = self._feet()
        if self.places is None:
            return np.concatenate(
                [
                    _PLACE * (np.array([right[2], left[2]]) - self.humanoid.soles[0].height),
                    _TURN * Rotation.from_matrix(turn_right).as_rotvec(),
                    _TURN * Rotation.from_matrix(turn_left).as_rotvec(),
                    _TURN * np.array([right[0], left[0], right[1] + left[1]]),
                ]
            )
        errors = []
        for (place, turn), (wanted, straight) in zip(self._feet(), self.places, strict=True):
            errors += [_PLACE * (place - wanted), _TURN * Rotation.from_matrix(straight.T @ turn).as_rotvec()]
        return np.concatenate(errors)
