"""Plants: equations of motion, written once, as python-control systems."""

from functools import partial
from typing import TYPE_CHECKING

from .._renamed import former
from .aerial_manipulator import aerial_manipulator
from .algebra import (
    cross,
    dot,
    norm,
    rotate,
    rotate_back,
    skew,
    solve,
    stack,
    where,
)
from .arm_motion import ArmMotion
from .arm_parts import Link
from .bodies import mass, rigid_body
from .coupling import coupling_force, coupling_torque
from .declaration import Columns
from .factory import Plant, plant
from .legged import JointQuantities, JointSpacePrior, LeggedRobot, load_robot
from .quadrotor import allocation_matrix, quadrotor
from .sensors import Sensor, sensors
from .serial_arm import SerialArm
from .small_arm import small_arm
from .trajectories import circle, lemniscate, trajectory, waypoints
from .wind import wind_field

__all__ = [
    "ArmMotion",
    "Columns",
    "JointQuantities",
    "JointSpacePrior",
    "LeggedRobot",
    "Link",
    "Plant",
    "Sensor",
    "SerialArm",
    "aerial_manipulator",
    "allocation_matrix",
    "circle",
    "coupling_force",
    "coupling_torque",
    "cross",
    "dot",
    "lemniscate",
    "load_robot",
    "mass",
    "norm",
    "plant",
    "quadrotor",
    "rigid_body",
    "rotate",
    "rotate_back",
    "sensors",
    "skew",
    "small_arm",
    "solve",
    "stack",
    "trajectory",
    "waypoints",
    "where",
    "wind_field",
]

if not TYPE_CHECKING:  # which is to see a wrong name
    __getattr__ = partial(former, __name__)
