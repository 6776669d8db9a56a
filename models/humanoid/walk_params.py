"""The numbers of ``berkeley/walk.toml``: steps, drives, training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

from ..quadruped.params import Training

__all__ = ["Falls", "Practice", "Reward", "Servo", "Steps", "Trials", "WalkParams", "walk_params"]

Two = tuple[float, float]
Three = tuple[float, float, float]


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
    action: float
    fall: float


@dataclass(frozen=True)
class Falls:
    """What counts as one."""

    upright: float
    height: float


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
    fall: Falls
    trial: Trials


walk_params: Callable[[], WalkParams] = parameter_file(
    Path(__file__).with_name("berkeley") / "walk.toml", WalkParams
)
"""The numbers of ``berkeley/walk.toml``."""
