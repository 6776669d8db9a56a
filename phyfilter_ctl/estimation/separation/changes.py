"""Whether a part changed at once, a payload dropped, a motor weak, at a rate of false alarms that is stated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from ... import _signals
from ..._sections import FloatArray
from ...results import Result
from .kalman import Forward
from .structure import Working

if TYPE_CHECKING:
    from .found import Separation

__all__ = ["Changes", "Schedule", "detect_changes", "evidence"]

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
        """For a part of so many scalars, sampled every ``dt`` seconds; the rest as for :func:`detect_changes`."""
        rate = _signals.number("false_alarms", false_alarms, "1/h", above=0.0)
        span = _signals.duration("within", within)
        ages = sorted({max(1, round(age * span / dt)) for age in _AGES})
        every = max(1, round(_SPACING * span / dt))
        count = 3600.0 / (every * dt) * len(ages)
        return cls(tuple(ages), every, float(chi2.isf(min(rate / count, 1.0), scalars)))


@dataclass(frozen=True, eq=False, repr=False)
class Changes(Result):
    """Sudden changes of a part; made by :func:`detect_changes`.

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


def detect_changes(
    separation: Separation, part: str, *, false_alarms: float = 1.0, within: float = 0.3
) -> Changes:
    """Sudden changes of one part, from the innovations of the filter.

    Parameters
    ----------
    separation : Separation
        Made with ``causal=True``.
    part : str
        Its name.
    false_alarms : float
        How many an hour are accepted at most.
    within : float
        Age at which a change is tested last, s. Older ones are for the filter to follow.

    Returns
    -------
    Changes

    Raises
    ------
    ValueError
        If there is no such part, the separation is not causal, it is shorter than ``within``, or an option is out of
        range.

    Notes
    -----
    The generalised likelihood ratio of A. S. Willsky and H. L. Jones, "A generalized likelihood ratio approach to the
    detection and estimation of jumps in linear systems", IEEE Transactions on Automatic Control 21 (1), 1976: a jump at
    sample k leaves a known signature in the innovations, which are white without it. Tested are jumps every within/30,
    at four ages. Bonferroni's inequality sets the threshold, so that the rate holds whatever the tests have in common,
    as long as the innovations are white, of which ``Separation.consistency`` speaks.

    A filter that has seen a change follows it slowly: separate the recording anew from the alarm on. In flight
    :func:`~phyfilter_ctl.blocks.separation_block` does these tests with ``watch``, and goes on with the change counted.

    Examples
    --------
    A load of 0.6 kg that falls off after 2 s:

    >>> from phyfilter_ctl.estimation import ColouredForce, Payload, separate
    >>> from phyfilter_ctl.recording import Recording
    >>> rng, t = np.random.default_rng(0), 0.01 * np.arange(301)
    >>> slope = np.where(t < 2.0, 0.0, 0.6 * 9.81 / 3.0)
    >>> v = np.cumsum(slope) * 0.01 + 0.01 * rng.standard_normal(t.shape)
    >>> log = Recording.from_arrays(x=v, g=np.full(301, 0.6 * 9.81), dt=0.01, inertia=3.0)
    >>> parts = [Payload(1.0, gravity=[9.81]), ColouredForce(0.5, bandwidth=5.0)]
    >>> found = detect_changes(separate(log, parts, noise=0.03, causal=True), "payload")
    >>> bool(2.0 < found.alarms[0] < 2.3), bool(found.jumps[0, 0] < -0.3)
    (True, True)
    """
    if part not in separation.parts:
        raise ValueError(f"part: expected one of {', '.join(separation.parts)}, got {part!r}")
    if not separation.causal:
        raise ValueError("separation: expected one of causal=True, whose innovations are those of the flight")
    log, ends = separation.recording, separation._ends
    own = np.flatnonzero(ends.structure.part == list(separation.parts).index(part))
    schedule = Schedule.of(log.dt, len(own), false_alarms=false_alarms, within=within)
    ages, threshold = schedule.ages, schedule.threshold
    if log.n <= ages[-1]:
        raise ValueError(
            f"within: expected less than the recording of {log.duration:.3g} s, got {within:g} s"
        )
    begins, statistic, jumps = evidence(ends.working, ends.run, own, schedule)
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
