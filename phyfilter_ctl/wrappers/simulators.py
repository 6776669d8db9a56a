"""MuJoCo: what a model file knows of a robot as the prior of the filter, and a control callback (extra ``mujoco``)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..plants.legged.simulator import simulator
from .feedforward import FeedForward, LoopModel

__all__ = ["JointState", "control_callback", "mujoco_model"]

Array = NDArray[np.floating]
JointState = tuple[Array, Array]


def mujoco_model(prior: object) -> LoopModel[JointState]:
    """What a MuJoCo model says of M(q) q'' = g + f: g is actuators + springs and dampers - bias; contacts are in f.

    Parameters
    ----------
    prior : mujoco.MjModel
        The robot as it is known, not as it is: without the payload. With actuators whose torque is linear in ctrl, and
        does not depend on the posture (motors on joints); ValueError without any.

    Returns
    -------
    LoopModel
        Observations are (qpos, qvel), commands ctrl within the actuators' ctrlrange; f in all nv velocities is
        compensated as far as the actuators reach, by least squares.
    """
    mj: Any = simulator("mujoco_model")
    model: Any = prior
    if model.nu == 0:
        raise ValueError("prior: expected a model with actuators, got none")
    data = mj.MjData(model)

    def at(y: JointState) -> None:
        # Stage by stage: mj_forward would call the control callback again.
        data.qpos[:], data.qvel[:] = y
        mj.mj_fwdPosition(model, data)
        mj.mj_fwdVelocity(model, data)

    def torque(y: JointState, u: Array) -> Array:
        at(y)
        data.ctrl[:] = u
        mj.mj_fwdActuation(model, data)
        return data.qfrc_actuator + data.qfrc_passive - data.qfrc_bias

    def inertia(y: JointState) -> Array:
        at(y)
        M = np.zeros((model.nv, model.nv))
        mj.mj_fullM(model, data, M)
        return M

    rest = (np.array(model.qpos0), np.zeros(model.nv))
    columns = [torque(rest, 1e-3 * row) - torque(rest, np.zeros(model.nu)) for row in np.eye(model.nu)]
    back = np.linalg.pinv(1e3 * np.array(columns).T)
    limited = np.asarray(model.actuator_ctrllimited, dtype=bool)
    low, high = np.where(limited, model.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    return LoopModel(lambda y: y[1], torque, lambda y, f_hat: -back @ f_hat, inertia, low=low, high=high)


def control_callback(
    feedforward: FeedForward[JointState], controller: Callable[[Any, Any], ArrayLike]
) -> Callable[[Any, Any], None]:
    """A callback for ``mujoco.set_mjcb_control``: the controller's command with the compensation added.

    Parameters
    ----------
    feedforward : FeedForward
        Around :func:`mujoco_model`, its filter sampled at the simulation's timestep, or a multiple of it: the command
        is held in between. A time that runs back is a reset of the simulation.
    controller : callable
        (model, data) -> ctrl (nu,).
    """
    dt = feedforward.live.recursion.sampling.dt
    last = -np.inf

    def callback(model: Any, data: Any) -> None:
        nonlocal last
        if data.time < last:
            feedforward.reset()
            last = -np.inf
        if data.time > last + dt - 0.5 * model.opt.timestep:
            last = data.time
            y = (data.qpos.copy(), data.qvel.copy())
            data.ctrl[:] = feedforward(data.time, y, controller(model, data))

    return callback
