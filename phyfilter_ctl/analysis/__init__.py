"""Analysis: what a filter does to signals."""

from .bounds import BoundResult, Certificate, ultimate_bound
from .frequency import FilterResponse, FilterResponseList, Peak, frequency_response
from .margins import (
    BandwidthLimit,
    InertiaVerdict,
    LoopMargin,
    LoopMargins,
    PriorMargin,
    largest_bandwidth,
    loop_margin,
    prior_margin,
)
from .variance import Variance, error_variance, gauss_markov

__all__ = [
    "BandwidthLimit",
    "BoundResult",
    "Certificate",
    "FilterResponse",
    "FilterResponseList",
    "InertiaVerdict",
    "LoopMargin",
    "LoopMargins",
    "Peak",
    "PriorMargin",
    "Variance",
    "error_variance",
    "frequency_response",
    "gauss_markov",
    "largest_bandwidth",
    "loop_margin",
    "prior_margin",
    "ultimate_bound",
]
