"""Bounds of several derivatives at once: the worst residual is the answer to a linear grid.

With phi = gamma^(k), k the lowest derivative bounded, seen backwards from the moment of the error, that error is
direct phi(0) + the integral of K phi over [0, T] (the rest is the tail), and |phi^(j)| <= D_j for some j = 0 ... m. Two
programmes enclose its supremum (weak duality, so whatever the solver returns):

* below: a phi whose m-th derivative is constant on each cell, scaled until it keeps every bound everywhere;
* above: a split of the kernel. For any densities k_j and A_1' = K - k_0, A_2' = A_1 - k_1, ... integration by parts
  gives error = sum_j integral k_j phi^(j) + integral A_m phi^(m) + terms at both ends, so at most sum_j D_j ||k_j||_1 +
  D_m ||A_m||_1 + those. A_m is a polynomial on every cell of the kernel's own grid: its area is enclosed, not summed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import factorial

import numpy as np

from ..._sections import FloatArray
from ...filter import PhyFilter, SampledPhyFilter
from . import kernels
from .cells import Cells, continuous_cells, sampled_cells
from .grid import Grid
from .kernel_split import least_split
from .sampled_kernels import SampledKernels
from .worst_course import worst_course

__all__ = ["Together", "together", "together_of"]

# Cells of the linear programmes; how close below and above shall come. Else cells are cut where the course leaves one
# bound for another, as often as this; where that would be too many, all are finer once.
_CELLS, _ENOUGH, _CUTS, _MOST = 120, 1e-4, 2, 320


@dataclass(frozen=True, eq=False)
class Together:
    """An enclosure of the largest error, and a course that comes close to it.

    Parameters
    ----------
    lower, upper : float
    knots : (L + 1,) array
        Seconds before the moment of the error.
    course : (m + 1, L) array
        phi and its derivatives (by time, backwards) at the beginning of each cell, the highest one over it.
    """

    lower: float
    upper: float
    knots: FloatArray
    course: FloatArray

    def at(self, before: FloatArray) -> FloatArray:
        """phi at times before the moment of the error, (N,).

        Parameters
        ----------
        before : (N,) array
            Seconds.
        """
        place = np.clip(np.searchsorted(self.knots, before, side="right") - 1, 0, len(self.knots) - 2)
        since = np.minimum(before, self.knots[-1]) - self.knots[place]
        terms = [part[place] * (-since) ** q / factorial(q) for q, part in enumerate(self.course)]
        return np.asarray(np.sum(terms, axis=0), dtype=float)


def together(cells: Cells, bounds: Mapping[int, float]) -> Together | None:
    """The enclosure for |phi^(j)| <= bounds[j], j = 0 included; None where the solver gives up.

    Parameters
    ----------
    cells : Cells
        Of the kernel from phi to the error.
    bounds : dict of int to float
        In units of ``cells.unit``: bounds of phi^(j) times unit^j.
    """
    best: Together | None = None
    grid = Grid.of(cells, bounds, _CELLS)
    for _ in range(1 + _CUTS):
        below, above = worst_course(grid), least_split(grid)
        if below is None or above is None:
            return best
        knots, (lower, course) = grid.knots * cells.unit, below
        scale = np.array([cells.unit**-q for q in range(len(course))])[:, None]
        found = Together(lower * cells.gain, above * cells.gain, knots, course * scale)
        if best is not None:  # either side of any grid counts, and the course belongs to the lower one
            source = found if found.lower >= best.lower else best
            found = Together(source.lower, min(found.upper, best.upper), source.knots, source.course)
        best = found
        if best.upper - best.lower <= _ENOUGH * best.upper:
            break
        finer = grid.refined(course[-1])
        if len(finer.widths) > _MOST:
            if len(grid.widths) > _CELLS:
                break
            finer = Grid.of(cells, bounds, 2 * _CELLS)
        grid = finer
    return best


def together_of(filter: PhyFilter | SampledPhyFilter, given: Mapping[int, float]) -> Together | None:
    """The enclosure for |gamma^(k)| <= given[k]; None where the kernel is too long or the solver gives up.

    Parameters
    ----------
    filter : PhyFilter or SampledPhyFilter
    given : dict of int to float
    """
    lowest = min(given)
    if isinstance(filter, SampledPhyFilter):
        cells = sampled_cells(SampledKernels(filter), lowest)
    else:
        cells = continuous_cells(kernels.error_kernel(filter, lowest))
    if cells is None:
        return None
    return together(cells, {k - lowest: value * cells.unit ** (k - lowest) for k, value in given.items()})
