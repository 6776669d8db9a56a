"""Logs of robots as they come: PX4, ArduPilot, ROS, Crazyflie and tables; topics on their own clocks, units, gaps."""

from .clock import Clock
from .contents import Dropout
from .logfile import Field, LogFile, Signal, Topic, open_log
from .recordings import read_recording
from .suggestions import Suggestion, suggestions

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
    "suggestions",
]
