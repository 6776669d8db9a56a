"""Diagrams run: in CasADi's virtual machine or as compiled C, one by one or in batches."""

from .._renamed import former
from .response import SimulationResponse
from .sensitivity import Sensitivity, sensitivity
from .simulate import BackendChoice, simulate, simulate_batch

__all__ = [
    "BackendChoice",
    "Sensitivity",
    "SimulationResponse",
    "sensitivity",
    "simulate",
    "simulate_batch",
]


def __getattr__(name: str) -> object:
    return former(__name__, name)
