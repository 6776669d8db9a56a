"""How far a filter is from the best possible one: the causal Wiener filter of the data.

    min_h sum_k (gamma*_k - sum_{l=0}^{L-1} h_l u_{k-l})^2

The finite impulse response h solves the normal equations R h = c, R the Toeplitz matrix of the autocorrelation of u
(N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series, 1949), by N. Levinson's recursion.
Blocks of the record are held out in turn: what is fitted on the others is scored on the block, so that a long response
pays for its own fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import oaconvolve
from scipy.special import stdtrit

from ..._sections import FloatArray
from ...filter import PhyFilter
from ...filter.sampling import Method
from ...results import Result
from .correlation import MOST_LAGS, Correlations, Stretch, memory
from .residuals import Flight
from .samples import Pooled, Samples, response
from .sensitivity import Data

_FOLDS = 8
_LENGTHS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048)
_SAMPLES_PER_TAP = 10
_RIDGE = 1e-9  # of r_0: keeps a response solvable where u has no content at all
_ONE_RATE = 0.01  # flights whose steps agree to this share one response
_LEVEL = 0.95


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
    """

    taps: FloatArray = field(repr=False)
    dt: float
    rmse: float
    filter_rmse: float
    ratio: float
    interval: tuple[float, float]
    blocks: int


@dataclass(frozen=True, eq=False)
class _Group:
    """Flights of one rate: the stretches of each fold, and their correlations."""

    folds: list[list[Stretch]]
    parts: list[Correlations | None]
    plain: bool

    def without(self, fold: int | None) -> list[Correlations]:
        return [part for i, part in enumerate(self.parts) if i != fold and part is not None]


def wiener_floor(
    flights: Sequence[Flight],
    filter: PhyFilter,
    refit: Callable[[Data], PhyFilter],
    method: Method,
) -> WienerFloor:
    """Score the Wiener filter and the learned one, both without the block, block by block.

    Parameters
    ----------
    flights : sequence of Flight
    filter : PhyFilter
        The learned one.
    refit : callable
        Data -> the filter learned from them, starting from the learned one.
    method : {"exact", "matched", "euler", "tustin"}
    """
    groups = _groups(flights, filter, method)
    count = len(groups[0].folds)
    ours, floors = np.zeros(count), np.zeros(count)
    weights = np.zeros(count)
    for fold in range(count):
        learned = refit(_data_without(groups, fold, method))
        for group in groups:
            for part in group.folds[fold]:
                ours[fold] += _scored(part, response(learned, part.flight, method, part.last)[part.first :])
                weights[fold] += _weight(part)
    responses = []
    for group in groups:
        errors, taps = _best_response(group)
        floors += errors
        responses.append(taps)
    ratio, interval = _ratio(ours, floors)
    total = float(np.sum(weights))
    floor, mine = np.sqrt(np.sum(floors) / total), np.sqrt(np.sum(ours) / total)
    dt = groups[0].without(None)[0].dt
    return WienerFloor(responses[0], dt, float(floor), float(mine), ratio, interval, count)


def _groups(flights: Sequence[Flight], filter: PhyFilter, method: Method) -> list[_Group]:
    """Flights by rate and kind, largest group first, cut into folds."""
    kinds: list[list[Flight]] = []
    for flight in flights:
        if not flight.takes_part:
            continue
        for kind in kinds:
            if kind[0].is_plain == flight.is_plain and abs(kind[0].dt - flight.dt) <= _tolerance(flight):
                kind.append(flight)
                break
        else:
            kinds.append([flight])
    kinds.sort(key=lambda kind: -sum(flight.samples for flight in kind))
    folds = _folds([flight for kind in kinds for flight in kind])
    slowest = float(np.min(-filter.poles.real))
    groups = []
    for kind in kinds:
        own = [[part for part in fold if any(part.flight is f for f in kind)] for fold in folds]
        lags = max(_LENGTHS[-1], int(2.0 * memory(filter.order) / (slowest * kind[0].dt)))
        parts = [Correlations.of(fold, method, min(lags, MOST_LAGS)) if fold else None for fold in own]
        groups.append(_Group(own, _same_lags(parts), kind[0].is_plain))
    return groups


def _same_lags(parts: list[Correlations | None]) -> list[Correlations | None]:
    """Early blocks know of fewer lags; the others' sums there are 0."""
    most = max(part.sequences.shape[1] for part in parts if part is not None)
    padded: list[Correlations | None] = []
    for part in parts:
        if part is None:
            padded.append(None)
            continue
        sequences = np.zeros((2, most))
        sequences[:, : part.sequences.shape[1]] = part.sequences
        padded.append(Correlations(part.stretches, part.dt, part.method, sequences, part.energy, part.weight))
    return padded


def _tolerance(flight: Flight) -> float:
    return flight.dt * (1e-6 if flight.is_plain else _ONE_RATE)


def _folds(flights: Sequence[Flight]) -> list[list[Stretch]]:
    """Contiguous blocks of about one size, dealt out to the folds."""
    total = sum(flight.samples for flight in flights)
    folds: list[list[Stretch]] = [[] for _ in range(_FOLDS)]
    dealt = 0
    for flight in flights:
        length = len(flight.u)
        blocks = min(max(1, round(_FOLDS * flight.samples / total)), _FOLDS, length)
        edges = np.linspace(0, length, blocks + 1).astype(int)
        for first, last in pairwise(edges):
            folds[dealt % _FOLDS].append(Stretch(flight, int(first), int(last), flight.weight))
            dealt += 1
    return [fold for fold in folds if fold]


def _data_without(groups: Sequence[_Group], fold: int, method: Method) -> Data:
    parts: list[Data] = []
    for group in groups:
        kept = group.without(fold)
        if group.plain:
            parts += [Correlations.joined(kept)] if kept else []
            continue
        out = {id(part.flight): [] for other in group.folds for part in other}
        flights = {id(part.flight): part.flight for other in group.folds for part in other}
        for part in group.folds[fold]:
            out[id(part.flight)].append(part)
        parts += [Samples(_masked(flights[key], held), method) for key, held in out.items()]
    return parts[0] if len(parts) == 1 else Pooled(parts)


def _masked(flight: Flight, held: Sequence[Stretch]) -> Flight:
    if not held:
        return flight
    own = flight.sample_weights
    weights = np.ones_like(flight.target) if own is None else own.copy()
    for part in held:
        weights[part.first : part.last] = 0.0
    return replace(flight, sample_weights=weights)


def _best_response(group: _Group) -> tuple[FloatArray, FloatArray]:
    """Squared errors on each fold for the length that does best on all of them, and its taps fitted on everything."""
    samples = sum(part.samples for fold in group.folds for part in fold)
    found: list[tuple[float, FloatArray, int]] = []
    for length in _LENGTHS:
        if found and length * _SAMPLES_PER_TAP > samples:
            break
        errors = np.zeros(len(group.folds))
        for fold, parts in enumerate(group.folds):
            others = group.without(fold)
            if not parts or not others:
                continue
            taps = _taps(others, length)
            errors[fold] = sum(_scored(part, _convolved(taps, part)) for part in parts)
        found.append((float(np.sum(errors)), errors, length))
    _, errors, length = min(found, key=lambda entry: entry[0])
    return errors, _taps(group.without(None), length)


def _taps(parts: Sequence[Correlations], length: int) -> FloatArray:
    r, c = np.sum([part.sequences[:, :length] for part in parts], axis=0)
    r[0] *= 2.0 * (1.0 + _RIDGE)  # stored halved
    return np.asarray(solve_toeplitz(r, c), dtype=float)


def _convolved(taps: FloatArray, part: Stretch) -> FloatArray:
    first = max(0, part.first - len(taps) + 1)
    y = oaconvolve(part.flight.u[first : part.last], taps[:, None], axes=0)
    return y[part.first - first : part.last - first]


def _scored(part: Stretch, y: FloatArray) -> float:
    rows = slice(part.first, part.last)
    squares = (part.flight.target[rows] - y) ** 2
    weights = part.flight.sample_weights
    return part.weight * float(np.sum(squares if weights is None else weights[rows] * squares))


def _weight(part: Stretch) -> float:
    weights = part.flight.sample_weights
    if weights is None:
        return part.weight * part.samples
    return part.weight * float(np.sum(weights[part.first : part.last]))


def _ratio(ours: FloatArray, floors: FloatArray) -> tuple[float, tuple[float, float]]:
    """Ratio of the root mean squares, and its jackknife interval on a log scale."""
    tiny = np.finfo(float).tiny
    count = len(ours)
    ratio = 0.5 * float(np.log(max(np.sum(ours), tiny) / max(np.sum(floors), tiny)))
    if count < 2:
        return float(np.exp(ratio)), (0.0, np.inf)
    left = 0.5 * np.log(np.maximum(np.sum(ours) - ours, tiny) / np.maximum(np.sum(floors) - floors, tiny))
    spread = np.sqrt((count - 1.0) / count * np.sum((left - np.mean(left)) ** 2))
    half = float(stdtrit(count - 1, 0.5 + 0.5 * _LEVEL) * spread)
    return float(np.exp(ratio)), (float(np.exp(ratio - half)), float(np.exp(ratio + half)))
