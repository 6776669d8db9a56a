"""A policy as plain numbers: a small network in a JSON file, with the robot it is for and how it was trained.

    a = W_3 elu(W_2 elu(W_1 o + c_1) + c_2) + c_3,     q_d = trot(phase, command) + action_scale a

Observations o (47): the vertical in the trunk's frame (3), turn rates (3), command (3), joint angles off the neutral
stance (12), joint velocities (12), last action (12), sine and cosine of the gait's phase (2).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .batch import Motion
from .gait import neutral
from .params import ROBOTS, Params, params

__all__ = ["ACTIONS", "OBSERVATIONS", "Policy", "blurred", "load", "observe", "save", "shipped"]

FloatArray = NDArray[np.float64]

FORMAT, VERSION = "phyfilter-ctl policy", 1
OBSERVATIONS, ACTIONS = 47, 12
FOLDER = Path(__file__).with_name("policies")
# Significant digits in a file: single precision was trained.
_DIGITS = 6


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
class Policy:
    """A trained network.

    Parameters
    ----------
    layers : tuple of (weights, bias)
        (n_out, n_in) and (n_out,) arrays.
    robot : str
        The robot it was trained on.
    record : mapping
        How: seed, steps, filter, reward curve.

    Raises
    ------
    ValueError
        For layers that do not fit one another, the observations or the actions, or numbers that are not finite.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]
    robot: str
    record: Mapping[str, Any]

    def __post_init__(self) -> None:
        width = OBSERVATIONS
        for k, (weights, bias) in enumerate(self.layers):
            if weights.ndim != 2 or weights.shape[1] != width or bias.shape != weights.shape[:1]:
                raise ValueError(
                    f"layer {k}: expected weights (n, {width}) and a bias (n,), got {weights.shape} and {bias.shape}"
                )
            if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
                raise ValueError(f"layer {k}: not all numbers are finite")
            width = len(bias)
        if width != ACTIONS:
            raise ValueError(f"expected {ACTIONS} actions, got {width}")

    def __call__(self, observations: ArrayLike) -> FloatArray:
        """Actions for observations (..., 47): (..., 12), within the action limit."""
        x = np.asarray(observations, dtype=float)
        for weights, bias in self.layers[:-1]:
            x = x @ weights.T + bias
            x = np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
        weights, bias = self.layers[-1]
        limit = params(self.robot).control.action_limit
        return np.clip(x @ weights.T + bias, -limit, limit)


def save(policy: Policy, path: Path) -> None:
    """Write a policy.

    Parameters
    ----------
    policy : Policy
    path : Path
        JSON.
    """
    from phyfilter_ctl._output import write_text

    layers = [{"weights": _rounded(weights), "bias": _rounded(bias)} for weights, bias in policy.layers]
    head = {
        "format": FORMAT,
        "version": VERSION,
        "robot": policy.robot,
        "shapes": [list(weights.shape) for weights, _ in policy.layers],
        "activation": "elu",
        "record": dict(policy.record),
        "layers": layers,
    }
    write_text(str(path), json.dumps(head, allow_nan=False, separators=(",", ":")) + "\n")


def _rounded(values: FloatArray) -> list[Any]:
    if values.ndim > 1:
        return [_rounded(row) for row in values]
    return [float(f"{value:.{_DIGITS}g}") for value in values]


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
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: expected a policy in JSON: {error}") from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f'{path}: expected a file with "format": "{FORMAT}"')
    if data.get("version") != VERSION:
        raise ValueError(f"{path}: version {data.get('version')}, this one reads {VERSION}")
    robot = data.get("robot")
    if robot not in ROBOTS:
        known = " or ".join(map(repr, ROBOTS))
        raise ValueError(f"{path}: a policy of the robot {robot!r}, expected {known}")
    if data.get("activation") != "elu":
        raise ValueError(f"{path}: activation {data.get('activation')!r}, expected 'elu'")
    try:
        layers = tuple((_array(entry["weights"]), _array(entry["bias"])) for entry in data["layers"])
        shapes = [tuple(shape) for shape in data["shapes"]]
        record = data["record"]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: damaged, {type(error).__name__}: {error}") from None
    if shapes != [weights.shape for weights, _ in layers]:
        raise ValueError(f"{path}: shapes {shapes} are announced, {[w.shape for w, _ in layers]} are there")
    try:
        return Policy(layers, robot, record)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _array(values: Any) -> FloatArray:
    found: FloatArray = np.asarray(values, dtype=float)
    return found


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
    path = FOLDER / f"{name}.json"
    if not path.is_file():
        there = ", ".join(sorted(entry.stem for entry in FOLDER.glob("*.json"))) or "none"
        raise ValueError(f"no policy {name!r}; there are: {there}")
    return load(path)
