"""What is kept of flights in folds once their samples are gone: correlations by fold, and u before every cut.

Over a stretch of a flight of equal steps, whose samples count alike, the squared error of a filter is one of moments,

    sum (gamma* - c s)^2 = sum gamma*^2 - 2 c m + c G c',

and that of an impulse response h one of correlations and of what h makes of u beyond the two ends,

    sum (gamma* - h u)^2 = sum gamma*^2 - 2 h c + h T(r) h' - tail(last) + tail(first),

both exact where u is kept as far back as filter and response remember.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import oaconvolve

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...filter.sampling import Method
from .correlation import Correlations, Stretch
from .offsets import Offsets
from .parametrisation import chain_of
from .residuals import Flight
from .samples import Pooled

__all__ = ["Remnant", "filter_errors", "remnants", "response_errors", "without_samples"]


class Remnant(Flight):
    """A flight without its samples.

    Attributes
    ----------
    shape : (int, int)
        Steps and channels.
    ends : mapping of int to (K, l) array
        By place: u before it, backwards, as far as is kept.
    """

    shape: tuple[int, int]
    ends: Mapping[int, FloatArray]
    sums: Mapping[tuple[int, int], tuple[FloatArray, FloatArray]]

    def __init__(self, flight: Flight, stretches: Sequence[Stretch], reach: int) -> None:
        places = {place for part in stretches for place in (part.first, part.last)} - {0}
        known = {
            name: getattr(flight, name)
            for name in ("dt", "weight", "channels", "log", "mean_step", "gaps", "first")
        }
        self.__dict__.update(
            known,
            steps=None,
            sample_weights=None,
            g=None,
            shape=flight.u.shape,
            ends={place: flight.before(place)[0][:, :reach].copy() for place in places},
            sums={(part.first, part.last): flight.totals(part.first, part.last) for part in stretches},
        )

    @property
    def takes_part(self) -> bool:
        return self.weight > 0.0

    @property
    def length(self) -> int:
        return self.shape[0]

    @property
    def samples(self) -> int:
        return (self.shape[0] - self.first) * self.shape[1]

    @property
    def width(self) -> int:
        return self.shape[1]

    def totals(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """As of the flight, of the stretches that were asked for."""
        return self.sums[first, last]

    def before(self, place: int) -> tuple[FloatArray, bool]:
        """As of the flight, before the cuts."""
        if place == 0:
            return np.zeros((self.shape[1], 0)), True
        past = self.ends[place]
        return past, past.shape[1] == place

    @property
    def nbytes(self) -> int:
        """Bytes that it takes."""
        return sum(past.nbytes for past in self.ends.values())


def remnants(stretches: Sequence[Stretch], reach: int) -> dict[int, Remnant]:
    """What is left of the flights of some stretches, by their ids; ``reach`` steps before every cut."""
    by_flight: dict[int, list[Stretch]] = {}
    for part in stretches:
        by_flight.setdefault(id(part.flight), []).append(part)
    return {key: Remnant(parts[0].flight, parts, reach) for key, parts in by_flight.items()}


def without_samples(part: Correlations, left: Mapping[int, Remnant]) -> Correlations:
    """Correlations whose stretches are those of remnants."""
    stretches = tuple(replace(each, flight=left[id(each.flight)]) for each in part.stretches)
    return replace(part, stretches=stretches)


def filter_errors(
    part: Correlations, filters: Sequence[PhyFilter], method: Method, offset: bool
) -> FloatArray:
    """Weighted sums of squared errors of some filters on stretches, less their means with an ``offset``."""
    data: Any = part
    if offset:
        data = Pooled([part, Offsets([[each] for each in part.stretches], method, rough=True)])
    found = np.full(len(filters), np.inf)
    for i, filter in enumerate(filters):
        chain = chain_of(filter.poles)
        c, moments = chain.output(filter.b), data.moments(chain.doubled)
        if moments is not None:
            G, m = moments[0][: len(c), : len(c)], moments[1][: len(c)]
            found[i] = max(data.energy - 2.0 * float(c @ m) + float(c @ G @ c), 0.0)
    return found


def response_errors(part: Correlations, taps: FloatArray, offset: bool) -> float:
    """Weighted sum of squared errors of an impulse response on stretches, less their means with an ``offset``."""
    L = len(taps)
    r, c = part.sequences[:, :L]
    own = np.correlate(taps, taps, "full")[L - 1 :]
    total = part.energy - 2.0 * float(taps[: len(c)] @ c) + 2.0 * float(own[: len(r)] @ r)
    for each in part.stretches:
        first, last = (_beyond(each.flight, place, taps) for place in (each.first, each.last))
        total += each.weight * float(np.sum(first**2) - np.sum(last**2))
        if offset:
            of_u, of_target = each.flight.totals(each.first, each.last)
            left = of_target - np.sum(taps) * of_u + last.sum(axis=0) - first.sum(axis=0)
            total -= each.weight * float(left @ left) / (each.last - each.first)
    return max(total, 0.0)


def _beyond(flight: Flight, place: int, taps: FloatArray) -> FloatArray:
    """What an impulse response makes, from a place on, of u before it (L - 1, K)."""
    past = flight.before(place)[0][:, : len(taps) - 1].T[::-1]
    if len(past) == 0 or len(taps) < 2:
        return np.zeros((0, past.shape[1]))
    return oaconvolve(past, taps[:, None], axes=0)[len(past) :]
