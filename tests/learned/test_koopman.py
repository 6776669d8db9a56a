"""Koopman models: known operators recovered, the recursion against the batch, downdates under stress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from phyfilter_ctl.learned import Dictionary, Koopman, LearnedModel, OnlineKoopman

# The same sums in another order: some ten terms of size 10.
SAME_FORMULA = 1e-12
# Gradient by algorithmic differentiation, relative to its largest entry.
GRADIENT = 1e-9
# Least squares of noise-free data in the span of the dictionary.
RECOVERED = 1e-9
# Sliding window by recursion, by sums and by a least squares of its own, well-excited windows.
RECURSION = 1e-9

H = 0.01


def dictionary(radial: bool = False) -> Dictionary:
    rng = np.random.default_rng(5)
    centres = rng.standard_normal((4, 3)) if radial else None
    return Dictionary(3, degree=2, centres=centres, width=1.5, offset=[0.1, -0.2, 0.3], scale=[1.0, 2.0, 0.5])  # pyright: ignore[reportArgumentType]


def random_model(radial: bool = True, seed: int = 0) -> Koopman:
    psi = dictionary(radial)
    W = np.random.default_rng(seed).standard_normal((psi.size, 2))
    return Koopman(psi, 2, dt=0.1, W=W)


def excited(n: int = 600, seed: int = 0) -> np.ndarray:
    """f, x, d: one channel that follows the others with some noise, all in motion."""
    rng = np.random.default_rng(seed)
    t = H * np.arange(n)
    x, d = np.sin(9.0 * t) + 0.3 * rng.standard_normal(n), np.cos(5.0 * t) + 0.3 * rng.standard_normal(n)
    f = np.cumsum(H * (x * d - 0.5 * x)) + 0.3 * rng.standard_normal(n)
    return np.column_stack([f, x, d])


# --------------------------------------------------------------------------------------------------------- dictionary


def test_monomials_in_order_and_radial_functions() -> None:
    psi = dictionary(radial=True)
    z = np.random.default_rng(1).standard_normal((6, 3))
    a, b, c = ((z - psi.offset) / psi.scale).T
    monomials = [a**0, a, b, c, a * a, a * b, a * c, b * b, b * c, c * c]
    assert psi.centres is not None
    s, centres = (z - psi.offset) / psi.scale, (psi.centres - psi.offset) / psi.scale
    radial = [np.exp(-np.sum((s - centre) ** 2, axis=1) / 4.5) for centre in centres]
    np.testing.assert_allclose(psi(z), np.column_stack(monomials + radial), rtol=SAME_FORMULA)
    assert psi.size == 14
    assert repr(psi) == "Dictionary(3, degree=2, 4 centres, 14 functions)"


def test_scaled_to_the_data() -> None:
    z = np.random.default_rng(1).standard_normal((50, 3)) * [1.0, 1e3, 0.0] + [0.0, 5.0, 7.0]
    psi = Dictionary(3, degree=1).scaled_to(z)(z)
    np.testing.assert_allclose(psi[:, :3].std(axis=0), [0.0, 1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(psi[:, 3], 0.0)


# --------------------------------------------------------------------------------------------------------- evaluation


@given(seed=st.integers(0, 1000), radial=st.booleans())
@settings(max_examples=20, deadline=None)
def test_casadi_is_predict(seed: int, radial: bool) -> None:
    model = random_model(radial, seed)
    z = 2.0 * np.random.default_rng(seed).standard_normal((10, 3))
    expected = model.casadi().map(10)(z.T).full().T
    np.testing.assert_allclose(model.predict(z), expected, rtol=SAME_FORMULA, atol=10 * SAME_FORMULA)
    np.testing.assert_allclose(model.rate(z), (expected - z[:, :2]) / 0.1, atol=1e-9)


def test_vjp_is_the_derivative_that_casadi_finds() -> None:
    model = random_model()
    rng = np.random.default_rng(2)
    z, cotangent = rng.standard_normal((25, 3)), rng.standard_normal((25, 2))
    W, z_, c_ = ca.SX.sym("W", model.parameters.size), ca.SX.sym("z", 3), ca.SX.sym("c", 2)
    f = z_[:2] + 0.1 * ca.reshape(W, 2, model.dictionary.size) @ model.dictionary.expression(z_)
    gradient = ca.Function("g", [W, z_, c_], [ca.gradient(ca.dot(c_, f), W)])
    expected = sum(gradient(model.parameters, a, b).full()[:, 0] for a, b in zip(z, cotangent, strict=True))
    np.testing.assert_allclose(
        model.vjp(z, cotangent), expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max()
    )


def test_parameters_round_trip() -> None:
    model = random_model()
    assert isinstance(model, LearnedModel)
    assert np.array_equal(model.with_parameters(2.0 * model.parameters).W, 2.0 * np.asarray(model.W))
    assert Koopman(dictionary(), 1, dt=0.1).parameters.shape == (0,)
    assert "not fitted" in repr(Koopman(dictionary(), 1, dt=0.1))


# --------------------------------------------------------------------------------------------- known truths recovered


def test_a_linear_system_is_recovered() -> None:
    """f' = A f + B d, d held: the weights are those of the matrix exponential, and the operator has its eigenvalues."""
    A, B = np.array([[-0.5, 2.0], [-2.0, -0.5]]), np.array([[1.0], [0.5]])
    transition = expm(H * np.block([[A, B], [np.zeros((1, 3))]]))
    d = np.repeat(np.random.default_rng(0).standard_normal(100), 20)
    f = np.zeros((2001, 2))
    for k in range(2000):
        f[k + 1] = (transition @ [*f[k], d[k]])[:2]
    z = np.column_stack([f[:-1], d])
    model = Koopman(Dictionary(3, degree=1), 2, dt=H, l2=0.0).fit(z, f[1:]).model
    expected = np.hstack([np.zeros((2, 1)), (transition[:2] - np.eye(2, 3)) / H])
    np.testing.assert_allclose(np.asarray(model.W).T, expected, rtol=0.0, atol=RECOVERED)


def slow_manifold(n: int) -> np.ndarray:
    """f1' = mu f1, f2' = lam (f2 - f1^2): nonlinear, with the invariant subspace of f1, f2, f1^2; exact solution."""
    mu, lam = -0.4, -2.0
    t = H * np.arange(n)
    b = lam / (lam - 2.0 * mu)
    f1 = 1.5 * np.exp(mu * t)
    return np.column_stack([f1, b * f1**2 + (0.3 - b * 1.5**2) * np.exp(lam * t)])


def test_a_nonlinear_system_with_an_invariant_subspace_is_recovered() -> None:
    f = slow_manifold(400)
    # f1^2 alone beside f1 and f2: the span of the monomials that the motion excites and that stays invariant
    result = Koopman(Dictionary(2, degree=2), 2, dt=H, l2=0.0).fit(f[:-1], f[1:])
    assert result.rmse < 1e-12
    run = OnlineKoopman(Koopman(Dictionary(2, degree=2), 2, dt=H, l2=1e-12), 50).run(f)
    assert np.max(np.abs(run.f_theta[60:] - f[60:])) < 1e-5
    rates = np.column_stack([-0.4 * f[:, 0], -2.0 * (f[:, 1] - f[:, 0] ** 2)])
    middle = 0.5 * (rates[60:-1] + rates[61:])  # the mean over the step, to the trapezoidal rule
    assert np.max(np.abs(run.rate[60:-1] - middle)) < 1e-3


def test_the_operator_has_the_eigenvalues_of_the_modes() -> None:
    starts = np.random.default_rng(3).uniform(-1.0, 1.0, (300, 2))
    mu, lam = -0.4, -2.0
    b = lam / (lam - 2.0 * mu)
    after = starts * np.exp([mu * H, lam * H])
    after[:, 1] = b * after[:, 0] ** 2 + (starts[:, 1] - b * starts[:, 0] ** 2) * np.exp(lam * H)
    model = Koopman(Dictionary(2, degree=2), 2, dt=H, l2=0.0).fit(starts, after).model
    one, f1, f2, f1f1 = 0, 1, 2, 3
    W = np.asarray(model.W)
    np.testing.assert_allclose(1.0 + H * W[[f1, f2], [0, 1]], np.exp([mu * H, lam * H]), atol=RECOVERED)
    np.testing.assert_allclose(H * W[f1f1, 1], b * (np.exp(2 * mu * H) - np.exp(lam * H)), atol=RECOVERED)
    np.testing.assert_allclose(H * W[one], 0.0, atol=RECOVERED)
    # the whole operator, on a linear motion where every monomial of degree 2 is a product of modes
    f = np.exp(np.outer(H * np.arange(200), [mu, lam])) * [1.0, -0.7]
    K = Dictionary(2, degree=2).operator(f)
    expected = np.exp(H * np.array([0.0, mu, lam, 2 * mu, mu + lam, 2 * lam]))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(K).real), np.sort(expected), atol=1e-7)


def test_prediction_beats_holding_the_last_value() -> None:
    t = H * np.arange(3000)
    f = (np.sin(3.0 * t) + 0.5 * np.sin(7.0 * t))[:, None]
    z = np.column_stack([f, np.cos(3.0 * t), np.cos(7.0 * t)])
    run = OnlineKoopman(Koopman(Dictionary(3, degree=1), 1, dt=H, l2=1e-10), 200).run(z)
    held = np.max(np.abs(f[301:] - f[300:-1]))
    assert np.max(np.abs(run.f_theta[301:] - f[301:])) < 2e-2 * held


# ----------------------------------------------------------------------------------------------------- sliding window


def batch(online: OnlineKoopman, z: np.ndarray, k: int) -> np.ndarray:
    """Weights of the window that ends with sample k, by a least squares of their own."""
    first = max(0, k - online.window)
    psi, m = online.model.dictionary(z[first:k]), online.model.dictionary.size
    rates = np.diff(z[first : k + 1, : online.model.n_f], axis=0) / online.model.dt
    ridge = np.sqrt(online.model.l2 * online.window) * np.eye(m)
    right = np.vstack([rates, np.zeros((m, rates.shape[1]))])
    return np.linalg.lstsq(np.vstack([psi, ridge]), right, rcond=None)[0]


@pytest.mark.parametrize("refresh", [1, None, 10**9])
@pytest.mark.parametrize("radial", [False, True])
def test_recursion_is_the_batch(refresh: int | None, radial: bool) -> None:
    z = excited()
    online = OnlineKoopman(Koopman(dictionary(radial), 1, dt=H, l2=1e-4), 80, refresh=refresh)
    run, state = online.run(z), online.start(z[0])
    for k in range(1, len(z)):
        state, f_next = online.step(state, z[k])
        scale = np.abs(run.f_next[k]).max()
        np.testing.assert_allclose(f_next, run.f_next[k], rtol=0.0, atol=RECURSION * max(scale, 1.0))
        if k % 97 == 0:
            expected = batch(online, z, k)
            np.testing.assert_allclose(state.W, expected, rtol=0.0, atol=RECURSION * np.abs(expected).max())
    np.testing.assert_allclose(online.model_at(state).predict(z[-1:])[0], run.f_next[-1], atol=RECURSION)
    np.testing.assert_allclose(
        run.model.parameters, state.W.ravel(), rtol=0.0, atol=1e-8 * np.abs(state.W).max()
    )


def test_run_over_several_chunks_and_what_it_returns() -> None:
    z = excited(2500)
    online = OnlineKoopman(Koopman(dictionary(), 1, dt=H, l2=1e-4), 60)
    run = online.run(z)
    for k in (1, 30, 61, 256, 257, 1000, 2499):
        W = batch(online, z, k)
        expected = z[k, :1] + H * (online.model.dictionary(z[k : k + 1]) @ W)[0]
        np.testing.assert_allclose(run.f_next[k], expected, rtol=0.0, atol=RECURSION)
    assert np.array_equal(run.f_theta[1:], run.f_next[:-1])
    assert run.f_theta[0, 0] == z[0, 0] == run.f_next[0, 0]
    np.testing.assert_allclose(run.rate, (run.f_next - z[:, :1]) / H, atol=1e-9)


def test_downdates_survive_poor_excitation() -> None:
    """Excited, then standing still, then huge, then excited: the inverse would be lost without factorising anew."""
    rng = np.random.default_rng(0)
    still = np.ones((300, 3)) + 1e-9 * rng.standard_normal((300, 3))
    z = np.vstack([excited(300), still, 1e4 * excited(3, 1), still, excited(300, 2)])
    online = OnlineKoopman(Koopman(dictionary(), 1, dt=H, l2=1e-8), 40, refresh=10**9)
    state, ages = online.start(z[0]), []
    for k in range(1, len(z)):
        state, f_next = online.step(state, z[k])
        assert np.all(np.isfinite(f_next))
        ages.append(state.age)
    assert 0 in ages  # it did factorise where it had to
    assert max(ages) > 100  # and only there
    expected = batch(online, z, len(z) - 1)
    np.testing.assert_allclose(state.W, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())
    run = online.run(z)
    np.testing.assert_allclose(run.model.W, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())
    assert np.all(np.isfinite(run.f_next))


def test_step_leaves_its_state_alone() -> None:
    z = excited(10)
    online = OnlineKoopman(Koopman(dictionary(), 1, dt=H), 5)
    state = online.start(z[0])
    copies = [np.copy(getattr(state, name)) for name in ("lifted", "gram", "inverse", "W", "psi")]
    online.step(state, z[1])
    for name, copy in zip(("lifted", "gram", "inverse", "W", "psi"), copies, strict=True):
        assert np.array_equal(getattr(state, name), copy)


def test_save_and_load(tmp_path: Path) -> None:
    model = random_model()
    model.save(tmp_path / "m.npz")
    loaded = Koopman.load(tmp_path / "m.npz")
    z = np.random.default_rng(0).standard_normal((7, 3))
    assert loaded.predict(z).tobytes() == model.predict(z).tobytes()
    assert (loaded.n_f, loaded.dt, loaded.l2) == (model.n_f, model.dt, model.l2)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        arrays = dict(archive)
    for change, words in (
        ({"W": np.zeros((3, 2))}, "W: expected shape"),
        ({"degree": np.array(10**6)}, "make .* functions"),
        ({"scale": np.zeros(3)}, "scale: expected numbers > 0"),
        ({"extra": np.zeros(3)}, "expected the entries"),
    ):
        np.savez(tmp_path / "bad.npz", allow_pickle=False, **(arrays | change))
        with pytest.raises(ValueError, match=words):
            Koopman.load(tmp_path / "bad.npz")
    with pytest.raises(ValueError, match="no weights yet"):
        replace(model, W=None).save(tmp_path / "none.npz")


def test_statuses() -> None:
    z = np.random.default_rng(0).standard_normal((5, 3))
    result = Koopman(dictionary(), 1, dt=H).fit(z, z[:, :1])
    assert result.status == "converged"
    assert "the data determine 5 of 10 weights" in result.message
    with np.errstate(over="ignore", invalid="ignore"):
        wild = Koopman(Dictionary(3, degree=4), 1, dt=H).fit(1e100 * z, z[:, :1])
    assert wild.status == "failed"
    assert "scale it with Dictionary.scaled_to" in wild.message


# ---------------------------------------------------------------------------------------------------------- bad input


MODEL = random_model()
ONLINE = OnlineKoopman(Koopman(dictionary(), 1, dt=H), 5)
Z, F = np.zeros((4, 3)), np.zeros((4, 2))


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda: Dictionary(0), ValueError, "n_z: expected at least 1"),
        (lambda: Dictionary(2, degree=-1), ValueError, "degree: expected at least 0"),
        (lambda: Dictionary(2, width=0.0), ValueError, "width: expected a finite number > 0"),
        (lambda: Dictionary(2, scale=np.zeros(2)), ValueError, "scale: expected numbers > 0"),
        (lambda: Dictionary(2, offset=np.zeros(3)), ValueError, r"offset: expected shape \(2,\)"),
        (lambda: Dictionary(2, centres=np.zeros((4, 3))), ValueError, r"centres: expected shape \(N, 2\)"),
        (lambda: Dictionary(30, degree=3), ValueError, "30 features make 5456 functions, more than 512"),
        (lambda: Dictionary(2).operator([[1.0, 2.0]]), ValueError, "at least 2 consecutive samples"),
        (lambda: Dictionary(2).operator(np.zeros((3, 2)), l2=-1.0), ValueError, "l2"),
        (lambda: Koopman(dictionary(), 4, dt=H), ValueError, "n_f: expected at most the 3 features"),
        (lambda: Koopman(dictionary(), 1, dt=0.0), ValueError, "dt: expected a finite number > 0"),
        (
            lambda: Koopman(dictionary(), 1, dt=H, W=np.zeros((3, 1))),
            ValueError,
            r"W: expected shape \(10, 1\)",
        ),
        (lambda: Koopman(dictionary(), 1, dt=H).predict(Z), ValueError, "no weights yet: call fit"),
        (lambda: MODEL.predict(Z[:, :2]), ValueError, r"z: expected shape \(N, 3\)"),
        (lambda: MODEL.fit(Z, F[:, :1]), ValueError, r"f: expected shape \(4, 2\)"),
        (lambda: MODEL.fit(Z, F[:2]), ValueError, r"f: expected shape \(4, 2\) to go with z"),
        (lambda: MODEL.vjp(Z, F[:2]), ValueError, r"cotangent: expected shape .* to go with z"),
        (lambda: MODEL.with_parameters([1.0]), ValueError, r"parameters: expected shape \(28,\)"),
        (lambda: OnlineKoopman(MODEL, 0), ValueError, "window: expected at least 1"),
        (lambda: OnlineKoopman(MODEL, 5, refresh=0), ValueError, "refresh: expected at least 1"),
        (lambda: OnlineKoopman(replace(MODEL, l2=0.0), 5), ValueError, "l2: expected a number > 0"),
        (lambda: ONLINE.start(Z), ValueError, "z: expected shape"),
        (
            lambda: ONLINE.step(ONLINE.start(Z[0]), [0.0, np.nan, 0.0]),
            ValueError,
            "z: expected finite numbers",
        ),
        (lambda: ONLINE.run(Z + 1e100), ValueError, "z: the dictionary overflows; scale it"),
        (lambda: ONLINE.run(Z[:, :2]), ValueError, r"z: expected shape \(N, 3\)"),
    ],
)
def test_bad_input(act: Callable[[], object], error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        act()
