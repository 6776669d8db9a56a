"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

__all__ = ["Params", "params"]

Two = tuple[float, float]
Three = tuple[float, float, float]


@dataclass(frozen=True)
class Vehicle:
    """Platform, rotors and servos; the arm is ``phyfilter_ctl.plants.small_arm``."""

    mass: float
    inertia: Three
    rotor_arm: float
    torque_ratio: float
    motor_lag: float
    delay: float
    drag: Three
    gravity: float
    rotor_max: float
    servo_bandwidth: float
    servo_damping: float
    tilt_bandwidth: float
    force_smoothing: float


@dataclass(frozen=True)
class Sampling:
    """Rate of controllers and filters, and step of the integration."""

    dt: float
    max_step: float


@dataclass(frozen=True)
class Sensors:
    """Standard deviations of white noise."""

    position: float
    velocity: float
    attitude: float
    rate: float
    joint: float
    joint_rate: float


@dataclass(frozen=True)
class Mission:
    """Places and times of pick and place, the load, and what is scored."""

    start: Three
    pick: Three
    place: Three
    clearance: float
    approach: Two
    descend: Two
    grasp: Two
    load: float
    lift: Two
    carry: Two
    lower: Two
    settle: Two
    release: float
    leave: Two
    duration: float
    tolerance: float
    payload: float
    transfer: float
    left_out: float
    lift_off: float


@dataclass(frozen=True)
class Planner:
    """Limits and horizon of the planner; its weights and period are the paper's, the defaults."""

    horizon: int
    platform: tuple[Three, Three]
    workspace: tuple[Three, Three]
    platform_velocity: float
    platform_acceleration: float
    arm_velocity: float
    arm_acceleration: float


@dataclass(frozen=True)
class Wind:
    """The fan."""

    jet_speed: float
    jet_origin: Three
    jet_direction: Three
    jet_width: float
    turbulence: float
    airspeed: float
    length_scale: float


@dataclass(frozen=True)
class Training:
    """Flights that train SEER-I, and its features."""

    rates: Two
    duration: float
    train: tuple[int, ...]
    held_out: tuple[int, ...]
    move: float
    spacing: float
    l2: float


@dataclass(frozen=True)
class Tuning:
    """The one procedure that tunes every method."""

    modulus_margin: float
    jitter: float
    lag_factor: float
    sharpness: float
    damping: float
    seeds: tuple[int, ...]
    slowest: float
    fastest: float
    step: float
    force: Two
    torque: Two
    integral: Two
    points: int
    attitude: Two


@dataclass(frozen=True)
class Test:
    """The flights that are compared."""

    __test__ = False  # no test class

    seeds: int


@dataclass(frozen=True)
class Params:
    """All tables of the file."""

    vehicle: Vehicle
    sampling: Sampling
    sensors: Sensors
    mission: Mission
    planner: Planner
    wind: Wind
    training: Training
    tuning: Tuning
    test: Test


params: Callable[[], Params] = parameter_file(Path(__file__).with_name("params.toml"), Params)
"""The numbers of ``params.toml``."""
