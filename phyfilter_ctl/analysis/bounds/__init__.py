"""What a filter promises: ultimate bounds."""

from .kernels import Certificate
from .ultimate import BoundResult, QuadraticProof, ultimate_bound

__all__ = ["BoundResult", "Certificate", "QuadraticProof", "ultimate_bound"]
