"""Many quadrupeds at once: one model, per-robot payload, friction and pushes, stepped on a pool of threads."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.plants import LeggedRobot
from phyfilter_ctl.plants.legged.simulator import simulator

from .bodies import Bodies, Motion, columns
from .gait import neutral
from .params import Params, params
from .robot import legged
from .terrain import Terrain

__all__ = ["Batch", "Motion"]

FloatArray = NDArray[np.float64]

# Centre of a payload above that of the trunk, and its size, m: a box on the back.
_PAYLOAD_HEIGHT = 0.11
_PAYLOAD_BOX = (0.25, 0.16, 0.1)


class Batch(Bodies):
    """E robots on one ground.

    Parameters
    ----------
    size : int
        Number of robots.
    terrain : Terrain, optional
        None: flat.
    threads : int
        Of MuJoCo's pool.
    parameters : Params, optional
        The robot; None: that of ``params.toml``.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    ValueError
        For a robot whose trunk has its principal axes of inertia across the axes of its body.
    """

    def __init__(
        self,
        size: int,
        *,
        terrain: Terrain | None = None,
        threads: int = 2,
        parameters: Params | None = None,
    ) -> None:
        simulator("the quadruped")
        self.terrain: Terrain = Terrain() if terrain is None else terrain
        self.parameters: Params = params() if parameters is None else parameters
        self.robot: LeggedRobot = legged(self.parameters, terrain=self.terrain)
        robot = self.robot
        super().__init__(robot.model, size, qpos=robot.qpos, dof=robot.dof, threads=threads)
        self._touch = self._pool.bind("sensordata")
        self._trunk, self._feet = self.robot.base, self.robot.geoms
        self._motors, self._sensors = columns(self.robot.motors), columns(self.robot.touch)
        self._axes = _principal_axes(self.model.body_iquat[self._trunk])
        self._friction = self._pool.expand("geom_friction")
        self._mass, self._inertia = self._pool.expand("body_mass"), self._pool.expand("body_inertia")
        self._ipos = self._pool.expand("body_ipos")
        self.set_friction(np.full(size, self.parameters.robot.friction))
        self.reset(np.arange(size))

    def set_payload(self, payload: ArrayLike) -> None:
        """Load the trunks.

        Parameters
        ----------
        payload : (E,) array
            In kg. Positive: a box on the back; negative: a lighter trunk.
        """
        extra = np.broadcast_to(np.asarray(payload, dtype=float), (self.size,))
        mass, trunk = self.model.body_mass[self._trunk], self._trunk
        box = np.maximum(extra, 0.0)
        left = mass + np.minimum(extra, 0.0)
        total = left + box
        shift = box * _PAYLOAD_HEIGHT / total
        a, b, c = _PAYLOAD_BOX
        own = np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2]) / 12.0
        apart = (left * box / total * _PAYLOAD_HEIGHT**2)[:, None] * np.array([1.0, 1.0, 0.0])
        self._mass[:, trunk] = total
        added = own[self._axes] * box[:, None], apart[:, self._axes]
        self._inertia[:, trunk] = (
            self.model.body_inertia[trunk] * (left / mass)[:, None] + added[0] + added[1]
        )
        self._ipos[:, trunk] = self.model.body_ipos[trunk] + shift[:, None] * np.array([0.0, 0.0, 1.0])
        self._pool.set_const()

    def set_friction(self, friction: ArrayLike) -> None:
        """Give the feet another friction.

        Parameters
        ----------
        friction : (E,) array
            Sliding friction; the ground's factor comes on top.
        """
        value = np.broadcast_to(np.asarray(friction, dtype=float), (self.size,))
        self._friction[:, self._feet, 0] = (value * self.terrain.friction)[:, None]

    def push(self, force: ArrayLike) -> None:
        """Force on the trunks until the next call.

        Parameters
        ----------
        force : (E, 3) array
            In the world, N.
        """
        self._push.reshape(self.size, -1, 6)[:, self._trunk, :3] = force

    def reset(
        self, which: NDArray[np.intp], *, joints: ArrayLike | None = None, place: ArrayLike | None = None
    ) -> None:
        """Put robots on the ground at rest.

        Parameters
        ----------
        which : (k,) int array
            The robots.
        joints : (k, 12) array, optional
            Angles; None: the neutral stance.
        place : (k, 3) array, optional
            x, y in m and yaw in rad; None: the origin.
        """
        if not len(which):
            return
        p = self.parameters
        where = np.zeros((len(which), 3)) if place is None else np.asarray(place, dtype=float)
        self._pool.reset(which, stage=0)
        qpos = np.zeros((len(which), self.model.nq))
        qpos[:, :2] = where[:, :2]
        ground = self.terrain.height(where[:, 0], where[:, 1])
        qpos[:, 2] = ground + p.gait.height + p.robot.foot_radius
        qpos[:, 3], qpos[:, 6] = np.cos(0.5 * where[:, 2]), np.sin(0.5 * where[:, 2])
        qpos[:, self._q] = neutral(parameters=p) if joints is None else joints
        self._qpos[which] = qpos
        self._qvel[which] = 0.0

    def step(self, torque: FloatArray, *, count: int = 1) -> None:
        """Advance.

        Parameters
        ----------
        torque : (E, 12) array
            Of the joints, held, N m.
        count : int
            Number of steps.
        """
        self._ctrl[:, self._motors] = torque
        self._pool.step(nstep=count)

    @property
    def load(self) -> FloatArray:
        """Normal force of each foot at the step before, (E, 4) N."""
        return self._touch[:, self._sensors]

    @property
    def lift(self) -> FloatArray:
        """Heights of the soles above the ground at the step before, (E, 4) m."""
        x, y, z = np.moveaxis(self._pool.bind("geom_xpos")[:, self._feet], -1, 0)
        return z - self.parameters.robot.foot_radius - self.terrain.height(x, y)

    @property
    def contact(self) -> FloatArray:
        """Generalised forces of the contacts over the step before, J' F_c, (E, 18) N and N m.

        MuJoCo's constraint forces: stops and dry friction of the joints are among them, where a robot has any.
        """
        rows = np.concatenate([np.arange(6), self.robot.dof])
        return self._pool.bind("qfrc_constraint")[:, columns(rows)]

    def fallen(self, motion: Motion) -> NDArray[np.bool_]:
        """Which robots lie, (E,).

        Parameters
        ----------
        motion : Motion
        """
        fall = self.parameters.fall
        above = motion.position[:, 2] - self.terrain.height(motion.position[:, 0], motion.position[:, 1])
        return (motion.up[:, 2] < fall.upright) | (above < fall.height) | ~np.isfinite(above)


# Sine of the largest angle between a principal axis and an axis of the trunk that is taken for none.
_ASKEW = 0.05


def _principal_axes(quaternion: FloatArray) -> NDArray[np.int64]:
    """Which axis of the trunk each of its principal axes of inertia is."""
    R = np.zeros(9)
    simulator("the quadruped").mju_quat2Mat(R, quaternion)
    along = np.abs(R.reshape(3, 3))
    axes = along.argmax(axis=0)
    if len(set(axes.tolist())) < 3 or np.min(along[axes, np.arange(3)]) < np.sqrt(1.0 - _ASKEW**2):
        raise ValueError(
            "the trunk's principal axes of inertia lie across its own axes: a payload cannot be put on it; turn the "
            "trunk's frame in the file"
        )
    return axes
