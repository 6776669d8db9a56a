"""Which order the flights support, and whether they agree: learned without a fold, scored on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...results import Result
from . import levenberg
from .folds import Folds
from .residuals import Flight
from .search import Best, OrderSearch
from .sensitivity import Data
from .wiener import log_ratio

__all__ = [
    "FlightScore",
    "OrderScore",
    "against",
    "by_flight",
    "chosen_order",
    "corrected_error",
    "cross_validated",
    "is_few",
    "one_by_one",
    "scores_of",
]

_STEPS = 6  # of Gauss and Newton for the filter learned without a fold
# Squared errors below this share of the target's square are rounding.
_EXACT = 1e-14
# A flight whose own filter lowers its RMSE by more than this, relative, disagrees with the others.
_DISAGREES = 0.1
_MOST_FLIGHTS = 32
_BLOCKS_REACH = 2.0  # standard errors from blocks of few flights


@dataclass(frozen=True, repr=False)
class OrderScore(Result):
    """One order in the cross-validation.

    Attributes
    ----------
    order : int
    rmse : float
        Root of the weighted mean square on the flights learned from.
    held_out_rmse : float
        The same on each fold for the filter learned without it: whole flights where there are five at least, else
        blocks.
    ratio : float
        ``held_out_rmse`` over the least of all orders.
    standard_error : float
        Of the logarithm of ``ratio``, from the differences fold by fold (jackknife), larger by what the folds' learned
        filters share (Nadeau and Bengio, Machine Learning 52 (2003)): the root of 1 + k / (k - 1) for k folds.
    is_good : bool
        Whether the ratio is within one standard error; within two where folds are blocks of few flights, which know
        nothing of how flights differ.
    """

    order: int
    rmse: float
    held_out_rmse: float
    ratio: float
    standard_error: float
    is_good: bool


@dataclass(frozen=True, repr=False)
class FlightScore(Result):
    """One flight in the table of flights left out.

    Attributes
    ----------
    flight : int
        Its place among the logs.
    rmse : float
        Of the learned filter on it.
    left_out_rmse : float
        Of the filter learned from the other flights.
    own_rmse : float
        Of the filter learned from this flight alone.
    """

    flight: int
    rmse: float
    left_out_rmse: float
    own_rmse: float

    @property
    def disagrees(self) -> bool:
        """Whether a filter of its own would serve this flight better by more than 10 %."""
        return self.left_out_rmse > (1.0 + _DISAGREES) * self.own_rmse


def cross_validated(folds: Folds, search: OrderSearch, orders: Sequence[int]) -> dict[int, FloatArray]:
    """Squared errors (count,) on each fold by order, of the filters learned without it.

    Each descent starts from the answer on all data and from the order below without the fold; the better on the other
    folds counts.
    """
    errors = {n: np.zeros(folds.count) for n in orders}
    for fold in range(folds.count):
        data = folds.without(fold)
        below: Best | None = None
        filters: list[PhyFilter] = []
        for n in sorted(orders):
            starts = [search.best[n].theta]
            if below is not None and below.chain.order == n - 1:
                starts.append(search.with_pole(below.chain))
            below = refitted(search, data, n, starts) or search.best[n]
            filters.append(search.filter(below))
        for n, error in zip(sorted(orders), folds.errors(filters, fold), strict=True):
            errors[n][fold] = error
    return errors


def refitted(search: OrderSearch, data: Data, n: int, starts: Sequence[FloatArray]) -> Best | None:
    """The best of some descents of an order on other data; None where none has a cost."""
    cost, (upper, lower) = search.cost(data), search.box(n)
    ended = []
    for theta in starts:
        begun = levenberg.start(cost, theta)
        if begun is not None:
            ended.append(
                levenberg.descend(
                    cost, begun, upper, lower, limit=_STEPS, negligible=0.0, report=lambda _: None
                )
            )
    if not ended:
        return None
    best = min(ended, key=lambda descent: descent.found.cost)
    return Best(best.theta, search.coordinates.chain(best.theta), best.found, 0, best.done, False)


def scores_of(folds: Folds, search: OrderSearch, errors: Mapping[int, FloatArray]) -> tuple[OrderScore, ...]:
    """The table by order."""
    negligible = _EXACT * search.fine.energy / search.fine.weight * folds.weights
    floored = {n: np.maximum(entry, negligible) for n, entry in errors.items()}
    least = min(floored.values(), key=lambda entry: float(np.sum(entry)))
    found = []
    for n, entry in sorted(floored.items()):
        ratio, error, good = against(entry, least, folds.are_flights)
        held_out = float(np.sqrt(np.sum(entry) / np.sum(folds.weights)))
        rmse = float(np.sqrt(max(search.best[n].cost, 0.0)))
        found.append(OrderScore(n, rmse, held_out, ratio, error, good))
    return tuple(found)


def corrected_error(errors: FloatArray, least: FloatArray) -> tuple[float, float]:
    """Ratio of two root mean squares on the same folds, and the standard error of its logarithm: jackknife, corrected
    for training sets that overlap (Nadeau and Bengio)."""
    ratio, spread = log_ratio(errors, least)
    k = len(errors)
    return float(np.exp(ratio)), float(np.sqrt(1.0 + k / max(k - 1.0, 1.0)) * spread)


def against(errors: FloatArray, least: FloatArray, are_flights: bool) -> tuple[float, float, bool]:
    """:func:`corrected_error`, and whether the first is as good as the other: within one standard error, or two where
    folds are blocks of few flights."""
    ratio, error = corrected_error(errors, least)
    return ratio, error, bool(np.log(ratio) <= (1.0 if are_flights else _BLOCKS_REACH) * error)


def chosen_order(scores: Sequence[OrderScore], orders: Sequence[int]) -> int:
    """Lowest of some orders as good as the best (Breiman et al., Classification and Regression Trees, 1984; the error
    here is of the difference, fold by fold)."""
    among = [score for score in scores if score.order in orders]
    good = [score.order for score in among if score.is_good]
    return min(good, default=min(among, key=lambda score: score.ratio).order)


def by_flight(
    flights: Sequence[Flight], search: OrderSearch, best: Best, lags: float, *, offset: bool
) -> tuple[FlightScore, ...]:
    """The learned filter, the one learned without and the one learned from each flight; empty for one flight, or more
    than 32."""
    if not is_few(flights):
        return ()
    taking = [flight for flight in flights if flight.takes_part]
    return one_by_one(Folds.of(taking, search.method, lags, offset=offset, by_flight=True), search, best)


def is_few(flights: Sequence[Flight]) -> bool:
    """Whether there are several flights, and not too many to refit each."""
    return 2 <= sum(flight.takes_part for flight in flights) <= _MOST_FLIGHTS


def one_by_one(folds: Folds, search: OrderSearch, best: Best) -> tuple[FlightScore, ...]:
    """The scores of flights that are a fold each."""
    n, shared = best.chain.order, search.filter(best)
    found = []
    for fold in range(folds.count):
        others, own = (
            refitted(search, data, n, [best.theta]) or best
            for data in (folds.without(fold), folds.data([fold]))
        )
        place = folds.stretches(fold)[0].flight.log
        filters = [shared, search.filter(others), search.filter(own)]
        rmse = np.sqrt(folds.errors(filters, fold) / folds.weights[fold])
        found.append(FlightScore(place, *map(float, rmse)))
    return tuple(sorted(found, key=lambda score: score.flight))
