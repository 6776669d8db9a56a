"""Margins of loops with the filter in them: inertia, gain, phase, delay, bandwidth."""

from .bandwidth import BandwidthLimit, largest_bandwidth
from .complete import LoopMargin, loop_margin
from .configurations import configuration_hull
from .disk import DiskMargin, disk_margin
from .loop_margins import LoopMargins
from .moving import InertiaCertificate, moving_inertia
from .prior import InertiaVerdict, PriorMargin, prior_margin
from .ratio_margins import RatioMargins
from .saturation import SaturationMargin, saturation_margin
from .slopes import Surroundings
from .sweep import Crossing, Loop
from .switching import InertiaMotion

__all__ = [
    "BandwidthLimit",
    "Crossing",
    "DiskMargin",
    "InertiaCertificate",
    "InertiaMotion",
    "InertiaVerdict",
    "Loop",
    "LoopMargin",
    "LoopMargins",
    "PriorMargin",
    "RatioMargins",
    "SaturationMargin",
    "Surroundings",
    "configuration_hull",
    "disk_margin",
    "largest_bandwidth",
    "loop_margin",
    "moving_inertia",
    "prior_margin",
    "saturation_margin",
]
