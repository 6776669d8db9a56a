"""Margins of loops with the filter in them: inertia, gain, phase, delay, bandwidth."""

from .bandwidth import BandwidthLimit, largest_bandwidth
from .configurations import configuration_hull
from .disk import DiskMargin
from .filter_margins import FilterMargins, filter_margins
from .inertia_tolerance import inertia_tolerance
from .margins import Margins
from .moving import InertiaCertificate
from .saturation import SaturationMargin, saturation_margin
from .slopes import Surroundings
from .sweep import Characteristic, Crossing
from .switching import InertiaMotion
from .system_margins import SystemMargins, gain_margins

__all__ = [
    "BandwidthLimit",
    "Characteristic",
    "Crossing",
    "DiskMargin",
    "FilterMargins",
    "InertiaCertificate",
    "InertiaMotion",
    "Margins",
    "SaturationMargin",
    "Surroundings",
    "SystemMargins",
    "configuration_hull",
    "filter_margins",
    "gain_margins",
    "inertia_tolerance",
    "largest_bandwidth",
    "saturation_margin",
]
