"""Lyapunov functions for loops whose inertia moves, as linear matrix inequalities: found in doubles, checked exactly.

One form serves the solver, with its variables, and the check, with fractions. V = x' P x changes along x' = A x + B q,
or x+ = A x + B q, by

    G' P E + E' P G,   or   G' P G - E' P E,        G = [A B],  E = [I 0]  on (x, q)
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from itertools import combinations_with_replacement, permutations
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, solve_continuous_are, solve_discrete_are

from ..._sections import FloatArray
from ._exact import exact, is_positive_definite
from .openings import Opening

__all__ = ["Inequalities", "common", "polytope", "power", "rate_bounded", "small_gain", "solved_by_riccati"]

# What the inequalities must hold by, relative to their terms: the rounding of the loop's own matrices.
_RESERVE = 1e-14
# Slack of the Riccati equation against the inequality, tried from large to small.
_SLACKS = (1e-3, 1e-5, 1e-7, 1e-9)

# A matrix of doubles, of fractions or of the solver's expressions: they share +, -, @ and .T.
_Matrix = Any
_Form = Callable[[Callable[[FloatArray], _Matrix], Sequence[_Matrix]], list[_Matrix]]


@dataclass(frozen=True, eq=False)
class Inequalities:
    """Matrices, linear in the unknowns, that must be negative definite, and unknowns that must be positive definite.

    Parameters
    ----------
    shapes : sequence of (rows, columns)
        Of the unknowns; the first ``definite`` of them are symmetric positive definite.
    definite : int
    form : callable
        ``form(number, unknowns)`` gives the matrices; ``number`` turns data into what the unknowns are made of.
    size : float
        Largest of the data.
    """

    shapes: tuple[tuple[int, int], ...]
    definite: int
    form: _Form
    size: float

    def hold(self, values: Sequence[FloatArray]) -> bool:
        """Whether they do, decided in rational arithmetic, with a reserve for the rounding of the loop's matrices."""
        if not all(np.all(np.isfinite(value)) for value in values):
            return False
        unknown = [exact(value) for value in values]
        largest = max(float(np.abs(value).max()) for value in values)
        reserve = exact(_RESERVE * max(1.0, self.size) * max(1.0, largest))
        positive = [*unknown[: self.definite], *(-each for each in self.form(exact, unknown))]
        definite = len(unknown[: self.definite])
        return all(
            is_positive_definite(each - (0 if i < definite else reserve) * np.eye(len(each), dtype=int))
            for i, each in enumerate(positive)
        )

    def solve(self, who: str) -> list[FloatArray] | None:
        """Values that hold, or None: there are none, or the solver did not find them.

        Raises
        ------
        ImportError
            Without the extra ``lmi``.
        """
        try:
            cp = import_module("cvxpy")
        except ImportError:
            raise ImportError(f"{who} needs the extra lmi: pip install 'phyfilter-ctl[lmi]'") from None
        unknown = [
            cp.Variable(shape, symmetric=i < self.definite and shape[0] > 1)
            for i, shape in enumerate(self.shapes)
        ]
        margin = cp.Variable()
        matrices = self.form(np.asarray, unknown)
        total = sum(cp.trace(each) for each in unknown[: self.definite])
        constraints = [total == sum(shape[0] for shape in self.shapes[: self.definite])]
        constraints += [each >> 0 for each in unknown[: self.definite]]
        constraints += [0.5 * (each + each.T) << -margin * np.eye(each.shape[0]) for each in matrices]
        problem = cp.Problem(cp.Maximize(margin), constraints)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of accuracy: what comes out is checked
                problem.solve(solver="CLARABEL")
        except cp.error.SolverError:
            return None
        if margin.value is None or not float(margin.value) > 0.0:
            return None
        values = [
            np.asarray(each.value, dtype=float).reshape(shape)
            for each, shape in zip(unknown, self.shapes, strict=True)
        ]
        values = [0.5 * (v + v.T) if i < self.definite else v for i, v in enumerate(values)]
        return values if self.hold(values) else None


def _change(P: _Matrix, G: _Matrix, E: _Matrix, sampled: bool) -> _Matrix:
    """V' or V+ - V as a form in (x, q)."""
    return G.T @ P @ G - E.T @ P @ E if sampled else G.T @ P @ E + E.T @ P @ G


def small_gain(opening: Opening, low: float, high: float) -> Inequalities:
    """mu(t) anywhere in [low, high]: the deviation from the middle as an unknown gain of at most half the width.

    It holds for every symmetric mu with eigenvalues in [low, high] too, with kron(P, I) in place of P.
    """
    size, m, sampled = len(opening.A), opening.axes, opening.dt is not None
    unit = np.eye(size + m)

    def form(number: Callable[[FloatArray], _Matrix], unknown: Sequence[_Matrix]) -> list[_Matrix]:
        ends = number(np.array([low, high]))
        middle, radius = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
        A, B, C = (number(part) for part in (opening.A, opening.B, opening.C))
        G = np.concatenate([A + middle * (B @ C), radius * B], axis=1)
        force = number(np.hstack([opening.spread, np.zeros((len(opening.spread), m))]))
        q = number(unit[size:])
        return [_change(unknown[0], G, number(unit[:size]), sampled) + force.T @ force - q.T @ q]

    return Inequalities(((size, size),), 1, form, float(np.abs(opening.closed(np.eye(m) * high)).max()))


def solved_by_riccati(opening: Opening, low: float, high: float) -> FloatArray | None:
    """P of :func:`small_gain`, from a Riccati equation; None where there is none."""
    wanted = small_gain(opening, low, high)
    A = opening.closed(0.5 * (low + high) * np.eye(opening.axes))
    B = 0.5 * (high - low) * opening.B
    output = opening.spread.T @ opening.spread
    solver = solve_continuous_are if opening.dt is None else solve_discrete_are
    if not opening.growth(A) < 0.0:
        return None
    for slack in _SLACKS:
        Q = output + slack * np.trace(output) / len(A) * np.eye(len(A))
        try:
            P = solver(A, B, Q, -np.eye(B.shape[1]))
        except (LinAlgError, ValueError):
            continue
        P = 0.5 * (P + P.T)
        if wanted.hold([P]):
            return P
    return None


def common(matrices: Sequence[FloatArray], sampled: bool) -> Inequalities:
    """One P for all matrices."""
    size = len(matrices[0])
    unit = np.eye(size)

    def form(number: Callable[[FloatArray], _Matrix], unknown: Sequence[_Matrix]) -> list[_Matrix]:
        return [_change(unknown[0], number(A), number(unit), sampled) for A in matrices]

    return Inequalities(((size, size),), 1, form, max(float(np.abs(A).max()) for A in matrices))


def power(A: FloatArray, degree: int, sampled: bool) -> FloatArray:
    """What A does to the products of ``degree`` states: a P for them is a Lyapunov function of twice that degree.

    The symmetric Kronecker power of x+ = A x, or its infinitesimal form for x' = A x (R. W. Brockett, "Lie algebras
    and Lie groups in control theory", 1973).
    """
    n = len(A)
    monomials = list(combinations_with_replacement(range(n), degree))
    basis = np.zeros((n**degree, len(monomials)))
    for column, entry in enumerate(monomials):
        orders = sorted(set(permutations(entry)))
        rows = [int(np.ravel_multi_index(order, (n,) * degree)) for order in orders]
        basis[rows, column] = 1.0 / np.sqrt(len(rows))
    whole = A if sampled else degree * A
    for _ in range(degree - 1):
        whole = np.kron(whole, A if sampled else np.eye(n))
    return basis.T @ whole @ basis


def polytope(opening: Opening, M_hat: FloatArray, vertices: FloatArray, *, constant: bool) -> Inequalities:
    """M anywhere in a polytope: p = M y and s = M_hat y with a multiplier, which leaves M where it is linear.

    P belongs to the mixture of vertices if M is constant, and is one for all if it moves.
    """
    size, n, sampled = len(opening.A), opening.axes, opening.dt is not None
    unit = np.eye(size, size + n)
    count = len(vertices) if constant else 1

    def form(number: Callable[[FloatArray], _Matrix], unknown: Sequence[_Matrix]) -> list[_Matrix]:
        P, X, E = unknown[:count], unknown[count], number(unit)
        A, B, C = (number(part) for part in (opening.A, opening.B, opening.C))
        G = np.concatenate([A, B @ number(M_hat)], axis=1)
        found = []
        for j, M in enumerate(vertices):
            tied = X @ np.concatenate([C, -number(M)], axis=1)
            found.append(_change(P[j % count], G, E, sampled) + tied + tied.T)
        return found

    shapes = (*[(size, size)] * count, (size + n, n))
    largest = max(float(np.abs(part).max()) for part in (opening.A, opening.B @ M_hat, opening.C, vertices))
    return Inequalities(shapes, count, form, largest)


def rate_bounded(opening: Opening, knots: FloatArray, rate: float) -> Inequalities:
    """mu(t) in the range of the knots with |mu'| <= rate mu: P linear in mu from knot to knot.

    Between two knots the inequality is a polynomial in mu of degree 2 (continuous) or 3 (sampled); its Bernstein
    coefficients are matrices, and it holds wherever all of them are negative definite. Sampled, mu counts as its mean
    over a step and goes at most over one knot at once.

    Parameters
    ----------
    opening : Opening
        One axis.
    knots : (K + 1,) array
        Ascending values of mu.
    rate : float
        1/s.
    """
    size, sampled = len(opening.A), opening.dt is not None
    moves = opening.dt is not None and not opening.is_even  # mu differs from its mean within the step
    step = float(np.expm1(rate * opening.dt)) if opening.dt is not None else rate
    count = len(knots)
    unit = np.eye(size + moves)

    def form(number: Callable[[FloatArray], _Matrix], unknown: Sequence[_Matrix]) -> list[_Matrix]:
        mu, speed = number(knots), number(np.array([step]))[0]
        A, B, C = (number(part) for part in (opening.A, opening.B, opening.C))
        closed = [A + m * (B @ C) for m in mu]
        G = [np.concatenate([each, B], axis=1) if moves else each for each in closed]
        E = number(unit[:size])
        P = unknown[:count]
        slope = [(P[i + 1] - P[i]) / (mu[i + 1] - mu[i]) for i in range(count - 1)]
        found = []
        for i in range(count - 1):
            extra = 0
            if moves:
                force = number(np.hstack([opening.spread, np.zeros((len(opening.spread), 1))]))
                q = number(unit[size:])
                extra = unknown[count + i][0, 0] * ((speed * mu[i + 1]) ** 2 * (force.T @ force) - q.T @ q)
            for sign in (1, -1):
                beyond = {i, min(max(i + sign, 0), count - 2)} if sampled else {i}
                for j in sorted(beyond):
                    later = [
                        P[k] * (1 if sampled else 0) + sign * speed * mu[k] * slope[j] for k in (i, i + 1)
                    ]
                    pieces = _bernstein((P[i], P[i + 1]), later, (G[i], G[i + 1]), E, sampled)
                    found += [each + extra for each in pieces]
        return found

    shapes = ((size, size),) * count + ((1, 1),) * ((count - 1) * moves)
    largest = float(np.abs(opening.closed(float(knots[-1]))).max())
    return Inequalities(shapes, count + (count - 1) * moves, form, largest)


def _bernstein(
    P: Sequence[_Matrix], later: Sequence[_Matrix], G: Sequence[_Matrix], E: _Matrix, sampled: bool
) -> list[_Matrix]:
    """Coefficients of V' (``later``: what the motion of mu adds to P') or of V+ - V (``later``: P after the step)."""
    if not sampled:

        def flow(i: int, j: int) -> _Matrix:
            return G[j].T @ P[i] @ E + E.T @ P[i] @ G[j]

        moved = [E.T @ each @ E for each in later]
        return [
            flow(0, 0) + moved[0],
            (flow(0, 1) + flow(1, 0) + moved[0] + moved[1]) / 2,
            flow(1, 1) + moved[1],
        ]

    def after(i: int, j: int, k: int) -> _Matrix:
        return G[i].T @ later[j] @ G[k]

    now = [E.T @ each @ E for each in P]
    return [
        after(0, 0, 0) - now[0],
        (after(1, 0, 0) + after(0, 1, 0) + after(0, 0, 1) - 2 * now[0] - now[1]) / 3,
        (after(0, 1, 1) + after(1, 0, 1) + after(1, 1, 0) - now[0] - 2 * now[1]) / 3,
        after(1, 1, 1) - now[1],
    ]
