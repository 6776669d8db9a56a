"""The differentiators by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from .difference import BackwardDifference
from .kalman import KalmanDifferentiator
from .lowpass import LowpassDifference
from .protocol import TunableDifferentiator
from .robust import RobustDifferentiator
from .tracking import TrackingDifferentiator

__all__ = ["BASELINES"]

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
