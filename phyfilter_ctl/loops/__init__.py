"""Loops of diagrams: margins at their wires, sampled loops, where they settle, and places for a filter in them."""

from .filter_place import FilterPlace
from .margins import margins
from .sampled_loop import SampledModel, linearize_sampled, sampled_open_loop
from .settling import OperatingPoint

__all__ = [
    "FilterPlace",
    "OperatingPoint",
    "SampledModel",
    "linearize_sampled",
    "margins",
    "sampled_open_loop",
]
