"""Methods compared: every one in every case over the same seeds, and what of it is statistics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from ..execution import Checkpoint, Executor, Report, silent
from ..results import Interval
from .statistics import median_interval, reduction

__all__ = ["Scores", "score_methods"]

Name = TypeVar("Name", bound=str)
Case = TypeVar("Case", bound=str)
S = TypeVar("S")


class Scores(dict[tuple[str, str], S], Generic[S]):
    """Scores by (case, method).

    Each is an object with an array (B,) for every figure, one entry a seed, in the same order for all methods. So
    methods are compared flight by flight: what differs between seeds is no noise of a reduction.
    """

    def interval(self, case: str, method: str, figure: str) -> Interval:
        """Median over the seeds with its interval.

        Parameters
        ----------
        case, method : str
        figure : str
            Of the score.
        """
        return median_interval(getattr(self[case, method], figure))

    def reduction(self, case: str, over: str, *, of: str, figure: str) -> Interval:
        """By how much one method is below another, in per cent, see :func:`reduction`.

        Parameters
        ----------
        case : str
        over, of : str
            The other method, and the one.
        figure : str
            Of the score.
        """
        return reduction(getattr(self[case, of], figure), getattr(self[case, over], figure))

    def middle(self, case: str, method: str, figure: str) -> int:
        """Number of the flight whose figure is the median one: the one to show.

        Parameters
        ----------
        case, method : str
        figure : str
            Of the score.
        """
        values = getattr(self[case, method], figure)
        return int(np.argsort(values)[len(values) // 2])


def score_methods(
    methods: Sequence[Name],
    cases: Sequence[Case],
    fly: Callable[[Name, Case], S],
    *,
    report: Report = silent,
    executor: Executor | None = None,
    checkpoint: Checkpoint[S] | None = None,
) -> Scores[S]:
    """Score every method in every case.

    Parameters
    ----------
    methods, cases : sequence of str
    fly : function (method, case) -> score
        Over the same seeds each time.
    report : callable
        Called at the beginning of every case.
    executor : Executor, optional
        What flies them; None flies one after the other, here. The scores are the same.
    checkpoint : Checkpoint, optional
        Of the scores, by "method, case".

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> errors = {"pd": [0.2, 0.1, 0.3], "filter": [0.1, 0.06, 0.12]}
    >>> scores = score_methods(list(errors), ["wind"], lambda name, case: SimpleNamespace(error=np.array(errors[name])))
    >>> scores.interval("wind", "filter", "error").value, scores.middle("wind", "pd", "error")
    (0.1, 0)
    >>> round(scores.reduction("wind", "pd", of="filter", figure="error").value, 9)
    50.0
    """
    jobs = [(name, case) for name in methods for case in cases]
    names = [f"{name}, {case}" for name, case in jobs]
    answers = (executor or Executor(1)).map(
        partial(_scored, fly=fly), jobs, names=names, report=report, checkpoint=checkpoint
    )
    scores: Scores[S] = Scores()
    for (name, case), answer in zip(jobs, answers, strict=True):
        scores[case, name] = answer
    return scores


def _scored(job: tuple[Name, Case], fly: Callable[[Name, Case], S]) -> S:
    return fly(*job)
