"""From the best filter of every order to the one that is returned, and everything that is said of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ...filter import PhyFilter, Sampling
from ...filter.sampling import Method
from ...results import Status
from . import verdict
from .correlation import memory
from .evidence import Evidence, Known, Where, validated
from .folds import Folds
from .options import LearnEvent
from .residuals import Flight, each
from .result import LearnResult, is_identified
from .samples import response
from .search import OrderSearch
from .validation import FlightScore, OrderScore, by_flight, chosen_order
from .wiener import LONGEST

__all__ = ["Asked", "answer", "rmse"]

# Squared errors below this share of the target's square are rounding.
_EXACT = 1e-14
# An order that was asked for is not returned where it errs by more than this, relative, beyond a lower one on what it
# was not learned from.
_WORSE = 0.01


@dataclass(frozen=True, eq=False)
class Asked:
    """What :func:`learn` was asked for, beside the search."""

    orders: tuple[int, ...]
    flights: Sequence[Flight]
    tests: Sequence[Flight]
    sampling: Sampling
    offset: bool
    validate: bool
    skipped: tuple[tuple[str, str], ...]
    where: Where


def answer(
    search: OrderSearch, asked: Asked, events: tuple[LearnEvent, ...], cancelled: bool, notes: tuple[str, ...]
) -> LearnResult:
    """The result of a search."""
    if not search.best:
        raise ValueError("no start had a finite cost; check the label and the residual for extreme values")
    candidates = _candidates(search, asked, cancelled)
    used, rejected, known = max(candidates), False, Known()
    orders: tuple[OrderScore, ...] = ()
    lags = _lags(search, candidates)
    if asked.validate and not cancelled:
        folds = Folds.of(asked.flights, search.method, lags, offset=asked.offset)
        found = validated(folds, search, candidates)
        alone: tuple[FlightScore, ...] = ()
        if orders := found.orders:
            used, rejected = _chosen(orders, candidates, asked)
            alone = by_flight(asked.flights, search, search.best[used], lags, offset=asked.offset)
        known = Known(found, alone)
    best = search.best[used]
    status, message = _judged(search, asked, used, orders, rejected, cancelled)
    filter = search.filter(best)
    result = LearnResult(
        filter=filter,
        rmse=rmse(filter, asked.flights, search, asked.offset),
        cost=max(best.cost, 0.0),  # of an exact fit only rounding is left, of either sign
        held_out_rmse=rmse(filter, asked.tests, search, asked.offset) if asked.tests else None,
        order_used=used,
        status=status,
        message=message,
        notes=(*notes, *verdict.disagreement(known.flights)),
        skipped=asked.skipped,
        history=events,
        costs={n: max(entry.cost, 0.0) for n, entry in sorted(search.best.items())},
        sampling=asked.sampling,
        slowest=search.floor,
    )
    if cancelled:
        return result
    return result._backed(
        Evidence.of(search, candidates, used, lags, asked.flights, asked.where, known, offset=asked.offset)
    )


def _candidates(search: OrderSearch, asked: Asked, cancelled: bool) -> list[int]:
    """Orders that may be returned: a low-pass order only where it pays, a general one where F is identified."""
    wanted = [n for n in search.best if len(asked.orders) == 1 or n in asked.orders] or list(search.best)
    if search.shape.form == "lowpass":
        least = min(entry.cost for entry in search.best.values())
        negligible = _EXACT * search.fine.energy / search.fine.weight
        enough = max(least, 0.0) / (1.0 - verdict.ADDS_NOTHING) + negligible
        top = min(n for n, entry in search.best.items() if entry.cost <= enough)
        return [n for n in wanted if n <= top] or [top]
    found = [n for n in wanted if is_identified(search.filter(search.best[n]), search.floor)]
    return found or [min(wanted)]


def _judged(
    search: OrderSearch,
    asked: Asked,
    used: int,
    orders: Sequence[OrderScore],
    rejected: bool,
    cancelled: bool,
) -> tuple[Status, str]:
    """How it ended, and in words."""
    top = max(asked.orders)
    if cancelled:
        return Status.CANCELLED, verdict.message_of(Status.CANCELLED, used, top, search)
    if len(asked.orders) > 1 and orders:
        status = verdict.status_of(search.best[used], used, used, search)
        message = verdict.of_several(orders, used, asked.orders)
        if status is not Status.CONVERGED:
            message += "; " + verdict.message_of(status, used, used, search)
        return status, message
    status = verdict.status_of(search.best[used], used, top, search)
    if rejected and status is Status.ORDER_ADDS_NOTHING:
        return status, verdict.by_folds(orders, used, max(score.order for score in orders), True)
    return status, verdict.message_of(status, used, top, search)


def _chosen(orders: Sequence[OrderScore], candidates: Sequence[int], asked: Asked) -> tuple[int, bool]:
    """The order that is returned, and whether the one asked for was rejected."""
    lowest = chosen_order(orders, candidates)
    if len(asked.orders) > 1:
        return lowest, False
    top = max(orders, key=lambda score: score.order)
    supported = top.held_out_rmse <= (1.0 + _WORSE) * min(score.held_out_rmse for score in orders)
    return (top.order, False) if supported else (lowest, lowest < top.order)


def _lags(search: OrderSearch, orders: Sequence[int]) -> float:
    """Seconds of correlations that refits and the Wiener filter need."""
    slowest = min(float(np.min(-search.best[n].chain.poles.real)) for n in orders)
    return max(LONGEST * search.step, 2.0 * memory(max(orders)) / slowest)


def rmse(filter: PhyFilter, flights: Sequence[Flight], search: OrderSearch, offset: bool) -> float:
    """Root-mean-square error on flights."""
    squares = sum(each(partial(_squares, filter=filter, method=search.method, offset=offset), flights))
    return float(np.sqrt(squares / sum(flight.samples for flight in flights)))


def _squares(flight: Flight, filter: PhyFilter, method: Method, offset: bool) -> float:
    errors = (flight.target - response(filter, flight, method))[flight.first :]
    return float(np.sum((errors - np.mean(errors, axis=0) if offset else errors) ** 2))
