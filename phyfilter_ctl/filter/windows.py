"""Averages of sampled signals over the filter's steps, delayed steps and steps across a gap included.

Between two samples a signal runs on a straight line from ``first`` to ``last`` (both equal where it is held), so an
average over any window is exact. Before the record it keeps its first value.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .._signals import unusable
from .recursion import Recursion, mean, momentum, residual

FloatArray = NDArray[np.floating]


def late_residual(
    recursion: Recursion,
    times: FloatArray,
    ends: FloatArray,
    dx: FloatArray,
    g: Sequence[FloatArray],
    f_theta: Sequence[FloatArray],
    M: FloatArray | None,
) -> FloatArray:
    """u (w, ..., n_f) over steps of any length, with g, f_theta and the inertia as they were then.

    Parameters
    ----------
    recursion : Recursion
    times : (m + 1,) array
        Ends of the intervals on which the signals are known.
    ends : (w + 1,) array
        Where the steps end, in those times: earlier than x was measured by the delay.
    dx : (w, ..., n_x) array
        How far x went.
    g, f_theta : pairs of (m, ..., n) arrays
        At the beginning and at the end of each interval.
    M : (m + 1, ...) or (1, ...) array or None
        Inertia.
    """
    g_mean, f_mean = (window_means(times, first, last, ends[:-1], ends[1:]) for first, last in (g, f_theta))
    if M is not None:
        if len(M) > 1:
            M = values_at(times, M, ends)
            M = mean("average", M[1:], M[:-1])
        dx = momentum(M, dx)
    slope = dx / np.diff(ends).reshape(-1, *[1] * (dx.ndim - 1))
    return residual(slope, g_mean, f_mean, None if recursion.E_left is None else recursion.E_left.T)


def window_means(
    times: FloatArray, first: FloatArray, last: FloatArray, starts: FloatArray, ends: FloatArray
) -> FloatArray:
    """Means over the windows [starts, ends] of a signal that is linear on each interval of ``times``.

    Parameters
    ----------
    times : (m + 1,) array
        Ends of the intervals.
    first, last : (m, ...) arrays
        Value at the beginning and at the end of each interval.
    starts, ends : (w,) arrays
        Windows; not beyond ``times[-1]``.

    Returns
    -------
    (w, ...) array
    """
    shape, (first, last) = first.shape[1:], (part.reshape(len(part), -1) for part in (first, last))
    # The part of a window before the record is an interval of its own, of constant value.
    begin = min(float(starts[0]), float(times[0]))
    begin -= 1.0 + abs(begin)  # earlier, however large the times are
    times = np.concatenate([[begin], times])
    first = np.concatenate([first[:1], first])
    last = np.concatenate([first[:1], last])
    duration = np.diff(times)
    slope = (last - first) / duration[:, None]

    left = np.clip(np.searchsorted(times, starts, side="right") - 1, 0, len(first) - 1)
    right = np.clip(np.searchsorted(times, ends, side="left") - 1, 0, len(first) - 1)

    def piece(index: np.ndarray, begin: FloatArray, end: FloatArray) -> FloatArray:
        middle = 0.5 * (begin + end) - times[index]
        return (end - begin)[:, None] * (first[index] + slope[index] * middle[:, None])

    total = piece(left, starts, np.minimum(ends, times[left + 1]))
    total += np.where((right > left)[:, None], piece(right, times[right], ends), 0.0)
    # Whole intervals between the two ends, summed window by window: a running sum over the record would lose digits.
    whole = np.concatenate([0.5 * (first + last) * duration[:, None], np.zeros((1, first.shape[1]))])
    bounds = np.stack([np.minimum(left + 1, right), right], axis=1).ravel()
    between = np.add.reduceat(whole, bounds, axis=0)[::2]
    total += np.where((right > left + 1)[:, None], between, 0.0)
    return (total / (ends - starts)[:, None]).reshape(-1, *shape)


def values_at(times: FloatArray, samples: FloatArray, when: FloatArray) -> FloatArray:
    """Straight-line values of samples (N, ...) at the times ``when`` (w,); the first one before the record."""
    flat = samples.reshape(len(samples), -1)
    columns = [np.interp(when, times, flat[:, j]) for j in range(flat.shape[1])]
    return np.stack(columns, axis=1).reshape(len(when), *samples.shape[1:])


def fill_forward(values: FloatArray, start: float = 0.0) -> FloatArray:
    """Replace each entry of (N, ...) that is no sample by the last one before it, by ``start`` where there is none."""
    flat = values.reshape(len(values), -1)
    good = ~unusable(flat)
    if good.all():
        return values
    row = np.maximum.accumulate(np.where(good, np.arange(len(flat))[:, None], -1), axis=0)
    filled = np.take_along_axis(flat, np.maximum(row, 0), axis=0)
    return np.where(row >= 0, filled, start).reshape(values.shape)


def mean_weights(rule: str, delay_steps: float) -> FloatArray:
    """Weights of the samples v_k, v_{k-1}, ... in the mean of v over the last step, ``delay_steps`` steps earlier.

    "hold": v keeps each sample until the next one. "average": straight lines between samples. Shape (j + 1,) with
    as many earlier samples as the window reaches back to; they add up to 1.
    """
    whole = int(delay_steps)
    part = delay_steps - whole
    if rule == "hold":
        tail = [0.0, 1.0 - part, part]
    else:
        rest = 1.0 - part
        tail = [0.5 * rest**2, part * (1.0 - 0.5 * part) + 0.5 * rest * (1.0 + part), 0.5 * part**2]
    weights = np.concatenate([np.zeros(whole), tail])
    return weights if part else weights[:-1]
