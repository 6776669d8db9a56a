"""Frames in which logs are written, and the one in which a robot's recording is: world ENU, body FLU, both z up.

World frames are ENU (east, north, up; also any local frame with z up), NED (north, east, down) and NWU; body frames FLU
(forward, left, up) and FRD (forward, right, down). The internal quaternion is (w, x, y, z), of length 1, and turns
vectors of the body into those of the world. Conventions: REP 103 of ROS (ENU, FLU); PX4 and ArduPilot (NED, FRD).
"""

from __future__ import annotations

import numpy as np

from .._sections import FloatArray

__all__ = ["ATTITUDES", "BODY", "WORLD", "attitude", "continuous", "rotated", "to_internal"]

_ROOT = np.sqrt(0.5)
# What turns a vector in this frame into ENU or FLU, as a quaternion (w, x, y, z).
WORLD: dict[str, tuple[float, ...]] = {
    "ENU": (1.0, 0.0, 0.0, 0.0),
    "NED": (0.0, _ROOT, _ROOT, 0.0),
    "NWU": (_ROOT, 0.0, 0.0, _ROOT),
}
BODY: dict[str, tuple[float, ...]] = {"FLU": (1.0, 0.0, 0.0, 0.0), "FRD": (0.0, 1.0, 0.0, 0.0)}
ATTITUDES = ("wxyz", "xyzw", "rpy")

_UNIT_LENGTH = 0.05  # of a quaternion; those of logs are rounded, what is no quaternion is far from it


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """p q of quaternions (..., 4)."""
    w, v = p[..., :1], p[..., 1:]
    u, r = q[..., :1], q[..., 1:]
    real = w * u - np.sum(v * r, axis=-1, keepdims=True)
    return np.concatenate([real, w * r + u * v + np.cross(v, r)], axis=-1)


def conjugate(q: FloatArray) -> FloatArray:
    """The inverse of unit quaternions (..., 4)."""
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def rotated(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (N, 3) or (1, 3) turned by quaternions (N, 4) or (1, 4), whatever their length."""
    if q.shape[1:] != (4,) or v.shape[1:] != (3,):
        raise ValueError(
            f"rotate: expected a quaternion and a vector of 3, got shapes {q.shape[1:]} and {v.shape[1:]}"
        )
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    w, r = q[:, :1], q[:, 1:]
    t = 2.0 * np.cross(r, v)
    return v + w * t + np.cross(r, t)


def to_internal(vectors: FloatArray, frame: str) -> FloatArray:
    """Vectors (N, 3) of a world or body frame in ENU or FLU."""
    turn = (WORLD | BODY)[frame]
    # Turns by 90 and 180 degrees: rounded, a component is one of the others to the last bit.
    matrix = np.rint(rotated(np.array([turn]), np.eye(3)))
    return vectors @ matrix


def attitude(values: FloatArray, kind: str, frames: tuple[str, str]) -> FloatArray:
    """Quaternions (N, 4) from body FLU to world ENU.

    Parameters
    ----------
    values : (N, 4) or (N, 3) array
        A quaternion, or roll, pitch and yaw in rad (turned about z, then y, then x).
    kind : {"wxyz", "xyzw", "rpy"}
    frames : (str, str)
        From which frame into which; (body, world), or (world, body) for the inverse.

    Raises
    ------
    ValueError
        If a quaternion is not of length 1.
    """
    q = _from_angles(values) if kind == "rpy" else values if kind == "wxyz" else np.roll(values, 1, axis=1)
    length = np.linalg.norm(q, axis=1, keepdims=True)
    wrong = np.abs(length[:, 0] - 1.0) > _UNIT_LENGTH
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(
            f"expected quaternions of length 1, got {length[k, 0]:.4g} at sample {k} ({int(wrong.sum())} such); are "
            "these the four fields of one quaternion?"
        )
    q = q / length
    if frames[0] in WORLD:
        q, frames = conjugate(q), (frames[1], frames[0])
    into, out_of = np.array([WORLD[frames[1]]]), conjugate(np.array([BODY[frames[0]]]))
    return continuous(product(product(into, q), out_of))


def continuous(q: FloatArray) -> FloatArray:
    """The same rotations, without the jumps from q to -q between samples, which a straight line would cut short."""
    good = np.isfinite(q).all(axis=1)
    flips = np.ones(len(q))
    if good.sum() > 1:
        some = q[good]
        same = np.sum(some[1:] * some[:-1], axis=1) >= 0.0
        flips[good] = np.concatenate([[1.0], np.cumprod(np.where(same, 1.0, -1.0))])
    return q * flips[:, None]


def _from_angles(angles: FloatArray) -> FloatArray:
    halves = 0.5 * angles

    def about(axis: int) -> FloatArray:
        q = np.zeros((len(angles), 4))
        q[:, 0], q[:, 1 + axis] = np.cos(halves[:, axis]), np.sin(halves[:, axis])
        return q

    return product(product(about(2), about(1)), about(0))
