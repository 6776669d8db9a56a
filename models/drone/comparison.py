"""All methods on the same test flights: errors, reductions, and what was estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl import study
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.results import Interval
from phyfilter_ctl.simulation import BackendChoice
from phyfilter_ctl.study import Executor, Report, Scores, TunedMethod, score_methods, silent

from . import reference
from .experiment import Flights, Score, fly
from .flights import Scenario, conditions
from .methods import METHODS, Method, MethodName
from .params import Mission, params
from .training import Training, train
from .tuning import tuned

__all__ = [
    "SCENARIOS",
    "Comparison",
    "Estimation",
    "compare",
    "realtime_factor",
    "steps",
]

FloatArray = NDArray[np.float64]

SCENARIOS: tuple[Scenario, ...] = ("mass", "wind")
_ESTIMATES = ("f_mass", "f_wind", "f_hat", "f_theta")


@dataclass(frozen=True)
class Estimation:
    """How far estimates of the unknown force are from the truth, RMSE in N over the counted time, one a flight.

    Attributes
    ----------
    force : (B,) array
        f_hat against f_mass + f_wind.
    mass_part : (B,) array or None
        f_theta against f_mass, where SEER-I flies along.
    wind_part : (B,) array or None
        f_hat - f_theta against f_wind, where both are there.
    """

    force: FloatArray
    mass_part: FloatArray | None
    wind_part: FloatArray | None


@dataclass(frozen=True)
class Comparison:
    """What the methods did on the test flights.

    Attributes
    ----------
    seeds : tuple of int
    methods : dict of str to TunedMethod
    training : Training
        Of SEER-I.
    scores : Scores
        By (scenario, method).
    estimation : dict of (scenario, method) to Estimation
        For the methods that estimate.
    shown : dict of str to Flights
        One windy flight of every method, with all signals: that of the seed with PhyFilter's median error.
    still : dict of str to Flights
        The same seed without wind.
    mission : Mission
        With the circle that was flown.
    """

    seeds: tuple[int, ...]
    methods: Mapping[MethodName, TunedMethod[Method]]
    training: Training
    scores: Scores[Score]
    estimation: Mapping[tuple[Scenario, MethodName], Estimation]
    shown: Mapping[MethodName, Flights]
    still: Mapping[MethodName, Flights]
    mission: Mission

    def mae(self, scenario: Scenario, part: str = "total") -> dict[MethodName, Interval]:
        """Mean errors in m, median over the seeds; ``part`` is total, horizontal or vertical."""
        return {name: self.scores.interval(scenario, name, part) for name in self.methods}

    def reduction(
        self, scenario: Scenario, over: MethodName, *, of: MethodName = "phyfilter", part: str = "total"
    ) -> Interval:
        """Reduction of the error of one method against another's, in per cent."""
        return self.scores.reduction(scenario, over, of=of, figure=part)


def steps(methods: Sequence[MethodName] = METHODS) -> int:
    """Number of reports of :func:`compare`."""
    return len(SCENARIOS) * len(methods) + 1


def compare(
    seeds: Sequence[int] | None = None,
    *,
    methods: Sequence[MethodName] = METHODS,
    duration: float | None = None,
    payload: tuple[float, float] | None = None,
    others: Mapping[str, ArrayLike] | None = None,
    backend: BackendChoice = "auto",
    report: Report = silent,
    executor: Executor | None = None,
) -> Comparison:
    """Fly every method over the test seeds, with unknown mass and with wind beside it.

    Parameters
    ----------
    seeds : sequence of int, optional
        None means those of ``params.toml``.
    methods : sequence of str
    duration : float, optional
        s; None means that of ``params.toml``.
    payload : (float, float), optional
        Range of the unknown mass, kg; None means that of ``params.toml``.
    others : mapping, optional
        Other parameters of the diagram, such as the speed of the circle.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    report : callable
        Called at the beginning of every step.
    executor : Executor, optional
        What flies the scenarios, method by method; None flies them here. The numbers are the same.
    """
    seeds = tuple(range(params().seeds.test)) if seeds is None else tuple(seeds)
    training, entries = train(backend), tuned()
    options = {"payload": payload, "duration": duration, "others": others, "backend": backend}
    flown = partial(
        _flown, seeds, {name: entries[name].method for name in methods}, training.model, **options
    )
    scores: Scores[Score] = score_methods(methods, SCENARIOS, flown, report=report, executor=executor)
    estimation: dict[tuple[Scenario, MethodName], Estimation] = {
        (scenario, name): entry.estimation
        for scenario in SCENARIOS
        for name in methods
        if isinstance(entry := scores[scenario, name], _Flown) and entry.estimation is not None
    }
    report("flights to show")
    shown_by = "phyfilter" if "phyfilter" in methods else methods[0]
    seed = seeds[scores.middle("wind", shown_by, "total")]

    def showing(scenario: Scenario) -> dict[MethodName, Flights]:
        return {
            name: fly(
                entries[name].method,
                conditions([seed], scenario, payload=payload),
                training.model,
                keep=("r", "r_ref", "wind", "f_mass", "f_wind", *_kept(name)),
                duration=duration,
                others=others,
                backend=backend,
            )
            for name in methods
        }

    chosen: dict[MethodName, TunedMethod[Method]] = {name: entries[name] for name in methods}
    shown, still = showing("wind"), showing("mass")
    return Comparison(seeds, chosen, training, scores, estimation, shown, still, reference.flown(others))


@dataclass(frozen=True)
class _Flown(Score):
    """What a scenario says of a method."""

    estimation: Estimation | None


def _flown(
    seeds: Sequence[int],
    methods: Mapping[MethodName, Method],
    model: Chebyshev,
    name: MethodName,
    scenario: Scenario,
    *,
    payload: tuple[float, float] | None,
    duration: float | None,
    others: Mapping[str, ArrayLike] | None,
    backend: BackendChoice,
) -> _Flown:
    drawn, keep = conditions(seeds, scenario, payload=payload), ("r", "r_ref", *_kept(name))
    flights = fly(methods[name], drawn, model, keep=keep, duration=duration, others=others, backend=backend)
    score = flights.score()
    estimation = _estimation(flights) if _kept(name) else None
    return _Flown(score.total, score.horizontal, score.vertical, estimation)


def _kept(name: MethodName) -> tuple[str, ...]:
    """Signals of the estimate that the method's diagram has."""
    if name in ("baseline", "integral", "known_mass"):
        return ()
    on_seer = ("seer", "phyfilter", "phyfilter_type2", "accelerometer")
    return _ESTIMATES if name in on_seer else _ESTIMATES[:3]


def _estimation(flights: Flights) -> Estimation:
    signals = {
        name: flights.signals[name][:, flights.counted] for name in _ESTIMATES if name in flights.signals
    }

    def rms(error: FloatArray) -> FloatArray:
        return np.sqrt(np.mean(np.sum(error**2, axis=2), axis=1))

    f_mass, f_wind, f_hat = (signals[name] for name in _ESTIMATES[:3])
    force = rms(f_hat - f_mass - f_wind)
    if "f_theta" not in signals:
        return Estimation(force, None, None)
    f_theta = signals["f_theta"]
    return Estimation(force, rms(f_theta - f_mass), rms(f_hat - f_theta - f_wind))


def realtime_factor(
    method: TunedMethod[Method],
    training: Training,
    *,
    duration: float = 60.0,
    backend: BackendChoice = "auto",
) -> float:
    """Simulated over elapsed time of the whole closed loop on one core, once it is compiled."""
    wind = conditions([0], "wind")
    arguments = {"keep": ("r",), "duration": duration, "backend": backend, "workers": 1}
    return study.realtime_factor(partial(fly, method.method, wind, training.model, **arguments), duration)
