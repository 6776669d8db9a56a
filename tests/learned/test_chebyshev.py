"""Chebyshev models against numpy's polynomials and CasADi, and the adaptive law against its Lyapunov function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Chebyshev as Series
from scipy.integrate import solve_ivp

from phyfilter_ctl.learned import AdaptationState, AdaptiveChebyshev, Chebyshev, LearnedModel

# The same sums in another order: some hundred terms of size 1.
SAME_FORMULA = 1e-12
# Gradient by algorithmic differentiation, relative to its largest entry.
GRADIENT = 1e-9
# Least squares of noise-free data in the span of a well-conditioned basis, l2 = 0.
RECOVERED = 1e-10
# Two routes through a stable recursion of some thousand steps.
SAME_RECURSION = 1e-10


def random_model(seed: int = 0, outside: str = "clip") -> Chebyshev:
    """Two features of the state, two parameters, three channels."""
    rng = np.random.default_rng(seed)
    middle, half = rng.standard_normal(4), rng.uniform(0.5, 3.0, 4)
    bounds = np.column_stack([middle - half, middle + half])
    Xi = rng.standard_normal((3, 16 * 9))
    return Chebyshev(3, n_d=2, degree_d=2, outside=outside, bounds=bounds, Xi=Xi)  # pyright: ignore[reportArgumentType]


def inside(model: Chebyshev, n: int, seed: int = 1, reach: float = 1.0) -> np.ndarray:
    assert model.bounds is not None
    middle, half = model.bounds.mean(axis=1), 0.5 * np.diff(model.bounds)[:, 0]
    return middle + reach * half * np.random.default_rng(seed).uniform(-1.0, 1.0, (n, len(half)))


# --------------------------------------------------------------------------------------------------------- evaluation


@pytest.mark.parametrize("outside", ["clip", "extrapolate"])
def test_predict_is_the_sum_of_products_of_polynomials(outside: str) -> None:
    model = random_model(outside=outside)
    z = inside(model, 20, reach=1.5)
    assert model.bounds is not None
    assert model.Xi is not None
    s = (z - model.bounds.mean(axis=1)) / (0.5 * np.diff(model.bounds)[:, 0])
    s = np.clip(s, -1.0, 1.0) if outside == "clip" else s
    expected = np.zeros((20, 3))
    for column, (i, j, k, m) in enumerate(product(range(4), range(4), range(3), range(3))):
        term = np.prod([Series.basis(n)(s[:, a]) for a, n in enumerate((i, j, k, m))], axis=0)
        expected += term[:, None] * model.Xi[:, column]
    np.testing.assert_allclose(model.predict(z), expected, rtol=SAME_FORMULA, atol=10 * SAME_FORMULA)


@given(seed=st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_casadi_is_predict(seed: int) -> None:
    for outside in ("clip", "extrapolate"):
        model = random_model(seed, outside)
        z = inside(model, 10, seed, reach=1.3)
        expected = model.casadi().map(10)(z.T).full().T
        np.testing.assert_allclose(model.predict(z), expected, rtol=SAME_FORMULA, atol=100 * SAME_FORMULA)


def test_the_decomposition_is_the_prediction() -> None:
    model = random_model()
    z = inside(model, 30)
    Y, varsigma = model.regressor(z[:, :2]), model.varsigma(z[:, 2:])
    assert (Y.shape, varsigma.shape) == ((30, 3, 9), (30, 9))
    np.testing.assert_allclose(
        np.einsum("kij,kj->ki", Y, varsigma), model.predict(z), atol=100 * SAME_FORMULA
    )
    np.testing.assert_allclose(model.d_from_varsigma(varsigma), z[:, 2:], atol=100 * SAME_FORMULA)


def test_vjp_is_the_derivative_that_casadi_finds() -> None:
    model = random_model()
    rng = np.random.default_rng(2)
    z, cotangent = inside(model, 12), rng.standard_normal((12, 3))
    assert model.Xi is not None
    assert model.bounds is not None
    Xi, z_, c_ = ca.SX.sym("Xi", model.Xi.size), ca.SX.sym("z", 4), ca.SX.sym("c", 3)
    s = (z_ - ca.DM(model.bounds.mean(axis=1))) / ca.DM(0.5 * np.diff(model.bounds)[:, 0])
    # T_n(s) = cos(n arccos s): another formula than the recurrence
    T = [[ca.cos(n * ca.acos(s[a])) for n in range(4 if a < 2 else 3)] for a in range(4)]
    basis = ca.vertcat(*(a * b * c * d for a, b, c, d in product(*T)))
    f = ca.reshape(Xi, model.Xi.shape[1], 3).T @ basis
    gradient = ca.Function("g", [Xi, z_, c_], [ca.gradient(ca.dot(c_, f), Xi)])
    expected = sum(gradient(model.parameters, a, b).full()[:, 0] for a, b in zip(z, cotangent, strict=True))
    actual = model.vjp(z, cotangent)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max())


def test_long_input_in_chunks_is_the_same() -> None:
    model = random_model()
    z, cotangent = inside(model, 3000), np.random.default_rng(3).standard_normal((3000, 3))
    apart = np.vstack([model.predict(part) for part in np.array_split(z, 77)])
    np.testing.assert_allclose(model.predict(z), apart, rtol=0.0, atol=100 * SAME_FORMULA)
    parts = zip(np.array_split(z, 77), np.array_split(cotangent, 77), strict=True)
    np.testing.assert_allclose(model.vjp(z, cotangent), sum(model.vjp(*pair) for pair in parts), atol=1e-9)


def test_parameters_round_trip_and_are_frozen() -> None:
    model = random_model()
    assert isinstance(model, LearnedModel)
    doubled = model.with_parameters(2.0 * model.parameters)
    z = inside(model, 5)
    np.testing.assert_allclose(doubled.predict(z), 2.0 * model.predict(z), rtol=SAME_FORMULA)
    assert model.Xi is not None
    with pytest.raises(ValueError, match="read-only"):
        model.Xi[0, 0] = 1.0
    assert Chebyshev().parameters.shape == (0,)
    assert repr(Chebyshev(2)) == "Chebyshev(degree=2, n_d=1, degree_d=2, not fitted)"


# ------------------------------------------------------------------------------------------------------------ fitting


def test_fit_recovers_the_coefficients() -> None:
    truth = random_model()
    z = inside(truth, 4000)
    assert truth.Xi is not None
    result = replace(truth, Xi=None, l2=0.0).fit(z, truth.predict(z))
    assert result.status == "converged"
    assert result.message == "converged"
    np.testing.assert_allclose(result.model.parameters, truth.parameters, rtol=0.0, atol=RECOVERED)


def test_fit_is_the_ridge_of_the_normal_equations() -> None:
    rng = np.random.default_rng(4)
    z, f = rng.uniform(-1.0, 1.0, (700, 2)), rng.standard_normal((700, 2))
    model = Chebyshev(2, l2=0.1, bounds=np.array([[-1.0, 1.0], [-1.0, 1.0]])).fit(z, f).model
    B = np.polynomial.chebyshev.chebvander2d(z[:, 0], z[:, 1], [2, 2])
    expected = np.linalg.solve(B.T @ B / 700 + 0.1 * np.eye(9), B.T @ f / 700).T
    np.testing.assert_allclose(model.Xi, expected, rtol=0.0, atol=RECOVERED)


def test_an_analytic_function_is_approached_exponentially_in_the_degree() -> None:
    rng = np.random.default_rng(5)
    z = rng.uniform(-1.0, 1.0, (3000, 2))
    f = (np.exp(z[:, 0]) * np.cos(2.0 * z[:, 1]))[:, None]
    errors = [Chebyshev(p, l2=0.0).fit(z, f).rmse for p in (2, 4, 6, 8)]
    assert all(b < 0.1 * a for a, b in pairwise(errors))


def test_undetermined_coefficients_are_reported() -> None:
    z = np.column_stack([np.linspace(0.0, 1.0, 50), np.zeros(50)])
    result = Chebyshev(2).fit(z, z[:, :1])
    assert result.rmse < 1e-6
    assert "the data determine 3 of 9 coefficients" in result.message


def test_a_constant_column_and_bounds_that_stay() -> None:
    z = np.column_stack([np.linspace(0.0, 1.0, 50), np.full(50, 7.0)])
    model = Chebyshev(1).fit(z, z[:, :1]).model
    np.testing.assert_array_equal(model.bounds, [[0.0, 1.0], [0.0, 14.0]])
    np.testing.assert_array_equal(model.fit(z * 0.5, z[:, :1]).model.bounds, model.bounds)


def test_clipping_keeps_the_size_that_extrapolation_loses() -> None:
    z = np.random.default_rng(6).uniform(-1.0, 1.0, (500, 2))
    f = np.sin(3.0 * z[:, :1]) * z[:, 1:]
    clip = Chebyshev(5).fit(z, f).model
    far = [[10.0, 0.5]]
    assert abs(clip.predict(far)[0, 0]) <= np.max(np.abs(f)) + 0.1
    assert abs(replace(clip, outside="extrapolate").predict(far)[0, 0]) > 1e3


def test_a_basis_that_overflows_is_a_status() -> None:
    z = np.random.default_rng(0).uniform(1e100, 2e100, (50, 2))
    wild = Chebyshev(4, outside="extrapolate", bounds=np.array([[-1.0, 1.0], [-1.0, 1.0]]))
    with np.errstate(over="ignore", invalid="ignore"):
        result = wild.fit(z, z[:, :1])
    assert result.status == "failed"
    assert result.model is wild


def test_save_and_load(tmp_path: Path) -> None:
    model = replace(random_model(outside="extrapolate"), l2=0.5)
    model.save(tmp_path / "m.npz")
    loaded = Chebyshev.load(tmp_path / "m.npz")
    z = inside(model, 8)
    assert loaded.predict(z).tobytes() == model.predict(z).tobytes()
    for name in ("degree", "n_d", "degree_d", "l2", "outside"):
        assert getattr(loaded, name) == getattr(model, name)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        arrays = dict(archive)
    for change, words in (
        ({"Xi": np.zeros((3, 5))}, "Xi: expected shape"),
        ({"bounds": np.zeros((4, 2))}, "bounds: expected rows"),
        ({"degree": np.array(10**6)}, "make .* terms"),
        ({"kind": np.array("network")}, "expected kind 'chebyshev'"),
    ):
        np.savez(tmp_path / "bad.npz", allow_pickle=False, **(arrays | change))
        with pytest.raises(ValueError, match=words):
            Chebyshev.load(tmp_path / "bad.npz")
    with pytest.raises(ValueError, match="no coefficients yet"):
        Chebyshev().save(tmp_path / "none.npz")


# ------------------------------------------------------------------------------------------------------- adaptive law


def wind_model(seed: int = 0) -> Chebyshev:
    """Two channels, one feature (time of the motion), one parameter of degree 2."""
    Xi = np.random.default_rng(seed).standard_normal((2, 12))
    return Chebyshev(3, degree_d=2, bounds=np.array([[-1.0, 1.0], [-2.0, 4.0]]), Xi=Xi)


def sampled_plant(
    law: AdaptiveChebyshev, z: np.ndarray, varsigma: np.ndarray, *, disturbance: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """x and g of a plant that the law's own assumptions hold for exactly."""
    rng = np.random.default_rng(11)
    Y, g = law.model.regressor(z), rng.standard_normal((len(z), 2))
    rate = np.einsum("kij,j->ki", 0.5 * (Y[1:] + Y[:-1]), varsigma)
    rate += (g[:-1] if law.g == "hold" else 0.5 * (g[:-1] + g[1:])) + disturbance * rng.uniform(
        -1.0, 1.0, rate.shape
    )
    return np.vstack([np.ones(2), 1.0 + law.dt * np.cumsum(rate, axis=0)]), g


EXCITING = np.sin(np.linspace(0.0, 80.0, 4000))[:, None] * np.cos(np.linspace(0.0, 31.0, 4000))[:, None]
D = np.array([[2.2]])


def law_of(
    memory: float = 0.0, leakage: float = 0.0, rate: float = 30.0, g: str = "hold", dt: float = 0.01
) -> AdaptiveChebyshev:
    return AdaptiveChebyshev(wind_model(), dt, rate=rate, memory=memory, leakage=leakage, g=g)  # pyright: ignore[reportArgumentType]


def lyapunov(varsigma: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.sum((varsigma - truth) ** 2, axis=1)


@pytest.mark.parametrize("memory", [0.0, 2.0])
@pytest.mark.parametrize("g", ["hold", "average"])
def test_varsigma_converges_under_persistent_excitation(memory: float, g: str) -> None:
    law = law_of(memory, g=g, rate=0.5)
    truth = law.model.varsigma(D)[0]
    x, known = sampled_plant(law, EXCITING, truth)
    run = law.run(EXCITING, x, known)
    V = lyapunov(run.varsigma, truth)
    assert V[0] > 0.1
    assert np.all(np.diff(V) <= 1e-12 * V[0])  # never rises, but for rounding
    thirds = [V[k] for k in (0, 1333, 2666, 3999)]
    assert all(b < 0.1 * a for a, b in pairwise(thirds))  # exponential
    np.testing.assert_allclose(law.model.d_from_varsigma(run.varsigma[-1:]), D, atol=0.02)
    z = np.hstack([EXCITING, np.repeat(D, 4000, axis=0)])
    error = np.abs(run.f_theta - law.model.predict(z)).max(axis=1)
    assert error[-500:].max() < 0.02 * error.max()
    assert np.abs(run.prediction_error[-500:]).max() < 0.02 * np.abs(run.prediction_error).max()


@given(
    rate=st.floats(0.01, 1e6),
    dt=st.floats(1e-4, 1.0),
    bandwidth=st.floats(0.1, 1e3),
    memory=st.sampled_from([0.0, 0.5]),
)
@settings(max_examples=40, deadline=None)
def test_the_lyapunov_function_falls_for_every_gain_and_step(
    rate: float, dt: float, bandwidth: float, memory: float
) -> None:
    law = AdaptiveChebyshev(wind_model(), dt, rate=rate, bandwidth=bandwidth, memory=memory)
    truth = law.model.varsigma(D)[0]
    z = EXCITING[::10]
    x, known = sampled_plant(law, z, truth)
    V = lyapunov(law.run(z, x, known).varsigma, truth)
    # u = (x_k - x_{k-1}) / h rounds to eps |x| / h
    assert np.all(np.diff(V) <= (1e-9 + 1e-12 / dt) * V[0])


def test_without_excitation_varsigma_stays_bounded_and_f_is_right() -> None:
    law = law_of()
    truth = law.model.varsigma(D)[0]
    still = np.full((4000, 1), 0.3)
    x, known = sampled_plant(law, still, truth)
    run = law.run(still, x, known)
    V = lyapunov(run.varsigma, truth)
    assert np.all(np.diff(V) <= 1e-12 * V[0])
    rest, f = V[-1], law.model.predict([[0.3, 2.2]])
    one_channel = AdaptiveChebyshev(replace(law.model, Xi=np.asarray(law.model.Xi)[:1]), 0.01, rate=30.0)
    x = np.cumsum(np.full((4000, 1), 0.01 * f[0, 0]), axis=0)
    alone = one_channel.run(still, x)
    assert lyapunov(alone.varsigma[-1:], truth)[0] > 1e-3  # one equation, two unknowns
    np.testing.assert_allclose(run.f_theta[-1], f[0], atol=1e-3)
    np.testing.assert_allclose(alone.f_theta[-1], f[0, :1], atol=1e-3)
    assert rest <= V[0]


def test_leakage_bounds_what_a_disturbance_does() -> None:
    still = np.full((20000, 1), 0.3)
    truth = law_of().model.varsigma(D)[0]
    spread = {}
    for leakage in (0.0, 1.0):
        law = law_of(leakage=leakage, rate=300.0)
        x, known = sampled_plant(law, still, truth, disturbance=3.0)
        run = law.run(still, x, known)
        spread[leakage] = np.sqrt(lyapunov(run.varsigma, truth).max())
        assert np.all(np.isfinite(run.varsigma))
    assert spread[1.0] < spread[0.0] + 1.0
    # leakage alone forgets: without a signal varsigma returns to the prior
    law = replace(law_of(leakage=1.0), rate=1e-9)
    state = replace(law.start([0.0], [0.0, 0.0]), varsigma=np.array([1.0, 5.0, 5.0]))
    run = law.run(np.zeros((1000, 1)), np.zeros((1000, 2)), state=state)
    np.testing.assert_allclose(
        run.varsigma[-1] - law.prior, np.exp(-10.0) * (state.varsigma - law.prior), atol=1e-4
    )


def test_a_gust_outside_the_model_does_not_run_away() -> None:
    law = law_of(memory=1.0, rate=1.0)
    truth = law.model.varsigma(D)[0]
    x, known = sampled_plant(law, EXCITING, truth, disturbance=2.0)
    V = lyapunov(law.run(EXCITING, x, known).varsigma, truth)
    assert V[-1000:].max() < 0.25 * V[0]


@pytest.mark.parametrize("constant", [False, True])
@pytest.mark.parametrize("memory", [0.0, 1.0])
def test_run_is_the_recursion_of_the_docstring(memory: float, constant: bool) -> None:
    law = replace(law_of(memory, leakage=0.2, g="average"), adapt_constant=constant)
    z, rng = EXCITING[:300], np.random.default_rng(3)
    x, g = np.cumsum(rng.standard_normal((300, 2)), axis=0), rng.standard_normal((300, 2))
    Y, h, c = law.model.regressor(z), law.dt, 1.0 - np.exp(-law.bandwidth * law.dt)
    Gamma = law.gain * np.diag([1.0 if constant else 0.0, 1.0, 1.0])
    W, r, Q, s, varsigma = np.zeros((2, 3)), np.zeros(2), np.zeros((3, 3)), np.zeros(3), law.prior
    expected, predictions, x_hat = [varsigma], [np.zeros(2)], None
    for k in range(1, 300):
        W = W + c * (0.5 * (Y[k] + Y[k - 1]) - W)
        r = r + c * ((x[k] - x[k - 1]) / h - 0.5 * (g[k] + g[k - 1]) - r)
        G, m = W.T @ W, W.T @ r
        if memory:
            fading = 1.0 - np.exp(-h / memory)
            Q, s = Q + fading * (G - Q), s + fading * (m - s)
            G, m = G + Q, m + s
        # the predictor of the docstring, run from the start with the estimate of the sample before
        x_hat = x[0]
        for j in range(1, k + 1) if k in (1, 2, 7, 50) else ():
            g_mean = 0.5 * (g[j] + g[j - 1])
            f_mean = 0.5 * (Y[j] + Y[j - 1]) @ varsigma
            x_hat = x_hat + h * (g_mean + f_mean) + c * (x[j - 1] - x_hat)
        predictions.append(x[k] - x_hat)
        right = varsigma + h * Gamma @ m + h * law.leakage * law.prior
        varsigma = np.linalg.solve((1.0 + h * law.leakage) * np.eye(3) + h * Gamma @ G, right)
        expected.append(varsigma)
    run = law.run(z, x, g)
    np.testing.assert_allclose(run.varsigma, expected, rtol=0.0, atol=SAME_RECURSION)
    for k in (1, 2, 7, 50):
        np.testing.assert_allclose(run.prediction_error[k], predictions[k], rtol=0.0, atol=SAME_RECURSION)
    np.testing.assert_allclose(
        run.f_theta, np.einsum("kij,kj->ki", Y, expected), rtol=0.0, atol=SAME_RECURSION
    )


def test_step_is_run_and_leaves_its_state_alone() -> None:
    law = law_of(1.0)
    x, g = sampled_plant(law, EXCITING, law.model.varsigma(D)[0])
    run = law.run(EXCITING[:50], x[:50], g[:50])
    state = law.start(EXCITING[0], x[0], g[0])
    first = state
    for k in range(1, 50):
        state, f_theta = law.step(state, EXCITING[k], x[k], g[k])
        np.testing.assert_allclose(f_theta, run.f_theta[k], rtol=0.0, atol=SAME_RECURSION)
    assert isinstance(state, AdaptationState)
    assert np.array_equal(first.varsigma, law.prior)
    rest = law.run(EXCITING[50:], x[50:], g[50:], state=state)
    whole = law.run(EXCITING, x, g)
    np.testing.assert_allclose(rest.f_theta, whole.f_theta[50:], rtol=0.0, atol=SAME_RECURSION)


def test_an_unseen_payload_is_recognised_in_flight() -> None:
    """The case of the paper: offline with masses known, in flight with another one, simulated in continuous time."""
    rng = np.random.default_rng(7)
    v, dm = rng.uniform(-6.0, 6.0, 3000), rng.choice([0.0, 0.2, 0.4, 0.6, 0.8, 1.0], 3000)

    def unknown(v: np.ndarray, dm: np.ndarray | float) -> np.ndarray:
        return -(9.81 * dm + 0.3 * v * np.abs(v)) / (1.0 + dm)

    model = Chebyshev(5, degree_d=3).fit(np.column_stack([v, dm]), unknown(v, dm)[:, None]).model
    t, h = 0.005 * np.arange(4000), 0.005
    thrust = 6.0 * np.sin(1.3 * t) + 2.0 * np.cos(3.1 * t) + 3.7
    solution = solve_ivp(
        lambda s, y: np.interp(s, t, thrust) + unknown(y, 0.83),
        (0.0, t[-1]),
        [0.0],
        t_eval=t,
        rtol=1e-9,
        max_step=h,
    )
    x = solution.y.T + 1e-3 * rng.standard_normal((4000, 1))
    law = AdaptiveChebyshev(model, h, rate=10.0, bandwidth=5.0, memory=2.0, g="average")
    run = law.run(x, x, thrust[:, None])
    truth = unknown(solution.y[0], 0.83)
    before = np.sqrt(np.mean((model.regressor(x)[:, 0] @ law.prior - truth)[2000:] ** 2))
    after = np.sqrt(np.mean((run.f_theta[:, 0] - truth)[2000:] ** 2))
    assert after < 0.1 * before


# ---------------------------------------------------------------------------------------------------------- bad input


MODEL, LAW = random_model(), law_of()
Z, F = np.zeros((4, 4)), np.zeros((4, 3))


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda: Chebyshev(-1), ValueError, "degree: expected at least 0"),
        (lambda: Chebyshev(1.5), TypeError, "degree: expected a whole number"),  # pyright: ignore[reportArgumentType]
        (lambda: Chebyshev(l2=float("nan")), ValueError, "l2"),
        (lambda: Chebyshev(outside="wrap"), ValueError, "outside: expected one of"),  # pyright: ignore[reportArgumentType]
        (lambda: Chebyshev(bounds=np.zeros((2, 2))), ValueError, "bounds: expected rows"),
        (lambda: Chebyshev(bounds=np.zeros((2, 3))), ValueError, r"bounds: expected shape \(N, 2\)"),
        (lambda: Chebyshev(Xi=np.zeros((1, 1))), ValueError, "expected bounds beside it"),
        (lambda: Chebyshev().predict(Z), ValueError, "no coefficients yet: call fit"),
        (lambda: Chebyshev().casadi(), ValueError, "no coefficients yet"),
        (lambda: Chebyshev(9).fit(np.zeros((3, 8)), F[:3]), ValueError, "8 columns make 100000000 terms"),
        (lambda: Chebyshev().fit(Z[:, :1], F), ValueError, "at least one column beside the n_d = 1"),
        (lambda: Chebyshev().fit(Z, F[:2]), ValueError, r"f: expected shape \(4, n_x\) to go with z"),
        (lambda: Chebyshev().fit(Z * np.nan, F), ValueError, "z: expected finite numbers"),
        (lambda: Chebyshev().fit(Z, F + 1e200), ValueError, "f: expected finite numbers up to"),
        (lambda: MODEL.predict(Z[:, :3]), ValueError, r"z: expected shape \(N, 4\)"),
        (lambda: MODEL.vjp(Z, F[:2]), ValueError, r"cotangent: expected shape .* to go with z"),
        (lambda: MODEL.with_parameters([1.0]), ValueError, r"parameters: expected shape \(432,\)"),
        (lambda: MODEL.regressor(Z), ValueError, r"x: expected shape \(N, 2\)"),
        (lambda: MODEL.varsigma(Z), ValueError, r"d: expected shape \(N, 2\)"),
        (lambda: MODEL.d_from_varsigma(np.zeros((1, 9))), ValueError, "entry of T_0"),
        (lambda: replace(MODEL, n_d=0, Xi=None).d_from_varsigma([[1.0]]), ValueError, "n_d >= 1"),
        (lambda: AdaptiveChebyshev(Chebyshev(), 0.1), ValueError, "model: expected a fitted model"),
        (lambda: replace(LAW, dt=0.0), ValueError, "dt: expected a finite number > 0"),
        (lambda: replace(LAW, leakage=-1.0), ValueError, "leakage"),
        (lambda: replace(LAW, prior=np.ones(2)), ValueError, r"prior: expected shape \(3,\)"),
        (lambda: replace(LAW, g="smooth"), ValueError, "g: expected one of"),  # pyright: ignore[reportArgumentType]
        (lambda: replace(LAW, adapt_constant=1), TypeError, "adapt_constant"),  # pyright: ignore[reportArgumentType]
        (
            lambda: replace(LAW, model=replace(LAW.model, Xi=np.zeros((2, 12)))),
            ValueError,
            "every coefficient is zero",
        ),
        (
            lambda: LAW.run(np.zeros((3, 1)), np.zeros((2, 2))),
            ValueError,
            "same number of rows, got 3, 2 and 2",
        ),
        (lambda: LAW.run(np.zeros((3, 1)), np.zeros((3, 1))), ValueError, r"x: expected shape \(N, 2\)"),
        (
            lambda: LAW.step(LAW.start([0.0], [0.0, 0.0]), [0.0], [np.nan, 0.0]),
            ValueError,
            "x: expected finite numbers",
        ),
    ],
)
def test_bad_input(act: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        act()
