"""From recordings to an answer: the force that the model missed, how sure that is, and which filter shows it.

``estimate`` is the front. ``spectrum`` measures the noise and where the model misses something, ``suggestion`` finds
the filter of least expected error without labels, ``prediction`` tests it, ``comparison`` puts other people's
estimators beside it, ``smoothing`` makes a label from both sides.
"""

from .comparison import EstimatorComparison, compare_estimators
from .estimate import Estimate, estimate
from .prediction import Prediction
from .smoothing import SmoothedLabel, smooth_label
from .spectrum import NoiseLevel, ResidualSpectrum
from .suggestion import Suggestion

__all__ = [
    "Estimate",
    "EstimatorComparison",
    "NoiseLevel",
    "Prediction",
    "ResidualSpectrum",
    "SmoothedLabel",
    "Suggestion",
    "compare_estimators",
    "estimate",
    "smooth_label",
]
