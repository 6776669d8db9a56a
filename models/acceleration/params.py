"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

__all__ = ["Params", "params"]


@dataclass(frozen=True)
class Sampling:
    """Rate, amount and start of the generated flights."""

    dt: float
    train_samples: int
    test_samples: int
    train_flights: int
    test_flights: int
    substeps: int
    warm_up: float


@dataclass(frozen=True)
class SetPoints:
    """Velocity commands."""

    train_speed_low: float
    train_speed_high: float
    test_speed_high: float
    hold_low: float
    hold_high: float
    vertical: float
    smoothing: float


@dataclass(frozen=True)
class Vehicle:
    """Velocity loop and drag."""

    velocity_gain: float
    tilt_frequency: float
    tilt_damping: float
    acceleration_limit: float
    linear_drag: float
    quadratic_drag: float


@dataclass(frozen=True)
class Wind:
    """Gusts."""

    deviation: float
    time_constant: float


@dataclass(frozen=True)
class Sensor:
    """Error of the velocity estimate."""

    white: float
    coloured: float
    coloured_time_constant: float


@dataclass(frozen=True)
class Network:
    """The learned differentiator and its training."""

    units: int
    length: int
    spans: tuple[float, ...]
    l2: float
    iterations: int
    choice_iterations: int
    choice_interval: float


@dataclass(frozen=True)
class Filter:
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
class Linear:
    """What is fitted without a network."""

    orders: tuple[int, ...]
    starts: int
    taps: tuple[int, ...]


@dataclass(frozen=True)
class Study:
    """Ranges of the studies."""

    poles: tuple[float, ...]
    points: int
    orders: tuple[int, ...]
    longest: float


@dataclass(frozen=True)
class Convergence:
    """Gauss-Newton and the paper's Algorithm 2 from the same starts."""

    orders: tuple[int, ...]
    starts: int
    poles: tuple[float, ...]
    rates: tuple[float, ...]
    segment: float
    batch: int
    time: float


@dataclass(frozen=True)
class Scoring:
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
    linear: Linear
    study: Study
    convergence: Convergence
    scoring: Scoring


params: Callable[[], Params] = parameter_file(Path(__file__).with_name("params.toml"), Params)
"""The numbers of ``params.toml``."""
