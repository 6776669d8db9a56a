"""How an arm moves relative to its platform: velocities, accelerations and momentum from link to link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from .._sections import FloatArray
from .algebra import Array, Scalar, cross, dot, rotation_matrix, skew, stack
from .arm_parts import Link, like

__all__ = ["ArmMotion", "joint_frames", "outer", "outward"]


@dataclass(frozen=True)
class ArmMotion:
    """An arm in motion relative to its platform, in body axes from the platform's centre of mass.

    Parameters
    ----------
    mass : number
        m_m in kg.
    centre, centre_velocity, centre_acceleration : (3,) arrays
        Centre of mass P_bm and its derivatives (m, m/s, m/s^2).
    inertia, inertia_rate : (3, 3) arrays
        J_m about the platform's centre of mass and its derivative (kg m^2, kg m^2/s).
    momentum, momentum_rate : (3,) arrays
        Angular momentum L_m of the motion relative to the platform, about the platform's centre of mass, and its
        derivative (N m s, N m).
    tip, tip_velocity, tip_acceleration : (3,) arrays
        End effector and its derivatives (m, m/s, m/s^2).
    """

    mass: Scalar
    centre: Array
    centre_velocity: Array
    centre_acceleration: Array
    inertia: Array
    inertia_rate: Array
    momentum: Array
    momentum_rate: Array
    tip: Array
    tip_velocity: Array
    tip_acceleration: Array


def outward(
    links: Sequence[Link],
    mount: FloatArray,
    base_axes: FloatArray,
    joint: Array,
    joint_rate: Array,
    joint_acceleration: Array,
) -> ArmMotion:
    """Velocities and accelerations from link to link, and the sums over the links.

    Parameters
    ----------
    links : sequence of Link
    mount, base_axes : (3,) and (3, 3) arrays
        Of the first joint, from the platform.
    joint, joint_rate, joint_acceleration : (joints,) arrays
        All numbers, or all CasADi columns.
    """
    R, p = like(joint, base_axes), like(joint, mount)
    zero, one, none = like(joint, np.zeros(3)), like(joint, np.eye(3)), like(joint, np.zeros((3, 3)))
    w = turning = v = a = zero
    centre = centre_v = centre_a = momentum = momentum_rate = zero
    inertia = inertia_rate = none
    for i, link in enumerate(links):
        axis = R @ link.axis
        turning = turning + joint_acceleration[i] * axis + cross(w, joint_rate[i] * axis)
        w = w + joint_rate[i] * axis
        R = R @ _turn(link.axis, joint[i])
        P, V, A = _carried(R @ link.centre, p, v, a, w, turning)
        own = R @ like(joint, link.inertia) @ R.T
        spin = skew(w) @ own
        m = link.mass
        centre, centre_v, centre_a = centre + m * P, centre_v + m * V, centre_a + m * A
        inertia = inertia + own + m * (dot(P, P) * one - outer(P, P))
        inertia_rate = inertia_rate + spin + spin.T + m * (2.0 * dot(P, V) * one - outer(P, V) - outer(V, P))
        momentum = momentum + own @ w + m * cross(P, V)
        momentum_rate = momentum_rate + own @ turning + cross(w, own @ w) + m * cross(P, A)
        p, v, a = _carried(R @ link.offset, p, v, a, w, turning)
    mass = float(sum(link.mass for link in links))
    return ArmMotion(
        mass,
        centre / mass,
        centre_v / mass,
        centre_a / mass,
        inertia,
        inertia_rate,
        momentum,
        momentum_rate,
        p,
        v,
        a,
    )


def joint_frames(
    links: Sequence[Link], mount: FloatArray, base_axes: FloatArray, joint: Array
) -> list[tuple[Array, Array]]:
    """Axis and origin of every joint, body axes.

    Parameters
    ----------
    links, mount, base_axes, joint
        As for :func:`outward`.
    """
    R, p = like(joint, base_axes), like(joint, mount)
    frames = []
    for i, link in enumerate(links):
        frames.append((R @ link.axis, p))
        R = R @ _turn(link.axis, joint[i])
        p = p + R @ link.offset
    return frames


def _carried(
    arm: Array, p: Array, v: Array, a: Array, w: Array, turning: Array
) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration of a point of a body that turns, ``arm`` from one where they are known."""
    around = cross(w, arm)
    return p + arm, v + around, a + cross(turning, arm) + cross(w, around)


def _turn(axis: FloatArray, angle: Array) -> Array:
    """Rotation matrix about an axis of the link."""
    symbolic = isinstance(angle, ca.SX)
    half = 0.5 * angle
    sine = ca.sin(half) if symbolic else np.sin(half)
    cosine = ca.cos(half) if symbolic else np.cos(half)
    return rotation_matrix(stack(cosine, *(float(entry) * sine for entry in axis)))


def outer(a: Array, b: Array) -> Array:
    """Matrix a b'.

    Parameters
    ----------
    a, b : (n,) arrays
    """
    return a @ b.T if isinstance(a, ca.SX) else np.outer(a, b)
