"""Many Berkeley Humanoids at once, on position drives, with a force on each."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..quadruped.bodies import Bodies
from .robot import FloatArray, Friction, Humanoid, load
from .stepping import neutral
from .walk_params import walk_params

__all__ = ["JOINTS", "Crowd"]

JOINTS = 12


class Crowd(Bodies):
    """E robots on a flat floor.

    Parameters
    ----------
    size : int
        Number of robots.
    grip : str
        Where forces act: "torso" or "pelvis".
    friction : {"elliptic", "pyramidal"}
        As for :func:`load`.
    timestep : float, optional
        Of the simulator, s; None takes that of ``berkeley/walk.toml``.
    threads : int
        Of MuJoCo's pool.

    Raises
    ------
    ValueError
        For fewer than one robot, unknown names, or without the extra ``mujoco``.
    """

    def __init__(
        self,
        size: int,
        *,
        grip: str = "torso",
        friction: Friction = "elliptic",
        timestep: float | None = None,
        threads: int = 1,
    ) -> None:
        self.humanoid: Humanoid = load(friction=friction, robot="berkeley", grip=grip)
        model, servo = self.humanoid.model, walk_params().servo
        limits = np.array(model.actuator_gear[:, 0])
        kp, kd = (np.tile(gains, 2) for gains in (servo.kp, servo.kd))
        model.opt.timestep = servo.timestep if timestep is None else timestep
        model.actuator_gear[:, 0], model.actuator_gainprm[:, 0] = 1.0, kp
        model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 2] = -kp, -kd
        model.actuator_ctrllimited[:], model.actuator_forcelimited[:] = 0, 1
        model.actuator_forcerange[:] = np.stack([-limits, limits], axis=1)
        joints = np.arange(JOINTS)
        super().__init__(model, size, qpos=7 + joints, dof=6 + joints, threads=threads)
        self.kp: FloatArray = kp
        self._torque, self._inertia = self._pool.bind("actuator_force"), self._pool.bind("M")
        self._bodies = [self._pool.bind(name) for name in ("xpos", "xmat")]
        self._floor = self._pool.expand("geom_friction")

    def set_friction(self, friction: ArrayLike) -> None:
        """Sliding friction of the floor.

        Parameters
        ----------
        friction : (E,) array
        """
        self._floor[:, self.model.geom("floor").id, 0] = friction

    def reset(self, which: NDArray[np.intp], joints: FloatArray, yaw: ArrayLike = 0.0) -> None:
        """Stand robots on the floor at rest.

        Parameters
        ----------
        which : (k,) int array
        joints : (k, 12) array
        yaw : (k,) array
            Heading, rad.
        """
        if not len(which):
            return
        self._pool.reset(which, stage=0)
        qpos, half = np.zeros((len(which), 7 + JOINTS)), 0.5 * np.asarray(yaw, dtype=float)
        qpos[:, 2], qpos[:, 3], qpos[:, 6] = neutral().height, np.cos(half), np.sin(half)
        qpos[:, 7:] = joints
        self._qpos[which], self._qvel[which] = qpos, 0.0

    def push(self, force: FloatArray) -> None:
        """Horizontal forces on the grip until the next call.

        Parameters
        ----------
        force : (E, 2) array
            In the world, N.
        """
        wrench = self._push.reshape(self.size, -1, 6)[:, self.humanoid.hand]
        wrench[:, :3] = np.concatenate([force, np.zeros((self.size, 1))], axis=1)
        lever = self.attitude @ (self.humanoid.offset - self.model.body_ipos[self.humanoid.hand])
        wrench[:, 3:] = np.cross(lever, wrench[:, :3])

    def step(self, target: FloatArray, *, count: int = 1) -> None:
        """Advance.

        Parameters
        ----------
        target : (E, 12) array
            Joint angles that the drives are sent, held, rad.
        count : int
            Number of steps.
        """
        unit = walk_params().servo.resolution
        self._ctrl[:] = unit * np.rint(target / unit)
        self._pool.step(nstep=count)

    @property
    def torque(self) -> FloatArray:
        """Of the motors at the step before, (E, 12) N m."""
        return self._torque

    def implicit_inertia(self) -> FloatArray:
        """M + h D (E, nv, nv), D of joints and drives: what a step divides forces by; of the step before."""
        model, nv = self.model, self.model.nv
        rows, columns = np.repeat(np.arange(nv), model.M_rownnz), model.M_colind
        M = np.zeros((self.size, nv, nv))
        M[:, rows, columns] = M[:, columns, rows] = self._inertia
        damping = np.array(model.dof_damping)
        damping[self.humanoid.motor_dof] -= model.actuator_biasprm[:, 2]
        diagonal = np.arange(nv)
        M[:, diagonal, diagonal] += float(model.opt.timestep) * damping
        return M

    def follow(self, other: Crowd, rows: NDArray[np.intp], qvel: FloatArray) -> None:
        """Take over places, solver starts and orders of some robots of another crowd.

        Parameters
        ----------
        other : Crowd
        rows : (E,) int array
            Its robots.
        qvel : (E, nv) array
            Velocities to start from: those measured, say.
        """
        self._qpos[:], self._qvel[:] = other.qpos[rows], qvel
        self._warm[:] = other.state()["warm"][rows]

    def force_jacobian(self) -> FloatArray:
        """Jacobian (E, 2, 6) of the grip, horizontal, by the velocities of the base.

        The grips are on the trunk: no joint moves them.
        """
        R, J = self.attitude, np.zeros((self.size, 3, 6))
        J[..., :3] = np.eye(3)
        J[..., 3:] = -np.cross((R @ self.humanoid.offset)[:, None], R.swapaxes(1, 2)).swapaxes(1, 2)
        return J[:, :2]

    @property
    def soles(self) -> FloatArray:
        """Heights of the middles of the soles, left and right, at the step before, (E, 2) m."""
        place, turn = (each.reshape(self.size, self.model.nbody, -1) for each in self._bodies)
        left, right = reversed(self.humanoid.soles)
        heights = [
            place[:, sole.body, 2] + turn[:, sole.body, 6:] @ sole.place - sole.height
            for sole in (left, right)
        ]
        return np.stack(heights, axis=1)

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which robots lie, (E,)."""
        fall, height = walk_params().fall, self._qpos[:, 2]
        return (self.up[:, 2] < fall.upright) | (height < fall.height) | ~np.isfinite(height)
