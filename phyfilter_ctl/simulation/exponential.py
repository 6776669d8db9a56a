"""The exponential Runge-Kutta method: the linear part of a diagram is integrated exactly.

x' = A x + N(t, x, u): A holds the entries of df/dx that are constant. Krogstad's ETDRK4-B (J. Comput. Phys. 203, 2005)
of fourth order; exact where N depends on time alone and is at most quadratic in a step, as in a linear diagram
whose inputs run on straight lines. With A = 0 it is the classical Runge-Kutta method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import factorial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .._sections import FloatArray
from ..blocks.functions import dependencies
from ..diagram import FlatModel, structure
from .steps import KEPT, SYMBOLS, Layout, Results, compose, cut, renewed

__all__ = [
    "LinearPart",
    "advance_exponential",
    "has_linear_states",
    "is_driven_by_lines",
    "linear_part",
    "phi_functions",
    "tables",
]

# Matrices with more entries than this are multiplied as a whole: SX would make one instruction of each entry.
_DENSE = 20_000


@dataclass(frozen=True, eq=False)
class LinearPart:
    """Where A has entries, and how to compute them.

    Parameters
    ----------
    rows, columns : (m,) arrays
        Entries of df/dx that depend on parameters at most.
    entries : casadi.Function
        p -> (m,) values.
    groups : tuple of (k,) arrays
        States that A couples, directly or through others; A is block diagonal in them.
    complete : bool
        df/dx has no other entries: the diagram is linear in x.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    entries: ca.Function
    groups: tuple[NDArray[np.intp], ...]
    complete: bool


def _jacobian(flat: FlatModel, by: str) -> tuple[list[ca.SX], ca.Sparsity, ca.Function]:
    """Symbols t, x, u, p, z, and the nonzero entries of the derivatives' Jacobian by some of them, as a function."""
    sizes = [flat.dynamics.size1_in(i) for i in range(5)]
    dynamics = compose("dynamics", sizes, lambda t, x, u, p, z: (flat.dynamics(t, x, u, p, z),))
    kind = SYMBOLS[0 if dynamics.is_a("SXFunction") else 1]
    symbols = [kind.sym(name, size) for name, size in zip("txupz", sizes, strict=True)]
    jacobian = ca.jacobian(
        dynamics.call(symbols)[0], ca.vertcat(*(symbols["txupz".index(name)] for name in by))
    )
    return symbols, jacobian.sparsity(), ca.Function("jacobian", symbols, [jacobian.nz[:]])


@lru_cache(maxsize=KEPT)
def linear_part(flat: FlatModel) -> LinearPart:
    """The constant entries of df/dx, from its structure."""
    (t, x, u, p, z), sparsity, function = _jacobian(flat, "x")
    rows, columns = (np.array(part, dtype=np.intp) for part in sparsity.get_triplet())
    varying = np.zeros(len(rows), dtype=bool)
    for argument in (0, 1, 2, 4):
        varying |= dependencies(function, argument).any(axis=1)
    kept = np.flatnonzero(~varying)
    rows, columns = rows[kept], columns[kept]
    # Values of t, x, u and z do not matter; 1 rather than 0 keeps off the poles of what does not depend on them.
    ones = [ca.DM.ones(part.shape) for part in (t, x, u, z)]
    values = function(ones[0], ones[1], ones[2], p, ones[3])
    entries = ca.Function("entries", [p], [ca.densify(values[kept.tolist()])])
    n_x = len(flat.states)
    _, label = connected_components(coo_array((np.ones(len(rows)), (rows, columns)), shape=(n_x, n_x)), False)
    touched = np.zeros(n_x, dtype=bool)
    touched[rows] = touched[columns] = True
    order = np.argsort(label, kind="stable")
    groups = [
        group for group in np.split(order, np.flatnonzero(np.diff(label[order])) + 1) if touched[group].any()
    ]
    return LinearPart(rows, columns, entries, tuple(groups), not varying.any())


def has_linear_states(flat: FlatModel) -> bool:
    """Whether df/dx is constant: then the method is exact for what straight lines drive."""
    return linear_part(flat).complete and structure.is_affine(flat.dynamics, (1,))


@lru_cache(maxsize=KEPT)
def is_driven_by_lines(flat: FlatModel) -> bool:
    """Whether time and inputs, which are straight lines between the times, act on the derivatives as such."""
    _, _, function = _jacobian(flat, "tu")
    lines = not any(dependencies(function, argument).any() for argument in (0, 1, 2))
    return lines and structure.is_affine(flat.dynamics, (0, 2))


# e^{A h/2}, phi_1(A h/2), phi_2(A h/2), e^{A h}, phi_1, phi_2, phi_3 of A h; all but the exponentials times h.
_MATRICES = 7
_TERMS = 15


def tables(flat: FlatModel, p: FloatArray, steps: Sequence[float]) -> FloatArray:
    """The matrices of the method for some step lengths, (steps, entries), and those of A in front.

    Notes
    -----
    phi_k(Z) = sum_j Z^j / (j + k)!, phi_k(2 Z) = (e^Z phi_k(Z) + sum_{j=1..k} phi_j(Z) / (k - j)!) / 2^k.
    """
    part = linear_part(flat)
    values = np.asarray(part.entries(p), dtype=float).ravel()
    n_x = len(flat.states)
    A = coo_array((values, (part.rows, part.columns)), shape=(n_x, n_x)).tocsr()
    columns = []
    for h in steps:
        pieces = []
        for group in part.groups:
            block = A[group][:, group].toarray()
            half, whole = phi_functions(block * (h / 2)), phi_functions(block * h)
            pieces.append(
                np.stack([half[0], h / 2 * half[1], h * half[2], whole[0], *(h * phi for phi in whole[1:])])
            )
        columns.append(np.concatenate([values, *(piece.ravel() for piece in pieces)]))
    return np.array(columns).reshape(len(steps), -1)


def phi_functions(Z: FloatArray) -> list[FloatArray]:
    """e^Z, phi_1(Z), phi_2(Z), phi_3(Z).

    Scaling and doubling, with e^Z - I in place of e^Z: a slow pole beside a fast one survives that many squarings.
    """
    scaled, (factors, _) = matrix_balance(Z, permute=False, separate=True)
    eye = np.eye(len(Z))
    doublings = max(0, int(np.ceil(np.log2(max(np.linalg.norm(scaled, 1), 1e-300)))) + 1)
    small = scaled / 2.0**doublings  # norm at most 1/2: 15 terms of the series are enough
    third = eye / factorial(_TERMS + 3)
    for k in range(_TERMS - 1, -1, -1):
        third = small @ third + eye / factorial(k + 3)
    second = small @ third + eye / 2
    first = small @ second + eye
    delta = small @ first
    for _ in range(doublings):
        third = (delta @ third + 2 * third + second + first / 2) / 8
        second = (delta @ second + 2 * second + first) / 4
        first = first + delta @ first / 2
        delta = 2 * delta + delta @ delta
    return [factors[:, None] * part / factors for part in (delta + eye, first, second, third)]


@lru_cache(maxsize=KEPT)
def _step(flat: FlatModel) -> ca.Function:
    """(state, data, p, matrices) -> state."""
    part, layout = linear_part(flat), Layout(flat)
    n_x, _, n_z = layout.sizes
    free = np.setdiff1d(np.arange(n_x), np.concatenate([np.zeros(0, dtype=np.intp), *part.groups]))
    places = [(group, np.arange(_MATRICES * len(group) ** 2).reshape(_MATRICES, -1)) for group in part.groups]

    def body(state: ca.SX, data: ca.SX, p: ca.SX, matrices: ca.SX) -> Results:
        x, s = cut(state, slice(n_x)), cut(state, slice(n_x, layout.state - n_z))
        z = cut(state, slice(layout.state - n_z, None))
        t, h = data[0], data[1]
        u = [cut(data, layout.input(stage)) for stage in range(3)]
        sparsity = ca.Sparsity.triplet(n_x, n_x, part.rows.tolist(), part.columns.tolist())
        order = np.lexsort((part.rows, part.columns)).tolist()
        A = type(state)(sparsity, matrices[order]) if order else type(state)(n_x, n_x)

        def nonlinear(time: ca.SX, x: ca.SX, u: ca.SX) -> ca.SX:
            return flat.dynamics(time, x, u, p, z) - ca.mtimes(A, x)

        offset = len(part.rows)
        blocks = []
        for group, place in places:
            m = len(group)
            # Row by row in the table, column by column in CasADi.
            blocks.append([ca.reshape(matrices[(offset + row).tolist()], m, m).T for row in place])
            offset += place.size
        order_of = np.argsort(np.concatenate([*part.groups, free])).tolist()

        def times(index: int, vector: ca.SX, outside: ca.SX | float) -> ca.SX:
            pieces = [
                ca.mtimes(M[index], vector[g.tolist()]) for M, (g, _) in zip(blocks, places, strict=True)
            ]
            if len(free):
                pieces.append(outside * vector[free.tolist()])
            return ca.vertcat(*pieces)[order_of]

        # Where A is 0, the matrices are 1, 1/2 ... times h.
        n1 = nonlinear(t, x, u[0])
        e_half = times(0, x, 1.0)
        stage2 = e_half + times(1, n1, h / 2)
        n2 = nonlinear(t + h / 2, stage2, u[1])
        stage3 = stage2 + times(2, n2 - n1, h / 2)
        n3 = nonlinear(t + h / 2, stage3, u[1])
        base = times(3, x, 1.0) + times(4, n1, h)
        stage4 = base + 2.0 * times(5, n3 - n1, h / 2)
        n4 = nonlinear(t + h, stage4, u[2])
        after = base + times(5, -3.0 * n1 + 2.0 * n2 + 2.0 * n3 - n4, h / 2)
        after += 4.0 * times(6, n1 - n2 - n3 + n4, h / 6)
        return (ca.vertcat(after, s, renewed(flat, t + h, after, u[2], p, z)),)

    size = len(part.rows) + sum(place.size for _, place in places)
    kinds = SYMBOLS if size <= _DENSE else SYMBOLS[1:]
    return compose("pf_etdrk4", [layout.state, layout.data, len(flat.parameters), size], body, kinds)


@lru_cache(maxsize=KEPT)
def advance_exponential(flat: FlatModel, capacity: int) -> ca.Function:
    """A step whose p is followed by ``capacity`` columns of matrices; data[table] chooses one of them."""
    step, layout = _step(flat), Layout(flat)
    size, n_p = step.size1_in(3), len(flat.parameters)
    MX = SYMBOLS[1]
    state, data = MX.sym("state", layout.state), MX.sym("data", layout.data)
    p = MX.sym("p", n_p + capacity * size)
    if capacity == 1 or size == 0:
        matrices = cut(p, slice(n_p, n_p + size))
    else:
        columns: Any = p[n_p:]  # casadi's types do not know indices that are computed
        matrices = columns.get_nz(False, MX(ca.DM(range(size))) + size * data[layout.table])
    return ca.Function("pf_exponential", [state, data, p], [step(state, data, cut(p, slice(n_p)), matrices)])
