"""Recordings as the sampled filter sees them: the measured residual u of each step; how sure a mean over them is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize_scalar
from scipy.stats import t as student

from .._sections import FloatArray
from ..filter import SampledPhyFilter, record, windows
from ..recording import Recording
from ..results import Interval

__all__ = [
    "LEAST",
    "Steps",
    "Stretch",
    "filtered",
    "jackknife",
    "least",
    "mean_g",
    "spread",
    "steps_of",
    "stretches",
    "units_of",
]

LEAST = 100  # steps below which nothing is said
_GAP = 20.0  # median steps, to which longer gaps are cut where spectra are taken
_STILL = 1e-9  # a residual that varies by less than this of its size is rounding
_ENOUGH, _BLOCKS, _MOST = (
    5,
    12,
    40,
)  # recordings from which on they are the unit; stretches of fewer; most units
_SHORTEST = 40  # rows of a stretch


@dataclass(frozen=True, eq=False)
class Steps:
    """One recording.

    Attributes
    ----------
    times : (m + 1,) array
        Of the samples between the steps, s.
    u, moved : (m, n_x) arrays
        M dx / h - mean(g + f_theta) over each step, and M dx / h.
    samples : (m + 1,) array
        Which samples of the recording those are.
    dt : float
        Median step; the step where all are equal.
    uniform : bool
    scale : (n_x,) array
        Mean of M where it is a number or a diagonal, else 1.
    """

    times: FloatArray
    u: FloatArray
    moved: FloatArray
    samples: NDArray[np.intp]
    dt: float
    uniform: bool
    scale: FloatArray

    @property
    def h(self) -> FloatArray:
        """Lengths (m, 1) of the steps."""
        return np.full((len(self.u), 1), self.dt) if self.uniform else np.diff(self.times)[:, None]

    def on_grid(self, dt: float) -> FloatArray:
        """Means of u over the cells of a uniform grid: rises of its integral, straight between the samples."""
        if self.uniform and abs(self.dt - dt) <= 1e-6 * dt:
            return self.u
        edges = self._edges(dt)
        return _means(self.grid_times, self.u, edges)

    @property
    def grid_times(self) -> FloatArray:
        """Times (m + 1,) in which a long gap is a short one: a day without samples needs no grid."""
        steps = np.minimum(np.diff(self.times), _GAP * self.dt)
        return self.times[0] + np.concatenate([[0.0], np.cumsum(steps)])

    def _edges(self, dt: float) -> FloatArray:
        last = float(self.grid_times[-1])
        return np.minimum(np.arange(self.times[0], last + 1e-6 * dt, dt), last)

    def noise_density(self, dt: float, theta: FloatArray) -> FloatArray:
        """Spectrum over theta = omega dt of the noise of u on that grid, for noise 1 of M x; its mean is the variance.

        Its integral is the noise of x on straight lines between the samples: white where grid and samples agree, else
        of a covariance that ends after two lags or so.
        """
        lags = [1.0, 0.0, 0.0]
        if not (self.uniform and abs(self.dt - dt) <= 1e-6 * dt):
            edges = self._edges(dt)
            times = self.grid_times
            left = np.clip(np.searchsorted(times, edges, "right") - 1, 0, len(times) - 2)
            w = (edges - times[left]) / np.diff(times)[left]
            lags = [float(np.mean(_shared(left, w, lag))) for lag in range(3)]
        covariance = lags[0] + 2.0 * (lags[1] * np.cos(theta) + lags[2] * np.cos(2.0 * theta))
        return np.maximum(covariance, 0.0) * 2.0 * (1.0 - np.cos(theta)) / dt**2


def _means(times: FloatArray, values: FloatArray, edges: FloatArray) -> FloatArray:
    """Means between the edges of what is constant between the times."""
    return np.asarray(windows.window_means(times, values, values, edges[:-1], edges[1:]), dtype=float)


def _shared(left: NDArray[np.intp], w: FloatArray, lag: int) -> FloatArray:
    """Covariance of the lines at two points of the grid, between samples of variance 1."""
    i, j = slice(None, len(w) - lag), slice(lag, None)
    apart = left[j] - left[i]
    same = (1.0 - w[i]) * (1.0 - w[j]) + w[i] * w[j]
    return np.where(apart == 0, same, np.where(apart == 1, w[i] * (1.0 - w[j]), 0.0))


def steps_of(logs: Sequence[Recording], sampled: SampledPhyFilter) -> list[Steps]:
    """Measured residuals of all logs, as this filter would take them.

    Raises
    ------
    ValueError
        If there are fewer than 100 steps in all, or nothing changes in any of them.
    """
    found = []
    for log in logs:
        u, samples = _residuals(sampled, log)
        moved, there = _residuals(sampled, log.with_signals(g=None, f_theta=None))
        times = log.times[samples]
        if len(moved) > len(u):  # g or f_theta has gaps where x has none
            moved = _means(log.times[there], moved, times)
        whole = log.is_uniform and len(samples) == log.n
        found.append(Steps(times, u, moved, samples, log.dt, whole, _scale(log)))
    if (count := sum(len(part.u) for part in found)) < LEAST:
        raise ValueError(
            f"expected at least {LEAST} steps to tell noise from force, got {count}; give longer recordings"
        )
    if all(np.all(np.ptp(part.u, axis=0) <= _STILL * np.max(np.abs(part.u), axis=0)) for part in found):
        raise ValueError(
            "the measured residual M x' - g - f_theta is constant throughout: it holds neither noise nor force to tell "
            "apart; give recordings with motion in them, and check that the columns are the right ones"
        )
    return found


def mean_g(log: Recording, sampled: SampledPhyFilter, part: Steps) -> FloatArray | None:
    """Means (m, n_x) of g over the steps of a recording; None where it has no g, or gaps of its own."""
    if log.g is None:
        return None
    u, samples = _residuals(sampled, log.with_signals(f_theta=None))
    return part.moved - u if len(samples) == len(part.samples) else None


def _residuals(sampled: SampledPhyFilter, log: Recording) -> tuple[FloatArray, NDArray[np.intp]]:
    u, samples = record.step_residuals(sampled.recursion, log.x, log.g, log.f_theta, log.inertia, log.times)
    return np.asarray(u, dtype=float), samples


def _scale(log: Recording) -> FloatArray:
    M = log.inertia
    if M is None or M.ndim == 3 or (M.ndim == 2 and M.shape == (log.n_x, log.n_x) and log.n != log.n_x):
        return np.ones(log.n_x)
    return np.broadcast_to(np.abs(M if M.ndim < 2 else M.mean(axis=0)), (log.n_x,))


def filtered(sampled: SampledPhyFilter, u: FloatArray, steps: FloatArray | None = None) -> FloatArray:
    """f_hat - f_theta (m, n_x) at the ends of steps of residual u; ``steps`` (m,) where not nominal."""
    y = np.empty(u.shape)
    for rows, part in record.respond(sampled.recursion, len(u), u.shape[1], lambda rows: u[rows], steps):
        y[rows] = part
    return y


def least(cost: Callable[[float], float], grid: FloatArray) -> tuple[float, float]:
    """Where a cost is least, and the cost: the best of a grid, refined between its neighbours."""
    k = int(np.argmin([cost(float(x)) for x in grid]))
    ends = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    found: OptimizeResult = minimize_scalar(cost, bounds=ends, method="bounded", options={"xatol": 1e-3})
    return float(found["x"]), float(found["fun"])


# -- how sure -------------------------------------------------------------------------------------------------------


Stretch = tuple[int, int, int]  # which recording, first row, end


def stretches(lengths: Sequence[int], long: float = math.inf) -> list[list[Stretch]]:
    """Independent units of recordings of so many rows: recordings, several where there are many, or parts of few.

    Those parts are 12, or up to 40 where each still has ``long`` rows.
    """
    if len(lengths) >= _ENOUGH:
        dealt = np.array_split(np.arange(len(lengths)), min(len(lengths), _MOST))
        return [[(int(k), 0, lengths[k]) for k in some] for some in dealt]
    found: list[list[Stretch]] = []
    blocks = min(max(_BLOCKS, int(sum(lengths) / long)), _MOST)
    for k, length in enumerate(lengths):
        most = max(-(-2 // len(lengths)), length // _SHORTEST)
        edges = np.linspace(0, length, min(-(-blocks // len(lengths)), most) + 1).astype(int).tolist()
        found += [[(k, a, b)] for a, b in pairwise(edges)]
    return found


def units_of(parts: Sequence[FloatArray], units: Sequence[Sequence[Stretch]] | None = None) -> FloatArray:
    """Sums (units, k) of rows (m, k) over independent stretches."""
    units = stretches([len(part) for part in parts]) if units is None else units
    return np.array([np.sum([parts[k][a:b].sum(axis=0) for k, a, b in unit], axis=0) for unit in units])


def jackknife(sums: FloatArray, statistic: Callable[[FloatArray], float], confidence: float) -> Interval:
    """A function of totals (k,), with Student's interval from leaving out one unit after the other."""
    total = sums.sum(axis=0)
    value, without = statistic(total), np.array([statistic(total - unit) for unit in sums])
    width = spread(without, confidence)
    return Interval(value, value - width, value + width)


def spread(without: FloatArray, confidence: float) -> float:
    """Half of Student's interval of what leaving out one unit after the other gives."""
    count, apart = len(without), without - without.mean()
    size = max(float(np.max(np.abs(apart))), 1e-300)  # the square of which may leave double precision
    deviation = size * math.sqrt((count - 1.0) / count * float(np.sum((apart / size) ** 2)))
    return float(student.ppf(0.5 + 0.5 * confidence, count - 1) * deviation)
