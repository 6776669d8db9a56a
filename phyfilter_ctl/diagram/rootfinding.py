"""Solutions of F(tau) = tau from a known start, as CasADi functions that C code can be made from.

Newton's method from the start; where it fails, a bracket closed by halving (one unknown), or Levenberg's damped
Gauss-Newton steps with a line search and, last, Newton's homotopy, followed along its arc length through folds
(Allgower and Georg, "Introduction to Numerical Continuation Methods", 2003, chapters 2 and 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import casadi as ca
import numpy as np

__all__ = ["QUICK", "TOLERANCE", "is_solution", "solver"]

TOLERANCE = 1e-9  # of a solution, relative to it: what Newton's method leaves must be below
QUICK = "pf_quick_"  # of names of Newton's methods that may fail: another follows them

_ITERATIONS, _QUICK_ITERATIONS = 50, 15  # Newton's method needs 2 to 8 where it converges
_LARGEST = 1e300
_GRID, _CANDIDATES = 100, 6
_HALVINGS = 200  # an interval of 1e12 down to rounding, and to 1e-45 where the root is 0
_DAMPED = 40
_REFINEMENTS = 4
_ARCS = 300
_CORRECTIONS = 4

# Typed as if all were SX: MX has the same operations.
_MX = cast(type[ca.SX], ca.MX)


def solver(residual: ca.Function, name: str, scale: float) -> ca.Function:
    """(start, arguments ...) -> the solution that the start leads to; not-a-number where none is found.

    Parameters
    ----------
    residual : casadi.Function
        (tau, arguments ...) -> F(tau) - tau.
    name : str
    scale : float
        Size of the numbers, for the stopping rule of Newton's method.

    Returns
    -------
    casadi.Function

    Notes
    -----
    Its derivatives are those of the implicit function; those by the start are 0.
    """
    options = {"error_on_fail": False, "abstol": 1e-13 * scale, "abstolStep": 1e-14 * scale}
    quick = ca.rootfinder(QUICK + name, "fast_newton", residual, options | {"max_iter": _QUICK_ITERATIONS})
    final = ca.rootfinder(f"pf_{name}", "fast_newton", residual, options | {"max_iter": _ITERATIONS})
    start, *given = _symbols(residual)
    tried = quick(start, *given)
    tau = _else(_rescue(residual), residual, [tried, *given], [start, *given])
    tau = final(tau, *given)
    solved = ca.if_else(is_solution(residual, tau, given), tau, np.nan * np.ones(tau.shape[0]))
    # Inlined in scalar expressions, both sides of the choice would be evaluated.
    return ca.Function(name, [start, *given], [solved], {"never_inline": True})


def is_solution(residual: ca.Function, tau: ca.SX, given: Sequence[ca.SX]) -> ca.SX:
    """Whether an expression solves a loop; false for what is not a number."""
    # Sums, which keep a not-a-number where a maximum may drop it; an infinite one is no solution either.
    left, size = ca.sum1(ca.fabs(residual(tau, *given))), ca.sum1(ca.fabs(tau))
    return ca.logic_and(left <= TOLERANCE * (1.0 + size), size < _LARGEST)


def _symbols(residual: ca.Function) -> list[ca.SX]:
    return [_MX.sym(f"i{i}", residual.size1_in(i)) for i in range(residual.n_in())]


def _else(
    otherwise: ca.Function, residual: ca.Function, tried: Sequence[ca.SX], given: Sequence[ca.SX]
) -> ca.SX:
    """tried[0] where that is a solution; only where it is none, the function is called."""
    symbols = _symbols(residual)
    spare = [_MX.sym(f"j{i}", symbol.shape[0]) for i, symbol in enumerate(symbols)]
    passing = ca.Function("passing", [*symbols, *spare], [symbols[0]])
    calling = ca.Function("calling", [*symbols, *spare], [otherwise(*spare)])
    choice = ca.Function.if_else("choice", passing, calling)
    return choice(is_solution(residual, tried[0], tried[1:]), *tried, *given)


def _rescue(residual: ca.Function) -> ca.Function:
    """(start, arguments ...) -> a solution, or nearly one, where Newton's method finds none."""
    if residual.size1_in(0) == 1:
        return _bracketed(residual)
    damped, homotopy = _damped(residual), _homotopy(residual)
    start, *given = _symbols(residual)
    far = damped(homotopy(start, *given), *given)
    last = ca.Function("last", [start, *given], [far])
    near = [damped(start, *given), *given]
    return ca.Function("rescue", [start, *given], [_else(last, residual, near, [start, *given])])


def _bracketed(residual: ca.Function) -> ca.Function:
    """The solution nearest to the start that lies at a change of sign, or near an edge of where F is defined."""
    start, *given = _symbols(residual)
    # A little more to one side than to the other: of two equally near, the same one is taken everywhere.
    steps = np.geomspace(1e-6, 1e6, _GRID)
    grid = np.concatenate([-1.0001 * steps[::-1], [0.0], steps])
    places = start + (1.0 + ca.fabs(start)) * ca.DM(grid)
    values = _mapped(residual, places.T, given).T
    order = sorted(range(len(grid) - 1), key=lambda k: -float(np.min(np.abs(grid[k : k + 2]))))
    after = [k + 1 for k in order]
    pairs = ca.horzcat(places[order], values[order], places[after], values[after]).T
    # Edges first: what comes later stands further in front.
    found = ca.DM.nan(3, _CANDIDATES)
    for candidate in (_edge(), _change()):
        found = _listed(candidate).fold(len(order))(found, pairs)
    halving = _halving(residual).fold(_HALVINGS)
    ends = _MX.sym("ends", 3)
    closed = halving(ends, *(ca.repmat(part, 1, _HALVINGS) for part in given))
    root = ca.Function("root", [ends, *given], [closed[0]])
    roots = _mapped(root, found, given)
    left = _mapped(residual, roots, given)
    best = start
    for k in reversed(range(_CANDIDATES)):
        best = ca.if_else(ca.fabs(left[k]) <= TOLERANCE * (1.0 + ca.fabs(roots[k])), roots[k], best)
    return ca.Function("bracketed", [start, *given], [best])


def _mapped(function: ca.Function, columns: ca.SX, given: Sequence[ca.SX]) -> ca.SX:
    count = columns.shape[1]
    return function.map(count)(columns, *(ca.repmat(part, 1, count) for part in given))


def _listed(candidate: ca.Function) -> ca.Function:
    """(list, interval) -> the list with an end, another end and the value at the first in front where it qualifies."""
    known, pair = ca.SX.sym("known", 3, _CANDIDATES), ca.SX.sym("pair", 4)
    qualifies, new = candidate(pair)
    longer = ca.horzcat(new, known[:, :-1])
    return ca.Function("listed", [known, pair], [ca.if_else(qualifies, longer, known)])


def _change() -> ca.Function:
    pair = ca.SX.sym("pair", 4)
    at, value, next_at, next_value = ca.vertsplit(pair)
    rises, falls = (ca.logic_and(s * value <= 0.0, s * next_value >= 0.0) for s in (1.0, -1.0))
    return ca.Function("change", [pair], [ca.logic_or(rises, falls), ca.vertcat(at, next_at, value)])


def _edge() -> ca.Function:
    pair = ca.SX.sym("pair", 4)
    at, value, next_at, next_value = ca.vertsplit(pair)
    here, there = ca.fabs(value) < _LARGEST, ca.fabs(next_value) < _LARGEST
    inside = ca.if_else(here, ca.vertcat(at, next_at, value), ca.vertcat(next_at, at, next_value))
    return ca.Function("edge", [pair], [here != there, inside])


def _halving(residual: ca.Function) -> ca.Function:
    """The first end keeps the sign that it has; where F is not defined counts as beyond the second."""
    ends, *given = _symbols(residual)
    ends = _MX.sym("ends", 3)
    middle = 0.5 * (ends[0] + ends[1])
    there = residual(middle, *given)
    same = ca.logic_or(ca.logic_and(there > 0.0, ends[2] > 0.0), ca.logic_and(there < 0.0, ends[2] < 0.0))
    closer = ca.vertcat(ca.if_else(same, middle, ends[0]), ca.if_else(same, ends[1], middle), ends[2])
    return ca.Function("halving", [ends, *given], [closer])


def _damped(residual: ca.Function) -> ca.Function:
    """Levenberg's steps, each as long as pays."""
    tau, *given = _symbols(residual)
    n = tau.shape[0]
    slope, value = residual.jacobian()(tau, *given, _MX.zeros(n, 1))[0], residual(tau, *given)
    slope = ca.densify(slope)
    normal = ca.mtimes(slope.T, slope)
    size = ca.trace(normal) / n
    damping = (1e-14 + 1e-6 * ca.fmin(1.0, ca.sumsqr(value))) * size + 1e-300
    step = -ca.solve(normal + damping * ca.DM.eye(n), ca.mtimes(slope.T, value))
    lengths = np.concatenate([[0.0], 0.5 ** np.arange(24.0), [2.0, 4.0]])
    places = ca.repmat(tau, 1, len(lengths)) + ca.mtimes(step, ca.DM(lengths).T)
    values = _mapped(residual, places, given)
    costs = ca.sum1(values * values)
    at, cost = ca.SX.sym("at", n, len(lengths)), ca.SX.sym("cost", 1, len(lengths))
    best, least = at[:, 0], cost[0]
    for k in range(1, len(lengths)):
        better = cost[k] < least
        best, least = ca.if_else(better, at[:, k], best), ca.if_else(better, cost[k], least)
    pick = ca.Function("pick", [at, cost], [best])
    once = ca.Function("damped", [tau, *given], [pick(places, costs)])
    return _repeated(once, _DAMPED)


def _repeated(once: ca.Function, count: int) -> ca.Function:
    state, *given = (_MX.sym(f"i{i}", once.size1_in(i)) for i in range(once.n_in()))
    result = once.fold(count)(state, *(ca.repmat(part, 1, count) for part in given))
    return ca.Function("repeated", [state, *given], [result])


def _homotopy(residual: ca.Function) -> ca.Function:
    """Where the path F(tau) - tau = (1 - s) (F(start) - start) from s = 0 reaches s = 1.

    State of a step: tau, s, the direction of the path, the length to go.
    """
    start, *given = _symbols(residual)
    n = start.shape[0]
    place, first = _MX.sym("place", n + 1), _MX.sym("first", n)
    at = residual(place[:n], *given) - (1.0 - place[n]) * first
    path = ca.Function("path", [place, first, *given], [at, ca.densify(ca.jacobian(at, place))])

    def tangent(matrix: ca.SX, before: ca.SX) -> ca.SX:
        along = ca.solve(ca.vertcat(matrix, before.T), ca.vertcat(ca.DM.zeros(n), 1.0))
        return along / ca.norm_2(along)

    state = _MX.sym("state", 2 * n + 3)
    before, direction, length = state[: n + 1], state[n + 1 : 2 * n + 2], state[2 * n + 2]
    trial = before + length * direction
    for _ in range(_CORRECTIONS):
        value, matrix = path(trial, first, *given)
        plane = ca.dot(direction, trial - before) - length
        trial = trial - ca.solve(ca.vertcat(matrix, direction.T), ca.vertcat(value, plane))
    value, matrix = path(trial, first, *given)
    onward = tangent(matrix, direction)
    good = ca.logic_and(ca.sumsqr(value) <= 1e-16 * (1.0 + ca.sumsqr(trial)), ca.dot(onward, direction) > 0.7)
    # Beyond s = 1: the point between the last two, and there it stays.
    part = (1.0 - before[n]) / (trial[n] - before[n])
    crossing = before + part * (trial - before)
    there, crossed = before[n] >= 1.0, ca.logic_and(good, trial[n] >= 1.0)
    ahead = ca.if_else(crossed, ca.vertcat(crossing[:n], 1.0), trial)
    grown = ca.vertcat(ahead, onward, 1.5 * length)
    after = ca.if_else(good, grown, ca.vertcat(before, direction, 0.4 * length))
    once = ca.Function("arc", [state, first, *given], [ca.if_else(there, state, after)])
    beginning = residual(start, *given)
    _, matrix = path(ca.vertcat(start, 0.0), beginning, *given)
    direction = tangent(matrix, ca.vertcat(_MX.zeros(n, 1), 1.0))
    state = ca.vertcat(start, 0.0, direction, 0.1)
    reached = _repeated(once, _ARCS)(state, beginning, *given)
    return ca.Function("homotopy", [start, *given], [reached[:n]])
