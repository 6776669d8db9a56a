"""The largest lateral force that is held, by bisection, in every stance, without the filter and with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, TypeAlias

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.study import Executor, Report, silent

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
    executor: Executor | None = None,
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
    executor : Executor, optional
        What runs the trials; None runs one after the other, here. The numbers are the same.

    Raises
    ------
    ValueError
        For unknown stances, or numbers out of range.
    """
    humanoid, law = _loaded(gears, friction), phyfilter() if filter is None else filter
    duration = params().trial.duration if duration is None else duration
    schedules = {name: schedule(humanoid, name, report=report) for name in stances}
    modes: tuple[Mode, ...] = ("alone", "filter")
    jobs, names = list[_Job](), list[str]()
    for name in stances:
        for profile in PROFILES:
            for mode in modes:
                jobs += [_Job(name, profile, mode, direction, True) for direction in DIRECTIONS]
                names += [f"{name} stance, {profile} force, {mode}"] * len(DIRECTIONS)
                jobs += [_Job(name, profile, mode, force, False) for force in forces]
                names += [f"{name} stance, {force:g} N, {mode}" for force in forces]
    work = partial(
        _answer, schedules=schedules, gears=gears, friction=friction, filter=law, duration=duration
    )
    limits, trials = list[Limit](), dict[tuple[str, str, float, Mode], Trial]()
    answers = (executor or Executor(1)).map(work, jobs, names=names, report=report)
    for job, answer in zip(jobs, answers, strict=True):
        if isinstance(answer, Limit):
            limits.append(answer)
        else:
            trials[job.stance, job.profile, job.force, job.mode] = answer
    tipping = {
        name: (
            tipping_force(humanoid, points.upright.posture, 1.0),
            tipping_force(humanoid, points.upright.posture, -1.0),
        )
        for name, points in schedules.items()
    }
    return Comparison(humanoid, schedules, tipping, tuple(limits), trials, law, duration)


@dataclass(frozen=True)
class _Job:
    stance: str
    profile: str
    mode: Mode
    force: float  # the direction alone, of a largest one
    largest: bool


# Not pickled: it holds the simulator.
_loaded = lru_cache(maxsize=2)(load)


def _answer(
    job: _Job,
    schedules: dict[str, Schedule],
    gears: float,
    friction: Friction,
    filter: PhyFilter,
    duration: float,
) -> Limit | Trial:
    humanoid, points, rise = _loaded(gears, friction), schedules[job.stance], PROFILES[job.profile]
    if not job.largest:
        return run(humanoid, points, job.force, mode=job.mode, rise=rise, filter=filter, duration=duration)
    found = largest_force(
        humanoid, points, job.force, mode=job.mode, rise=rise, filter=filter, duration=duration
    )
    return Limit(job.stance, job.profile, job.force, job.mode, *found)


def study(
    stance: str,
    *,
    friction: Friction = "pyramidal",
    duration: float | None = None,
    report: Report = silent,
    executor: Executor | None = None,
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
    executor : Executor, optional
        As for :func:`compare`.
    """
    points = schedule(_loaded(1.0, friction), stance, report=report)
    band = PhyFilter([400.0, 40.0], [0.0, 40.0])
    type2 = PhyFilter([400.0, 40.0], [400.0, 40.0])
    variants: list[_Variant] = [
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
    work = partial(_row, points=points, friction=friction, duration=duration)
    names = [name for name, *_ in variants]
    return tuple((executor or Executor(1)).map(work, variants, names=names, report=report))


# Name, mode, filter, noise.
_Variant: TypeAlias = tuple[str, Mode, PhyFilter | None, float]


def _row(variant: _Variant, points: Schedule, friction: Friction, duration: float | None) -> StudyRow:
    name, mode, law, noise = variant
    options: dict[str, Any] = {"mode": mode, "filter": law, "noise": noise, "duration": duration}
    found = {
        profile: tuple(
            largest_force(_loaded(1.0, friction), points, direction, rise=rise, **options)[0]
            for direction in DIRECTIONS
        )
        for profile, rise in PROFILES.items()
    }
    return StudyRow(name, (found["sudden"][0], found["sudden"][1]), (found["slow"][0], found["slow"][1]))


def mean_estimate(trial: Trial) -> float:
    """Mean of F_hat over the last second in N.

    Parameters
    ----------
    trial : Trial
    """
    last = trial.time > trial.time[-1] - 1.0
    return float(np.mean(trial.f_hat[last]))
