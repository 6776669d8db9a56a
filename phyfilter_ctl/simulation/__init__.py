"""Diagrams run: in CasADi's virtual machine or as compiled C, one by one or in batches."""

from .filter_place import FilterPlace
from .response import SimulationResponse
from .sampled_loop import SampledModel, linearize_sampled, sampled_open_loop
from .sensitivity import Sensitivity, sensitivity
from .settling import OperatingPoint
from .signal_margin import signal_margin
from .simulate import BackendChoice, simulate, simulate_batch

__all__ = [
    "BackendChoice",
    "FilterPlace",
    "OperatingPoint",
    "SampledModel",
    "Sensitivity",
    "SimulationResponse",
    "linearize_sampled",
    "sampled_open_loop",
    "sensitivity",
    "signal_margin",
    "simulate",
    "simulate_batch",
]
