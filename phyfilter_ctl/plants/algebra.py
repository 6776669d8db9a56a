"""Vectors, rotations and choices for equations of motion: the same on CasADi columns and on numpy vectors.

Elementwise functions (sin, exp, ...) are numpy's own, which take both. A unit quaternion (w, x, y, z), the scalar part
first, stands for the rotation of vectors from the body frame to the world frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Array",
    "Scalar",
    "cross",
    "dot",
    "norm",
    "quaternion_product",
    "quaternion_rate",
    "rotate",
    "rotate_back",
    "rotation_matrix",
    "skew",
    "solve",
    "stack",
    "where",
]

Array: TypeAlias = ca.SX | NDArray[np.float64]
"""A CasADi expression, or numbers."""
Scalar: TypeAlias = Array | float


def stack(*parts: Scalar) -> Array:
    """Scalars and vectors one after the other, as one vector.

    Parameters
    ----------
    *parts : arrays

    Examples
    --------
    >>> stack(1.0, np.array([2.0, 3.0])).tolist()
    [1.0, 2.0, 3.0]
    """
    if any(isinstance(part, ca.SX) for part in parts):
        return ca.vertcat(*parts)
    return np.concatenate([np.atleast_1d(np.asarray(part, dtype=float)) for part in parts])


def where(condition: Scalar, yes: Scalar, no: Scalar) -> Array:
    """``yes`` where the condition holds, else ``no``; an ``if`` on a state cannot be traced.

    Parameters
    ----------
    condition, yes, no : arrays

    Examples
    --------
    >>> where(np.array([1.0, -1.0]) > 0.0, 5.0, 6.0).tolist()
    [5.0, 6.0]
    """
    if any(isinstance(part, ca.SX) for part in (condition, yes, no)):
        return ca.if_else(condition, yes, no)
    return np.where(condition, yes, no)


def dot(a: Scalar, b: Scalar) -> Array:
    """Inner product of two vectors.

    Parameters
    ----------
    a, b : (n,) arrays

    Examples
    --------
    >>> float(dot(np.array([1.0, 2.0]), np.array([3.0, 4.0])))
    11.0
    """
    return ca.dot(a, b) if _symbolic(a, b) else np.dot(a, b)


def norm(v: Scalar) -> Array:
    """Length of a vector (magnitude of a number), with derivative 0 at 0, where sqrt(v.v) has none.

    So |v| v, the drag of a body at rest, linearises.

    Parameters
    ----------
    v : (n,) array

    Examples
    --------
    >>> float(norm(np.array([3.0, 4.0])))
    5.0
    >>> x = ca.SX.sym("x", 2)
    >>> ca.Function("f", [x], [ca.jacobian(norm(x) * x, x)])([0.0, 0.0]).full().tolist()
    [[0.0, 0.0], [0.0, 0.0]]
    """
    square = dot(v, v)
    if not _symbolic(v):
        return np.sqrt(square)
    moving = square > 0.0
    # sqrt never sees 0, so its derivative there, infinite, is not multiplied by 0.
    return ca.if_else(moving, ca.sqrt(ca.if_else(moving, square, 1.0)), 0.0)


def cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors of three.

    Parameters
    ----------
    a, b : (3,) arrays

    Examples
    --------
    >>> cross(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])).tolist()
    [0.0, 0.0, 1.0]
    """
    return ca.cross(a, b) if _symbolic(a, b) else np.cross(a, b)


def skew(v: Array) -> Array:
    """Matrix S (3, 3) with S b = v x b.

    Parameters
    ----------
    v : (3,) array

    Examples
    --------
    >>> (skew(np.array([1.0, 2.0, 3.0])) @ np.array([1.0, 0.0, 0.0])).tolist()
    [0.0, 3.0, -2.0]
    """
    x, y, z = _three(v)
    return _matrix([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def solve(M: Array, v: Array) -> Array:
    """M^-1 v.

    Parameters
    ----------
    M : (n, n) array
    v : (n,) array

    Examples
    --------
    >>> solve(np.diag([2.0, 4.0]), np.array([2.0, 2.0])).tolist()
    [1.0, 0.5]
    """
    return ca.solve(M, v) if _symbolic(M, v) else np.linalg.solve(np.asarray(M), np.asarray(v))


def quaternion_product(p: Array, q: Array) -> Array:
    """p q: first the rotation q, then p.

    Parameters
    ----------
    p, q : (4,) arrays
        Scalar part first.

    Examples
    --------
    >>> i, j = np.array([0.0, 1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
    >>> quaternion_product(i, j).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    scalar = p[0] * q[0] - dot(p[1:], q[1:])
    return stack(scalar, p[0] * q[1:] + q[0] * p[1:] + cross(p[1:], q[1:]))


def quaternion_rate(q: Array, omega: Array, *, pull: float = 1.0) -> Array:
    """q' = q (0, omega)/2 + pull (1 - |q|^2) q/2 of a body that turns with omega, given in its own frame.

    The second term is zero on unit quaternions and draws others to them, so that integration errors do not grow.

    Parameters
    ----------
    q : (4,) array
    omega : (3,) array
        rad/s, body frame.
    pull : float
        1/s.

    Examples
    --------
    >>> quaternion_rate(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0])).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return 0.5 * (quaternion_product(q, stack(0.0, omega)) + pull * (1.0 - dot(q, q)) * q)


def rotate(q: Array, v: Array) -> Array:
    """A vector of the body frame in the world frame: v + 2 q_v x (q_v x v + q_0 v).

    Parameters
    ----------
    q : (4,) array
        Unit quaternion.
    v : (3,) array

    Examples
    --------
    >>> quarter = np.sqrt(0.5) * np.array([1.0, 0.0, 0.0, 1.0])
    >>> np.allclose(rotate(quarter, np.array([1.0, 0.0, 0.0])), [0.0, 1.0, 0.0])
    True
    """
    axis = q[1:]
    return v + 2.0 * cross(axis, cross(axis, v) + q[0] * v)


def rotate_back(q: Array, v: Array) -> Array:
    """A vector of the world frame in the body frame.

    Parameters
    ----------
    q : (4,) array
        Unit quaternion.
    v : (3,) array

    Examples
    --------
    >>> quarter = np.sqrt(0.5) * np.array([1.0, 0.0, 0.0, 1.0])
    >>> np.allclose(rotate_back(quarter, np.array([0.0, 1.0, 0.0])), [1.0, 0.0, 0.0])
    True
    """
    axis = q[1:]
    return v + 2.0 * cross(axis, cross(axis, v) - q[0] * v)


def rotation_matrix(q: Array) -> Array:
    """R (3, 3) with R v = rotate(q, v).

    Parameters
    ----------
    q : (4,) array
        Unit quaternion.

    Examples
    --------
    >>> rotation_matrix(np.array([0.0, 1.0, 0.0, 0.0])).round(12).diagonal().tolist()
    [1.0, -1.0, -1.0]
    """
    w = q[0]
    x, y, z = _three(q[1:])
    return _matrix(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def _symbolic(*values: Scalar) -> bool:
    return any(isinstance(value, ca.SX) for value in values)


def _three(v: Array) -> tuple[Array, Array, Array]:
    return v[0], v[1], v[2]


def _matrix(rows: Sequence[Sequence[Scalar]]) -> Array:
    if _symbolic(*[entry for row in rows for entry in row]):
        return ca.vertcat(*[ca.horzcat(*row) for row in rows])
    return np.array(rows, dtype=float)
