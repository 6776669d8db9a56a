"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

__all__ = ["Params", "Robot", "params"]

Two = tuple[float, float]
Three = tuple[float, float, float]


@dataclass(frozen=True)
class Robot:
    """Bodies and joints."""

    name: str
    mass: float
    hip_mass: float
    thigh_mass: float
    shank_mass: float
    foot_mass: float
    trunk: Three
    hip_x: float
    hip_y: float
    abduction: float
    thigh: float
    shank: float
    foot_radius: float
    torque_limits: Three
    lower: Three
    upper: Three
    damping: float
    armature: float
    friction: float

    @property
    def leg_mass(self) -> float:
        """One of four, kg."""
        return self.hip_mass + self.thigh_mass + self.shank_mass + self.foot_mass

    @property
    def trunk_mass(self) -> float:
        """What the legs leave, kg."""
        return self.mass - 4.0 * self.leg_mass


@dataclass(frozen=True)
class Control:
    """Rates and gains."""

    dt: float
    decimation: int
    kp: float
    kd: float
    action_scale: float
    resolution: float
    action_limit: float


@dataclass(frozen=True)
class Gait:
    """The trot."""

    frequency: float
    frequency_high: float
    speed_low: float
    speed_high: float
    height: float
    clearance: float


@dataclass(frozen=True)
class FilterNumbers:
    """The paper's filter."""

    a0: float
    limit: float


@dataclass(frozen=True)
class Training:
    """PPO."""

    environments: int
    horizon: int
    iterations: int
    actor: tuple[int, ...]
    critic: tuple[int, ...]
    episode: float
    resample: float
    learning_rate: float
    epochs: int
    batches: int
    discount: float
    trace: float
    entropy: float
    deviation: float


@dataclass(frozen=True)
class Randomisation:
    """Drawn uniformly for every episode."""

    payload: Two
    velocity: Two
    gain: Two
    friction: Two
    noise_angle: float
    noise_rate: float


@dataclass(frozen=True)
class Reward:
    """Weights."""

    velocity: float
    turn: float
    width: float
    vertical: float
    rolling: float
    tilt: float
    height: float
    torque: float
    change: float
    fall: float


@dataclass(frozen=True)
class Fall:
    """What counts as one."""

    upright: float
    height: float


@dataclass(frozen=True)
class Push:
    """Lateral, on the trunk."""

    force: float
    duration: float


@dataclass(frozen=True)
class Judged:
    """What is judged."""

    phases: int
    duration: float
    left_out: float
    payloads: tuple[float, ...]
    speeds: tuple[float, ...]
    strength: float
    distance: float
    difficulties: tuple[float, ...]


@dataclass(frozen=True)
class Params:
    """All tables of the file."""

    robot: Robot
    control: Control
    gait: Gait
    filter: FilterNumbers
    training: Training
    randomisation: Randomisation
    reward: Reward
    fall: Fall
    push: Push
    test: Judged


params: Callable[[], Params] = parameter_file(Path(__file__).with_name("params.toml"), Params)
"""The numbers of ``params.toml``."""
