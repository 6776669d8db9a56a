"""A serial arm on a flying platform: its kinematics and momentum, the same on CasADi columns and on numpy vectors.

All vectors are in the platform's body axes, from the platform's centre of mass, and all motion is relative to the
platform: what the platform itself does enters in :mod:`.coupling`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .algebra import Array, cross
from .arm_inverse import Elbow, elbow_sign, no_more, planar_chain
from .arm_motion import ArmMotion, joint_frames, outward
from .arm_parts import Link, Vector, column, freeze, like, numbers

__all__ = ["SerialArm"]

# Rounding of typed rotation matrices.
_TYPED = 1e-9


@dataclass(frozen=True, init=False, eq=False)
class SerialArm:
    """A serial arm of revolute joints below a platform.

    Parameters
    ----------
    links : sequence of Link
        From the base to the end effector.
    mount : (3,) array
        P_o: the first joint, from the platform's centre of mass in body axes, in m.
    home : (joints,) array, optional
        Joint angles to start from, in rad. None means 0.
    base_axes : (3, 3) array
        Rotation from the arm's base frame to the body frame. The default, diag(1, -1, -1), is for an arm that hangs:
        base x forward as the body's, base z down where the body's is up, hence base y to the right where the body's
        points to the left.

    Raises
    ------
    ValueError
        For no link, shapes, axes that are no rotation, or a home outside the joint limits.

    Notes
    -----
    The kinematics take numbers or CasADi columns (``casadi.SX``) and give numpy arrays or CasADi expressions.

    Examples
    --------
    >>> from phyfilter_ctl.plants import small_arm
    >>> arm = small_arm()
    >>> arm.joints, round(arm.mass, 3)
    (5, 0.45)
    >>> arm.end_effector([0.0, 0.0, 0.0, 0.0, 0.0]).round(3).tolist()
    [0.47, 0.0, -0.09]
    """

    links: tuple[Link, ...]
    mount: FloatArray
    home: FloatArray
    base_axes: FloatArray

    def __init__(
        self,
        links: Sequence[Link],
        mount: ArrayLike = (0.0, 0.0, 0.0),
        *,
        home: ArrayLike | None = None,
        base_axes: ArrayLike = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    ) -> None:
        if len(links) == 0 or not all(isinstance(link, Link) for link in links):
            raise ValueError(f"links: expected at least one Link, got {list(links)!r}")
        axes = numbers("base_axes", base_axes, (3, 3))
        if not (np.allclose(axes @ axes.T, np.eye(3), atol=_TYPED) and np.linalg.det(axes) > 0.0):
            raise ValueError(
                f"base_axes: expected a rotation (orthonormal, determinant 1), got {axes.tolist()}; an axis that is "
                "turned over takes a second one with it"
            )
        angles = numbers("home", np.zeros(len(links)) if home is None else home, (len(links),))
        for i, (link, angle) in enumerate(zip(links, angles, strict=True)):
            if not link.lower <= angle <= link.upper:
                raise ValueError(
                    f"home: joint {i} is at {angle:.4g} rad, expected {link.lower:.4g} to {link.upper:.4g}, its limits"
                )
        fields = {
            "links": tuple(links),
            "mount": numbers("mount", mount, (3,)),
            "home": angles,
            "base_axes": axes,
        }
        freeze(self, fields)

    # -- what it is ---------------------------------------------------------------------------------------------

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.links)

    @property
    def mass(self) -> float:
        """Mass of all links in kg."""
        return float(sum(link.mass for link in self.links))

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper limits of the joint angles, (joints,) each, rad."""
        return np.array([link.lower for link in self.links]), np.array([link.upper for link in self.links])

    @property
    def rate_limits(self) -> FloatArray:
        """Largest joint rates, (joints,), rad/s."""
        return np.array([link.rate_limit for link in self.links])

    # -- base frame ---------------------------------------------------------------------------------------------

    def from_base(self, p: Vector) -> Array:
        """A point of the arm's base frame, from the platform's centre of mass in body axes: P_o + A p.

        Parameters
        ----------
        p : (3,) array
            m, in the base frame.

        Examples
        --------
        >>> from phyfilter_ctl.plants import small_arm
        >>> small_arm().from_base([0.28, 0.0, 0.105]).round(3).tolist()
        [0.34, 0.0, -0.145]
        """
        point = column("p", p, 3)
        return like(point, self.mount) + like(point, self.base_axes) @ point

    def to_base(self, p: Vector) -> Array:
        """A point, from the platform's centre of mass in body axes, in the arm's base frame: A' (p - P_o).

        Parameters
        ----------
        p : (3,) array
            m, in body axes.
        """
        point = column("p", p, 3)
        return like(point, self.base_axes).T @ (point - like(point, self.mount))

    # -- kinematics ---------------------------------------------------------------------------------------------

    def motion(
        self, joint: Vector, joint_rate: Vector | None = None, *, joint_acceleration: Vector | None = None
    ) -> ArmMotion:
        """Mass, centre of mass, inertia, momentum and end effector, with their derivatives in time.

        Parameters
        ----------
        joint : (joints,) array
            rad.
        joint_rate, joint_acceleration : (joints,) array, optional
            rad/s and rad/s^2; None means rest.

        Returns
        -------
        ArmMotion

        Raises
        ------
        ValueError
            For another number of joints.

        Notes
        -----
        Velocities and accelerations go from link to link as in the outward half of the recursive Newton-Euler
        algorithm (Featherstone, Rigid Body Dynamics Algorithms, ch. 5); the sums over the links are

            J_m = sum R I R' + m (p.p 1 - p p'),    L_m = sum R I R' w + m p x p'

        with p the centre of a link, p' its velocity and w its angular velocity, all relative to the platform.
        """
        n = self.joints
        angle = column("joint", joint, n)
        rate = column("joint_rate", np.zeros(n) if joint_rate is None else joint_rate, n)
        acceleration = column(
            "joint_acceleration", np.zeros(n) if joint_acceleration is None else joint_acceleration, n
        )
        if any(isinstance(part, ca.SX) for part in (angle, rate, acceleration)):
            angle, rate, acceleration = ca.SX(angle), ca.SX(rate), ca.SX(acceleration)
        return outward(self.links, self.mount, self.base_axes, angle, rate, acceleration)

    def end_effector(self, joint: Vector) -> Array:
        """Position of the end effector from the platform's centre of mass, body axes, (3,), m.

        Parameters
        ----------
        joint : (joints,) array
            rad.
        """
        return self.motion(joint).tip

    def centre_of_mass(self, joint: Vector) -> Array:
        """P_bm, the arm's centre of mass from the platform's, body axes, (3,), m.

        Parameters
        ----------
        joint : (joints,) array
            rad.
        """
        return self.motion(joint).centre

    def inertia(self, joint: Vector) -> Array:
        """J_m, the arm's inertia about the platform's centre of mass, body axes, (3, 3), kg m^2.

        Parameters
        ----------
        joint : (joints,) array
            rad.
        """
        return self.motion(joint).inertia

    def angular_momentum(self, joint: Vector, joint_rate: Vector) -> Array:
        """L_m of the motion relative to the platform, about its centre of mass, body axes, (3,), N m s.

        Parameters
        ----------
        joint, joint_rate : (joints,) array
            rad and rad/s.
        """
        return self.motion(joint, joint_rate).momentum

    def jacobian(self, joint: Vector) -> Array:
        """J_e (3, joints): velocity of the end effector relative to the platform = J_e joint_rate, body axes.

        Parameters
        ----------
        joint : (joints,) array
            rad.
        """
        angle = column("joint", joint, self.joints)
        frames = joint_frames(self.links, self.mount, self.base_axes, angle)
        tip = self.end_effector(angle)
        columns = [cross(axis, tip - origin) for axis, origin in frames]
        return ca.horzcat(*columns) if isinstance(tip, ca.SX) else np.column_stack(columns)

    # -- inverse kinematics of the arm with five joints ---------------------------------------------------------

    def inverse(
        self, p: Vector, pitch: ca.SX | float = 0.0, *, roll: ca.SX | float = 0.0, elbow: Elbow = "down"
    ) -> Array:
        """Joint angles that bring the end effector to a point, in closed form.

        For arms of five joints: base yaw (axis z of the base frame), shoulder, elbow, wrist pitch (y), wrist roll (x).
        The base turns to the point, a triangle gives shoulder and elbow, the wrist makes up the pitch.

        Parameters
        ----------
        p : (3,) array
            From the platform's centre of mass in body axes, in m; :meth:`from_base` takes points of the base frame.
        pitch : number
            Elevation of the gripper above the base frame's x-y plane in rad: shoulder + elbow + wrist pitch.
        roll : number
            Of the gripper, in rad.
        elbow : {"down", "up"}
            Side of the bent elbow: towards the base frame's z, away from the platform, or against it.

        Returns
        -------
        (5,) array
            rad, each within -pi ... pi.

        Raises
        ------
        ValueError
            For an arm of another kind, or another elbow.

        Notes
        -----
        Points out of reach give the nearest stretched or folded arm, never NaN, so that a block may call it at any
        time; :meth:`reachable` tells, joint limits included. On the axis of the base yaw the yaw is free, and 0.

        Examples
        --------
        >>> from phyfilter_ctl.plants import small_arm
        >>> arm = small_arm()
        >>> joint = arm.inverse([0.3, 0.1, -0.2], 0.2)
        >>> arm.end_effector(joint).round(12).tolist(), float(joint[1:4].sum().round(12))
        ([0.3, 0.1, -0.2], 0.2)
        """
        chain, sign = planar_chain(self.links), elbow_sign(elbow)
        return chain.inverse(self._target(p, pitch, roll), pitch, roll, sign)

    def _target(self, p: Vector, *angles: ca.SX | float) -> Array:
        """A point in the base frame, a CasADi column where an angle beside it is one."""
        point = self.to_base(p)
        return ca.SX(point) if any(isinstance(angle, ca.SX) for angle in angles) else point

    def inverse_rates(
        self,
        joint: Vector,
        velocity: Vector,
        *,
        pitch_rate: ca.SX | float = 0.0,
        roll_rate: ca.SX | float = 0.0,
    ) -> Array:
        """Joint rates that move the end effector with a velocity: the derivative of :meth:`inverse`.

        Parameters
        ----------
        joint : (5,) array
            rad.
        velocity : (3,) array
            Relative to the platform, body axes, m/s.
        pitch_rate, roll_rate : number
            rad/s.

        Returns
        -------
        (5,) array
            rad/s. Where upper arm and forearm are in line, no finite rates move the wrist in all directions: there
            shoulder and forearm do not turn. On the axis of the base yaw the same holds for the yaw.

        Raises
        ------
        ValueError
            For an arm of another kind.
        """
        chain = planar_chain(self.links)
        angle, moving = column("joint", joint, self.joints), column("velocity", velocity, 3)
        if any(isinstance(part, ca.SX) for part in (angle, moving, pitch_rate, roll_rate)):
            angle, moving = ca.SX(angle), ca.SX(moving)
        return chain.inverse_rates(angle, like(moving, self.base_axes).T @ moving, pitch_rate, roll_rate)

    def reachable(
        self, p: Vector, pitch: ca.SX | float = 0.0, *, roll: ca.SX | float = 0.0, elbow: Elbow = "down"
    ) -> bool | ca.SX:
        """Whether the end effector gets to a point within the joint limits.

        Parameters
        ----------
        p, pitch, roll, elbow
            As for :meth:`inverse`.

        Returns
        -------
        bool or casadi.SX
            An SX is 1 or 0.

        Examples
        --------
        >>> from phyfilter_ctl.plants import small_arm
        >>> small_arm().reachable([0.3, 0.1, -0.2]), small_arm().reachable([0.6, 0.0, 0.0])
        (True, False)
        """
        chain = planar_chain(self.links)
        joint = self.inverse(p, pitch, roll=roll, elbow=elbow)
        within = chain.triangle_closes(self._target(p, pitch, roll), pitch)
        for i, link in enumerate(self.links):
            within = within * no_more(link.lower, joint[i]) * no_more(joint[i], link.upper)
        return within if isinstance(within, ca.SX) else bool(within)

    def check_reachable(
        self, points: ArrayLike, pitch: float = 0.0, *, roll: float = 0.0, elbow: Elbow = "down"
    ) -> None:
        """Refuse a path that the arm cannot follow.

        Parameters
        ----------
        points : (N, 3) array
            As ``p`` of :meth:`inverse`.
        pitch, roll, elbow
            As for :meth:`inverse`.

        Raises
        ------
        ValueError
            Naming the first point out of reach, and the joint or the length that is in the way.
        """
        path = _signals.array("points", points, ("N", 3), empty=True)
        for k, p in enumerate(path):
            if self.reachable(p, pitch, roll=roll, elbow=elbow):
                continue
            joint = np.asarray(self.inverse(p, pitch, roll=roll, elbow=elbow))
            lower, upper = self.limits
            beyond = np.flatnonzero((joint < lower) | (joint > upper))
            reach, distance = planar_chain(self.links).reach(self.to_base(p), pitch)
            why = (
                f"the wrist would be {distance:.3f} m from the shoulder, expected {reach[0]:.3f} to {reach[1]:.3f} m"
                if not reach[0] <= distance <= reach[1]
                else f"joint {beyond[0]} would be at {joint[beyond[0]]:.3f} rad, expected "
                f"{lower[beyond[0]]:.3f} to {upper[beyond[0]]:.3f}"
            )
            raise ValueError(
                f"points[{k}] = {p.round(4).tolist()} m (from the platform's centre of mass) is out of reach at pitch "
                f"{pitch:g} rad: {why}; move the point or the platform, or take another pitch"
            )
