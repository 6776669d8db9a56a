"""Filters learned by least squares on the flights that the others are tuned on, and how fast that goes beside Adam."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from phyfilter_ctl import PhyFilter, Search, Status
from phyfilter_ctl.design import Adam, LearnEvent, LearnResult, learn, train
from phyfilter_ctl.recording import Recording
from phyfilter_ctl.study import Report

from .differentiator import counted
from .params import params
from .tuning import Case

__all__ = ["Convergence", "Descent", "Form", "convergence", "learn_filters"]

FloatArray = NDArray[np.float64]
Form = Literal["lowpass", "general"]

_ENDLESS = 10**9  # epochs: time is what stops Adam here


@dataclass(frozen=True)
class Descent:
    """One way down from one start.

    Attributes
    ----------
    order : int
    start : float
        RMSE of the filter started from, m/s^2.
    times : (m,) array
        Wall time since the beginning, s; what is below the order is part of it.
    rmse : (m,) array
        Least so far, m/s^2.
    status : Status
    """

    order: int
    start: float
    times: FloatArray
    rmse: FloatArray
    status: Status


@dataclass(frozen=True)
class Convergence:
    """Low-pass filters from the same starts by both ways, on the same flights.

    Attributes
    ----------
    learned : tuple of Descent
        By :func:`phyfilter_ctl.design.learning.learn`: no random start beside the given one.
    adam : tuple of Descent
        By :func:`phyfilter_ctl.design.adjoint.train`, the paper's Algorithm 2, on the raw coefficients.
    rates : dict of int to float
        Adam's learning rate by order.
    """

    learned: tuple[Descent, ...]
    adam: tuple[Descent, ...]
    rates: dict[int, float]


def learn_filters(cases: Sequence[Case], orders: Sequence[int]) -> dict[tuple[int, Form], LearnResult]:
    """Filters of both forms with the least squared error on these flights, the start of each left out.

    Parameters
    ----------
    cases : sequence of Case
        Flights that the learned model has not seen.
    orders : sequence of int
    """
    logs = [case.log.with_signals(f_theta=case.f_theta) for case in cases]
    weights = [np.where(np.arange(log.n) < counted(log).start, 0.0, 1.0) for log in logs]
    forms: tuple[Form, ...] = ("lowpass", "general")
    return {(n, form): learn(logs, n, weights=weights, shape=form) for n in orders for form in forms}


def convergence(
    cases: Sequence[Case],
    dt: float,
    *,
    seed: int = 0,
    orders: Sequence[int] | None = None,
    starts: int | None = None,
    seconds: float | None = None,
    report: Report | None = None,
) -> Convergence:
    """Go down from the same random starts by Gauss-Newton and by Adam.

    Parameters
    ----------
    cases : sequence of Case
        Flights that the learned model has not seen; irregular ones are resampled.
    dt : float
        Nominal sampling interval, s.
    seed : int
        Of the starts.
    orders, starts, seconds : optional
        Orders, starts of each, and time for Adam from each; None means the figures in ``params.toml``.
    report : callable, optional
        Called with a few words at the beginning of every order.

    Notes
    -----
    The paper's Fig. S2, with wall time on the axis. Both minimise the same cost, all samples but the first of a flight;
    Adam sees it in segments that start at rest, as in the paper.
    """
    chosen = params().convergence
    orders = chosen.orders if orders is None else orders
    logs = [_uniform(case, dt) for case in cases]
    rng = np.random.default_rng(seed)
    learned: list[Descent] = []
    adam: list[Descent] = []
    limit = chosen.time if seconds is None else seconds
    for n in orders:
        if report is not None:
            report(f"convergence, order {n}")
        # Two threads of a BLAS make products of this size ten times slower, for either way.
        with threadpool_limits(1, user_api="blas"):
            for _ in range(chosen.starts if starts is None else starts):
                start = _random_filter(n, rng)
                learned.append(_by_learning(logs, start, dt))
                adam.append(_by_adam(logs, start, dt, _rate(n), limit))
    return Convergence(tuple(learned), tuple(adam), {n: _rate(n) for n in orders})


def _rate(n: int) -> float:
    chosen = params().convergence
    return chosen.rates[chosen.orders.index(n)]


def _uniform(case: Case, dt: float) -> Recording:
    log = case.log.with_signals(f_theta=case.f_theta)
    return log if log.is_uniform and abs(log.dt - dt) <= 1e-9 * dt else log.resample(dt)


def _random_filter(n: int, rng: np.random.Generator) -> PhyFilter:
    """Pairs of any damping, or real poles, their sizes evenly on a logarithmic scale."""
    low, high = np.log(params().convergence.poles)
    poles: list[complex] = []
    while len(poles) < n:
        size, damping = float(np.exp(rng.uniform(low, high))), rng.uniform(0.4, 1.3)
        if len(poles) == n - 1 or damping >= 1.0:
            poles.append(complex(-size))
        else:
            pole = size * complex(-damping, np.sqrt(1.0 - damping**2))
            poles += [pole, pole.conjugate()]
    return PhyFilter.from_poles(poles)


def _rmse(filter: PhyFilter, logs: Sequence[Recording], dt: float) -> float:
    """Over all samples but the first of each flight, m/s^2."""
    squares = []
    for log in logs:
        assert log.label is not None  # checked when the flights were prepared
        f_hat = np.asarray(filter.sampled(dt).run(log.x, f_theta=log.f_theta), dtype=float)
        squares.append(((f_hat - log.label)[1:] ** 2).ravel())
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _by_learning(logs: Sequence[Recording], start: PhyFilter, dt: float) -> Descent:
    points: list[tuple[float, float]] = []

    def note(event: LearnEvent) -> None:
        if event.order == start.order:
            points.append((time.perf_counter() - begun, event.cost))

    begun = time.perf_counter()
    result = learn(logs, start.order, search=Search(start=start, starts=0, callback=note))
    # A low-pass filter of lower order may come back, and then it is the answer.
    points.append((time.perf_counter() - begun, result.cost))
    return _descent(start, _rmse(start, logs, dt), points, result.status)


def _by_adam(logs: Sequence[Recording], start: PhyFilter, dt: float, rate: float, seconds: float) -> Descent:
    chosen = params().convergence
    channels = logs[0].n_x
    steps = min(round(chosen.segment / dt), min(log.n for log in logs) - 2)
    points: list[tuple[float, float]] = []

    def note(epoch: int, cost: float, filter: PhyFilter) -> bool:
        points.append((time.perf_counter() - begun, cost / channels))
        return time.perf_counter() - begun > seconds

    begun = time.perf_counter()
    result = train(
        logs,
        start,
        form="lowpass",
        segment=steps,
        optimiser=Adam(rate, batch=chosen.batch, patience=_ENDLESS, max_epochs=_ENDLESS),
        validation=0.0,
        callback=note,
    )
    return _descent(start, _rmse(start, logs, dt), points, result.status)


def _descent(
    start: PhyFilter, first: float, points: Sequence[tuple[float, float]], status: Status
) -> Descent:
    table = np.array(points, dtype=float).reshape(-1, 2)
    least = np.minimum.accumulate(np.minimum(np.sqrt(np.maximum(table[:, 1], 0.0)), first))
    return Descent(start.order, first, table[:, 0], least, status)
