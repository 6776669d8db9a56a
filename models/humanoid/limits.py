"""The largest lateral force that is held, by bisection, in every stance, without the filter and with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.study import Report, silent

from .params import params
from .posture import tipping_force
from .regulator import Schedule, schedule
from .robot import Friction, Humanoid, load
from .trial import Mode, Trial, phyfilter, run

__all__ = ["PROFILES", "Comparison", "Limit", "StudyRow", "compare", "largest_force", "steps", "study"]

# Rise time of the force in s, by name.
PROFILES = {"sudden": 0.0, "slow": params().trial.rise}
DIRECTIONS = (1.0, -1.0)


@dataclass(frozen=True)
class Limit:
    """Largest force held in one case, N; ``capped`` where the largest one tried was."""

    stance: str
    profile: str
    direction: float
    mode: Mode
    force: float
    capped: bool


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that the report shows.

    Attributes
    ----------
    humanoid : Humanoid
    schedules : dict
        Of each stance.
    tipping : dict
        Static limit of each stance's upright posture in N, for y and -y.
    limits : tuple of Limit
    trials : dict
        By (stance, profile, force, mode).
    filter : PhyFilter
    duration : float
        Of a trial in s.
    """

    humanoid: Humanoid
    schedules: dict[str, Schedule]
    tipping: dict[str, tuple[float, float]]
    limits: tuple[Limit, ...]
    trials: dict[tuple[str, str, float, Mode], Trial]
    filter: PhyFilter
    duration: float

    def limit(self, stance: str, profile: str, direction: float, mode: Mode) -> Limit:
        """One of the limits.

        Parameters
        ----------
        stance, profile, direction, mode
            Which.
        """
        key = (stance, profile, direction, mode)
        (found,) = (
            each for each in self.limits if (each.stance, each.profile, each.direction, each.mode) == key
        )
        return found


@dataclass(frozen=True)
class StudyRow:
    """Largest forces of one variant: sudden and slow, along y and against it, N."""

    name: str
    sudden: tuple[float, float]
    slow: tuple[float, float]


def largest_force(
    humanoid: Humanoid,
    points: Schedule,
    direction: float,
    *,
    mode: Mode = "filter",
    rise: float = 0.0,
    filter: PhyFilter | None = None,
    noise: float = 0.0,
    duration: float | None = None,
) -> tuple[float, bool]:
    """Largest force held, and whether it is the largest one tried.

    Bisection takes for granted that a smaller force is easier. It is not always, by a few newtons.

    Parameters
    ----------
    humanoid : Humanoid
    points : Schedule
        Of the stance; its largest force is the largest one tried.
    direction : {1, -1}
        Along y.
    mode, rise, filter, noise, duration
        As for :func:`run`.
    """
    resolution = params().trial.resolution
    low, high = 0, round(float(points.forces[-1]) / resolution) + 1
    while high - low > 1:
        middle = (low + high) // 2
        trial = run(
            humanoid,
            points,
            direction * middle * resolution,
            mode=mode,
            rise=rise,
            filter=filter,
            noise=noise,
            duration=duration,
        )
        low, high = (middle, high) if trial.held else (low, middle)
    return low * resolution, high * resolution > float(points.forces[-1])


def steps(stances: tuple[str, ...], forces: tuple[float, ...]) -> int:
    """Number of steps that :func:`compare` reports.

    Parameters
    ----------
    stances, forces
        As for :func:`compare`.
    """
    return len(stances) * (1 + len(PROFILES) * 2 * (len(DIRECTIONS) + len(forces)))


def compare(
    stances: tuple[str, ...],
    forces: tuple[float, ...],
    *,
    gears: float = 1.0,
    friction: Friction = "pyramidal",
    filter: PhyFilter | None = None,
    duration: float | None = None,
    report: Report = silent,
) -> Comparison:
    """Trials at given forces, and the largest ones, without and with the filter.

    Parameters
    ----------
    stances : tuple of str
    forces : tuple of float
        Lateral hand forces in N: positive across the body, negative away from it.
    gears : float
        Factor on the motor torques.
    friction : {"pyramidal", "elliptic"}
        As for :func:`load`.
    filter : PhyFilter, optional
        None takes that of ``params.toml``.
    duration : float, optional
        Of a trial in s; None takes that of ``params.toml``.
    report : Report
        Told what is being computed.

    Raises
    ------
    ValueError
        For unknown stances, or numbers out of range.
    """
    humanoid, law = load(gears, friction), phyfilter() if filter is None else filter
    duration = params().trial.duration if duration is None else duration
    schedules = {name: schedule(humanoid, name, report=report) for name in stances}
    limits, trials = [], {}
    modes: tuple[Mode, ...] = ("alone", "filter")
    for name, points in schedules.items():
        for profile, rise in PROFILES.items():
            for mode in modes:
                for direction in DIRECTIONS:
                    report(f"{name} stance, {profile} force, {mode}")
                    found = largest_force(
                        humanoid, points, direction, mode=mode, rise=rise, filter=law, duration=duration
                    )
                    limits.append(Limit(name, profile, direction, mode, *found))
                for force in forces:
                    report(f"{name} stance, {force:g} N, {mode}")
                    trials[name, profile, force, mode] = run(
                        humanoid, points, force, mode=mode, rise=rise, filter=law, duration=duration
                    )
    tipping = {
        name: (
            tipping_force(humanoid, points.upright.posture, 1.0),
            tipping_force(humanoid, points.upright.posture, -1.0),
        )
        for name, points in schedules.items()
    }
    return Comparison(humanoid, schedules, tipping, tuple(limits), trials, law, duration)


def study(
    stance: str,
    *,
    friction: Friction = "pyramidal",
    duration: float | None = None,
    report: Report = silent,
) -> tuple[StudyRow, ...]:
    """Variants of the filter, of what is done with f_hat and of the sensors, in one stance.

    Parameters
    ----------
    stance : str
    friction : {"pyramidal", "elliptic"}
        As for :func:`load`.
    duration : float, optional
        Of a trial in s.
    report : Report
        Told what is being computed.
    """
    humanoid = load(friction=friction)
    points = schedule(humanoid, stance, report=report)
    band = PhyFilter([400.0, 40.0], [0.0, 40.0])
    type2 = PhyFilter([400.0, 40.0], [400.0, 40.0])
    variants: list[tuple[str, Mode, PhyFilter | None, float]] = [
        ("LQR alone", "alone", None, 0.0),
        ("f_hat off the motors, target unchanged", "torque", None, 0.0),
        *(
            (f"retarget, order 1, a0 = {a0:g} rad/s", "filter", phyfilter(a0, 1), 0.0)
            for a0 in (1.0, 5.0, 20.0, 60.0)
        ),
        ("retarget, order 2, poles 20 rad/s", "filter", phyfilter(20.0, 2), 0.0),
        ("retarget, order 2, N = D - s^2", "filter", type2, 0.0),
        ("retarget, band-pass, forgets constants", "filter", band, 0.0),
        ("LQR alone, velocity noise 0.01 rad/s, m/s", "alone", None, 0.01),
        ("retarget, velocity noise 0.001", "filter", None, 0.001),
        ("retarget, velocity noise 0.01", "filter", None, 0.01),
        ("retarget, velocity noise 0.01, a0 = 1 rad/s", "filter", phyfilter(1.0, 1), 0.01),
    ]
    rows = []
    for name, mode, law, noise in variants:
        report(name)
        found = {
            profile: tuple(
                largest_force(
                    humanoid,
                    points,
                    direction,
                    mode=mode,
                    rise=rise,
                    filter=law,
                    noise=noise,
                    duration=duration,
                )[0]
                for direction in DIRECTIONS
            )
            for profile, rise in PROFILES.items()
        }
        rows.append(
            StudyRow(name, (found["sudden"][0], found["sudden"][1]), (found["slow"][0], found["slow"][1]))
        )
    return tuple(rows)


def mean_estimate(trial: Trial) -> float:
    """Mean of F_hat over the last second in N.

    Parameters
    ----------
    trial : Trial
    """
    last = trial.time > trial.time[-1] - 1.0
    return float(np.mean(trial.f_hat[last]))
