"""Recorded numbers as they are handed over: what counts as a sample, and times, which carry a unit."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._sections import FloatArray

__all__ = ["LARGEST", "interval", "refuse_ticks", "seconds", "unmasked", "unusable", "usable"]

# Of a sample, in any unit: the square of a larger one, times a step or a weight, may leave double precision.
LARGEST = 1e150

# Whole numbers this far apart count something shorter than seconds.
_TICKS = 1000.0
_UNITS = "divided by 1e3 (ms), 1e6 (us) or 1e9 (ns); if they are seconds, as floating-point numbers"


def unmasked(values: ArrayLike) -> ArrayLike:
    """The values with NaN (NaT) where they are masked: numpy would hand out what lies under the mask.

    Parameters
    ----------
    values : array_like
        Masked arrays, also as rows of a list; anything else is given back as it is.
    """
    if type(values) is np.ndarray:  # at every step of a loop
        return values
    masked: np.ma.MaskedArray | None = None
    if isinstance(values, np.ma.MaskedArray):
        masked = values
    elif isinstance(values, list | tuple) and np.ma.MaskedArray in map(type, values):
        masked = np.ma.stack([np.ma.asarray(row) for row in values])
    if masked is None:
        return values
    plain = np.array(masked.data, masked.dtype if masked.dtype.kind in "fcmM" else float)
    plain[np.ma.getmaskarray(masked)] = "NaT" if plain.dtype.kind in "mM" else np.nan
    return plain


def usable(values: NDArray[np.floating]) -> bool:
    """Whether all are finite and no larger than :data:`LARGEST`, without an array of their size."""
    return not values.size or (float(values.min()) >= -LARGEST and float(values.max()) <= LARGEST)


def unusable(values: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which are not."""
    return ~(np.abs(values) <= np.float64(LARGEST))


def seconds(name: str, values: ArrayLike) -> FloatArray:
    """Times in seconds, a copy as float64; a missing one is NaN.

    Parameters
    ----------
    name : str
        For the complaint.
    values : array_like
        Seconds; or timedelta64, which has its unit with it; or datetime64, counted from the first, in whole ticks
        until then, so that nothing is lost of times that lie decades after 1970.

    Raises
    ------
    TypeError
        If they are no numbers.
    ValueError
        If they are whole numbers that count no seconds, or have a unit without a length (months, none).

    Examples
    --------
    >>> import numpy as np
    >>> seconds("times", np.array(["2024-05-01T10:00:00.002", "2024-05-01T10:00:00.004"], "datetime64[ns]"))
    array([0.   , 0.002])
    """
    array = np.asarray(unmasked(values))
    if array.dtype.kind == "M":
        if np.datetime_data(array.dtype)[0] in ("Y", "M"):
            array = array.astype("datetime64[s]")
        array = array - array.ravel()[:1]
    if array.dtype.kind == "m":
        unit = np.datetime_data(array.dtype)[0]
        if unit in ("Y", "M", "generic"):
            raise ValueError(
                f"{name}: timedelta64[{unit}] has no length in seconds; give one in s, ms, us or ns"
            )
        return np.asarray(array / np.timedelta64(1, "s"), dtype=float)
    if array.dtype.kind in "iu":
        refuse_ticks(name, array.astype(float), f"as timedelta64, or {_UNITS}")
    try:
        return np.array(array, dtype=float)
    except (TypeError, ValueError) as error:
        raise TypeError(
            f"{name}: expected times in seconds, datetime64 or timedelta64, got {array.dtype}: {error}"
        ) from error


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
    steps = np.abs(np.diff(times)) if times.ndim == 1 else times[:0]
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
