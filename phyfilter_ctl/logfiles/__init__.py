"""Logs of robots as they come: PX4, ArduPilot, ROS, Crazyflie and tables; topics on their own clocks, units, gaps."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .clock import Clock
from .contents import Dropout
from .logfile import Field, LogFile, Signal, Topic, open_log
from .recordings import read_recording
from .suggesting import Suggestion

__all__ = [
    "Clock",
    "Dropout",
    "Field",
    "LogFile",
    "Signal",
    "Suggestion",
    "Topic",
    "open_log",
    "read_recording",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
