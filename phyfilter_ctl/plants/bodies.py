"""Plants that ship with the toolbox: a point mass and a rigid body."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .algebra import Array, cross, norm, quaternion_rate, rotate, solve
from .declaration import Columns
from .factory import Plant, Results, plant

__all__ = ["mass", "rigid_body"]


def mass(axes: int = 3, *, mass: float = 1.0, drag: float = 0.0, name: str = "mass") -> Plant:
    """A point mass that a force moves against quadratic drag.

        r' = v,    m v' = force - c |v| v

    Parameters
    ----------
    axes : int
        Number of axes, 1 to 3 as a rule.
    mass : float
        m in kg.
    drag : float
        c in kg/m.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Input force, outputs r and v, each of ``axes`` entries; parameters mass and drag.

    Raises
    ------
    ValueError
        For fewer axes than one, a mass that is not positive, or a negative drag.

    Examples
    --------
    Terminal speed sqrt(force/c):

    >>> import control as ct
    >>> fall = ct.input_output_response(mass(1, drag=0.5), np.linspace(0.0, 10.0), 8.0)
    >>> fall.outputs[1, -1].round(2).item()
    4.0
    """
    if axes < 1:
        raise ValueError(f"axes: expected at least 1, got {axes}")
    _check_positive("mass", mass)
    if not (np.isfinite(drag) and drag >= 0.0):
        raise ValueError(f"drag: expected 0 kg/m or more, got {drag}")

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> Results:
        return {"r": x.v, "v": (u.force - p.drag * norm(x.v) * x.v) / p.mass}

    zero = np.zeros(axes)
    return plant(
        equations,
        name=name,
        states={"r": (zero, "m", "position"), "v": (zero, "m/s", "velocity")},
        inputs={"force": (zero, "N", "force")},
        params={"mass": (mass, "kg", "mass"), "drag": (drag, "kg/m", "quadratic drag")},
    )


def rigid_body(
    *,
    mass: float = 1.0,
    J: ArrayLike = (1.0, 1.0, 1.0),
    gravity: float = 0.0,
    name: str = "body",
) -> Plant:
    """A rigid body that a force and a torque move, both given in its own frame.

        r' = v,                              m v' = q force q* - m gravity e_z
        q' = q (0, omega)/2,                 J omega' = torque - omega x J omega

    Parameters
    ----------
    mass : float
        m in kg.
    J : (3,) or (3, 3) array
        Moments of inertia about the body's axes, or the whole matrix, about the centre of mass, in kg m^2.
    gravity : float
        m/s^2, against the z axis of the world.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Inputs force (N) and torque (N m), in the body frame; outputs r (m) and v (m/s) in the world frame, the unit
        quaternion q (w, x, y, z) from the body to the world frame, and omega (rad/s) in the body frame. Parameters
        mass, J and gravity.

    Raises
    ------
    ValueError
        For a mass that is not positive, or J that is not symmetric and positive definite.

    Notes
    -----
    Newton-Euler equations. The term (1 - |q|^2) q/2 in q' holds q at unit length against integration errors; it is zero
    on unit quaternions.

    Examples
    --------
    >>> body = rigid_body(mass=2.0, gravity=9.81)
    >>> body.dynamics(0.0, body.start_state, [0.0, 0.0, 2.0, 0.0, 0.0, 0.0])[3:6].round(12).tolist()
    [0.0, 0.0, -8.81]
    """
    _check_positive("mass", mass)
    inertia = _signals.real("J", J)
    inertia = np.diag(inertia) if inertia.shape == (3,) else inertia
    good = inertia.shape == (3, 3) and np.allclose(inertia, inertia.T, rtol=1e-9, atol=0.0)
    if not good or not np.isfinite(inertia).all() or np.linalg.eigvalsh(inertia)[0] <= 0.0:
        raise ValueError(
            f"J: expected three positive moments of inertia, or a symmetric positive definite (3, 3) matrix, got {J!r}"
        )

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> Results:
        down = np.array([0.0, 0.0, 1.0]) * p.gravity
        return {
            "r": x.v,
            "v": rotate(x.q, u.force) / p.mass - down,
            "q": quaternion_rate(x.q, x.omega),
            "omega": solve(p.J, u.torque - cross(x.omega, p.J @ x.omega)),
        }

    zero = np.zeros(3)
    return plant(
        equations,
        name=name,
        states={
            "r": (zero, "m", "position, world"),
            "v": (zero, "m/s", "velocity, world"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "omega": (zero, "rad/s", "angular velocity, body"),
        },
        inputs={"force": (zero, "N", "force, body"), "torque": (zero, "N m", "torque, body")},
        params={
            "mass": (mass, "kg", "mass"),
            "J": (inertia, "kg m^2", "moments of inertia"),
            "gravity": (gravity, "m/s^2", "gravity, against z"),
        },
    )


def _check_positive(name: str, value: float) -> None:
    _signals.number(name, value, above=0.0)
