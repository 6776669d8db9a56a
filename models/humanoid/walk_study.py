"""How often policies stand or walk for a minute under a force, by what they are told: the trials and their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.study import Executor, Report, silent

from .around import HEADINGS
from .limits import PROFILES
from .params import params
from .trial import Mode, settings
from .walk_params import walk_params
from .walks import Case, Fate, Policy, load, march

__all__ = ["ANSWERS", "STEPS_ALONE", "Cell", "Marches", "figures", "steps", "study", "table"]

ANSWERS: dict[Mode, str] = {
    "alone": "policy",
    "torque": "f_hat off the motors",
    "filter": "told F_hat",
    "told": "told the true force",
}
# Name in place of a policy: the clocked steps without one.
STEPS_ALONE = "steps"
_SIDES = ("left", "right")


@dataclass(frozen=True)
class Cell:
    """Robots that are simulated together: a policy under one force, by all headings and answers."""

    policy: str
    grip: str
    profile: str
    force: float
    speed: float

    @property
    def headings(self) -> tuple[str, ...]:
        """Of the force: all around in place, from the sides when walking."""
        return _SIDES if self.speed else tuple(HEADINGS)

    def cases(self) -> list[Case]:
        """Every answer under every heading."""
        return [
            Case(self.force, HEADINGS[name], self.profile, mode, self.speed)
            for mode in ANSWERS
            if self.policy != STEPS_ALONE or mode in ("alone", "torque")  # steps cannot be told
            for name in self.headings
        ]


@dataclass(frozen=True, eq=False)
class Marches:
    """Everything that the report shows.

    Attributes
    ----------
    fates : dict
        Of each cell: one for each answer and heading.
    duration, noise : float
        Of a trial in s; of the velocities.
    filter : PhyFilter
    """

    fates: dict[Cell, tuple[Fate, ...]]
    duration: float
    noise: float
    filter: PhyFilter

    def of(self, cell: Cell, mode: Mode) -> list[Fate]:
        """Trials of one cell with one answer.

        Parameters
        ----------
        cell, mode
            Which.
        """
        return [each for each in self.fates[cell] if each.case.mode == mode]


def _jobs(
    policies: Sequence[str], grips: Sequence[str], profiles: Sequence[str], forces: Sequence[float]
) -> list[Cell]:
    walking = walk_params().trial.speed
    return [
        Cell(policy, grip, profile, force, speed)
        for policy in policies
        for grip in grips
        for profile in profiles
        for speed in ((0.0, walking) if profile == "slow" else (0.0,))
        for force in forces
    ]


def steps(
    policies: Sequence[str], grips: Sequence[str], profiles: Sequence[str], forces: Sequence[float]
) -> int:
    """Number of steps that :func:`study` reports.

    Parameters
    ----------
    policies, grips, profiles, forces
        As for :func:`study`.
    """
    return len(_jobs(policies, grips, profiles, forces))


def study(
    policies: Sequence[str],
    grips: Sequence[str] = ("torso", "pelvis"),
    profiles: Sequence[str] = tuple(PROFILES),
    forces: Sequence[float] | None = None,
    *,
    filter: PhyFilter | None = None,
    noise: float | None = None,
    duration: float | None = None,
    report: Report = silent,
    executor: Executor | None = None,
) -> Marches:
    """Step in place under forces from all around, and walk under slow ones from the sides.

    Parameters
    ----------
    policies : sequence of str
        Files, names of shipped ones, or "steps" for the clocked steps alone.
    grips : sequence of {"torso", "pelvis"}
    profiles : sequence of {"sudden", "slow"}
    forces : sequence of float, optional
        N; None takes those of ``berkeley/walk.toml``.
    filter, noise, duration, report, executor
        As for :func:`~models.humanoid.around.around`.

    Raises
    ------
    ValueError
        For unknown policies or numbers out of range.
    """
    for name in policies:
        _policy(name)
    forces = walk_params().trial.forces if forces is None else tuple(forces)
    law, noise, duration = settings(filter, noise, duration, robot="berkeley")
    jobs = _jobs(policies, grips, profiles, forces)
    names = [f"{job.policy}, {job.grip}, {job.profile} {job.force:g} N, {job.speed:g} m/s" for job in jobs]
    work = partial(_march, law=law, noise=noise, duration=duration)
    found = (executor or Executor(1)).map(work, jobs, names=names, report=report)
    fates = dict(zip(jobs, found, strict=True))
    return Marches(fates, duration, noise, law)


@lru_cache(maxsize=8)
def _policy(name: str) -> Policy | None:
    return None if name == STEPS_ALONE else load(name)


def _march(job: Cell, law: PhyFilter, noise: float, duration: float) -> tuple[Fate, ...]:
    return march(
        job.cases(),
        _policy(job.policy),
        grip=job.grip,
        filter=law,
        noise=noise,
        seed=params().trial.test_seeds[0],
        duration=duration,
    )


def table(found: Marches) -> str:
    """Trials that stood to the end, as text.

    Parameters
    ----------
    found : Marches
    """
    cells = list(found.fates)
    policies, forces = (
        tuple(dict.fromkeys(cell.policy for cell in cells)),
        tuple(dict.fromkeys(cell.force for cell in cells)),
    )
    lines = [
        f"Berkeley Humanoid, trials of {found.duration:g} s, velocity noise {found.noise:g}, "
        f"a0 = {-found.filter.poles()[0].real:g} rad/s; policies: {', '.join(policies)}",
        f"{'robots that stood to the end, one number a policy':<52}"
        + "".join(f"{f'{force:g} N':>16}" for force in forces),
    ]
    for grip, profile, speed in dict.fromkeys((cell.grip, cell.profile, cell.speed) for cell in cells):
        motion = f"walking at {speed:g} m/s, from both sides" if speed else "in place, from all sides"
        lines.append(f"{grip}, {profile}, {motion}")
        for mode, answer in ANSWERS.items():
            row = [
                " ".join(
                    _held(found.of(Cell(policy, grip, profile, force, speed), mode)) for policy in policies
                )
                for force in forces
            ]
            lines.append(f"  {answer:<50}" + "".join(f"{each:>16}" for each in row))
    return "\n".join([*lines, *_motion(found)])


def _held(fates: Sequence[Fate]) -> str:
    return f"{sum(each.held for each in fates)}/{len(fates)}" if fates else "-"


def _motion(found: Marches) -> list[str]:
    """Drift, footfalls and errors of the estimate, of those that stood."""
    standing = [each for fates in found.fates.values() for each in fates if each.held]
    if not standing:
        return ["nobody stood to the end"]
    lines = [
        "of those that stood: drift off the command, m/s, median (largest); footfalls a minute; |F_hat - F|, N"
    ]
    for mode, answer in ANSWERS.items():
        mine = [each for each in standing if each.case.mode == mode]
        if not mine:
            continue
        drift = [float(np.hypot(each.velocity[0] - each.case.speed, each.velocity[1])) for each in mine]
        rate = [60.0 * each.steps / each.time for each in mine]
        off = [abs(each.estimate - each.case.force) for each in mine]
        estimate = f"{np.median(off):.2f}" if np.isfinite(off).all() else "-"
        lines.append(
            f"  {answer:<50}{np.median(drift):.3f} ({max(drift):.3f})   {np.median(rate):.0f}   {estimate}"
        )
    return lines


def figures(found: Marches) -> dict[str, object]:
    """The same, for JSON.

    Parameters
    ----------
    found : Marches
    """
    return {
        "robot": "berkeley",
        "duration_s": found.duration,
        "velocity_noise": found.noise,
        "seed": params().trial.test_seeds[0],
        "filter": {"a": found.filter.a.tolist(), "b": found.filter.b.tolist()},
        "trials": [
            {
                "policy": cell.policy,
                "grip": cell.grip,
                "profile": cell.profile,
                "force_n": cell.force,
                "speed_m_s": cell.speed,
                "heading_deg": each.case.heading,
                "mode": each.case.mode,
                "held": each.held,
                "time_s": each.time,
                "velocity_m_s": [value if np.isfinite(value) else None for value in each.velocity],
                "footfalls": each.steps,
                "estimate_n": each.estimate if np.isfinite(each.estimate) else None,
            }
            for cell, fates in found.fates.items()
            for each in fates
        ],
    }
