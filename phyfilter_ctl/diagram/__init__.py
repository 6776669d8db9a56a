"""python-control diagrams as one model, and their margins at any signal."""

from .equations import AlgebraicLoop, FlatEvent
from .flattening import as_sampled, flatten
from .model import FlatModel, Task
from .opening import SignalMargin, open_loop

__all__ = [
    "AlgebraicLoop",
    "FlatEvent",
    "FlatModel",
    "SignalMargin",
    "Task",
    "as_sampled",
    "flatten",
    "open_loop",
]
