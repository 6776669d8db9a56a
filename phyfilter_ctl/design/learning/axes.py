"""One filter for all axes, one each, or one each in coordinates in which the axes are not coupled.

    shared: F I,    each: diag(F_1 ... F_n),    coupled: T diag(F_1 ... F_n) T^-1,    f = T phi

T makes the covariances of the residual and of the noise on it diagonal at once (their generalised eigenvectors), so
that each phi_i can be estimated by itself. In it the matrix filter is a bank with E = T: M x' = g + T phi.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from scipy import linalg

from ..._sections import FloatArray
from ...filter import FilterBank, PhyFilter, SampledPhyFilter, stack
from ...recording import Recording
from ...recording.checks import inertia_varies
from ...results import Result
from .result import LearnResult
from .validation import corrected_error

__all__ = ["Axes", "AxesResult", "AxesScore", "learn_axes"]

Axes = Literal["shared", "each", "coupled"]
Learner = Callable[[list[Recording]], LearnResult]

_KINDS: tuple[Axes, ...] = ("shared", "each", "coupled")
_WHOLE_FLIGHTS = 5
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
class AxesResult(Result):
    """What :func:`learn_axes` found.

    Attributes
    ----------
    choice : {"shared", "each", "coupled"}
        The simplest within one standard error of the best.
    scores : dict of AxesScore
    results : dict of tuples of LearnResult
        Learned from all flights: one; one an axis; one for every phi_i.
    T : (n_x, n_x) array
        f = T phi; columns of length 1, those with the most residual for their noise last.
    """

    choice: Axes
    scores: dict[Axes, AxesScore]
    results: dict[Axes, tuple[LearnResult, ...]]
    T: FloatArray

    @property
    def filter(self) -> PhyFilter | FilterBank:
        """The filter or the bank of the choice; of phi where it is coupled."""
        filters = [result.filter for result in self.results[self.choice]]
        return filters[0] if len(filters) == 1 else stack(filters)

    def sampled(self) -> SampledPhyFilter:
        """The choice as it was learned; a coupled one gives phi_hat from ``f_theta`` in phi, f_hat = T phi_hat."""
        return _sampled(self.results[self.choice], self.T if self.choice == "coupled" else None)


def learn_axes(logs: Sequence[Recording], learner: Learner, *, folds: int = 8) -> AxesResult:
    """Choose by cross-validation among one filter for all axes, one each, and a matrix.

    Parameters
    ----------
    logs : sequence of Recording
        Flights with labels and several channels; an inertia that varies is refused.
    learner : callable
        Flights -> LearnResult, for instance ``lambda logs: learn(logs, 2, form="general", wiener=False)``. It is called
        with all channels, and with one, without and with each fold.
    folds : int
        Most of them: whole flights where there are five at least, else contiguous blocks.

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
    >>> from phyfilter_ctl.design import learn
    >>> x = np.cumsum(np.random.default_rng(0).standard_normal((800, 2)), axis=0)
    >>> label = stack([PhyFilter([4.0]), PhyFilter([40.0])]).sampled(0.01).run(x)
    >>> log = Recording.from_arrays(x=x, dt=0.01, label=label)
    >>> found = learn_axes([log], lambda logs: learn(logs, 1, starts=0, wiener=False, cross_validate=False), folds=4)
    >>> found.choice, [f"{one.a[0]:.3f}" for one in found.filter]
    ('each', ['4.000', '40.000'])
    """
    plain = [_in_units_of_f(log, i) for i, log in enumerate(logs)]
    if not plain or plain[0].n_x < 2:
        raise ValueError("logs: expected flights of two channels at least; one channel has one filter")
    T = _decoupling(plain)
    blocks = _blocks(plain, folds)
    errors: dict[Axes, FloatArray] = {kind: np.zeros(len(blocks)) for kind in _KINDS}
    for fold, held in enumerate(blocks):
        rest = _without(plain, held)
        own = _decoupling(rest)
        for kind in _KINDS:
            estimate = _estimator(kind, _learned(kind, rest, own, learner), own)
            for i, first, last in held:
                log = plain[i]
                assert log.label is not None
                f_hat = estimate(log)
                errors[kind][fold] += float(np.sum((log.label - f_hat)[first:last] ** 2))
    samples = sum((last - first) * plain[i].n_x for held in blocks for i, first, last in held)
    scores = _scores(errors, samples)
    choice: Axes = next(kind for kind in _KINDS if np.log(scores[kind].ratio) <= scores[kind].standard_error)
    results: dict[Axes, tuple[LearnResult, ...]] = {
        kind: _learned(kind, plain, T, learner) for kind in _KINDS
    }
    return AxesResult(choice, scores, results, T)


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


def _decoupling(logs: Sequence[Recording]) -> FloatArray:
    """T whose inverse makes the covariances of gamma* and of u - gamma* diagonal."""
    targets, noises = [], []
    for log in logs:
        assert log.label is not None
        known = np.zeros_like(log.x) if log.f_theta is None else log.f_theta
        g = np.zeros_like(log.x) if log.g is None else log.g
        target = log.label - known
        slope = np.diff(log.x, axis=0) / np.diff(log.times)[:, None] - (g + known)[:-1]
        targets.append(target[1:] - target[1:].mean(axis=0))
        noises.append(slope - target[1:])
    S, N = (np.cov(np.concatenate(part), rowvar=False) for part in (targets, noises))
    N = N + (_LEAST_NOISE * np.trace(S) + np.finfo(float).tiny) * np.eye(len(N))
    vectors = linalg.eigh(S, N)[1]
    T = np.linalg.inv(vectors.T)
    T = T / np.linalg.norm(T, axis=0)
    return np.asarray(T * np.sign(T[np.argmax(np.abs(T), axis=0), np.arange(len(T))]), dtype=float)


def _learned(
    kind: Axes, logs: Sequence[Recording], T: FloatArray, learner: Learner
) -> tuple[LearnResult, ...]:
    if kind == "shared":
        return (learner(list(logs)),)
    rows = np.eye(len(T)) if kind == "each" else np.linalg.inv(T)
    return tuple(learner([_transformed(log, row[None]) for log in logs]) for row in rows)


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


def _blocks(logs: Sequence[Recording], folds: int) -> list[list[tuple[int, int, int]]]:
    """Folds of (flight, first, last sample); the first sample of a flight, where f_hat = f_theta, in none."""
    if len(logs) >= _WHOLE_FLIGHTS:
        dealt: list[list[tuple[int, int, int]]] = [[] for _ in range(min(folds, len(logs)))]
        for i, log in enumerate(logs):
            dealt[i % len(dealt)].append((i, 1, log.n))
        return dealt
    edges = [(i, np.linspace(1, log.n, folds + 1).astype(int)) for i, log in enumerate(logs)]
    return [[(i, int(cut[k]), int(cut[k + 1])) for i, cut in edges] for k in range(folds)]


def _without(logs: Sequence[Recording], held: Sequence[tuple[int, int, int]]) -> list[Recording]:
    """What is left of the flights, cut where a block is taken out."""
    out = {i: (first, last) for i, first, last in held}
    kept: list[Recording] = []
    for i, log in enumerate(logs):
        cuts = [0, *out.get(i, ()), log.n]
        pieces = list(pairwise(cuts))[:: 2 if i in out else 1]
        kept += [log.segment(first, last) for first, last in pieces if last - first > 2]
    return kept
