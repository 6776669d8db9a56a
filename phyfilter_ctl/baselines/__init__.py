"""Causal differentiators of sampled velocity: what one would use where there is no PhyFilter.

``BASELINES`` names them; ``tune`` sets the parameters of one on flights whose acceleration is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from ._protocol import Differentiator, SearchRange, TunableDifferentiator
from .difference import BackwardDifference
from .kalman import KalmanDifferentiator
from .lowpass import LowpassDifference
from .robust import RobustDifferentiator
from .tracking import TrackingDifferentiator
from .tuning import TuneResult, tune

__all__ = [
    "BASELINES",
    "BackwardDifference",
    "Differentiator",
    "KalmanDifferentiator",
    "LowpassDifference",
    "RobustDifferentiator",
    "SearchRange",
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
