"""What a filter promises: ultimate bounds."""

from .fixed_point import FixedPoint, fixed_point
from .implementation import Implementation
from .kernels import Certificate
from .result import BoundResult, QuadraticProof
from .together import Together
from .ultimate import ultimate_bound

__all__ = [
    "BoundResult",
    "Certificate",
    "FixedPoint",
    "Implementation",
    "QuadraticProof",
    "Together",
    "fixed_point",
    "ultimate_bound",
]
