"""Identities of the source paper in the Laplace domain, symbolic coefficients, orders 1 to 5.

Signals stand for their Laplace transforms; an initial value enters where a derivative is transformed. Each
realisation is written down as printed and solved for f_hat. Only the last tests use the package: they hold it
against the same formulas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
import sympy
from sympy import Expr, Integer, Rational, Symbol

from phyfilter_ctl import PhyFilter

# The code works in doubles on sections, the reference in rationals on coefficients: some hundred roundings.
DOUBLE = 1e-12

s, x, g, f, f_theta, f_hat, nu = sympy.symbols("s x g f f_theta f_hat nu")
x0, M, M_hat = sympy.symbols("x_0 M M_hat")
every_order = pytest.mark.parametrize("n", range(1, 6))


def coefficients(name: str, n: int) -> list[Symbol]:
    return [Symbol(f"{name}{i}") for i in range(n)]


def polynomial(ascending: Sequence[Expr]) -> Expr:
    return sympy.Add(*(c * s**i for i, c in enumerate(ascending)))


def denominator(a: Sequence[Expr]) -> Expr:
    return polynomial([*a, Integer(1)])


def lowpass(a: Sequence[Expr]) -> Expr:
    return a[0] / denominator(a)


def solved_for(unknown: Symbol, equation: Expr) -> Expr:
    """Root of an expression that is affine in ``unknown``."""
    slope = equation.diff(unknown)
    assert not slope.has(unknown)
    return -equation.subs(unknown, 0) / slope


def put(expression: Expr, old: Expr, new: Expr) -> Expr:
    replaced = expression.subs(old, new)
    assert isinstance(replaced, Expr)
    return replaced


def same(one: Expr, other: Expr) -> bool:
    return sympy.expand(sympy.numer(sympy.together(one - other))) == 0


def at_zero(expression: Expr) -> Expr:
    return sympy.cancel(expression).subs(s, 0)


def at_infinity(expression: Expr) -> Expr:
    reciprocal = Symbol("reciprocal")
    return sympy.cancel(expression.subs(s, 1 / reciprocal)).subs(reciprocal, 0)


def filtered(F: Expr, residual: Expr) -> Expr:
    """Eq. (1): f_hat = f_theta + F [M x' - g - f_theta], ``residual`` being what F is fed with."""
    return f_theta + F * residual


def integrals(ascending: Sequence[Expr], signal: Expr) -> Expr:
    """c_{n-1} int signal + ... + c_1 int^{n-1} signal, the pattern of chi_1, chi_2 and chi_3."""
    n = len(ascending)
    return sympy.Add(*(ascending[n - i] * signal / s**i for i in range(1, n)))


def initial_terms(start: Sequence[Expr]) -> Expr:
    """What xi(0), xi'(0), ..., xi^(n-1)(0) add to the transform of xi^(n), with their sign turned."""
    n = len(start)
    return sympy.Add(*(start[k] * s ** (n - 1 - k) for k in range(n)))


def paper_lowpass(a: Sequence[Expr], start: Sequence[Expr] | None = None, driver: Expr = x) -> Expr:
    """Eq. (5) solved for f_hat; ``driver`` is x, or int M dx in the inertia form."""
    n = len(a)
    start = [Integer(0)] * n if start is None else start
    xi = (-g - f_hat + initial_terms(start)) / s**n
    chi_1 = integrals(a, f_hat)
    chi_2 = f_theta + integrals(a, f_theta)
    return solved_for(f_hat, a[0] * xi - chi_1 + chi_2 + a[0] * driver / s ** (n - 1) - f_hat)


def paper_general(
    a: Sequence[Expr],
    b: Sequence[Expr],
    *,
    g_in_xi: Expr | None = None,
    chi_3: Sequence[Expr] | None = None,
    start: Sequence[Expr] | None = None,
    driver: Expr = x,
) -> Expr:
    """The supplement's general form solved for f_hat, by default with the corrected terms.

    ``g_in_xi`` is the coefficient of -g in xi^(n) (b_0; printed a_0), ``chi_3`` the ascending coefficients of
    chi_3 (b; printed with b_{n-1} in the place of b_1).
    """
    n = len(a)
    g_in_xi = b[0] if g_in_xi is None else g_in_xi
    start = [Integer(0)] * n if start is None else start
    xi = ((a[0] - b[0]) * f_theta - g_in_xi * g - a[0] * f_hat + initial_terms(start)) / s**n
    chi_1 = integrals(a, f_hat)
    chi_2 = f_theta + integrals([a_i - b_i for a_i, b_i in zip(a, b, strict=True)], f_theta)
    inputs = sympy.Add(*(b[i] * driver / s ** (n - 1 - i) for i in range(n)))
    total = xi - chi_1 + chi_2 - integrals(b if chi_3 is None else chi_3, g) + inputs
    return solved_for(f_hat, total - f_hat)


# --- low-pass form, Eqs. (3) to (5)


@every_order
def test_eq_5_is_the_lowpass_filter_of_the_residual(n: int) -> None:
    a = coefficients("a", n)
    F = lowpass(a)
    assert same(paper_lowpass(a), f_theta + s * F * x - F * (g + f_theta))


@every_order
def test_eq_5_starts_without_a_bump_only_from_minus_x0(n: int) -> None:
    a, start = coefficients("a", n), coefficients("xi_0_", n)
    wanted = filtered(lowpass(a), s * x - x0 - g - f_theta)
    bump = (paper_lowpass(a, start) - wanted) * denominator(a) / a[0]
    # The bump vanishes where every coefficient does: xi^(n-1)(0) = -x(0), the rest 0, and nothing else.
    assert same(bump, initial_terms([*start[:-1], start[-1] + x0]))
    rule = [*[Integer(0)] * (n - 1), -x0]
    assert same(paper_lowpass(a, rule), wanted)


@every_order
def test_eq_5_from_zero_leaves_a_transient_of_a0_x0(n: int) -> None:
    a = coefficients("a", n)
    bump = paper_lowpass(a) - filtered(lowpass(a), s * x - x0 - g - f_theta)
    assert same(bump, lowpass(a) * x0)
    # Its derivative of order n - 1 jumps by a_0 x(0) at t = 0 (initial value theorem); its area is x(0).
    assert at_infinity(s**n * bump) == a[0] * x0
    assert at_zero(bump) == x0


# --- general form


@every_order
def test_general_form_with_the_corrected_terms(n: int) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    F = polynomial(b) / denominator(a)
    assert same(paper_general(a, b), f_theta + s * F * x - F * (g + f_theta))


@every_order
def test_general_form_starts_without_a_bump(n: int) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    start = [-b[n - 1 - k] * x0 for k in range(n)]  # xi^(k)(0) = -b_{n-1-k} x(0)
    wanted = filtered(polynomial(b) / denominator(a), s * x - x0 - g - f_theta)
    assert same(paper_general(a, b, start=start), wanted)
    assert not same(paper_general(a, b), wanted)


@every_order
def test_general_form_nests_the_lowpass_form(n: int) -> None:
    a = coefficients("a", n)
    assert same(paper_general(a, [a[0], *[Integer(0)] * (n - 1)]), paper_lowpass(a))


@every_order
def test_printed_a0_g_is_wrong_unless_b0_equals_a0(n: int) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    wrong = paper_general(a, b, g_in_xi=a[0]) - paper_general(a, b)
    assert not same(wrong, Integer(0))
    assert same(wrong, (b[0] - a[0]) * g / denominator(a))
    assert same(put(wrong, b[0], a[0]), Integer(0))


@pytest.mark.parametrize("n", range(2, 6))  # n = 1 with b_0 = 0 is no filter
def test_printed_bandpass_takes_a_constant_g_for_residual(n: int) -> None:
    a, b = coefficients("a", n), [Integer(0), *coefficients("b", n)[1:]]
    F = polynomial(b) / denominator(a)
    assert same(paper_general(a, b), f_theta + s * F * x - F * (g + f_theta))
    assert at_zero(paper_general(a, b).diff(g)) == 0
    assert at_zero(paper_general(a, b, g_in_xi=a[0]).diff(g)) == -1


@every_order
def test_printed_chi_3_is_wrong_from_order_three(n: int) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    printed = [*b]
    if n >= 2:
        printed[1] = b[n - 1]  # the coefficient of int^{n-1} g
    wrong = paper_general(a, b, chi_3=printed) - paper_general(a, b)
    if n <= 2:
        assert same(wrong, Integer(0))
    else:
        assert not same(wrong, Integer(0))
        assert same(wrong, (b[1] - b[n - 1]) * s * g / denominator(a))


# --- inertia form and error


@every_order
def test_inertia_form_and_its_error(n: int) -> None:
    a, b = coefficients("a", n), coefficients("b", n)
    N, D = polynomial(b), denominator(a)
    F, gamma = N / D, f - f_theta
    # The plant M x' = g + f gives g; the filter sees x + nu through M_hat.
    estimate = paper_general(a, b, driver=M_hat * (x + nu)).subs(g, M * s * x - f)
    error = (1 - F) * gamma + F * (M - M_hat) * s * x - s * F * M_hat * nu
    assert same(f - estimate, error)
    forcing = polynomial([*(a_k - b_k for a_k, b_k in zip(a, b, strict=True)), Integer(1)]) * gamma
    noiseless = (f - estimate).subs(nu, 0)
    assert same(D * noiseless, forcing + N * (M - M_hat) * s * x)


@every_order
def test_lowpass_inertia_form_needs_no_start_rule(n: int) -> None:
    # int M dx starts at zero by its definition, so all states may: Eq. (5) with M as printed starts bumplessly.
    a = coefficients("a", n)
    travelled = M_hat * (x - x0 / s)
    wanted = filtered(lowpass(a), M_hat * (s * x - x0) - g - f_theta)
    assert same(paper_lowpass(a, driver=travelled), wanted)


@every_order
def test_robustness_appendix_forcing_holds_for_the_residual(n: int) -> None:
    # The appendix prints f^(k) where gamma^(k) belongs; the two agree for f_theta = 0 only.
    a = coefficients("a", n)
    estimate = paper_lowpass(a, driver=M_hat * x).subs(g, M * s * x - f)
    mismatch = a[0] * (M - M_hat) * s * x
    printed = (denominator(a) - a[0]) * f + mismatch
    left = denominator(a) * (f - estimate)
    assert same(left, (denominator(a) - a[0]) * (f - f_theta) + mismatch)
    assert not same(left, printed)
    assert same(put(left, f_theta, Integer(0)), printed)
    # Its right-hand side for f_hat itself, again f_theta = 0.
    assert same(put(denominator(a) * estimate, f_theta, Integer(0)), a[0] * (f - (M - M_hat) * s * x))


@every_order
def test_type_is_the_number_of_matched_coefficients(n: int) -> None:
    a = coefficients("a", n)
    for k in range(n + 1):
        b = [*a[:k], *coefficients("b", n)[k:]]
        error = (denominator(a) - polynomial(b)) / denominator(a)
        assert same(1 - polynomial(b) / denominator(a), error)
        # Final value theorem for the residuals t^j / j!: followed for j < k, not for j = k.
        for j in range(k):
            assert at_zero(s * error / s ** (j + 1)) == 0
        left = at_zero(s * error / s ** (k + 1))
        assert sympy.simplify(left - ((a[k] - b[k] if k < n else 1) / a[0])) == 0
        assert left != 0


# --- special forms: order one, and the linear extended state observer


def test_first_order_without_a_model_is_chens_observer() -> None:
    (a0,) = a = coefficients("a", 1)
    z = Symbol("z")
    for start, begun_at in ((Integer(0), Integer(0)), (-a0 * x0, x0)):
        z_solved = solved_for(z, -a0 * z - a0 * (a0 * x + g) - (s * z - start))
        d_hat = z_solved + a0 * x
        assert same(d_hat, put(paper_lowpass(a, [start / a0]), f_theta, Integer(0)))
        assert same(d_hat, lowpass(a) * (s * x - begun_at - g))


def test_first_order_is_the_feedback_neural_network() -> None:
    (a0,) = a = coefficients("a", 1)
    x_hat = Symbol("x_hat")
    law = f_theta + a0 * (x - x_hat)

    def estimate(x_hat_0: Expr) -> Expr:
        return law.subs(x_hat, solved_for(x_hat, g + law - (s * x_hat - x_hat_0)))

    wanted = filtered(lowpass(a), s * x - x0 - g - f_theta)
    assert same(estimate(x0), wanted)
    # The printed integral of g + f_hat starts at zero instead: the same transient as an all-zero Eq. (5).
    assert same(estimate(Integer(0)), paper_lowpass(a))
    assert same(estimate(Integer(0)) - wanted, lowpass(a) * x0)


def test_first_order_is_evolver() -> None:
    (a0,) = a = coefficients("a", 1)
    xi_1, f_theta_0 = sympy.symbols("xi_1 f_theta_0")
    start = f_theta_0 - a0 * x0
    slope = s * f_theta - f_theta_0
    solved = solved_for(xi_1, slope - a0 * (g + xi_1 + a0 * x) - (s * xi_1 - start))
    assert same(solved + a0 * x, filtered(lowpass(a), s * x - x0 - g - f_theta))


def test_first_order_is_seer_ii() -> None:
    # In time: f_theta = Xi Phi(t) s(x) with Chebyshev polynomials of t and of x(t).
    t, a0 = sympy.symbols("t a0")
    state = sympy.Function("x")(t)
    known = sympy.Function("g")(t)
    estimate = sympy.Function("f_hat")(t)
    at = Symbol("at")
    Xi = sympy.Matrix(1, 3, sympy.symbols("Xi:3"))
    Phi = sympy.Matrix(3, 3, [sympy.chebyshevt(i + 2 * j, t) for i in range(3) for j in range(3)])
    basis = sympy.Matrix([sympy.chebyshevt(i, at) for i in range(3)])
    model = (Xi * Phi * basis.subs(at, state))[0]

    by_time = (Xi * Phi.diff(t) * basis.subs(at, state))[0]
    by_state = (Xi * Phi * basis.diff(at).subs(at, state))[0] * state.diff(t)
    assert sympy.expand(by_time + by_state - model.diff(t)) == 0

    xi_2_rate = by_time - a0 * (known + estimate)
    estimate_rate = xi_2_rate + by_state + a0 * state.diff(t)
    # The filter (s + a0)(f_hat - f_theta) = a0 (x' - g - f_theta) in time.
    filter_rate = model.diff(t) - a0 * (estimate - model) + a0 * (state.diff(t) - known - model)
    assert sympy.expand(estimate_rate - filter_rate) == 0


def test_second_order_without_a_model_is_the_linear_eso() -> None:
    w, z1, z2 = sympy.symbols("w z1 z2")
    z1_of_z2 = solved_for(z1, z2 + g + 2 * w * (x - z1) - (s * z1 - x0))
    z2_solved = solved_for(z2, w**2 * (x - z1_of_z2) - s * z2)
    a = [w**2, 2 * w]
    assert same(z2_solved, lowpass(a) * (s * x - x0 - g))
    assert same(z2_solved, put(paper_lowpass(a, [Integer(0), -x0]), f_theta, Integer(0)))


# --- the code against the same formulas

# Ascending a and b (empty: low-pass form), rational numbers.
FILTERS = {
    "one": ("5/2", ""),
    "one-general": ("5/2", "3/2"),
    "pair": ("5 2", ""),
    "repeated": ("4 4", "0 4"),
    "three": ("6 11 6", "6 7/3 -1/2"),
    "four-repeated": ("16 32 24 8", ""),
    "four": ("20 28 19 6", "20 28 1 3"),
    "five": ("120 274 225 85 15", "120 274 225 85 0"),
}
PARTS = ((0, 0), (0, "3/10"), (1, 2), (0, 10), ("-1/2", 7), (50, 0))
POINTS = [Rational(real) + sympy.I * Rational(imaginary) for real, imaginary in PARTS]


@pytest.fixture(params=FILTERS.values(), ids=list(FILTERS))
def both(request: pytest.FixtureRequest) -> tuple[PhyFilter, Expr]:
    """A filter of the package and the formula of its F."""
    a, b = ([Rational(c) for c in text.split()] for text in request.param)
    N = polynomial(b) if b else a[0]
    code = PhyFilter([float(c) for c in a], [float(c) for c in b] if b else None)
    return code, N / denominator(a)


def agree(function: Callable[[complex], object], formula: Expr) -> bool:
    got = np.array([np.asarray(function(complex(point))).item() for point in POINTS])
    wanted = np.array([complex(put(formula, s, point).evalf(30)) for point in POINTS])
    return bool(np.all(np.abs(got - wanted) <= DOUBLE * np.maximum(1.0, np.abs(wanted))))


def test_code_transfer_functions(both: tuple[PhyFilter, Expr]) -> None:
    code, F = both
    assert agree(code, F)
    assert agree(code.error, 1 - F)
    assert agree(code.transfer_function, F)
    assert agree(code.error_transfer_function, 1 - F)


def test_code_sections(both: tuple[PhyFilter, Expr]) -> None:
    code, F = both
    A, equilibrium, C = code.sections
    assert agree(lambda p: C @ np.linalg.solve(p * np.eye(code.order) - A, -A @ equilibrium), F)


@pytest.mark.parametrize("channel", [0, 1])
def test_code_state_space(both: tuple[PhyFilter, Expr], channel: int) -> None:
    code, F = both
    system = code.state_space(2)

    def response(p: complex, signal: str, source: int) -> complex:
        column = system.input_labels.index(f"{signal}[{source}]")
        at_states = np.linalg.solve(p * np.eye(system.nstates) - system.A, system.B[:, column])
        return complex(system.C[channel] @ at_states + system.D[channel, column])

    for signal, formula in (("x", s * F), ("g", -F), ("f_theta", 1 - F)):
        assert agree(lambda p, signal=signal: response(p, signal, channel), formula)
        assert agree(lambda p, signal=signal: response(p, signal, 1 - channel), Integer(0))


@every_order
def test_code_type(n: int) -> None:
    a = [float(c) for c in sympy.Poly((s + 2) ** n - s**n, s).all_coeffs()[::-1]]
    for k in range(n + 1):
        b = [*a[:k], *(0.5 * c for c in a[k:])]
        assert PhyFilter(a, b).type == k
