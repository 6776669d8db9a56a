"""The mission on which the learned model pays: hover while the arm turns on the paper's path, in the wind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.results import Interval, plain
from phyfilter_ctl.study import Executor, Report, Scores, score_methods, silent

from .experiment import Backend, fly
from .methods import METHODS, NAMES, MethodName
from .params import params
from .seer import Seer
from .training import circling, train
from .tuning import tuned

__all__ = ["CASES", "PLACE", "RATES", "Turning", "compare", "figures", "steps", "table"]

FloatArray = NDArray[np.float64]

RATES = ("2.5", "4.5", "6.5")
"""Of the arm, rad/s: those that SEER-I was trained on, and one beyond."""
PLACE = "pick and place"
"""The paper's mission beside them."""
_SECONDS, _LEFT_OUT = 20.0, 6.0
_OVER: tuple[MethodName, ...] = ("observer", "seer", "integral", "baseline")


@dataclass(frozen=True)
class Error:
    """Mean |e| of the end effector, (B,), m; inf where a flight failed."""

    mean: FloatArray


@dataclass(frozen=True, eq=False)
class Turning:
    """What the methods did while the arm turned.

    Attributes
    ----------
    seeds : tuple of int
    scores : Scores
        By (rate, method), and ("pick and place", method).
    """

    seeds: tuple[int, ...]
    scores: Scores[Error]

    def reduction(self, case: str, over: MethodName) -> Interval:
        """By how much PhyFilter is below another method, flight by flight, per cent."""
        return self.scores.reduction(case, over, of="phyfilter", figure="mean")


CASES = (*RATES, PLACE)
"""What is flown."""


def steps(cases: Sequence[str] = CASES) -> int:
    """Number of reports of :func:`compare`."""
    return len(METHODS) * len(cases)


def compare(
    seeds: Sequence[int],
    *,
    cases: Sequence[str] = CASES,
    backend: Backend = "auto",
    report: Report = silent,
    executor: Executor | None = None,
) -> Turning:
    """Fly every method at every rate.

    Parameters
    ----------
    seeds : sequence of int
    cases : sequence of str
        Rates in rad/s, or ``PLACE``.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    report : callable
        Called at the beginning of every step.
    executor : Executor, optional
        As for :func:`comparison.compare`.
    """
    flown = partial(_flown, seeds=tuple(seeds), seer=train(backend).seer, backend=backend)
    return Turning(tuple(seeds), score_methods(METHODS, cases, flown, report=report, executor=executor))


def _flown(name: MethodName, case: str, *, seeds: Sequence[int], seer: Seer, backend: Backend) -> Error:
    method = tuned()[name].method
    if case == PLACE:
        return Error(fly(method, seeds, seer, backend=backend).score().mean)
    goals = circling((float(case), float(case)), _SECONDS)
    flights = fly(method, seeds, seer, goals=goals, others={"vehicle.load.mass": 0.0}, backend=backend)
    error = flights.error()
    mean = error[:, goals.time >= _LEFT_OUT].mean(axis=1)
    return Error(np.where(np.isfinite(error).all(axis=1), mean, np.inf))


def table(found: Turning) -> str:
    """Errors and reductions as text.

    Parameters
    ----------
    found : Turning
    """
    cases = list(dict.fromkeys(case for case, _ in found.scores))
    heads = [case if case == PLACE else f"{case} rad/s" for case in cases]
    beside = f" (last column: {PLACE})" if PLACE in cases else ""
    lines = [
        f"hover in a jet of {params().wind.jet_speed:g} m/s while the arm turns{beside}, {len(found.seeds)} flights a "
        "method; mean |e| of the end effector in cm, median of the flights [its 95 % interval]",
        "",
        f"{'':<25}" + "".join(f"{head:>22}" for head in heads),
    ]
    for name in METHODS:
        cells = (found.scores.interval(case, name, "mean").text(100.0) for case in cases)
        lines.append(f"{NAMES[name]:<25}" + "".join(f"{cell:>22}" for cell in cells))
    lines += ["", "PhyFilter below, %"]
    for over in _OVER:
        cells = (found.reduction(case, over).text(1.0, 1) for case in cases)
        lines.append(f"{NAMES[over]:<25}" + "".join(f"{cell:>22}" for cell in cells))
    return "\n".join(lines)


def figures(found: Turning) -> dict[str, object]:
    """The content of the JSON file: cm and per cent, by rate.

    Parameters
    ----------
    found : Turning
    """
    cases = list(dict.fromkeys(case for case, _ in found.scores))
    medians = {
        case: {name: 100.0 * found.scores.interval(case, name, "mean").value for name in METHODS}
        for case in cases
    }
    gains = {case: {over: found.reduction(case, over) for over in _OVER} for case in cases}
    return {
        "seeds": list(found.seeds),
        "mean_error_cm": plain(medians, infinite=True),
        "reduction_pct": plain(gains, infinite=True),
    }
