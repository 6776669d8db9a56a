"""Upper bound on the structured singular value for full complex blocks: the largest singular value, best scaled."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from ..._sections import ComplexArray, FloatArray

__all__ = ["scaled_norm"]

# Rounds of Osborne's balancing: each halves what is left, at least.
_BALANCINGS = 30
# max sigma <= (sum sigma^2q)^(1/2q) <= n^(1/2q) max sigma: each exponent starts from the last one's minimum.
_EXPONENTS = (4.0, 64.0, 1e3, 1e5, 1e7)


def scaled_norm(M: ComplexArray, blocks: Sequence[int], *, exact: bool = True) -> FloatArray:
    """min over D of the largest singular value of D M D^-1: an upper bound on mu for full blocks.

    Parameters
    ----------
    M : (K, n, n) complex array
    blocks : sequence of int
        Sizes of the blocks, n together; D is a positive multiple of I in each.
    exact : bool
        Whether D is optimal, else only balances M, which is quick and at least as large.

    Returns
    -------
    (K,) array
    """
    if len(blocks) == 1:
        return np.linalg.norm(M, 2, axis=(1, 2))
    logs = _balanced(M, blocks)
    if exact:
        logs = np.array([_optimal(each, start, blocks) for each, start in zip(M, logs, strict=True)])
    return np.linalg.norm(_scaled(M, np.repeat(logs, blocks, axis=-1)), 2, axis=(1, 2))


def _scaled(M: ComplexArray, logs: FloatArray) -> ComplexArray:
    return M * np.exp(logs[..., :, None] - logs[..., None, :])


def _balanced(M: ComplexArray, blocks: Sequence[int]) -> FloatArray:
    """Logarithms of D, (K, blocks), that make the Frobenius norm least (Osborne, J. ACM 7 (1960))."""
    edges = np.concatenate([[0], np.cumsum(blocks)[:-1]])
    size = np.add.reduceat(np.add.reduceat(np.abs(M) ** 2, edges, axis=1), edges, axis=2)
    size[:, range(len(blocks)), range(len(blocks))] = 0.0
    size = np.maximum(size, 1e-30 * np.max(size, axis=(1, 2), keepdims=True, initial=1e-270))
    logs = np.zeros((len(M), len(blocks)))
    for _ in range(_BALANCINGS):
        for i in range(len(blocks)):
            now = size * np.exp(2.0 * (logs[:, :, None] - logs[:, None, :]))
            others = np.arange(len(blocks)) != i
            logs[:, i] += 0.25 * np.log(now[:, others, i].sum(axis=1) / now[:, i, others].sum(axis=1))
    return logs


def _optimal(M: ComplexArray, start: FloatArray, blocks: Sequence[int]) -> FloatArray:
    """Logarithms of D that make the largest singular value least: a convex function of them, smoothed less and less."""
    # One scaling is free.
    logs = start - start[0]

    def smoothed(free: FloatArray, q: float) -> tuple[float, FloatArray]:
        scaled = _scaled(M, np.repeat(np.append(0.0, free), blocks))
        left, sigma, right = np.linalg.svd(scaled)
        sizes = np.log(np.maximum(sigma, 1e-300))
        weights = np.exp(2.0 * q * (sizes - sizes[0]))
        total = weights.sum()
        change = np.abs(left) ** 2 - np.abs(right.conj().T) ** 2
        edges = np.concatenate([[0], np.cumsum(blocks)[:-1]])
        slope = np.add.reduceat(change @ (weights / total), edges)
        return float(sizes[0] + np.log(total) / (2.0 * q)), slope[1:]

    free = logs[1:]
    for q in _EXPONENTS:
        free = np.asarray(
            minimize(smoothed, free, args=(q,), jac=True, method="BFGS", options={"gtol": 1e-9}).x
        )
    return np.append(0.0, free)
