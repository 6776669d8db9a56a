"""Controllers of the vehicles in ``plants``: tracking laws as sampled blocks, the aerial manipulator's
planner, and the filter of legged robots' joint torques."""

from .allocation import allocate
from .arm import arm_controller
from .attitude import AttitudeGains, attitude_error, attitude_gains
from .indi import indi
from .joint_torque import JointFilterState, JointTorqueFilter
from .known_force import KnownForce, known_force
from .known_torque import known_torque
from .l1_adaptive import l1_adaptive
from .planner import (
    CooperativePlanner,
    PathSample,
    Plan,
    PlannedPath,
    PlannerLimits,
    PlannerWeights,
    follow,
)
from .tracking import attitude_controller, position_controller

__all__ = [
    "AttitudeGains",
    "CooperativePlanner",
    "JointFilterState",
    "JointTorqueFilter",
    "KnownForce",
    "PathSample",
    "Plan",
    "PlannedPath",
    "PlannerLimits",
    "PlannerWeights",
    "allocate",
    "arm_controller",
    "attitude_controller",
    "attitude_error",
    "attitude_gains",
    "follow",
    "indi",
    "known_force",
    "known_torque",
    "l1_adaptive",
    "position_controller",
]
