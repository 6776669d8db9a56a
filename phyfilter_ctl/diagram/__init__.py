"""python-control diagrams as one model."""

from .flattening import as_sampled, flatten
from .model import FlatModel, Task

__all__ = ["FlatModel", "Task", "as_sampled", "flatten"]
