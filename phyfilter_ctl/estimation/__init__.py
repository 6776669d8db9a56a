"""From recordings to an answer: the force that the model missed, how sure that is, and which filter shows it.

``estimate`` is the front. ``spectrum`` shows where the model misses something, ``levels`` tells it from the noise,
``noise`` has what is known of it from elsewhere, ``suggestion`` finds the filter of least expected error without
labels, ``prediction`` tests it, ``model_value`` says what the learned model is worth, ``smoothing``
makes a label from both sides,
``separation`` tells payload, wind and model error apart, or says that they cannot be.
"""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .estimate import Estimate, estimate
from .model_value import ModelValue, model_value
from .noise import Noise
from .prediction import Prediction
from .separation import (
    AddedInertia,
    Changes,
    ColouredForce,
    Combination,
    Identifiability,
    ModelScale,
    Part,
    PartEstimate,
    PartialSum,
    Payload,
    Regressor,
    SensorBias,
    Separation,
    SteadyForce,
    separate,
)
from .smoothing import SmoothedLabel, smooth_label
from .spectrum import ResidualSpectrum
from .suggestion import Suggestion

__all__ = [
    "AddedInertia",
    "Changes",
    "ColouredForce",
    "Combination",
    "Estimate",
    "Identifiability",
    "ModelScale",
    "ModelValue",
    "Noise",
    "Part",
    "PartEstimate",
    "PartialSum",
    "Payload",
    "Prediction",
    "Regressor",
    "ResidualSpectrum",
    "SensorBias",
    "Separation",
    "SmoothedLabel",
    "SteadyForce",
    "Suggestion",
    "estimate",
    "model_value",
    "separate",
    "smooth_label",
]

if not TYPE_CHECKING:
    __getattr__ = partial(former, __name__)
