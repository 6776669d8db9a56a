"""What surrounds a filter, each with a name: the loop it is in, and what disturbs it."""

from .disturbance import Bounded, Bounds, Gaussian, Implementation, Shape, gauss_markov
from .loop import Loop

__all__ = ["Bounded", "Bounds", "Gaussian", "Implementation", "Loop", "Shape", "gauss_markov"]
