"""Step responses: the curve that is drawn, and the time after which nothing moves any more."""

from __future__ import annotations

import math

import numpy as np

from .._sections import FloatArray, expm1
from ..filter import PhyFilter

__all__ = ["settling_time", "step_response"]

_POINTS, _MOST_POINTS = 300, 1500
_SETTLED = 0.02
# A block is resolved by so many points, and by so many a period of what still swings.
_BLOCK, _PER_PERIOD, _MOST_IN_BLOCK = 64, 16, 8192
_BLOCKS = 60
_FORGOTTEN = 12.0  # time constants after which a mode no longer counts
# F(0) below this share of the states' contributions is 0, a band-pass.
_NO_DC = 1e-9


def settling_time(filter: PhyFilter) -> float:
    """Time after which the step response of F stays within 2 % of its end, in s.

    Parameters
    ----------
    filter : PhyFilter

    Returns
    -------
    float
        2 % of the final value, or of the largest one where the final value is 0 (a band-pass). nan where the response
        still moves after all the time that is looked at.

    Notes
    -----
    The response is F(0) - C e^(A t) w_e, with w_e the equilibrium for a unit input.

    Examples
    --------
    >>> round(settling_time(PhyFilter([20.0])), 4), round(math.log(50.0) / 20.0, 4)
    (0.1956, 0.1956)
    """
    _, equilibrium, C = filter.sections
    times, distance = _decay(filter)
    final = abs(float(C @ equilibrium))
    passes_dc = final > _NO_DC * float(np.abs(C) @ np.abs(equilibrium))
    level = _SETTLED * (final if passes_dc else float(distance.max()))
    if level < np.finfo(float).tiny:  # F is 0, or so small that its digits are gone
        return float("nan") if np.any(distance) else 0.0
    if distance[-1] > level:
        return float("nan")
    return max(_last_sample_outside(times, distance, level), _last_swing_outside(times, distance, level))


def step_response(filter: PhyFilter, settling: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times from 0 to half as long again as the response takes to settle, and F and 1 - F there.

    Parameters
    ----------
    filter : PhyFilter
    settling : float
        From :func:`settling_time`.

    Returns
    -------
    t, F, E : (N,) arrays
    """
    slowest = float(np.min(-filter.poles.real))
    end = 1.5 * settling if settling > 0.0 else 4.0 / slowest
    periods = end * float(np.max(np.abs(filter.poles.imag))) / (2.0 * np.pi)
    count = int(min(max(_POINTS, _PER_PERIOD * periods), _MOST_POINTS))
    _, equilibrium, C = filter.sections
    distance, _ = _deviation(filter, -equilibrium, end / (count - 1), count)
    missing = float(filter.error_numerator[0] / filter.a[0])  # 1 - F(0)
    return np.linspace(0.0, end, count), float(C @ equilibrium) + distance, missing - distance


def _deviation(
    filter: PhyFilter, start: FloatArray, step: float, count: int
) -> tuple[FloatArray, FloatArray]:
    """C e^(A t) start at t = 0, step, ... (count,), and the state after the last step; by doubling."""
    A, _, C = filter.sections
    X = np.empty((count + 1, len(A)))
    X[0] = start
    filled, delta = 1, expm1(A, step)
    while filled <= count:
        more = min(filled, count + 1 - filled)
        X[filled : filled + more] = X[:more] + X[:more] @ delta.T
        filled, delta = filled + more, 2.0 * delta + delta @ delta
    return X[:-1] @ C, X[-1]


def _decay(filter: PhyFilter) -> tuple[FloatArray, FloatArray]:
    """Times and |F(0) - step response|, in blocks that double in length and resolve every mode that is still alive."""
    _, equilibrium, _ = filter.sections
    decay, swing = -filter.poles.real, np.abs(filter.poles.imag)
    state, begun = -equilibrium, 0.0
    length = 4.0 / float(np.max(np.abs(filter.poles)))
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    for _ in range(_BLOCKS):
        alive = decay * begun < _FORGOTTEN
        if not np.any(alive):
            break
        resolved = _PER_PERIOD * length * float(np.max(swing[alive])) / (2.0 * np.pi)
        count = min(max(_BLOCK, math.ceil(resolved)), _MOST_IN_BLOCK)
        part, state = _deviation(filter, state, length / count, count)
        times.append(begun + length / count * np.arange(count, dtype=float))
        values.append(part)
        begun += length
        length = begun
    return np.concatenate(times), np.abs(np.concatenate(values))


def _last_sample_outside(times: FloatArray, distance: FloatArray, level: float) -> float:
    outside = np.flatnonzero(distance > level)
    if len(outside) == 0:
        return 0.0
    k = int(outside[-1])
    # On a straight line of the logarithm: exact for one mode.
    high, low = math.log(distance[k]), math.log(max(distance[k + 1], 1e-300))
    share = (high - math.log(level)) / (high - low)
    return float(times[k] + min(share, 1.0) * (times[k + 1] - times[k]))


def _last_swing_outside(times: FloatArray, distance: FloatArray, level: float) -> float:
    """End of the last swing that leaves the level between two samples only: its top on a parabola."""
    left, here, right = distance[:-2], distance[1:-1], distance[2:]
    bend = 2.0 * here - left - right
    top = (here >= left) & (here >= right) & (bend > 0.0)
    height = np.where(top, here + (right - left) ** 2 / (8.0 * np.where(top, bend, 1.0)), 0.0)
    over = np.flatnonzero(height > level)
    if len(over) == 0:
        return 0.0
    k = int(over[-1])
    step = times[k + 2] - times[k + 1]
    centre = times[k + 1] + 0.5 * step * (right[k] - left[k]) / bend[k]
    # A swing whose samples are outside too ends where those say; the parabola is for its top.
    return float(centre + step * math.sqrt(2.0 * (height[k] - level) / bend[k])) if here[k] <= level else 0.0
