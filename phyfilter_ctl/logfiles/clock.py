"""Clocks: from what a file counts to seconds from a common zero, and what is odd about a topic's times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from .._choices import TimeUnit
from .._sections import FloatArray
from ..recording.checks import is_jump
from ..recording.header import TIMES, stem, unit_of_time

_TICKS: dict[str, float] = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_GAP = 3.0  # a step this many times the median is a gap
_SHORTEST, _LONGEST = 10e-6, 1.0  # of a sampling interval that nobody asks about, s


class TimeUnitError(ValueError):
    """Nobody says what the times of a table count."""


@dataclass(frozen=True)
class Clock:
    """What the times of a topic are like; nothing is put right.

    Attributes
    ----------
    first, last : float
        s from the log's zero; NaN without samples.
    dt : float
        Median step forwards, s; NaN where there is none.
    gaps : int
        Steps of more than 3 dt that are no jumps.
    longest : float
        Longest step that is no jump, s.
    jumps : int
        Steps forwards of more than 60 s and 200 dt: the clock was set, or the log goes on after a pause.
    jumped : float
        Longest of those, s; 0 without one.
    backwards, duplicates, missing : int
        Steps back, steps of length zero, times that are no numbers.

    Examples
    --------
    >>> import numpy as np
    >>> clock = Clock.of(np.array([0.0, 0.1, 0.2, 0.9, 0.9, 0.8]))
    >>> round(clock.dt, 3), clock.gaps, clock.backwards, clock.duplicates
    (0.1, 1, 1, 1)
    """

    first: float
    last: float
    dt: float
    gaps: int
    longest: float
    jumps: int
    jumped: float
    backwards: int
    duplicates: int
    missing: int

    @classmethod
    def of(cls, times: FloatArray) -> Clock:
        """The clock that counted ``times``, shape (N,), s."""
        known = times[np.isfinite(times)]
        steps = np.diff(known)
        forwards = steps[steps > 0.0]
        dt = float(np.median(forwards)) if len(forwards) else float("nan")
        jumped = is_jump(forwards, dt)
        usual = forwards[~jumped]
        return cls(
            first=float(known[0]) if len(known) else float("nan"),
            last=float(known[-1]) if len(known) else float("nan"),
            dt=dt,
            gaps=int(np.count_nonzero(usual > _GAP * dt)),
            longest=float(usual.max()) if len(usual) else float("nan"),
            jumps=int(np.count_nonzero(jumped)),
            jumped=float(forwards[jumped].max(initial=0.0)),
            backwards=int(np.count_nonzero(steps < 0.0)),
            duplicates=int(np.count_nonzero(steps == 0.0)),
            missing=len(times) - len(known),
        )

    @property
    def findings(self) -> tuple[str, ...]:
        """What is odd, each with what it may mean."""
        found: list[str] = []
        if self.dt < _SHORTEST:
            found.append(f"dt {self.dt:.3g} s is below 10 us: a wrong unit of time?")
        if self.dt > _LONGEST:
            found.append(f"dt {self.dt:.3g} s is above 1 s: a slow topic, or a wrong unit of time?")
        if self.gaps:
            found.append(f"{_counted(self.gaps, 'gap')}, the longest {self.longest:.3g} s")
        if self.jumps:
            found.append(
                f"the clock jumps ahead {_counted(self.jumps, 'time')}, by up to {self.jumped:.6g} s: it was set, or "
                "the log goes on after a pause"
            )
        if self.backwards:
            found.append(f"the clock runs back {_counted(self.backwards, 'time')}")
        if self.duplicates:
            found.append(f"{_counted(self.duplicates, 'time')} the same time twice")
        if self.missing:
            found.append(f"{_counted(self.missing, 'sample')} without a time")
        return tuple(found)


def _counted(n: int, word: str) -> str:
    return f"{n} {word}" if n == 1 else f"{n} {word}s"


@dataclass(frozen=True)
class Times:
    """Times of a column, s from its first or the ``zero`` given; ``start`` is UTC of that, where the column says it."""

    seconds: FloatArray
    start: datetime | None
    note: str
    zero: float | int = 0
    unit: str = ""


def since(ticks: NDArray[np.generic], zero: int, unit: str) -> FloatArray:
    """Seconds from ``zero``, exact until the one division; NaN for none of them.

    Parameters
    ----------
    ticks : (N,) array of integers
    zero : int
        In ticks.
    unit : {"s", "ms", "us", "ns"}
    """
    if ticks.dtype.kind == "u":  # a difference below zero wraps around, and is meant
        return (ticks.astype(np.uint64) - np.uint64(zero)).astype(np.int64) / _TICKS[unit]
    return (ticks.astype(np.int64) - np.int64(zero)) / _TICKS[unit]


def column_times(
    name: str,
    values: NDArray[np.generic],
    unit: str | None,
    *,
    said: str = "",
    utc: bool = True,
    zero: float | None = None,
) -> Times:
    """Times of a table's column: datetime64 and timedelta64 have their unit, numbers are given one.

    Parameters
    ----------
    name : str
        Of the column.
    values : (N,) array
    unit : {"s", "ms", "us", "ns"}, optional
        As the caller says it.
    said : {"s", "ms", "us", "ns", ""}
        As the file says it.
    utc : bool
        Whether datetime64 is UTC, and not a local time of some zone.
    zero : float, optional
        Number to count from; None means the first.

    Raises
    ------
    ValueError
        If there is no unit, or two different ones, or no time is finite.
    """
    if values.dtype.kind in "mM":
        _refuse_second(name, unit, f"is {values.dtype}, which has its unit")
        return _calendar(name, values, utc)
    own = said or unit_of_time(name)
    if own:
        _refuse_second(name, None if unit == own else unit, f"is in {own}")
    unit = unit or own
    if not unit:
        raise TimeUnitError(f"column {name!r}: {_question(values)}")
    if values.dtype.kind in "iu" and len(values):
        whole = values.astype(np.uint64 if values.dtype.kind == "u" else np.int64)
        zero = int(whole[0] if zero is None else zero)
        seconds = since(whole, zero, unit)
    else:
        known = values.astype(float)
        finite = known[np.isfinite(known)]
        if not len(finite):
            raise ValueError(f"column {name!r}: no time is a number")
        zero = float(finite[0] if zero is None else zero)
        seconds = (known - zero) / _TICKS[unit]
    return Times(seconds, None, f"time 0 is {zero} {unit} of {name!r}", zero, unit)


def _calendar(name: str, values: NDArray[np.generic], utc: bool) -> Times:
    known = values[~np.isnat(values)]
    if not len(known):
        raise ValueError(f"column {name!r}: no time is given")
    seconds = (values - known[0]) / np.timedelta64(1, "s")
    if values.dtype.kind == "m":
        return Times(np.asarray(seconds, float), None, f"time 0 is {known[0]} of {name!r}")
    start = utc_of(int(known[0].astype("datetime64[us]").astype(np.int64)))
    if not utc:
        return Times(np.asarray(seconds, float), None, f"{name!r} is local time of an unknown zone")
    return Times(np.asarray(seconds, float), start, f"time 0 is the first of {name!r}")


def utc_of(microseconds: int) -> datetime | None:
    """UTC of a count since 1970 without leap seconds; None for what no log is of: before 2000, after 2200."""
    if not 946_684_800_000_000 <= microseconds < 7_258_118_400_000_000:
        return None
    return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=microseconds)


def _refuse_second(name: str, unit: str | None, own: str) -> None:
    if unit is not None:
        raise ValueError(f"column {name!r} {own}: leave time_unit={unit!r} out")


def _question(values: NDArray[np.generic]) -> str:
    """What the steps would be in each unit, so that a person sees which is right."""
    steps = np.diff(values.astype(float))
    steps = steps[steps > 0.0]
    advice = "give time_unit=, one of s, ms, us, ns"
    if not len(steps):
        return f"the file does not say its unit; {advice}"
    dt = float(np.median(steps))
    choices = ", ".join(f"{dt / ticks:.3g} s in {unit}" for unit, ticks in _TICKS.items())
    return f"the file does not say its unit; its steps would be {choices}; {advice}"


def check_unit(unit: str | None) -> None:
    """Raise unless it is one that :func:`column_times` knows, or None."""
    if unit is not None and unit not in get_args(TimeUnit):
        raise ValueError(f"time_unit: expected one of s, ms, us, ns, got {unit!r}")


def time_column(names: Sequence[str], calendar: Sequence[str], time: str | None) -> str:
    """Which column holds the times: the one asked for, else the one with such a name, else the only calendar one.

    Raises
    ------
    ValueError
        If there is none, or more than one that may be meant.
    """
    if time is not None:
        if time not in names:
            raise ValueError(f"time: there is no column {time!r}, only {', '.join(names)}")
        return time
    found = [name for name in names if stem(name) in TIMES] or list(calendar)
    if len(found) == 1:
        return found[0]
    which = f"{', '.join(map(repr, found))} may be the times" if found else "no column is known as the times"
    raise ValueError(f"{which}; name it by time=, one of: {', '.join(names)}")
