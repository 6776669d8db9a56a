"""What decides who wins: every point of the study is flown, here or on a cluster, with the same numbers."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from phyfilter_ctl import Sampling
from phyfilter_ctl.design import learn
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.recording import Recording
from phyfilter_ctl.results import plain
from phyfilter_ctl.simulation import BackendChoice
from phyfilter_ctl.study import Checkpoint, Executor, Report, silent

from .experiment import fly
from .flights import Scenario, conditions
from .margins import Limits, limits
from .methods import Method, MethodName
from .params import params
from .study_points import AXES, FORMS, USED, AxisName, Form, Grid, LearnedFilter, Point, bandwidths, plan
from .training import train
from .tuning import modulus_margin, tuned

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "LearnedFilter",
    "Outcome",
    "Spread",
    "Study",
    "evaluate",
    "learn_filters",
    "records",
    "steps",
    "study",
]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """Median and quartiles over the flights of a point, m; inf where flights failed.

    Attributes
    ----------
    low, median, high : float
    """

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Outcome:
    """What a point found.

    Attributes
    ----------
    point : Point
    errors : dict of str to tuple of float
        Mean |e| of every flight by scenario, m, inf for one that failed; empty where it was not flown.
    margin : float or None
        Modulus margin, where it was taken.
    position_bandwidth : float
        Of the outer loop that flew, rad/s.
    """

    point: Point
    errors: Mapping[Scenario, tuple[float, ...]]
    margin: float | None
    position_bandwidth: float

    def spread(self, scenario: Scenario) -> Spread:
        """Median and quartiles; the quartiles are errors of flights, so that failed ones do not spoil them."""
        values = self.errors[scenario]
        low, high = np.quantile(values, [0.25, 0.75], method="nearest")
        return Spread(float(low), float(np.median(values)), float(high))


@dataclass(frozen=True)
class Study:
    """The outcomes, in the order of the plan.

    Attributes
    ----------
    grid : Grid
    methods : dict of str to Method
        As tuned.
    outcomes : tuple of Outcome
    learned : tuple of LearnedFilter
    limits : Limits or None
        Where the loop breaks, by choice of g.
    """

    grid: Grid
    methods: Mapping[MethodName, Method]
    outcomes: tuple[Outcome, ...]
    learned: tuple[LearnedFilter, ...]
    limits: Limits | None

    @property
    def axes(self) -> tuple[AxisName, ...]:
        """Those that were studied."""
        return tuple(dict.fromkeys(outcome.point.axis for outcome in self.outcomes))

    def curves(self, axis: AxisName) -> dict[str, list[Outcome]]:
        """The outcomes of an axis by family."""
        found: dict[str, list[Outcome]] = {}
        for outcome in self.outcomes:
            if outcome.point.axis == axis:
                found.setdefault(outcome.point.family, []).append(outcome)
        return found

    def winners(self, scenario: Scenario) -> dict[tuple[float, float], str]:
        """Who has the least median error by (bandwidth, speed) of the map."""
        return {place: name for place, (_, name) in self._best(scenario).items()}

    def least(self, scenario: Scenario) -> dict[tuple[float, float], float]:
        """The winner's median error in m by (bandwidth, speed) of the map."""
        return {place: error for place, (error, _) in self._best(scenario).items()}

    def _best(self, scenario: Scenario) -> dict[tuple[float, float], tuple[float, str]]:
        best: dict[tuple[float, float], tuple[float, str]] = {}
        for family, curve in self.curves("map").items():
            for outcome in curve:
                if scenario not in outcome.errors:
                    continue
                point, entry = outcome.point, (outcome.spread(scenario).median, family)
                # SEER-I has no filter whose bandwidth could be varied: it stands in every column.
                for w in self.map_bandwidths if family == "seer" else (point.value,):
                    if point.speed is not None:
                        best[w, point.speed] = min(entry, best.get((w, point.speed), entry))
        return best

    @property
    def map_bandwidths(self) -> tuple[float, ...]:
        """Bandwidths of the map, rad/s."""
        return bandwidths(self.grid.map_bandwidths)


def evaluate(
    point: Point,
    grid: Grid,
    model: Chebyshev,
    *,
    backend: BackendChoice = "auto",
    workers: int | None = None,
) -> Outcome:
    """Fly one point and take its margin.

    Parameters
    ----------
    point : Point
    grid : Grid
        Seeds and duration.
    model : Chebyshev
        Of SEER-I.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    workers : int, optional
        Threads; None means one per core. The numbers do not depend on it.
    """
    method, found = point.method, None
    if point.with_margin:
        with threadpool_limits(1):  # two threads are slower on matrices of this size, and round differently
            method, found = _with_margin(method, model, point.needs_margin)
        if point.needs_margin and found < params().tuning.modulus_margin:
            return Outcome(point, {}, found, method.position_bandwidth)
    seeds = grid.map_seeds if point.axis == "map" else grid.seeds
    others = {} if point.speed is None else {"controller.reference.speed": point.speed}
    errors: dict[Scenario, tuple[float, ...]] = {}
    for scenario in point.scenarios:
        drawn = conditions(seeds, scenario, strength=point.strength)
        drawn = replace(drawn, added_mass=point.mass_scale * drawn.added_mass)
        flown = fly(
            method, drawn, model, duration=grid.duration, others=others, backend=backend, workers=workers
        )
        errors[scenario] = tuple(float(value) for value in flown.score().total)
    return Outcome(point, errors, found, method.position_bandwidth)


@lru_cache(maxsize=256)
def _with_margin(method: Method, model: Chebyshev, needed: bool) -> tuple[Method, float]:
    """The method and its margin; where one is needed, with the fastest outer loop that has it, as the tuning does."""
    tuning, found = params().tuning, modulus_margin(method, model)
    if not needed:
        return method, found
    step = tuning.step if found >= tuning.modulus_margin else -tuning.step
    while True:
        w = round(method.position_bandwidth + step, 6)
        if not tuning.slowest <= w <= tuning.fastest:
            return method, found
        following = replace(method, position_bandwidth=w)
        held = modulus_margin(following, model)
        if step > 0.0 and held < tuning.modulus_margin:
            return method, found
        method, found = following, held
        if step < 0.0 and held >= tuning.modulus_margin:
            return method, found


def records(
    method: Method,
    model: Chebyshev,
    *,
    duration: float | None = None,
    backend: BackendChoice = "auto",
) -> tuple[list[Recording], list[FloatArray]]:
    """The tuning flights as recordings of x, g, f_theta and the true f, and weights that leave the start-up out.

    Parameters
    ----------
    method : Method
        The PhyFilter that flies meanwhile.
    model : Chebyshev
        Of SEER-I.
    duration : float, optional
        s of every flight; None means that of ``params.toml``.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    """
    keep = ("v_m", "g", "f_theta", "f_mass", "f_wind")
    tune = conditions(params().seeds.tune, "mass")
    flights = fly(method, tune, model, keep=keep, duration=duration, backend=backend)
    signals = flights.signals
    logs = [
        Recording.from_arrays(
            x=params().vehicle.mass * signals["v_m"][i],
            g=signals["g"][i],
            f_theta=signals["f_theta"][i],
            label=signals["f_mass"][i] + signals["f_wind"][i],
            dt=params().sampling.dt,
            name=f"seed {seed}",
        )
        for i, seed in enumerate(tune.seeds)
    ]
    return logs, [np.where(np.arange(log.n) < flights.counted.start, 0.0, 1.0) for log in logs]


def learn_filters(
    logs: Sequence[Recording], weights: Sequence[FloatArray], forms: Sequence[Form] = FORMS
) -> tuple[LearnedFilter, ...]:
    """Filters of least squared error on recordings.

    Parameters
    ----------
    logs, weights
        Of :func:`records`.
    forms : sequence of (int, str)
        Order and form of each.
    """
    found = []
    for order, form in forms:
        result = learn(logs, order, weights=weights, shape=form, sampling=Sampling(g="average"))
        a, b = (tuple(float(c) for c in part) for part in (result.filter.a, result.filter.b))
        found.append(LearnedFilter(order, form, (a, b), result.rmse, result.message))
    return tuple(found)


def steps(axes: Sequence[AxisName] | None = None, grid: Grid | None = None) -> int:
    """Number of reports of :func:`study`.

    Parameters
    ----------
    axes, grid
        As for :func:`study`.

    Examples
    --------
    >>> steps(["delay"]), steps(["mass", "wind"])
    (24, 40)
    """
    axes, grid = AXES if axes is None else axes, Grid() if grid is None else grid
    fake = LearnedFilter(1, "lowpass", ((1.0,), (1.0,)), 0.0, "")
    anyone: dict[MethodName, Method] = {name: Method(name, 1.0, 1.234) for name in USED}
    learned = [replace(fake, coefficients=((1.0 + k,), (1.0,))) for k in range(len(FORMS))]
    jobs = {_job(point) for point in plan(axes, anyone, grid, learned)}
    return len(jobs) + ("learned" in axes) + ("g" in axes)


def study(
    axes: Sequence[AxisName] | None = None,
    *,
    grid: Grid | None = None,
    methods: Mapping[MethodName, Method] | None = None,
    backend: BackendChoice = "auto",
    report: Report = silent,
    scheduler: str | Client | None = None,
    workers: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> Study:
    """Fly the study.

    Parameters
    ----------
    axes : sequence of str, optional
        Of ``AXES``; None means all.
    grid : Grid, optional
        Points and seeds.
    methods : mapping, optional
        None means those of ``tuned.toml``.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    report : callable
        Called at the beginning of every step, :func:`steps` times.
    scheduler : str or distributed.Client, optional
        Of a Dask cluster whose workers fly; None flies here. The numbers are the same.
    workers : int, optional
        Processes here; None means one per core.
    checkpoint : str or path-like, optional
        File of JSON lines that keeps every outcome; given again, the study goes on where it was broken off.

    Raises
    ------
    ValueError
        For an unknown axis, a method that is missing, or a scheduler that does not answer.
    """
    axes, grid = AXES if axes is None else tuple(axes), Grid() if grid is None else grid
    entries = tuned() if methods is None else {}
    methods = {name: entry.method for name, entry in entries.items()} if methods is None else methods
    plan(axes, methods, grid)  # says what is wrong before anything flies
    model = train(backend).model
    learned: tuple[LearnedFilter, ...] = ()
    if "learned" in axes:
        report("learning filters")
        learned = learn_filters(
            *records(methods["phyfilter"], model, duration=grid.duration, backend=backend)
        )
    points = plan(axes, methods, grid, learned)
    jobs = list(dict.fromkeys(_job(point) for point in points))
    kept = None if checkpoint is None else _kept(checkpoint, grid, methods, learned, jobs)
    with Executor(workers, scheduler=scheduler) as executor:
        work = partial(evaluate, grid=grid, model=model, backend=backend, workers=1)
        answers = list(executor.map(work, jobs, names=_names(jobs), report=report, checkpoint=kept))
    found = dict(zip(jobs, answers, strict=True))
    outcomes = tuple(replace(found[_job(point)], point=point) for point in points)
    where = None
    if "g" in axes:
        report("where the loop breaks")
        where = limits(methods["phyfilter"].position_bandwidth)
    return Study(grid, methods, outcomes, learned, where)


def _job(point: Point) -> Point:
    """The point without its place: what is the same flight is flown once."""
    return replace(point, axis="map" if point.axis == "map" else "g", family="", value=0.0)


def _names(jobs: Sequence[Point]) -> list[str]:
    return [f"{k + 1}: {job.method.name}, {job.method.bandwidth:.3g}" for k, job in enumerate(jobs)]


def _kept(
    path: str | os.PathLike[str],
    grid: Grid,
    methods: Mapping[MethodName, Method],
    learned: Sequence[LearnedFilter],
    jobs: Sequence[Point],
) -> Checkpoint[Outcome]:
    """Outcomes on disk. Their points are those of the plan, which :func:`study` gives them."""

    def to_json(outcome: Outcome) -> dict[str, object]:
        errors = {
            name: [e if np.isfinite(e) else None for e in each] for name, each in outcome.errors.items()
        }
        return {"errors": errors, "margin": outcome.margin, "position_bandwidth": outcome.position_bandwidth}

    def from_json(entry: dict[str, Any]) -> Outcome:
        errors = {
            name: tuple(np.inf if e is None else e for e in each) for name, each in entry["errors"].items()
        }
        return Outcome(jobs[0], errors, entry["margin"], entry["position_bandwidth"])

    described = plain({"grid": grid, "methods": methods, "learned": learned, "jobs": len(jobs)})
    return Checkpoint(path, described, to_json=to_json, from_json=from_json)
