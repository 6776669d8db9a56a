"""Robots: files that say what the signals of a log are, and turn it into a recording of M x' = g + f."""

from .checking import RobotCheck
from .document import RobotSignal, presets
from .findings import Finding, Suspicion, findings_of
from .robot import Robot
from .writing import describe_log

__all__ = [
    "Finding",
    "Robot",
    "RobotCheck",
    "RobotSignal",
    "Suspicion",
    "describe_log",
    "findings_of",
    "presets",
]
