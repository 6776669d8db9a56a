"""What a sampled filter computes once: transitions for a step, and the constants of records and loops."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _sections
from .._sections import FloatArray
from .phyfilter import PhyFilter
from .recursion import BlockKernel

Method = Literal["exact", "euler", "tustin"]
Precision = Literal["float64", "float32"]
Array = NDArray[np.floating]


class StepConstants(NamedTuple):
    """What one step of a loop needs, in the arithmetic of the filter."""

    dA: Array  # (n, n) transposed for a shared filter, (n_f, n, n) for one per channel
    equilibrium: Array  # (n,) or (n_f, n)
    C: Array  # (n,) or (n_f, n)
    rate: np.floating


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Transitions of a bank of filters, padded to one order and rounded to the precision, kept in double."""

    filters: tuple[PhyFilter, ...]
    method: Method
    dt: float
    precision: Precision

    def at(self, dt: float | FloatArray, i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(dA, equilibrium, C) of filter i for a step, or for steps (m,): dA (m, n, n) then."""
        entry = self.filters[i]
        A, equilibrium, C = entry.sections
        dA = transition(A, self.method, dt)
        extra = max(other.order for other in self.filters) - entry.order
        if extra:
            dA = np.pad(dA, [(0, 0)] * (dA.ndim - 2) + [(0, extra), (0, extra)])
            equilibrium, C = np.pad(equilibrium, (0, extra)), np.pad(C, (0, extra))
        return self._rounded(dA), self._rounded(equilibrium), self._rounded(C)

    def all_at(self, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dA (c, n, n), equilibrium (c, n) and C (c, n) of all filters for a step."""
        parts = [self.at(dt, i) for i in range(len(self.filters))]
        dA, equilibrium, C = (np.stack(column) for column in zip(*parts, strict=True))
        return dA, equilibrium, C

    @cached_property
    def bank(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """:meth:`all_at` of the nominal step."""
        return self.all_at(self.dt)

    @cached_property
    def kernels(self) -> tuple[BlockKernel, ...]:
        """For records of equal steps: one block kernel per filter."""
        return tuple(BlockKernel.build(*parts) for parts in zip(*self.bank, strict=True))

    @cached_property
    def nominal(self) -> StepConstants:
        """For loops: what a nominal step needs."""
        return self.step(self.dt)

    def step(self, dt: float) -> StepConstants:
        """For loops: what a step of another length needs."""
        dA, equilibrium, C = (part.astype(self.precision) for part in self.all_at(dt))
        rate = np.dtype(self.precision).type(1.0 / dt)
        if len(self.filters) == 1:
            return StepConstants(np.ascontiguousarray(dA[0].T), equilibrium[0], C[0], rate)
        return StepConstants(dA, equilibrium, C, rate)

    @property
    def slowest(self) -> float:
        """Least |p| of all poles in rad/s."""
        return min(float(np.min(np.abs(entry.poles))) for entry in self.filters)

    def check_step(self, dt: float) -> None:
        """Refuse a step at which forward Euler would diverge, |1 + p h| >= 1.

        Raises
        ------
        ValueError
            Naming the pole and the largest step.
        """
        if self.method == "euler":
            for entry in self.filters:
                _refuse_divergence(entry, dt)

    def _rounded(self, values: FloatArray) -> FloatArray:
        return values.astype(self.precision).astype(float)


def transition(A: FloatArray, method: Method, dt: float | FloatArray) -> FloatArray:
    """The increment of w' = A w over a step of dt: e^(A dt) - I, A dt or the trapezoidal rule of it.

    Shape (n, n); for steps (m,) shape (m, n, n).
    """
    if method == "exact":
        return _sections.expm1(A, dt)
    scaled = A * np.asarray(dt)[..., None, None]
    if method == "euler":
        return scaled
    return np.asarray(np.linalg.solve(np.eye(len(A)) - 0.5 * scaled, scaled), dtype=float)


def _refuse_divergence(filter: PhyFilter, dt: float) -> None:
    growth = np.abs(1.0 + filter.poles * dt)
    worst = int(np.argmax(growth))
    if growth[worst] >= 1.0:
        pole = filter.poles[worst]
        largest = float(np.min(-2.0 * filter.poles.real / np.abs(filter.poles) ** 2))
        raise ValueError(
            f"forward Euler diverges: |1 + p h| = {growth[worst]:.4g} >= 1 for the pole {pole:.6g} rad/s at "
            f"h = {dt:g} s; expected h < {largest:.4g} s; use method='exact'"
        )


def checked_direction(E: ArrayLike) -> FloatArray:
    """E (n_x, n_f) of full column rank, read-only."""
    matrix = np.array(E, dtype=float)
    if matrix.ndim != 2 or not np.all(np.isfinite(matrix)):
        raise ValueError(f"E: expected a finite (n_x, n_f) matrix, got shape {matrix.shape}")
    rank = int(np.linalg.matrix_rank(matrix))
    if rank < matrix.shape[1]:
        raise ValueError(
            f"E has rank {rank} for {matrix.shape[1]} columns: expected full column rank, else f cannot be told from "
            "the measurement; drop dependent columns"
        )
    matrix.flags.writeable = False
    return matrix


def checked_limit(limit: ArrayLike, channels: int | None) -> FloatArray:
    """Bounds on |f_hat|, () or (n_f,), read-only."""
    bound = np.array(limit, dtype=float)
    if bound.ndim > 1 or not np.all(bound > 0.0):
        raise ValueError(
            f"limit: expected a positive bound on |f_hat|, one number or one per channel, got {limit!r}"
        )
    if bound.ndim == 1 and channels is not None and len(bound) != channels:
        raise ValueError(
            f"limit: {len(bound)} bounds for {channels} channels; expected one number or {channels}"
        )
    bound.flags.writeable = False
    return bound
