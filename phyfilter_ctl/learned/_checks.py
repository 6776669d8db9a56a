"""Checks that the learned models make before anything changes."""

from __future__ import annotations

from .._sections import FloatArray
from .._signals import Given, array, count

__all__ = ["count", "rows"]


def rows(name: str, values: Given, columns: int | None = None) -> FloatArray:
    """Finite samples as a float array of shape (N, columns), N >= 1."""
    return array(name, values, ("N", "n" if columns is None else columns))
