"""The comparison: a learned differentiator, PhyFilters on top of it, and the differentiators used without learning.

Everything is fitted and tuned on the training flights. The test flights are only estimated and scored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.baselines import BASELINES, TunableDifferentiator, TuneResult, tune
from phyfilter_ctl.learned import Network, Windowed
from phyfilter_ctl.recording import Recording, split
from phyfilter_ctl.study import Report, silent

from .differentiator import counted, labels, stride_of, train
from .flights import generate
from .linear import Linear, fit_linear
from .params import params
from .tuning import Case, TunedFilter, filtered, rmse, squares, tune_filters

__all__ = [
    "BASELINE_NAMES",
    "Comparison",
    "Effort",
    "Learned",
    "compare",
    "compare_generated",
    "estimates",
    "fit_learned",
    "prepare",
]

FloatArray = NDArray[np.float64]

BASELINE_NAMES = tuple(BASELINES)
# A recording at another rate than the rest: a window of so many samples would mean another time.
_SAME_RATE = 0.1
# A single training flight is cut into this many, so that some can be held out.
_PIECES = 4


@dataclass(frozen=True)
class Effort:
    """How much work the training and tuning may do; None means the figures of ``params.toml``.

    Attributes
    ----------
    iterations, choice_iterations : int, optional
        Of the network's training.
    filter_evaluations, baseline_evaluations : int, optional
        Of the tuners.
    """

    iterations: int | None = None
    choice_iterations: int | None = None
    filter_evaluations: int | None = None
    baseline_evaluations: int = 150


QUICK = Effort(iterations=40, choice_iterations=25, filter_evaluations=30, baseline_evaluations=10)


@dataclass(frozen=True)
class Learned:
    """The trained differentiator and the filters tuned for it.

    Attributes
    ----------
    network : Windowed
        Trained on all training flights.
    filters : dict of int to TunedFilter
        By order.
    span : float
        Candidate duration of the window that was chosen, s.
    span_rmse : dict of float to float
        RMSE of each candidate on the training flights held out, m/s^2.
    cases : tuple of Case
        The faster training flights with the twin network's estimate: what the filters were tuned on.
    """

    network: Windowed[Network]
    filters: Mapping[int, TunedFilter]
    span: float
    span_rmse: Mapping[float, float]
    cases: tuple[Case, ...]


@dataclass(frozen=True)
class Comparison:
    """What the comparison found.

    Attributes
    ----------
    data : str
        "generated" or "recorded".
    seed : int
    dt : float
        Nominal sampling interval, s.
    train, test : tuples of Recording
    learned : Learned
    baselines : dict of str to TuneResult
    linear : Linear
    train_estimates, test_estimates : dict of str to list of (N, n_x) arrays
        By method, one array a flight, m/s^2.
    """

    data: str
    seed: int
    dt: float
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    learned: Learned
    baselines: Mapping[str, TuneResult[TunableDifferentiator]]
    linear: Linear
    train_estimates: Mapping[str, Sequence[FloatArray]]
    test_estimates: Mapping[str, Sequence[FloatArray]]

    @property
    def train_rmse(self) -> dict[str, float]:
        """By method, m/s^2."""
        return {name: rmse(estimates, self.train) for name, estimates in self.train_estimates.items()}

    @property
    def test_rmse(self) -> dict[str, float]:
        """By method, m/s^2."""
        return {name: rmse(estimates, self.test) for name, estimates in self.test_estimates.items()}

    @property
    def test_squares(self) -> dict[str, FloatArray]:
        """By method, for each test flight (flights, 2): sum of squared errors, and how many; for paired intervals."""
        return {name: squares(estimates, self.test) for name, estimates in self.test_estimates.items()}

    def tested_on(self, logs: Sequence[Recording]) -> Comparison:
        """The same methods, as they were fitted and tuned, on other test flights."""
        prepare(self.train, logs)
        return replace(
            self,
            test=tuple(logs),
            test_estimates=_all(logs, self.dt, self.learned, self.baselines, self.linear),
        )

    def train_cases(self) -> list[Case]:
        """The training flights with the network's estimate."""
        network = self.train_estimates["network"]
        return [Case(log, f_theta) for log, f_theta in zip(self.train, network, strict=True)]

    def test_cases(self) -> list[Case]:
        """The test flights with the network's estimate."""
        network = self.test_estimates["network"]
        return [Case(log, f_theta) for log, f_theta in zip(self.test, network, strict=True)]


def prepare(train: Sequence[Recording], test: Sequence[Recording]) -> tuple[tuple[Recording, ...], float]:
    """Check the flights; return the training flights, a single one cut in pieces, and the nominal interval in s.

    Raises
    ------
    ValueError
        If there are none, a flight has no label or is too short, or the rates or the channels differ.
    """
    for name, flights in (("training", train), ("test", test)):
        if not flights:
            raise ValueError(f"expected at least one {name} flight, got none")
    for log in (*train, *test):
        labels(log)
        counted(log)
    dt = float(np.median([log.dt for log in train]))
    for log in (*train, *test):
        if log.n_x != train[0].n_x:
            raise ValueError(
                f"flight {log.name!r} has {log.n_x} channels, expected {train[0].n_x} as in {train[0].name!r}"
            )
        if abs(log.dt - dt) > _SAME_RATE * dt:
            raise ValueError(
                f"flight {log.name!r} is sampled every {1e3 * log.dt:.4g} ms, the training flights every "
                f"{1e3 * dt:.4g} ms: expected one rate; resample it first"
            )
    if len(train) > 1:
        return tuple(train), dt
    (only,) = train
    edges = np.linspace(0, only.n, _PIECES + 1).astype(int)
    pieces = tuple(only.segment(int(a), int(b)) for a, b in pairwise(edges))
    for piece in pieces:
        counted(piece)
    return pieces, dt


def fit_learned(
    train_logs: Sequence[Recording], dt: float, *, seed: int, effort: Effort, report: Report = silent
) -> Learned:
    """Choose the window, tune the filters and train the network, on training flights only.

    A network fits the flights it was trained on better than any other, so a filter tuned there would come out too
    slow. A twin network therefore learns from the slower training flights; the filters (and the window) are chosen on
    the faster ones, which it has not seen. The network that is used learns from all training flights.

    Parameters
    ----------
    train_logs : sequence of Recording
        At least two.
    dt : float
        Nominal sampling interval, s.
    seed : int
        Seed of the networks' first weights.
    effort : Effort
    report : callable, optional
        Told about every step begun.

    Returns
    -------
    Learned

    Raises
    ------
    ValueError
        If there are fewer than two flights, one has no label or is too short, or training failed.
    """
    chosen = params().network
    iterations = chosen.iterations if effort.iterations is None else effort.iterations
    choice = chosen.choice_iterations if effort.choice_iterations is None else effort.choice_iterations
    slower, faster = split(train_logs, fraction=params().filter.slower)
    strides = {span: stride_of(span, dt) for span in chosen.spans}
    every = max(1, round(chosen.choice_interval / dt))
    by_stride: dict[int, float] = {}
    for stride in sorted(set(strides.values())):
        report(f"window of {stride * (chosen.length - 1) * dt * 1e3:.0f} ms")
        twin = train(slower, stride=stride, seed=seed, iterations=choice, every=every)
        by_stride[stride] = rmse([twin.predict(log.x) for log in faster], faster)
    span_rmse = {span: by_stride[stride] for span, stride in strides.items()}
    span = min(span_rmse, key=lambda key: span_rmse[key])
    report("twin network")
    twin = train(slower, stride=strides[span], seed=seed, iterations=iterations)
    report("filters")
    cases = [Case(log, twin.predict(log.x)) for log in faster]
    filters = tune_filters(params().filter.orders, cases, dt, evaluations=effort.filter_evaluations)
    report("network")
    network = train(train_logs, stride=strides[span], seed=seed, iterations=iterations)
    return Learned(network, filters, span, span_rmse, tuple(cases))


def compare(
    train_logs: Sequence[Recording],
    test_logs: Sequence[Recording],
    *,
    data: str,
    seed: int = 0,
    effort: Effort | None = None,
    report: Report = silent,
) -> Comparison:
    """Fit and tune every method on the training flights and run it on all flights.

    Parameters
    ----------
    train_logs, test_logs : sequences of Recording
        x the measured velocity in m/s, label the true acceleration in m/s^2. A single training flight is cut in four.
    data : str
        What the flights are, "generated" or "recorded".
    seed : int
        Seed of the networks' first weights.
    effort : Effort, optional
        None means in full.
    report : callable, optional
        Called with a few words at the beginning of every step.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there are no flights, one has no label or is too short, or the rates or the channels differ.

    Notes
    -----
    Windows and baselines take the samples of a slightly irregular recording as evenly spaced; the filter uses the
    times themselves.
    """
    effort = Effort() if effort is None else effort
    prepared, dt = prepare(train_logs, test_logs)
    learned = fit_learned(prepared, dt, seed=seed, effort=effort, report=report)
    flights = [(log.x, labels(log), log.dt, counted(log).start) for log in prepared]
    baselines: dict[str, TuneResult[TunableDifferentiator]] = {}
    for name, kind in BASELINES.items():
        report(name.replace("_", " "))
        baselines[name] = tune(kind, flights, max_evaluations=effort.baseline_evaluations)
    report("without a network")
    iterations = params().network.iterations if effort.iterations is None else effort.iterations
    linear = fit_linear(prepared, dt, stride=learned.network.stride, seed=seed, iterations=iterations)
    report("estimates")
    tested = tuple(test_logs)
    return Comparison(
        data,
        seed,
        dt,
        prepared,
        tested,
        learned,
        baselines,
        linear,
        _all(prepared, dt, learned, baselines, linear),
        _all(tested, dt, learned, baselines, linear),
    )


def compare_generated(seed: int, *, effort: Effort | None = None, share: float = 1.0) -> Comparison:
    """:func:`compare` on the flights of a seed, the networks' first weights being its own, too."""
    train_logs, test_logs = (generate(kind, seed, share=share) for kind in ("train", "test"))
    return compare(train_logs, test_logs, data="generated", seed=seed, effort=effort)


def estimates(
    logs: Sequence[Recording],
    dt: float,
    learned: Learned,
    baselines: Mapping[str, TuneResult[TunableDifferentiator]],
) -> dict[str, list[FloatArray]]:
    """Acceleration by every method, one array (N, n_x) in m/s^2 a flight."""
    cases = [Case(log, learned.network.predict(log.x)) for log in logs]
    estimates = {"network": [case.f_theta for case in cases]}
    for order, tuned in learned.filters.items():
        estimates[f"phyfilter_{order}"] = filtered(tuned.filter, cases, dt)
    for name, result in baselines.items():
        estimates[name] = [result.differentiator.estimate(log.x, log.dt) for log in logs]
    return estimates


def _all(
    logs: Sequence[Recording],
    dt: float,
    learned: Learned,
    baselines: Mapping[str, TuneResult[TunableDifferentiator]],
    linear: Linear,
) -> dict[str, list[FloatArray]]:
    return {**estimates(logs, dt, learned, baselines), **linear.estimates(logs, dt)}


def steps() -> int:
    """How often :func:`compare` reports at most, for a progress bar."""
    return len(params().network.spans) + 3 + len(BASELINES) + 2
