"""Plants: equations of motion, written once, as python-control systems."""

from .aerial_manipulator import aerial_manipulator
from .algebra import (
    cross,
    dot,
    norm,
    quaternion_product,
    quaternion_rate,
    rotate,
    rotate_back,
    rotation_matrix,
    skew,
    solve,
    stack,
    where,
)
from .arm_motion import ArmMotion
from .arm_parts import Link
from .bodies import mass, rigid_body
from .coupling import (
    Accelerations,
    coupled_accelerations,
    coupling_force,
    coupling_torque,
    payload_motion,
)
from .declaration import Columns
from .factory import Plant, plant
from .legged import JointQuantities, JointSpacePrior, LeggedRobot, load_robot
from .quadrotor import allocation_matrix, quadrotor
from .sensors import Sensor, sensors
from .serial_arm import SerialArm
from .small_arm import small_arm
from .wind import wind_field

__all__ = [
    "Accelerations",
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
    "coupled_accelerations",
    "coupling_force",
    "coupling_torque",
    "cross",
    "dot",
    "load_robot",
    "mass",
    "norm",
    "payload_motion",
    "plant",
    "quadrotor",
    "quaternion_product",
    "quaternion_rate",
    "rigid_body",
    "rotate",
    "rotate_back",
    "rotation_matrix",
    "sensors",
    "skew",
    "small_arm",
    "solve",
    "stack",
    "where",
    "wind_field",
]
