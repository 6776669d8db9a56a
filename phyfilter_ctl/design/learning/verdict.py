"""How a search ended, and in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...results import Status
from .result import error_peak, is_identified
from .search import Best, OrderSearch
from .validation import FlightScore, OrderScore

__all__ = ["ADDS_NOTHING", "by_folds", "disagreement", "message_of", "of_several", "status_of"]

# An order that lowers the squared error by less than this share adds nothing.
ADDS_NOTHING = 1e-4


def status_of(best: Best, used: int, order: int, search: OrderSearch) -> Status:
    """How the search for an order ended of which ``best``, of order ``used``, is returned."""
    if search.shape.form == "general" and not is_identified(
        search.filter(search.best[max(search.best)]), search.floor
    ):
        return Status.NOT_IDENTIFIED
    if used < order:
        return Status.ORDER_ADDS_NOTHING
    if not best.done:
        return Status.ITERATION_LIMIT
    at_end = best.bound or search.coordinates.at_end(best.chain.poles)
    return Status.AT_BOUND if at_end else Status.CONVERGED


def message_of(status: Status, used: int, order: int, search: OrderSearch) -> str:
    """The status in words, and what to try."""
    return {
        Status.CONVERGED: f"order {used}: no start and no lower order does better",
        Status.ORDER_ADDS_NOTHING: (
            f"no low-pass filter above order {used}, up to {order}, lowers the squared error by "
            f"{100 * ADDS_NOTHING:g} %: the filter of order {used} is returned; try shape='general'"
        ),
        Status.NOT_IDENTIFIED: _not_identified(used, search),
        Status.AT_BOUND: _at_bound(used, search),
        Status.ITERATION_LIMIT: f"order {used}: the best descent was still going down; raise max_iterations",
        Status.CANCELLED: f"cancelled by the callback: the best filter so far, of order {used}",
    }[status]


def by_folds(orders: Sequence[OrderScore], used: int, asked: int, rejected: bool) -> str:
    """The choice of cross-validation in words."""
    by_order = {score.order: score for score in orders}
    chosen, best = by_order[used], min(orders, key=lambda score: score.ratio)
    if rejected:
        worse = by_order[asked]
        return (
            f"order {asked}: RMSE {worse.held_out_rmse:.4g} on what it was not learned from, "
            f"{chosen.held_out_rmse:.4g} with order {used}, which is returned: the flights do not support more; give "
            "longer or more flights"
        )
    return (
        f"order {used}: the lowest that is as good as the best of {orders[0].order} to {orders[-1].order}; "
        f"cross-validated RMSE {chosen.held_out_rmse:.4g}, the least {best.held_out_rmse:.4g} with order {best.order}"
    )


def of_several(orders: Sequence[OrderScore], used: int, asked: Sequence[int]) -> str:
    """The choice among orders that were asked for, in words, those named that were not worth a score."""
    scored = {score.order: score for score in orders}
    left = [n for n in asked if n not in scored]
    if len(scored) > 1:
        said = by_folds(orders, used, used, False)
    else:
        said = f"order {used}: the lowest of {', '.join(map(str, asked))}; "
        said += f"cross-validated RMSE {scored[used].held_out_rmse:.4g}"
    if not left:
        return said
    return f"{said}; {', '.join(map(str, left))}: not scored, for the squared error hardly falls or F is not identified"


def disagreement(flights: Sequence[FlightScore]) -> tuple[str, ...]:
    """What the flights left out have to warn of."""
    apart = [score for score in flights if score.disagrees]
    if not apart:
        return ()
    worst = max(apart, key=lambda score: score.left_out_rmse / score.own_rmse)
    return (
        f"flights disagree: {len(apart)} of {len(flights)} have a filter of their own that is better by more than "
        f"10 %, flight {worst.flight} most (RMSE {worst.own_rmse:.4g} against {worst.left_out_rmse:.4g} with that "
        "of the others); look at their units, labels and noise, or learn them apart",
    )


def _at_bound(used: int, search: OrderSearch) -> str:
    if search.shape.is_limited:
        low, high = search.band
        return (
            f"order {used}: a pole lies at a limit ({low:.3g} to {high:.3g} rad/s, damping ratio "
            f"{search.shape.least_damping:.2g} at least): widen it, or try a lower order"
        )
    return (
        f"order {used}: a pole lies at a bound (decay rates from {search.floor:.3g} rad/s, 2 pi over the longest "
        f"flight, to about {1.0 / search.step:.3g} rad/s, the sampling): try a lower order, longer flights or "
        "faster sampling"
    )


def _not_identified(used: int, search: OrderSearch) -> str:
    order = max(search.best)
    refused = search.filter(search.best[order])
    slowest = float(np.min(np.abs(refused.poles)))
    if search.shape.dc_gain is None:
        what = (
            f"F(0) is not identified: it would be {refused.dc_gain:.3g}, and a constant residual estimated worse than "
            "by f_theta alone"
        )
    else:
        peak, omega = error_peak(refused, search.floor)
        what = f"F is not identified at low frequency: |1 - F| would be {peak:.3g} at {omega:.2g} rad/s"
    return (
        f"order {order}: {what}; near {slowest:.2g} rad/s the flights hold little but the label's own error (a lost "
        f"mean, a drift, another unit than M x' - g): the filter of order {used} is returned; put the label's mean and "
        "slow part right, add flights with steady residuals, or take a lower order or shape='lowpass', where F(0) = 1"
    )
