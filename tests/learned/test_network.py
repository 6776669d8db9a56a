"""The network against scikit-learn, CasADi and differences; fitting, windows and bad input."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.neural_network import MLPRegressor
from sklearn.preprocessing import StandardScaler

from phyfilter_ctl.learned import FitResult, LearnedModel, Network, window
from phyfilter_ctl.learned.layers import Layers

# The same sums in another order: some 20 terms of size 10.
SAME_FORMULA = 1e-12
# Gradient by algorithmic differentiation of an expression built apart from the code under test, relative.
GRADIENT = 1e-9
# Central differences of step 1e-5: truncation 1e-10, rounding 1e-11, times the curvature.
DIFFERENCES = 1e-6
# Rounding, amplified by 60 iterations of L-BFGS whose matrix products sum in another order.
SAME_TRAINING = 1e-3


def random_network(n_z: int = 5, n_x: int = 3, hidden: tuple[int, ...] = (20, 20), seed: int = 0) -> Network:
    """A network with random weights and a standardisation that is not the identity."""
    rng = np.random.default_rng(seed)
    sizes = (n_z, *hidden, n_x)
    layers = Layers(
        tuple(rng.standard_normal((m, n)) / np.sqrt(m) for m, n in pairwise(sizes)),
        tuple(rng.standard_normal(n) for n in sizes[1:]),
        rng.standard_normal(n_z),
        rng.uniform(0.5, 2.0, n_z),
        rng.standard_normal(n_x),
        rng.uniform(0.5, 5.0, n_x),
    )
    return Network(hidden, layers=layers)


def smooth(n: int = 600, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    z = np.random.default_rng(seed).uniform(-2.0, 2.0, (n, 2)) * [1.0, 100.0] + [0.0, 500.0]
    x, y = z[:, 0], (z[:, 1] - 500.0) / 100.0
    return z, np.column_stack([np.sin(x) * y, 50.0 + 10.0 * np.cos(x + y)])


# --------------------------------------------------------------------------------------------------------- evaluation


def by_hand(network: Network, z: ca.SX, p: ca.SX) -> ca.SX:
    """The network's expression with its parameters as symbols, laid out as documented."""
    layers = network.layers
    assert layers is not None
    h, first = (z - ca.DM(layers.z_mean)) / ca.DM(layers.z_scale), 0
    depth = len(layers.sizes) - 1
    for i, (before, after) in enumerate(pairwise(layers.sizes)):
        W = ca.reshape(p[first : first + before * after], after, before)  # rows of W_i are columns here
        first += before * after
        h = W @ h + p[first : first + after]
        first += after
        h = ca.tanh(h) if i < depth - 1 else h
    return ca.DM(layers.f_mean) + ca.DM(layers.f_scale) * h


@pytest.mark.parametrize("hidden", [(20, 20), (4,), (3, 7, 2)])
def test_vjp_is_the_derivative_that_casadi_finds(hidden: tuple[int, ...]) -> None:
    network = random_network(hidden=hidden)
    rng = np.random.default_rng(1)
    z, cotangent = rng.standard_normal((30, 5)), rng.standard_normal((30, 3))
    z_, c_, p_ = ca.SX.sym("z", 5), ca.SX.sym("c", 3), ca.SX.sym("p", len(network.parameters))
    f_ = by_hand(network, z_, p_)
    derivative = ca.Function("g", [z_, c_, p_], [f_, ca.gradient(ca.dot(c_, f_), p_)])
    values, gradients = derivative(z.T, cotangent.T, network.parameters)
    np.testing.assert_allclose(network.predict(z), values.full().T, rtol=0.0, atol=SAME_FORMULA * 10)
    expected = gradients.full().reshape(-1, 30, order="F").sum(axis=1)
    np.testing.assert_allclose(
        network.vjp(z, cotangent), expected, rtol=0, atol=GRADIENT * np.abs(expected).max()
    )


def test_vjp_is_the_slope_of_the_prediction() -> None:
    network = random_network(2, 2, (3, 4))
    rng = np.random.default_rng(2)
    z, cotangent = rng.standard_normal((50, 2)), rng.standard_normal((50, 2))
    p = network.parameters

    def value(q: np.ndarray) -> float:
        return float(np.sum(cotangent * network.with_parameters(q).predict(z)))

    slopes = [(value(p + step) - value(p - step)) / 2e-5 for step in 1e-5 * np.eye(len(p))]
    gradient = network.vjp(z, cotangent)
    assert gradient.shape == p.shape
    np.testing.assert_allclose(gradient, slopes, rtol=0.0, atol=DIFFERENCES * np.abs(gradient).max())


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_casadi_is_predict(seed: int) -> None:
    network = random_network(seed=seed)
    z = 3.0 * np.random.default_rng(seed).standard_normal((20, 5))
    function = network.casadi()
    assert (function.size_in(0), function.size_out(0)) == ((5, 1), (3, 1))
    expected = function.map(20)(z.T).full().T
    np.testing.assert_allclose(network.predict(z), expected, rtol=SAME_FORMULA, atol=SAME_FORMULA * 10)
    np.testing.assert_array_equal(function(z[0]).full()[:, 0], expected[0])


def test_long_input_in_chunks_is_the_same() -> None:
    network = random_network()
    rng = np.random.default_rng(3)
    z, cotangent = rng.standard_normal((3000, 5)), rng.standard_normal((3000, 3))
    apart = np.vstack([network.predict(part) for part in np.array_split(z, 77)])
    np.testing.assert_allclose(network.predict(z), apart, rtol=0.0, atol=SAME_FORMULA * 10)
    parts = zip(np.array_split(z, 77), np.array_split(cotangent, 77), strict=True)
    expected = sum(network.vjp(*pair) for pair in parts)
    np.testing.assert_allclose(
        network.vjp(z, cotangent), expected, rtol=0, atol=1e-10 * np.abs(expected).max()
    )


def test_parameters_round_trip_and_are_frozen() -> None:
    network = random_network()
    p = network.parameters
    assert np.array_equal(network.with_parameters(p).parameters, p)
    changed = network.with_parameters(2.0 * p)
    assert np.array_equal(changed.parameters, 2.0 * p)
    assert np.array_equal(network.parameters, p)
    assert network.layers is not None
    with pytest.raises(ValueError, match="read-only"):
        network.layers.weights[0][0, 0] = 1.0
    p[:] = 0.0
    assert np.any(network.parameters != 0.0)


# ------------------------------------------------------------------------------------------------------------ fitting


@pytest.mark.parametrize("columns", [[0, 1], [1]])
def test_fit_and_predict_are_those_of_scikit_learn(columns: list[int]) -> None:
    z, f = smooth()
    f = f[:, columns]
    options = Network((8, 6), max_iterations=60, seed=3, l2=1e-3)
    result = options.fit(z, f)
    inputs, outputs = StandardScaler().fit(z), StandardScaler().fit(f)
    regressor = MLPRegressor(
        hidden_layer_sizes=(8, 6), activation="tanh", solver="lbfgs", alpha=1e-3, max_iter=60, random_state=3
    )
    targets = np.asarray(outputs.transform(f))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        regressor.fit(inputs.transform(z), targets if len(columns) > 1 else targets[:, 0])
    layers = result.model.layers
    assert layers is not None
    # the same training ...
    trained = outputs.inverse_transform(np.reshape(regressor.predict(inputs.transform(z)), f.shape))
    np.testing.assert_allclose(result.model.predict(z), trained, rtol=0.0, atol=SAME_TRAINING * f.std())
    # ... and the same value of one set of weights
    regressor.coefs_, regressor.intercepts_ = list(layers.weights), list(layers.biases)
    expected = outputs.inverse_transform(np.reshape(regressor.predict(inputs.transform(z)), f.shape))
    np.testing.assert_allclose(result.model.predict(z), expected, rtol=SAME_FORMULA, atol=1e-11)


@pytest.mark.slow
def test_fit_recovers_a_smooth_function_beyond_the_samples() -> None:
    result = Network(seed=1, tolerance=1e-5, l2=1e-6).fit(*smooth(800))
    assert isinstance(result, FitResult)
    assert result.status in ("converged", "iteration_limit")
    z, f = smooth(300, seed=9)
    error = np.sqrt(np.mean((result.model.predict(z) - f) ** 2, axis=0)) / f.std(axis=0)
    assert np.all(error < 0.02)
    z, f = smooth(800)
    assert result.rmse == pytest.approx(np.sqrt(np.mean((result.model.predict(z) - f) ** 2)), rel=1e-12)


def test_same_seed_same_network_and_another_seed_another() -> None:
    z, f = smooth(100)
    options = Network((5, 5), max_iterations=30)
    one, again = options.fit(z, f).model, options.fit(z, f).model
    other = Network((5, 5), max_iterations=30, seed=1).fit(z, f).model
    assert np.array_equal(one.parameters, again.parameters)
    assert not np.array_equal(one.parameters, other.parameters)
    assert np.array_equal(one.fit(z, f).model.parameters, one.parameters)  # a fit starts afresh


def test_statuses_not_warnings() -> None:
    z, f = smooth(100)
    short = Network((5, 5), max_iterations=3).fit(z, f)
    assert (short.status, short.iterations) == ("iteration_limit", 3)
    assert "raise max_iterations" in short.message
    assert short.model.predict(z).shape == f.shape
    adam = Network((5,), solver="adam", max_iterations=2).fit(z, f)
    assert adam.status == "iteration_limit"
    assert Network((5, 5), tolerance=1e-2).fit(z, f).status == "converged"


def test_training_that_diverges_is_a_status() -> None:
    z, f = smooth(50)
    untouched = Network((5,), l2=1e308)
    result = untouched.fit(z, f)
    assert result.status == "failed"
    assert result.rmse == float("inf")
    assert result.model is untouched


def test_constant_columns() -> None:
    z, f = smooth(100)
    z[:, 1], f[:, 0] = 0.1 + 0.2, 7.0
    model = Network((5, 5), max_iterations=20).fit(z, f).model
    elsewhere = np.vstack([z, 3.0 * z])
    np.testing.assert_allclose(
        model.predict(elsewhere)[:, 0], 7.0, rtol=1e-15
    )  # whatever the training came to
    assert np.ptp(model.predict(z)[:, 1]) > 0.0


def test_is_a_learned_model() -> None:
    assert isinstance(Network(), LearnedModel)
    assert isinstance(random_network(), LearnedModel)
    assert Network().parameters.shape == (0,)
    assert repr(Network()) == "Network(hidden=(20, 20), not fitted)"
    assert repr(random_network()) == "Network(hidden=(20, 20), 5 -> 3, 603 parameters)"


# ------------------------------------------------------------------------------------------------------------- window


@given(n=st.integers(1, 30), channels=st.integers(1, 3), length=st.integers(1, 8), stride=st.integers(1, 5))
@settings(max_examples=60, deadline=None)
def test_window_is_its_definition(n: int, channels: int, length: int, stride: int) -> None:
    x = np.random.default_rng(n).standard_normal((n, channels))
    expected = [np.concatenate([x[max(k - j * stride, 0)] for j in range(length)]) for k in range(n)]
    assert np.array_equal(window(x, length, stride=stride), expected)


def test_window_is_a_copy() -> None:
    x = np.zeros((5, 2))
    window(x, 1)[:] = 1.0
    assert not x.any()


# ---------------------------------------------------------------------------------------------------------- bad input


NETWORK = random_network()
Z, F = np.zeros((4, 5)), np.zeros((4, 3))


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda: Network(()), ValueError, "hidden: expected the units of at least one layer"),
        (lambda: Network((0,)), ValueError, "hidden: expected at least 1"),
        (lambda: Network((2.5,)), TypeError, "hidden"),  # pyright: ignore[reportArgumentType]
        (lambda: Network(solver="sgd"), ValueError, "solver: expected one of"),  # pyright: ignore[reportArgumentType]
        (lambda: Network(l2=-1.0), ValueError, "l2"),
        (lambda: Network(tolerance=float("nan")), ValueError, "tolerance"),
        (lambda: Network(max_iterations=0), ValueError, "max_iterations"),
        (lambda: Network(seed=-1), ValueError, "seed: expected at least 0"),
        (lambda: Network((3,), layers=NETWORK.layers), ValueError, r"expected hidden layers of \(3,\) units"),
        (lambda: Network().predict(Z), ValueError, "no weights yet: call fit"),
        (lambda: Network().vjp(Z, F), ValueError, "no weights yet"),
        (lambda: Network().casadi(), ValueError, "no weights yet"),
        (lambda: Network().with_parameters([]), ValueError, "no weights yet"),
        (lambda: Network().fit(Z, F[:2]), ValueError, r"f: expected shape \(4, n_x\) to go with z"),
        (lambda: Network().fit(Z, F[:, 0]), ValueError, r"f: .*; for one channel give f\[:, None\]"),
        (
            lambda: Network().fit(Z * np.nan, F),
            ValueError,
            "z: expected finite numbers, none masked, got nan in row 0, column 0",
        ),
        (lambda: Network().fit(Z, F + np.inf), ValueError, "f: expected finite numbers"),
        (lambda: Network().fit(Z + 1e200, F), ValueError, r"z: expected finite numbers up to 1e\+150"),
        (lambda: Network().fit([["a"]], [[1.0]]), TypeError, "z: expected an array of real numbers"),
        (lambda: NETWORK.predict(Z[:, :4]), ValueError, r"z: expected shape \(N, 5\), got \(4, 4\)"),
        (lambda: NETWORK.predict(Z[:0]), ValueError, "z: expected shape"),
        (lambda: NETWORK.vjp(Z, F[:, :2]), ValueError, r"cotangent: expected shape \(4, 3\)"),
        (lambda: NETWORK.vjp(Z, F[:2]), ValueError, r"cotangent: expected shape .* to go with z"),
        (
            lambda: NETWORK.with_parameters([1.0]),
            ValueError,
            r"parameters: expected shape \(603,\), got \(1,\)",
        ),
        (
            lambda: NETWORK.with_parameters(np.full(603, np.nan)),
            ValueError,
            r"parameters: expected finite numbers.*entry 0",
        ),
        (lambda: window(np.zeros(3), 2), ValueError, r"x: .*for one channel give x\[:, None\]"),
        (lambda: window(np.zeros((3, 1)), 0), ValueError, "length: expected at least 1"),
        (lambda: window(np.zeros((3, 1)), 1, stride=0), ValueError, "stride: expected at least 1"),
        (lambda: window([[np.nan]], 1), ValueError, "x: expected finite numbers"),
    ],
)
def test_bad_input(act: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        act()
