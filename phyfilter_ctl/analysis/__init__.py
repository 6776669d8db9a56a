"""Analysis: what a filter does to signals."""

from .bounds import BoundResult, Certificate, ultimate_bound
from .frequency import FilterResponse, FilterResponseList, Peak, frequency_response
from .variance import Variance, error_variance, gauss_markov

__all__ = [
    "BoundResult",
    "Certificate",
    "FilterResponse",
    "FilterResponseList",
    "Peak",
    "Variance",
    "error_variance",
    "frequency_response",
    "gauss_markov",
    "ultimate_bound",
]
