"""A uniform grid through a log, and the two ways of reading a signal on it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .._sections import FloatArray

# A grid point this close before a sample, in steps of the grid, belongs to it: k * dt is rounded.
_ON_GRID = 1e-6

Pick = Callable[[FloatArray], FloatArray]


def uniform_grid(times: FloatArray, dt: float) -> tuple[FloatArray, Pick, Pick]:
    """The grid (steps + 1,) of ``dt`` from the first time on, straight lines on it, and the sample before it.

    Raises
    ------
    ValueError
        If ``dt`` is longer than the log.
    """
    duration = float(times[-1] - times[0])
    steps = int(np.floor(duration / dt + _ON_GRID))
    if steps < 1:
        raise ValueError(f"dt: expected at most the duration of the log, {duration:.6g} s, got {dt:.6g} s")
    grid = times[0] + dt * np.arange(steps + 1)
    before = np.searchsorted(times, grid + _ON_GRID * dt, side="right") - 1
    left = np.minimum(before, len(times) - 2)
    weight = np.clip((grid - times[left]) / np.diff(times)[left], 0.0, 1.0)

    def linear(values: FloatArray) -> FloatArray:
        w = weight.reshape(-1, *[1] * (values.ndim - 1))
        return values[left] + w * (values[left + 1] - values[left])

    return grid, linear, lambda values: values[before]
