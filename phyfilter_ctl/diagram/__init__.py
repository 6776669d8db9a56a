"""python-control diagrams as one model, and their margins at any signal."""

from .discrete import as_sampled
from .equations import AlgebraicLoop, FlatEvent
from .flattening import flatten
from .model import FlatModel, Task
from .opening import SignalMargin, between, open_loop

__all__ = [
    "AlgebraicLoop",
    "FlatEvent",
    "FlatModel",
    "SignalMargin",
    "Task",
    "as_sampled",
    "between",
    "flatten",
    "open_loop",
]
