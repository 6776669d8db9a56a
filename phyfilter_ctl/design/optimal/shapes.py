"""Shapes of filters: poles of geometric mean 1, free of constraints, and the filters of a shape at a speed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from ..._sections import FloatArray
from ...filter import PhyFilter
from ..placement import lowpass, place_poles

__all__ = ["Numerator", "at_speed", "best_shape", "starts"]

Numerator = int
# Parameters of a shape stay within these: damping 1/4 to 4, speeds of the sections 1/8 to 8 of the last one's. A search
# that ends there has found that a section is better left out.
_LIMIT_DAMPING, _LIMIT_SPEED = np.log(4.0), np.log(8.0)


def at_speed(shape: FloatArray, order: int, type: int, speed: float) -> PhyFilter:
    """The filter of a shape whose poles have the geometric mean ``speed`` (rad/s).

    ``shape``: logarithms of the dampings of the ``order // 2`` second-order sections, then of the speeds of all
    sections but the last, relative to the mean.
    """
    return place_poles(speed * _poles(shape, order), numerator=type)


def _poles(shape: FloatArray, order: int) -> FloatArray:
    pairs = order // 2
    damping = np.exp(shape[:pairs])
    weights = np.array([2.0] * pairs + [1.0] * (order % 2))
    logs = np.append(shape[pairs:], 0.0)
    logs -= weights @ logs / order
    poles: list[complex] = []
    for z, w in zip(damping, np.exp(logs[:pairs]), strict=True):
        root = np.sqrt(complex(z * z - 1.0))
        poles += (
            [w * (-z + root), w * (-z - root)] if root.imag else [-w / (z + root.real), -w * (z + root.real)]
        )
    if order % 2:
        poles.append(-np.exp(logs[-1]))
    return np.array(poles)


def starts(order: int) -> list[FloatArray]:
    """Shapes of well-known families to start a search from."""
    shapes: list[FloatArray] = []
    for family in ("binomial", "butterworth", "bessel") if order > 1 else ():
        poles = lowpass(order, 1.0, family=family).poles
        poles = poles / np.exp(np.mean(np.log(np.abs(poles))))
        pairs = poles[poles.imag > 0.0]
        real = np.sort(poles[poles.imag == 0.0].real)
        damping, speeds = list(-pairs.real / np.abs(pairs)), list(np.abs(pairs))
        while len(real) > 1:
            damping.append(-(real[0] + real[-1]) / (2.0 * np.sqrt(real[0] * real[-1])))
            speeds.append(float(np.sqrt(real[0] * real[-1])))
            real = real[1:-1]
        logs = np.log(np.append(speeds, -real))
        shapes.append(np.concatenate([np.log(damping), logs[:-1] - logs[-1]]))
    return shapes or [np.zeros(0)]


def best_shape(
    cost: Callable[[FloatArray], float], first: list[FloatArray], *, free: int = 0, accuracy: float = 1e-4
) -> tuple[FloatArray, float]:
    """The least cost over shapes and ``free`` further coordinates, by Nelder and Mead's simplex from many starts."""
    best, least = first[0], cost(first[0])
    if not len(best):
        return best, least

    def bounded(shape: FloatArray) -> float:
        kept = shape[: len(shape) - free]
        limits = np.where(np.arange(len(kept)) < (len(kept) + 1) // 2, _LIMIT_DAMPING, _LIMIT_SPEED)
        return cost(shape) if np.all(np.abs(kept) <= limits) else np.inf

    for start in first:
        simplex = np.vstack([start, start + 0.15 * np.eye(len(start))])
        found = minimize(
            bounded,
            start,
            method="Nelder-Mead",
            options={"initial_simplex": simplex, "xatol": accuracy**0.5, "fatol": accuracy * abs(least)},
        )
        if found.fun < least:
            best, least = np.asarray(found.x, dtype=float), float(found.fun)
    return best, least
