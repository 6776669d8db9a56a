"""The numbers of ``berkeley/walk.toml``: steps, drives, training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

from ..quadruped.params import Fall, Three, Training, Two
from ..quadruped.params import Reward as WalkReward

__all__ = ["Practice", "Reward", "Servo", "Steps", "Trials", "WalkParams", "walk_params"]


@dataclass(frozen=True)
class Servo:
    """Position drives of the joints, each leg from the hip down."""

    timestep: float
    decimation: int
    kp: tuple[float, ...]
    kd: tuple[float, ...]
    resolution: float
    action_scale: float
    action_limit: float


@dataclass(frozen=True)
class Steps:
    """The stepping that the policy corrects."""

    height: float
    width: float
    forward: float
    frequency: float
    duty: float
    lift: float
    place: Two
    pitch: Two
    roll: Two
    sway: float
    reach: float


@dataclass(frozen=True)
class Practice:
    """Drawn uniformly for every episode, or for every stretch of it."""

    timestep: float
    velocity: Three
    still: float
    force: float
    free: float
    told: float
    shove: float
    friction: Two
    gain: Two
    noise_angle: float
    noise_rate: float
    noise_velocity: float


@dataclass(frozen=True)
class Reward(WalkReward):
    """Weights, one more than a quadruped's."""

    action: float


@dataclass(frozen=True)
class Trials:
    """What policies are judged by."""

    forces: tuple[float, ...]
    speed: float


@dataclass(frozen=True)
class WalkParams:
    """All tables of the file."""

    servo: Servo
    steps: Steps
    training: Training
    practice: Practice
    reward: Reward
    fall: Fall
    trial: Trials


walk_params: Callable[[], WalkParams] = parameter_file(
    Path(__file__).with_name("berkeley") / "walk.toml", WalkParams
)
"""The numbers of ``berkeley/walk.toml``."""
