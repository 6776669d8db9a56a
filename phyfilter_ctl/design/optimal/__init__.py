"""Filters from promises: least worst-case error, least variance, within limits, and what a log says of the data."""

from functools import partial
from typing import TYPE_CHECKING

from ..._renamed import former
from .floor import error_floor
from .limits import LimitsFront, Trade, limits_front
from .promises import LeastBound, least_bound
from .statistics import Peak, ResidualStatistics, residual_statistics
from .variances import LeastVariance, kalman_filter, kalman_variance, least_variance

__all__ = [
    "LeastBound",
    "LeastVariance",
    "LimitsFront",
    "Peak",
    "ResidualStatistics",
    "Trade",
    "error_floor",
    "kalman_filter",
    "kalman_variance",
    "least_bound",
    "least_variance",
    "limits_front",
    "residual_statistics",
]

if not TYPE_CHECKING:
    __getattr__ = partial(former, __name__)
