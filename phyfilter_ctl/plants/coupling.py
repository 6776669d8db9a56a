"""What a moving arm does to the platform that carries it: the coupling force and torque, and both bodies together.

The paper's equations have the world's and the body's z axes down. Turning both frames over about x,
N = diag(1, -1, -1), leaves every vector equation as it is, but for the two vectors that are written in coordinates:
gravity g e_z becomes -g e_z, and the thrust -f b_3 becomes T b_3. So, with z up,

    m_b v' = T b_3 - m_b g e_z + Delta_F,          J omega' = -omega x J omega + tau + Delta_tau.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from .algebra import Array, Scalar, cross, dot, rotate, rotate_back, solve
from .arm_motion import ArmMotion, outer

__all__ = ["Accelerations", "coupled_accelerations", "coupling_force", "coupling_torque", "payload_motion"]


class Accelerations(NamedTuple):
    """Accelerations of the platform.

    Parameters
    ----------
    specific : (3,) array
        R' (v' + g e_z), body axes, m/s^2: what an accelerometer reads.
    omega_rate : (3,) array
        omega', body axes, rad/s^2.
    """

    specific: Array
    omega_rate: Array


def coupling_force(
    motion: ArmMotion, *, q: Array, omega: Array, v_rate: Array, omega_rate: Array, gravity: Scalar = 9.81
) -> Array:
    """Delta_F, the force of a moving arm on its platform.

        Delta_F = -m_m v' - m_m g e_z - m_m R (omega x (omega x P) + omega' x P + 2 omega x P' + P'')

    Parameters
    ----------
    motion : ArmMotion
        m_m and P = P_bm of the arm, or of a load.
    q : (4,) array
        Attitude of the platform.
    omega, omega_rate : (3,) arrays
        Angular velocity and its derivative, body axes, rad/s and rad/s^2.
    v_rate : (3,) array
        Acceleration v' of the platform's centre of mass, world, m/s^2.
    gravity : float
        g in m/s^2, against the z axis of the world.

    Returns
    -------
    (3,) array
        N, world; m_b v' = T b_3 - m_b g e_z + Delta_F.

    Notes
    -----
    Balance of linear momentum. The paper's Eq. (coupling_V) has this force, but its platform equation subtracts it; it
    has to be added. The sign of the gravity term is that of z up here.

    Examples
    --------
    An arm at rest under a platform at rest weighs what it weighs:

    >>> from phyfilter_ctl.plants import small_arm
    >>> level, zero = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    >>> motion = small_arm().motion(np.zeros(5))
    >>> float(coupling_force(motion, q=level, omega=zero, v_rate=zero, omega_rate=zero)[2].round(4))
    -4.4145
    """
    own = motion.centre_acceleration + _carried(omega, omega_rate, motion.centre, motion.centre_velocity)
    return -motion.mass * (v_rate + _upward(v_rate, gravity) + rotate(q, own))


def coupling_torque(
    motion: ArmMotion, *, q: Array, omega: Array, v_rate: Array, omega_rate: Array, gravity: Scalar = 9.81
) -> Array:
    """Delta_tau, the torque of a moving arm on its platform, about the platform's centre of mass.

        Delta_tau = -J_m omega' - omega x J_m omega - J_m' omega - omega x L_m - L_m' - m_m P x R' (g e_z + v')

    Parameters
    ----------
    motion : ArmMotion
        m_m, P = P_bm, J_m and L_m of the arm, or of a load.
    q, omega, v_rate, omega_rate, gravity
        As for :func:`coupling_force`.

    Returns
    -------
    (3,) array
        N m, body axes; J omega' = -omega x J omega + tau + Delta_tau.

    Notes
    -----
    Balance of angular momentum about a point that moves. The paper's Eq. (coupling_V) prints J_m' omega' for
    J_m' omega, and a product m_m P R' (...) of two columns for the cross product. The sign of the gravity term is that
    of z up here.

    Examples
    --------
    An arm held out forward pitches the nose down, about +y:

    >>> from phyfilter_ctl.plants import small_arm
    >>> level, zero = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    >>> motion = small_arm().motion(np.zeros(5))
    >>> float(coupling_torque(motion, q=level, omega=zero, v_rate=zero, omega_rate=zero)[1].round(3))
    0.923
    """
    felt = rotate_back(q, v_rate + _upward(v_rate, gravity))
    return -(
        motion.inertia @ omega_rate + _gyroscopic(motion, omega) + motion.mass * cross(motion.centre, felt)
    )


def payload_motion(mass: Scalar, motion: ArmMotion) -> ArmMotion:
    """A point mass in the gripper, as a moving body of its own.

    Parameters
    ----------
    mass : number
        kg.
    motion : ArmMotion
        The arm that carries it.

    Returns
    -------
    ArmMotion
        For :func:`coupling_force` and :func:`coupling_torque`.

    Notes
    -----
    Where the mass varies in time, as while a stand hands its load over, these functions take it as it is at the
    moment; the momentum m' v_e that mass brings or takes is left out. It is none where the gripper rests against the
    stand, or where the mass comes with the gripper's velocity.
    """
    p, v, a = motion.tip, motion.tip_velocity, motion.tip_acceleration
    square = outer(p, v)
    one = ca.SX.eye(3) if isinstance(p, ca.SX) else np.eye(3)
    return ArmMotion(
        mass,
        p,
        v,
        a,
        mass * (dot(p, p) * one - outer(p, p)),
        mass * (2.0 * dot(p, v) * one - square - square.T),
        mass * cross(p, v),
        mass * cross(p, a),
        p,
        v,
        a,
    )


def coupled_accelerations(
    bodies: tuple[ArmMotion, ...], *, mass: Scalar, J: Array, omega: Array, force: Array, torque: Array
) -> Accelerations:
    """Accelerations of a platform with the bodies that it carries along prescribed motions.

    Six equations, with s = sum m P and M the mass of all,

        [ M 1     -[s]x     ] [ specific ]     [ force - n  ]
        [ [s]x    J + sum J_m ] [ omega'   ]  =  [ torque - k ],

    n and k what the accelerations do not enter, solved for omega' by eliminating the first three: what is left is the
    inertia about the common centre of mass.

    Parameters
    ----------
    bodies : tuple of ArmMotion
        Arm, load.
    mass : number
        m_b of the platform alone, kg.
    J : (3, 3) array
        Of the platform alone about its centre of mass, kg m^2.
    omega : (3,) array
        rad/s, body axes.
    force, torque : (3,) array
        On the platform's centre of mass, without weights, body axes, N and N m.

    Returns
    -------
    Accelerations
    """
    M, inertia, s = mass, J, 0.0 * omega
    n, k = 0.0 * omega, cross(omega, J @ omega)
    for body in bodies:
        M = M + body.mass
        inertia = inertia + body.inertia
        s = s + body.mass * body.centre
        around = cross(omega, cross(omega, body.centre)) + 2.0 * cross(omega, body.centre_velocity)
        n = n + body.mass * (body.centre_acceleration + around)
        k = k + _gyroscopic(body, omega)
    left = force - n
    one = ca.SX.eye(3) if isinstance(omega, ca.SX) else np.eye(3)
    central = inertia - (dot(s, s) * one - outer(s, s)) / M
    omega_rate = solve(central, torque - k - cross(s, left) / M)
    return Accelerations((left + cross(s, omega_rate)) / M, omega_rate)


def _carried(omega: Array, omega_rate: Array, p: Array, v: Array) -> Array:
    """Acceleration of a point from the turn of the frame in which it moves."""
    return cross(omega, cross(omega, p)) + cross(omega_rate, p) + 2.0 * cross(omega, v)


def _gyroscopic(motion: ArmMotion, omega: Array) -> Array:
    own = motion.inertia @ omega + motion.momentum
    return cross(omega, own) + motion.inertia_rate @ omega + motion.momentum_rate


def _upward(like: Array, gravity: Scalar) -> Array:
    upward = np.array([0.0, 0.0, 1.0])
    return (ca.SX(upward) if isinstance(like, ca.SX) else upward) * gravity
