"""A multirotor with four rotors, or four coaxial pairs, in an X: six degrees of freedom, motor lag, rotor drag."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _signals
from .algebra import Array, cross, quaternion_rate, rotate, rotate_back, stack
from .declaration import Columns
from .factory import Plant, Results, plant

__all__ = ["allocation_matrix", "quadrotor"]

# Rotors counter-clockwise from the front left; x forward, y left, z up. Rows: T, tau_x = y F, tau_y = -x F, tau_z.
_SIGNS = np.array(
    [
        [1.0, 1.0, 1.0, 1.0],
        [1.0, 1.0, -1.0, -1.0],
        [-1.0, 1.0, 1.0, -1.0],
        [1.0, -1.0, 1.0, -1.0],
    ]
)


def allocation_matrix(arm: float, torque_ratio: float) -> NDArray[np.float64]:
    """Total thrust and torque from the thrusts of the four rotors: (T, tau_x, tau_y, tau_z) = A rotor.

    With d = arm/sqrt(2), body axes x forward, y left, z up along the thrust:

        T     =              F_0 + F_1 + F_2 + F_3
        tau_x = d            (F_0 + F_1 - F_2 - F_3)
        tau_y = d            (-F_0 + F_1 + F_2 - F_3)
        tau_z = torque_ratio (F_0 - F_1 + F_2 - F_3)

    Parameters
    ----------
    arm : float
        Distance of each rotor from the centre of mass in m.
    torque_ratio : float
        Yaw torque per thrust in m.

    Returns
    -------
    (4, 4) array
        A; its inverse gives the thrusts for a wanted T (N) and tau (N m).

    Raises
    ------
    ValueError
        For an arm or a ratio that is not positive; the matrix would have no inverse.

    Notes
    -----
    X layout: rotor 0 front left, 1 rear left, 2 rear right, 3 front right. Rotors 0 and 2 turn clockwise seen from
    above, so that their reaction turns the body counter-clockwise, about +z.

    Examples
    --------
    More thrust on the left rolls to the right, about +x:

    >>> A = allocation_matrix(0.25, 0.016)
    >>> (A @ [2.0, 2.0, 1.0, 1.0]).round(4).tolist()
    [6.0, 0.3536, 0.0, 0.0]
    >>> np.linalg.solve(A, [8.0, 0.0, 0.0, 0.0]).round(12).tolist()
    [2.0, 2.0, 2.0, 2.0]
    """
    for name, value in (("arm", arm), ("torque_ratio", torque_ratio)):
        _check_positive(name, value, "m")
    return np.array([1.0, arm / np.sqrt(2.0), arm / np.sqrt(2.0), torque_ratio])[:, None] * _SIGNS


def quadrotor(
    *,
    mass: float = 3.0,
    J: ArrayLike = (0.035, 0.035, 0.06),
    arm: float = 0.25,
    torque_ratio: float = 0.016,
    motor_lag: float = 0.04,
    drag: ArrayLike = (0.9, 0.9, 0.9),
    gravity: float = 9.81,
    rotor_max: float = 16.2,
    added_mass: float = 0.0,
    name: str = "quadrotor",
) -> Plant:
    """A multirotor with motor lag and rotor drag, with a mass that the controller does not know, in wind.

        r' = v,       (m + dm) v' = T R e_z - (m + dm) g e_z - R D R' (v - wind)
        q' = q (0, omega)/2,            J omega' = tau - omega x J omega
        rotor' = (clip(thrust, 0, rotor_max) - rotor)/motor_lag,      (T, tau) = A rotor

    with R = R(q), D = diag(drag) and A of :func:`allocation_matrix`. Written with the nominal mass m, as a controller
    knows the plant:

        m v' = T R e_z - m g e_z - R D R' v + f_mass + f_wind
        f_mass = -dm (v' + g e_z),      f_wind = R D R' wind

    Parameters
    ----------
    mass : float
        Nominal mass m in kg.
    J : (3,) array
        Moments of inertia about the body's axes in kg m^2.
    arm : float
        Distance of each rotor from the centre of mass in m.
    torque_ratio : float
        Yaw torque per thrust in m.
    motor_lag : float
        Time constant of the rotors' thrust in s.
    drag : (3,) array
        Rotor drag D along the body's axes in N s/m.
    gravity : float
        g in m/s^2, against the z axis of the world.
    rotor_max : float
        Largest thrust of each rotor in N.
    added_mass : float
        Difference dm of the true mass from the nominal one in kg.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Inputs thrust[i] (N, commanded to each rotor) and wind[i] (m/s, world). Outputs r (m), v (m/s) in the world
        frame, the unit quaternion q (w, x, y, z) from the body to the world frame, omega (rad/s, body), rotor (N, the
        thrust of each rotor), a = R' (v' + g e_z) (m/s^2, body: what an accelerometer reads), f_mass and f_wind (N,
        world). Parameters mass, J, arm, torque_ratio, motor_lag, drag, gravity, rotor_max and added_mass. It starts at
        rest with the rotors, and the default of the command, at the hover thrust m g/4 of the nominal mass.

    Raises
    ------
    ValueError
        For a mass, inertia, length, lag or limit that is not positive, a negative drag or gravity, added mass that
        leaves no mass, or rotors that cannot carry the weight.

    Notes
    -----
    Newton-Euler equations with linear rotor drag: M. Faessler, A. Franchi, D. Scaramuzza, "Differential flatness of
    quadrotor dynamics subject to rotor drag for accurate tracking of high-speed trajectories", IEEE Robotics and
    Automation Letters 3(2), 2018. The defaults describe a coaxial octocopter of 3 kg with thrust for 2.2 times its
    weight; a coaxial pair counts as one rotor, with a yaw torque in proportion to its thrust. Left out: the moment of
    a load beside the centre of mass and its share of J (the added mass sits in the centre), the rotors' own angular
    momentum (which cancels in coaxial pairs), drag torque, quadratic drag and ground effect.

    Examples
    --------
    With 1 kg more than it knows of, it sags with g/4:

    >>> drone = quadrotor(added_mass=1.0)
    >>> drone.dynamics(0.0, drone.start_state, np.zeros(7))[3:6].round(4).tolist()
    [0.0, 0.0, -2.4525]
    """
    for label, value, unit in (
        ("mass", mass, "kg"),
        ("arm", arm, "m"),
        ("torque_ratio", torque_ratio, "m"),
        ("motor_lag", motor_lag, "s"),
        ("rotor_max", rotor_max, "N"),
    ):
        _check_positive(label, value, unit)
    check_carries(mass, added_mass, gravity, rotor_max)
    inertia = _three("J", J, "moments of inertia in kg m^2, positive", positive=True)
    coefficients = _three("drag", drag, "drag coefficients in N s/m, 0 or more", positive=False)

    zero = np.zeros(3)
    hover = np.full(4, mass * gravity / 4.0)
    return plant(
        _equations,
        name=name,
        states={
            "r": (zero, "m", "position, world"),
            "v": (zero, "m/s", "velocity, world"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "omega": (zero, "rad/s", "angular velocity, body"),
            "rotor": (hover, "N", "thrust of each rotor"),
        },
        inputs={
            "thrust": (hover, "N", "commanded thrust of each rotor"),
            "wind": (zero, "m/s", "wind, world"),
        },
        optional=["wind"],
        outputs={
            "r": "m",
            "v": "m/s",
            "q": "",
            "omega": "rad/s",
            "rotor": "N",
            "a": ("m/s^2", "specific force, body"),
            "f_mass": ("N", "force of the added mass, world"),
            "f_wind": ("N", "force of the wind, world"),
        },
        params={
            "mass": (mass, "kg", "nominal mass"),
            "added_mass": (added_mass, "kg", "true less nominal mass"),
            "J": (inertia, "kg m^2", "moments of inertia"),
            "arm": (arm, "m", "rotor to centre of mass"),
            "torque_ratio": (torque_ratio, "m", "yaw torque per thrust"),
            "motor_lag": (motor_lag, "s", "time constant of the rotors"),
            "drag": (coefficients, "N s/m", "rotor drag, body axes"),
            "gravity": (gravity, "m/s^2", "gravity, against z"),
            "rotor_max": (rotor_max, "N", "largest thrust of a rotor"),
        },
    )


def _equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
    length = p.arm / np.sqrt(2.0)
    wrench = stack(1.0, length, length, p.torque_ratio) * (_SIGNS @ x.rotor)
    upward = np.array([0.0, 0.0, 1.0])
    # Specific force in the body frame: gravity is not in it, so an accelerometer reads it as it stands.
    specific = (wrench[0] * upward - p.drag * rotate_back(x.q, x.v - u.wind)) / (p.mass + p.added_mass)
    felt = rotate(x.q, specific)
    command = np.fmin(np.fmax(u.thrust, 0.0), p.rotor_max)
    derivatives: Results = {
        "r": x.v,
        "v": felt - p.gravity * upward,
        "q": quaternion_rate(x.q, x.omega),
        "omega": (wrench[1:] - cross(x.omega, p.J * x.omega)) / p.J,
        "rotor": (command - x.rotor) / p.motor_lag,
    }
    outputs: Results = {
        "r": x.r,
        "v": x.v,
        "q": x.q,
        "omega": x.omega,
        "rotor": x.rotor,
        "a": specific,
        "f_mass": -p.added_mass * felt,
        "f_wind": rotate(x.q, p.drag * rotate_back(x.q, u.wind)),
    }
    return derivatives, outputs


def _check_positive(name: str, value: float, unit: str) -> None:
    _signals.number(name, value, unit, above=0.0)


def check_carries(mass: float, added_mass: float, gravity: float, rotor_max: float) -> None:
    """Refuse masses (kg) that four rotors of at most ``rotor_max`` (N) cannot carry: a ``ValueError``."""
    if not (np.isfinite(gravity) and gravity >= 0.0):
        raise ValueError(f"gravity: expected 0 m/s^2 or more, acting against z, got {gravity}")
    if not (np.isfinite(added_mass) and mass + added_mass > 0.0):
        raise ValueError(
            f"added_mass: expected more than -{mass:g} kg, so that some of the mass of {mass:g} kg is left, got "
            f"{added_mass}"
        )
    weight = max(mass, mass + added_mass) * gravity
    if 4.0 * rotor_max < weight:
        raise ValueError(
            f"rotor_max: expected at least {weight / 4.0:.4g} N, a quarter of the weight, got {rotor_max:g} N: the "
            "rotors cannot carry it; raise rotor_max, or lower mass or added_mass"
        )


def _three(name: str, values: ArrayLike, words: str, *, positive: bool) -> NDArray[np.float64]:
    array = _signals.array(name, values, (3,))
    if array.min() < 0.0 or (positive and not array.all()):
        raise ValueError(f"{name}: expected three {words}, got {values!r}")
    return array
