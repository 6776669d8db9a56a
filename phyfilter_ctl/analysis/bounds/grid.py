"""The grid of the linear programmes for several derivatives: cells, finer where the kernel has its area."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from .cells import Cells

__all__ = ["Grid", "bernstein", "ends"]

# Cells that are refined are cut in two so often.
_HALVINGS = 2


@dataclass(frozen=True, eq=False)
class Grid:
    """A kernel, what is bounded, and the cells on which densities are straight and the highest derivative constant.

    Parameters
    ----------
    cells : Cells
    D : dict of int to float
    knots : (L + 1,) array
    owner : (M,) array
        Cell of the programme that each of the kernel's lies in.
    """

    cells: Cells
    D: Mapping[int, float]
    knots: FloatArray
    owner: NDArray[np.intp]

    @staticmethod
    def of(cells: Cells, D: Mapping[int, float], count: int) -> Grid:
        """Knots where the kernel has its area: an equal share of (area of a cell)^(1/3) between two."""
        while len(cells.lengths) < 2 * count:
            cells = cells.halved(np.ones(len(cells.lengths), dtype=bool))
        weight = np.cbrt(cells.sizes + 1e-9 * cells.sizes.max())
        share = np.concatenate([[0.0], np.cumsum(weight)]) / weight.sum()
        first = np.unique(np.searchsorted(share, np.linspace(0.0, 1.0, count + 1)[:-1]))
        return Grid._at(cells, D, first)

    @staticmethod
    def _at(cells: Cells, D: Mapping[int, float], first: NDArray[np.intp]) -> Grid:
        """With a knot at the beginning of some of the kernel's cells."""
        starts = np.concatenate([[0.0], np.cumsum(cells.lengths)])
        owner = np.searchsorted(first, np.arange(len(cells.lengths)), side="right") - 1
        return Grid(cells, D, starts[np.append(first, len(starts) - 1)], owner.astype(np.intp))

    def refined(self, v: FloatArray) -> Grid:
        """Finer where the course changes its highest derivative (L,)."""
        step = np.abs(np.diff(v)) > 0.02 * self.D[self.m]
        busy = np.append(step, False) | np.append(False, step)
        cells, which, owner = self.cells, busy[self.owner], self.owner
        for _ in range(_HALVINGS):
            cells, times = cells.halved(which), np.where(which, 2, 1)
            which, owner = np.repeat(which, times), np.repeat(owner, times)
        begins = np.append(True, np.diff(owner) > 0) | which
        return Grid._at(cells, self.D, np.flatnonzero(begins))

    @property
    def m(self) -> int:
        """Highest derivative bounded."""
        return max(self.D)

    @property
    def widths(self) -> FloatArray:
        """Of the cells, (L,)."""
        return np.diff(self.knots)

    def integrals(self, densities: Mapping[int, FloatArray], starts: FloatArray) -> list[FloatArray]:
        """A_0 ... A_(m+1) as polynomials over the kernel's cells, each (M, degree + 1); A_r(0) = starts[r]."""
        lengths, parts = self.cells.lengths[:, None], [self.cells.polynomials]
        for r in range(self.m + 2):
            part = parts[r]
            if r in densities:
                part = np.column_stack([part, np.zeros(len(part))]) if part.shape[1] == 1 else part.copy()
                first, last = densities[r]
                rise = ((last - first) / self.widths)[self.owner]
                part[:, 0] -= first[self.owner] + rise * self.since
                part[:, 1] -= rise * self.cells.lengths
            parts[r] = part
            whole = lengths * part / np.arange(1.0, part.shape[1] + 1.0)
            begin = starts[r + 1] + np.concatenate([[0.0], np.cumsum(whole.sum(axis=1))])
            parts.append(np.column_stack([begin[:-1], whole]))
        return parts

    @property
    def since(self) -> FloatArray:
        """From the beginning of a cell to that of each of the kernel's in it, (M,)."""
        return np.concatenate([[0.0], np.cumsum(self.cells.lengths)])[:-1] - self.knots[self.owner]

    def error(self, r: int) -> float:
        """Bound of what the remainders of the kernel and rounding do to A_r."""
        cells, T = self.cells, float(self.knots[-1])
        first = float(cells.lengths @ cells.remainders) + 1e-15 * len(cells.lengths) ** 0.5 * float(
            cells.sizes.sum() + abs(cells.direct)
        )
        return first * T ** (r - 1)

    def implied(self, r: int) -> float:
        """Bound of |phi^(r)|: as given, or Gorny's inequality from the orders below and above.

        It weighs only what the solver's tolerance leaves.
        """
        if r in self.D:
            return self.D[r]
        low, high = max(j for j in self.D if j < r), min(j for j in self.D if j > r)
        k, n = r - low, high - low
        return float(
            4.0 * np.exp(2.0 * k) * (n / k) ** k * self.D[low] ** (1.0 - k / n) * self.D[high] ** (k / n)
        )


def ends(polynomials: FloatArray) -> FloatArray:
    """Values at the end of each cell."""
    return polynomials.sum(axis=1)


def bernstein(degree: int) -> FloatArray:
    """From power to Bernstein coefficients over [0, 1]."""
    return np.array([[comb(i, j) / comb(degree, j) for j in range(degree + 1)] for i in range(degree + 1)])
