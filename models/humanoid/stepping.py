"""Steps in place and walking by a clock: what the policy corrects, and what carries it until it has learned.

Each foot is in the air for a part of its half of the cycle and lands where the trunk's speed asks for (M. Raibert,
Legged Robots That Balance, 1986); standing, it moves back with the commanded speed:

    touchdown    p = v_c T/4 + k (v - v_c)                 T the cycle, v of the trunk
    stance       p' = -v_c,   foot turned against the trunk's pitch and roll by k_p angle + k_d rate
    joints       q = q_0 + J_0^{-1} (p, lift, turn)        J_0 of each foot in the neutral stance
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .robot import FloatArray, Humanoid, load
from .walk_params import walk_params

__all__ = ["Clock", "Neutral", "neutral"]

_SIDE: FloatArray = np.array([1.0, -1.0])
_NEWTON = 20  # rounds: it converges in six


@dataclass(frozen=True, eq=False)
class Neutral:
    """The stance on two flat feet.

    Attributes
    ----------
    q : (12,) array
        Joint angles, left leg first.
    inverse : (2, 6, 6) array
        Joint angles of each leg by place (3) and turn (3) of its sole in the trunk's frame.
    height : float
        Of the trunk's origin, m.
    """

    q: FloatArray
    inverse: FloatArray
    height: float


@cache
def neutral() -> Neutral:
    """Joint angles that put the soles flat below the centre of mass, by Newton's method.

    Raises
    ------
    ValueError
        Without the extra ``mujoco``.
    """
    humanoid, steps = load(robot="berkeley"), walk_params().steps
    q = humanoid.model.key("home").qpos[7:].copy()
    for _ in range(_NEWTON):
        feet, centre = _feet(humanoid, q)
        for k, (place, turn, jacobian) in enumerate(feet):
            wanted = np.array([centre[0], _SIDE[k] * steps.width, -steps.height])
            q[6 * k : 6 * k + 6] += np.linalg.solve(jacobian, np.concatenate([wanted - place, -turn]))
    feet, _ = _feet(humanoid, q)
    inverse: FloatArray = np.asarray([np.linalg.inv(jacobian) for _, _, jacobian in feet], dtype=float)
    return Neutral(q, inverse, steps.height + humanoid.soles[0].height)


def _feet(
    humanoid: Humanoid, q: FloatArray
) -> tuple[list[tuple[FloatArray, FloatArray, FloatArray]], FloatArray]:
    """Place, turn and Jacobian (6, 6) of the soles, left first, in the trunk's frame, and the centre of mass."""
    mujoco, model, data = humanoid.mujoco, humanoid.model, humanoid.data()
    data.qpos[:7], data.qpos[7:] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), q
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    found = []
    for k, sole in enumerate(reversed(humanoid.soles)):
        place, turn = sole.frame(data)
        J = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, J[:3], J[3:], place, sole.body)
        found.append((place, Rotation.from_matrix(turn).as_rotvec(), J[:, 6 + 6 * k : 12 + 6 * k]))
    return found, np.array(data.subtree_com[1])


class Clock:
    """Phase and footholds of E robots.

    Parameters
    ----------
    size : int
        Number of robots.
    """

    def __init__(self, size: int) -> None:
        self.phase: FloatArray = np.zeros(size)
        self.place: FloatArray = np.zeros((size, 2, 3))
        self.airborne: NDArray[np.bool_] = np.zeros((size, 2), dtype=bool)

    def restart(self, which: NDArray[np.intp], phase: FloatArray) -> None:
        """Both feet at their neutral places.

        Parameters
        ----------
        which : (k,) int array
        phase : (k,) array
            Of the cycle, in [0, 1).
        """
        self.phase[which], self.place[which], self.airborne[which] = phase, 0.0, False

    def target(
        self, velocity: FloatArray, up: FloatArray, rate: FloatArray, command: FloatArray
    ) -> FloatArray:
        """Joint angles (E, 12) for the next step of the policy; the clock moves on.

        Parameters
        ----------
        velocity, up, rate : (E, 3) arrays
            Of the trunk, as ``Motion`` has them.
        command : (E, 3) array
            Speeds forwards and to the left, m/s, and turn rate, rad/s.
        """
        steps, servo, stance = walk_params().steps, walk_params().servo, neutral()
        dt = servo.timestep * servo.decimation
        self.phase = np.mod(self.phase + steps.frequency * dt, 1.0)
        part = 2.0 * np.stack([self.phase, np.mod(self.phase + 0.5, 1.0)], axis=1) / steps.duty
        airborne = part < 1.0
        swing = np.clip(part, 0.0, 1.0)
        gains = np.array([*steps.place, 0.0])
        measured = np.concatenate([velocity[:, :2], command[:, 2:]], axis=1)
        wanted = 0.25 / steps.frequency * command + gains * (measured - command)
        wanted = np.clip(wanted, -steps.reach, steps.reach)[:, None]
        landed = self.airborne & ~airborne
        self.place = np.where(landed[..., None], wanted, self.place)
        self.place = np.where(airborne[..., None], self.place, self.place - dt * command[:, None])
        self.airborne = airborne
        blend = (0.5 - 0.5 * np.cos(np.pi * swing))[..., None]
        place = np.where(airborne[..., None], self.place + blend * (wanted - self.place), self.place)
        place = np.clip(place, -steps.reach, steps.reach)
        moved = np.zeros((len(command), 2, 6))
        moved[..., 0] = place[..., 0] + steps.forward
        moved[..., 1] = place[..., 1] + (steps.sway * np.sin(2.0 * np.pi * self.phase))[:, None]
        moved[..., 2] = steps.lift * np.sin(np.pi * swing) ** 2
        pitch, roll = -up[:, 0], up[:, 1]
        moved[..., 3] = ~airborne * (steps.roll[0] * roll + steps.roll[1] * rate[:, 0])[:, None]
        moved[..., 4] = ~airborne * (steps.pitch[0] * pitch + steps.pitch[1] * rate[:, 1])[:, None]
        moved[..., 5] = place[..., 2]
        return stance.q + np.einsum("lij,elj->eli", stance.inverse, moved).reshape(-1, 12)

    def state(self) -> dict[str, NDArray[np.generic]]:
        """What the next target depends on."""
        return {"phase": self.phase.copy(), "place": self.place.copy(), "airborne": self.airborne.copy()}

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there.

        Parameters
        ----------
        state : dict
            Of :meth:`state`.
        """
        for name in ("phase", "place", "airborne"):
            setattr(self, name, np.array(state[name]))
