"""Many quadrupeds at once: one model, per-robot payload, friction and pushes, stepped on a pool of threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.plants.legged import LeggedRobot
from phyfilter_ctl.plants.legged.simulator import simulator

from .gait import neutral
from .params import Params, params
from .robot import legged
from .terrain import Terrain

if TYPE_CHECKING:
    from mujoco._structs import MjModel  # the public name is not seen by type checkers

__all__ = ["Batch", "Motion"]

FloatArray = NDArray[np.float64]

# Centre of a payload above that of the trunk, and its size, m: a box on the back.
_PAYLOAD_HEIGHT = 0.11
_PAYLOAD_BOX = (0.25, 0.16, 0.1)


@dataclass(frozen=True)
class Motion:
    """What the robots do at one instant; leading axis: robots.

    Attributes
    ----------
    position : (E, 3) array
        Of the trunk, m.
    velocity : (E, 3) array
        Of the trunk in its own frame, m/s.
    rate : (E, 3) array
        Of the trunk in its own frame, rad/s.
    up : (E, 3) array
        The vertical in the trunk's frame.
    yaw : (E,) array
        In rad.
    q, qd : (E, 12) array
        Joints, rad and rad/s.
    """

    position: FloatArray
    velocity: FloatArray
    rate: FloatArray
    up: FloatArray
    yaw: FloatArray
    q: FloatArray
    qd: FloatArray


class Batch:
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
        if size < 1:
            raise ValueError(f"size: expected at least one robot, got {size}")
        simulator("the quadruped")
        from mujoco.batch import Batch as Pool

        self.terrain: Terrain = Terrain() if terrain is None else terrain
        self.size = size
        self.parameters: Params = params() if parameters is None else parameters
        self.robot: LeggedRobot = legged(self.parameters, terrain=self.terrain)
        self.model: MjModel = self.robot.model
        self._pool = Pool(self.model, nsim=size, nthread=threads)
        self._qpos, self._qvel = self._pool.bind("qpos"), self._pool.bind("qvel")
        self._ctrl, self._push = self._pool.bind("ctrl"), self._pool.bind("xfrc_applied")
        self._touch, self._warm = self._pool.bind("sensordata"), self._pool.bind("qacc_warmstart")
        self._trunk, self._feet = self.robot.base, self.robot.geoms
        self._q, self._qd = _columns(self.robot.qpos), _columns(self.robot.dof)
        self._motors, self._sensors = _columns(self.robot.motors), _columns(self.robot.touch)
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
    def q(self) -> FloatArray:
        """Joint angles, (E, 12); a view where the model has them in this order."""
        return self._qpos[:, self._q]

    @property
    def qd(self) -> FloatArray:
        """Joint velocities, (E, 12); a view where the model has them in this order."""
        return self._qvel[:, self._qd]

    @property
    def qpos(self) -> FloatArray:
        """Positions as MuJoCo has them, (E, 19); a view."""
        return self._qpos

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
        return self._pool.bind("qfrc_constraint")[:, _columns(rows)]

    @property
    def up(self) -> FloatArray:
        """The vertical in the trunks' frames, (E, 3)."""
        w, x, y, z = self._qpos[:, 3:7].T
        return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)

    @property
    def lean(self) -> tuple[FloatArray, FloatArray]:
        """Tilt of the trunks (sine) and largest of roll and pitch rates (rad/s), (E,) each."""
        tilt = np.hypot(*self.up[:, :2].T)
        return tilt, np.abs(self._qvel[:, 3:5]).max(axis=1)

    @property
    def motion(self) -> Motion:
        """What the robots do now."""
        w, x, y, z = self._qpos[:, 3:7].T
        # Columns of the rotation from trunk to world.
        R = np.empty((self.size, 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        R[:, 2] = up = self.up
        velocity = np.matmul(self._qvel[:, None, :3], R)[:, 0]
        return Motion(
            self._qpos[:, :3].copy(),
            velocity,
            self._qvel[:, 3:6].copy(),
            up,
            np.arctan2(R[:, 1, 0], R[:, 0, 0]),
            self.q.copy(),
            self.qd.copy(),
        )

    def fallen(self, motion: Motion) -> NDArray[np.bool_]:
        """Which robots lie, (E,).

        Parameters
        ----------
        motion : Motion
        """
        fall = self.parameters.fall
        above = motion.position[:, 2] - self.terrain.height(motion.position[:, 0], motion.position[:, 1])
        return (motion.up[:, 2] < fall.upright) | (above < fall.height) | ~np.isfinite(above)

    def state(self) -> dict[str, NDArray[np.generic]]:
        """What the next step depends on: positions, velocities, the solver's start."""
        return {"qpos": self._qpos.copy(), "qvel": self._qvel.copy(), "warm": self._warm.copy()}

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there; payload and friction are the caller's.

        Parameters
        ----------
        state : dict
            Of :meth:`state`.
        """
        self._qpos[:], self._qvel[:], self._warm[:] = state["qpos"], state["qvel"], state["warm"]


def _columns(index: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """As a slice where the columns follow one another: a view, not a copy."""
    first = int(index[0])
    return slice(first, first + len(index)) if np.array_equal(index, first + np.arange(len(index))) else index


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
