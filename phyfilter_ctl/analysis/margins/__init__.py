"""Margins of loops with the filter in them: inertia, gain, phase, delay, bandwidth."""

from ._margins import LoopMargins
from ._sweep import Crossing
from .bandwidth import BandwidthLimit, largest_bandwidth
from .complete import LoopMargin, loop_margin
from .prior import InertiaVerdict, PriorMargin, prior_margin

__all__ = [
    "BandwidthLimit",
    "Crossing",
    "InertiaVerdict",
    "LoopMargin",
    "LoopMargins",
    "PriorMargin",
    "largest_bandwidth",
    "loop_margin",
    "prior_margin",
]
