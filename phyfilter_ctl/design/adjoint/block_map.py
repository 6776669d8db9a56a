"""The recursion of a sampled filter over blocks of samples, its transpose, and how both change with a and b.

A block of L steps is one linear map of the state before it and its inputs to its outputs and the state after it.
The costate recursion is the transpose of that map, run from the last block to the first; the gradient is the sum over
the blocks of the products of what enters forwards with what enters backwards, weighted by the derivative of the map.
So neither states nor costates of single samples are ever formed.

The coefficients enter a chain of sections without a detour over the poles (whose derivative does not exist at
repeated ones): with row_i the output row of w^(n-i) s^i / D and B the input vector, changing the scaled coefficient
a_i / w^(n-i) is, up to a change of coordinates that the output does not see, dA/da_i = -B row_i and dC/db_i = row_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ... import _sections
from ..._sections import FloatArray
from ...filter import PhyFilter
from ...filter.blocked import is_slow, propagate
from ...filter.sampling import Method

BLOCK = 32
SLAB = 128  # blocks in one matrix product: small enough that no BLAS splits it over threads
CHUNK = 16 * SLAB * BLOCK  # samples at once: buffers stay in the cache, threads hold the interpreter rarely
_SQUARED = tuple(2**j for j in range(BLOCK.bit_length() - 1))


@dataclass(frozen=True)
class BlockMap:
    """A block of L steps as one map, and its derivatives in q scaled coefficients.

    The q directions are a_0 ... a_{n-1} and b_0 ... b_{n-1}, each over ``scale``.
    """

    ends: FloatArray  # (L, n): inputs to the state after the block
    outputs: FloatArray  # (L, L): inputs to outputs
    observe: FloatArray  # (n, L): state before to outputs
    advance: FloatArray  # (n, n): state before to state after, minus I
    slow: bool  # whether a block is short against the slowest pole
    d_ends: FloatArray  # (q, L, n)
    d_impulse: FloatArray  # (q, L)
    d_observe: FloatArray  # (q, n, L)
    d_advance: FloatArray  # (q, n, n)
    scale: FloatArray  # (q,): a raw coefficient over its scaled one

    @classmethod
    def build(cls, filter: PhyFilter, method: Method, dt: float) -> BlockMap:
        """Of a filter that is discretised by a method with a step of dt seconds."""
        A, equilibrium, C = filter.sections
        n = filter.order
        omega = abs(filter.a[0]) ** (1.0 / n)
        scale = omega ** np.arange(n, 0, -1)
        rows = np.array([_sections.chain_output(filter.poles, filter.a, row) for row in np.diag(scale)])
        dA, B, d_dA, d_B = _discretised(A, -A @ equilibrium, rows, method, dt)
        powers, d_powers = _powers(dA, d_dA)
        states = B + powers[:BLOCK] @ B
        d_states = d_B[:, None] + (powers[:BLOCK] @ d_B.T).transpose(2, 0, 1) + d_powers[:, :BLOCK] @ B
        impulse = states @ C
        lag = np.arange(BLOCK)[None, :] - np.arange(BLOCK)[:, None]
        return cls(
            ends=np.ascontiguousarray(states[::-1]),
            outputs=np.where(lag >= 0, impulse[np.abs(lag)], 0.0),
            observe=np.ascontiguousarray((C + C @ powers[1:]).T),
            advance=powers[-1],
            slow=is_slow(powers[-1]),
            d_ends=np.concatenate([d_states[:, ::-1], np.zeros((n, BLOCK, n))]),
            d_impulse=np.concatenate([d_states @ C, rows @ states.T]),
            d_observe=np.concatenate(
                [
                    (d_powers[:, 1:].transpose(0, 1, 3, 2) @ C).transpose(0, 2, 1),
                    (rows + rows @ powers[1:]).transpose(1, 2, 0),
                ]
            ),
            d_advance=np.concatenate([d_powers[:, -1], np.zeros((n, n, n))]),
            scale=np.concatenate([scale, scale]),
        )

    def transition(self, blocks: int) -> FloatArray:
        """(I + advance)^blocks - I, by squaring in delta form."""
        result, square = np.zeros_like(self.advance), self.advance
        while blocks:
            if blocks & 1:
                result = result + square + result @ square
            square = 2.0 * square + square @ square
            blocks >>= 1
        return result

    # -- forwards -----------------------------------------------------------------------------------------------

    def final_state(self, u: FloatArray) -> FloatArray:
        """State (K, n) after inputs u (m, K), from rest; m a multiple of the block."""
        state = np.zeros((u.shape[1], len(self.advance)))
        for rows in _chunks(len(u)):
            state = self._states(_blocks(u[rows]), state, rows)[:, -1]
        return state

    def respond(self, u: FloatArray, start: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Outputs (m, K) for inputs u (m, K) from the state ``start`` (K, n); the state before each chunk."""
        y, starts = np.empty(u.shape), [start]
        for rows in _chunks(len(u)):
            inputs = _blocks(u[rows])
            states = self._states(inputs, starts[-1], rows)
            part = np.matmul(inputs, self.outputs)
            part += np.matmul(_beside(inputs, states[:, :-1]), self.observe)
            y[rows] = part.reshape(u.shape[1], -1)[:, : rows.stop - rows.start].T
            starts.append(states[:, -1])
        return y, starts[:-1]

    def _states(self, inputs: FloatArray, start: FloatArray, rows: slice) -> FloatArray:
        """States (K, blocks + 1, n) before each block of ``rows`` and after the last."""
        channels, n = len(inputs), len(self.advance)
        drive = np.matmul(inputs, self.ends).reshape(channels, -1, n)[:, : _count(rows)]
        after = propagate(self.advance[None], drive, start, refine=self.slow)
        return np.concatenate([start[:, None], after], axis=1)

    # -- backwards ----------------------------------------------------------------------------------------------

    def first_costate(self, r: FloatArray) -> FloatArray:
        """Costate (K, n) before the cotangents r (m, K) of the outputs, with none after them."""
        costate = np.zeros((r.shape[1], len(self.advance)))
        for rows in reversed(_chunks(len(r))):
            costate = self._costates(_blocks(r[rows]), costate, rows)[:, 0]
        return costate

    def pull_back(
        self, u: FloatArray, r: FloatArray, starts: list[FloatArray], costate: FloatArray, *, inputs: bool
    ) -> tuple[FloatArray, FloatArray | None]:
        """Gradient of sum(r * outputs) in the q scaled coefficients, and in u (m, K) if ``inputs``.

        ``starts`` as ``respond`` gave them, ``costate`` (K, n) after the last step.
        """
        n = len(self.advance)
        products = np.zeros((n + BLOCK, n + BLOCK))
        cotangent = np.empty(u.shape) if inputs else None
        for rows, start in zip(reversed(_chunks(len(u))), reversed(starts), strict=True):
            u_blocks, r_blocks = _blocks(u[rows]), _blocks(r[rows])
            costates = self._costates(r_blocks, costate, rows)
            costate = costates[:, 0]
            before = _beside(u_blocks, self._states(u_blocks, start, rows)[:, :-1])
            after = _beside(r_blocks, costates[:, 1:])
            entering = np.concatenate([before, u_blocks], axis=3)
            leaving = np.concatenate([after, r_blocks], axis=3)
            products += np.matmul(entering.transpose(0, 1, 3, 2), leaving).sum(axis=(0, 1))
            if cotangent is not None:
                part = np.matmul(r_blocks, self.outputs.T) + np.matmul(after, self.ends.T)
                cotangent[rows] = part.reshape(u.shape[1], -1)[:, : rows.stop - rows.start].T
        return self._contract(products), cotangent

    def _costates(self, r_blocks: FloatArray, costate: FloatArray, rows: slice) -> FloatArray:
        """Costates (K, blocks + 1, n) before each block of ``rows`` and after the last."""
        channels, n = len(r_blocks), len(self.advance)
        drive = np.matmul(r_blocks, self.observe.T).reshape(channels, -1, n)[:, : _count(rows)]
        before = propagate(self.advance.T[None], drive[:, ::-1], costate, refine=self.slow)
        return np.concatenate([before[:, ::-1], costate[:, None]], axis=1)

    def _contract(self, products: FloatArray) -> FloatArray:
        n = len(self.advance)
        lag = np.arange(BLOCK)[None, :] - np.arange(BLOCK)[:, None]
        later = lag >= 0
        by_lag = np.bincount(lag[later], products[n:, n:][later], BLOCK)
        return (
            np.einsum("qij,ji->q", self.d_advance, products[:n, :n])
            + np.einsum("qli,li->q", self.d_ends, products[n:, :n])
            + np.einsum("qil,il->q", self.d_observe, products[:n, n:])
            + self.d_impulse @ by_lag
        )


def _discretised(
    A: FloatArray, B: FloatArray, rows: FloatArray, method: Method, dt: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """dA (n, n), B_d (n,) and their derivatives (n, n, n), (n, n) along -B row_i."""
    n = len(A)
    along = -B[None, :, None] * rows[:, None, :]
    if method == "euler":
        return A * dt, B * dt, along * dt, np.zeros((n, n))
    if method == "tustin":
        left = np.eye(n) - 0.5 * dt * A
        half = np.asarray(np.linalg.inv(left), dtype=float)
        dA, B_d = half @ A * dt, half @ B * dt
        return dA, B_d, half @ along @ (np.eye(n) + 0.5 * dA) * dt, 0.5 * dt * along @ B_d @ half.T
    # One exponential for all: the derivative along E stands in the corner of exp [[S, E], [0, S]]. Here the first
    # row of blocks carries every direction at once.
    m = n + 1
    big = np.zeros((m * m, m * m))
    for i in range(m):
        here = slice(i * m, i * m + n)
        big[here, here], big[here, i * m + n] = A, B
        if i:
            big[:n, here] = along[i - 1]
    corner = _sections.expm1(big, dt)[:n].reshape(n, m, m).transpose(1, 0, 2)
    return corner[0, :, :n], corner[0, :, n], corner[1:, :, :n], corner[1:, :, n]


def _powers(dA: FloatArray, d_dA: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(I + dA)^j - I for j = 0 ... L (L + 1, n, n) and the derivatives (q, L + 1, n, n), by doubling."""
    n = len(dA)
    powers, slopes = np.zeros((BLOCK + 1, n, n)), np.zeros((len(d_dA), BLOCK + 1, n, n))
    powers[1], slopes[:, 1] = dA, d_dA
    for m in _SQUARED:
        some, last = slice(1, m + 1), slice(m + 1, 2 * m + 1)
        powers[last] = powers[m] + powers[some] + powers[m] @ powers[some]
        slopes[:, last] = slopes[:, [m]] + slopes[:, some]
        slopes[:, last] += slopes[:, [m]] @ powers[some] + powers[m] @ slopes[:, some]
    return powers, slopes


def _chunks(count: int) -> list[slice]:
    return [slice(first, min(first + CHUNK, count)) for first in range(0, count, CHUNK)]


def _blocks(values: FloatArray) -> FloatArray:
    """Samples (m, K) in blocks, slab by slab: (K, slabs, blocks, L); what is missing at the end is zero."""
    m, channels = values.shape
    blocks = -(-m // BLOCK)
    slabs = -(-blocks // SLAB)
    padded = np.zeros((channels, slabs * min(SLAB, blocks) * BLOCK))
    padded[:, :m] = values.T
    return padded.reshape(channels, slabs, -1, BLOCK)


def _count(rows: slice) -> int:
    """Blocks that hold these rows."""
    return -(-(rows.stop - rows.start) // BLOCK)


def _beside(blocks: FloatArray, states: FloatArray) -> FloatArray:
    """States (K, blocks, n) in the slabs of ``_blocks``, zero in the blocks that only fill a slab."""
    channels, count, n = states.shape
    filled = np.zeros((*blocks.shape[:3], n))
    filled.reshape(channels, -1, n)[:, :count] = states
    return filled
