"""Searches for a motion of the inertia that makes the loop diverge: back and forth between two values, periodically."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..._sections import FloatArray, expm1
from ...results import Result
from .openings import Opening

__all__ = ["InertiaMotion", "worst_mixture", "worst_motion", "worst_switching"]

# Times at each end that are tried at first, then shares by which the best are varied.
_TIMES, _COARSE = 32, 12
_VARIED = (0.3, 0.1, 0.03, 0.01)
# Pieces of a ramp between two values.
_RAMP = 64
# Longest search in the sampled loop, in steps at one value.
_MOST_STEPS = 2000
# Growth below this share in a period may be rounding, or with ramps come from their pieces.
_GROWS, _GROWS_RAMPED = 1e-6, 1e-3
# Vertices between which pairs are tried.
_MOST_VERTICES = 8


@dataclass(frozen=True, eq=False, repr=False)
class InertiaMotion(Result):
    """A periodic motion of the inertia under which the loop diverges.

    Parameters
    ----------
    times : (K + 1,) array
        Begin and end of the pieces of one period in s, from 0.
    ratios : (K, 2) array
        M_hat/M at the beginning and at the end of each piece; ln(M_hat/M) is linear in between. Empty for matrices.
    vertices : (K,) array of int
        Index of the vertex that M keeps to on each piece. Empty for ratios.
    growth : float
        Spectral radius over one period, above 1.
    """

    times: FloatArray
    ratios: FloatArray
    vertices: np.ndarray[tuple[int], np.dtype[np.intp]]
    growth: float

    @property
    def period(self) -> float:
        """Seconds."""
        return float(self.times[-1])

    def piece(self, time: float) -> int:
        """Index of the piece that a time (s) belongs to, period after period."""
        return min(
            int(np.searchsorted(self.times, time % self.period, side="right")) - 1, len(self.times) - 2
        )

    def ratio(self, time: float) -> float:
        """M_hat/M at a time (s), period after period."""
        k = self.piece(time)
        begin, end = self.times[k : k + 2]
        share = (time % self.period - begin) / (end - begin)
        first, last = self.ratios[k]
        return float(first * (last / first) ** share)


def worst_motion(opening: Opening, low: float, high: float, rate: float | None) -> InertiaMotion | None:
    """Ratios that go back and forth within [low, high], at no more than ``rate`` (1/s); None where none was found."""
    ends = [(low, high)]
    if rate is not None:
        ends = list(combinations(np.geomspace(low, high, 5).tolist(), 2))[::-1]
        ends.sort(key=lambda pair: pair[0] / pair[1])
    for a, b in ends:
        matrices = [opening.closed(value) for value in (a, b)]
        ramps = [np.eye(len(opening.A))] * 2
        duration = 0.0
        if rate is not None:
            values, duration = _ramp(opening, a, b, rate)
            steps = np.array([opening.closed(mu) for mu in values])
            if opening.dt is None:
                steps = np.array(
                    [_flows(opening, each, np.array([duration / len(values)]))[0] for each in steps]
                )
            ramps = [_product(steps[::-1]), _product(steps)]
        found = _best_times(opening, matrices, ramps, 2.0 * duration)
        if found is None or (rate is not None and found[1] < 1.0 + _GROWS_RAMPED):
            continue
        (t1, t2), growth = found
        pieces = [(t1, a, a), (duration, a, b), (t2, b, b), (duration, b, a)]
        pieces = [piece for piece in pieces if piece[0] > 0.0]
        times = np.cumsum([0.0, *(piece[0] for piece in pieces)])
        return InertiaMotion(
            times, np.array([piece[1:] for piece in pieces]), np.zeros(0, dtype=np.intp), growth
        )
    return None


def worst_switching(opening: Opening, mixtures: Sequence[FloatArray]) -> InertiaMotion | None:
    """Vertices mu_j that M switches between; None where none was found."""
    slowest = sorted(range(len(mixtures)), key=lambda j: -opening.growth(opening.closed(mixtures[j])))
    unit = [np.eye(len(opening.A))] * 2
    for i, j in combinations(sorted(slowest[:_MOST_VERTICES]), 2):
        found = _best_times(opening, [opening.closed(mixtures[k]) for k in (i, j)], unit, count=_COARSE)
        if found is not None:
            (t1, t2), growth = found
            return InertiaMotion(
                np.cumsum([0.0, t1, t2]), np.zeros((0, 2)), np.array([i, j], dtype=np.intp), growth
            )
    return None


def worst_mixture(stable: Callable[[FloatArray], bool], vertices: FloatArray) -> FloatArray | None:
    """A constant M of the hull that is not stable: vertices, midpoints, 200 random mixtures."""
    unit = np.eye(len(vertices))
    shares = [
        *unit,
        *(0.5 * unit[list(pair)].sum(axis=0) for pair in combinations(range(min(len(unit), 30)), 2)),
    ]
    shares += list(np.random.default_rng(0).dirichlet(np.full(len(vertices), 0.5), 200))
    for share in shares:
        M = np.asarray(np.tensordot(share, vertices, axes=1), dtype=float)
        if not stable(M):
            return M
    return None


def _ramp(opening: Opening, low: float, high: float, rate: float) -> tuple[FloatArray, float]:
    """Ratios in the middle of the pieces of a ramp, and its duration."""
    duration = float(np.log(high / low)) / rate
    count = _RAMP
    if opening.dt is not None:
        count = int(np.ceil(duration / opening.dt))
        duration = count * opening.dt
    return low * (high / low) ** ((np.arange(count) + 0.5) / count), duration


def _product(matrices: FloatArray) -> FloatArray:
    """The first acts last."""
    found = np.eye(len(matrices[0]))
    for each in matrices:
        found = found @ each
    return found


def _flows(opening: Opening, matrix: FloatArray, times: FloatArray) -> FloatArray:
    """The state at the end of each time over that at its beginning, (T, N, N)."""
    if opening.dt is None:
        return np.eye(len(matrix)) + expm1(matrix, times)
    return np.array([np.linalg.matrix_power(matrix, round(time / opening.dt)) for time in times])


def _best_times(
    opening: Opening,
    matrices: Sequence[FloatArray],
    ramps: Sequence[FloatArray],
    between: float = 0.0,
    count: int = _TIMES,
) -> tuple[tuple[float, float], float] | None:
    """Times at the two values with the fastest growth, and the growth in a period; None where nothing grows.

    ``between``: seconds that the ramps take. Growth is per second: in no time at all nothing shrinks either.
    """

    def rates(first: FloatArray, second: FloatArray) -> FloatArray:
        """Growth for each pair of times."""
        flows = (
            _flows(opening, matrix, time) for matrix, time in zip(matrices, (first, second), strict=True)
        )
        begin, end = (ramp @ flow for ramp, flow in zip(ramps, flows, strict=True))
        size = np.abs(np.linalg.eigvals(end[:, None] @ begin[None])).max(axis=-1)
        period = first + second[:, None] + between
        return np.where(period > 0.0, np.log(np.maximum(size, 1e-300)) / np.maximum(period, 1e-300), -np.inf)

    first = second = _candidates(opening, matrices, count)
    best, where = -np.inf, (0.0, 0.0)
    for share in (0.0, *_VARIED):
        for _ in range(20 if share else 1):
            if share:
                first, second = (_near(opening, value, share) for value in where)
            rate = rates(first, second)
            j, i = np.unravel_index(int(np.argmax(rate)), rate.shape)
            if not rate[j, i] > best:
                break
            best, where = float(rate[j, i]), (float(first[i]), float(second[j]))
    growth = float(np.exp(best * (sum(where) + between)))
    return (where, growth) if growth > 1.0 + _GROWS else None


def _near(opening: Opening, time: float, share: float) -> FloatArray:
    times = time * np.array([1.0 - share, 1.0, 1.0 + share])
    return times if opening.dt is None else opening.dt * np.round(times / opening.dt)


def _candidates(opening: Opening, matrices: Sequence[FloatArray], count: int) -> FloatArray:
    """Times from a fraction of the fastest oscillation to a few of the slowest state's."""
    values = np.concatenate([np.linalg.eigvals(each) for each in matrices])
    if opening.dt is not None:
        values = np.log(values[np.abs(values) > 1e-6]) / opening.dt
    sizes = np.abs(values)
    times = np.geomspace(0.05 / sizes.max(), 6.0 / sizes.min(), count - 1)
    if opening.dt is None:
        return np.append(0.0, times)
    steps = np.unique(np.clip(np.round(times / opening.dt), 1, _MOST_STEPS))
    return opening.dt * np.append(0.0, steps)
