"""Estimators compared on the same recordings, each at its best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..estimation.estimate import checked_logs, estimate, sampled_for
from ..estimation.steps import Steps, jackknife, steps_of, units_of
from ..filter import FilterBank, PhyFilter, SampledPhyFilter
from ..filter.sampling import Rule
from ..recording import Recording
from ..results import Interval, Result
from .differentiator_tuning import tune
from .kinds import BASELINES
from .protocol import SearchRange, TunableDifferentiator, of_recordings

__all__ = ["EstimatorComparison", "compare"]

_EQUAL = {
    1: "momentum observer (= PhyFilter of order 1 without f_theta)",
    2: "extended state observer (= PhyFilter of order 2, equal poles, without f_theta)",
}
_FAR = 3.0  # over the step, fastest pole sought
_ALIKE = 0.01  # share by which two have to differ


@dataclass(frozen=True, repr=False)
class EstimatorComparison(Result):
    """Estimators of f side by side; made by :func:`compare`.

    Attributes
    ----------
    against : str
        What they are scored against: the label, or the mean force over the horizon to come.
    rmse : dict of str to float
        By name, over the second half of each recording; in the unit of f.
    ratio : dict of str to Interval
        RMSE over that of the filter, paired: below 1 the other is better.
    tuned : dict of str to str
        What the first halves gave.
    verdict : str
    """

    against: str
    rmse: dict[str, float]
    ratio: dict[str, Interval]
    tuned: dict[str, str]
    verdict: str


@dataclass(frozen=True)
class _Observer:
    """PhyFilter with equal poles as a differentiator, so that it is tuned as the others are."""

    rate: float
    order: float = 1.0

    @classmethod
    def search_space(cls, dt: float) -> tuple[SearchRange, ...]:
        return (SearchRange("rate", 0.3, _FAR / dt),)

    @of_recordings
    def estimate(self, v: ArrayLike, dt: float) -> FloatArray:
        filter = PhyFilter.from_poles([-self.rate] * int(self.order))
        return np.asarray(filter.sampled(dt).run(v), dtype=float)


@dataclass(frozen=True, eq=False)
class _Case:
    """One recording on its uniform grid: z' = f - f_theta, and what an estimate of that is scored against."""

    z: FloatArray
    target: FloatArray
    dt: float

    @property
    def half(self) -> int:
        return len(self.z) // 2


def compare(
    recordings: Recording | Sequence[Recording],
    filter: PhyFilter | FilterBank | SampledPhyFilter | None = None,
    *,
    horizon: float = 0.2,
    confidence: float = 0.95,
    max_evaluations: int = 60,
    g: Rule = "hold",
    f_theta: Rule = "average",
) -> EstimatorComparison:
    """The filter beside every differentiator of ``BASELINES``, a momentum observer and an extended state observer.

    Each is tuned on the first half of every recording and scored on the second, against the label where all recordings
    have one, else against the mean of the measured force over the horizon to come: the prediction test. The
    differentiators get what the filter has, M, g and f_theta; the observers have no f_theta. ``filter`` is taken as it
    is; None takes the one :func:`~phyfilter_ctl.estimate` suggests for the first halves, without a label.

    Parameters
    ----------
    recordings, filter, horizon, confidence, g, f_theta
        As for :func:`~phyfilter_ctl.estimate`.
    max_evaluations : int
        Most candidates that are tried for one estimator after a coarse grid.

    Returns
    -------
    EstimatorComparison

    Raises
    ------
    TypeError, ValueError
        As for :func:`~phyfilter_ctl.estimate`; if a half is shorter than the horizon.

    Notes
    -----
    Momentum observer: A. De Luca, R. Mattone, "Actuator failure detection and isolation using generalized momenta",
    ICRA 2003. With x the generalized momentum and g the torque with the Coriolis and gravity terms, its residual is
    f_hat of the filter of order 1. So without f_theta that order cannot beat it: it is the same thing.

    Examples
    --------
    >>> t = 0.01 * np.arange(800)[:, None]
    >>> v = 2.0 * (1.0 - np.cos(t)) + 0.005 * np.random.default_rng(0).standard_normal(t.shape)
    >>> found = compare(Recording.from_arrays(x=v, dt=0.01, label=2.0 * np.sin(t)), max_evaluations=5)
    >>> min(found.rmse, key=found.rmse.get) != "difference", found.against
    (True, 'the label')
    """
    logs = checked_logs(recordings)
    horizon = _signals.duration("horizon", horizon)
    labelled = all(log.label is not None for log in logs)
    if filter is None:
        firsts = [log.segment(0, max(log.n // 2, 2)) for log in logs]
        filter = estimate(firsts, horizon=horizon, confidence=confidence, g=g, f_theta=f_theta).filter
    sampled = sampled_for(filter, logs, g, f_theta)
    bare = [log.with_signals(f_theta=None) for log in logs]
    cases, without = (
        [_case(*each, labelled, horizon) for each in zip(several, steps_of(several, sampled), strict=True)]
        for several in (logs, bare)
    )
    kinds: list[tuple[str, type[TunableDifferentiator], dict[str, float], list[_Case]]]
    kinds = [(name, kind, {}, cases) for name, kind in BASELINES.items()]
    kinds += [(name, _Observer, {"order": float(order)}, without) for order, name in _EQUAL.items()]
    rows = {"filter": [_scored(_own(sampled, case), case) for case in cases]}
    tuned = {"filter": repr(sampled)}
    for name, kind, fixed, known in kinds:
        flights = [(c.z[: c.half], c.target[: c.half], c.dt, 1) for c in known]
        best = tune(kind, flights, fixed=fixed, max_evaluations=max_evaluations).differentiator
        rows[name] = [_scored(best.estimate(case.z, case.dt), case) for case in known]
        sought = [entry.name for entry in kind.search_space(cases[0].dt) if entry.name not in fixed]
        tuned[name] = ", ".join(f"{entry} {getattr(best, entry):.4g}" for entry in sought)
    ratio = {
        name: jackknife(
            units_of([np.hstack([a, b]) for a, b in zip(parts, rows["filter"], strict=True)]),
            _root,
            confidence,
        )
        for name, parts in rows.items()
        if name != "filter"
    }
    against = "the label" if labelled else f"the mean force over the {horizon:g} s to come"
    rmse = {name: math.sqrt(np.mean(np.concatenate(parts))) for name, parts in rows.items()}
    return EstimatorComparison(against, rmse, ratio, tuned, _verdict(ratio))


def _root(total: FloatArray) -> float:
    return math.sqrt(total[0] / total[1]) if total[1] > 0.0 else math.inf


def _case(log: Recording, part: Steps, labelled: bool, horizon: float) -> _Case:
    u = part.on_grid(part.dt)
    z = part.dt * np.concatenate([np.zeros_like(u[:1]), np.cumsum(u, axis=0)])
    if labelled and log.label is not None:
        wanted = (log.label if log.f_theta is None else log.label - log.f_theta)[part.samples]
        grid = part.times[0] + part.dt * np.arange(len(z))
        known = [np.isfinite(column) for column in wanted.T]
        pairs = zip(known, wanted.T, strict=True)
        target = [np.interp(grid, part.grid_times[rows], column[rows]) for rows, column in pairs]
        return _Case(z, np.stack(target, axis=1), part.dt)
    ahead = max(1, round(horizon / part.dt))
    if len(z) < 4 * ahead + 4:
        raise ValueError(f"horizon: expected less than a quarter of each recording, got {horizon:g} s")
    return _Case(z[:-ahead], (z[ahead:] - z[:-ahead]) / (ahead * part.dt), part.dt)


def _own(sampled: SampledPhyFilter, case: _Case) -> FloatArray:
    return np.asarray(sampled.run(case.z, times=case.dt * np.arange(len(case.z))), dtype=float)


def _scored(estimate: FloatArray, case: _Case) -> FloatArray:
    """Rows (m, 1) of the second half: mean square of the error over the channels."""
    return ((estimate - case.target)[case.half :] ** 2).mean(axis=1, keepdims=True)


def _verdict(ratio: dict[str, Interval]) -> str:
    """Who is better, who worse, and who cannot be told apart."""
    better = [name for name, each in ratio.items() if each.high < 1.0 and each.value < 1.0 - _ALIKE]
    alike = [name for name, each in ratio.items() if each.low <= 1.0 or each.value < 1.0 + _ALIKE]
    if better:
        return f"better than the filter: {', '.join(better)}"
    if alike:
        return f"none is better than the filter; as good: {', '.join(alike)}"
    return "the filter is better than all of them"
