"""Small pieces of equations that the controllers share."""

from __future__ import annotations

import numpy as np

from ..plants.algebra import Array, Scalar, rotate, rotate_back, stack

__all__ = ["UP", "clip", "drag_force", "each_axis"]

UP = np.array([0.0, 0.0, 1.0])


def each_axis(values: Array) -> Array:
    """One entry for the first two axes, the other for the third."""
    return stack(values[0], values[0], values[1])


def clip(value: Array, lowest: Scalar, highest: Scalar) -> Array:
    """Elementwise, on CasADi columns too."""
    return np.fmin(np.fmax(value, lowest), highest)


def drag_force(q: Array, v: Array, drag: Array) -> Array:
    """R D R' v: what rotor drag takes from the thrust at a velocity, world frame."""
    return rotate(q, drag * rotate_back(q, v))
