"""Statistics of a few dozen flights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Interval

__all__ = ["median_interval", "reduction"]


def median_interval(values: ArrayLike) -> Interval:
    """Median and its interval from order statistics: P(x_(k) < median < x_(n+1-k)) = 1 - 2 P(Binomial(n, 1/2) < k).

    Parameters
    ----------
    values : (B,) array
        At least one. Below 6 values the interval is that of least and greatest, and encloses less than 95 %.

    Returns
    -------
    Interval
        Distribution-free: its ends are order statistics that enclose the median of all that could be drawn with at
        least 95 %.

    Raises
    ------
    ValueError
        For no values, or an array of another shape.

    Examples
    --------
    >>> interval = median_interval(np.arange(20.0))
    >>> interval.value, interval.low, interval.high
    (9.5, 5.0, 14.0)
    """
    from scipy.stats import binom  # takes half a second

    ordered = np.sort(_row("values", values))
    n = len(ordered)
    k = max(1, int(binom.ppf(0.025, n, 0.5)))
    return Interval(float(np.median(ordered)), float(ordered[k - 1]), float(ordered[n - k]))


def _row(name: str, values: ArrayLike) -> FloatArray:
    """Numbers, infinity where a flight has failed."""
    row = _signals.array(name, values, ("B",), finite=False)
    if np.isnan(row).any():
        raise ValueError(
            f"{name}: expected numbers, none masked, got nan in entry {int(np.argmax(np.isnan(row)))}"
        )
    return row


def reduction(ours: ArrayLike, theirs: ArrayLike) -> Interval:
    """By how much one method's errors are below another's, in per cent: 100 (1 - ours/theirs), flight by flight.

    Parameters
    ----------
    ours, theirs : (B,) arrays
        Errors of the same flights: the same seeds in the same order.

    Raises
    ------
    ValueError
        For no flights, or different numbers of them.

    Examples
    --------
    >>> reduction([1.0, 2.0, 1.5], [2.0, 4.0, 3.0]).value
    50.0
    """
    a, b = _row("ours", ours), _row("theirs", theirs)
    if a.shape != b.shape:
        raise ValueError(
            f"ours, theirs: expected errors of the same flights, got shapes {a.shape} and {b.shape}"
        )
    return median_interval(100.0 * (1.0 - a / b))
