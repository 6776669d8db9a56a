"""Recorded flights: named channels, units, CSV in and out, checks that name the row, splits by flight."""

from .log import FlightLog
from .splits import split_by_speed, split_flights

__all__ = ["FlightLog", "split_by_speed", "split_flights"]
