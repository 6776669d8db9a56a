"""The worst course of a residual with several derivatives bounded: a lower bound that is attained."""

from __future__ import annotations

from math import factorial

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_array, hstack, vstack

from ..._sections import FloatArray
from .grid import Grid, bernstein, ends

__all__ = ["worst_course"]

# Rounding of the sums, relative.
_SUMS = 1e-13


def worst_course(grid: Grid) -> tuple[float, FloatArray] | None:
    """A lower bound, and its course (m + 1, L); None where the solver gives up.

    Parameters
    ----------
    grid : Grid
    """
    m, L, d = grid.m, len(grid.widths), grid.widths
    start = np.zeros(m + 3)
    start[1] = grid.cells.direct
    parts = grid.integrals({}, start)
    areas = np.bincount(grid.owner, ends(parts[m + 1]) - parts[m + 1][:, 0], minlength=L)
    at_end = np.array([ends(parts[r + 1])[-1] for r in range(m)])
    # Unknown: phi_r at the knots, r = 0 ... m - 1, then v over the cells; backwards: phi_r' = -phi_(r+1).
    size = L + 1
    blocks = []
    for r in range(m):
        row = []
        for q in range(m):
            if q < r:
                row.append(csr_array((L, size)))
            else:
                step = _banded((-d) ** (q - r) / factorial(q - r), size, 0)
                row.append(step - _banded(np.ones(L), size, 1) if q == r else step)
        row.append(csr_array(np.diag((-d) ** (m - r) / factorial(m - r))))
        blocks.append(hstack(row))
    # Between the knots: the inner Bernstein coefficients of phi_j keep its bound too.
    inner: list[csr_array] = []
    tops: list[FloatArray] = []
    for j in (j for j in grid.D if j <= m - 2):
        matrix = bernstein(m - j)
        for i in range(1, m - j):
            row = [csr_array((L, size)) for _ in range(m)] + [csr_array((L, L))]
            for q in range(i + 1):
                row[j + q] = _banded(matrix[i, q] * (-d) ** q / factorial(q), size, 0)
            inner.append(csr_array(hstack(row)))
            tops.append(np.full(L, grid.D[j]))
    limits = []
    for r in range(m):
        top = grid.D.get(r, np.inf)
        limits += [(-top, top)] * L + [(-top, top) if r == 0 else (0.0, 0.0)]  # goes on as a constant
    limits += [(-grid.D[m], grid.D[m])] * L
    cost = np.zeros(m * size + L)
    cost[[r * size + L for r in range(m)]] = -at_end
    cost[m * size :] = -areas
    found = linprog(
        cost,
        A_ub=vstack([*inner, *[-part for part in inner]]) if inner else None,
        b_ub=np.concatenate([*tops, *tops]) if inner else None,
        A_eq=vstack(blocks),
        b_eq=np.zeros(m * L),
        bounds=limits,
        method="highs",
    )
    if found.x is None:
        return None
    # Once more from the highest derivative, which the solver's tolerances cannot spoil; then within every bound.
    v = np.clip(found.x[m * size :], -grid.D[m], grid.D[m])
    course = np.zeros((m + 1, L))
    course[m] = v
    state = np.zeros(m)
    state[0] = found.x[L]
    end = state[0]
    for i in range(L - 1, -1, -1):
        tail = np.append(state, v[i])
        state = np.array(
            [sum(d[i] ** (q - r) / factorial(q - r) * tail[q] for q in range(r, m + 1)) for r in range(m)]
        )
        course[:m, i] = state
    largest = 1.0
    for j, bound in grid.D.items():
        if bound > 0.0:
            degree = m - j
            taylor = np.array([course[j + q] * (-d) ** q / factorial(q) for q in range(degree + 1)])
            largest = max(largest, float(np.abs(bernstein(degree) @ taylor).max()) / bound)
    value = (float(at_end[0] * end + areas @ v)) / largest
    doubt = grid.D[m] * float(grid.knots[-1]) * grid.error(m) + grid.error(1) * grid.D[0]
    value *= 1.0 - _SUMS
    return max(value - doubt - grid.D[0] * grid.cells.tail, 0.0), course / largest


def _banded(values: FloatArray, size: int, offset: int) -> csr_array:
    rows = np.arange(len(values))
    return csr_array((values, (rows, rows + offset)), shape=(len(values), size))
