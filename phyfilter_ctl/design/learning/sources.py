"""Flights as data for a cost: correlations where they hold everything, samples where not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...filter.sampling import Method
from .correlation import Correlations, Stretch
from .offsets import Offsets
from .residuals import Flight
from .samples import Pooled, Samples
from .sensitivity import Data

# Steps that agree to this are one step, and for trials to this.
_SAME_STEP, _SIMILAR_STEP = 1e-6, 0.02


def sources(flights: Sequence[Flight], method: Method, *, offset: bool = False) -> tuple[Data, Data]:
    """Data for trials, and for the answer; one object where correlations hold everything.

    With ``offset`` each flight and channel has an offset of its label, fitted along.
    """
    taking = [flight for flight in flights if flight.takes_part]
    rest = [flight for flight in taking if not flight.is_plain]
    plain = [flight for flight in taking if flight.is_plain]
    exact = [*_correlated(plain, method, _SAME_STEP), *_offsets(plain if offset else [], method)]
    if not rest:
        pooled = _pooled(exact)
        return pooled, pooled
    levelled = [_levelled(flight) for flight in taking]
    trials = [*_correlated(levelled, method, _SIMILAR_STEP), *_offsets(levelled if offset else [], method)]
    return _pooled(trials), _pooled([*exact, *(Samples(flight, method, offset) for flight in rest)])


def _offsets(flights: Sequence[Flight], method: Method) -> list[Data]:
    groups = [[Stretch(flight, 0, len(flight.u), flight.weight)] for flight in flights]
    return [Offsets(groups, method)] if groups else []


def _pooled(parts: Sequence[Data]) -> Data:
    return parts[0] if len(parts) == 1 else Pooled(parts)


def _correlated(flights: Sequence[Flight], method: Method, tolerance: float) -> list[Data]:
    groups: list[list[Flight]] = []
    for flight in flights:
        for group in groups:
            if abs(flight.dt - group[0].dt) <= tolerance * flight.dt:
                group.append(flight)
                break
        else:
            groups.append([flight])
    return [Correlations.of([Stretch(f, 0, len(f.u), f.weight) for f in group], method) for group in groups]


def _levelled(flight: Flight) -> Flight:
    """The flight as if its steps were equal and the weights, slowly varying, part of the signals."""
    if flight.sample_weights is None:
        return Flight(flight.u, flight.target, flight.dt, None, flight.weight)
    root = np.sqrt(flight.sample_weights)
    return Flight(root * flight.u, root * flight.target, flight.dt, None, flight.weight)
