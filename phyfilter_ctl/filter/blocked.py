"""The sampled filter over a whole record, without a Python loop per sample.

    w_k = w_{k-1} + dA_k (w_{k-1} - equilibrium u_k),    y_k = C w_k

Equal steps: the record is cut into blocks. Inside a block the outputs are one matrix product with the impulse
response (an exact sum, whatever the poles: repeated, complex or slow); the states at the block ends follow the same
recursion with a larger step. Unequal steps, and those block ends, are a banded triangular system that LAPACK solves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs

from .._sections import FloatArray, multiply

_BLOCK = 32
# Samples handled at once, a multiple of the block: few enough that every buffer stays in the cache and is given back
# to the allocator whole (fresh pages cost more than the arithmetic), and that a long record needs little memory.
CHUNK = 128 * _BLOCK
IRREGULAR_CHUNK = 32 * _BLOCK  # a transition for every step: larger buffers
# I + dA in the banded matrix rounds away eps / |p h| of a slow pole; below this |p h| one step of iterative
# refinement (residual in delta form, where nothing is lost) brings it back.
_SLOW = 1e-2


@dataclass(frozen=True)
class BlockKernel:
    """Everything about a constant step that does not depend on the data."""

    forward: FloatArray  # (L, L + n): inputs of a block to its outputs, and to the state at its end
    observe: FloatArray  # (n, L): state before a block to its outputs
    advance: FloatArray  # (n, n): transition over a block, minus I
    slow: bool  # whether even a block is short against the slowest pole

    @classmethod
    def build(cls, dA: FloatArray, equilibrium: FloatArray, C: FloatArray) -> BlockKernel:
        """Of w <- w + dA (w - equilibrium u) with output C w."""
        n = len(dA)
        powers = np.zeros((_BLOCK + 1, n, n))  # (I + dA)^j - I
        for j in range(_BLOCK):
            powers[j + 1] = powers[j] + dA + dA @ powers[j]
        B = -dA @ equilibrium
        states = B + powers[:_BLOCK] @ B  # (L, n): impulse response of the state
        impulse = states @ C
        lag = np.arange(_BLOCK)[None, :] - np.arange(_BLOCK)[:, None]
        toeplitz = np.where(lag >= 0, impulse[np.abs(lag)], 0.0)
        observe = np.ascontiguousarray((C + C @ powers[1:]).T)
        return cls(np.hstack([toeplitz, states[::-1]]), observe, powers[-1], is_slow(powers[-1]))


def uniform(kernel: BlockKernel, u: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Outputs C w_k for inputs u (m, K) from the state ``start`` (K, n).

    Returns
    -------
    y : (m, K) array
    end : (K, n) array
        State after the last whole block: the start of the next chunk where m is a multiple of the block.
    """
    m, channels = u.shape
    n = len(kernel.advance)
    blocks = -(-m // _BLOCK)
    inputs = np.zeros((channels, blocks * _BLOCK))
    inputs[:, :m] = u.T
    product = multiply(inputs.reshape(-1, _BLOCK), kernel.forward)
    ends = product[:, _BLOCK:].reshape(channels, blocks, n)
    before = np.empty((channels, blocks + 1, n))
    before[:, 0] = start
    before[:, 1:] = propagate(kernel.advance[None], ends, start, refine=kernel.slow)
    outputs = product[:, :_BLOCK]
    outputs += multiply(before[:, :-1].reshape(-1, n), kernel.observe)
    return outputs.reshape(channels, -1)[:, :m].T, before[:, -1]


def irregular(
    dA: FloatArray, equilibrium: FloatArray, C: FloatArray, u: FloatArray, start: FloatArray, *, refine: bool
) -> tuple[FloatArray, FloatArray]:
    """Outputs C w_k (m, K) for transitions dA (m, n, n) and inputs u (m, K), and the state (K, n) at the end."""
    drive = u.T[:, :, None] * -(dA @ equilibrium)
    states = propagate(dA, drive, start, refine=refine)
    return (states @ C).T, states[:, -1]


def needs_refinement(slowest: float, shortest: float) -> bool:
    """Whether the least |p| (rad/s) times the shortest step (s) is too small for the banded solve alone."""
    return slowest * shortest < _SLOW


def is_slow(advance: FloatArray) -> bool:
    """Whether I + ``advance`` (n, n) is too near I for the banded solve alone."""
    return bool(np.min(np.abs(np.linalg.eigvals(advance))) < _SLOW)


def propagate(dA: FloatArray, drive: FloatArray, start: FloatArray, *, refine: bool) -> FloatArray:
    """Solve w_k = (I + dA_k) w_{k-1} + drive_k for all k at once.

    Parameters
    ----------
    dA : (m, n, n), or (1, n, n) where it is the same at every step
    drive : (K, m, n)
    start : (K, n), state before the first step
    """
    _, m, n = drive.shape
    right = np.array(drive)
    right[:, 0] += start + start @ dA[0].T
    # Unknowns in the order (step, state): entry (i, j) of step k couples row k n + i to column (k - 1) n + j.
    band = np.zeros((m * n, 2 * n))
    by_step = band.reshape(m, n, 2 * n)
    later = dA if len(dA) == 1 else dA[1:]
    for i in range(n):
        for j in range(n):
            np.negative(later[:, i, j], out=by_step[: m - 1, j, n + i - j])
        by_step[: m - 1, i, n] -= 1.0
    states = _substitute(band, right)
    if refine:
        before = np.concatenate([start[:, None], states[:, :-1]], axis=1)
        residual = drive - (states - before)
        for j in range(n):
            residual += dA[:, :, j] * before[:, :, [j]]
        states += _substitute(band, residual)
    return states


def _substitute(band: FloatArray, right: FloatArray) -> FloatArray:
    channels, m, n = right.shape
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (band, right))
    solution, info = tbtrs(band.T, right.reshape(channels, m * n).T, uplo="L", diag="U", overwrite_b=True)
    assert info == 0  # a unit diagonal cannot be singular
    return solution.T.reshape(channels, m, n)
