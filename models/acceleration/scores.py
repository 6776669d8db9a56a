"""RMSE of one method over that of another, with an interval over what is independent: flights, or seeds.

The two are paired: units are drawn with replacement, and of each draw both methods are scored. Of few units the
quantiles of a bootstrap lie too near each other; they are taken further out, as far as Student's t with n - 1 degrees
of freedom and the variance over n - 1 instead of n ask for (expanded percentile interval: T. Hesterberg, "What teachers
should know about the bootstrap", The American Statistician 69(4), 2015).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

__all__ = ["OURS", "Ratio", "best_rival", "over", "root_mean"]

FloatArray = NDArray[np.float64]

# Methods with a PhyFilter in them; the others are their rivals, the network alone among them.
OURS = ("phyfilter_1", "phyfilter_2", "phyfilter_3", "learned", "learned_axes", "network_after")
_FEWEST = 5  # units below which an interval says nothing
_DRAWS = 10_000
_OUTSIDE = 0.025  # on either side


class Ratio(NamedTuple):
    """RMSE over that of another method, less 1.

    Attributes
    ----------
    value : float
    low, high : float
        Ends of the 95 % interval; infinite for fewer than five units.
    """

    value: float
    low: float
    high: float

    @property
    def is_ahead(self) -> bool:
        """Whether the interval lies below 0."""
        return self.high < 0.0

    def __str__(self) -> str:
        """In per cent.

        Examples
        --------
        >>> print(Ratio(0.057, 0.025, 0.0909))
        +5.7 % [+2.5, +9.1]
        """
        ends = f" [{100 * self.low:+.1f}, {100 * self.high:+.1f}]" if np.isfinite(self.low) else ""
        return f"{100 * self.value:+.1f} %{ends}"


def root_mean(squares: FloatArray) -> float:
    """RMSE of sums of squared errors and their numbers, (units, 2)."""
    total, count = squares.sum(axis=0)
    return float(np.sqrt(total / count))


def over(one: FloatArray, other: FloatArray) -> Ratio:
    """Paired ratio of two methods.

    Parameters
    ----------
    one, other : (units, 2) arrays
        Sum of squared errors, and how many: of the same units in the same order.

    Examples
    --------
    >>> other = np.array([[4.0, 1.0], [9.0, 1.0], [16.0, 1.0], [4.0, 1.0], [1.0, 1.0]])
    >>> print(over(other * [0.81, 1.0], other))
    -10.0 % [-10.0, -10.0]
    """
    n = len(one)
    value = root_mean(one) / root_mean(other) - 1.0
    if n < _FEWEST:
        return Ratio(value, -np.inf, np.inf)
    drawn = np.random.default_rng(0).integers(n, size=(_DRAWS, n))
    ratios = np.sqrt(one[drawn, 0].sum(axis=1) / other[drawn, 0].sum(axis=1)) - 1.0
    outside = float(ndtr(np.sqrt(n / (n - 1.0)) * stdtrit(n - 1.0, _OUTSIDE)))
    low, high = np.quantile(ratios, [outside, 1.0 - outside])
    return Ratio(value, float(low), float(high))


def best_rival(rmse: Mapping[str, float]) -> str:
    """Name of the method without a PhyFilter that has the least RMSE."""
    return min((name for name in rmse if name not in OURS), key=lambda name: rmse[name])
