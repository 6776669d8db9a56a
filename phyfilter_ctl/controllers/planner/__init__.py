"""Cooperative planner of an aerial manipulator: platform and arm share the way of the end effector to its target."""

from .following import Attitude, PathSample, PlannedPath, follow
from .planner import CooperativePlanner, Plan
from .problem import RotationPrediction
from .settings import PlannerLimits, PlannerWeights
from .solver import SolverName

__all__ = [
    "Attitude",
    "CooperativePlanner",
    "PathSample",
    "Plan",
    "PlannedPath",
    "PlannerLimits",
    "PlannerWeights",
    "RotationPrediction",
    "SolverName",
    "follow",
]
