"""Frames, series and labelled arrays of other packages, by their array protocols: none of the packages is imported.

Rows go by position; an index is not looked at, nor aligned. Numbers of one type that lie in one block are
not copied.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "are_whole",
    "channel_names",
    "contained",
    "contained_times",
    "from_calendar",
    "labels",
    "text_advice",
]

# What a dimension of samples is called; samples come first.
_SAMPLES = frozenset({"t", "time", "times", "timepts", "sample", "samples"})
_MISSING = frozenset({"NoneType", "NaTType", "NAType"})  # the last two are pandas'
_OWN = (np.ndarray, np.generic, list, tuple, float, int)
_TEXT = (
    "text may mean any format and time zone: convert it, as with pandas.to_datetime(..., utc=True) or "
    "numpy.array(..., 'datetime64[ns]')"
)


def contained(name: str, values: Any) -> Any:
    """Numbers out of a frame, a series or a labelled array, NaN where one is missing; anything else as it is.

    Parameters
    ----------
    name : str
        For the complaint.
    values : object

    Raises
    ------
    TypeError
        If a column of a frame holds no real numbers.
    ValueError
        If the dimensions are named and the samples do not come first.
    """
    if isinstance(values, _OWN) or not hasattr(values, "__array__"):
        return values
    _refuse_transposed(name, values)
    if _is_frame(values):
        types: list[Any] = list(values.dtypes)
        _refuse_columns(name, values, types)
    else:
        types = [getattr(values, "dtype", None)]
        if getattr(types[0], "tz", None) is not None:
            # Without the type pandas makes an object of every sample; xarray asks it for values, which lose the zone.
            index = values.to_index() if hasattr(values, "to_index") else values
            return np.asarray(index, dtype=f"datetime64[{getattr(types[0], 'unit', 'ns')}]")
    plain = isinstance(types[0], np.dtype) and all(each == types[0] for each in types) if types else True
    if not plain and all(getattr(each, "kind", "") in tuple("iufb") for each in types):
        # pandas: columns of several types, or of its own, whose missing entries are no NaN.
        return values.to_numpy(dtype=float, na_value=np.nan)
    return np.asarray(values)


def contained_times(name: str, values: Any) -> Any:
    """Times out of a series, an index or a labelled array, in UTC where they have a time zone.

    Raises
    ------
    TypeError
        If it is a whole frame.
    ValueError
        As for :func:`contained`.
    """
    if isinstance(values, _OWN) or not hasattr(values, "__array__"):
        return values
    if _is_frame(values):
        raise TypeError(
            f"{name}: expected one time a sample, got a frame with columns {list(values.columns)}; give one of its "
            "columns, or its index"
        )
    return contained(name, values)


def channel_names(channels: Sequence[str] | None, n_x: int) -> tuple[str, ...]:
    """n_x different names that can stand in the header of a file."""
    if channels is None:
        return tuple(f"x[{i}]" for i in range(n_x))
    if isinstance(channels, str) or not all(isinstance(name, str) for name in channels):
        raise TypeError(f"channels: expected {n_x} names, got {channels!r}")
    names = tuple(channels)
    if len(names) != n_x:
        raise ValueError(
            f"channels: expected {n_x} names, one for every column of x, got {len(names)}: {names}"
        )
    if len(set(names)) < n_x:
        raise ValueError(f"channels: expected different names, got {names}")
    for name in names:
        if not name or name != name.strip() or not name.isprintable():
            raise ValueError(f"channels: expected printable names without spaces around them, got {name!r}")
    return names


def labels(values: Any) -> tuple[str, ...] | None:
    """Names of the columns of a frame, or of a series; None where there are none, or not all are text."""
    if isinstance(values, _OWN) or not hasattr(values, "__array__"):
        return None
    names: list[Any] = list(values.columns) if _is_frame(values) else [getattr(values, "name", None)]
    return tuple(names) if names and all(isinstance(each, str) and each for each in names) else None


def from_calendar(name: str, given: NDArray[np.object_]) -> NDArray[Any]:
    """datetime64 in UTC, or timedelta64, from datetime or timedelta objects; pandas' keep their nanoseconds.

    Raises
    ------
    TypeError
        If they are neither, or some have a time zone and some do not.
    """
    entries = given.ravel().tolist()
    present = [(k, each) for k, each in enumerate(entries) if type(each).__name__ not in _MISSING]
    for wanted in (datetime, timedelta):
        if entries and all(isinstance(each, wanted) for _, each in present):
            break
    else:
        wrong = [each for _, each in present if not isinstance(each, datetime | timedelta)]
        held = type(wrong[0]).__name__ if wrong else "datetime and timedelta" if present else "nothing"
        advice = _TEXT if held in ("str", "bytes") else "convert them to float"
        raise TypeError(
            f"{name}: expected times in seconds, datetime64 or timedelta64, got object ({held}); {advice}"
        )
    if wanted is timedelta:
        made = [np.timedelta64("NaT") if type(e).__name__ in _MISSING else _length(e) for e in entries]
        return np.array(made).reshape(given.shape)
    naive = [k for k, each in present if each.utcoffset() is None]
    if naive and len(naive) < len(present):
        raise TypeError(
            f"{name}: expected all times with a time zone or all without, got both (row {naive[0]} has none); give "
            "each its tzinfo"
        )
    made = [np.datetime64("NaT") if type(e).__name__ in _MISSING else _instant(e) for e in entries]
    return np.array(made).reshape(given.shape)


def are_whole(values: Any) -> bool:
    """Whether a series says that it holds whole numbers, though with missing ones they come out as floats."""
    return getattr(getattr(values, "dtype", None), "kind", "") in ("i", "u")


def text_advice(kind: str) -> str | None:
    """What to do about an array of text, by numpy's letter for its kind; None for any other."""
    return _TEXT if kind in "UST" else None


def _instant(entry: Any) -> np.datetime64:
    if hasattr(entry, "to_datetime64"):
        return entry.to_datetime64()
    naive = entry if entry.utcoffset() is None else entry.astimezone(UTC)
    return np.datetime64(naive.replace(tzinfo=None), "us")


def _length(entry: Any) -> np.timedelta64:
    return entry.to_timedelta64() if hasattr(entry, "to_timedelta64") else np.timedelta64(entry, "us")


def _is_frame(values: Any) -> bool:
    return hasattr(values, "columns") and hasattr(values, "dtypes")


def _refuse_columns(name: str, frame: Any, types: Sequence[Any]) -> None:
    """Raise for columns of text, dates and objects: numpy would make objects of all the others too."""
    wrong = [
        f"{label!r} ({kind})"
        for label, kind in zip(frame.columns, types, strict=True)
        if not (_is_number(kind) or getattr(kind, "kind", "") == "c")
    ]
    if wrong:
        raise TypeError(
            f"{name}: expected columns of real numbers, got {', '.join(wrong)}; leave them out or convert them"
        )


def _is_number(kind: Any) -> bool:
    if hasattr(kind, "is_numeric"):  # polars
        return bool(kind.is_numeric()) or str(kind) == "Boolean"
    return getattr(kind, "kind", "") in tuple("iufb")


def _refuse_transposed(name: str, values: Any) -> None:
    dims = list[Any](getattr(values, "dims", ()))
    found = [d for d in dims if isinstance(d, str) and d.lower() in _SAMPLES] if len(dims) > 1 else []
    if len(found) == 1 and dims[0] != found[0]:
        raise ValueError(
            f"{name}: expected samples first, got dimensions {tuple(dims)}; "
            f"give {name.rpartition(' ')[2]}.transpose({found[0]!r}, ...)"
        )
