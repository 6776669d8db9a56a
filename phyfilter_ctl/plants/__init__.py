"""Plants: equations of motion, written once, as python-control systems."""

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
from .bodies import mass, rigid_body
from .declaration import Columns
from .factory import Plant, plant

__all__ = [
    "Columns",
    "Plant",
    "cross",
    "dot",
    "mass",
    "norm",
    "plant",
    "quaternion_product",
    "quaternion_rate",
    "rigid_body",
    "rotate",
    "rotate_back",
    "rotation_matrix",
    "skew",
    "solve",
    "stack",
    "where",
]
