"""Robots: files that say what the signals of a log are, and turn it into a recording of M x' = g + f."""

from .._renamed import former
from .checking import RobotCheck
from .document import RobotSignal, presets
from .findings import Finding, Suspicion
from .robot import Robot
from .writing import describe_log

__all__ = [
    "Finding",
    "Robot",
    "RobotCheck",
    "RobotSignal",
    "Suspicion",
    "describe_log",
    "presets",
]


def __getattr__(name: str) -> object:
    return former(__name__, name)
