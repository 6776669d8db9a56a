"""Inverse kinematics, in closed form, of an arm with base yaw, shoulder, elbow, wrist pitch and wrist roll.

Everything here is in the arm's base frame. In the vertical plane that the base yaw turns to, a direction has an
elevation, positive against z; a joint about +y adds its angle to the elevation of all that it carries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import casadi as ca
import numpy as np

from .algebra import Array, Scalar, stack, where
from .arm_parts import Link

__all__ = ["Elbow", "PlanarChain", "elbow_sign", "no_more", "planar_chain"]

Elbow: TypeAlias = Literal["down", "up"]

_AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 1, 0], [1, 0, 0]], dtype=float)
# Lengths and directions that agree to this are equal: micrometres on an arm.
_SAME = 1e-6
# Share of a length below which the arm counts as stretched, folded or on its axis when rates are asked for.
_SINGULAR = 1e-6


@dataclass(frozen=True)
class PlanarChain:
    """The arm in the plane that its base yaw turns.

    Parameters
    ----------
    shoulder_x, shoulder_z : float
        Of the shoulder from the base, in m.
    upper, fore : float
        Lengths of upper arm and forearm, in m.
    upper_slope, fore_slope : float
        Their elevations at joint angle 0, in rad.
    tool : float
        From the wrist pitch joint to the end effector, in m.
    """

    shoulder_x: float
    shoulder_z: float
    upper: float
    fore: float
    upper_slope: float
    fore_slope: float
    tool: float

    def inverse(self, p: Array, pitch: Scalar, roll: Scalar, sign: float) -> Array:
        """Joint angles (5,) for the point p; sign 1 for elbow down, -1 for elbow up.

        Parameters
        ----------
        p : (3,) array
        pitch, roll : numbers
        sign : float
        """
        yaw = _atan2(p[1], p[0])
        x, z = self._wrist(p, pitch)
        cosine = _clipped(self._cosine(x, z))
        bend = sign * _atan2(_sqrt(1.0 - cosine * cosine), cosine)
        below = _atan2(self.fore * _sin(bend), self.upper + self.fore * _cos(bend))
        shoulder = _wrapped(_atan2(-z, x) - below - self.upper_slope)
        elbow = _wrapped(bend + self.upper_slope - self.fore_slope)
        return stack(yaw, shoulder, elbow, _wrapped(pitch - shoulder - elbow), _wrapped(roll))

    def inverse_rates(self, joint: Array, velocity: Array, pitch_rate: Scalar, roll_rate: Scalar) -> Array:
        """Joint rates (5,) for a velocity of the end effector.

        Parameters
        ----------
        joint : (5,) array
        velocity : (3,) array
        pitch_rate, roll_rate : numbers
        """
        c, s = _cos(joint[0]), _sin(joint[0])
        upper = joint[1] + self.upper_slope
        fore = joint[1] + joint[2] + self.fore_slope
        pitch = joint[1] + joint[2] + joint[3]
        out = self.shoulder_x + self.upper * _cos(upper) + self.fore * _cos(fore) + self.tool * _cos(pitch)
        yaw_rate = _quotient(c * velocity[1] - s * velocity[0], out, self.upper + self.fore)
        # Of the wrist, outward and up, as elevations count; the tool's own turn taken off.
        outward = c * velocity[0] + s * velocity[1] + self.tool * _sin(pitch) * pitch_rate
        up = -velocity[2] - self.tool * _cos(pitch) * pitch_rate
        # Two bars: along one bar only the other's turn moves the wrist.
        turn = self.upper * self.fore * _sin(fore - upper)
        shoulder_rate = _quotient(
            self.fore * (_cos(fore) * outward + _sin(fore) * up), turn, self.upper * self.fore
        )
        fore_rate = _quotient(
            -self.upper * (_cos(upper) * outward + _sin(upper) * up), turn, self.upper * self.fore
        )
        elbow_rate = fore_rate - shoulder_rate
        return stack(yaw_rate, shoulder_rate, elbow_rate, pitch_rate - fore_rate, roll_rate)

    def triangle_closes(self, p: Array, pitch: Scalar) -> Array:
        """Whether upper arm and forearm are long enough, and not too long, for a point: a truth value.

        Parameters
        ----------
        p : (3,) array
        pitch : number
        """
        cosine = self._cosine(*self._wrist(p, pitch))
        return no_more(-1.0, cosine) * no_more(cosine, 1.0)

    def reach(self, p: Array, pitch: float) -> tuple[tuple[float, float], float]:
        """Least and largest distance of the wrist from the shoulder, and the one for a point, in m.

        Parameters
        ----------
        p : (3,) array
        pitch : float
        """
        x, z = self._wrist(p, pitch)
        return (abs(self.upper - self.fore), self.upper + self.fore), float(np.hypot(x, z))

    def _wrist(self, p: Array, pitch: Scalar) -> tuple[Array, Array]:
        """The wrist pitch joint from the shoulder: outward and down."""
        out = _sqrt(p[0] * p[0] + p[1] * p[1])
        return (
            out - self.tool * _cos(pitch) - self.shoulder_x,
            p[2] + self.tool * _sin(pitch) - self.shoulder_z,
        )

    def _cosine(self, x: Array, z: Array) -> Array:
        return (x * x + z * z - self.upper**2 - self.fore**2) / (2.0 * self.upper * self.fore)


def planar_chain(links: Sequence[Link]) -> PlanarChain:
    """The planar chain of an arm, if it is of the kind that can be inverted in closed form.

    Parameters
    ----------
    links : sequence of Link

    Raises
    ------
    ValueError
        If it is not, saying which link is in the way.
    """
    kind = "inverse kinematics are for five joints: base yaw (z), shoulder (y), elbow (y), wrist pitch (y), roll (x)"
    if len(links) != len(_AXES):
        raise ValueError(f"{kind}; got {len(links)} joints")
    for i, (link, axis) in enumerate(zip(links, _AXES, strict=True)):
        if not np.allclose(link.axis, axis, rtol=0.0, atol=_SAME):
            raise ValueError(
                f"{kind}; got the axis {link.axis.tolist()} for joint {i}, expected {axis.tolist()}"
            )
        sideways = abs(link.offset[1]) if i < 3 else float(np.max(np.abs(link.offset[1:])))
        if sideways > _SAME:
            where_to = "in the x-z plane" if i < 3 else "along x"
            raise ValueError(
                f"{kind}; got the offset {link.offset.tolist()} m for link {i}, expected {where_to}"
            )
    upper, fore = (float(np.hypot(link.offset[0], link.offset[2])) for link in links[1:3])
    slopes = [float(np.arctan2(-link.offset[2], link.offset[0])) for link in links[1:3]]
    tool = float(links[3].offset[0] + links[4].offset[0])
    if min(upper, fore) <= _SAME or tool < 0.0:
        raise ValueError(
            f"{kind}; expected an upper arm and a forearm of some length and a tool along +x, got {upper}, {fore} and "
            f"{tool} m"
        )
    shoulder = links[0].offset
    return PlanarChain(float(shoulder[0]), float(shoulder[2]), upper, fore, slopes[0], slopes[1], tool)


def no_more(a: Scalar, b: Scalar) -> Array:
    """Whether a <= b, as 1 or 0.

    Parameters
    ----------
    a, b : numbers
    """
    if isinstance(a, ca.SX) or isinstance(b, ca.SX):
        return ca.SX(a <= b)
    return np.asarray(a <= b, dtype=float)


def elbow_sign(elbow: str) -> float:
    """1 for "down", where the forearm bends up; -1 for "up".

    Parameters
    ----------
    elbow : {"down", "up"}

    Raises
    ------
    ValueError
        For anything else.
    """
    if elbow not in ("down", "up"):
        raise ValueError(f"elbow: expected 'down' or 'up', got {elbow!r}")
    return 1.0 if elbow == "down" else -1.0


def _quotient(a: Array, b: Array, scale: float) -> Array:
    """a/b, and 0 where b is next to nothing beside ``scale``."""
    tiny = no_more(b * b, (_SINGULAR * scale) ** 2)
    return where(tiny, 0.0, a / where(tiny, 1.0, b))


def _clipped(cosine: Array) -> Array:
    if isinstance(cosine, ca.SX):
        return ca.fmin(ca.fmax(cosine, -1.0), 1.0)
    return np.clip(cosine, -1.0, 1.0)


def _wrapped(angle: Scalar) -> Array:
    return _atan2(_sin(angle), _cos(angle))


def _sqrt(value: Scalar) -> Array:
    return ca.sqrt(value) if isinstance(value, ca.SX) else np.sqrt(value)


def _sin(value: Scalar) -> Array:
    return ca.sin(value) if isinstance(value, ca.SX) else np.sin(value)


def _cos(value: Scalar) -> Array:
    return ca.cos(value) if isinstance(value, ca.SX) else np.cos(value)


def _atan2(y: Scalar, x: Scalar) -> Array:
    symbolic = isinstance(y, ca.SX) or isinstance(x, ca.SX)
    return ca.atan2(y, x) if symbolic else np.arctan2(y, x)
