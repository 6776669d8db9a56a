"""What a filter promises: bounds of the error."""

from .error_bound import error_bound
from .fixed_point import FixedPoint, fixed_point
from .kernels import Certificate
from .result import ErrorBound, QuadraticProof
from .together import Together

__all__ = [
    "Certificate",
    "ErrorBound",
    "FixedPoint",
    "QuadraticProof",
    "Together",
    "error_bound",
    "fixed_point",
]
