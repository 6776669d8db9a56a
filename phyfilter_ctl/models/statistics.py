"""Statistics of a few dozen flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binom

__all__ = ["Interval", "median_interval"]


@dataclass(frozen=True)
class Interval:
    """A median with a distribution-free interval.

    Attributes
    ----------
    median, low, high : float
        low and high are order statistics that enclose the median of all that could be drawn with at least 95 %.
    """

    median: float
    low: float
    high: float


def median_interval(values: ArrayLike) -> Interval:
    """Median and its interval from order statistics: P(x_(k) < median < x_(n+1-k)) = 1 - 2 P(Binomial(n, 1/2) < k).

    Parameters
    ----------
    values : (B,) array
        At least one. Below 6 values the interval is that of least and greatest, and encloses less than 95 %.

    Raises
    ------
    ValueError
        For no values, or an array of another shape.

    Examples
    --------
    >>> interval = median_interval(np.arange(20.0))
    >>> interval.median, interval.low, interval.high
    (9.5, 5.0, 14.0)
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    if ordered.ndim != 1 or len(ordered) == 0:
        raise ValueError(f"values: expected one row of numbers, got shape {ordered.shape}")
    n = len(ordered)
    k = max(1, int(binom.ppf(0.025, n, 0.5)))
    return Interval(float(np.median(ordered)), float(ordered[k - 1]), float(ordered[n - k]))
