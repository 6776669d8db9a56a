"""A policy as plain numbers: a small network in a JSON file, with the robot it is for and how it was trained.

    a = W_3 elu(W_2 elu(W_1 o + c_1) + c_2) + c_3,     q_d = trot(phase, command) + action_scale a

Observations o (47): the vertical in the trunk's frame (3), turn rates (3), command (3), joint angles off the neutral
stance (12), joint velocities (12), last action (12), sine and cosine of the gait's phase (2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import network
from .batch import Motion
from .gait import neutral
from .network import Network, read, save
from .params import ROBOTS, Params, params

__all__ = ["ACTIONS", "OBSERVATIONS", "Policy", "blurred", "load", "observe", "save", "shipped"]

FloatArray = NDArray[np.float64]

OBSERVATIONS, ACTIONS = 47, 12
FOLDER = Path(__file__).with_name("policies")


def observe(
    motion: Motion,
    phase: ArrayLike,
    command: ArrayLike,
    action: ArrayLike,
    *,
    parameters: Params | None = None,
) -> FloatArray:
    """What a policy sees.

    Parameters
    ----------
    motion : Motion
    phase : (E,) array
        Of the gait, rad.
    command : (E, 3) array
    action : (E, 12) array
        The last one.
    parameters : Params, optional

    Returns
    -------
    (E, 47) array
    """
    angle = np.asarray(phase, dtype=float)[:, None]
    parts = (
        motion.up,
        0.25 * motion.rate,
        np.asarray(command, dtype=float),
        motion.q - neutral(parameters=parameters),
        0.05 * motion.qd,
        np.asarray(action, dtype=float),
        np.sin(angle),
        np.cos(angle),
    )
    return np.concatenate(parts, axis=1)


def blurred(seen: FloatArray, rng: np.random.Generator, *, parameters: Params | None = None) -> FloatArray:
    """Observations with the sensors' noise, uniform.

    Parameters
    ----------
    seen : (E, 47) array
        Is changed.
    rng : numpy.random.Generator
    parameters : Params, optional
    """
    table, size = (params() if parameters is None else parameters).randomisation, len(seen)
    seen[:, :3] += table.noise_angle * rng.uniform(-1.0, 1.0, (size, 3))
    seen[:, 3:6] += 0.25 * table.noise_rate * rng.uniform(-1.0, 1.0, (size, 3))
    seen[:, 9:21] += table.noise_angle * rng.uniform(-1.0, 1.0, (size, 12))
    seen[:, 21:33] += 0.05 * table.noise_rate * rng.uniform(-1.0, 1.0, (size, 12))
    return seen


@dataclass(frozen=True, eq=False)
class Policy(Network):
    """A :class:`Network` that moves a quadruped."""

    def sizes(self) -> tuple[int, int, float]:
        """Observations, actions, and the limit of an action."""
        return OBSERVATIONS, ACTIONS, params(self.robot).control.action_limit


def load(path: Path) -> Policy:
    """Read a policy.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ValueError
        If the file is no policy, one of another robot, or its shapes are wrong.
    OSError
        If it cannot be read.
    """
    return read(path, Policy, ROBOTS)


@cache
def shipped(name: str) -> Policy:
    """A policy that comes with the model.

    Parameters
    ----------
    name : str
        Of the file, without its ending: "base-0", "filter-2".

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    return load(network.shipped(FOLDER, name))
