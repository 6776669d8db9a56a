"""Tuning of a differentiator on flights whose acceleration is known."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from itertools import product
from typing import Generic, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from .. import _signals
from .._sections import FloatArray
from ..execution import Executor
from ..results import Result, SearchResult, Status
from .protocol import SearchRange, TunableDifferentiator

_Flight = tuple[FloatArray, FloatArray, float, int]

D = TypeVar("D", bound=TunableDifferentiator)
D_co = TypeVar("D_co", bound=TunableDifferentiator, covariant=True)

# Points of the coarse grid along each parameter, by the number of parameters, so that a grid costs some 200
# evaluations at most.
_GRID_POINTS = {0: 1, 1: 25, 2: 9, 3: 6}
_GRID_POINTS_MORE = 4
# The grid is tried on about this many samples, taken from the start of every flight in proportion, and its best
# points then on all.
_SCREENING_SAMPLES = 8000
_SCREENED = 3
# A diverged candidate costs this much: finite, so that the simplex search can subtract costs.
_DIVERGED = 1e300


@dataclass(frozen=True, repr=False)
class TuneResult(Result, SearchResult[D_co]):
    """What tuning found.

    Attributes
    ----------
    differentiator : Differentiator
        The best one met.
    rmse : float
        Its root-mean-square error on the flights, in the unit of the labels; inf if none worked.
    evaluations : int
        How many candidates were tried.
    status : Status
        CONVERGED, AT_BOUND, ITERATION_LIMIT (no evaluations are left) or FAILED.
    message : str
        The status in words, and what to try.
    """

    differentiator: D_co
    rmse: float
    evaluations: int
    status: Status
    message: str

    @property
    def best(self) -> D_co:
        """``differentiator``: what every search calls what it found."""
        return self.differentiator


def tune(
    kind: type[D],
    flights: Sequence[tuple[ArrayLike, ArrayLike, float, int]],
    *,
    fixed: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    max_evaluations: int = 400,
    tolerance: float = 1e-2,
    executor: Executor | None = None,
) -> TuneResult[D]:
    """Return the differentiator of this kind with the least RMSE over all samples and channels.

    A coarse grid on the logarithms of the parameters, then the Nelder-Mead simplex from its best point, kept
    within the ranges. Long flights are shortened for the grid. Whole-number parameters are tried at every value
    of their range. The same flights give the same result.

    Parameters
    ----------
    kind : type
        Class of the differentiator, such as :class:`LowpassDifference`.
    flights : sequence of (v, label, dt, skip)
        Velocity (N, n_x) in m/s, true acceleration (N, n_x) in m/s^2, sampling interval in s, and the
        number of samples at the start that do not count (their label may be NaN).
    fixed : mapping, optional
        Fields that are set and not sought, such as ``{"order": 2}``.
    bounds : mapping, optional
        Ranges (low, high) that replace those of ``kind.search_space``, which is asked at the least ``dt``.
    max_evaluations : int
        Most candidates that the simplex may try after the grid.
    tolerance : float
        Relative change of the parameters at which the simplex stops.
    executor : Executor, optional
        What tries the points of the grid; None tries one after the other, here. The result is the same.

    Returns
    -------
    TuneResult

    Raises
    ------
    ValueError, TypeError
        If there are no flights, shapes disagree, samples are not finite, nothing is left to count, or ``fixed``
        or ``bounds`` name something that the kind does not have.

    Notes
    -----
    J. A. Nelder, R. Mead, "A simplex method for function minimization", The Computer Journal 7(4), 1965.

    Examples
    --------
    >>> from phyfilter_ctl.baselines import LowpassDifference, tune
    >>> t = np.arange(2000)[:, None] * 0.002
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(t.shape)
    >>> result = tune(LowpassDifference, [(np.sin(2 * t) + noise, 2 * np.cos(2 * t), 0.002, 250)])
    >>> str(result.status), round(result.rmse, 2)
    ('converged', 0.24)
    """
    data = [_flight(i, *flight) for i, flight in enumerate(flights)]
    if not data:
        raise ValueError("flights: expected at least one, got none")
    _signals.count("max_evaluations", max_evaluations)
    _signals.number("tolerance", tolerance, above=0.0)
    fixed = {} if fixed is None else dict(fixed)
    ranges = _ranges(kind, min(dt for _, _, dt, _ in data), fixed, {} if bounds is None else bounds)
    search = _Search(kind, data, fixed, ranges)
    # Shortened flights rank all the points; integers alone are final, so they are ranked on everything.
    points = list(_grid(ranges))
    run = Executor(1) if executor is None else executor
    if not all(r.integer for r in ranges):
        costs = search.costs(points, _shortened(data), run)
        points = [points[k] for k in np.argsort(costs, kind="stable")[:_SCREENED]]
    for point, cost in zip(points, search.costs(points, data, run), strict=True):
        search.keep(point, cost)
    limited = _refine(search, max_evaluations, tolerance) if search.best_cost < _DIVERGED else False
    return search.result(limited, tolerance)


class _Search(Generic[D]):
    """Counts candidates and keeps the best."""

    def __init__(
        self,
        kind: type[D],
        data: Sequence[_Flight],
        fixed: Mapping[str, float],
        ranges: Sequence[SearchRange],
    ) -> None:
        self.make = cast("Callable[..., D]", kind)
        self.data, self.fixed, self.ranges = data, fixed, ranges
        self.evaluations = 0
        self.best_cost = np.inf
        self.best = np.array([np.log(np.sqrt(r.low * r.high)) for r in ranges])

    def candidate(self, point: FloatArray) -> D:
        values = np.exp(point)
        sought = {
            r.name: round(x) if r.integer else float(x) for r, x in zip(self.ranges, values, strict=True)
        }
        return self.make(**self.fixed, **sought)

    def costs(self, points: Sequence[FloatArray], data: Sequence[_Flight], executor: Executor) -> list[float]:
        self.evaluations += len(points)
        return list(executor.map(partial(_rmse, data=data), [self.candidate(point) for point in points]))

    def keep(self, point: FloatArray, cost: float) -> None:
        if cost < self.best_cost:
            self.best_cost, self.best = cost, np.array(point)

    def cost(self, point: FloatArray) -> float:
        self.evaluations += 1
        cost = _rmse(self.candidate(point), self.data)
        self.keep(point, cost)
        return cost

    def result(self, limited: bool, tolerance: float) -> TuneResult[D]:
        best = self.candidate(self.best)
        if not self.best_cost < _DIVERGED:
            message = "every candidate diverged; lower the upper bounds"
            return TuneResult(best, float("inf"), self.evaluations, Status.FAILED, message)
        if limited:
            message = "the simplex used up its evaluations; raise max_evaluations or tolerance"
            return TuneResult(best, self.best_cost, self.evaluations, Status.ITERATION_LIMIT, message)
        ends = []
        for r, x in zip(self.ranges, self.best, strict=True):
            for side, end in (("lower", r.low), ("upper", r.high)):
                if abs(x - np.log(end)) <= 2.0 * tolerance:
                    ends.append(f"{r.name} at its {side} bound {end:g}")
        if ends:
            message = f"converged with {', '.join(ends)}; widen it with bounds= if a value beyond makes sense"
            return TuneResult(best, self.best_cost, self.evaluations, Status.AT_BOUND, message)
        return TuneResult(best, self.best_cost, self.evaluations, Status.CONVERGED, "converged")


def _flight(i: int, v: ArrayLike, label: ArrayLike, dt: float, skip: int) -> _Flight:
    where = f"flights[{i}]: "
    v = _signals.array(f"{where}v", v, ("N", "n_x"))
    label = _signals.array(f"{where}label", label, v.shape, beside="v", finite=False)
    skip = _signals.count(f"{where}skip", skip, least=0)
    if skip >= len(v):
        raise ValueError(
            f"{where}skip: expected fewer than the {len(v)} samples, got {skip}: nothing would count"
        )
    if not np.isfinite(label[skip:]).all():
        raise ValueError(f"{where}the label is not finite after the first {skip} samples; skip or cut them")
    return v, label, _signals.duration(f"{where}dt", dt), skip


def _shortened(data: Sequence[_Flight]) -> list[_Flight]:
    share = min(1.0, _SCREENING_SAMPLES / sum(len(v) for v, _, _, _ in data))
    ends = [skip + max(1, round(share * (len(v) - skip))) for v, _, _, skip in data]
    return [(v[:end], label[:end], dt, skip) for (v, label, dt, skip), end in zip(data, ends, strict=True)]


def _ranges(
    kind: type[TunableDifferentiator],
    dt: float,
    fixed: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
) -> list[SearchRange]:
    space = {r.name: r for r in kind.search_space(dt)}
    known = {f.name for f in fields(kind)} if is_dataclass(kind) else set(space)
    if unknown := set(fixed) - known:
        raise ValueError(f"fixed: {kind.__name__} has no {sorted(unknown)}, only {sorted(known)}")
    if unknown := set(bounds) - (set(space) - set(fixed)):
        raise ValueError(
            f"bounds: {sorted(unknown)} is not sought; sought are {sorted(set(space) - set(fixed))}"
        )
    sought = [r for name, r in space.items() if name not in fixed]
    return [SearchRange(r.name, *bounds.get(r.name, (r.low, r.high)), integer=r.integer) for r in sought]


def _grid(ranges: Sequence[SearchRange]) -> Iterator[FloatArray]:
    """Points on the logarithms; every whole number of an integer range."""
    points = _GRID_POINTS.get(len(ranges), _GRID_POINTS_MORE)
    axes = [
        np.log(np.arange(np.ceil(r.low), np.floor(r.high) + 1.0))
        if r.integer
        else np.linspace(np.log(r.low), np.log(r.high), points)
        for r in ranges
    ]
    for point in product(*axes):
        yield np.array(point)


def _refine(search: _Search[D], max_evaluations: int, tolerance: float) -> bool:
    """Improve the continuous parameters from the best grid point; True if the evaluations ran out."""
    free = np.array([not r.integer for r in search.ranges], dtype=bool)
    if not free.any():
        return False
    start = search.best.copy()
    low = np.log([r.low for r in search.ranges])[free]
    high = np.log([r.high for r in search.ranges])[free]
    step = (high - low) / (_GRID_POINTS.get(len(free), _GRID_POINTS_MORE) - 1) / 2.0
    corner = start[free]
    inward = np.where(corner + step > high, -step, step)

    def cost(point: FloatArray) -> float:
        full = start.copy()
        full[free] = point
        return search.cost(full)

    found = minimize(
        cost,
        corner,
        method="Nelder-Mead",
        bounds=list(zip(low, high, strict=True)),
        options={
            "initial_simplex": np.vstack([corner, corner + np.diag(inward)]),
            "maxfev": max_evaluations,
            "xatol": tolerance,
            "fatol": tolerance**2 * search.best_cost,
        },
    )
    return not found.success


def _rmse(candidate: TunableDifferentiator, data: Sequence[_Flight]) -> float:
    total, counted = 0.0, 0
    for v, label, dt, skip in data:
        try:
            error = candidate.estimate(v, dt)[skip:] - label[skip:]
        except FloatingPointError:
            return _DIVERGED
        total += float(np.sum(error**2)) if np.max(np.abs(error)) < 1e100 else np.inf
        counted += error.size
    return min(float(np.sqrt(total / counted)), _DIVERGED)
