"""What the residual is made of: payload, wind, drag, a model's scale, each with its uncertainty, or only their sum."""

from .changes import Changes
from .found import PartEstimate, PartialSum, Separation
from .identifiability import Combination, Identifiability
from .parts import (
    AddedInertia,
    ColouredForce,
    ModelScale,
    Part,
    Payload,
    Regressor,
    SensorBias,
    SteadyForce,
)
from .separate import separate

__all__ = [
    "AddedInertia",
    "Changes",
    "ColouredForce",
    "Combination",
    "Identifiability",
    "ModelScale",
    "Part",
    "PartEstimate",
    "PartialSum",
    "Payload",
    "Regressor",
    "SensorBias",
    "Separation",
    "SteadyForce",
    "separate",
]
