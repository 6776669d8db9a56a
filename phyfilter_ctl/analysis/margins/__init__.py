"""Margins of loops with the filter in them: inertia, gain, phase, delay, bandwidth."""

from .bandwidth import BandwidthLimit, largest_bandwidth
from .complete import LoopMargin, loop_margin
from .loop_margins import LoopMargins
from .prior import InertiaVerdict, PriorMargin, prior_margin
from .saturation import SaturationMargin, saturation_margin
from .sweep import Crossing, Loop

__all__ = [
    "BandwidthLimit",
    "Crossing",
    "InertiaVerdict",
    "Loop",
    "LoopMargin",
    "LoopMargins",
    "PriorMargin",
    "SaturationMargin",
    "largest_bandwidth",
    "loop_margin",
    "prior_margin",
    "saturation_margin",
]
