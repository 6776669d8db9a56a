"""The numbers of ``params.toml``, and of the robots that differ from it, read once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from phyfilter_ctl.study import read_parameters

__all__ = ["ROBOTS", "Params", "Robot", "params"]

FOLDER = Path(__file__).parent
# The robots by name, each with the file that says where it differs from the first.
ROBOTS: dict[str, Path | None] = {"lite3-primitives": None, "go1": FOLDER / "go1" / "params.toml"}

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
    file: str
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    inertia: tuple[float, ...]
    speed_limits: tuple[float, ...]

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
    delay: int
    noise_angle: float
    noise_rate: float
    observed_noise: float


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
    full_payload: Two
    full_strength: Two
    full_push: float


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
    grounds: int


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


@cache
def params(robot: str = "lite3-primitives") -> Params:
    """The numbers of a robot.

    Parameters
    ----------
    robot : str
        Of ``ROBOTS``; what its own file leaves out is that of ``params.toml``.

    Raises
    ------
    ValueError
        For another robot.

    Examples
    --------
    >>> params("go1").robot.torque_limits
    (23.7, 23.7, 35.55)
    """
    if robot not in ROBOTS:
        raise ValueError(f"expected one of the robots {', '.join(ROBOTS)}, got {robot!r}")
    usual, own = FOLDER / "params.toml", ROBOTS[robot]
    return read_parameters(usual, Params) if own is None else read_parameters(own, Params, defaults=usual)
