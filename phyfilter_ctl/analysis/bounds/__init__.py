"""What a filter promises: ultimate bounds."""

from .implementation import Implementation
from .kernels import Certificate
from .result import BoundResult, QuadraticProof
from .together import Together
from .ultimate import ultimate_bound

__all__ = ["BoundResult", "Certificate", "Implementation", "QuadraticProof", "Together", "ultimate_bound"]
