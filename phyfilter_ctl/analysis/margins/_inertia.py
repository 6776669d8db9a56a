"""Inertia matrices: pairs to eigenvalues of M_hat M^-1, and sets of M to ranges of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh, eigvals

from ... import _signals
from ..._sections import ComplexArray, FloatArray

__all__ = ["checked_inertia", "definite", "loewner_range", "ratios"]

# Reciprocal condition number below which a matrix counts as singular.
_SINGULAR = 1e-14
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
    singular = np.linalg.svd(M, compute_uv=False)
    if not singular[-1] > _SINGULAR * singular[0]:
        raise ValueError(
            f"{name}: singular (smallest singular value {singular[-1]:.3g}, largest {singular[0]:.3g}); an inertia "
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


def ratios(M_hat: FloatArray, M: FloatArray) -> ComplexArray:
    """Eigenvalues of M_hat M^-1, from the pencil, so that M is not inverted."""
    if M_hat.shape != M.shape:
        raise ValueError(f"M_hat has shape {M_hat.shape} but M has {M.shape}: expected the same")
    return np.asarray(eigvals(M_hat, M), dtype=np.complex128)


def loewner_range(M_hat: FloatArray, low: FloatArray, high: FloatArray) -> tuple[float, float]:
    """Range of the eigenvalues of M_hat M^-1 over all symmetric M with low <= M <= high (all positive definite).

    They are the stationary values of v' M_hat v / v' M v, which only falls as M grows.
    """
    return float(eigh(M_hat, high, eigvals_only=True)[0]), float(eigh(M_hat, low, eigvals_only=True)[-1])
