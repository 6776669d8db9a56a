"""python-control diagrams as one model."""

from .model import FlatModel, Task

__all__ = ["FlatModel", "Task"]
