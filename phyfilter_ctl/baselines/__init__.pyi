# What the package offers, and where it lives: read by type checkers, and at run time by `__init__.py`.

from .difference import BackwardDifference
from .differentiator_tuning import TuneResult, tune
from .estimator_comparison import EstimatorComparison, compare
from .kalman import KalmanDifferentiator
from .kinds import BASELINES
from .lowpass import LowpassDifference
from .observers import (
    DisturbanceObserver,
    Evolver,
    FeedbackNeuralNetwork,
    LinearESO,
    MomentumObserver,
    SeerII,
)
from .protocol import SearchRange, TunableDifferentiator
from .robust import RobustDifferentiator
from .tracking import TrackingDifferentiator

__all__ = [
    "BASELINES",
    "BackwardDifference",
    "DisturbanceObserver",
    "EstimatorComparison",
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
    "compare",
    "tune",
]
