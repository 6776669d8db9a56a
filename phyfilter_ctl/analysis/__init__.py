"""Analysis: what a filter does to signals."""

from .frequency import FilterResponse, FilterResponseList, Peak, frequency_response

__all__ = ["FilterResponse", "FilterResponseList", "Peak", "frequency_response"]
