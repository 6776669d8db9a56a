"""Quadratic programs of a few unknowns and many linear limits."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from ..._sections import FloatArray

__all__ = ["quadratic_program"]


def quadratic_program(
    gradient: FloatArray, H: FloatArray, A: FloatArray, spare: FloatArray
) -> FloatArray | None:
    """The step d that minimises gradient d + d' H d/2 with spare + A d >= 0; None where nothing keeps that.

    Lawson and Hanson's least distance programming: by non-negative least squares.
    """
    try:
        L = cholesky(H, lower=True)
    except np.linalg.LinAlgError:
        return None
    free = solve_triangular(L, gradient, lower=True)
    G = solve_triangular(L, A.T, lower=True)  # columns
    h = G.T @ free - spare
    E = np.vstack([G, h])
    sizes = np.linalg.norm(E, axis=0)
    E = E[:, sizes > 0.0] / sizes[sizes > 0.0]
    target = np.append(np.zeros(len(G)), 1.0)
    try:
        y, _ = nnls(E, target)
    except RuntimeError:
        return None
    r = E @ y - target
    if -r[-1] <= 1e-12:
        return None
    v = -r[:-1] / r[-1]
    return np.asarray(solve_triangular(L.T, v - free, lower=False))
