"""Neural ODE: exact gradients of the rollouts, known laws recovered from motions, statuses and bad input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phyfilter_ctl.learned import LearnedModel, NeuralOde, Trajectory
from phyfilter_ctl.learned._rollout import Segments, ends, misfit
from phyfilter_ctl.learned.layers import Layers
from tests.cpu_budget import slow_but

# The same sums in another order: some 20 terms of size 10.
SAME_FORMULA = 1e-12
# Gradient by algorithmic differentiation or a complex step, relative to its largest entry.
GRADIENT = 1e-9


def random_layers(n_z: int, n_x: int, hidden: tuple[int, ...] = (5, 4), seed: int = 0) -> Layers:
    rng = np.random.default_rng(seed)
    sizes = (n_z, *hidden, n_x)
    return Layers(
        tuple(rng.standard_normal(pair) for pair in pairwise(sizes)),
        tuple(rng.standard_normal(n) for n in sizes[1:]),
        rng.standard_normal(n_z),
        rng.uniform(0.5, 2.0, n_z),
        rng.standard_normal(n_x),
        rng.uniform(0.5, 2.0, n_x),
    )


def random_segments(B: int, S: int, held: tuple[bool, bool]) -> Segments:
    rng = np.random.default_rng(1)
    shape = (B, 2 * S + 1)
    x, g, u = (
        rng.standard_normal((B, S + 1, 2)),
        rng.standard_normal((*shape, 2)),
        rng.standard_normal((*shape, 1)),
    )
    return Segments(x, g, u, rng.uniform(0.05, 0.2, B), held)


def network(layers: Layers, p: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The layers' formula with other parameters, in complex arithmetic too."""
    h, first, depth = (z - layers.z_mean) / layers.z_scale, 0, len(layers.sizes) - 1
    for i, (before, after) in enumerate(pairwise(layers.sizes)):
        W = p[first : first + before * after].reshape(before, after)
        first += before * after
        h = h @ W + p[first : first + after]
        first += after
        h = np.tanh(h) if i < depth - 1 else h
    return layers.f_mean + layers.f_scale * h


def rollout(layers: Layers, p: np.ndarray, segments: Segments, b: int, x: np.ndarray) -> list[np.ndarray]:
    """Classical Runge-Kutta steps of segment b, written out."""
    h, states = segments.dt[b], [x]
    for i in range(segments.x.shape[1] - 1):
        g0, gm, g1 = (segments.g[b, 2 * i + (0 if segments.held[0] else j)] for j in range(3))
        u0, um, u1 = (segments.u[b, 2 * i + (0 if segments.held[1] else j)] for j in range(3))

        def slope(x: np.ndarray, g: np.ndarray, u: np.ndarray) -> np.ndarray:
            return g + network(layers, p, np.concatenate([x, u]))

        k1 = slope(x, g0, u0)
        k2 = slope(x + h / 2 * k1, gm, um)
        k3 = slope(x + h / 2 * k2, gm, um)
        k4 = slope(x + h * k3, g1, u1)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(x)
    return states


# ---------------------------------------------------------------------------------------------------------- gradients


@pytest.mark.parametrize("held", [(True, False), (False, True)])
def test_the_gradient_of_the_rollouts_is_the_complex_step(held: tuple[bool, bool]) -> None:
    layers, segments = random_layers(3, 2), random_segments(3, 4, held)
    scale, starts, p = np.array([0.7, 3.0]), segments.x[:, 0] + 0.1, layers.parameters

    def value(p: np.ndarray, starts: np.ndarray) -> complex:
        total = 0.0
        for b in range(3):
            states = np.array(rollout(layers, p, segments, b, starts[b]))
            total = total + 0.5 * np.sum(((states - segments.x[b]) / scale) ** 2)
        return complex(total)

    J, of_parameters, of_starts = misfit(layers, segments, starts, scale)
    assert pytest.approx(value(p, starts).real, rel=1e-12) == J
    expected = [value(p + s, starts.astype(complex)).imag / 1e-30 for s in 1e-30j * np.eye(len(p))]
    np.testing.assert_allclose(of_parameters, expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max())
    steps = 1e-30j * np.eye(6).reshape(6, 3, 2)
    expected = np.reshape([value(p, starts + s).imag / 1e-30 for s in steps], (3, 2))
    np.testing.assert_allclose(of_starts, expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max())
    last = [rollout(layers, p, segments, b, starts[b])[-1] for b in range(3)]
    np.testing.assert_allclose(
        ends(layers, segments, starts), last, rtol=SAME_FORMULA, atol=10 * SAME_FORMULA
    )


def test_many_segments_in_batches_are_the_same() -> None:
    layers, segments = random_layers(3, 2), random_segments(700, 3, (True, True))
    scale, starts = np.ones(2), segments.x[:, 0]
    whole = misfit(layers, segments, starts, scale)
    parts = [misfit(layers, segments.rows(r), starts[r], scale) for r in (slice(0, 300), slice(300, 700))]
    assert whole[0] == pytest.approx(parts[0][0] + parts[1][0], rel=1e-12)
    np.testing.assert_allclose(whole[1], parts[0][1] + parts[1][1], atol=1e-10 * np.abs(whole[1]).max())
    np.testing.assert_allclose(whole[2], np.vstack([parts[0][2], parts[1][2]]), rtol=1e-12, atol=1e-12)


def test_vjp_is_the_complex_step_and_casadi_is_predict() -> None:
    model = NeuralOde((5, 4), layers=random_layers(3, 2))
    rng = np.random.default_rng(2)
    z, cotangent, p = rng.standard_normal((20, 3)), rng.standard_normal((20, 2)), model.parameters
    assert model.layers is not None
    layers = model.layers
    steps = 1e-30j * np.eye(len(p))
    expected = [np.sum(cotangent * network(layers, p + s, z).imag) / 1e-30 for s in steps]
    actual = model.vjp(z, cotangent)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max())
    function = model.casadi()
    np.testing.assert_allclose(
        model.predict(z), function.map(20)(z.T).full().T, rtol=SAME_FORMULA, atol=10 * SAME_FORMULA
    )
    assert isinstance(model, LearnedModel)


@pytest.mark.parametrize("g", ["hold", "average"])
@pytest.mark.parametrize("u", ["hold", "average"])
def test_simulate_is_the_rollout_written_out(g: str, u: str) -> None:
    model = NeuralOde((5, 4), layers=random_layers(3, 2), g=g, u=u)  # pyright: ignore[reportArgumentType]
    rng = np.random.default_rng(3)
    x, known, inputs = rng.standard_normal((6, 2)), rng.standard_normal((6, 2)), rng.standard_normal((6, 1))
    motion = Trajectory(x, 0.1, g=known, u=inputs)
    fine = [
        np.stack([np.interp(np.arange(11) / 2, np.arange(6), c) for c in a.T], axis=-1)[None]
        for a in (known, inputs)
    ]
    segments = Segments(x[None], *fine, np.array([0.1]), (g == "hold", u == "hold"))
    expected = rollout(random_layers(3, 2), model.parameters, segments, 0, x[0])
    np.testing.assert_allclose(model.simulate(motion), expected, rtol=SAME_FORMULA, atol=10 * SAME_FORMULA)


# ------------------------------------------------------------------------------------------------ known laws recovered


def pendulum(t: float, x: np.ndarray) -> np.ndarray:
    return np.array([x[1], -9.81 * np.sin(x[0]) - 0.3 * x[1]])


def swing(x0: list[float], noise: float = 0.0, seed: int = 0, h: float = 0.02) -> Trajectory:
    t = np.arange(0.0, 5.0, h)
    x = solve_ivp(pendulum, (0.0, 5.0), x0, t_eval=t, rtol=1e-10, atol=1e-12).y.T
    return Trajectory(x + noise * np.random.default_rng(seed).standard_normal(x.shape), h)


STARTS = [[2.0, 0.0], [1.0, 2.0], [-1.5, -1.0], [0.5, 0.0]]


def law_error(model: NeuralOde) -> np.ndarray:
    """Relative error of the law on motions that were not fitted to."""
    z = np.concatenate([swing([1.2, 1.0]).x, swing([-0.8, -0.5]).x])
    truth = pendulum(0.0, z.T).T
    return np.sqrt(np.mean((model.predict(z) - truth) ** 2, axis=0)) / truth.std(axis=0)


def test_the_law_of_a_pendulum_is_recovered() -> None:
    result = NeuralOde((12,), max_iterations=300).fit_trajectories([swing(x0) for x0 in STARTS])
    assert result.status == "converged"
    assert np.all(law_error(result.model) < 0.01)
    unseen = swing([1.2, 1.0])
    assert np.max(np.abs(result.model.simulate(unseen) - unseen.x)[:100]) < 0.15


@pytest.mark.slow
def test_free_starts_take_the_noise_out_of_the_law() -> None:
    noisy = [swing(x0, 0.05, seed) for seed, x0 in enumerate(STARTS)]
    errors = {}
    for starts in ("free", "measured"):
        options = NeuralOde((8,), segment=10, starts=starts, max_iterations=150, l2=1e-6)
        errors[starts] = law_error(options.fit_trajectories(noisy).model)
    assert np.all(errors["free"] < 0.06)
    assert errors["free"].sum() < 0.7 * errors["measured"].sum()


@pytest.mark.slow
@pytest.mark.parametrize("g", slow_but(("average",), ("hold", "average")))
def test_the_law_of_drag_is_recovered_beside_a_known_thrust(g: str) -> None:
    h, rng = 0.02, np.random.default_rng(0)
    t = h * np.arange(1500)
    thrust = np.stack([3.0 * np.sin(t + a) + 2.0 * np.cos(2.7 * t * (1 + a)) for a in (0.0, 1.0)], axis=-1)
    wind = np.repeat(rng.uniform(-1.0, 1.0, (30, 1)), 50, axis=0)

    def motion(s: float, v: np.ndarray, k: int) -> np.ndarray:
        share = 0.0 if g == "hold" else (s - t[k]) / h
        drive = (1.0 - share) * thrust[k] + share * thrust[k + 1]
        return drive - 0.4 * (v - wind[k]) * np.abs(v - wind[k])

    x = [np.zeros(2)]
    for k in range(1499):  # step by step: what is held jumps between the steps of the integrator only
        span = (t[k], t[k + 1])
        x.append(solve_ivp(motion, span, x[-1], method="RK45", rtol=1e-6, atol=1e-9, args=(k,)).y[:, -1])
    data = Trajectory(np.array(x), h, g=thrust, u=wind)
    options = NeuralOde((10,), g=g, u="hold", max_iterations=400, segment=15)  # pyright: ignore[reportArgumentType]
    result = options.fit_trajectories(data)
    truth = -0.4 * (data.x - wind) * np.abs(data.x - wind)
    error = np.sqrt(np.mean((result.model.predict(np.hstack([data.x, wind])) - truth) ** 2)) / truth.std()
    assert error < 0.03
    assert result.rmse < 0.05 * truth.std()


def test_labels_are_fitted_as_by_every_learned_model() -> None:
    rng = np.random.default_rng(0)
    z = rng.uniform(-2.0, 2.0, (400, 2))
    f = pendulum(0.0, z.T).T
    result = NeuralOde((10,), max_iterations=300).fit(z, f)
    assert result.rmse < 0.02 * f.std()
    assert result.rmse == pytest.approx(np.sqrt(np.mean((result.model.predict(z) - f) ** 2)), rel=1e-12)
    assert np.array_equal(
        result.model.fit(z, f).model.parameters, result.model.parameters
    )  # a fit starts afresh


def test_trajectories_go_on_from_the_weights_at_hand() -> None:
    motions = [swing(x0) for x0 in STARTS[:2]]
    options = NeuralOde((6,), max_iterations=40)
    one = options.fit_trajectories(motions)
    two = one.model.fit_trajectories(motions)
    assert one.status == "iteration_limit"
    assert "raise max_iterations" in one.message
    assert two.rmse < one.rmse
    again = options.fit_trajectories(motions)
    assert np.array_equal(again.model.parameters, one.model.parameters)


def test_segments_cover_every_sample_with_one_overlap() -> None:
    model = NeuralOde((3,), segment=10, max_iterations=1)
    x = np.arange(36.0)[:, None]
    segments = model._segments([Trajectory(x, 0.1), Trajectory(x[:11], 0.2)])
    assert segments.x[:, 0, 0].tolist() == [0.0, 10.0, 20.0, 25.0, 0.0]
    assert segments.dt.tolist() == [0.1] * 4 + [0.2]


def test_a_fit_that_diverges_is_a_status() -> None:
    layers = random_layers(2, 2, (3,))
    wild = NeuralOde((3,), layers=layers.with_parameters(1e200 * layers.parameters))
    result = wild.fit_trajectories(swing(STARTS[0]))
    assert result.status == "failed"
    assert result.rmse == float("inf")
    assert result.model is wild
    assert "the fit diverged" in result.message


def test_save_and_load(tmp_path: Path) -> None:
    model = NeuralOde(
        (5, 4), layers=random_layers(3, 2), segment=7, starts="measured", u="hold", l2=0.1, seed=3
    )
    model.save(tmp_path / "m.npz")
    loaded = NeuralOde.load(tmp_path / "m.npz")
    for name in ("hidden", "segment", "starts", "g", "u", "l2", "max_iterations", "tolerance", "seed"):
        assert getattr(loaded, name) == getattr(model, name)
    z = np.random.default_rng(0).standard_normal((5, 3))
    assert loaded.predict(z).tobytes() == model.predict(z).tobytes()
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        arrays = dict(archive)
    for change, words in (
        ({"segment": np.array(0)}, "segment: expected at least 1"),
        ({"weights_0": np.zeros((2, 2))}, "do not fit together"),
        ({"kind": np.array("network")}, "expected kind 'neural_ode'"),
    ):
        np.savez(tmp_path / "bad.npz", allow_pickle=False, **(arrays | change))
        with pytest.raises(ValueError, match=words):
            NeuralOde.load(tmp_path / "bad.npz")
    with pytest.raises(ValueError, match="no weights yet"):
        NeuralOde().save(tmp_path / "none.npz")


def test_the_expression_can_be_differentiated() -> None:
    function = NeuralOde((5, 4), layers=random_layers(3, 2)).casadi()
    z = ca.SX.sym("z", 3)
    jacobian = ca.Function("J", [z], [ca.jacobian(function(z), z)])
    assert jacobian(np.ones(3)).shape == (2, 3)


# ---------------------------------------------------------------------------------------------------------- bad input


MODEL = NeuralOde((5, 4), layers=random_layers(3, 2))
X = np.zeros((20, 2))


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda: NeuralOde(()), ValueError, "hidden: expected the units"),
        (lambda: NeuralOde(segment=0), ValueError, "segment: expected at least 1"),
        (lambda: NeuralOde(starts="late"), ValueError, "starts: expected one of"),  # pyright: ignore[reportArgumentType]
        (lambda: NeuralOde(g="zoh"), ValueError, "g: expected one of"),  # pyright: ignore[reportArgumentType]
        (lambda: NeuralOde(l2=-1.0), ValueError, "l2"),
        (lambda: NeuralOde((3,), layers=random_layers(3, 2)), ValueError, r"hidden layers of \(3,\) units"),
        (lambda: Trajectory(X, 0.0), ValueError, "dt: expected a finite number > 0"),
        (lambda: Trajectory(X[:1], 0.1), ValueError, "x: expected at least 2 samples"),
        (lambda: Trajectory(X * np.nan, 0.1), ValueError, "x: expected finite numbers"),
        (lambda: Trajectory(X, 0.1, g=X[:5]), ValueError, "g: expected 20 rows as in x, got 5"),
        (lambda: Trajectory(X, 0.1, g=X[:, :1]), ValueError, r"g: expected shape \(N, 2\)"),
        (lambda: NeuralOde().fit_trajectories([]), ValueError, "expected at least one, got none"),
        (
            lambda: NeuralOde(segment=20).fit_trajectories(Trajectory(X, 0.1)),
            ValueError,
            "fewer than a segment of 20",
        ),
        (
            lambda: NeuralOde().fit_trajectories([Trajectory(X, 0.1), Trajectory(X, 0.1, u=X)]),
            ValueError,
            "expected the same channels",
        ),
        (
            lambda: MODEL.fit_trajectories(Trajectory(X, 0.1)),
            ValueError,
            "2 states and 1 inputs u, got 2 and 0",
        ),
        (lambda: MODEL.simulate(Trajectory(X, 0.1)), ValueError, "2 states and 1 inputs u, got 2 and 0"),
        (lambda: NeuralOde().predict(X), ValueError, "no weights yet: call fit_trajectories"),
        (lambda: NeuralOde().fit(X, X[:3]), ValueError, r"f: expected shape .* to go with z"),
        (
            lambda: MODEL.vjp(np.zeros((4, 3)), np.zeros((3, 2))),
            ValueError,
            r"cotangent: expected shape .* to go with z",
        ),
        (lambda: MODEL.with_parameters([1.0]), ValueError, "parameters: expected shape"),
        (lambda: replace(MODEL, layers=None).with_parameters([1.0]), ValueError, "no weights yet"),
    ],
)
def test_bad_input(act: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        act()
