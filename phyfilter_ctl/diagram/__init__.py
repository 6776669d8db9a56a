"""python-control diagrams as one model, and their margins at any signal."""

from .._renamed import former
from .equations import AlgebraicLoop, FlatEvent
from .flattening import flatten
from .model import FlatModel, Task
from .opening import between, open_loop

__all__ = [
    "AlgebraicLoop",
    "FlatEvent",
    "FlatModel",
    "Task",
    "between",
    "flatten",
    "open_loop",
]


def __getattr__(name: str) -> object:
    return former(__name__, name)
