"""Joint quantities out of MuJoCo."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .prior import JointQuantities

__all__ = ["SimulatorData", "SimulatorModel", "quantities", "simulator"]


class SimulatorOptions(Protocol):
    """What is read of ``mujoco.MjModel.opt``."""

    @property
    def timestep(self) -> float: ...


class SimulatorModel(Protocol):
    """What is read of ``mujoco.MjModel``."""

    @property
    def nv(self) -> int: ...
    @property
    def opt(self) -> SimulatorOptions: ...
    @property
    def njnt(self) -> int: ...
    @property
    def jnt_type(self) -> NDArray[np.int32]: ...
    @property
    def dof_damping(self) -> NDArray[np.float64]: ...


class SimulatorData(Protocol):
    """What is read of ``mujoco.MjData``."""

    @property
    def qvel(self) -> NDArray[np.float64]: ...
    @property
    def qfrc_bias(self) -> NDArray[np.float64]: ...
    @property
    def qfrc_passive(self) -> NDArray[np.float64]: ...
    @property
    def qfrc_constraint(self) -> NDArray[np.float64]: ...


def simulator(who: str) -> ModuleType:
    """The module ``mujoco``.

    Parameters
    ----------
    who : str
        Who needs it, for the message.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    try:
        return import_module("mujoco")
    except ImportError:
        raise ImportError(f"{who} needs the extra mujoco: pip install 'phyfilter-ctl[mujoco]'") from None


def quantities(model: SimulatorModel, data: SimulatorData, *, stepped: bool = False) -> JointQuantities:
    """What MuJoCo knows of the robot.

    Base degrees of freedom are those of a free joint at the beginning of the tree; all others count as joints.

    Parameters
    ----------
    model : mujoco.MjModel
    data : mujoco.MjData
        After ``mj_forward``: of this instant. After ``mj_step``: velocities of now, the rest of the step that ends now,
        which is what a ``JointTorqueFilter`` with ``g="hold"`` asks for.
    stepped : bool
        Add h D to M, as the integrators "Euler" and "implicitfast" do with the damping D of the joints:
        (M + h D) (q'_k - q'_{k-1})/h = forces at q'_{k-1}. With it the residual after ``mj_step`` is exact.

    Returns
    -------
    JointQuantities
        bias is ``qfrc_bias - qfrc_passive``, contact_torque is ``qfrc_constraint`` (joint limits and dry friction too).

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    mujoco = simulator("quantities")
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    if stepped:
        M[np.diag_indices(model.nv)] += model.opt.timestep * model.dof_damping
    floating = model.njnt > 0 and model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    return JointQuantities(
        qd=data.qvel[6 if floating else 0 :].copy(),
        M=M,
        bias=data.qfrc_bias - data.qfrc_passive,
        contact_torque=data.qfrc_constraint.copy(),
    )
