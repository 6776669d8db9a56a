"""Flights cut into folds: what is learned without one is scored on it.

Whole flights where there are several, for flights are what is independent; contiguous blocks of few ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...filter.sampling import Method
from .correlation import MOST_LAGS, Correlations, Stretch
from .offsets import Offsets
from .remnant import Remnant, filter_errors, remnants, without_samples
from .residuals import Flight, each
from .samples import Pooled, Samples, response
from .sensitivity import Data

__all__ = ["Folds", "Group", "scored"]

MOST = 8
_WHOLE_FLIGHTS = 5  # so many, and no flight is cut
_ONE_RATE = 0.01  # flights whose steps agree to this share one response


@dataclass(frozen=True, eq=False)
class Group:
    """Flights of one rate: the stretches of each fold, and their correlations."""

    folds: list[list[Stretch]]
    parts: list[Correlations | None]
    weighted: bool  # samples one by one

    @property
    def is_kept(self) -> bool:
        """Whether the samples are gone."""
        return any(isinstance(part.flight, Remnant) for fold in self.folds for part in fold)

    def kept(self) -> Group:
        """Without samples."""
        stretches = [part for fold in self.folds for part in fold]
        reach = max(part.sequences.shape[1] for part in self.parts if part is not None)
        left = remnants(stretches, reach)
        folds = [[replace(part, flight=left[id(part.flight)]) for part in fold] for fold in self.folds]
        parts = [None if part is None else without_samples(part, left) for part in self.parts]
        return Group(folds, parts, self.weighted)

    def without(self, fold: int | None) -> list[Correlations]:
        """The correlations of the other folds."""
        return [part for i, part in enumerate(self.parts) if i != fold and part is not None]


@dataclass(frozen=True, eq=False)
class Folds:
    """Flights in folds.

    Attributes
    ----------
    groups : list of Group
        By rate, the largest first.
    method : {"exact", "matched", "euler", "tustin"}
    offset : bool
        Whether each flight's label has an offset of its own: fitted along, and taken off the errors of a fold.
    """

    groups: list[Group]
    method: Method
    offset: bool

    @classmethod
    def of(
        cls,
        flights: Sequence[Flight],
        method: Method,
        lags: float,
        *,
        offset: bool = False,
        by_flight: bool = False,
    ) -> Folds:
        """Cut flights into folds.

        Parameters
        ----------
        flights : sequence of Flight
        method : {"exact", "matched", "euler", "tustin"}
        lags : float
            Seconds that correlations must reach back.
        offset : bool
        by_flight : bool
            A fold for every flight, however few or many.
        """
        kinds: list[list[Flight]] = []
        for flight in flights:
            if not flight.takes_part:
                continue
            for kind in kinds:
                if _alike(kind[0], flight):
                    kind.append(flight)
                    break
            else:
                kinds.append([flight])
        kinds.sort(key=lambda kind: -sum(flight.samples for flight in kind))
        ordered = [flight for kind in kinds for flight in kind]
        folds = [[_whole(flight)] for flight in ordered] if by_flight else _folds(ordered)
        groups = []
        for kind in kinds:
            members = {id(flight) for flight in kind}
            own = [[part for part in fold if id(part.flight) in members] for fold in folds]
            reach = min(max(int(lags / kind[0].dt), 1), MOST_LAGS)
            parts = [Correlations.of(fold, method, reach, rough=True) if fold else None for fold in own]
            groups.append(Group(own, _same_lags(parts), kind[0].is_weighted))
        return cls(groups, method, offset)

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.groups[0].folds)

    @property
    def are_flights(self) -> bool:
        """Whether no flight is cut."""
        parts = [part for i in range(self.count) for part in self.stretches(i)]
        return all(part.first == part.flight.first and part.last == part.flight.length for part in parts)

    def stretches(self, fold: int) -> list[Stretch]:
        """The stretches of a fold."""
        return [part for group in self.groups for part in group.folds[fold]]

    @cached_property
    def weights(self) -> FloatArray:
        """Sum of the weights (count,) of each fold."""
        return np.array([sum(_weight(part) for part in self.stretches(i)) for i in range(self.count)])

    def data(self, folds: Sequence[int]) -> Data:
        """The data of some folds. Steps that differ are taken as equal, but for flights with weights of samples."""
        chosen = set(folds)
        parts: list[Data] = []
        for group in self.groups:
            if group.weighted:
                parts += self._sample_by_sample(group, chosen)
                continue
            kept = [part for i, part in enumerate(group.parts) if i in chosen and part is not None]
            parts += [Correlations.joined(kept)] if kept else []
            if self.offset and kept:
                parts.append(
                    Offsets(_by_flight([p for own in kept for p in own.stretches]), self.method, rough=True)
                )
        return parts[0] if len(parts) == 1 else Pooled(parts)

    def without(self, fold: int) -> Data:
        """The data of the other folds."""
        return self.data([i for i in range(self.count) if i != fold])

    def errors(self, filters: Sequence[PhyFilter], fold: int) -> FloatArray:
        """Weighted sums of squared errors of some filters on a fold."""
        work = partial(_errors_of, filters=filters, method=self.method, offset=self.offset)
        found: list[FloatArray] = []
        for group in self.groups:
            if not group.is_kept:
                found += each(work, group.folds[fold])
            elif (part := group.parts[fold]) is not None:
                found.append(filter_errors(part, filters, self.method, self.offset))
        return np.sum(found, axis=0)

    def kept(self) -> Folds:
        """The same without samples, of flights of equal steps whose samples count alike."""
        return Folds([group.kept() for group in self.groups], self.method, self.offset)

    @property
    def nbytes(self) -> int:
        """Bytes of correlations and of what is kept of u."""
        flights = {id(p.flight): p.flight for group in self.groups for fold in group.folds for p in fold}
        left = sum(flight.nbytes for flight in flights.values() if isinstance(flight, Remnant))
        return left + sum(
            part.sequences.nbytes for group in self.groups for part in group.parts if part is not None
        )

    def _sample_by_sample(self, group: Group, chosen: set[int]) -> list[Data]:
        flights = {id(part.flight): part.flight for fold in group.folds for part in fold}
        out: dict[int, list[Stretch]] = {key: [] for key in flights}
        for i, fold in enumerate(group.folds):
            for part in fold:
                out[id(part.flight)] += [] if i in chosen else [part]
        masked = [
            flights[key].masked([slice(part.first, part.last) for part in held]) if held else flights[key]
            for key, held in out.items()
        ]
        taking = [flight for flight in masked if flight.takes_part]
        return [*each(partial(Samples, method=self.method, offset=self.offset), taking)]


def scored(part: Stretch, y: FloatArray, offset: bool) -> float:
    """Weighted sum of squares of gamma* - y on a stretch, less their mean with an ``offset``."""
    rows = slice(part.first, part.last)
    errors, given = part.flight.target[rows] - y, part.flight.sample_weights
    weights = np.ones_like(errors) if given is None else given[rows]
    if offset:
        total = np.maximum(weights.sum(axis=0), np.finfo(float).tiny)
        errors = errors - (weights * errors).sum(axis=0) / total
    return part.weight * float(np.sum(weights * errors**2))


def _errors_of(part: Stretch, filters: Sequence[PhyFilter], method: Method, offset: bool) -> FloatArray:
    answers = (response(filter, part.flight, method, part.last)[part.first :] for filter in filters)
    return np.array([scored(part, y, offset) for y in answers])


def _alike(one: Flight, other: Flight) -> bool:
    if one.is_weighted != other.is_weighted or one.is_even != other.is_even:
        return False
    return abs(one.dt - other.dt) <= (1e-6 if one.is_even else _ONE_RATE) * other.dt


def _whole(flight: Flight) -> Stretch:
    return Stretch(flight, flight.first, flight.length, flight.weight)


def _folds(flights: Sequence[Flight]) -> list[list[Stretch]]:
    """Whole flights, or contiguous blocks of about one size, dealt out to the folds."""
    folds: list[list[Stretch]] = [[] for _ in range(MOST)]
    if len(flights) >= _WHOLE_FLIGHTS:
        for flight in sorted(flights, key=lambda flight: -flight.samples):
            min(folds, key=lambda fold: sum(part.samples for part in fold)).append(_whole(flight))
        return [fold for fold in folds if fold]
    total = sum(flight.samples for flight in flights)
    dealt = 0
    for flight in flights:
        length = flight.length - flight.first
        blocks = min(max(1, round(MOST * flight.samples / total)), MOST, length)
        edges = np.linspace(flight.first, flight.length, blocks + 1).astype(int)
        for first, last in pairwise(edges):
            folds[dealt % MOST].append(Stretch(flight, int(first), int(last), flight.weight))
            dealt += 1
    return [fold for fold in folds if fold]


def _by_flight(stretches: Sequence[Stretch]) -> list[list[Stretch]]:
    found: dict[int, list[Stretch]] = {}
    for part in stretches:
        found.setdefault(id(part.flight), []).append(part)
    return list(found.values())


def _same_lags(parts: list[Correlations | None]) -> list[Correlations | None]:
    """Early blocks know of fewer lags; the others' sums there are 0."""
    most = max(part.sequences.shape[1] for part in parts if part is not None)
    padded: list[Correlations | None] = []
    for part in parts:
        if part is None:
            padded.append(None)
            continue
        sequences = np.zeros((2, most))
        sequences[:, : part.sequences.shape[1]] = part.sequences
        padded.append(
            Correlations(
                part.stretches, part.dt, part.method, sequences, part.energy, part.weight, part.rough
            )
        )
    return padded


def _weight(part: Stretch) -> float:
    if not part.flight.is_weighted or (weights := part.flight.sample_weights) is None:
        return part.weight * part.samples
    return part.weight * float(np.sum(weights[part.first : part.last]))
