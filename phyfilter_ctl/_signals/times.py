"""Times, which carry a unit: numbers are seconds, unless they are whole numbers that only ticks of a clock can be."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from .arrays import LARGEST, Where, array, refuse_unusable, row, unmasked
from .containers import are_whole, contained_times, from_calendar, text_advice
from .numbers import number

__all__ = ["duration", "interval", "refuse_ticks", "refuse_unordered", "sample_times", "seconds"]

# Whole numbers this far apart count something shorter than seconds.
_TICKS = 1000.0
_UNITS = "divided by 1e3 (ms), 1e6 (us) or 1e9 (ns); if they are seconds, as floating-point numbers"
_OTHERS = {"c": "give their real part"}
_SHOWN = 5  # rows that an error lists


def seconds(name: str, values: ArrayLike) -> FloatArray:
    """Times in seconds, a copy as float64; a missing one is NaN.

    Parameters
    ----------
    name : str
        For the complaint.
    values : array_like
        Seconds; or timedelta64, which has its unit with it; or datetime64, counted from the first, in whole ticks
        until then, so that nothing is lost of times that lie decades after 1970; or timedelta and datetime objects.
        Times with a time zone are counted in UTC, those without as they stand: in a zone that changes its clocks
        they jump.

    Raises
    ------
    TypeError
        If they are no numbers, or some have a time zone and some do not.
    ValueError
        If they are whole numbers that count no seconds, or have a unit without a length (months, none).

    Examples
    --------
    >>> import numpy as np
    >>> seconds("times", np.array(["2024-05-01T10:00:00.002", "2024-05-01T10:00:00.004"], "datetime64[ns]"))
    array([0.   , 0.002])
    """
    given = np.asarray(unmasked(contained_times(name, values)))
    if given.dtype.kind == "O":
        given = from_calendar(name, given)
    if given.dtype.kind == "M":
        if np.datetime_data(given.dtype)[0] in ("Y", "M"):
            given = given.astype("datetime64[s]")
        given = given - given.ravel()[:1]
    if given.dtype.kind == "m":
        unit = np.datetime_data(given.dtype)[0]
        if unit in ("Y", "M", "generic"):
            raise ValueError(
                f"{name}: timedelta64[{unit}] has no length in seconds; give one in s, ms, us or ns"
            )
        return np.asarray(given / np.timedelta64(1, "s"), dtype=float)
    if given.dtype.kind in "iu" or are_whole(values):
        refuse_ticks(name, given.astype(float), f"as timedelta64, or {_UNITS}")
    if given.dtype.kind not in "fiu":
        raise TypeError(
            f"{name}: expected times in seconds, datetime64 or timedelta64, got {given.dtype}; "
            f"{text_advice(given.dtype.kind) or _OTHERS.get(given.dtype.kind, 'convert them to float')}"
        )
    return np.array(given, dtype=float)


def refuse_ticks(name: str, times: FloatArray, remedy: str) -> None:
    """Raise for whole numbers whose steps are absurd as seconds: a clock that counts milli-, micro- or nanoseconds.

    Parameters
    ----------
    name : str
    times : (N,) array
        Whole numbers.
    remedy : str
        How to give them.
    """
    steps = np.abs(np.diff(times)) if times.ndim == 1 else np.zeros(0)
    if len(steps) and (step := float(np.median(steps))) >= _TICKS:
        raise ValueError(
            f"{name}: steps of {step:.6g} as whole numbers are ticks of a clock, not seconds; give them {remedy}"
        )


def interval(name: str, value: float | np.timedelta64 | timedelta) -> float:
    """A length of time in seconds, of any sign: a number, or timedelta64, which has its unit with it.

    Parameters
    ----------
    name : str
        For the complaint.
    value : float, numpy.timedelta64 or datetime.timedelta

    Raises
    ------
    TypeError, ValueError
        As for :func:`seconds`.

    Examples
    --------
    >>> interval("dt", np.timedelta64(2, "ms"))
    0.002
    """
    if isinstance(value, timedelta):
        return value.total_seconds()
    if isinstance(value, np.timedelta64):
        return float(seconds(name, [value])[0])
    if isinstance(value, int | np.integer):
        refuse_ticks(name, np.array([0.0, float(value)]), _UNITS)
    return value  # whatever else it is, the caller judges


def duration(name: str, value: float | np.timedelta64 | timedelta) -> float:
    """A length of time above zero, in seconds; as for :func:`interval` and :func:`number`.

    Examples
    --------
    >>> duration("dt", timedelta(milliseconds=2))
    0.002
    """
    return number(name, interval(name, value), "s", above=0.0)


def sample_times(name: str, values: ArrayLike, n: int | None = None, *, beside: str = "x") -> FloatArray:
    """Finite, increasing times in seconds.

    Parameters
    ----------
    name : str
    values : array_like
        As for :func:`seconds`.
    n : int, optional
        How many; None for any number above 0.
    beside : str
        What has as many.

    Raises
    ------
    TypeError, ValueError
        As for :func:`seconds`; if their shape is not (n,), one is not finite, or they do not increase.

    Examples
    --------
    >>> sample_times("times", [0.0, 1.0, 1.0])
    Traceback (most recent call last):
        ...
    ValueError: times: expected increasing times, got row 2 (1 s, then 1 s: stands still); drop ...
    """
    beside = "" if n is None else beside
    found = array(name, seconds(name, values), ("N" if n is None else n,), beside=beside, finite=False)
    refuse_unusable(name, found, where=row)
    refuse_unordered(name, found)
    return found


def refuse_unordered(name: str, times: FloatArray, where: Where = row) -> None:
    """Raise unless times increase.

    Parameters
    ----------
    name : str
    times : (N,) array
    where : callable
        What the index is called.
    """
    bad = np.flatnonzero(np.diff(times) <= 1.0 / LARGEST) + 1
    if not len(bad):
        return
    listed = [
        f"{where(int(k))} ({times[k - 1]:.9g} s, then {times[k]:.9g} s: "
        f"{'stands still' if times[k] >= times[k - 1] else 'runs back'})"
        for k in bad[:_SHOWN]
    ]
    more = f" and {len(bad) - _SHOWN} more" if len(bad) > _SHOWN else ""
    raise ValueError(
        f"{name}: expected increasing times, got {', '.join(listed)}{more}; drop repeated samples, split the log where "
        "it starts again"
    )
