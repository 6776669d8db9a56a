"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Self

__all__ = ["PATH", "Params", "params"]

PATH = Path(__file__).with_name("params.toml")


@dataclass(frozen=True)
class _Group:
    """One table of the file; the fields are its keys."""

    @classmethod
    def read(cls, table: Mapping[str, Mapping[str, Any]]) -> Self:
        names = {entry.name for entry in fields(cls)}
        if names != set(table):
            raise ValueError(
                f"{PATH.name}: {cls.__name__} expects the keys {sorted(names)}, got {sorted(table)}"
            )
        return cls(**{name: _frozen(entry["value"]) for name, entry in table.items()})


@dataclass(frozen=True)
class Sampling(_Group):
    """Rate, amount and start of the generated flights."""

    dt: float
    train_samples: int
    test_samples: int
    train_flights: int
    test_flights: int
    substeps: int
    warm_up: float


@dataclass(frozen=True)
class SetPoints(_Group):
    """Velocity commands."""

    train_speed_low: float
    train_speed_high: float
    test_speed_high: float
    hold_low: float
    hold_high: float
    vertical: float
    smoothing: float


@dataclass(frozen=True)
class Vehicle(_Group):
    """Velocity loop and drag."""

    velocity_gain: float
    tilt_frequency: float
    tilt_damping: float
    acceleration_limit: float
    linear_drag: float
    quadratic_drag: float


@dataclass(frozen=True)
class Wind(_Group):
    """Gusts."""

    deviation: float
    time_constant: float


@dataclass(frozen=True)
class Sensor(_Group):
    """Error of the velocity estimate."""

    white: float
    coloured: float
    coloured_time_constant: float


@dataclass(frozen=True)
class Network(_Group):
    """The learned differentiator and its training."""

    units: int
    length: int
    spans: tuple[float, ...]
    l2: float
    iterations: int
    choice_iterations: int
    choice_interval: float


@dataclass(frozen=True)
class Filter(_Group):
    """What the tuner of the filters may do."""

    orders: tuple[int, ...]
    slower: float
    slowest: float
    fastest: float
    damping_low: float
    damping_high: float
    evaluations: int
    worthwhile: float


@dataclass(frozen=True)
class Study(_Group):
    """Ranges of the studies."""

    poles: tuple[float, ...]
    points: int
    orders: tuple[int, ...]
    longest: float


@dataclass(frozen=True)
class Convergence(_Group):
    """Gauss-Newton and the paper's Algorithm 2 from the same starts."""

    orders: tuple[int, ...]
    starts: int
    poles: tuple[float, ...]
    rates: tuple[float, ...]
    segment: float
    batch: int
    time: float


@dataclass(frozen=True)
class Scoring(_Group):
    """What counts."""

    left_out: float


@dataclass(frozen=True)
class Params:
    """All tables of the file."""

    sampling: Sampling
    setpoints: SetPoints
    vehicle: Vehicle
    wind: Wind
    sensor: Sensor
    network: Network
    filter: Filter
    study: Study
    convergence: Convergence
    scoring: Scoring


@cache
def params() -> Params:
    """The numbers of ``params.toml``.

    Raises
    ------
    ValueError
        If a table or a key is missing or not known.

    Examples
    --------
    >>> params().sampling.dt
    0.002
    """
    data = tomllib.loads(PATH.read_text(encoding="utf-8"))
    return Params(
        sampling=Sampling.read(data["sampling"]),
        setpoints=SetPoints.read(data["setpoints"]),
        vehicle=Vehicle.read(data["vehicle"]),
        wind=Wind.read(data["wind"]),
        sensor=Sensor.read(data["sensor"]),
        network=Network.read(data["network"]),
        filter=Filter.read(data["filter"]),
        study=Study.read(data["study"]),
        convergence=Convergence.read(data["convergence"]),
        scoring=Scoring.read(data["scoring"]),
    )


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value
