"""Flights as data for a cost: correlations where they hold everything, samples where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from ...filter.sampling import Method
from .correlation import Correlations, Stretch
from .offsets import Offsets
from .residuals import Flight, each
from .samples import Pooled, Samples
from .sensitivity import Data
from .stored import StoredFlights

# Steps that agree to this are one step, and for trials to this.
_SAME_STEP, _SIMILAR_STEP = 1e-6, 0.02


def sources(flights: Sequence[Flight], method: Method, *, offset: bool = False) -> tuple[Data, Data]:
    """Data for trials, and for the answer; one object where correlations hold everything and are in memory.

    With ``offset`` each flight and channel has an offset of its label, fitted along.
    """
    taking = [flight for flight in flights if flight.takes_part]
    rest = [flight for flight in taking if not flight.is_plain]
    plain = [flight for flight in taking if flight.is_plain]
    stored = isinstance(flights, StoredFlights)
    exact = flights.correlations(method) if stored else _correlated(plain, method, _SAME_STEP)
    offsets = _offsets(plain if offset else [], method)
    if not rest:
        if stored:
            return _pooled([replace(part, rough=True) for part in (*exact, *offsets)]), _pooled(
                [*exact, *offsets]
            )
        pooled = _pooled([*exact, *offsets])
        return pooled, pooled
    levelled = [flight.levelled() for flight in taking]
    trials: list[Data] = [*_correlated(levelled, method, _SIMILAR_STEP, rough=True)]
    trials += _offsets(levelled if offset else [], method, rough=True)
    summed = each(partial(Samples, method=method, offset=offset), rest)
    return _pooled(trials), _pooled([*exact, *offsets, *summed])


def _offsets(flights: Sequence[Flight], method: Method, *, rough: bool = False) -> list[Offsets]:
    groups = [[Stretch(flight, flight.first, flight.length, flight.weight)] for flight in flights]
    return [Offsets(groups, method, rough)] if groups else []


def _pooled(parts: Sequence[Data]) -> Data:
    return parts[0] if len(parts) == 1 else Pooled(parts)


def _correlated(
    flights: Sequence[Flight], method: Method, tolerance: float, *, rough: bool = False
) -> list[Correlations]:
    groups: list[list[Flight]] = []
    for flight in flights:
        for group in groups:
            if abs(flight.dt - group[0].dt) <= tolerance * flight.dt:
                group.append(flight)
                break
        else:
            groups.append([flight])
    return [
        Correlations.of([Stretch(f, f.first, f.length, f.weight) for f in group], method, rough=rough)
        for group in groups
    ]
