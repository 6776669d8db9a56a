"""Filters from promises: least worst-case error, least variance, trade-offs, and what a log says of the data."""

from .floor import error_floor
from .limits import LimitsFront, Trade, limits_front
from .promises import LeastBound, TradeOff, bound_trade_off, least_bound
from .statistics import Interval, Peak, ResidualStatistics, residual_statistics
from .variances import LeastVariance, kalman_filter, kalman_variance, least_variance, variance_trade_off

__all__ = [
    "Interval",
    "LeastBound",
    "LeastVariance",
    "LimitsFront",
    "Peak",
    "ResidualStatistics",
    "Trade",
    "TradeOff",
    "bound_trade_off",
    "error_floor",
    "kalman_filter",
    "kalman_variance",
    "least_bound",
    "least_variance",
    "limits_front",
    "residual_statistics",
    "variance_trade_off",
]
