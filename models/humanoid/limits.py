"""The largest lateral force that is held, by bisection, in every stance, without the filter and with it."""

from __future__ import annotations

from collections.abc import Sequence
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
from .trial import Mode, Trial, phyfilter, run, settings

__all__ = [
    "PROFILES",
    "Comparison",
    "Limit",
    "StudyRow",
    "compare",
    "largest_force",
    "steps",
    "study",
    "study_steps",
]

# Rise time of the force in s, by name.
PROFILES = {"sudden": 0.0, "slow": params().trial.rise}
DIRECTIONS = (1.0, -1.0)
# Of the filter in the study, rad/s.
SPEEDS = (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 20.0)


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
    duration, noise : float
        Of a trial in s; of the velocities, standard deviation in rad/s and m/s.
    """

    humanoid: Humanoid
    schedules: dict[str, Schedule]
    tipping: dict[str, tuple[float, float]]
    limits: tuple[Limit, ...]
    trials: dict[tuple[str, str, float, Mode], Trial]
    filter: PhyFilter
    duration: float
    noise: float

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
    heading: float = 90.0,
    rise: float = 0.0,
    filter: PhyFilter | None = None,
    noise: float | None = None,
    seeds: Sequence[int] | None = None,
    duration: float | None = None,
    resolution: float | None = None,
) -> tuple[float, bool]:
    """Largest force held with every seed of the noise, and whether it is the largest one tried.

    Bisection with the first seed, then downwards until the others hold too. It takes for granted that a smaller force
    is easier, which it is not always, by a few newtons.

    Parameters
    ----------
    humanoid : Humanoid
    points : Schedule
        Of the stance; its largest force is the largest one tried.
    direction : {1, -1}
        Along the heading, by default y.
    mode, heading, rise, filter, noise, duration
        As for :func:`run`.
    seeds : sequence of int, optional
        None takes the test seeds of ``params.toml``.
    resolution : float, optional
        Of the force in N; None takes that of ``params.toml``.
    """
    resolution = params().trial.resolution if resolution is None else resolution
    first, *others = params().trial.test_seeds if seeds is None else seeds
    top = int(points.reach(heading) / resolution + 1e-9)

    def held(count: int, seed: int) -> bool:
        force = direction * count * resolution
        options: dict[str, Any] = {"heading": heading, "noise": noise, "seed": seed, "duration": duration}
        return run(humanoid, points, force, mode=mode, rise=rise, filter=filter, **options).held

    low, high = 0, top + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if held(middle, first) else (low, middle)
    while low > 0 and not all(held(low, seed) for seed in others):
        low -= 1
    return low * resolution, low == top


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
    friction: Friction = "elliptic",
    filter: PhyFilter | None = None,
    noise: float | None = None,
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
    noise, duration : float, optional
        As for :func:`run`.
    report : Report
        Told what is being computed.
    executor : Executor, optional
        What runs the trials; None runs one after the other, here. The numbers are the same.

    Raises
    ------
    ValueError
        For unknown stances, or numbers out of range.
    """
    humanoid, (law, noise, duration) = _loaded(gears, friction), settings(filter, noise, duration)
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
        _answer,
        schedules=schedules,
        gears=gears,
        friction=friction,
        filter=law,
        noise=noise,
        duration=duration,
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
    return Comparison(humanoid, schedules, tipping, tuple(limits), trials, law, duration, noise)


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
    noise: float,
    duration: float,
) -> Limit | Trial:
    humanoid, points = _loaded(gears, friction), schedules[job.stance]
    options: dict[str, Any] = {
        "mode": job.mode,
        "rise": PROFILES[job.profile],
        "filter": filter,
        "noise": noise,
        "duration": duration,
    }
    if not job.largest:
        return run(humanoid, points, job.force, seed=params().trial.test_seeds[0], **options)
    found = largest_force(humanoid, points, job.force, **options)
    return Limit(job.stance, job.profile, job.force, job.mode, *found)


def study(
    stance: str,
    *,
    friction: Friction = "elliptic",
    duration: float | None = None,
    report: Report = silent,
    executor: Executor | None = None,
) -> tuple[StudyRow, ...]:
    """Variants of the filter, of what is done with f_hat and of the sensors, in one stance, with the tuning seeds.

    Parameters
    ----------
    stance : str
    friction : {"pyramidal", "elliptic"}
        As for :func:`load`.
    duration : float, optional
        Of a trial in s; None takes the study's of ``params.toml``.
    report : Report
        Told what is being computed.
    executor : Executor, optional
        As for :func:`compare`.
    """
    points = schedule(_loaded(1.0, friction), stance, report=report)
    duration, variants = params().trial.study_duration if duration is None else duration, _variants()
    work = partial(_row, points=points, friction=friction, duration=duration)
    names = [name for name, *_ in variants]
    return tuple((executor or Executor(1)).map(work, variants, names=names, report=report))


def study_steps(stances: tuple[str, ...]) -> int:
    """Number of steps that :func:`study` reports for so many stances.

    Parameters
    ----------
    stances : tuple of str
    """
    return len(stances) * (1 + len(_variants()))


# Name, mode, filter, noise.
_Variant: TypeAlias = tuple[str, Mode, PhyFilter | None, float]


def _variants() -> list[_Variant]:
    a0, noise = params().filter.a0, params().sensors.velocity_noise
    band = PhyFilter([a0**2, 2.0 * a0], [0.0, 2.0 * a0])
    type2 = PhyFilter([a0**2, 2.0 * a0], [a0**2, 2.0 * a0])
    return [
        ("LQR alone", "alone", None, noise),
        ("the true force told", "told", None, noise),
        ("f_hat off the motors, target unchanged", "torque", None, noise),
        *((f"retarget, order 1, a0 = {a:g} rad/s", "filter", phyfilter(a, 1), noise) for a in SPEEDS),
        (f"retarget, order 2, poles {a0:g} rad/s", "filter", phyfilter(a0, 2), noise),
        ("retarget, order 2, N = D - s^2", "filter", type2, noise),
        ("retarget, band-pass, forgets constants", "filter", band, noise),
        *(
            (f"retarget, a0 = {a:g}, velocity noise {level:g}", "filter", phyfilter(a, 1), level)
            for level, a in ((0.0, a0), (0.0, 20.0), (0.01, a0), (0.01, 1.0))
        ),
        ("LQR alone, velocity noise 0.01", "alone", None, 0.01),
    ]


def _row(variant: _Variant, points: Schedule, friction: Friction, duration: float | None) -> StudyRow:
    name, mode, law, noise = variant
    options: dict[str, Any] = {
        "mode": mode,
        "filter": law,
        "noise": noise,
        "seeds": params().trial.tuning_seeds,
        "duration": duration,
    }
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
