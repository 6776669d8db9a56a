"""Checks and small pieces of equations that the controllers share."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..plants.algebra import Array, Scalar, rotate, rotate_back, stack

__all__ = ["UP", "check_not_negative", "check_positive", "clip", "drag_force", "each_axis", "pair", "three"]

UP = np.array([0.0, 0.0, 1.0])


def check_positive(name: str, value: float, unit: str) -> None:
    """Refuse a number that is not finite and above 0."""
    if not (np.isfinite(value) and value > 0.0):
        raise ValueError(f"{name}: expected a positive number of {unit}, got {value}")


def check_not_negative(name: str, value: float, unit: str) -> None:
    """Refuse a number that is not finite or below 0."""
    if not (np.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name}: expected 0 {unit} or more, got {value}")


def three(name: str, values: ArrayLike, words: str) -> NDArray[np.float64]:
    """(3,) array of numbers that are not negative; one number stands for all three."""
    return _filled(name, values, 3, f"one or three {words}")


def pair(name: str, values: ArrayLike, words: str) -> NDArray[np.float64]:
    """(2,) array of numbers that are not negative; one number stands for both."""
    return _filled(name, values, 2, f"a number, or two, for {words}")


def _filled(name: str, values: ArrayLike, count: int, words: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=float)
    if array.shape not in ((), (count,)) or not np.isfinite(array).all() or array.min() < 0.0:
        raise ValueError(f"{name}: expected {words}, finite and 0 or more, got {values!r}")
    return np.broadcast_to(array, (count,)).copy()


def each_axis(values: Array) -> Array:
    """One entry for the first two axes, the other for the third."""
    return stack(values[0], values[0], values[1])


def clip(value: Array, lowest: Scalar, highest: Scalar) -> Array:
    """Elementwise, on CasADi columns too."""
    return np.fmin(np.fmax(value, lowest), highest)


def drag_force(q: Array, v: Array, drag: Array) -> Array:
    """R D R' v: what rotor drag takes from the thrust at a velocity, world frame."""
    return rotate(q, drag * rotate_back(q, v))
