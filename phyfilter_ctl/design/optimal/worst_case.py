"""The least worst-case error over shapes of filters: what a search evaluates, without a certificate, to 1e-4.

Let y be the error that 1 - F leaves of a unit step of the residual, y(t) = C e^(A t) e with e the equilibrium of the
chain of sections. All kernels are its derivatives and integrals; their L1 norms are total variations:

    ||F||_1 = TV(y),    ||s F||_1 = |y'(0)| + TV(y'),    ||(1 - F) / s^k||_1 = TV(k-fold integral of y)

They are summed over a grid whose step doubles every 32 samples: poles 10^4 apart cost a few times what equal ones do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter
from .shapes import at_speed, best_shape, chains, descend, outputs, sections, starts

__all__ = ["Active", "Gains", "WorstCase", "worst_gains"]

Active = Literal["none", "noise_limit", "accept", "fastest"]

# First step in units of the fastest pole, 2^levels of them before it doubles, decay times of the slowest pole.
_FIRST_STEP, _LEVELS, _HORIZON = 0.1, 5, 16.0
# Of the Taylor series of A times the first step.
_TERMS = 8
# Speed in rad/s below which an accepted one is looked for where nothing else limits it.
_ANY_SPEED = 1e6


class Gains(NamedTuple):
    """Gains of m shapes whose poles have the geometric mean 1 rad/s.

    Attributes
    ----------
    following : (m,) array
        ||(1 - F) / s^k||_1.
    noise : (m,) array
        ||s F||_1.
    inertia : (m,) array
        ||F||_1.
    """

    following: FloatArray
    noise: FloatArray
    inertia: FloatArray


@dataclass(frozen=True)
class WorstCase:
    """What is bounded, and what the filter is to keep.

    Parameters
    ----------
    derivative : int
        Order k of the derivative of the residual that is bounded.
    delta, noise, inertia : float
        Bounds of gamma^(k), of M_hat nu and of (M - M_hat) x'.
    noise_limit, fastest : float or None
        As for ``least_bound``.
    """

    derivative: int
    delta: float
    noise: float
    inertia: float
    noise_limit: float | None
    fastest: float | None

    def speeds(self, gains: Gains) -> tuple[FloatArray, Active]:
        """Best speeds (m,) of the shapes with the ``gains``, and what limits that of the first."""
        speeds: dict[Active, FloatArray] = {"none": np.full(len(gains.noise), _ANY_SPEED)}
        if self.noise > 0.0:
            k = self.derivative
            speeds["none"] = (k * self.delta * gains.following / (self.noise * gains.noise)) ** (
                1.0 / (k + 1)
            )
            if self.noise_limit is not None:
                speeds["noise_limit"] = self.noise_limit / (self.noise * gains.noise)
        if self.fastest is not None:
            speeds["fastest"] = np.full(len(gains.noise), self.fastest)
        return np.min(list(speeds.values()), axis=0), min(speeds, key=lambda name: speeds[name][0])

    def costs(self, gains: Gains, speeds: FloatArray | float) -> FloatArray:
        """Bounds (m,) at the speeds."""
        following = self.delta * gains.following * np.power(speeds, -float(self.derivative))
        return following + self.noise * gains.noise * speeds + self.inertia * gains.inertia

    def least(
        self, order: int, type: int, free: int, accept: Callable[[PhyFilter], bool] | None
    ) -> tuple[PhyFilter, Active, float]:
        """The best filter of an order, with ``free`` weights in its numerator; what limits its speed; its bound."""

        def costs(shapes: FloatArray) -> FloatArray:
            gains = worst_gains(shapes, order, type, self.derivative)
            return self.costs(gains, self.speeds(gains)[0])

        def limited(shape: FloatArray) -> tuple[PhyFilter, Active, float]:
            gains = worst_gains(shape[None], order, type, self.derivative)
            speeds, active = self.speeds(gains)
            speed = float(speeds[0])
            if accept is not None:
                reached = _accepted(lambda w: at_speed(shape, order, type, w), accept, speed)
                speed, active = reached, "accept" if reached < speed else active
            return at_speed(shape, order, type, speed), active, float(self.costs(gains, speed)[0])

        # The binomial start never ends lower than both others.
        first = [np.append(start, np.zeros(free)) for start in starts(order)[-2:]]
        best, _ = descend(costs, first, free=free)
        found = limited(best)
        if found[1] == "accept":
            best, _ = best_shape(lambda shape: limited(shape)[2], [best, first[-1]], free=free)
            found = limited(best)
        return found


def _accepted(make: Callable[[float], PhyFilter], accept: Callable[[PhyFilter], bool], high: float) -> float:
    """The largest speed up to ``high`` whose filter is accepted, to 0.1 %."""
    if accept(make(high)):
        return high
    low = high
    for _ in range(60):
        low *= 0.5
        if accept(make(low)):
            break
    else:
        raise ValueError("accept: refuses filters of every speed; a margin that no filter has cannot be met")
    while high / low > 1.001:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if accept(make(middle)) else (low, middle)
    return low


def worst_gains(shapes: FloatArray, order: int, type: int, derivative: int) -> Gains:
    """Gains of ``shapes`` (m, p), the first of which sets the grid of all: the others are to be near it."""
    dampings, speeds = sections(shapes, order)
    A, equilibrium = chains(dampings, speeds)
    C = outputs(A, equilibrium, shapes[:, order - 1 :], type)
    steps, X = _responses(A, equilibrium, *_extent(dampings[0], speeds[0]))
    # Rows of y'', y', y and its integrals: C A^2, C A, C, C A^-1, ...
    rows, back = [C[:, None] @ A @ A], np.linalg.inv(A)
    for _ in range(derivative + 2):
        rows.append(rows[-1] @ back)
    y = (np.concatenate(rows, axis=1) @ X.transpose(0, 2, 1)).transpose(1, 0, 2)
    variations = _variation(y[1:], y[:-1], steps)
    return Gains(variations[-1], np.abs(y[1, :, 0]) + variations[0], variations[1])


def _extent(damping: FloatArray, speeds: FloatArray) -> tuple[float, float]:
    """Decay of the slowest pole and magnitude of the fastest."""
    over = damping + np.sqrt(np.maximum(damping**2 - 1.0, 0.0))
    pairs = speeds[: len(damping)]
    decays = np.where(damping < 1.0, pairs * damping, pairs / over)
    rest = speeds[len(damping) :]
    return float(np.append(decays, rest).min()), float(np.append(pairs * np.maximum(over, 1.0), rest).max())


def _responses(
    A: FloatArray, equilibrium: FloatArray, slowest: float, fastest: float
) -> tuple[FloatArray, FloatArray]:
    """Steps (N - 1,) of the grid and e^(A t) e on it, (m, N, n)."""
    step, m, n = _FIRST_STEP / fastest, *equilibrium.shape
    count = 1 << _LEVELS
    blocks = int(np.ceil(np.log2(_HORIZON / slowest / (count * step) + 1.0)))
    term = delta = A * step
    for j in range(2, _TERMS + 1):
        term = term @ A * (step / j)
        delta = delta + term
    # e^(A step 2^j) - I: block j has steps of 2^j, and so is 2^(j + levels) long.
    powers = [delta]
    while len(powers) < blocks + _LEVELS:
        powers.append(2.0 * powers[-1] + powers[-1] @ powers[-1])
    delta = np.stack(powers, axis=1).transpose(0, 1, 3, 2)
    X = np.empty((m, blocks, count, n))
    X[:, 0, 0] = equilibrium
    for j in range(1, blocks):
        X[:, j, 0] = X[:, j - 1, 0] + (X[:, j - 1, None, 0] @ delta[:, j - 1 + _LEVELS])[:, 0]
    for level in range(_LEVELS):
        done = 1 << level
        X[:, :, done : 2 * done] = X[:, :, :done] + X[:, :, :done] @ delta[:, level : level + blocks]
    steps = np.repeat(step * 2.0 ** np.arange(blocks, dtype=float), count)
    return steps[:-1], X.reshape(m, -1, n)


def _variation(y: FloatArray, slope: FloatArray, steps: FloatArray) -> FloatArray:
    """Total variation (...,) of y (..., N) with the derivative ``slope``.

    Where that changes its sign y turns, about as Hermite's cubic: smooth in y and slope, which a search needs.
    """
    rise, left, right = np.diff(y, axis=-1), slope[..., :-1], slope[..., 1:]
    turns = np.nonzero(left * right < 0.0)
    step, d = steps[turns[-1]], rise[turns]
    p, q = step * left[turns], step * right[turns]
    # The cubic's derivative over the interval is p + linear u + square u^2; its one zero there, u.
    linear, square = 6.0 * d - 4.0 * p - 2.0 * q, 3.0 * (p + q) - 6.0 * d
    u = 2.0 * p / (np.copysign(np.sqrt(linear**2 - 4.0 * square * p), p) - linear)
    first = u * (p + u * (linear / 2.0 + u * square / 3.0))
    parts = np.abs(rise)
    parts[turns] = np.abs(first) + np.abs(d - first)
    return parts.sum(axis=-1)
