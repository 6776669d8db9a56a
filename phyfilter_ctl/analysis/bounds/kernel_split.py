"""The best split of a kernel among several bounded derivatives: an upper bound that holds whatever the solver does."""

from __future__ import annotations

from collections.abc import Mapping
from math import factorial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array, hstack, vstack
from scipy.sparse import eye as identity

from ..._sections import FloatArray
from .cells import halving
from .grid import Grid, bernstein, ends

__all__ = ["least_split"]

# Rounding of the sums, relative.
_SUMS = 1e-13


def least_split(grid: Grid) -> float | None:
    """An upper bound; None where the solver gives up.

    Parameters
    ----------
    grid : Grid
    """
    unknowns, m, M = _Unknowns(grid), grid.m, len(grid.owner)
    particular = grid.integrals({}, np.append([0.0, grid.cells.direct], np.zeros(m + 1)))
    equal, right = _propagation(unknowns, [float(ends(part)[-1]) for part in particular[1 : m + 1]])
    inner = _values(unknowns)
    gap = hstack([csr_array((2 * M, unknowns.slack)), -identity(2 * M)])
    halfway = 0.5 ** np.arange(particular[m].shape[1])
    known = np.concatenate([particular[m][:, 0], particular[m] @ halfway])
    free = m * (len(grid.widths) + 1)
    found = linprog(
        unknowns.cost(),
        A_ub=vstack([inner + gap, -inner + gap]),
        b_ub=np.concatenate([-known, known]),
        A_eq=equal,
        b_eq=right,
        bounds=[(None, None)] * free + [(0.0, None)] * (unknowns.count - free),
        method="highs",
    )
    return None if found.x is None else _certified(grid, *unknowns.split(found.x))


class _Unknowns:
    """Where each unknown stands: what densities and atoms add to A_1 ... A_m at the knots; the densities of each order
    below m at both ends of a cell, the atoms at 0 and what is left at T, each as the difference of two that are not
    negative; |A_m| at the beginning and in the middle of each of the kernel's cells."""

    def __init__(self, grid: Grid) -> None:
        self.grid, self.L = grid, len(grid.widths)
        self.orders = [j for j in sorted(grid.D) if j < grid.m]
        self.densities = grid.m * (self.L + 1)
        self.atoms = self.densities + 4 * len(self.orders) * self.L
        self.left = self.atoms + 2 * len(self.orders)
        self.slack = self.left + 2 * grid.m
        self.count = self.slack + 2 * len(grid.owner)

    def knot(self, r: int, i: NDArray[np.intp]) -> NDArray[np.intp]:
        """A_r at knots i."""
        return (r - 1) * (self.L + 1) + i

    def density(self, p: int, place: int, cell: NDArray[np.intp]) -> NDArray[np.intp]:
        """Of the p-th order at the beginning (0) or end (1) of cells; what is taken off follows L later."""
        return self.densities + (4 * p + 2 * place) * self.L + cell

    def cost(self) -> FloatArray:
        """What the upper bound is made of, |A_m| by the trapezoidal rule."""
        grid, cost = self.grid, np.zeros(self.count)
        M, lengths = len(grid.owner), grid.cells.lengths
        for p, j in enumerate(self.orders):
            first = self.densities + 4 * p * self.L
            cost[first : first + 4 * self.L] = grid.D[j] * np.tile(0.5 * grid.widths, 4)
            cost[self.atoms + 2 * p : self.atoms + 2 * p + 2] = grid.D[j]
        for r in range(grid.m):
            cost[self.left + 2 * r : self.left + 2 * r + 2] = grid.implied(r)
        cost[self.slack : self.slack + M] = grid.D[grid.m] * 0.25 * (lengths + np.append(0.0, lengths[:-1]))
        cost[self.slack + M :] = grid.D[grid.m] * 0.5 * lengths
        return cost

    def split(self, x: FloatArray) -> tuple[dict[int, FloatArray], dict[int, float]]:
        """Densities (2, L) and atoms by order."""
        densities, atoms = {}, {}
        for p, j in enumerate(self.orders):
            first = self.densities + 4 * p * self.L
            begin, off_begin, end, off_end = x[first : first + 4 * self.L].reshape(4, self.L)
            densities[j] = np.stack([begin - off_begin, end - off_end])
            atoms[j] = float(x[self.atoms + 2 * p] - x[self.atoms + 2 * p + 1])
        return densities, atoms


class _Entries:
    """Of a sparse matrix, as they come."""

    def __init__(self) -> None:
        self.rows: list[NDArray[np.intp]] = []
        self.columns: list[NDArray[np.intp]] = []
        self.values: list[FloatArray] = []

    def add(self, rows: NDArray[np.intp], columns: NDArray[np.intp], values: FloatArray) -> None:
        self.rows.append(rows)
        self.columns.append(columns)
        self.values.append(values)

    def matrix(self, shape: tuple[int, int]) -> csr_array:
        """Of a shape."""
        at = (np.concatenate(self.rows), np.concatenate(self.columns))
        return csr_array((np.concatenate(self.values), at), shape=shape)


def _propagation(unknowns: _Unknowns, at_end: list[float]) -> tuple[csr_array, FloatArray]:
    """The A_r over each cell, at 0 and at T; ``at_end`` what the kernel alone leaves there."""
    grid, L, d, found = unknowns.grid, unknowns.L, unknowns.grid.widths, _Entries()
    cell, right = np.arange(L), np.zeros(grid.m * (L + 2))
    for r in range(1, grid.m + 1):
        rows = (r - 1) * L + cell
        for q in range(r):
            found.add(rows, unknowns.knot(r - q, cell), d**q / factorial(q))
        found.add(rows, unknowns.knot(r, cell + 1), -np.ones(L))
        _add_densities(found, unknowns, rows, r, d, cell)
    for r in range(1, grid.m + 1):
        row = grid.m * L + 2 * (r - 1)
        at_0, at_T = _one(row), _one(row + 1)
        found.add(at_0, unknowns.knot(r, _one(0)), np.ones(1))
        found.add(at_T, unknowns.knot(r, _one(L)), np.ones(1))
        for sign, place in ((1.0, 0), (-1.0, 1)):
            if r - 1 in unknowns.orders:
                atom = unknowns.atoms + 2 * unknowns.orders.index(r - 1) + place
                found.add(at_0, _one(atom), np.array([sign]))
            found.add(at_T, _one(unknowns.left + 2 * (r - 1) + place), np.array([-sign]))
        right[row + 1] = -at_end[r - 1]
    return found.matrix((len(right), unknowns.count)), right


def _values(unknowns: _Unknowns) -> csr_array:
    """A_m, less the kernel's own, at the beginning and in the middle of each of the kernel's cells."""
    grid, found = unknowns.grid, _Entries()
    owner = np.tile(grid.owner, 2)
    rows = np.arange(len(owner))
    since = np.concatenate([grid.since, grid.since + 0.5 * grid.cells.lengths])
    for q in range(grid.m):
        found.add(rows, unknowns.knot(grid.m - q, owner), since**q / factorial(q))
    _add_densities(found, unknowns, rows, grid.m, since, owner)
    return found.matrix((len(owner), unknowns.count))


def _add_densities(
    found: _Entries,
    unknowns: _Unknowns,
    rows: NDArray[np.intp],
    r: int,
    since: FloatArray,
    cell: NDArray[np.intp],
) -> None:
    """What the densities of a cell take off A_r until some time after its beginning."""
    width = unknowns.grid.widths[cell]
    for p, j in enumerate(unknowns.orders):
        if j < r:
            last = since ** (r - j + 1) / (width * factorial(r - j + 1))
            for place, share in enumerate((since ** (r - j) / factorial(r - j) - last, last)):
                at = unknowns.density(p, place, cell)
                found.add(rows, at, -share)
                found.add(rows, at + unknowns.L, share)


def _certified(grid: Grid, split: Mapping[int, FloatArray], atoms: Mapping[int, float]) -> float:
    """The upper bound that a split proves, its areas enclosed."""
    m, d = grid.m, grid.widths
    start = np.zeros(m + 3)
    start[1] = grid.cells.direct
    for j, value in atoms.items():
        start[j + 1] -= value
    parts = grid.integrals(split, start)
    total = sum(
        grid.D[j] * (float(0.5 * d @ np.abs(k).sum(axis=0)) + abs(atoms[j])) for j, k in split.items()
    )
    total += grid.D[m] * _area_above(parts[m], grid.cells.lengths)
    total += grid.D[m] * float(grid.knots[-1]) * grid.error(m)
    for r in range(m):
        total += grid.implied(r) * (abs(float(ends(parts[r + 1])[-1])) + grid.error(r + 1))
    return (total + grid.D[0] * grid.cells.tail) * (1.0 + _SUMS)


def _one(index: int) -> NDArray[np.intp]:
    return np.array([index], dtype=np.intp)


def _area_above(polynomials: FloatArray, lengths: FloatArray) -> float:
    """Integral of |polynomials| from above; cells where Bernstein's coefficients differ in sign are halved 8 times."""
    total, matrix = 0.0, bernstein(polynomials.shape[1] - 1)
    halves = halving(polynomials.shape[1])
    for last in (*[False] * 8, True):
        hull = polynomials @ matrix.T
        mixed = (hull.min(axis=1) < 0.0) & (hull.max(axis=1) > 0.0)
        plain = ~mixed
        total += float(lengths[plain] @ np.abs(hull[plain].mean(axis=1)))  # the mean of a polynomial
        if last:
            return total + float(lengths[mixed] @ np.abs(hull[mixed]).mean(axis=1))
        polynomials = np.concatenate([polynomials[mixed] @ half for half in halves])
        lengths = 0.5 * np.tile(lengths[mixed], 2)
    return total
