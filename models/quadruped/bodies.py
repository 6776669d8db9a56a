"""Robots on free bases, many at once: MuJoCo's arrays of a pool of threads, and what the trunks do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from mujoco._structs import MjModel  # the public name is not seen by type checkers

__all__ = ["Bodies", "Motion", "columns"]

FloatArray = NDArray[np.float64]


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
    q, qd : (E, J) array
        Joints, rad and rad/s.
    """

    position: FloatArray
    velocity: FloatArray
    rate: FloatArray
    up: FloatArray
    yaw: FloatArray
    q: FloatArray
    qd: FloatArray


class Bodies:
    """E copies of a robot in a pool of threads; the memory is MuJoCo's, nothing is copied.

    Parameters
    ----------
    model : mujoco.MjModel
        Its first joint is the free one of the trunk.
    size : int
        Number of robots.
    qpos, dof : (J,) int array
        Where the joints are among positions and velocities.
    threads : int

    Raises
    ------
    ValueError
        For fewer than one robot.
    """

    def __init__(
        self, model: MjModel, size: int, *, qpos: NDArray[np.int64], dof: NDArray[np.int64], threads: int
    ) -> None:
        if size < 1:
            raise ValueError(f"size: expected at least one robot, got {size}")
        from mujoco.batch import Batch as Pool

        self.model: MjModel = model
        self.size = size
        self._pool = Pool(model, nsim=size, nthread=threads)
        self._qpos, self._qvel = self._pool.bind("qpos"), self._pool.bind("qvel")
        self._ctrl, self._push = self._pool.bind("ctrl"), self._pool.bind("xfrc_applied")
        self._warm = self._pool.bind("qacc_warmstart")
        self._q, self._qd = columns(qpos), columns(dof)

    @property
    def q(self) -> FloatArray:
        """Joint angles, (E, J); a view where the model has them in this order."""
        return self._qpos[:, self._q]

    @property
    def qd(self) -> FloatArray:
        """Joint velocities, (E, J); a view where the model has them in this order."""
        return self._qvel[:, self._qd]

    @property
    def qpos(self) -> FloatArray:
        """Positions as MuJoCo has them, (E, nq); a view."""
        return self._qpos

    @property
    def up(self) -> FloatArray:
        """The vertical in the trunks' frames, (E, 3)."""
        w, x, y, z = self._qpos[:, 3:7].T
        return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)

    @property
    def attitude(self) -> FloatArray:
        """Rotations from the trunks' frames to the world's, (E, 3, 3)."""
        w, x, y, z = self._qpos[:, 3:7].T
        R = np.empty((self.size, 3, 3))
        R[:, 0, 0], R[:, 0, 1], R[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        R[:, 1, 0], R[:, 1, 1], R[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        R[:, 2] = self.up
        return R

    @property
    def lean(self) -> tuple[FloatArray, FloatArray]:
        """Tilt of the trunks (sine) and largest of roll and pitch rates (rad/s), (E,) each."""
        tilt = np.hypot(*self.up[:, :2].T)
        return tilt, np.abs(self._qvel[:, 3:5]).max(axis=1)

    @property
    def motion(self) -> Motion:
        """What the robots do now."""
        return self.seen(self._qvel)

    @property
    def qvel(self) -> FloatArray:
        """Velocities as MuJoCo has them, (E, nv); a view."""
        return self._qvel

    def seen(self, qvel: FloatArray) -> Motion:
        """What the robots do now, by measured velocities.

        Parameters
        ----------
        qvel : (E, nv) array
            As MuJoCo has them.
        """
        R, up = self.attitude, self.up
        velocity = np.matmul(qvel[:, None, :3], R)[:, 0]
        return Motion(
            self._qpos[:, :3].copy(),
            velocity,
            qvel[:, 3:6].copy(),
            up,
            np.arctan2(R[:, 1, 0], R[:, 0, 0]),
            self.q.copy(),
            qvel[:, self._qd].copy(),
        )

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


def columns(index: NDArray[np.int64]) -> slice | NDArray[np.int64]:
    """As a slice where the columns follow one another: a view, not a copy."""
    first = int(index[0])
    return slice(first, first + len(index)) if np.array_equal(index, first + np.arange(len(index))) else index
