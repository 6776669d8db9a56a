"""Checks that the learned models make before anything changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .._samples import unmasked
from .._sections import FloatArray


def rows(name: str, values: ArrayLike, columns: int | None = None) -> FloatArray:
    """Finite samples as a float array of shape (N, columns), N >= 1."""
    raw = np.asarray(unmasked(values))
    if raw.dtype.kind not in "fiub":
        raise TypeError(f"{name}: expected an array of real numbers, got dtype {raw.dtype}")
    if raw.ndim != 2 or raw.size == 0 or (columns is not None and raw.shape[1] != columns):
        advice = f"; use {name}[:, None] for one column" if raw.ndim == 1 else ""
        wanted = "N and the number of columns at least 1" if columns is None else "N >= 1"
        raise ValueError(f"{name}: expected shape (N, {columns or 'n'}), {wanted}, got {raw.shape}{advice}")
    array = raw.astype(float)
    finite = np.isfinite(array)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise ValueError(
            f"{name}: every value must be finite, got {array[row, column]} in row {row}, column {column}; "
            "leave the row out"
        )
    return array


def count(name: str, value: int, least: int = 1) -> int:
    """A whole number of at least ``least``."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected a whole number, got {value!r}")
    if value < least:
        raise ValueError(f"{name}: expected at least {least}, got {value}")
    return int(value)
