"""One filter for all axes, one each, or one each in coordinates in which the axes are not coupled.

    shared: F I,    each: diag(F_1 ... F_n),    coupled: T diag(F_1 ... F_n) T^-1,    f = T phi

T makes the covariances of the residual and of the noise on it diagonal at once (their generalised eigenvectors), so
that each phi_i can be estimated by itself. In it the matrix filter is a bank with E = T: M x' = g + T phi.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from ..._sections import FloatArray
from ...filter import FilterBank, PhyFilter, SampledPhyFilter, Sampling, stack
from ...recording import Recording
from ...recording.checks import inertia_varies
from ...results import Result, SearchResult
from .options import Reading
from .reading import Recordings, first_of, listed
from .result import LearnResult
from .stored import OneFlight
from .validation import corrected_error

__all__ = ["Axes", "AxesResult", "AxesScore", "compare_axes", "compared", "one_each", "refuse_beside"]

Axes = Literal["shared", "each", "coupled"]
Learner = Callable[[list[OneFlight]], LearnResult]
# A flight, or what reads it.
_Log: TypeAlias = Recording | Callable[[], Recording]

_KINDS: tuple[Axes, ...] = ("shared", "each", "coupled")
_WHOLE_FLIGHTS = 5
# Options of a sampling that hold in any coordinates.
_OF_ALL = ("method", "g", "f_theta", "delay", "precision", "nonfinite")
# Noise below this share of the residual's power does not shape the coordinates.
_LEAST_NOISE = 1e-6


class AxesScore(NamedTuple):
    """One kind in the cross-validation.

    Attributes
    ----------
    held_out_rmse : float
        Of f_hat on each fold, all axes, learned without it.
    ratio : float
        ``held_out_rmse`` over the least of the three.
    standard_error : float
        Of the logarithm of ``ratio``, from the differences fold by fold.
    """

    held_out_rmse: float
    ratio: float
    standard_error: float


@dataclass(frozen=True, eq=False, repr=False)
class AxesResult(Result, SearchResult[PhyFilter | FilterBank]):
    """What :func:`learn` found with ``axes="each"`` or ``"compare"``.

    Attributes
    ----------
    choice : {"shared", "each", "coupled"}
        The simplest within one standard error of the best; "each" where that was asked for.
    scores : dict of AxesScore
        Of the kinds that were compared.
    results : dict of tuples of LearnResult
        Learned from all flights: one; one an axis; one for every phi_i. By kind.
    T : (n_x, n_x) array
        f = T phi; columns of length 1, those with the most residual for their noise last.
    sampling : Sampling or None
        Of all channels together, where one each was asked for; None: as the results have it.
    """

    choice: Axes
    scores: dict[Axes, AxesScore]
    results: dict[Axes, tuple[LearnResult, ...]]
    T: FloatArray
    sampling: Sampling | None = None

    @property
    def best(self) -> PhyFilter | FilterBank:
        """``filter``: what every search calls what it found."""
        return self.filter

    @property
    def filter(self) -> PhyFilter | FilterBank:
        """The filter or the bank of the choice; of phi where it is coupled."""
        filters = [result.filter for result in self.results[self.choice]]
        return filters[0] if len(filters) == 1 else stack(filters)

    def sampled(self) -> SampledPhyFilter:
        """The choice as it was learned; a coupled one gives phi_hat from ``f_theta`` in phi, f_hat = T phi_hat."""
        if self.sampling is not None:
            return SampledPhyFilter([result.filter for result in self.results["each"]], self.sampling)
        return _sampled(self.results[self.choice], self.T if self.choice == "coupled" else None)


def one_each(
    recordings: Recordings,
    learner: Callable[..., LearnResult],
    channels: Sequence[int | str] | None,
    sampling: Sampling,
    weights: Sequence[ArrayLike] | None,
    how: Reading,
) -> AxesResult:
    """A filter for each channel.

    Raises
    ------
    ValueError
        For options that channels share.
    """
    if sampling.E is not None or getattr(sampling.inertia, "ndim", 0) == 2:
        raise ValueError(
            "sampling: expected no E and no full inertia where each channel has a filter of its own; give the inertia "
            "to the recordings"
        )
    names = range(first_of(recordings, how).n_x) if channels is None else channels
    results = [
        learner(
            recordings,
            channels=[name],
            sampling=sampling.alone(i),
            weights=None if weights is None else [_of_channel(entry, i) for entry in weights],
        )
        for i, name in enumerate(names)
    ]
    whole = sampling if sampling.has_dt else replace(sampling, dt=results[0].sampled().dt)
    return AxesResult("each", {}, {"each": tuple(results)}, np.eye(len(results)), whole)


def _of_channel(weight: ArrayLike, i: int) -> ArrayLike:
    entry = np.asarray(weight)
    return entry[:, i : i + 1] if entry.ndim == 2 and entry.shape[1] > 1 else entry


def refuse_beside(**given: object) -> None:
    """Refuse what flights that are cut and turned cannot have."""
    for name, value in given.items():
        if value is not None:
            raise ValueError(
                f"{name}: expected none with axes='compare', which cuts flights and carries them into other "
                "coordinates; give it to a call with axes='each' or 'shared'"
            )


def compared(
    recordings: Recordings,
    learner: Learner,
    channels: Sequence[int | str] | None,
    sampling: Sampling,
    how: Reading,
) -> AxesResult:
    """The choice among one filter, one each and a matrix, of what ``learn`` was given.

    Raises
    ------
    TypeError
        For a function that makes all flights.
    ValueError
        For options of single channels.
    """
    refuse_beside(**{f"sampling, {n}": v for n, v in sampling.unusual.items() if n not in _OF_ALL})
    logs = listed("recordings", recordings)
    if not isinstance(logs, list):
        raise TypeError(
            "recordings: expected a list of them with axes='compare', got a function that makes all"
        )
    if channels is not None:
        chosen = [*channels]
        logs = [_then(_source(log, how.read), partial(_selected, channels=chosen)) for log in logs]
    return compare_axes(logs, learner, read=how.read)


def _selected(log: Recording, channels: Sequence[int | str]) -> Recording:
    return log.select(channels)


def compare_axes(
    logs: Sequence[OneFlight],
    learner: Learner,
    *,
    folds: int = 8,
    read: Callable[[Path], Recording] = Recording.read,
) -> AxesResult:
    """Choose by cross-validation among one filter for all axes, one each, and a matrix.

    Parameters
    ----------
    logs : sequence of Recording, path or function () -> Recording
        Flights with labels and several channels; an inertia that varies is refused. Files are read when they are
        needed, not kept.
    learner : callable
        Flights -> LearnResult, for instance ``lambda logs: learn(logs, 2, shape="general")``. It is called
        with all channels, and with one, without and with each fold.
    folds : int
        Most of them: whole flights where there are five at least, else contiguous blocks.
    read : callable
        Path -> Recording, as for :func:`learn`.

    Returns
    -------
    AxesResult

    Raises
    ------
    ValueError
        If a label is missing, there is one channel only, or the inertia varies.

    Examples
    --------
    >>> import numpy as np
    >>> from phyfilter_ctl import PhyFilter, Recording, stack
    >>> from phyfilter_ctl import Search, learn
    >>> x = np.cumsum(np.random.default_rng(0).standard_normal((800, 2)), axis=0)
    >>> label = stack([PhyFilter([4.0]), PhyFilter([40.0])]).sampled(0.01).run(x)
    >>> log = Recording.from_arrays(x=x, dt=0.01, label=label)
    >>> found = compare_axes([log], lambda logs: learn(logs, 1, search=Search(starts=0)), folds=4)
    >>> found.choice, [f"{one.a[0]:.3f}" for one in found.filter]
    ('each', ['4.000', '40.000'])
    """
    plain = [_then(_source(log, read), partial(_in_units_of_f, i=i)) for i, log in enumerate(logs)]
    shapes = [_at_hand(log).x.shape for log in plain]
    if not plain or shapes[0][1] < 2:
        raise ValueError("logs: expected flights of two channels at least; one channel has one filter")
    T = _decoupling(plain)
    blocks = _blocks([n for n, _ in shapes], folds)
    errors: dict[Axes, FloatArray] = {kind: np.zeros(len(blocks)) for kind in _KINDS}
    for fold, held in enumerate(blocks):
        rest = _without(plain, held, [n for n, _ in shapes])
        own = _decoupling(rest)
        estimates = {kind: _estimator(kind, _learned(kind, rest, own, learner), own) for kind in _KINDS}
        for i, first, last in held:
            log = _at_hand(plain[i])
            assert log.label is not None
            for kind in _KINDS:
                f_hat = estimates[kind](log)
                errors[kind][fold] += float(np.sum((log.label - f_hat)[first:last] ** 2))
    samples = sum((last - first) * shapes[i][1] for held in blocks for i, first, last in held)
    scores = _scores(errors, samples)
    choice: Axes = next(kind for kind in _KINDS if np.log(scores[kind].ratio) <= scores[kind].standard_error)
    results: dict[Axes, tuple[LearnResult, ...]] = {
        kind: _learned(kind, plain, T, learner) for kind in _KINDS
    }
    return AxesResult(choice, scores, results, T)


def _source(log: OneFlight, read: Callable[[Path], Recording]) -> _Log:
    return partial(read, Path(log)) if isinstance(log, str | os.PathLike) else log


def _at_hand(log: _Log) -> Recording:
    return log() if callable(log) else log


def _then(log: _Log, change: Callable[[Recording], Recording]) -> _Log:
    """A flight changed: now, or whenever it is read."""
    return partial(_changed, log, change) if callable(log) else change(log)


def _changed(log: Callable[[], Recording], change: Callable[[Recording], Recording]) -> Recording:
    return change(log())


def _scores(errors: Mapping[Axes, FloatArray], samples: int) -> dict[Axes, AxesScore]:
    least = min(errors.values(), key=lambda entry: float(np.sum(entry)))
    found: dict[Axes, AxesScore] = {}
    for kind, entry in errors.items():
        ratio, error = corrected_error(entry, least)
        found[kind] = AxesScore(float(np.sqrt(np.sum(entry) / samples)), ratio, error)
    return found


def _in_units_of_f(log: Recording, i: int) -> Recording:
    """The log with the momentum M x as x: of no inertia."""
    if log.label is None:
        raise ValueError(f"log {i} has no label: learning needs the true f; give label=")
    x = log.x
    if log.inertia is not None:
        M = np.asarray(log.inertia)
        if inertia_varies(M, log.n):
            if not np.array_equal(M, np.broadcast_to(M[0], M.shape)):
                raise ValueError(
                    f"log {i}: an inertia that varies cannot be carried into other coordinates; learn axis by axis, "
                    "by learn(..., channels=[name])"
                )
            M = M[0]
        x = x @ M.T if M.ndim == 2 else x * M
    return Recording(log.times, x, g=log.g, f_theta=log.f_theta, label=log.label, channels=log.channels)


def _transformed(log: Recording, into: FloatArray) -> Recording:
    """Every signal s as into s."""

    def moved(signal: FloatArray | None) -> FloatArray | None:
        return None if signal is None else signal @ into.T

    return Recording(
        log.times, log.x @ into.T, g=moved(log.g), f_theta=moved(log.f_theta), label=moved(log.label)
    )


def _decoupling(logs: Sequence[_Log]) -> FloatArray:
    """T whose inverse makes the covariances of gamma* and of u - gamma* diagonal."""
    parts = [_moments(_at_hand(log)) for log in logs]
    counts = np.array([[part.steps] for part in parts])
    means = np.array([part.mean for part in parts])
    off = means - np.sum(counts * means, axis=0) / np.sum(counts)
    rest = float(np.sum(counts)) - 1.0
    S = np.sum([part.target for part in parts], axis=0) / rest
    N = (np.sum([part.noise for part in parts], axis=0) + (counts * off).T @ off) / rest
    N = N + (_LEAST_NOISE * np.trace(S) + np.finfo(float).tiny) * np.eye(len(N))
    vectors = linalg.eigh(S, N)[1]
    T = np.linalg.inv(vectors.T)
    T = T / np.linalg.norm(T, axis=0)
    return np.asarray(T * np.sign(T[np.argmax(np.abs(T), axis=0), np.arange(len(T))]), dtype=float)


class _Moments(NamedTuple):
    """Of a flight: products of gamma* and of u - gamma* about their means, and the mean of the latter."""

    steps: int
    target: FloatArray
    noise: FloatArray
    mean: FloatArray


def _moments(log: Recording) -> _Moments:
    assert log.label is not None
    known = np.zeros_like(log.x) if log.f_theta is None else log.f_theta
    g = np.zeros_like(log.x) if log.g is None else log.g
    target = (log.label - known)[1:]
    noise = np.diff(log.x, axis=0) / np.diff(log.times)[:, None] - (g + known)[:-1] - target
    mean = noise.mean(axis=0)
    target, noise = target - target.mean(axis=0), noise - mean
    return _Moments(len(target), target.T @ target, noise.T @ noise, mean)


def _learned(kind: Axes, logs: Sequence[_Log], T: FloatArray, learner: Learner) -> tuple[LearnResult, ...]:
    if kind == "shared":
        return (learner([*logs]),)
    rows = np.eye(len(T)) if kind == "each" else np.linalg.inv(T)
    return tuple(learner([_then(log, partial(_transformed, into=row[None])) for log in logs]) for row in rows)


def _sampled(results: Sequence[LearnResult], E: FloatArray | None) -> SampledPhyFilter:
    if len(results) == 1:
        return results[0].sampled()
    whole = stack([result.sampled() for result in results])
    return whole if E is None else SampledPhyFilter(whole.filters, whole.sampling, E=E)


def _estimator(
    kind: Axes, results: Sequence[LearnResult], T: FloatArray
) -> Callable[[Recording], FloatArray]:
    """Recording -> f_hat (N, n_x)."""
    E = T if kind == "coupled" else None
    sampled = _sampled(results, E)

    def estimate(log: Recording) -> FloatArray:
        f_theta = log.f_theta if E is None or log.f_theta is None else np.linalg.solve(E, log.f_theta.T).T
        found = np.asarray(sampled.run(log.x, log.g, f_theta, times=log.times), dtype=float)
        return found if E is None else found @ E.T

    return estimate


def _blocks(lengths: Sequence[int], folds: int) -> list[list[tuple[int, int, int]]]:
    """Folds of (flight, first, last sample); the first sample of a flight, where f_hat = f_theta, in none."""
    if len(lengths) >= _WHOLE_FLIGHTS:
        dealt: list[list[tuple[int, int, int]]] = [[] for _ in range(min(folds, len(lengths)))]
        for i, length in enumerate(lengths):
            dealt[i % len(dealt)].append((i, 1, length))
        return dealt
    edges = [(i, np.linspace(1, length, folds + 1).astype(int)) for i, length in enumerate(lengths)]
    return [[(i, int(cut[k]), int(cut[k + 1])) for i, cut in edges] for k in range(folds)]


def _without(
    logs: Sequence[_Log], held: Sequence[tuple[int, int, int]], lengths: Sequence[int]
) -> list[_Log]:
    """What is left of the flights, cut where a block is taken out."""
    out = {i: (first, last) for i, first, last in held}
    kept: list[_Log] = []
    for i, log in enumerate(logs):
        if i not in out:
            kept.append(log)
            continue
        pieces = list(pairwise([0, *out[i], lengths[i]]))[::2]
        kept += [
            _then(log, partial(_segment, first=first, last=last))
            for first, last in pieces
            if last - first > 2
        ]
    return kept


def _segment(log: Recording, first: int, last: int) -> Recording:
    return log.segment(first, last)
