"""Inertia matrices: pairs to eigenvalues of M_hat M^-1, and sets of M to ranges of them."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, eigvals

from ... import _signals
from ..._sections import ComplexArray, FloatArray
from ..._signals import LARGEST

__all__ = [
    "checked_inertia",
    "checked_vertices",
    "definite",
    "hull_range",
    "loewner_range",
    "ratios",
]

# Reciprocal condition number below which a matrix counts as singular.
_SINGULAR = 1e-14
# Axes up to which all 2^(n-1) sign patterns are tried: 4,096 small eigenvalue problems.
_MOST_AXES = 13
# Ratio of two axes of one robot, in whatever units.
_WIDEST = 1e30
# Asymmetry that rounding leaves.
_SYMMETRIC = 1e-9


def checked_inertia(name: str, value: ArrayLike) -> FloatArray:
    """A finite regular matrix (n, n); a vector (n,) stands for a diagonal one, a number for 1 x 1."""
    M = _signals.real(name, value)
    if M.ndim < 2:
        M = np.diag(np.atleast_1d(M))
    if M.ndim != 2 or M.shape[0] != M.shape[1] or not M.size:
        raise ValueError(f"{name}: expected a square matrix (n, n) or a diagonal (n,), got shape {M.shape}")
    if not np.all(np.isfinite(M)):
        raise ValueError(f"{name}: every entry must be finite, got {M.tolist()}")
    sizes = np.abs(M).max(axis=1)
    if not 0.0 < sizes.max() <= LARGEST or sizes.min() * _WIDEST < sizes.max():
        raise ValueError(
            f"{name}: singular, or of axes too unlike: rows of {sizes.min():.3g} to {sizes.max():.3g}, expected up to "
            f"{_WIDEST:g} times between them and none beyond {LARGEST:g}; choose other units"
        )
    scaled = M / sizes[:, None]
    columns = np.abs(scaled).max(axis=0)  # whatever the units of the axes
    singular = np.linalg.svd(scaled / columns, compute_uv=False) if columns.min() > 0.0 else np.zeros(1)
    if not singular[-1] > _SINGULAR * singular[0]:
        raise ValueError(
            f"{name}: singular, with axes scaled alike the smallest singular value is {singular[-1]:.3g}; an inertia "
            "matrix has an inverse"
        )
    return M


def definite(name: str, M: FloatArray) -> FloatArray:
    """The matrix itself, refused where it is not symmetric positive definite."""
    if np.max(np.abs(M - M.T)) > _SYMMETRIC * np.max(np.abs(M)):
        raise ValueError(f"{name}: expected a symmetric matrix, got one that differs from its transpose")
    M = 0.5 * (M + M.T)
    least = float(np.linalg.eigvalsh(M)[0])
    if not least > 0.0:
        raise ValueError(
            f"{name}: expected a positive definite matrix, got one with the eigenvalue {least:.4g}"
        )
    return M


def checked_vertices(M_hat: FloatArray, vertices: ArrayLike) -> FloatArray:
    """Symmetric positive definite matrices (J, n, n) beside M_hat; (J, n) or (J,) stand for diagonal ones."""
    given = _signals.real("vertices", vertices)
    if given.ndim not in (1, 2, 3) or not len(given):
        raise ValueError(
            f"vertices: expected a list of inertia matrices, (J, n, n) or diagonal (J, n), got shape {given.shape}"
        )
    found = np.array(
        [definite(f"vertices[{j}]", checked_inertia(f"vertices[{j}]", each)) for j, each in enumerate(given)]
    )
    if found.shape[1:] != M_hat.shape:
        raise ValueError(f"vertices: expected shape {M_hat.shape} as M_hat each, got {found.shape[1:]}")
    return found


def ratios(M_hat: FloatArray, M: FloatArray) -> ComplexArray:
    """Eigenvalues of M_hat M^-1, from the pencil, so that M is not inverted."""
    if M_hat.shape != M.shape:
        raise ValueError(f"M_hat has shape {M_hat.shape} but M has {M.shape}: expected the same")
    units = 1.0 / np.sqrt(np.abs(M).max(axis=1))  # a congruence, so that no axis is lost beside the others
    units = np.outer(units, units)
    return np.asarray(eigvals(M_hat * units, M * units), dtype=np.complex128)


def loewner_range(M_hat: FloatArray, low: FloatArray, high: FloatArray) -> tuple[float, float]:
    """Range of the eigenvalues of M_hat M^-1 over all symmetric M with low <= M <= high (all positive definite).

    They are the stationary values of v' M_hat v / v' M v, which only falls as M grows.
    """
    return float(eigh(M_hat, high, eigvals_only=True)[0]), float(eigh(M_hat, low, eigvals_only=True)[-1])


def hull_range(
    M_hat: FloatArray, vertices: FloatArray, deviation: FloatArray | None = None
) -> tuple[float, float, bool]:
    """Range of the eigenvalues of M_hat M^-1 over all symmetric M within a deviation of the convex hull of vertices.

    With M_hat = L L' they are the inverses of those of L^-1 M L^-T, of which the largest is a convex function of M and
    the least a concave one: both ends are attained at vertices. v' M v is largest, and least, in a box about V at
    V +- S deviation S with S = diag(sign v), which leaves 2^(n-1) vertices of it (J. Rohn, "Positive definiteness and
    stability of interval matrices", SIAM J. Matrix Anal. Appl. 15 (1994)). L makes all of it free of units.

    Parameters
    ----------
    M_hat : (n, n) array
    vertices : (J, n, n) array
    deviation : (n, n) array, optional
        |M - V| <= deviation entry by entry, V in the hull.

    Returns
    -------
    low, high : float
        ``high`` is infinite where a singular M is in the set.
    attained : bool
        False for a deviation beyond 13 axes: then the range is one that contains the true one.
    """
    n, inverse = len(M_hat), np.linalg.inv(np.linalg.cholesky(M_hat))
    middle = inverse @ vertices @ inverse.T
    if deviation is None:
        ends = np.linalg.eigvalsh(0.5 * (middle + middle.transpose(0, 2, 1)))
        return *_inverted(float(ends[:, 0].min()), float(ends[:, -1].max())), True
    if n > _MOST_AXES:
        ends = np.linalg.eigvalsh(0.5 * (middle + middle.transpose(0, 2, 1)))
        size = np.abs(inverse) @ deviation @ np.abs(inverse.T)
        radius = float(np.linalg.eigvalsh(0.5 * (size + size.T))[-1])
        return *_inverted(float(ends[:, 0].min()) - radius, float(ends[:, -1].max()) + radius), False
    patterns = np.array([[1.0, *signs] for signs in product((1.0, -1.0), repeat=n - 1)])
    turned = inverse * patterns[:, None, :]
    spread = turned @ deviation @ turned.transpose(0, 2, 1)
    low = min(float(np.linalg.eigvalsh(each - spread)[:, 0].min()) for each in middle)
    high = max(float(np.linalg.eigvalsh(each + spread)[:, -1].max()) for each in middle)
    return *_inverted(low, high), True


def _inverted(low: float, high: float) -> tuple[float, float]:
    """Range of 1/v for v from low to high > 0."""
    return 1.0 / high, 1.0 / low if low > 0.0 else np.inf
