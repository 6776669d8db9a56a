"""Algebraic loops tau = F(tau): affine ones solved, nonlinear ones prepared for Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .rootfinding import TOLERANCE, solver

Expression: TypeAlias = ca.SX
"""Scalar expressions as a rule; the same code runs on MX where a block has no scalar form."""

__all__ = ["Expression", "NewtonLoop", "affine_solution", "newton_function", "start_solutions"]

SINGULAR = (
    1e-12  # smallest over largest singular value of 1 - dF/dtau below which the loop has no single solution
)
# Two solutions found from different starts are one where they differ by less, relative to their size.
_SAME = 1e-6

_WAYS_OUT = "put a lag, a unit delay or a sampled block into it, or change a gain"


@dataclass(frozen=True, eq=False)
class NewtonLoop:
    """A loop that is solved wherever the model is evaluated.

    Parameters
    ----------
    tau : casadi symbol
        Its unknowns.
    start : casadi symbol
        Where the search for them begins: as they were at the last instant.
    entered : casadi expression
        What enters the loop, of (t, x, u, p, z) and of the unknowns of loops before this one.
    residual : casadi.Function
        (tau, entered, t, x, p) -> F(tau) - tau.
    solutions : (k, n) array
        Those found at the start values; the first is the one that a run starts from.
    names : tuple of str
        Signals that the unknowns are.
    path : str
        Signals along the loop.
    """

    tau: Expression
    start: Expression
    entered: Expression
    residual: ca.Function
    solutions: NDArray[np.float64]
    names: tuple[str, ...]
    path: str


def affine_solution(
    matrix: ca.Function,
    constant: ca.Function,
    entered: Expression,
    symbols: Sequence[Expression],
    places: Sequence[Sequence[NDArray[np.float64]]],
    path: str,
) -> Expression:
    """tau = (1 - J)^-1 F(0) of tau = F(0) + J tau.

    Parameters
    ----------
    matrix : casadi.Function
        (entered, t, x, p) -> J.
    constant : casadi.Function
        (tau, entered, t, x, p) -> F.
    entered : casadi expression
    symbols : sequence of casadi symbols
        t, x, u, p, z.
    places : sequence of (entered, t, x, p)
        Numbers at which a matrix that is not constant is tried.
    path : str

    Returns
    -------
    casadi expression

    Raises
    ------
    ValueError
        If 1 - J is singular.
    """
    t, x, _, p, _ = symbols
    n = matrix.size1_out(0)
    offset = constant.call([np.zeros(n), entered, t, x, p], True, False)[0]
    numbers = [np.eye(n) - np.asarray(matrix(*place), dtype=float) for place in places]
    if all(_is_singular(M) for M in numbers):
        raise ValueError(
            f"algebraic loop {path} is singular: the signals on it have no solution or many; {_WAYS_OUT}"
        )
    if not any(dependence.nnz() for dependence in _dependence(matrix)):
        return ca.mtimes(ca.sparsify(ca.DM(np.linalg.inv(numbers[0]))), offset)
    M = ca.DM.eye(n) - matrix.call([entered, t, x, p], True, False)[0]
    return offset / M if n == 1 else ca.solve(ca.densify(M), offset)


def _dependence(function: ca.Function) -> list[ca.Sparsity]:
    return [function.jac_sparsity(0, i) for i in range(function.n_in())]


def _is_singular(matrix: NDArray[np.float64]) -> bool:
    if not np.all(np.isfinite(matrix)):
        return False  # undefined here, not singular: another place decides
    values = np.linalg.svd(matrix, compute_uv=False)
    return bool(values[-1] <= SINGULAR * max(1.0, values[0]))


def start_solutions(
    residual: ca.Function, places: Sequence[Sequence[NDArray[np.float64]]], path: str
) -> NDArray[np.float64]:
    """Solutions of a nonlinear loop at the first place that has one, from several starts; 0 first.

    Parameters
    ----------
    residual : casadi.Function
        (tau, entered, t, x, p) -> F(tau) - tau.
    places : sequence of (entered, t, x, p)
    path : str

    Returns
    -------
    (k, n) array

    Raises
    ------
    ValueError
        If none is found, or the loop is singular around it.
    """
    n = residual.size1_in(0)
    derivative, solve = residual.jacobian(), solver(residual, "start", 1.0)
    rng = np.random.default_rng(11)

    def slope(tau: NDArray[np.float64], place: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        result = derivative(tau, *place, np.zeros(n))
        first = result[0] if isinstance(result, tuple) else result
        return np.asarray(first, dtype=float)

    def same(
        tau: NDArray[np.float64], other: NDArray[np.float64], place: Sequence[NDArray[np.float64]]
    ) -> bool:
        """A multiple root is met to few digits: what lies between the two is a solution too."""
        size = 1.0 + float(np.max(np.abs(tau)))
        middle = np.asarray(residual(0.5 * (tau + other), *place), dtype=float)
        return bool(np.max(np.abs(tau - other)) <= _SAME * size or np.max(np.abs(middle)) <= TOLERANCE * size)

    for place in places:
        found: list[NDArray[np.float64]] = []
        for start in (np.zeros(n), np.ones(n), *rng.normal(size=(4, n)), *(10.0 * rng.normal(size=(4, n)))):
            tau = np.asarray(solve(start, *place), dtype=float).reshape(-1)
            if np.all(np.isfinite(tau)) and not any(same(tau, other, place) for other in found):
                found.append(tau)
        if not found:
            continue
        around = [found[0], *(found[0] + 0.3 * (1.0 + np.abs(found[0])) * rng.normal(size=(3, n)))]
        if all(_is_singular(slope(tau, place)) for tau in around):
            raise ValueError(
                f"algebraic loop {path} is singular: the signals on it have many solutions; {_WAYS_OUT}"
            )
        return np.array(found)
    raise ValueError(f"algebraic loop {path}: no solution found at the start values; {_WAYS_OUT}")


def newton_function(loops: Sequence[NewtonLoop], symbols: Sequence[Expression]) -> ca.Function:
    """(t, x, u, p, z, starts) -> the unknowns of all loops, below each other.

    Parameters
    ----------
    loops : sequence of NewtonLoop
    symbols : sequence of casadi symbols
        t, x, u, p, z of the loops' expressions.

    Returns
    -------
    casadi.Function

    Notes
    -----
    The unknowns are not-a-number where no solution is found, and so is all that depends on them.
    """
    outer = [ca.MX.sym(name, symbol.shape[0]) for name, symbol in zip("txupz", symbols, strict=True)]
    starts = [ca.MX.sym(f"start{i}", loop.tau.shape[0]) for i, loop in enumerate(loops)]
    t, x, _, p, _ = outer
    known: list[ca.MX] = []
    for i, loop in enumerate(loops):
        entered = ca.Function(
            f"entered{i}", [*symbols, *(before.tau for before in loops[:i])], [loop.entered]
        )
        scale = 1.0 + float(np.max(np.abs(loop.solutions[0])))
        solve = solver(loop.residual, f"loop{i}", scale)
        known.append(solve(starts[i], entered(*outer, *known), t, x, p))
    return ca.Function("unknowns", [*outer, *starts], [ca.vertcat(*known)])
