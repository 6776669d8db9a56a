"""Analysis: what a filter does to signals."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .bounds import Certificate, ErrorBound, FixedPoint, QuadraticProof, Together, error_bound, fixed_point
from .budget import ErrorBudget, error_budget
from .frequency import FilterResponse, FilterResponseList, Peak, frequency_response
from .margins import (
    BandwidthLimit,
    Characteristic,
    Crossing,
    DiskMargin,
    FilterMargins,
    InertiaCertificate,
    InertiaMotion,
    Margins,
    SaturationMargin,
    Surroundings,
    SystemMargins,
    configuration_hull,
    inertia_tolerance,
    largest_bandwidth,
    saturation_margin,
)
from .poles import PoleZeroMap
from .summary import Analysis, analyze
from .tracking_error import TrackingDeviation, TrackingTube, tracking_error
from .variance import Variance, error_variance
from .verdict import Sentence

__all__ = [
    "Analysis",
    "BandwidthLimit",
    "Certificate",
    "Characteristic",
    "Crossing",
    "DiskMargin",
    "ErrorBound",
    "ErrorBudget",
    "FilterMargins",
    "FilterResponse",
    "FilterResponseList",
    "FixedPoint",
    "InertiaCertificate",
    "InertiaMotion",
    "Margins",
    "Peak",
    "PoleZeroMap",
    "QuadraticProof",
    "SaturationMargin",
    "Sentence",
    "Surroundings",
    "SystemMargins",
    "Together",
    "TrackingDeviation",
    "TrackingTube",
    "Variance",
    "analyze",
    "configuration_hull",
    "error_bound",
    "error_budget",
    "error_variance",
    "fixed_point",
    "frequency_response",
    "inertia_tolerance",
    "largest_bandwidth",
    "saturation_margin",
    "tracking_error",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
