"""Inertia and bias torques of a mechanism from its URDF or MJCF file, by MuJoCo."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .._sections import FloatArray
from ..plants.legged.simulator import simulator
from .expressions import Functions

__all__ = ["Mechanism"]


@dataclass(frozen=True)
class Mechanism:
    """A mechanism from a URDF or MJCF file, whose joints of one degree of freedom are the channels, in their order."""

    file: Path
    joints: Sequence[str]

    @property
    def functions(self) -> Functions:
        """What expressions may call."""
        return {"mass_matrix": (self.mass_matrix, 1), "bias": (self.bias, 2)}

    @cached_property
    def _loaded(self) -> tuple[Any, Any, Any, list[int], list[int]]:
        mujoco = simulator("[mechanism]")
        if not self.file.is_file():
            raise FileNotFoundError(2, "No such file (mechanism.file)", str(self.file))
        model = mujoco.MjModel.from_xml_path(str(self.file))
        have = [model.joint(i).name for i in range(model.njnt)]
        if missing := [name for name in self.joints if name not in have]:
            raise ValueError(
                f"{self.file}: no joint {missing[0]!r} (mechanism.joints), only {', '.join(have)}"
            )
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        for name in self.joints:
            if model.joint(name).type[0] not in kinds:
                raise ValueError(f"{self.file}: joint {name!r} has more than one degree of freedom")
        positions = [int(model.joint(name).qposadr[0]) for name in self.joints]
        velocities = [int(model.joint(name).dofadr[0]) for name in self.joints]
        return mujoco, model, mujoco.MjData(model), positions, velocities

    def mass_matrix(self, q: FloatArray) -> FloatArray:
        """M (N, n, n) at joint positions q (N, n)."""
        mujoco, model, data, positions, velocities = self._loaded
        full = np.zeros((model.nv, model.nv))

        def at(row: FloatArray) -> FloatArray:
            data.qpos[positions] = row
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fullM(model, data, full)
            return full[np.ix_(velocities, velocities)]

        return self._each(at, q, len(self.joints), (len(self.joints), len(self.joints)))

    def bias(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Coriolis, centrifugal and gravity torques (N, n), less those of the file's springs and dampers."""
        mujoco, model, data, positions, velocities = self._loaded
        n = len(positions)

        def at(row: FloatArray) -> FloatArray:
            data.qpos[positions], data.qvel[velocities] = row[:n], row[n:]
            mujoco.mj_forward(model, data)
            return (data.qfrc_bias - data.qfrc_passive)[velocities]

        count = max(len(q), len(qd))
        rows = np.hstack([np.broadcast_to(part, (count, *part.shape[1:])) for part in (q, qd)])
        return self._each(at, rows, 2 * n, (n,))

    def _each(
        self, at: Callable[[FloatArray], FloatArray], rows: FloatArray, expected: int, shape: tuple[int, ...]
    ) -> FloatArray:
        if rows.shape[1:] != (expected,):
            raise ValueError(
                f"expected vectors of {len(self.joints)} joints (mechanism.joints), got shape {rows.shape[1:]}"
            )
        found = np.full((len(rows), *shape), np.nan)
        for k in np.flatnonzero(np.isfinite(rows).all(axis=1)):
            found[k] = at(rows[k])
        return found
