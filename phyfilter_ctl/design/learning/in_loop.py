"""From the filter learned without the loop to the one that keeps its limits, verified by the exact margins."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...analysis.margins.slopes import SampledLoop
from ...filter import PhyFilter, SampledPhyFilter, Sampling
from ...results import Status
from .constrained import INSIDE, Admissible, Point
from .constraints import LoopGoal, LoopPrice
from .evidence import Evidence
from .objective import Estimation, Remembering
from .residuals import Flight
from .result import LearnResult
from .search import OrderSearch
from .tracking import Tracking, spectra_of

__all__ = ["keep_limits"]


def keep_limits(
    search: OrderSearch,
    constraint: LoopGoal,
    sampling: Sampling,
    flights: Sequence[Flight],
    result: LearnResult,
    score: Callable[[PhyFilter], tuple[float, float | None]],
    *,
    offset: bool,
) -> LearnResult:
    """The result with the best filter that keeps the limits, verified by the exact margins.

    ``score`` gives the RMSE on training and held-out flights.
    """
    sampling = replace(
        sampling, dt=float(f"{sampling.dt:.12g}"), channels=None, inertia=None, units=None, E=None
    )
    data = Remembering(search.fine)
    task = Admissible(search, data, constraint, sampling, Estimation(data))
    objective = _tracking(task, flights, offset) if constraint.cost == "tracking" else None
    without = constraint.spare(SampledPhyFilter(result.filter, sampling))
    if objective is None and min(without.values()) >= 0.0:
        price = LoopPrice(constraint, without, without, result.rmse, 0.0)
        return replace(result, loop=price)._backed(result._evidence)
    found = _verified(task, result.order_used)
    errors: tuple[float, float] | tuple[()] = ()
    if objective is not None and found is not None:
        estimator = found[0]
        found = _verified(replace(task, objective=objective), result.order_used, [estimator.filter])
        if found is not None:
            errors = (
                float(np.sqrt(found[0].cost)),
                float(np.sqrt(objective.cost(estimator.chain, estimator.c))),
            )
    if found is None:
        return _infeasible(constraint, sampling, result, without)
    point, ended, spare = found
    rmse, held_out = score(point.filter)
    price = LoopPrice(constraint, spare, without, result.rmse, rmse / result.rmse - 1.0, *errors)
    lost = ", ".join(name for name, value in without.items() if value < 0.0)
    message = (
        f"order {point.filter.order}: {', '.join(price.binding) or 'no limit'} binds; RMSE {rmse:.4g}, "
        f"{100.0 * price.price:+.1f} % of the filter without the loop ({result.rmse:.4g}), which "
        + (f"does not keep {lost}" if lost else "keeps the limits too")
    )
    if errors:
        message += f"; tracking error {errors[0]:.4g}, {errors[1]:.4g} with the filter that estimates best"
    return replace(
        result,
        filter=point.filter,
        rmse=rmse,
        cost=point.cost,
        held_out_rmse=held_out,
        order_used=point.filter.order,
        status=Status.CONVERGED if ended else Status.ITERATION_LIMIT,
        message=message,
        loop=price,
    )._backed(_bound(result))


def _bound(result: LearnResult) -> Evidence | None:
    return None if result._evidence is None else replace(result._evidence, is_free=False)


def _tracking(task: Admissible, flights: Sequence[Flight], offset: bool) -> Tracking:
    assert isinstance(task.loop, SampledLoop)  # the constraint has asked for kp or kd
    reference = task.constraint.reference
    signal = None if reference is None else np.asarray(reference, dtype=float)
    omega, spectra = spectra_of(flights, task.sampling.dt, signal, offset=offset)
    return Tracking.of(task.loop, omega, spectra, task.sampling)


def _verified(
    task: Admissible, orders: int, given: Sequence[PhyFilter] = ()
) -> tuple[Point, bool, dict[str, float]] | None:
    """The best filter by the exact margins, searched further inside where they find less than the search did."""
    for inside in INSIDE:
        found = replace(task, inside=inside).best(orders, given)
        if found is None:
            return None
        assert found[0].sampled is not None  # it keeps the limits
        spare = task.constraint.spare(found[0].sampled)
        if min(spare.values()) >= 0.0:
            return *found, spare
    return None


def _infeasible(
    constraint: LoopGoal, sampling: Sampling, result: LearnResult, without: dict[str, float]
) -> LearnResult:
    """F = 0: nothing is fed back."""
    filter = PhyFilter(result.filter.a, np.zeros(result.filter.order))
    spare = constraint.spare(SampledPhyFilter(filter, sampling))
    lost = [name for name, value in spare.items() if value < 0.0]
    why = (
        f"the loop without any filter does not keep {', '.join(lost)}: lower the outer gains, or ask for less"
        if lost
        else "not even the slowest filter that the flights show keeps them: ask for less, lower the outer gains, or "
        "give longer flights (slower filters)"
    )
    price = LoopPrice(constraint, spare, without, result.rmse, float("nan"))
    return replace(
        result,
        filter=filter,
        rmse=float("nan"),
        cost=float("nan"),
        held_out_rmse=None,
        status=Status.INFEASIBLE,
        message=f"no filter up to order {result.order_used} keeps the limits, F = 0 is returned: {why}",
        loop=price,
    )._backed(_bound(result))
