"""From the filter learned without the loop to the one that keeps its limits, verified by the exact margins."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...filter import PhyFilter, SampledPhyFilter, Sampling
from ...results import Result, Status
from .constrained import Admissible, Point, at_speed
from .constraints import LoopConstraint, LoopPrice
from .result import LearnResult
from .search import Search

__all__ = ["MarginTradeOff", "keep_limits", "margin_trade_off"]

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
        wiener=None,
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
        wiener=None,
        intervals=None,
        loop=price,
    )


@dataclass(frozen=True, eq=False, repr=False)
class MarginTradeOff(Result):
    """What every margin costs; made by :func:`margin_trade_off`.

    Attributes
    ----------
    margins : (m,) array
        Modulus margins asked for.
    rmse : (m,) array
        RMSE of the filter that keeps them on the training flights; nan where none does.
    results : tuple of LearnResult
    """

    margins: FloatArray
    rmse: FloatArray
    results: tuple[LearnResult, ...]


def margin_trade_off(
    learner: Callable[[LoopConstraint], LearnResult], loop: LoopConstraint, margins: ArrayLike
) -> MarginTradeOff:
    """Error against modulus margin: what is given up for every step of safety.

    Parameters
    ----------
    learner : callable
        ``lambda loop: learn(logs, 2, loop=loop)``.
    loop : LoopConstraint
        Whose modulus margin is replaced.
    margins : array_like, shape (m,)
        Modulus margins in [0, 1).

    Returns
    -------
    MarginTradeOff

    Raises
    ------
    ValueError
        If a margin is out of range, before anything is learned.

    Examples
    --------
    >>> from phyfilter_ctl import Recording, learn
    >>> rng = np.random.default_rng(0)
    >>> f = np.sin(0.02 * np.arange(1000))[:, None]
    >>> x = np.cumsum(0.01 * f, axis=0) + 1e-3 * rng.standard_normal(f.shape)
    >>> log = Recording.from_arrays(x=x, dt=0.01, label=f)
    >>> loop = LoopConstraint(kp=10.0, kd=6.0, delay=0.04)
    >>> found = margin_trade_off(lambda each: learn(log, 1, loop=each, wiener=False), loop, [0.3, 0.5])
    >>> bool(found.rmse[0] < found.rmse[1])
    True
    """
    wanted = _signals.array("margins", margins, ("m",))
    loops = [replace(loop, modulus_margin=float(margin)) for margin in wanted]
    results = tuple(learner(each) for each in loops)
    return MarginTradeOff(wanted, np.array([result.rmse for result in results]), results)
