"""What a serial arm is made of, and checks of what it is given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .algebra import Array

__all__ = ["Link", "Vector", "column", "freeze", "like", "numbers"]

Vector: TypeAlias = ca.SX | ArrayLike
"""A CasADi column, or anything numpy makes a vector of."""

# Rounding of typed inertias, relative.
_TYPED = 1e-9


@dataclass(frozen=True, init=False, eq=False)
class Link:
    """One revolute joint and the rigid link that it moves.

    Vectors are in the link's own frame: its origin is the joint, and at joint angle 0 its axes are those of the link
    before.

    Parameters
    ----------
    axis : (3,) array
        Direction of the joint's axis; made a unit vector.
    offset : (3,) array
        From this joint to the next one, of the last link to the end effector, in m.
    mass : float
        kg.
    centre : (3,) array
        Centre of mass, in m.
    inertia : (3,) or (3, 3) array
        Moments of inertia about the centre of mass, or the whole matrix, in kg m^2.
    lower, upper : float
        Limits of the joint angle in rad.
    rate_limit : float
        Largest joint rate in rad/s.

    Raises
    ------
    ValueError
        For shapes, an axis of length 0, a mass that is not positive, an inertia that no rigid body has, or limits that
        contradict each other.

    Examples
    --------
    >>> Link((0.0, 2.0, 0.0), (0.2, 0.0, 0.0), 0.1, (0.1, 0.0, 0.0), (1e-5, 4e-4, 4e-4)).axis.tolist()
    [0.0, 1.0, 0.0]
    """

    axis: FloatArray
    offset: FloatArray
    mass: float
    centre: FloatArray
    inertia: FloatArray
    lower: float
    upper: float
    rate_limit: float

    def __init__(
        self,
        axis: ArrayLike,
        offset: ArrayLike,
        mass: float,
        centre: ArrayLike,
        inertia: ArrayLike,
        *,
        lower: float = -np.pi,
        upper: float = np.pi,
        rate_limit: float = 6.0,
    ) -> None:
        direction = numbers("axis", axis, (3,))
        length = float(np.linalg.norm(direction))
        if not length > 0.0:
            raise ValueError("axis: expected a direction, got a vector of length 0")
        _signals.number("mass", mass, "kg", above=0.0)
        if not (np.isfinite([lower, upper]).all() and lower < upper):
            raise ValueError(f"lower, upper: expected lower < upper in rad, got {lower} and {upper}")
        _signals.number("rate_limit", rate_limit, "rad/s", above=0.0)
        fields = {
            "axis": direction / length,
            "offset": numbers("offset", offset, (3,)),
            "mass": float(mass),
            "centre": numbers("centre", centre, (3,)),
            "inertia": _inertia(inertia),
            "lower": float(lower),
            "upper": float(upper),
            "rate_limit": float(rate_limit),
        }
        freeze(self, fields)


def like(value: Array, constant: ArrayLike) -> Array:
    """A constant as what ``value`` is: numpy's operators on CasADi's types change with CasADi's version."""
    array = np.asarray(constant, dtype=float)
    return ca.SX(array) if isinstance(value, ca.SX) else array


def column(name: str, value: Vector, count: int) -> Array:
    """A column of so many entries, or an error that names it."""
    if isinstance(value, ca.SX):
        if value.shape != (count, 1):
            raise ValueError(f"{name}: expected a column of {count}, got shape {value.shape}")
        return value
    return numbers(name, value, (count,))


def numbers(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """A new array of finite numbers, or an error that names it."""
    return _signals.array(name, value, shape)


def _inertia(value: ArrayLike) -> FloatArray:
    matrix = _signals.real("inertia", value)
    matrix = np.diag(matrix) if matrix.shape == (3,) else matrix
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise ValueError(f"inertia: expected three moments or a (3, 3) matrix in kg m^2, got {value!r}")
    moments = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    if np.abs(matrix - matrix.T).max() > _TYPED * np.abs(matrix).max() or moments[0] <= 0.0:
        raise ValueError(f"inertia: expected symmetric and positive definite, got {matrix.tolist()}")
    if moments[2] > (moments[0] + moments[1]) * (1.0 + _TYPED):
        raise ValueError(
            f"inertia: no rigid body has the principal moments {moments.tolist()} kg m^2: expected the largest to be "
            "at most the sum of the others"
        )
    return matrix


def freeze(thing: object, fields: dict[str, object]) -> None:
    """Fields of a frozen dataclass, arrays read-only."""
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(thing, name, value)
