"""From recordings to an answer: the force that the model missed, how sure that is, and which filter shows it.

``estimate`` is the front. ``spectrum`` shows where the model misses something, ``levels`` tells it from the noise,
``noise`` is for noise that is known from elsewhere, ``suggestion`` finds the filter of least expected error without
labels, ``prediction`` tests it, ``model_value`` says what the learned model is worth beside it, ``comparison`` puts
other people's estimators beside it, ``smoothing`` makes a label from both sides,
``separation`` tells payload, wind and model error apart, or says that they cannot be.
"""

from .comparison import EstimatorComparison, compare_estimators
from .estimate import Estimate, estimate
from .model_value import ModelValue, model_value
from .noise import known_noise, measurement_noise
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
    detect_changes,
    separate,
)
from .smoothing import SmoothedLabel, smooth_label
from .spectrum import NoiseLevel, ResidualSpectrum
from .suggestion import Suggestion

__all__ = [
    "AddedInertia",
    "Changes",
    "ColouredForce",
    "Combination",
    "Estimate",
    "EstimatorComparison",
    "Identifiability",
    "ModelScale",
    "ModelValue",
    "NoiseLevel",
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
    "compare_estimators",
    "detect_changes",
    "estimate",
    "known_noise",
    "measurement_noise",
    "model_value",
    "separate",
    "smooth_label",
]
