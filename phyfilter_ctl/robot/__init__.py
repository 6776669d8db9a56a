"""Robots: files that say what the signals of a log are, and turn it into a recording of M x' = g + f."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .document import RobotSignal, presets
from .robot import Robot
from .writing import describe_log

__all__ = [
    "Robot",
    "RobotSignal",
    "describe_log",
    "presets",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
