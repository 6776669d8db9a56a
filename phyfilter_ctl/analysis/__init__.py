"""Analysis: what a filter does to signals."""

from .bounds import BoundResult, Certificate, Implementation, QuadraticProof, ultimate_bound
from .budget import ErrorBudget, error_budget
from .frequency import FilterResponse, FilterResponseList, Peak, frequency_response
from .margins import (
    BandwidthLimit,
    Crossing,
    InertiaCertificate,
    InertiaMotion,
    InertiaVerdict,
    Loop,
    LoopMargin,
    LoopMargins,
    PriorMargin,
    SaturationMargin,
    configuration_hull,
    largest_bandwidth,
    loop_margin,
    moving_inertia,
    prior_margin,
    saturation_margin,
)
from .poles import PolesAndZeros, PoleZeroMap, pole_zero_map
from .variance import Variance, error_variance, gauss_markov

__all__ = [
    "BandwidthLimit",
    "BoundResult",
    "Certificate",
    "Crossing",
    "ErrorBudget",
    "FilterResponse",
    "FilterResponseList",
    "Implementation",
    "InertiaCertificate",
    "InertiaMotion",
    "InertiaVerdict",
    "Loop",
    "LoopMargin",
    "LoopMargins",
    "Peak",
    "PoleZeroMap",
    "PolesAndZeros",
    "PriorMargin",
    "QuadraticProof",
    "SaturationMargin",
    "Variance",
    "configuration_hull",
    "error_budget",
    "error_variance",
    "frequency_response",
    "gauss_markov",
    "largest_bandwidth",
    "loop_margin",
    "moving_inertia",
    "pole_zero_map",
    "prior_margin",
    "saturation_margin",
    "ultimate_bound",
]
