"""Checks that every differentiator makes before it touches the data."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .._samples import LARGEST, unmasked, unusable, usable
from .._samples import interval as seconds_of
from .._sections import FloatArray


def samples(name: str, values: ArrayLike) -> FloatArray:
    """Finite samples as a float array of shape (N, n_x)."""
    array = shaped_samples(name, values)
    if not usable(array):
        row, channel = np.argwhere(unusable(array))[0]
        raise ValueError(
            f"{name}: every sample must be finite, up to {LARGEST:g} and not masked, got {array[row, channel]} in row "
            f"{row}, channel {channel}; cut the flight there or fill the gap"
        )
    return array


def shaped_samples(name: str, values: ArrayLike) -> FloatArray:
    """Samples as a float array of shape (N, n_x), finite or not; NaN where they are masked."""
    raw = np.asarray(unmasked(values))
    if raw.dtype.kind not in "fiub":
        raise TypeError(f"{name}: expected an array of real numbers, got dtype {raw.dtype}")
    if raw.ndim != 2 or raw.size == 0:
        advice = "; use v[:, None] for one channel" if raw.ndim == 1 else ""
        raise ValueError(f"{name}: expected shape (N, n_x) with N, n_x >= 1, got {raw.shape}{advice}")
    return raw.astype(float)


def interval(dt: float) -> float:
    """A sampling interval above zero."""
    return positive("dt", seconds_of("dt", dt), "s")


def positive(name: str, value: float, unit: str = "") -> float:
    """A finite number above zero."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: expected a number, got {value!r}") from error
    if not (math.isfinite(number) and number > 0.0):
        raise ValueError(f"{name}: expected a finite number > 0{' ' + unit if unit else ''}, got {value!r}")
    return number


def count(name: str, value: int) -> int:
    """A whole number of at least 1."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected a whole number, got {value!r}")
    if value < 1:
        raise ValueError(f"{name}: expected at least 1, got {value}")
    return int(value)
