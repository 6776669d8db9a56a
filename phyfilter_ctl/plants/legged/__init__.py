"""Joint-space residual models of legged robots, M q'' = g + f.

``load_robot`` takes anybody's MJCF or URDF. ``prior`` says which part of M and g is known
(``controllers.JointTorqueFilter`` estimates f from it), ``simulator`` fills the quantities from MuJoCo, and
``renderer`` draws a robot off screen. Only numpy is needed until these are given a MuJoCo model.
"""

from .prior import Contact, JointQuantities, JointSpacePrior, balanced_contact
from .rendering import Camera, Draw, renderer
from .robot import LeggedRobot, load_robot
from .simulator import quantities

__all__ = [
    "Camera",
    "Contact",
    "Draw",
    "JointQuantities",
    "JointSpacePrior",
    "LeggedRobot",
    "balanced_contact",
    "load_robot",
    "quantities",
    "renderer",
]
