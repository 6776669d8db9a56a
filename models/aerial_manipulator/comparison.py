"""All methods on the same missions: errors of the end effector, what was grasped and placed, reductions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import Status, study
from phyfilter_ctl.results import Interval
from phyfilter_ctl.study import Executor, Report, Scores, TunedMethod, score_methods, silent

from .experiment import Backend, Flights, Score, fly
from .methods import METHODS, Method, MethodName
from .mission import changed, reference
from .params import Mission, params
from .training import Training, off_distribution, train
from .tuning import tuned

__all__ = ["CASES", "Case", "Comparison", "Reduction", "compare", "realtime_factor", "steps"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """What a mission meets.

    Parameters
    ----------
    turbulence : float
        Gusts over the local mean speed.
    transfer : float
        s in which the load comes and goes.
    """

    turbulence: float
    transfer: float


CASES: dict[str, Case] = {
    "mission": Case(params().wind.turbulence, params().mission.transfer),
    "quick_load": Case(params().wind.turbulence, 0.2),
    "gusty": Case(0.2, params().mission.transfer),
}
"""The mission as it is, with the load within 0.2 s, and with twice the turbulence."""

_SHOWN = ("r_e", "r", "wind", "f_coupling", "f_payload", "f_wind", "tau_coupling", "tau_payload", "thrust")


@dataclass(frozen=True)
class Reduction:
    """By how much PhyFilter is below another method, mission by mission, in per cent.

    Attributes
    ----------
    mean, variance : Interval
        Of |e| over the mission.
    """

    mean: Interval
    variance: Interval


@dataclass(frozen=True, eq=False)
class Comparison:
    """What the methods did on the test missions.

    Attributes
    ----------
    seeds : tuple of int
    mission : Mission
    methods : dict of str to TunedMethod
    training : Training
        Of SEER-I.
    off_distribution : dict of str to dict
        Its errors elsewhere, see :func:`training.off_distribution`.
    scores : Scores
        By (case, method).
    planner_seconds : (K,) array
        Solve times of the planner.
    planner_statuses : tuple of Status
        What came out of them.
    shown : dict of str to Flights
        One mission of every method, with its signals: that of the seed with PhyFilter's median mean error.
    """

    seeds: tuple[int, ...]
    mission: Mission
    methods: Mapping[MethodName, TunedMethod[Method]]
    training: Training
    off_distribution: Mapping[str, Mapping[str, float]]
    scores: Scores[Score]
    planner_seconds: FloatArray
    planner_statuses: tuple[Status, ...]
    shown: Mapping[MethodName, Flights]

    def interval(self, case: str, name: MethodName, field: str) -> Interval:
        """Median over the seeds of a field of the scores, in its unit."""
        return self.scores.interval(case, name, field)

    def reduction(
        self, over: MethodName, *, of: MethodName = "phyfilter", case: str = "mission"
    ) -> Reduction:
        """Reduction of mean and variance of the error of one method against another's."""
        mean, variance = (
            self.scores.reduction(case, over, of=of, figure=figure) for figure in ("mean", "variance")
        )
        return Reduction(mean, variance)

    def planner_ms(self, percentile: float) -> float:
        """Percentile of the planner's solve times, ms."""
        return float(1e3 * np.percentile(self.planner_seconds, percentile))


def steps(methods: Sequence[MethodName] = METHODS, cases: Sequence[str] = tuple(CASES)) -> int:
    """Number of reports of :func:`compare`."""
    return 2 + len(cases) * len(methods) + 1


def compare(
    seeds: Sequence[int] | None = None,
    *,
    methods: Sequence[MethodName] = METHODS,
    cases: Sequence[str] = tuple(CASES),
    mission: Mission | None = None,
    backend: Backend = "auto",
    report: Report = silent,
    executor: Executor | None = None,
) -> Comparison:
    """Fly every method over the test seeds in every case.

    Parameters
    ----------
    seeds : sequence of int, optional
        None means those of ``params.toml``.
    methods : sequence of str
    cases : sequence of str
        Of ``CASES``.
    mission : Mission, optional
        None means that of ``params.toml``; the time in which the load comes is the case's.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    report : callable
        Called at the beginning of every step.
    executor : Executor, optional
        What flies the cases, method by method; None flies them here. The numbers are the same.

    Raises
    ------
    ValueError
        Before anything flies, for a mission that cannot be flown.
    """
    seeds = tuple(range(params().test.seeds)) if seeds is None else tuple(seeds)
    report("planner")
    path = reference(mission).path
    report("training of SEER-I")
    training, entries = train(backend), tuned()
    elsewhere = off_distribution(training, backend)

    scored = partial(_scored, seeds=seeds, training=training, mission=mission, backend=backend)
    scores = score_methods(methods, cases, scored, report=report, executor=executor)
    report("missions to show")
    shown_by = "phyfilter" if "phyfilter" in methods else methods[0]
    seed = seeds[scores.middle(cases[0], shown_by, "mean")]
    shown: dict[MethodName, Flights] = {
        name: _flown(name, (seed,), training, CASES[cases[0]], mission, keep=_SHOWN, backend=backend)
        for name in methods
    }
    return Comparison(
        seeds,
        params().mission if mission is None else mission,
        {name: entries[name] for name in methods},
        training,
        elsewhere,
        scores,
        path.solve_seconds,
        path.statuses,
        shown,
    )


def _scored(
    name: MethodName,
    case: str,
    seeds: Sequence[int],
    training: Training,
    mission: Mission | None,
    backend: Backend,
) -> Score:
    return _flown(name, seeds, training, CASES[case], mission, backend=backend).score()


def _flown(
    name: MethodName,
    seeds: Sequence[int],
    training: Training,
    case: Case,
    mission: Mission | None,
    *,
    keep: Sequence[str] = ("r_e",),
    backend: Backend,
) -> Flights:
    method = tuned()[name].method
    return fly(
        method,
        seeds,
        training.seer,
        mission=changed(mission, transfer=case.transfer),
        keep=(
            *keep,
            *(("f_hat", "tau_hat") if len(keep) > 1 and name not in ("baseline", "integral") else ()),
        ),
        others={"vehicle.wind.turbulence": case.turbulence},
        backend=backend,
    )


def realtime_factor(method: TunedMethod[Method], training: Training, *, backend: Backend = "auto") -> float:
    """Simulated over elapsed time of the whole closed loop on one core, once it is compiled."""
    once = partial(fly, method.method, (0,), training.seer, backend=backend, workers=1)
    return study.realtime_factor(once, params().mission.duration, repeats=3)
