"""Joint-space residual models of legged robots, M q'' = g + f, and the filter that estimates the residual torque f.

``prior`` says which part of M and g the filter is told, ``filter`` estimates f for any number of robots at once, and
``simulator`` fills the quantities from MuJoCo. Only numpy is needed until ``simulator`` is given a MuJoCo model.
"""

from .filter import JointFilterState, JointTorqueFilter
from .prior import JointQuantities, JointSpacePrior, balanced_contact
from .simulator import quantities

__all__ = [
    "JointFilterState",
    "JointQuantities",
    "JointSpacePrior",
    "JointTorqueFilter",
    "balanced_contact",
    "quantities",
]
