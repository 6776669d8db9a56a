"""The linearised loop as a python-control block."""

from __future__ import annotations

import control as ct
import numpy as np

from .params import params
from .posture import stand
from .regulator import regulate
from .robot import load

__all__ = ["build"]


def build(stance: str = "normal") -> ct.StateSpace:
    """The standing humanoid with its regulator, linear about the upright posture, sampled at 5 ms.

    x_{k+1} = (A - B K) x_k + B_F F_k + B (du*/dF + K dx*/dF) F_hat_k, the slopes from a neighbouring set-point.

    Parameters
    ----------
    stance : {"normal", "wide", "wider"}

    Returns
    -------
    control.StateSpace
        Inputs force and force_hat (N, lateral, on the right hand), output centre_y: the centre of mass's deviation from
        the feet's centre in m.

    Raises
    ------
    ValueError
        For an unknown stance, or without the extra ``mujoco``.
    """
    humanoid, spacing = load(), params().schedule.spacing
    upright = stand(humanoid, stance)
    here = regulate(humanoid, upright)
    near = regulate(humanoid, stand(humanoid, stance, (0.0, spacing, 0.0), start=upright))
    nv, model, data = humanoid.nv, humanoid.model, humanoid.data()
    data.qpos[:], data.ctrl[:] = here.q, here.posture.control
    humanoid.mujoco.mj_forward(model, data)
    h = float(model.opt.timestep)
    push = h * np.linalg.solve(humanoid.implicit_inertia(data), humanoid.hand_jacobian(data)[1])
    target = np.concatenate([humanoid.difference(here.q, near.q), np.zeros(nv)])
    retarget = here.B @ (near.posture.control - here.posture.control + here.K @ target) / spacing
    block = ct.ss(
        here.A - here.B @ here.K,
        np.stack([np.concatenate([h * push, push]), retarget], axis=1),
        np.concatenate([humanoid.centre_jacobian(data)[1], np.zeros(nv)])[None],
        np.zeros((1, 2)),
        h,
        inputs=["force", "force_hat"],
        outputs=["centre_y"],
        name="humanoid",
    )
    assert isinstance(block, ct.StateSpace)  # a linear system is one
    return block
