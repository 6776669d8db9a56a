"""Learned models on windows of past signals."""

from __future__ import annotations

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.learned import Chebyshev, LearnedModel, Network, Windowed, window

RNG = np.random.default_rng(0)
X = RNG.standard_normal((60, 2))
F = RNG.standard_normal((60, 1))


def small(**options: object) -> Windowed[Network]:
    return Windowed(Network(hidden=(4,), max_iterations=30), 3, 2, **options).fit(X, F).model  # type: ignore[arg-type]


@pytest.mark.parametrize("steps", [True, False])
def test_it_is_the_model_of_the_window(steps: bool) -> None:
    model = small(steps=steps)
    assert isinstance(model, LearnedModel)
    past = window(X, 3, stride=2)
    rows = model.casadi().map(len(X))(past.T).full().T
    np.testing.assert_allclose(model.predict(X), rows, atol=1e-12)
    np.testing.assert_allclose(rows, model.model.predict(model.features(X)), atol=1e-12)
    assert (model.reach, model.features(X).shape) == (4, (60, 6))
    later = X.copy()
    later[30:] += 1.0
    np.testing.assert_array_equal(model.predict(later)[:30], model.predict(X)[:30])


def test_gradient_against_differences() -> None:
    model, direction = small(), RNG.standard_normal(small().parameters.shape)
    moved = [model.with_parameters(model.parameters + h * direction).predict(X) for h in (1e-6, -1e-6)]
    slope = np.sum(F * (moved[0] - moved[1])) / 2e-6
    assert model.vjp(X, F) @ direction == pytest.approx(slope, rel=1e-6)


def test_flights_are_windowed_apart() -> None:
    several = Windowed(Chebyshev(1, n_d=0), 2).fit([X, X[:20]], [F, F[:20]])
    rows = Windowed(Chebyshev(1, n_d=0), 2)
    z = np.concatenate([rows.features(X), rows.features(X[:20])])
    one = Chebyshev(1, n_d=0).fit(z, np.concatenate([F, F[:20]]))
    np.testing.assert_array_equal(several.model.parameters, one.model.parameters)
    with pytest.raises(ValueError, match="f: expected one for each of 2 flights"):
        rows.fit([X, X], [F])


def test_files_hold_it_whole(tmp_path) -> None:
    model = small(steps=False)
    model.save(path := tmp_path / "windowed.npz")
    for again in (Windowed.load(path), pf.learned_model(path)):
        assert (again.length, again.stride, again.steps) == (3, 2, False)
        np.testing.assert_array_equal(again.predict(X), model.predict(X))
    (tmp_path / "damaged.npz").write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ValueError, match="damaged"):
        Windowed.load(tmp_path / "damaged.npz")


def test_a_recording_has_what_it_predicts() -> None:
    log, model = pf.Recording.from_arrays(x=X, dt=0.1), small()
    wide = Windowed(Chebyshev(1, n_d=0), 3, 2).fit(X, np.hstack([F, F])).model
    np.testing.assert_array_equal(log.with_model(wide).f_theta, wide.predict(X))
    held = log.with_signals(features=X[:, :1])
    drag = pf.learned_model(lambda v: -np.hstack([v, v]), z=X[:1, :1])
    np.testing.assert_array_equal(held.with_model(drag).f_theta, -X[:, [0, 0]])
    with pytest.raises(ValueError, match="f_theta"):
        log.with_model(model)  # of one channel for two
    with pytest.raises(TypeError, match=r"model: expected a learned model.*learned_model"):
        log.with_model(np.sin)
    for wrong in ({"length": 0}, {"length": 2, "stride": 0}):
        with pytest.raises(ValueError, match=[*wrong][-1]):
            Windowed(Chebyshev(1, n_d=0), **wrong)
    with pytest.raises(TypeError, match="model: expected a learned model"):
        Windowed(np.sin, 2)  # type: ignore[type-var]  # wrong on purpose


def test_a_block_takes_the_window() -> None:
    model = small()
    block = pf.learned_block(model)
    np.testing.assert_allclose(block(window(X, 3, stride=2)[9]), model.predict(X)[9], atol=1e-12)
