"""Algebraic loops tau = F(tau): affine ones solved, nonlinear ones prepared for Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

Expression: TypeAlias = ca.SX
"""Scalar expressions as a rule; the same code runs on MX where a block has no scalar form."""

__all__ = ["Expression", "NewtonLoop", "affine_solution", "newton_function", "nominal_solution"]

SINGULAR = (
    1e-12  # smallest over largest singular value of 1 - dF/dtau below which the loop has no single solution
)
TOLERANCE = 1e-9  # of a solution, relative to it: what Newton's method leaves must be below
ITERATIONS = 50  # Newton's method needs 4 to 8 where it converges

_LARGEST = 1e300

_WAYS_OUT = "put a lag, a unit delay or a sampled block into it, or change a gain"


@dataclass(frozen=True, eq=False)
class NewtonLoop:
    """A loop that is solved wherever the model is evaluated.

    Parameters
    ----------
    tau : casadi symbol
        Its unknowns.
    entered : casadi expression
        What enters the loop, of (t, x, u, p, z) and of the unknowns of loops before this one.
    residual : casadi.Function
        (tau, entered, t, x, p) -> F(tau) - tau.
    guess : (n,) array
        Where Newton's method starts: the solution at the start values.
    path : str
        Signals along the loop.
    """

    tau: Expression
    entered: Expression
    residual: ca.Function
    guess: NDArray[np.float64]
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


def nominal_solution(
    residual: ca.Function, places: Sequence[Sequence[NDArray[np.float64]]], path: str
) -> NDArray[np.float64]:
    """A solution of a nonlinear loop at the first place that has one.

    Parameters
    ----------
    residual : casadi.Function
        (tau, entered, t, x, p) -> F(tau) - tau.
    places : sequence of (entered, t, x, p)
    path : str

    Returns
    -------
    (n,) array

    Raises
    ------
    ValueError
        If none is found, or the loop is singular around it.
    """
    n = residual.size1_in(0)
    derivative = residual.jacobian()
    rng = np.random.default_rng(11)

    def slope(tau: NDArray[np.float64], place: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        result = derivative(tau, *place, np.zeros(n))
        first = result[0] if isinstance(result, tuple) else result
        return np.asarray(first, dtype=float)

    for place in places:
        for start in (np.zeros(n), np.ones(n), *rng.normal(size=(4, n)), *(10.0 * rng.normal(size=(4, n)))):

            def value(
                tau: NDArray[np.float64], place: Sequence[NDArray[np.float64]] = place
            ) -> NDArray[np.float64]:
                return np.asarray(residual(tau, *place), dtype=float).reshape(-1)

            if not np.all(np.isfinite(value(start))):
                continue
            with np.errstate(all="ignore"):
                found = root(value, start, tol=1e-13).x
            if not np.max(np.abs(value(found))) <= TOLERANCE * (1.0 + np.max(np.abs(found))):
                continue
            around = [found, *(found + 0.3 * (1.0 + np.abs(found)) * rng.normal(size=(3, n)))]
            if all(_is_singular(slope(tau, place)) for tau in around):
                raise ValueError(
                    f"algebraic loop {path} is singular: the signals on it have many solutions; {_WAYS_OUT}"
                )
            return found
    raise ValueError(f"algebraic loop {path}: no solution found at the start values; {_WAYS_OUT}")


def newton_function(loops: Sequence[NewtonLoop], symbols: Sequence[Expression]) -> ca.Function:
    """(t, x, u, p, z) -> the unknowns of all loops, below each other.

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
    Newton's method without damping from the solution at the start values, as CasADi's ``fast_newton``, which C code
    can be made from. The unknowns are not-a-number where it does not get there, and so is all that depends on them.
    """
    outer = [ca.MX.sym(name, symbol.shape[0]) for name, symbol in zip("txupz", symbols, strict=True)]
    t, x, _, p, _ = outer
    known: list[ca.MX] = []
    for i, loop in enumerate(loops):
        entered = ca.Function(
            f"entered{i}", [*symbols, *(before.tau for before in loops[:i])], [loop.entered]
        )
        arguments = [entered(*outer, *known), t, x, p]
        scale = 1.0 + float(np.max(np.abs(loop.guess)))
        solver = ca.rootfinder(
            f"loop{i}",
            "fast_newton",
            loop.residual,
            {
                "error_on_fail": False,
                "abstol": 1e-13 * scale,
                "abstolStep": 1e-14 * scale,
                "max_iter": ITERATIONS,
            },
        )
        tau = solver(loop.guess, *arguments)
        # Sums, which keep a not-a-number where a maximum may drop it; an infinite one is no solution either.
        left = ca.sum1(ca.fabs(loop.residual(tau, *arguments)))
        size = ca.sum1(ca.fabs(tau))
        solved = ca.logic_and(left <= TOLERANCE * (1.0 + size), size < _LARGEST)
        known.append(ca.if_else(solved, tau, np.nan * np.ones(len(loop.guess))))
    return ca.Function("unknowns", outer, [ca.vertcat(*known)])
