"""A trained network as plain numbers: a JSON file, with the robot it is for and how it was trained.

a = W_n elu(... elu(W_1 o + c_1) ...) + c_n,    cut at the action limit
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Network", "read", "save", "shipped"]

FloatArray = NDArray[np.float64]

FORMAT, VERSION = "phyfilter-ctl policy", 1
# Significant digits in a file: single precision was trained.
_DIGITS = 6


@dataclass(frozen=True, eq=False)
class Network(ABC):
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
        width, actions, _ = self.sizes()
        for k, (weights, bias) in enumerate(self.layers):
            if weights.ndim != 2 or weights.shape[1] != width or bias.shape != weights.shape[:1]:
                raise ValueError(
                    f"layer {k}: expected weights (n, {width}) and a bias (n,), got {weights.shape} and {bias.shape}"
                )
            if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
                raise ValueError(f"layer {k}: not all numbers are finite")
            width = len(bias)
        if width != actions:
            raise ValueError(f"expected {actions} actions, got {width}")

    @abstractmethod
    def sizes(self) -> tuple[int, int, float]:
        """Observations, actions, and the limit of an action."""

    def __call__(self, observations: ArrayLike) -> FloatArray:
        """Actions for observations (..., n), within the action limit."""
        x = np.asarray(observations, dtype=float)
        for weights, bias in self.layers[:-1]:
            x = x @ weights.T + bias
            x = np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
        weights, bias = self.layers[-1]
        limit = self.sizes()[2]
        return np.clip(x @ weights.T + bias, -limit, limit)


N = TypeVar("N", bound=Network)


def save(policy: Network, path: Path) -> None:
    """Write a policy.

    Parameters
    ----------
    policy : Network
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


def read(path: Path, kind: type[N], robots: Collection[str]) -> N:
    """Read a policy.

    Parameters
    ----------
    path : Path
    kind : type
        Of network.
    robots : collection of str
        That it may be of.

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
    robot = str(data.get("robot"))
    if robot not in robots:
        known = " or ".join(map(repr, robots))
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
        return kind(layers, robot, record)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _array(values: Any) -> FloatArray:
    found: FloatArray = np.asarray(values, dtype=float)
    return found


def shipped(folder: Path, name: str) -> Path:
    """The file of a policy: the one named, or one that comes with a model.

    Parameters
    ----------
    folder : Path
    name : str
        A path, or the name of a file of the folder without its ending.

    Raises
    ------
    ValueError
        If there is none.
    """
    for path in (Path(name), folder / f"{name}.json"):
        if path.is_file():
            return path
    there = ", ".join(sorted(entry.stem for entry in folder.glob("*.json"))) or "none"
    raise ValueError(
        f"no policy {name!r}: neither a file nor one of those that come with the model ({there})"
    )
