"""Whether a part changed at once, a payload dropped, a motor weak, at a rate of false alarms that is stated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ... import _signals
from ..._sections import FloatArray
from ...recording import Recording
from ...results import Result
from .kalman import Forward
from .structure import Working

__all__ = ["Changes", "Schedule", "changes_of", "evidence"]

_AGES = (1 / 6, 1 / 3, 2 / 3, 1.0)  # of a change when it is tested, in the longest
_SPACING = 1 / 30  # between changes tested, in the longest age


@dataclass(frozen=True)
class Schedule:
    """Which jumps are tested, and when.

    Attributes
    ----------
    ages : tuple of int
        Of a jump when it is tested, in samples, ascending.
    every : int
        Samples between two jumps that are tested.
    threshold : float
        Above which a test alarms.
    """

    ages: tuple[int, ...]
    every: int
    threshold: float

    @classmethod
    def of(cls, dt: float, scalars: int, *, false_alarms: float, within: float) -> Schedule:
        """For a part of so many scalars, sampled every ``dt`` seconds; the rest as for :meth:`Separation.changes`."""
        rate = _signals.number("false_alarms", false_alarms, "1/h", above=0.0)
        span = _signals.duration("within", within)
        ages = sorted({max(1, round(age * span / dt)) for age in _AGES})
        every = max(1, round(_SPACING * span / dt))
        count = 3600.0 / (every * dt) * len(ages)
        return cls(tuple(ages), every, float(chi2.isf(min(rate / count, 1.0), scalars)))


@dataclass(frozen=True, eq=False, repr=False)
class Changes(Result):
    """Sudden changes of a part; made by :meth:`Separation.changes`.

    Attributes
    ----------
    alarms : (K,) array
        Times in s at which one is noticed, none while the last lasts.
    onsets : (K,) array
        When it began, most likely, s.
    jumps : (K, p) array
        By how much each scalar of the part changed, most likely.
    statistic : (N,) array
        At each sample the largest of the tests that end there; each is chi-square of p degrees of freedom without a
        change.
    threshold : float
        Above which it alarms.
    """

    alarms: FloatArray
    onsets: FloatArray
    jumps: FloatArray
    statistic: FloatArray
    threshold: float


def changes_of(
    log: Recording, working: Working, run: Forward, own: NDArray[np.intp], schedule: Schedule
) -> Changes:
    """Of the scalars ``own``, over a recording longer than the longest age."""
    ages, threshold = schedule.ages, schedule.threshold
    begins, statistic, jumps = evidence(working, run, own, schedule)
    best, onset, jump = np.zeros(log.n), np.zeros(log.n), np.zeros((log.n, len(own)))
    for age, values, sizes in zip(ages, statistic, jumps, strict=True):
        at = begins + age
        better = values > best[at]
        best[at[better]], onset[at[better]], jump[at[better]] = (
            values[better],
            log.times[begins[better]],
            sizes[better],
        )
    over = np.flatnonzero(best > threshold)
    # One alarm for a change: the next not before the last has been quiet for the longest age.
    first = over[np.diff(over, prepend=-math.inf) > ages[-1]]
    return Changes(log.times[first], onset[first], jump[first], best, threshold)


def evidence(
    working: Working, run: Forward, own: NDArray[np.intp], schedule: Schedule
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Where jumps begin (T,), and for each age their statistic (A, T, ...) and most likely size (A, T, ..., p)."""
    n_x = working.structure.n_x
    H = np.hstack([np.eye(n_x), working.structure.measured])
    ages = schedule.ages
    begins = np.arange(0, len(run.F) - ages[-1] + 1, schedule.every)
    mean, P = run.course.mean[begins][..., n_x:], run.course.covariance[begins][..., n_x:, n_x:]
    # What a jump of the physical scalars does to the working ones.
    D = np.zeros((*mean.shape[:-1], run.F.shape[-1], len(own)))
    D[..., n_x:, :] = np.linalg.inv(working.physical(mean, P)[2])[..., own]
    score, information = np.zeros((*D.shape[:-2], len(own), 1)), np.zeros((*D.shape[:-2], len(own), len(own)))
    statistic, sizes = [], []
    for age in range(ages[-1]):
        k = begins + age
        D = run.F[k] @ D
        seen = H @ D
        weighted = np.swapaxes(seen, -1, -2) @ run.S_inverse[k]
        score += weighted @ run.innovation[k][..., None]
        information += weighted @ seen
        D = D - run.gain[k] @ seen
        if age + 1 in ages:
            size = np.linalg.pinv(information, hermitian=True) @ score
            statistic.append((np.swapaxes(score, -1, -2) @ size)[..., 0, 0])
            sizes.append(size[..., 0])
    return begins, np.array(statistic), np.array(sizes)
