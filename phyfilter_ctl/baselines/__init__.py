"""What one would use where there is no PhyFilter: causal differentiators of sampled velocity, and observers.

``BASELINES`` names the differentiators; ``tune`` sets the parameters of one on flights whose acceleration is known.
The observers are special cases of the filter, and run by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from .difference import BackwardDifference
from .kalman import KalmanDifferentiator
from .lowpass import LowpassDifference
from .observers import (
    DisturbanceObserver,
    Evolver,
    FeedbackNeuralNetwork,
    LinearESO,
    MomentumObserver,
    SeerII,
)
from .protocol import Differentiator, SearchRange, TunableDifferentiator
from .robust import RobustDifferentiator
from .tracking import TrackingDifferentiator
from .tuning import TuneResult, tune

__all__ = [
    "BASELINES",
    "BackwardDifference",
    "Differentiator",
    "DisturbanceObserver",
    "Evolver",
    "FeedbackNeuralNetwork",
    "KalmanDifferentiator",
    "LinearESO",
    "LowpassDifference",
    "MomentumObserver",
    "RobustDifferentiator",
    "SearchRange",
    "SeerII",
    "TrackingDifferentiator",
    "TunableDifferentiator",
    "TuneResult",
    "tune",
]

BASELINES: Final[Mapping[str, type[TunableDifferentiator]]] = MappingProxyType(
    {
        "difference": BackwardDifference,
        "tracking_differentiator": TrackingDifferentiator,
        "robust_differentiator": RobustDifferentiator,
        "kalman": KalmanDifferentiator,
        "lowpass": LowpassDifference,
    }
)
"""The differentiators by name."""
