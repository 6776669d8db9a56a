"""Controllers of the vehicles in ``plants``: tracking laws as sampled blocks, the aerial manipulator's
planner, and the filter of legged robots' joint torques."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .arm import arm_controller
from .attitude import AttitudeGains
from .indi import indi
from .joint_torque import JointFilterState, JointTorqueFilter
from .l1_adaptive import l1_adaptive
from .multirotor import Multirotor
from .planner import (
    CooperativePlanner,
    PathSample,
    Plan,
    PlannedPath,
    PlannerLimits,
    PlannerWeights,
    follow,
)
from .tracking import Vehicle, attitude_controller

__all__ = [
    "AttitudeGains",
    "CooperativePlanner",
    "JointFilterState",
    "JointTorqueFilter",
    "Multirotor",
    "PathSample",
    "Plan",
    "PlannedPath",
    "PlannerLimits",
    "PlannerWeights",
    "Vehicle",
    "arm_controller",
    "attitude_controller",
    "follow",
    "indi",
    "l1_adaptive",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
