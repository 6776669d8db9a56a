"""Diagrams run: in CasADi's virtual machine or as compiled C, one by one or in batches."""

from .response import SimulationResponse
from .sensitivity import Sensitivity, sensitivity
from .simulate import simulate, simulate_batch

__all__ = ["Sensitivity", "SimulationResponse", "sensitivity", "simulate", "simulate_batch"]
