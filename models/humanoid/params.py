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
    foot_force: float
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


@dataclass(frozen=True)
class Filter:
    """a_0 of each pole and the order of the PhyFilter."""

    a0: float
    order: int


@dataclass(frozen=True)
class Contacts:
    """Of the variant with elliptic friction cones."""

    impratio: float


@dataclass(frozen=True)
class TrialRules:
    """A trial, and when it is lost."""

    duration: float
    onset: float
    rise: float
    fallen: float
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
    filter: Filter
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
