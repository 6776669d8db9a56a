"""The Berkeley Humanoid pulled from eight sides: the largest force held by the LQR, and with what a filter gives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.study import Executor, Report, silent

from .limits import PROFILES, largest_force
from .params import params
from .posture import tipping_force
from .regulator import Schedule, schedule
from .robot import GRIPS, Friction, Humanoid, load
from .trial import Mode, settings

__all__ = ["ANSWERS", "HEADINGS", "Around", "Held", "around", "figures", "steps", "table"]

HEADINGS = {
    "front": 0.0,
    "front left": 45.0,
    "left": 90.0,
    "back left": 135.0,
    "back": 180.0,
    "back right": 225.0,
    "right": 270.0,
    "front right": 315.0,
}
ANSWERS: dict[Mode, str] = {
    "alone": "LQR alone",
    "torque": "f_hat off the motors",
    "filter": "target moved by F_hat",
    "told": "true force told",
}
_STANCE = "normal"


@dataclass(frozen=True)
class Held:
    """Largest force held in one case, N; ``capped`` where the largest one tried was."""

    grip: str
    profile: str
    mode: Mode
    heading: str
    force: float
    capped: bool


@dataclass(frozen=True, eq=False)
class Around:
    """Everything that the report shows.

    Attributes
    ----------
    humanoid : Humanoid
    tipping : dict
        Force in N at which the upright posture, taken as rigid, tips; by (grip, heading).
    held : tuple of Held
    filter : PhyFilter
    duration, noise : float
        Of a trial in s; of the velocities.
    """

    humanoid: Humanoid
    tipping: dict[tuple[str, str], float]
    held: tuple[Held, ...]
    filter: PhyFilter
    duration: float
    noise: float

    def row(self, grip: str, profile: str, mode: Mode) -> tuple[Held, ...]:
        """The limits of one line of the table, in the order of the headings tried.

        Parameters
        ----------
        grip, profile, mode
            Which.
        """
        return tuple(
            each for each in self.held if (each.grip, each.profile, each.mode) == (grip, profile, mode)
        )


def steps(grips: Sequence[str], headings: Sequence[str], profiles: Sequence[str]) -> int:
    """Number of steps that :func:`around` reports.

    Parameters
    ----------
    grips, headings, profiles
        As for :func:`around`.
    """
    return len(grips) * (1 + len(profiles) * len(ANSWERS) * len(headings))


def around(
    grips: Sequence[str] = tuple(GRIPS["berkeley"]),
    headings: Sequence[str] = tuple(HEADINGS),
    profiles: Sequence[str] = tuple(PROFILES),
    *,
    gears: float = 1.0,
    friction: Friction = "elliptic",
    filter: PhyFilter | None = None,
    noise: float | None = None,
    duration: float | None = None,
    report: Report = silent,
    executor: Executor | None = None,
) -> Around:
    """Largest horizontal forces that the Berkeley Humanoid holds, by heading, place and answer.

    Parameters
    ----------
    grips : sequence of {"torso", "pelvis"}
    headings : sequence of str
        Of ``HEADINGS``: where the force points to.
    profiles : sequence of {"sudden", "slow"}
    gears, friction
        As for :func:`load`.
    filter, noise, duration, report, executor
        As for :func:`~models.humanoid.limits.compare`; the filter's default is this robot's.

    Raises
    ------
    ValueError
        For unknown grips or headings, or numbers out of range.
    """
    unknown = [name for name in headings if name not in HEADINGS]
    if unknown:
        raise ValueError(f"headings: expected some of {', '.join(HEADINGS)}, got {', '.join(unknown)}")
    law, noise, duration = settings(filter, noise, duration, robot="berkeley")
    points, tipping = dict[str, Schedule](), dict[tuple[str, str], float]()
    for grip in grips:
        humanoid = _loaded(grip, gears, friction)
        points[grip] = schedule(humanoid, _STANCE, report=report)
        upright = points[grip].upright.posture
        for name in headings:
            tipping[grip, name] = tipping_force(humanoid, upright, heading=HEADINGS[name])
    jobs: list[tuple[str, str, Mode, str]] = [
        (grip, profile, mode, name)
        for grip in grips
        for profile in profiles
        for mode in ANSWERS
        for name in headings
    ]
    names = [f"{grip}, {profile} force to the {name}, {ANSWERS[mode]}" for grip, profile, mode, name in jobs]
    work = partial(
        _held, points=points, gears=gears, friction=friction, filter=law, noise=noise, duration=duration
    )
    held = tuple((executor or Executor(1)).map(work, jobs, names=names, report=report))
    return Around(_loaded(grips[0], gears, friction), tipping, held, law, duration, noise)


@lru_cache(maxsize=4)  # not pickled: it holds the simulator
def _loaded(grip: str, gears: float, friction: Friction) -> Humanoid:
    return load(gears, friction, robot="berkeley", grip=grip)


def _held(
    job: tuple[str, str, Mode, str],
    points: dict[str, Schedule],
    gears: float,
    friction: Friction,
    filter: PhyFilter,
    noise: float,
    duration: float,
) -> Held:
    grip, profile, mode, name = job
    force, capped = largest_force(
        _loaded(grip, gears, friction),
        points[grip],
        1.0,
        mode=mode,
        heading=HEADINGS[name],
        rise=PROFILES[profile],
        filter=filter,
        noise=noise,
        duration=duration,
        resolution=params().berkeley.resolution,
    )
    return Held(grip, profile, mode, name, force, capped)


def table(found: Around) -> str:
    """Limits as text.

    Parameters
    ----------
    found : Around
    """
    rules, humanoid = params().trial, found.humanoid
    names = list(dict.fromkeys(name for _, name in found.tipping))
    lines = [
        f"Berkeley Humanoid, {humanoid.mass:.1f} kg, motors at {humanoid.gears:g} times their 5 to 30 N m; a constant "
        f"horizontal force, sudden or rising over {rules.rise:g} s,",
        f"trials of {found.duration:g} s, {humanoid.friction} friction cones, velocity noise {found.noise:g}, "
        f"a0 = {-found.filter.poles()[0].real:g} rad/s",
        "",
        f"largest force held with {len(rules.test_seeds)} seeds of the noise, N, in steps of "
        f"{params().berkeley.resolution:g}; where it points to",
        f"{'':<32}" + "".join(f"{name:>12}" for name in names) + f"{'mean':>8}",
    ]
    for grip in dict.fromkeys(grip for grip, _ in found.tipping):
        tips = [found.tipping[grip, name] for name in names]
        lines.append(_line(f"{grip}, tips at, as if rigid", [f"{tip:.0f}" for tip in tips], tips))
        for profile in dict.fromkeys(each.profile for each in found.held):
            for mode, answer in ANSWERS.items():
                row = found.row(grip, profile, mode)
                cells = [f"{'>=' if each.capped else ''}{each.force:g}" for each in row]
                lines.append(_line(f"  {profile}, {answer}", cells, [each.force for each in row]))
    return "\n".join(lines)


def _line(label: str, cells: Sequence[str], numbers: Sequence[float]) -> str:
    return f"{label:<32}" + "".join(f"{cell:>12}" for cell in cells) + f"{np.mean(numbers):>8.1f}"


def figures(found: Around) -> dict[str, object]:
    """The same, for JSON.

    Parameters
    ----------
    found : Around
    """
    return {
        "robot": "berkeley",
        "mass_kg": found.humanoid.mass,
        "gears": found.humanoid.gears,
        "friction": found.humanoid.friction,
        "duration_s": found.duration,
        "velocity_noise": found.noise,
        "seeds": list(params().trial.test_seeds),
        "filter": {"a": found.filter.a.tolist(), "b": found.filter.b.tolist()},
        "tipping_n": [
            {"grip": grip, "heading": name, "force": force} for (grip, name), force in found.tipping.items()
        ],
        "largest_held_n": [
            {
                "grip": each.grip,
                "profile": each.profile,
                "mode": each.mode,
                "heading": each.heading,
                "force": each.force,
                "largest_tried": each.capped,
            }
            for each in found.held
        ],
    }
