"""The numbers of ``params.toml``, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phyfilter_ctl.study import parameter_file

__all__ = ["STANCES", "Params", "Stance", "params", "stance"]

STANCES = ("normal", "wide", "wider")


@dataclass(frozen=True)
class Stance:
    """How far apart the legs are."""

    hip: float


@dataclass(frozen=True)
class Statics:
    """Weight and limits of a posture."""

    posture: float
    hip_flexion: float
    shoulder: float
    torque_share: float
    foot_share: float
    friction_share: float


@dataclass(frozen=True)
class Regulator:
    """Weights of the LQR."""

    centre: float
    height: float
    centre_rate: float
    root: float
    joint: float
    arm: float
    rate: float
    control: float


@dataclass(frozen=True)
class ScheduleGrid:
    """Forces with a set-point of their own."""

    largest: float
    spacing: float
    forward: float


@dataclass(frozen=True)
class Berkeley:
    """What is its own: sampling, set-points, resolution of a force, the filter's a_0."""

    timestep: float
    largest: float
    forward: float
    spacing: float
    resolution: float
    a0: float


@dataclass(frozen=True)
class Filter:
    """a_0 of each pole and the order of the PhyFilter."""

    a0: float
    order: int


@dataclass(frozen=True)
class Sensors:
    """What is measured beside the truth."""

    velocity_noise: float


@dataclass(frozen=True)
class Contacts:
    """With elliptic friction cones."""

    impratio: float


@dataclass(frozen=True)
class TrialRules:
    """A trial, and when it is lost."""

    duration: float
    study_duration: float
    onset: float
    rise: float
    fallen: float
    slide: float
    tuning_seeds: tuple[int, ...]
    test_seeds: tuple[int, ...]
    resolution: float


@dataclass(frozen=True)
class Params:
    """All tables of the file."""

    normal: Stance
    wide: Stance
    wider: Stance
    statics: Statics
    regulator: Regulator
    schedule: ScheduleGrid
    berkeley: Berkeley
    filter: Filter
    sensors: Sensors
    contacts: Contacts
    trial: TrialRules


params: Callable[[], Params] = parameter_file(Path(__file__).with_name("params.toml"), Params)
"""The numbers of ``params.toml``."""


def stance(name: str) -> Stance:
    """The stance of a name.

    Parameters
    ----------
    name : {"normal", "wide", "wider"}

    Raises
    ------
    ValueError
        If there is no such stance.
    """
    if name not in STANCES:
        raise ValueError(f"stance: expected one of {', '.join(STANCES)}, got {name!r}")
    return getattr(params(), name)
