"""Limits and weights of the cooperative planner, checked before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray

__all__ = ["AXES", "PlannerLimits", "PlannerWeights", "vector"]

AXES = ("platform x", "platform y", "platform z", "arm x", "arm y", "arm z")

# An eigenvalue this far below zero, in parts of the largest, is rounding of a matrix that was meant to be semidefinite.
_SEMIDEFINITE = 1e-12


def vector(name: str, value: ArrayLike, shape: tuple[int, ...], *, finite: bool = True) -> FloatArray:
    """A read-only copy, broadcast to a shape; TypeError or ValueError if it is not numbers of that shape."""
    array = _signals.filled(name, value, shape, finite=finite)
    if np.isnan(array).any():
        raise ValueError(f"{name}: expected numbers, or infinity for no limit, got {array.tolist()}")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, init=False, eq=False)
class PlannerLimits:
    """Limits of position, velocity and acceleration on the six planned axes.

    They are boxes, which keeps the axes apart: platform x, y, z in the world (z up), then the end effector
    relative to the arm's base, in body axes.

    Parameters
    ----------
    platform : array_like, shape (2, 3)
        Lower and upper corner of the box that the platform's centre of mass stays in, m, world. May be infinite.
    workspace : array_like, shape (2, 3)
        Lower and upper corner of the box that the end effector stays in, m, from the arm's base in body axes.
    platform_velocity, arm_velocity : float or array_like, shape (3,)
        Largest speed along each axis, m/s.
    platform_acceleration, arm_acceleration : float or array_like, shape (3,)
        Largest acceleration along each axis, m/s^2.

    Attributes
    ----------
    lower, upper : (6,) read-only arrays
        Positions, m; platform, then arm.
    velocity, acceleration : (6,) read-only arrays
        m/s and m/s^2.

    Raises
    ------
    ValueError
        If a lower limit lies above its upper one, a velocity or acceleration is not positive, or a number is not
        finite.

    Examples
    --------
    >>> limits = PlannerLimits([[-3, -3, 0.3], [3, 3, 2.5]], [[0.2, -0.15, -0.3], [0.4, 0.15, -0.1]])
    >>> limits.upper.tolist()
    [3.0, 3.0, 2.5, 0.4, 0.15, -0.1]
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def __init__(
        self,
        platform: ArrayLike,
        workspace: ArrayLike,
        *,
        platform_velocity: ArrayLike = 1.5,
        arm_velocity: ArrayLike = 0.6,
        platform_acceleration: ArrayLike = 2.0,
        arm_acceleration: ArrayLike = 3.0,
    ) -> None:
        boxes = np.hstack(
            [vector("platform", platform, (2, 3), finite=False), vector("workspace", workspace, (2, 3))]
        )
        for name, low, high in zip(AXES, *boxes, strict=True):
            if not low <= high or low == np.inf or high == -np.inf:
                raise ValueError(
                    f"{name}: lower limit {low:g} m, upper limit {high:g} m contradict: expected lower <= upper; "
                    "give the box as [lower corner, upper corner]"
                )
        values = {"lower": boxes[0], "upper": boxes[1]}
        for name, pair in (
            ("velocity", (platform_velocity, arm_velocity)),
            ("acceleration", (platform_acceleration, arm_acceleration)),
        ):
            parts = [
                vector(f"{who}_{name}", value, (3,))
                for who, value in zip(("platform", "arm"), pair, strict=True)
            ]
            values[name] = np.concatenate(parts)
            for axis, value in zip(AXES, values[name], strict=True):
                if not value > 0.0:
                    raise ValueError(
                        f"{axis}: expected a largest {name} > 0, got {value:g}; to hold an axis still make its lower "
                        "and upper position limits equal"
                    )
        for name, value in values.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)


@dataclass(frozen=True, init=False, eq=False)
class PlannerWeights:
    """Weights of the planner's costs, the same at every step of the horizon.

    Parameters
    ----------
    tracking : array_like, shape (3,) or (3, 3)
        Lambda_1, of the end effector's error in the world, 1/m^2. Positive definite.
    smoothness : array_like, shape (6,) or (6, 6)
        Lambda_2, of the increments of the six accelerations, s^4/m^2. Positive definite: it is what makes the plan
        unique, platform and arm being redundant.
    platform_increment : array_like, shape (3,) or (3, 3)
        Lambda_3^u, of the platform's move per step, 1/m^2. Positive semidefinite.
    arm_increment : array_like, shape (3,) or (3, 3)
        Lambda_3^m, of the end effector's move per step relative to the arm's base, 1/m^2. Positive semidefinite.

    Attributes
    ----------
    tracking : (3, 3) read-only array
    smoothness : (6, 6) read-only array
    increment : (6, 6) read-only array
        Lambda_3^u and Lambda_3^m as blocks.

    Raises
    ------
    ValueError
        If a matrix is not symmetric or not positive (semi)definite.

    Notes
    -----
    The defaults are the paper's (its supplement "Trajectory generation of aerial manipulator").

    Examples
    --------
    >>> PlannerWeights().tracking.diagonal().tolist()
    [6000.0, 6000.0, 9000.0]
    """

    tracking: FloatArray
    smoothness: FloatArray
    increment: FloatArray

    def __init__(
        self,
        tracking: ArrayLike = (6000.0, 6000.0, 9000.0),
        smoothness: ArrayLike = (700.0, 700.0, 700.0, 1.0, 1.0, 1.0),
        *,
        platform_increment: ArrayLike = (20.0, 20.0, 20.0),
        arm_increment: ArrayLike = (10.0, 10.0, 10.0),
    ) -> None:
        increment = np.zeros((6, 6))
        increment[:3, :3] = _weight("platform_increment", platform_increment, 3, definite=False)
        increment[3:, 3:] = _weight("arm_increment", arm_increment, 3, definite=False)
        for name, value in (
            ("tracking", _weight("tracking", tracking, 3, definite=True)),
            ("smoothness", _weight("smoothness", smoothness, 6, definite=True)),
            ("increment", increment),
        ):
            value.flags.writeable = False
            object.__setattr__(self, name, value)


def _weight(name: str, value: ArrayLike, size: int, *, definite: bool) -> FloatArray:
    """A weight given by its diagonal or whole, as a matrix."""
    given = np.asarray(value)
    whole = given.ndim == 2
    array = vector(name, value, (size, size) if whole else (size,))
    matrix = array.copy() if whole else np.diag(array)
    if not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0.0):
        raise ValueError(f"{name}: expected a symmetric matrix, got {matrix.tolist()}; use (W + W') / 2")
    eigenvalues = np.linalg.eigvalsh(matrix)
    rounding = _SEMIDEFINITE * abs(eigenvalues).max()
    if eigenvalues[0] <= rounding if definite else eigenvalues[0] < -rounding:
        kind = "definite" if definite else "semidefinite"
        raise ValueError(
            f"{name}: expected a positive {kind} weight, got smallest eigenvalue {eigenvalues[0]:g}; "
            f"make its diagonal {'> 0' if definite else '>= 0'}"
        )
    return matrix
