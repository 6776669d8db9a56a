"""Bounds from quadratic Lyapunov functions: the textbook's ball and the best invariant ellipsoid.

They answer the same question as the L1 norm, for x' = A x + B d, e = direct d + C x with |d| <= 1, less sharply:

* ball: |x| <= sqrt(lmax(P) / lmin(P)) 2 lmax(P) |B| / lmin(Q) with A' P + P A = -Q, here Q = I. It depends on the
  coordinates; in those of the companion form it can be useless, and scaling time helps;
* ellipsoid: x' P^-1 x <= 1 with A P + P A' + alpha P + B B' / alpha = 0 is invariant, so |C x| <= sqrt(C P C'); alpha
  is chosen best. It does not depend on coordinates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_lyapunov
from scipy.optimize import fminbound

from ..._sections import FloatArray

__all__ = ["QuadraticBound", "ball", "ellipsoid"]

# Raw companion coordinates of fast filters span 1e20 and more.
_DIGITS = 80


class QuadraticBound(NamedTuple):
    """A bound with the matrix and the decay rate (1/s) that prove it."""

    gain: float
    P: FloatArray
    decay: float


def ball(a: FloatArray, C: FloatArray) -> QuadraticBound:
    """The textbook's bound |C| |x| with Q = I, in the coordinates y, y', ... of 1/D, D = s^n + a_{n-1} s^(n-1) + ..."""
    import mpmath

    with mpmath.workdps(_DIGITS):
        n = len(a)
        exact = mpmath.matrix(n, n)
        for i in range(n):
            exact[n - 1, i] = -mpmath.mpf(float(a[i]))
            if i + 1 < n:
                exact[i, i + 1] = mpmath.mpf(1)
        eye = mpmath.eye(n)
        system = mpmath.matrix(n * n)
        for i in range(n):
            for j in range(n):
                for k in range(n):
                    system[i * n + j, k * n + j] += exact[k, i]
                    system[i * n + j, i * n + k] += exact[k, j]
        flat = mpmath.lu_solve(system, -mpmath.matrix([eye[i, j] for i in range(n) for j in range(n)]))
        P = mpmath.matrix(n, n)
        for i in range(n):
            for j in range(n):
                P[i, j] = (flat[i * n + j] + flat[j * n + i]) / 2
        values = [mpmath.mpf(v) for v in mpmath.eigsy(P, eigvals_only=True)]
        largest, smallest = max(values), min(values)
        gain = mpmath.sqrt(largest / smallest) * 2 * largest * float(np.linalg.norm(C))
        return QuadraticBound(
            float(gain), np.array(P.tolist(), dtype=float).reshape(n, n), float(1 / (2 * largest))
        )


def ellipsoid(A: FloatArray, B: FloatArray, C: FloatArray) -> QuadraticBound:
    """The least bound |C x| by an invariant ellipsoid."""
    top = -2.0 * float(np.linalg.eigvals(A).real.max())
    eye, outer = np.eye(len(A)), np.outer(B, B)

    def matrix(alpha: float) -> FloatArray:
        return np.asarray(solve_continuous_lyapunov(A + 0.5 * alpha * eye, -outer / alpha))

    def radius(alpha: float) -> float:
        value = float(C @ matrix(alpha) @ C)
        return float(np.sqrt(value)) if value > 0.0 else np.inf

    alpha = float(np.asarray(fminbound(radius, 1e-3 * top, 0.999 * top, xtol=1e-4 * top)))
    return QuadraticBound(radius(alpha), matrix(alpha), 0.5 * alpha)
