"""Margins of loops with the filter in them: inertia, gain, phase, delay, bandwidth."""

from ._switching import InertiaMotion
from .bandwidth import BandwidthLimit, largest_bandwidth
from .complete import LoopMargin, loop_margin
from .configurations import configuration_hull
from .loop_margins import LoopMargins
from .moving import InertiaCertificate, moving_inertia
from .prior import InertiaVerdict, PriorMargin, prior_margin
from .saturation import SaturationMargin, saturation_margin
from .sweep import Crossing, Loop

__all__ = [
    "BandwidthLimit",
    "Crossing",
    "InertiaCertificate",
    "InertiaMotion",
    "InertiaVerdict",
    "Loop",
    "LoopMargin",
    "LoopMargins",
    "PriorMargin",
    "SaturationMargin",
    "configuration_hull",
    "largest_bandwidth",
    "loop_margin",
    "moving_inertia",
    "prior_margin",
    "saturation_margin",
]
