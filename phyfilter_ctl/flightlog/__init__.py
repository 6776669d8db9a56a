"""Recorded flights: named channels, units, CSV in and out, checks that name the row, splits by flight."""

from .comparison import EstimateComparison
from .log import FlightLog
from .splits import split_by_speed, split_flights

__all__ = ["EstimateComparison", "FlightLog", "split_by_speed", "split_flights"]
