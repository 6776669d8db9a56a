"""python-control diagrams as one model, and their margins at any signal."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .equations import AlgebraicLoop, FlatEvent
from .flattening import flatten
from .model import FlatModel, Task
from .opening import between

__all__ = [
    "AlgebraicLoop",
    "FlatEvent",
    "FlatModel",
    "Task",
    "between",
    "flatten",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
