"""Flights as ``learn`` takes them: recordings, files, folders, functions; the bad ones left out or refused."""

from __future__ import annotations

import os
import sys
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Any, TypeAlias, cast

from ...execution import Executor, Report
from ...recording import Recording
from .options import Reading
from .residuals import Flight, flights_of, other_channels, other_time_units
from .stored import Answer, OneFlight, Source, StoredFlight, StoredFlights, load, serve, surveyed

__all__ = ["Reader", "Recordings", "files_of", "first_of", "listed"]

Recordings: TypeAlias = OneFlight | Sequence[OneFlight] | Callable[[], Iterable[Recording]]
Bad: TypeAlias = tuple[tuple[str, str], ...]

# Bytes of all files below which one process reads them sooner than several do that have to start.
_SMALL = 64 << 20
# Flights that a function makes are not counted beforehand.
_FLIGHTS_MADE = 1 << 6
_TABLES = (".parquet", ".pq", ".arrow", ".feather", ".csv")


@dataclass(frozen=True)
class Reader:
    """Reads the flights of one call of ``learn``.

    Attributes
    ----------
    stack : ExitStack
        Ends the workers that were started.
    how : Reading
    options : mapping
        Of :func:`flights_of`.
    """

    stack: ExitStack
    how: Reading
    options: Mapping[str, Any]

    executors: list[Executor] = field(default_factory=list)

    @property
    def skip(self) -> bool:
        """Whether bad flights are left out."""
        return self.how.on_bad == "skip"

    @property
    def is_spread(self) -> bool:
        """Whether a cluster reads."""
        return not isinstance(self.how.workers, int | NoneType)

    def executor(self, logs: Sequence[OneFlight]) -> Executor:
        """Started when the first flights are read; in this process where these are small."""
        if not self.executors:
            workers = self.how.workers
            if workers is None and _are_small(logs):
                workers = 1
            here = isinstance(workers, int | NoneType)
            made = Executor(workers) if here else Executor(scheduler=workers)
            self.executors.append(self.stack.enter_context(made))
        return self.executors[0]

    def flights(
        self, name: str, logs: Recordings, weights: Sequence[Any] | None
    ) -> tuple[Sequence[Flight], Bad]:
        """Flights, whose signals are in memory or not, and the bad ones that were left out.

        Raises
        ------
        TypeError
            If ``logs`` hold something else, or an iterator.
        ValueError, OSError
            If there are none, or one is bad and not skipped.
        """
        found = listed(name, logs)
        if not isinstance(found, list):
            stored = _made_flights(self, found, weights)
        elif self.is_spread or any(isinstance(log, str | os.PathLike) or callable(log) for log in found):
            stored = _stored_flights(self, found, weights)
        else:
            return self._of_one_clock(
                name, found, *self._at_hand(name, cast("list[Recording]", found), weights)
            )
        return self._of_one_clock(name, stored.names, stored, tuple(stored.skipped))

    def _of_one_clock(
        self, name: str, logs: Sequence[OneFlight], flights: Sequence[Flight], bad: Bad
    ) -> tuple[Sequence[Flight], Bad]:
        """Flights without those whose times are in another unit than most, which are bad."""
        faults = other_time_units(flights)
        named = {i: _name(logs[i], i) for i in faults}
        if faults and (not self.skip or len(faults) == len({flight.log for flight in flights})):
            i, fault = next(iter(faults.items()))
            raise ValueError(f"{name}: {named[i]}: {fault}")
        if not faults:
            return flights, bad
        if isinstance(flights, StoredFlights):
            flights.leave_out(faults)
            kept: Sequence[Flight] = flights
        else:
            kept = [flight for flight in flights if flight.log not in faults]
        return kept, (*bad, *((named[i], fault) for i, fault in faults.items()))

    def _at_hand(
        self, name: str, logs: list[Recording], weights: Sequence[Any] | None
    ) -> tuple[list[Flight], Bad]:
        if not self.skip:
            found = flights_of(logs, weights=weights, **self.options)
            for flight in found:
                if fault := other_channels(flight, found[0]):
                    raise ValueError(f"{name}: log {flight.log} {fault}")
            return found, ()
        entries = [1.0] * len(logs) if weights is None else weights
        found = list[Flight]()
        bad: list[tuple[str, str]] = []
        for i, (log, entry) in enumerate(zip(logs, entries, strict=True)):
            try:
                flight = load(log, self.how.read, entry, dict(self.options))
                if fault := other_channels(flight, (found or [flight])[0]):
                    raise ValueError(fault)
                found.append(replace(flight, log=i))
            except ValueError as error:
                bad.append((_name(log, i), str(error)))
        _refuse_empty(found, bad)
        return found, tuple(bad)


def listed(name: str, logs: object) -> list[OneFlight] | Callable[[], Iterable[Recording]]:
    """Flights one by one, a folder as its files; or the function that makes them.

    Raises
    ------
    TypeError
        For an iterator, which is used up by one pass, or something else.
    ValueError
        Without any.
    """
    if isinstance(logs, str | os.PathLike):
        found: list[OneFlight] = [*files_of(Path(logs))]
    elif isinstance(logs, Recording):
        found = [logs]
    elif isinstance(logs, Mapping) or hasattr(logs, "columns"):
        raise TypeError(
            f"{name}: expected Recordings, files or a function, got {type(logs).__name__}; give the recordings of a "
            "mapping as list(logs.values()), and of a table Recording.from_arrays(...)"
        )
    elif isinstance(logs, Iterator):
        raise TypeError(
            f"{name}: an iterator or generator is used up after one pass, and learning makes several; give a function "
            "that begins anew each time, as lambda: flights(), or a list of files"
        )
    elif callable(logs):
        return cast("Callable[[], Iterable[Recording]]", logs)
    elif isinstance(logs, Iterable):
        found = [
            file
            for log in logs
            for file in (files_of(Path(log)) if isinstance(log, str | os.PathLike) else [log])
        ]
    else:
        raise TypeError(f"{name}: expected Recordings, files or a function, got {type(logs).__name__}")
    if not found:
        raise ValueError(f"{name}: expected at least one Recording or file, got none")
    return found


def files_of(path: Path) -> list[Path]:
    """The tables of a folder, in the order of their paths; a file as it is.

    Raises
    ------
    ValueError
        If a folder holds none.
    """
    if any(sign in str(path) for sign in "*?") and not path.exists():
        raise ValueError(f"{path}: no such file; of a pattern give sorted(Path('folder').glob('*.csv'))")
    if not path.is_dir() or (path / "metadata.yaml").is_file():  # a ROS 2 bag
        return [path]
    files = sorted(file for file in path.rglob("*") if file.suffix.lower() in _TABLES)
    if not files:
        raise ValueError(f"{path}: a folder without {', '.join(_TABLES)} files")
    return files


def first_of(recordings: Recordings, how: Reading) -> Recording:
    """The first good recording.

    Raises
    ------
    ValueError, OSError
        If there is none.
    """
    found = listed("recordings", recordings)
    for log in found if isinstance(found, list) else found():
        try:
            if isinstance(log, str | os.PathLike):
                return how.read(Path(log))
            return log if isinstance(log, Recording) else log()
        except (ValueError, OSError):
            if how.on_bad == "raise":
                raise
    raise ValueError("recordings: no good flight among them")


def _stored_flights(how: Reader, logs: list[OneFlight], weights: Sequence[Any] | None) -> StoredFlights:
    """Every flight read once, side by side."""
    if weights is not None and len(weights) != len(logs):
        raise ValueError(f"weights: expected one entry for each of the {len(logs)} logs, got {len(weights)}")
    token = uuid.uuid4().hex
    executor = how.executor(logs)
    serve(token, executor)
    entries = [None] * len(logs) if weights is None else weights
    sources = [
        Source(token, i, _name(log, i), partial(load, log, how.how.read, entry, dict(how.options)))
        for i, (log, entry) in enumerate(zip(logs, entries, strict=True))
    ]
    survey = partial(surveyed, flights=len(logs), skip=how.skip)
    names = [source.name for source in sources]
    return _gathered(how, sources, executor.map(survey, sources, names=names, report=how.how.report))


def _made_flights(
    how: Reader, make: Callable[[], Iterable[Recording]], weights: Sequence[Any] | None
) -> StoredFlights:
    """Every flight that a function makes, here, one after the other."""
    if weights is not None:
        raise ValueError("weights: flights that a function makes all count alike; give a list of flights")
    if how.is_spread:
        raise ValueError(
            "workers: flights that one function makes one after the other cannot be spread over workers; give a list "
            "of files, or of functions () -> Recording"
        )
    made = _Made(make)
    sources = made.sources(uuid.uuid4().hex, dict(how.options), how.how.report)
    survey = partial(surveyed, flights=_FLIGHTS_MADE, skip=how.skip)
    return _gathered(how, made.known, map(survey, sources))


def _gathered(how: Reader, sources: Sequence[Source], answers: Iterable[Answer]) -> StoredFlights:
    found = StoredFlights(sources)
    for i, answer in enumerate(answers):
        if not isinstance(answer, str):
            survey, sums = answer
            flight = StoredFlight(sources[i], survey)
            if fault := other_channels(flight, (found.flights or [flight])[0]):
                answer = fault
            else:
                found.add(flight, sums)
        if isinstance(answer, str):
            if not how.skip:
                raise ValueError(f"{sources[i].name}: {answer}")
            found.skipped.append((sources[i].name, answer))
    _refuse_empty(found.flights, found.skipped)
    return found


def _are_small(logs: Sequence[OneFlight]) -> bool:
    """Whether all are files that are read sooner than processes start."""
    paths = [Path(log) for log in logs if isinstance(log, str | os.PathLike)]
    return len(paths) == len(logs) and sum(p.stat().st_size for p in paths if p.is_file()) <= _SMALL


def _refuse_empty(found: Sequence[Flight], bad: Sequence[tuple[str, str]]) -> None:
    if not found:
        text = f"; the first: {bad[0][0]}: {bad[0][1]}" if bad else ""
        raise ValueError(f"recordings: no good flight among {len(bad)}{text}")
    if not any(flight.takes_part for flight in found):
        raise ValueError("weights: all are 0, nothing to fit; give at least one flight a positive weight")


def _name(log: OneFlight, index: int) -> str:
    if isinstance(log, str | os.PathLike):
        return os.fspath(log)
    return log.name if isinstance(log, Recording) and log.name else f"flight {index}"


class _Made:
    """Flights that a function makes anew in every pass, one after the other."""

    def __init__(self, make: Callable[[], Iterable[Recording]]) -> None:
        self.make, self.known = make, list[Source]()
        self._logs, self._next = (
            iter(()),
            sys.maxsize,
        )  # flights of the later passes, and the next one's number

    def sources(self, token: str, options: dict[str, Any], report: Report) -> Iterator[Source]:
        """Of the first pass."""
        for i, log in enumerate(self.make()):
            name = _name(log, i)
            report(name)
            self.known.append(Source(token, i, name, partial(self._load, i, options)))
            # The flight at hand is not made twice.
            yield replace(
                self.known[-1],
                token=f"{token}, survey",
                load=partial(load, log, Recording.read, None, options),
            )

    def _load(self, index: int, options: dict[str, Any]) -> Flight:
        if index < self._next:
            self._logs, self._next = iter(self.make()), 0
        for log in self._logs:
            self._next += 1
            if self._next > index:
                return load(log, Recording.read, None, options)
        raise ValueError(
            f"recordings: the function made {self._next} flights in a later pass, {len(self.known)} in the first; it "
            "has to begin anew each time it is called"
        )
