"""What is left open, one thing at a time: gusts, load transfer, an arm that helps, the attitude the planner knows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.study import Executor, Report, silent

from .experiment import Score, fly
from .methods import METHODS, NAMES, MethodName
from .mission import changed, reference
from .params import params
from .seer import Seer
from .training import train
from .tuning import modulus_margin, tuned

__all__ = ["Row", "figures", "run", "steps", "swaying", "table"]

FloatArray = NDArray[np.float64]

_TURBULENCE = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)
_TRANSFER = (0.0, 0.2, 0.5, 1.0)
_ARM = "arm makes up"
_SHARES = (0.0, 0.5, 1.0)
_METHODS: tuple[MethodName, ...] = ("integral", "observer", "phyfilter")


@dataclass(frozen=True, eq=False)
class Row:
    """One setting.

    Attributes
    ----------
    what : str
        What is varied.
    value : str
    method : str
    score : Score
    margin : float or None
        Modulus margin, where what is varied changes the loop.
    """

    what: str
    value: str
    method: MethodName
    score: Score
    margin: float | None = None


def swaying(time: float, h: FloatArray, u_before: FloatArray) -> tuple[ArrayLike, ArrayLike]:
    """Attitude of a platform that makes the acceleration of the step before, and no turning.

    Parameters
    ----------
    time : float
    h : (12,) array
    u_before : (6,) array
        Accelerations of platform and arm, m/s^2.
    """
    z = u_before[:3] + np.array([0.0, 0.0, params().vehicle.gravity])
    z = z / np.linalg.norm(z)
    y = np.cross(z, [1.0, 0.0, 0.0])
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z]), np.zeros(3)


def steps() -> int:
    """Number of reports of :func:`run`."""
    return len(_METHODS) * (len(_TURBULENCE) + len(_TRANSFER)) + len(METHODS) * len(_SHARES) + 2


def run(seeds: Sequence[int], *, report: Report = silent, executor: Executor | None = None) -> list[Row]:
    """Fly all settings.

    Parameters
    ----------
    seeds : sequence of int
    report : callable
        Called at the beginning of every step.
    executor : Executor, optional
        What flies the settings; None flies them here. The numbers are the same.
    """
    seer, settings = train().seer, _settings()
    names = [f"{one.what} {one.value}, {one.method}" for one in settings]
    work = partial(_row, seeds=seeds, seer=seer)
    rows = list((executor or Executor(1)).map(work, settings, names=names, report=report))
    for label, attitude in (("level", None), ("swaying", swaying)):
        report(f"planner told {label}")
        goals = reference(attitude=attitude)
        flights = fly(tuned()["phyfilter"].method, seeds, seer, goals=goals)
        rows.append(Row("planner told", label, "phyfilter", flights.score()))
    return rows


@dataclass(frozen=True)
class _Setting:
    what: str
    value: str
    method: MethodName
    others: dict[str, float]
    transfer: float | None = None


def _settings() -> list[_Setting]:
    found: list[_Setting] = []
    for name in _METHODS:
        for turbulence in _TURBULENCE:
            wind = {"vehicle.wind.turbulence": turbulence}
            found.append(_Setting("turbulence", f"{100 * turbulence:g} %", name, wind))
        found += [_Setting("load within", f"{time:g} s", name, {}, time) for time in _TRANSFER]
    for name in METHODS:
        for share in _SHARES:
            found.append(_Setting(_ARM, f"{100 * share:g} %", name, {"controller.arm.share": share}))
    return found


def _row(one: _Setting, seeds: Sequence[int], seer: Seer) -> Row:
    method = tuned()[one.method].method
    flights = fly(method, seeds, seer, mission=changed(transfer=one.transfer), others=one.others)
    margin = modulus_margin(method, seer, others=one.others) if one.what == _ARM else None
    return Row(one.what, one.value, one.method, flights.score(), margin)


def table(rows: Sequence[Row]) -> str:
    """The study as text."""
    n = len(rows[0].score.mean)
    lines = [
        f"{n} missions each; |e| in cm: mean (median), windows (median / worst), lift-off (median); passed: grasped / "
        f"placed of {n}",
        "",
        f"{'':<14}{'':<10}{'':<25}{'mean':>7}{'grasp window':>15}{'place window':>15}{'lift-off':>10}{'passed':>10}"
        f"{'margin':>9}",
    ]
    before = ""
    for row in rows:
        if row.what != before and before:
            lines.append("")
        score, before = row.score, row.what
        windows = (f"{100 * np.median(v):.2f} / {100 * v.max():.2f}" for v in (score.grasp, score.settle))
        lines.append(
            f"{row.what:<14}{row.value:<10}{NAMES[row.method]:<25}{100 * np.median(score.mean):>7.2f}"
            + "".join(f"{text:>15}" for text in windows)
            + f"{100 * np.median(score.lift_off):>10.2f}{f'{score.grasped.sum()} / {score.placed.sum()}':>10}"
            + ("" if row.margin is None else f"{row.margin:>9.2f}")
        )
    return "\n".join(lines)


def figures(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The study for JSON: cm and numbers of missions."""

    def cm(value: float) -> float | None:
        return 100.0 * float(value) if np.isfinite(value) else None

    return [
        {
            "what": row.what,
            "value": row.value,
            "method": row.method,
            "mean_error_cm": cm(float(np.median(row.score.mean))),
            "max_error_cm": cm(float(row.score.windows.max())),
            "lift_off_cm": cm(float(np.median(row.score.lift_off))),
            "grasped": int(row.score.grasped.sum()),
            "placed": int(row.score.placed.sum()),
            "modulus_margin": row.margin,
        }
        for row in rows
    ]
