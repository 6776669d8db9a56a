"""The increment recursion is the paper's Eq. (5) discretised, and what the printed gradient lacks.

Eq. (5) is integrated by the rule v_k = v_{k-1} + h ((1 - theta) v'_{k-1} + theta v'_k): theta = 0 is forward
Euler, theta = 1/2 is Tustin's trapezoidal rule. Once in the z-domain with symbolic coefficients, once sample by
sample in exact fractions, where the start counts too.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import pytest
import sympy
from sympy import Basic, Expr, Integer, Matrix, Rational, Symbol

from tests.cpu_budget import slow_but

z, h = sympy.symbols("z h", positive=True)
x, g, f_theta, f_hat = sympy.symbols("x g f_theta f_hat")
every_order = pytest.mark.parametrize("n", slow_but((1, 2, 3), range(1, 6)))
every_rule = pytest.mark.parametrize("theta", [Rational(0), Rational(1, 2)], ids=["euler", "tustin"])
Values = dict[Basic | complex, Basic | complex]


def coefficients(name: str, n: int) -> list[Symbol]:
    return [Symbol(f"{name}{i}") for i in range(n)]


def companion(a: Sequence[Expr]) -> tuple[Matrix, Matrix]:
    """State matrix and equilibrium of w^(n) + ... + a_0 w = u in the states w, w', ..., w^(n-1)."""
    n = len(a)
    A = Matrix(n, n, lambda i, j: -a[j] if i == n - 1 else Integer(int(j == i + 1)))
    return A, Matrix([1 / a[0], *[Integer(0)] * (n - 1)])


def same(one: Expr, other: Expr) -> bool:
    return sympy.expand(sympy.numer(sympy.together(one - other))) == 0


# --- z-domain


def paper_form(a: Sequence[Expr], b: Sequence[Expr] | None, integrator: Expr) -> Expr:
    """f_hat with ``integrator`` for 1/s: Eq. (5) where b is None, else the corrected general form."""
    n = len(a)

    def chi(ascending: Sequence[Expr], signal: Expr) -> Expr:
        return sympy.Add(*(ascending[n - i] * signal * integrator**i for i in range(1, n)))

    if b is None:
        xi = integrator**n * (-g - f_hat)
        total = a[0] * xi - chi(a, f_hat) + f_theta + chi(a, f_theta) + a[0] * integrator ** (n - 1) * x
    else:
        xi = integrator**n * ((a[0] - b[0]) * f_theta - b[0] * g - a[0] * f_hat)
        total = (
            xi
            - chi(a, f_hat)
            + f_theta
            + chi([p - q for p, q in zip(a, b, strict=True)], f_theta)
            - chi(b, g)
        )
        total += sympy.Add(*(b[i] * integrator ** (n - 1 - i) * x for i in range(n)))
    defect = total - f_hat
    return -defect.subs(f_hat, 0) / defect.diff(f_hat)


def increment_form(a: Sequence[Expr], b: Sequence[Expr], theta: Expr) -> Expr:
    """f_hat of w_k = w_{k-1} + dA (w_{k-1} - equilibrium u_k), f_hat_k = f_theta_k + C w_k."""
    n = len(a)
    A, equilibrium = companion(a)
    mean = (1 - theta) / z + theta  # of the two ends of a step
    u = (1 - 1 / z) * x / h - mean * (g + f_theta)
    # Claimed solution: w = (1, sigma, ..., sigma^(n-1)) u / (mean D(sigma)), sigma the operator for s.
    sigma = (1 - 1 / z) / (h * mean)
    D = sympy.Add(*(c * sigma**i for i, c in enumerate([*a, Integer(1)])))
    w = Matrix([sigma**i * u / (mean * D) for i in range(n)])
    # dA = (I - theta A h)^-1 A h; the recursion is multiplied by the matrix in brackets.
    recursion = (sympy.eye(n) - theta * h * A) * (w - w / z) - A * h * (w / z - equilibrium * u)
    assert all(same(row, Integer(0)) for row in recursion)
    return f_theta + (Matrix([b]) * w)[0]


@every_order
@every_rule
def test_discretised_eq_5_is_the_increment_recursion(n: int, theta: Expr) -> None:
    a = coefficients("a", n)
    integrator = h * ((1 - theta) + theta * z) / (z - 1)
    assert same(paper_form(a, None, integrator), increment_form(a, [a[0], *[Integer(0)] * (n - 1)], theta))


@every_order
@every_rule
def test_discretised_general_form_is_the_increment_recursion(n: int, theta: Expr) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    integrator = h * ((1 - theta) + theta * z) / (z - 1)
    assert same(paper_form(a, b, integrator), increment_form(a, b, theta))


@every_order
def test_the_rules_are_not_interchangeable(n: int) -> None:
    a = coefficients("a", n)
    trapezoid = h * (z + 1) / (2 * (z - 1))
    assert not same(
        paper_form(a, None, trapezoid), increment_form(a, [a[0], *[Integer(0)] * (n - 1)], Integer(0))
    )


# --- sample by sample, in exact fractions

Samples = list[Fraction]
COUNT = 9
STEP = Fraction(1, 50)


def samples(seed: int) -> Samples:
    return [Fraction(int(value), 100) for value in np.random.default_rng(seed).integers(-500, 500, COUNT)]


def binomial(n: int, pole: int) -> Samples:
    """Ascending coefficients of (s + pole)^n without the leading 1."""
    return [Fraction(int(sympy.binomial(n, i)) * pole ** (n - i)) for i in range(n)]


def integrate(chain: Samples, before: Fraction, now: Fraction, theta: Fraction) -> Samples:
    """One step of [int v, int^2 v, ...], v going from ``before`` to ``now``."""
    moved = []
    for old in chain:
        new = old + STEP * ((1 - theta) * before + theta * now)
        moved.append(new)
        before, now = old, new
    return moved


def paper_run(a: Samples, theta: Fraction, signals: tuple[Samples, ...], last_xi: Fraction) -> Samples:
    """Eq. (5) on samples: chains of open integrators of xi^(n), f_hat, f_theta and x."""
    n = len(a)
    xs, gs, models = signals
    # xi^(n-1) is the first integral of xi^(n), xi the last.
    chains = [[last_xi, *[Fraction(0)] * (n - 1)], *[[Fraction(0)] * (n - 1) for _ in range(3)]]
    assert sum(len(chain) for chain in chains) == 4 * n - 3

    def output(chains: list[Samples], k: int) -> Fraction:
        xi, of_f_hat, of_model, of_x = chains
        chi = sum((a[n - i] * (of_f_hat[i - 1] - of_model[i - 1]) for i in range(1, n)), start=Fraction(0))
        return a[0] * xi[-1] - chi + models[k] + a[0] * (of_x[-1] if n > 1 else xs[k])

    def advanced(k: int, before: Fraction, now: Fraction) -> list[Samples]:
        ends = [(-gs[k - 1] - before, -gs[k] - now), (before, now)]
        ends += [(signal[k - 1], signal[k]) for signal in (models, xs)]
        return [integrate(chain, *end, theta) for chain, end in zip(chains, ends, strict=True)]

    estimate = [output(chains, 0)]
    for k in range(1, COUNT):
        before = estimate[-1]
        # Under the trapezoidal rule f_hat_k stands on both sides, affinely: two trials give it.
        at_0, at_1 = (output(advanced(k, before, Fraction(trial)), k) - trial for trial in (0, 1))
        estimate.append(at_0 / (at_0 - at_1))
        chains = advanced(k, before, estimate[-1])
    return estimate


def increment_run(a: Samples, theta: Fraction, signals: tuple[Samples, ...]) -> Samples:
    xs, gs, models = signals
    n = len(a)
    A, equilibrium = companion([Rational(c) for c in a])
    step, weight = Rational(STEP), Rational(theta)
    dA = (sympy.eye(n) - weight * step * A).LUsolve(A * step)
    w = sympy.zeros(n, 1)
    estimate = [models[0]]
    for k in range(1, COUNT):
        known = [(1 - theta) * signal[k - 1] + theta * signal[k] for signal in (gs, models)]
        u = (xs[k] - xs[k - 1]) / STEP - sum(known)
        w = w + dA * (w - equilibrium * Rational(u))
        low = Rational(a[0]) * w[0]
        estimate.append(models[k] + Fraction(int(low.p), int(low.q)))
    return estimate


@every_order
@every_rule
def test_both_runs_give_the_same_fractions(n: int, theta: Rational) -> None:
    a, rule = binomial(n, 20), Fraction(int(theta.p), int(theta.q))
    signals = tuple(samples(seed) for seed in (1, 2, 3))
    started = signals[0][0]
    assert started != 0
    wanted = increment_run(a, rule, signals)
    assert wanted[0] == signals[2][0]
    assert paper_run(a, rule, signals, last_xi=-started) == wanted
    assert paper_run(a, rule, signals, last_xi=Fraction(0)) != wanted


# --- the gradient, Eq. (grad_3) of the supplement


def rollout(n: int) -> tuple[list[Symbol], list[Matrix], list[Expr]]:
    """Euler rollout of the supplement's optimal-control system over six samples, n_x = 1.

    Returns the symbols of the state and, one per sample and as expressions in state and coefficients, the map to
    the next state and the squared error l_i.
    """
    a = coefficients("a", n)
    state = list(sympy.symbols(f"state:{3 * n - 2}"))
    xi, alpha, beta = state[:n], state[n : 2 * n - 1], state[2 * n - 1 :]  # xi first, xi^(n-1) last
    xs, gs, models, labels = ([Rational(v) for v in samples(seed)[:6]] for seed in (4, 5, 6, 7))
    step = Rational(STEP)
    of_x: list[Expr] = [Integer(0)] * (n - 1)
    maps, costs = [], []
    for i in range(6):
        f = a[0] * (xi[0] + (of_x[-1] if of_x else xs[i])) + models[i]
        f += sympy.Add(*(a[n - j] * (beta[j - 1] - alpha[j - 1]) for j in range(1, n)))
        rates = [*xi[1:], -gs[i] - f, *[f, *alpha][: n - 1], *[models[i], *beta][: n - 1]]
        maps.append(Matrix([value + step * rate for value, rate in zip(state, rates, strict=True)]))
        costs.append((labels[i] - f) ** 2)
        of_x = [value + step * rate for value, rate in zip(of_x, [xs[i], *of_x][: n - 1], strict=True)]
    return state, maps, costs


@pytest.mark.parametrize("n", [1, 2, 3])
def test_printed_gradient_lacks_the_terminal_term(n: int) -> None:
    a = coefficients("a", n)
    point: Values = dict(zip(a, (Rational(c) for c in binomial(n, 3)), strict=True))
    state, maps, costs = rollout(n)
    first: list[Expr] = [Integer(0)] * len(state)
    first[n - 1] = -Rational(samples(4)[0])

    # The true derivative: the cost of the unrolled recursion as a polynomial in the coefficients.
    unrolled: list[Expr] = [*first]
    visited: list[Values] = []
    spent = Matrix([0])
    for step, cost in zip(maps, costs, strict=True):
        here: Values = dict(zip(state, unrolled, strict=True))
        visited.append({symbol: sympy.sympify(value).subs(point) for symbol, value in here.items()})
        spent += Matrix([cost]).subs(here)
        unrolled = [sympy.expand(row) for row in step.subs(here).flat()]
    truth = Matrix([sympy.expand(spent[0]).diff(c).subs(point) for c in a])

    def along(expression: Expr | Matrix, wrt: Sequence[Symbol], i: int) -> Matrix:
        rows = expression if isinstance(expression, Matrix) else Matrix([expression])
        return rows.jacobian(Matrix(wrt)).subs({**visited[i], **point}).T

    # Eqs. (grad_1) and (grad_3), transposed so that the shapes fit.
    costate = along(costs[-1], state, -1)
    printed = sympy.zeros(n, 1)
    for i in range(len(costs) - 2, -1, -1):
        printed += along(costs[i], a, i) + along(maps[i], a, i) * costate
        costate = along(costs[i], state, i) + along(maps[i], state, i) * costate
    missing = along(costs[-1], a, -1)
    assert printed + missing == truth
    assert printed != truth
    assert all(entry != 0 for entry in missing)
