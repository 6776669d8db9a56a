"""A kernel as polynomials over the cells of a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from .kernels import Kernel
from .sampled_kernels import SampledKernels
from .walk import walk

__all__ = ["Cells", "continuous_cells", "halving", "sampled_cells"]

_TAIL = 1e-9
# More samples, or steps of the fastest pole, than these are not taken apart.
_MOST = 20_000


@dataclass(frozen=True, eq=False)
class Cells:
    """gain * (direct at 0 + K) with time in units of ``unit`` seconds.

    Parameters
    ----------
    lengths : (M,) array
    polynomials : (M, degree + 1) array
        Ascending coefficients of K over each cell, as a function of the share of it that has passed.
    remainders : (M,) array
        Bound of |K - polynomial|.
    direct, gain, unit, tail : float
        ``tail`` is the area of |K| beyond the cells, and all else that is not in them.
    """

    lengths: FloatArray
    polynomials: FloatArray
    remainders: FloatArray
    direct: float
    gain: float
    unit: float
    tail: float

    @cached_property
    def sizes(self) -> FloatArray:
        """About the area of |K| over each cell, (M,)."""
        ends = self.polynomials.sum(axis=1)
        return self.lengths * np.maximum(np.abs(self.polynomials[:, 0]), np.abs(ends))

    def halved(self, which: NDArray[np.bool_]) -> Cells:
        """The same with some cells (M,) cut in two."""
        count = self.polynomials.shape[1]
        left, right = halving(count)
        twice = np.where(which, 2, 1)
        place = np.repeat(np.arange(len(which)), twice)
        second = np.concatenate([[False], place[1:] == place[:-1]])
        cut = which[place]
        polynomials = self.polynomials[place]
        polynomials[cut & ~second] = self.polynomials[which] @ left
        polynomials[cut & second] = self.polynomials[which] @ right
        return replace(
            self,
            lengths=self.lengths[place] * np.where(cut, 0.5, 1.0),
            polynomials=polynomials,
            remainders=self.remainders[place],
        )


def halving(count: int) -> tuple[FloatArray, FloatArray]:
    """From coefficients over [0, 1], as rows, to those over each of its halves."""
    left = np.diag(0.5 ** np.arange(count)).astype(float)
    right = [[comb(i, j) * 0.5**i if i >= j else 0.0 for j in range(count)] for i in range(count)]
    return left, np.array(right)


def continuous_cells(kernel: Kernel) -> Cells | None:
    """Of a kernel of a continuous filter; None if it rings too long."""
    stretches, tail, _ = walk(kernel.A, kernel.B, kernel.C, _TAIL, _MOST)
    halves = [stretch.halved().sorted() for stretch in stretches]  # remainders fall by 2^11
    if sum(len(part.starts) for part in halves) > 2 * _MOST:
        return None
    return Cells(
        np.concatenate([np.full(len(part.starts), part.step) for part in halves]),
        np.concatenate([part.left @ part.rows.T for part in halves]),
        np.concatenate([part.remainders for part in halves]),
        kernel.direct,
        kernel.gain,
        kernel.unit,
        tail + kernel.doubt + kernel.l1.rounding / abs(kernel.gain),
    )


def sampled_cells(kernels: SampledKernels, derivative: int) -> Cells | None:
    """Of the kernel from a derivative of gamma to a sampled filter's error; None for too many samples."""
    X, certificate = kernels.states, kernels.error(derivative)
    if len(X) > _MOST:
        return None
    h, delay = kernels.sampled.dt, kernels.sampled.sampling.delay
    if derivative == 0:
        polynomials, gain, before = -kernels.impulse[:, None], 1.0, 0.0
    else:
        polynomials, gain, before = X[:-1] @ kernels.pieces[derivative - 1].T, h, 1.0
    lengths = np.ones(len(polynomials))
    if delay:
        late = np.zeros((1, polynomials.shape[1]))
        late[0, 0] = before
        polynomials, lengths = np.vstack([late, polynomials]), np.append(delay / h, lengths)
    direct = 1.0 if derivative == 0 else 0.0
    tail = (certificate.tail + certificate.rounding) / gain
    return Cells(lengths, polynomials, np.zeros(len(lengths)), direct, gain, h, tail)
