"""What a result keeps to say more of itself when it is asked: the Wiener floor, intervals, orders, flights left out.

None of it is computed before. Flights in files are read again, those of a function made again. Of flights in memory the
steps are kept, u and gamma*, up to 16 MB; of more their correlations by fold and u before every cut, as far back as
correlations reach (``remnant``). But where steps differ, samples have weights, the rule is "matched", or correlations
reach so far that these would take half the room, steps are kept after all. Intervals look at beginnings of the flights,
100,000 samples together.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from ..._sections import FloatArray
from ...execution import silent
from ...filter.sampling import Method
from .folds import Folds
from .intervals import Directions, Intervals, beginnings, directions_of, intervals_of
from .options import Reading
from .reading import Reader, Recordings
from .residuals import Flight
from .search import OrderSearch
from .stored import StoredFlights
from .validation import FlightScore, OrderScore, by_flight, cross_validated, is_few, one_by_one, scores_of
from .wiener import WienerFloor, wiener_floor

__all__ = ["Evidence", "Known", "Validation", "Where"]


class Validation(NamedTuple):
    """Every order on what it was not learned from: squared errors by order and fold, and the table."""

    errors: dict[int, FloatArray]
    orders: tuple[OrderScore, ...]


# Bytes of u and gamma* that are kept as they are, and the share of them above which correlations are not worth it.
KEPT, WORTH = 1 << 24, 0.5


@dataclass(frozen=True, eq=False)
class Where:
    """Where the flights of one call are."""

    kept: Sequence[Flight] | None
    how: Reading
    options: Mapping[str, Any]
    recordings: Recordings
    weights: Sequence[Any] | None

    @classmethod
    def of(cls, flights: Sequence[Flight], reader: Reader, recordings: Recordings, weights: Any) -> Where:
        """Of flights that were read."""
        if isinstance(flights, StoredFlights):
            return cls(None, replace(reader.how, report=silent), reader.options, recordings, weights)
        return cls(flights, Reading(), {}, (), None)

    @contextmanager
    def flights(self) -> Iterator[Sequence[Flight]]:
        """The flights, for a while."""
        with threadpool_limits(1, user_api="blas"), ExitStack() as stack:
            if self.kept is not None:
                yield self.kept
            else:
                reader = Reader(stack, self.how, self.options)
                yield reader.flights("recordings", self.recordings, self.weights)[0]


class Totals(NamedTuple):
    """Data of which the moments are no longer needed."""

    energy: float
    weight: float

    def moments(self, doubled: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """None: the search is over."""
        return None


class Known(NamedTuple):
    """What was found already, since the choice of the order asked for it."""

    validation: Validation | None = None
    flights: tuple[FlightScore, ...] = ()


class Reduced(NamedTuple):
    """Flights in memory, reduced to what is asked of them: in folds, and where they are few each as a fold."""

    folds: Folds
    alone: Folds | None


def reduced(
    flights: Sequence[Flight], method: Method, lags: float, *, offset: bool, by_flight: bool
) -> Reduced | None:
    """Flights without samples; None where these may as well be kept."""
    taking = [flight for flight in flights if flight.takes_part]
    size = sum(flight.u.nbytes + flight.target.nbytes for flight in taking)
    if size <= KEPT or method == "matched" or not all(flight.is_plain for flight in taking):
        return None
    folds = Folds.of(taking, method, lags, offset=offset).kept()
    alone = Folds.of(taking, method, lags, offset=offset, by_flight=True).kept() if by_flight else None
    taken = folds.nbytes + (0 if alone is None else alone.nbytes)
    return None if taken > WORTH * size else Reduced(folds, alone)


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is behind a result.

    Attributes
    ----------
    search : OrderSearch
        Its answers; its data no longer.
    candidates : tuple of int
        Orders that may be returned.
    used : int
        The one that is.
    lags : float
        Seconds of correlations that refits and the Wiener filter need.
    offset : bool
    where : Where
    reduced : Reduced or None
        Instead of ``where``.
    directions : Directions
        In which the data move the filter.
    begun : (sequence of Flight, float) or None
        Beginnings of the flights and their share in all samples; None where the flights are kept.
    known : Known
    is_free : bool
        Whether no limit of a loop binds, which intervals and the comparison with the Wiener filter know nothing of.
    """

    search: OrderSearch
    candidates: tuple[int, ...]
    used: int
    lags: float
    offset: bool
    where: Where
    reduced: Reduced | None
    directions: Directions
    begun: tuple[Sequence[Flight], float] | None
    known: Known
    is_free: bool = True

    @classmethod
    def of(
        cls,
        search: OrderSearch,
        candidates: Sequence[int],
        used: int,
        lags: float,
        flights: Sequence[Flight],
        where: Where,
        known: Known,
        *,
        offset: bool,
    ) -> Evidence:
        """Of a search that is over."""
        rest = Totals(search.fine.energy, search.fine.weight)
        small: Reduced | None = None
        if where.kept is not None:
            few = known.validation is None and is_few(flights)
            small = reduced(flights, search.method, lags, offset=offset, by_flight=few)
            where = where if small is None else replace(where, kept=())
        return cls(
            replace(search, coarse=rest, fine=rest, report=lambda *_: None, rough={}),
            tuple(candidates),
            used,
            lags,
            offset,
            where,
            small,
            directions_of(search, search.best[used]),
            None if where.kept else beginnings(flights),
            known,
        )

    @contextmanager
    def _folds(self) -> Iterator[Folds]:
        """The flights in folds, for a while."""
        with self.where.flights() as flights:
            yield (
                Folds.of(flights, self.search.method, self.lags, offset=self.offset)
                if self.reduced is None
                else self.reduced.folds
            )

    @cached_property
    def orders(self) -> tuple[OrderScore, ...]:
        """Every order on what it was not learned from."""
        if self.known.validation is not None:
            return self.known.validation.orders
        with self._folds() as folds:
            return validated(folds, self.search, self.candidates).orders

    @cached_property
    def flights(self) -> tuple[FlightScore, ...]:
        """Every flight with the filter learned without it."""
        if self.known.validation is not None:
            return self.known.flights
        best = self.search.best[self.used]
        with self.where.flights() as flights:
            if self.reduced is None:
                return by_flight(flights, self.search, best, self.lags, offset=self.offset)
            return () if self.reduced.alone is None else one_by_one(self.reduced.alone, self.search, best)

    @cached_property
    def wiener(self) -> WienerFloor | None:
        """The causal Wiener filter on the same folds."""
        if not self.is_free:
            return None
        with self._folds() as folds:
            if folds.count < 2:
                return None
            known = self.known.validation
            errors = cross_validated(folds, self.search, [self.used]) if known is None else known.errors
            return wiener_floor(folds, errors[self.used])

    @cached_property
    def intervals(self) -> Intervals | None:
        """Standard errors."""
        if not self.is_free:
            return None
        with threadpool_limits(1, user_api="blas"):
            begun, share = beginnings(self.where.kept or ()) if self.begun is None else self.begun
            best = self.search.best[self.used]
            return intervals_of(begun, share, self.search, best, self.directions, self.offset)


def validated(folds: Folds, search: OrderSearch, orders: Sequence[int]) -> Validation:
    """Orders cross-validated; of a single fold nothing."""
    if folds.count < 2:
        return Validation({}, ())
    errors = cross_validated(folds, search, orders)
    return Validation(errors, scores_of(folds, search, errors))
