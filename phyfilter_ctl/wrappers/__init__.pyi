from .feedforward import FeedForward, LoopModel
from .ros2 import ForceEstimator, Stamped, force_node
from .simulators import control_callback, mujoco_model

__all__ = [
    "FeedForward",
    "ForceEstimator",
    "LoopModel",
    "Stamped",
    "control_callback",
    "force_node",
    "mujoco_model",
]
