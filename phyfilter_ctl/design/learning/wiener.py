"""How far a filter is from the best possible one: the causal Wiener filter of the data.

    min_h sum_k (gamma*_k - sum_{l=0}^{L-1} h_l u_{k-l})^2

The finite impulse response h solves the normal equations R h = c, R the Toeplitz matrix of the autocorrelation of u
(N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949), by N. Levinson's recursion.
Blocks of the record are held out in turn: what is fitted on the others is scored on the block, so that a long response
pays for its own fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import oaconvolve
from scipy.special import stdtrit

from ..._sections import FloatArray
from ...results import Result
from .correlation import Correlations, Stretch
from .folds import Folds, Group, scored
from .remnant import response_errors
from .residuals import each

_LENGTHS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048)
_SAMPLES_PER_TAP = 10
_RIDGE = 1e-9  # of r_0: keeps a response solvable where u has no content at all
_LEVEL = 0.95
# Taps that err by more than this on what they were not fitted on, relative, are not known well enough for a floor,
_OVERFIT = 1.02
# nor is a ratio whose interval is wider than this, relative.
_WIDEST = 1.1
LONGEST = _LENGTHS[-1]


@dataclass(frozen=True, eq=False, repr=False)
class WienerFloor(Result):
    """The causal Wiener filter of the data, and the learned filter beside it on the same held-out blocks.

    Attributes
    ----------
    taps : (L,) array
        Impulse response from u to gamma* at the samples, fitted on everything; L was chosen on held-out blocks. Flights
        of other rates have responses of their own; this is the one with the most samples.
    dt : float
        Its sampling interval in s.
    rmse : float
        Of the Wiener filter on held-out blocks, in the unit of f.
    filter_rmse : float
        Of the filter, learned without the block, on held-out blocks.
    ratio : float
        ``filter_rmse / rmse``.
    interval : (float, float)
        Where the ratio lies with 95 % confidence: jackknife over the blocks, Student's t.
    blocks : int
        Number of blocks.
    overfit : float
        RMSE of the Wiener filter on held-out blocks over that on the blocks it was fitted on.
    filter_errors : (blocks,) array
        Weighted sum of squared errors of the filter on each held-out block.
    are_flights : bool
        Whether the blocks are whole flights.
    """

    taps: FloatArray = field(repr=False)
    dt: float
    rmse: float
    filter_rmse: float
    ratio: float
    interval: tuple[float, float]
    blocks: int
    overfit: float
    filter_errors: FloatArray = field(repr=False)
    are_flights: bool

    @property
    def is_reliable(self) -> bool:
        """Whether it is a floor: its taps are known (``overfit`` within 2 % of 1), the ratio is (``interval`` no wider
        than 10 %), and the filter is not below it."""
        low, high = self.interval
        return self.overfit <= _OVERFIT and 1.0 <= high <= _WIDEST * low


def wiener_floor(folds: Folds, ours: FloatArray) -> WienerFloor:
    """Score the Wiener filter without each fold, beside a filter.

    Parameters
    ----------
    folds : Folds
    ours : (count,) array
        Squared errors of the filter learned without each fold, on that fold.
    """
    floors, fitted = np.zeros(folds.count), 0.0
    responses = []
    for group in folds.groups:
        errors, taps = _best_response(folds, group)
        floors += errors
        fitted += sum(float(_fold_errors(folds, group, fold, [taps])[0]) for fold in range(len(group.folds)))
        responses.append(taps)
    ratio, interval = ratio_of(ours, floors)
    total = float(np.sum(folds.weights))
    floor, mine = np.sqrt(np.sum(floors) / total), np.sqrt(np.sum(ours) / total)
    dt = folds.groups[0].without(None)[0].dt
    overfit = float(np.sqrt(np.sum(floors) / max(fitted, np.finfo(float).tiny)))
    return WienerFloor(
        responses[0],
        dt,
        float(floor),
        float(mine),
        ratio,
        interval,
        folds.count,
        overfit,
        ours,
        folds.are_flights,
    )


def _best_response(folds: Folds, group: Group) -> tuple[FloatArray, FloatArray]:
    """Squared errors on each fold for the length that does best on all of them, and its taps fitted on everything."""
    samples = sum(part.samples for fold in group.folds for part in fold)
    lengths = [length for length in _LENGTHS if length == 1 or length * _SAMPLES_PER_TAP <= samples]
    errors = np.zeros((len(group.folds), len(lengths)))
    for fold, parts in enumerate(group.folds):
        others = group.without(fold)
        if parts and others:
            responses = [_taps(others, length) for length in lengths]
            errors[fold] = _fold_errors(folds, group, fold, responses)
    best = int(np.argmin(errors.sum(axis=0)))
    return errors[:, best], _taps(group.without(None), lengths[best])


def _fold_errors(folds: Folds, group: Group, fold: int, responses: Sequence[FloatArray]) -> FloatArray:
    """Squared errors of some impulse responses on a fold."""
    part = group.parts[fold]
    if part is None:
        return np.zeros(len(responses))
    if group.is_kept:
        return np.array([response_errors(part, taps, folds.offset) for taps in responses])
    work = partial(_errors, responses=responses, offset=folds.offset)
    return np.sum([*each(work, group.folds[fold])], axis=0)


def _errors(part: Stretch, responses: Sequence[FloatArray], offset: bool) -> FloatArray:
    """Squared errors of some impulse responses on a stretch."""
    return np.array([scored(part, _convolved(taps, part), offset) for taps in responses])


def _taps(parts: Sequence[Correlations], length: int) -> FloatArray:
    r, c = np.sum([part.sequences[:, :length] for part in parts], axis=0)
    if r[0] == 0.0:  # none of these samples counts: they know of no response
        return np.zeros(length)
    r[0] *= 2.0 * (1.0 + _RIDGE)  # stored halved
    return np.asarray(solve_toeplitz(r, c), dtype=float)


def _convolved(taps: FloatArray, part: Stretch) -> FloatArray:
    first = max(0, part.first - len(taps) + 1)
    y = oaconvolve(part.flight.u[first : part.last], taps[:, None], axes=0)
    return y[part.first - first : part.last - first]


def ratio_of(ours: FloatArray, floors: FloatArray) -> tuple[float, tuple[float, float]]:
    """Ratio of the root mean squares, and its 95 % interval."""
    ratio, spread, count = *log_ratio(ours, floors), len(ours)
    if count < 2:
        return float(np.exp(ratio)), (0.0, np.inf)
    half = float(stdtrit(count - 1, 0.5 + 0.5 * _LEVEL) * spread)
    return float(np.exp(ratio)), (float(np.exp(ratio - half)), float(np.exp(ratio + half)))


def log_ratio(ours: FloatArray, others: FloatArray) -> tuple[float, float]:
    """Logarithm of the ratio of two root mean squares on the same folds, and its standard error: jackknife."""
    tiny = np.finfo(float).tiny
    count = len(ours)
    ratio = 0.5 * float(np.log(max(np.sum(ours), tiny) / max(np.sum(others), tiny)))
    if count < 2:
        return ratio, np.inf
    left = 0.5 * np.log(np.maximum(np.sum(ours) - ours, tiny) / np.maximum(np.sum(others) - others, tiny))
    return ratio, float(np.sqrt((count - 1.0) / count * np.sum((left - np.mean(left)) ** 2)))
