"""From the filter learned without the loop to the one that keeps its limits, verified by the exact margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...filter import PhyFilter, SampledPhyFilter, Sampling
from ...results import Status
from .constrained import Admissible, Point, at_speed
from .constraints import LoopConstraint, LoopPrice
from .result import LearnResult
from .search import Search

__all__ = ["keep_limits"]

_SLOWER = (1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.2)  # where the exact margins find less than the search did


def keep_limits(
    search: Search,
    constraint: LoopConstraint,
    sampling: Sampling,
    result: LearnResult,
    score: Callable[[PhyFilter], tuple[float, float | None]],
) -> LearnResult:
    """The result with the best filter that keeps the limits, verified by the exact margins.

    ``score`` gives the RMSE on training and held-out flights.
    """
    sampling = replace(sampling, dt=float(f"{sampling.dt:.12g}"))
    task = Admissible(search, constraint, sampling)
    without = constraint.spare(SampledPhyFilter(result.filter, sampling))
    if min(without.values()) >= 0.0:
        price = LoopPrice(constraint, without, without, result.rmse, 0.0)
        return replace(result, loop=price)
    found = task.best(result.order_used)
    verified = None if found is None else _verified(task, found[0])
    if found is None or verified is None:
        return _infeasible(constraint, sampling, result, without)
    point, spare = verified
    rmse, held_out = score(point.filter)
    price = LoopPrice(constraint, spare, without, result.rmse, rmse / result.rmse - 1.0)
    status = Status.CONVERGED if found[1] else Status.ITERATION_LIMIT
    message = (
        f"order {point.filter.order}: {', '.join(price.binding) or 'no limit'} binds; RMSE {rmse:.4g}, "
        f"{100.0 * price.price:+.1f} % of the filter without the loop ({result.rmse:.4g}), which does not keep "
        f"{', '.join(name for name, value in without.items() if value < 0.0)}"
    )
    return replace(
        result,
        filter=point.filter,
        rmse=rmse,
        cost=point.cost,
        held_out_rmse=held_out,
        order_used=point.filter.order,
        status=status,
        message=message,
        intervals=None,
        loop=price,
    )


def _verified(task: Admissible, point: Point) -> tuple[Point, dict[str, float]] | None:
    """The filter by the exact margins, a little slower where they find less than the search did."""
    for slower in (0.0, *_SLOWER):
        now = point if slower == 0.0 else task.slowed(at_speed(point.filter, 1.0 - slower))
        if now is not None:
            spare = task.constraint.spare(SampledPhyFilter(now.filter, task.sampling))
            if min(spare.values()) >= 0.0:
                return now, spare
    return None


def _infeasible(
    constraint: LoopConstraint, sampling: Sampling, result: LearnResult, without: dict[str, float]
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
        intervals=None,
        loop=price,
    )
