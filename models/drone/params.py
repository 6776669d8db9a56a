"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

__all__ = ["Params", "params"]

Three = tuple[float, float, float]


@dataclass(frozen=True)
class Vehicle:
    """The multirotor."""

    mass: float
    inertia: Three
    arm: float
    torque_ratio: float
    motor_lag: float
    delay: float
    drag: Three
    gravity: float
    rotor_max: float


@dataclass(frozen=True)
class Sampling:
    """Rate of controllers and filter, and step of the integration."""

    dt: float
    max_step: float


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of white noise."""

    position: float
    velocity: float
    attitude: float
    rate: float
    specific_force: float


@dataclass(frozen=True)
class Mission:
    """The circle, and what is scored."""

    speed: float
    radius: float
    height: float
    ramp: float
    duration: float
    left_out: float


@dataclass(frozen=True)
class MassRange:
    """Unknown mass, drawn uniformly."""

    low: float
    high: float


@dataclass(frozen=True)
class Wind:
    """The fan and the hall."""

    jet_speed_low: float
    jet_speed_high: float
    jet_width: float
    jet_offset: float
    fan_distance: float
    mean: float
    turbulence: float
    airspeed: float
    length_scale: float


@dataclass(frozen=True)
class Seeds:
    """Which flights train, tune and test."""

    train: tuple[int, ...]
    tune: tuple[int, ...]
    test: int


@dataclass(frozen=True)
class Seer:
    """SEER-I."""

    degree: int
    history: float
    prediction: float
    l2: float


@dataclass(frozen=True)
class L1:
    """L1 adaptive."""

    pole: float


@dataclass(frozen=True)
class Tuning:
    """The one procedure that tunes every method."""

    modulus_margin: float
    duration: float
    lag_factor: float
    jitter: float
    sharpness: float
    damping: float
    slowest: float
    fastest: float
    step: float
    bandwidths: tuple[float, float]
    studied: tuple[float, float]
    integral: tuple[float, float]
    points: int


@dataclass(frozen=True)
class Params:
    """All tables of the file."""

    vehicle: Vehicle
    sampling: Sampling
    sensors: Sensors
    mission: Mission
    mass: MassRange
    wind: Wind
    seeds: Seeds
    seer: Seer
    l1: L1
    tuning: Tuning


params: Callable[[], Params] = parameter_file(Path(__file__).with_name("params.toml"), Params)
"""The numbers of ``params.toml``."""
