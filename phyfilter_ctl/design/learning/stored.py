"""Flights that stay where they are: in files, on a cluster's disks, behind a function that makes them.

A :class:`StoredFlight` reads itself when its signals are asked for; a process keeps the last two. One survey reads
every flight once, side by side, and keeps what is exact and small of it: its correlations (summed up, in the order of
the flights), its beginning and end, and what its label is checked by. With these a descent does not read again,
whatever the length and number of the flights, unless a filter remembers more than the ends that were kept.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from weakref import WeakValueDictionary

import numpy as np

from ..._sections import FloatArray
from ...execution import Executor
from ...filter.sampling import Method
from ...recording import Recording
from .correlation import MOST_LAGS, Correlations, Stretch, reduced
from .label_check import FlightSums, label_sums
from .residuals import BEGINNINGS, Flight, flights_of

__all__ = [
    "ENDS",
    "Answer",
    "OneFlight",
    "Source",
    "StoredFlight",
    "StoredFlights",
    "load",
    "serve",
    "surveyed",
]

OneFlight: TypeAlias = Recording | str | os.PathLike[str] | Callable[[], Recording]

# Bytes that the ends of all flights may take together.
ENDS = 1 << 27
# Samples that their beginnings may take together: those of longer flights are longer.
_BEGUN = 2 * BEGINNINGS
_SAME_STEP = 1e-6


_SIGNALS = ("u", "target", "steps", "sample_weights", "g")
# By token: in a worker there is none.
_EXECUTORS: WeakValueDictionary[str, Executor] = WeakValueDictionary()


def serve(token: str, executor: Executor) -> None:
    """Let an executor do what is asked of the flights with a token, as long as it lives."""
    _EXECUTORS[token] = executor


# -- one flight ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Source:
    """How a flight is read; the token tells the flights of one call from those of another."""

    token: str
    index: int
    name: str = field(compare=False)
    load: Callable[[], Flight] = field(compare=False)
    how: str = ""  # it was changed


@lru_cache(maxsize=2)
def _loaded(source: Source) -> Flight:
    return source.load()


class Survey(NamedTuple):
    """What is kept of a flight."""

    shape: tuple[int, int]
    dt: float
    weight: float
    is_even: bool
    is_weighted: bool
    is_constant: tuple[bool, bool]
    power: float
    takes_part: bool
    longest_step: float
    has_g: bool
    beginning: Flight
    end: FloatArray
    totals: tuple[FloatArray, FloatArray]
    sums: FlightSums
    channels: tuple[str, ...]
    mean_step: float
    gaps: tuple[float, ...]
    head: FloatArray  # u of the steps that do not count

    def bare(self, **changed: Any) -> Survey:
        """Without signals."""
        return self._replace(beginning=self.beginning.beginning(0), end=self.end[:0], **changed)


# What a survey finds: also the correlations and squares of a plain flight. Or why it is bad.
Answer: TypeAlias = tuple[Survey, tuple[FloatArray, float] | None] | str


class StoredFlight(Flight):
    """A flight that is read when its signals are asked for.

    Attributes
    ----------
    source : Source
    survey : Survey
        What is known of it without reading.
    """

    source: Source
    survey: Survey

    def __init__(self, source: Source, survey: Survey) -> None:
        known = {"dt": survey.dt, "weight": survey.weight, "channels": survey.channels}
        known |= {"log": source.index, "mean_step": survey.mean_step, "gaps": survey.gaps}
        known |= {"first": len(survey.head)}
        self.__dict__.update(known, source=source, survey=survey)

    def __getattr__(self, name: str) -> Any:
        """The signals."""
        if name not in _SIGNALS:
            raise AttributeError(name)
        found = _loaded(self.source)
        if found.u.shape != self.survey.shape or found.dt != self.dt:
            raise ValueError(f"{self.source.name}: changed while learn was reading it; start again")
        return getattr(found, name)

    def __getstate__(self) -> dict[str, Any]:
        """For a worker: how to read it, and no more."""
        return {**self.__dict__, "survey": self.survey.bare()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)

    @property
    def executor(self) -> Executor | None:
        return _EXECUTORS.get(self.source.token)

    @property
    def is_even(self) -> bool:
        return self.survey.is_even

    @property
    def is_weighted(self) -> bool:
        return self.survey.is_weighted

    @property
    def is_constant(self) -> tuple[bool, bool]:
        return self.survey.is_constant

    @property
    def power(self) -> float:
        return self.survey.power

    @property
    def takes_part(self) -> bool:
        return self.survey.takes_part

    @property
    def length(self) -> int:
        return self.survey.shape[0]

    @property
    def samples(self) -> int:
        return (self.survey.shape[0] - self.first) * self.survey.shape[1]

    @property
    def width(self) -> int:
        return self.survey.shape[1]

    @property
    def longest_step(self) -> float:
        return self.survey.longest_step

    @property
    def has_g(self) -> bool:
        return self.survey.has_g

    def totals(self, first: int, last: int) -> tuple[FloatArray, FloatArray]:
        """As of a flight in memory; those of what counts were kept."""
        if (first, last) == (self.first, self.length):
            return self.survey.totals
        return super().totals(first, last)

    def before(self, place: int) -> tuple[FloatArray, bool]:
        """As of a flight in memory; those of the end were kept."""
        end = self.survey.end
        if place == self.first:
            return self.survey.head.T[:, ::-1], True
        if place == self.length:
            return end.T[:, ::-1], len(end) == place
        return super().before(place)

    def beginning(self, count: int) -> Flight:
        """As of a flight in memory; a short one was kept."""
        kept = self.survey.beginning
        if min(count, self.length) <= kept.length:
            return kept.beginning(count)
        shape = (min(count, self.length), self.survey.shape[1])
        source = self._source(f"first {count}", partial(_beginning, count=count))
        return StoredFlight(source, self.survey.bare(shape=shape))

    def masked(self, rows: Sequence[slice]) -> Flight:
        """As of a flight in memory, done when it is read."""
        return self._derived(f"without {rows}", partial(_masked, rows=tuple(rows)), is_weighted=True)

    def levelled(self) -> Flight:
        """As of a flight in memory, done when it is read."""
        dt = self.mean_step or self.dt
        return self._derived("levelled", Flight.levelled, dt=dt, is_even=True, is_weighted=False)

    def _derived(self, how: str, make: Callable[[Flight], Flight], **known: Any) -> StoredFlight:
        """A flight that is made of this one when it is read."""
        source = self._source(how, make)
        found = _loaded(source) if self.is_weighted else None
        totals = self.survey.totals if found is None else found.totals(self.first, self.length)
        return StoredFlight(source, self.survey.bare(**known, totals=totals))

    def _source(self, how: str, make: Callable[[Flight], Flight]) -> Source:
        return replace(self.source, how=how, load=partial(_made_of, self.source, make))


def _beginning(flight: Flight, count: int) -> Flight:
    return flight.beginning(count)


def _masked(flight: Flight, rows: Sequence[slice]) -> Flight:
    return flight.masked(rows)


def _made_of(source: Source, make: Callable[[Flight], Flight]) -> Flight:
    return make(_loaded(source))


def load(log: OneFlight, read: Callable[[Path], Recording], weight: Any, options: dict[str, Any]) -> Flight:
    """One flight in memory, read or made where it is not yet."""
    if isinstance(log, str | os.PathLike):
        log = read(Path(log))
    elif callable(log):
        log = log()
    weight = 1.0 if weight is None else weight
    if np.any(weight):
        return flights_of([log], weights=[weight], **options)[0]
    return replace(flights_of([log], **options)[0], weight=0.0)


def surveyed(source: Source, *, flights: int, skip: bool) -> Answer:
    """Read one of so many flights."""
    try:
        flight = _loaded(source)
    except (ValueError, TypeError, OSError) as error:
        if skip:
            return str(error)
        text = str(error)
        raise ValueError(text if source.name in text else f"{source.name}: {text}") from error
    m, count = flight.u.shape
    kept = min(m, max(1, ENDS // flights // (8 * count)))
    survey = Survey(
        (m, count),
        flight.dt,
        flight.weight,
        flight.is_even,
        flight.is_weighted,
        flight.is_constant,
        flight.power,
        flight.takes_part,
        flight.longest_step,
        flight.has_g,
        flight.beginning(_BEGUN // flights),
        flight.u[m - kept :].copy(),
        flight.totals(flight.first, m),
        label_sums(flight),
        flight.channels,
        flight.mean_step,
        flight.gaps,
        flight.u[: flight.first].copy(),
    )
    if not (flight.takes_part and flight.is_plain):
        return survey, None
    return survey, reduced(Stretch(flight, flight.first, m, 1.0), min(m, MOST_LAGS))


# -- all of them --------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class _Total:
    """Plain flights of one step: their correlations, weighted and summed."""

    stretches: list[Stretch]
    sequences: FloatArray
    energy: float

    def add(self, flight: Flight, sequences: FloatArray, energy: float) -> None:
        """Count the correlations and the energy of a flight."""
        longer = sequences.shape[1] - self.sequences.shape[1]
        if longer > 0:
            self.sequences = np.pad(self.sequences, ((0, 0), (0, longer)))
        self.sequences[:, : sequences.shape[1]] += flight.weight * sequences
        self.energy += flight.weight * energy
        self.stretches.append(Stretch(flight, flight.first, flight.length, flight.weight))


@dataclass(eq=False)
class StoredFlights(Sequence[Flight]):
    """Flights that were surveyed.

    Attributes
    ----------
    sources : sequence of Source
        Of all logs.
    flights : list of StoredFlight
    skipped : list of (str, str)
        Bad ones that were left out, and why.
    """

    sources: Sequence[Source] = ()
    flights: list[StoredFlight] = field(default_factory=list)
    skipped: list[tuple[str, str]] = field(default_factory=list)
    _totals: list[_Total] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.flights)

    def __getitem__(self, index: Any) -> Any:
        return self.flights[index]

    def __iter__(self) -> Iterator[StoredFlight]:
        return iter(self.flights)

    @property
    def names(self) -> list[str]:
        """Of all logs."""
        return [source.name for source in self.sources]

    def leave_out(self, logs: Collection[int]) -> None:
        """Drop the flights of some logs, whose steps are not those of others."""
        self.flights = [flight for flight in self.flights if flight.log not in logs]
        self._totals = [total for total in self._totals if total.stretches[0].flight.log not in logs]

    @property
    def sums(self) -> list[FlightSums]:
        """What their labels are checked by."""
        return [flight.survey.sums for flight in self.flights]

    def correlations(self, method: Method) -> list[Correlations]:
        """Of the plain ones, by their steps."""
        return [
            Correlations.summed(total.stretches, method, total.sequences.copy(), total.energy)
            for total in self._totals
        ]

    def add(self, flight: StoredFlight, found: tuple[FloatArray, float] | None) -> None:
        """Count a flight; what was found of a plain one are its correlations and its energy."""
        self.flights.append(flight)
        self._bound()
        if found is None:
            return
        for total in self._totals:
            dt = total.stretches[0].flight.dt
            if abs(flight.dt - dt) <= _SAME_STEP * flight.dt:
                return total.add(flight, *found)
        self._totals.append(_Total([], np.zeros((2, 1)), 0.0))
        return self._totals[-1].add(flight, *found)

    def _bound(self) -> None:
        """Halve the beginnings, and the longest ends, while all together are too long."""
        if sum(flight.survey.beginning.length for flight in self.flights) > _BEGUN:
            for flight in self.flights:
                begun = flight.survey.beginning.beginning(_BEGUN // 2 // len(self.flights))
                flight.__dict__["survey"] = flight.survey._replace(beginning=begun)
        while sum(flight.survey.end.nbytes for flight in self.flights) > ENDS:
            most = max(len(flight.survey.end) for flight in self.flights) // 2
            for flight in self.flights:
                end = flight.survey.end[-most:].copy()
                flight.__dict__["survey"] = flight.survey._replace(end=end)
