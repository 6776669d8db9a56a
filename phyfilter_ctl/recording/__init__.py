"""Recordings: named channels, units, CSV in and out, checks that name the row, splits by recording."""

from .comparison import EstimateComparison
from .recording import Recording
from .splits import split_by_speed, split_flights

__all__ = ["EstimateComparison", "Recording", "split_by_speed", "split_flights"]
