"""Diagrams run: in CasADi's virtual machine or as compiled C, one by one or in batches."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from ..execution.limits import Limits
from .response import SimulationResponse
from .sensitivity import Sensitivity, sensitivity
from .signals import SimulationBatch
from .simulate import BackendChoice, simulate, simulate_batch

__all__ = [
    "BackendChoice",
    "Limits",
    "Sensitivity",
    "SimulationBatch",
    "SimulationResponse",
    "sensitivity",
    "simulate",
    "simulate_batch",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
