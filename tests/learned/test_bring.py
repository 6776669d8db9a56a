"""Functions, CasADi functions and saved models as learned models; what is refused, and the way that is named."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.design import joint_gradient, refine
from phyfilter_ctl.learned import Chebyshev, Dictionary, Koopman, LearnedModel, Network
from phyfilter_ctl.learned.function_model import FunctionModel
from phyfilter_ctl.learned.onnx import OnnxGraph, OnnxNetwork, OnnxNode

# The same formula in another order, in double precision.
SAME_FORMULA = 1e-12

Z = np.random.default_rng(0).standard_normal((20, 2))


def by_columns(z: np.ndarray) -> np.ndarray:
    return np.column_stack([np.tanh(z[:, 0]) * z[:, 1], z[:, 0] ** 2])


def by_matrices(z: np.ndarray) -> np.ndarray:
    return np.sin(z @ np.array([[1.0, 2.0, 0.5], [0.0, -1.0, 3.0]])) + np.array([0.0, 1.0, 2.0])


def by_limits(z: np.ndarray) -> np.ndarray:
    return np.minimum(np.fabs(z[:, :1]), 0.5)


def of_one_channel(z: np.ndarray) -> np.ndarray:
    return z[:, 0] * np.exp(-(z[:, 1] ** 2))


@pytest.mark.parametrize("function", [by_columns, by_matrices, by_limits, of_one_channel])
def test_functions_and_their_expressions(function: Callable[[np.ndarray], np.ndarray]) -> None:
    model, expected = pf.learned_model(function, z=Z), function(Z).reshape(20, -1)
    assert isinstance(model, LearnedModel)
    assert np.array_equal(model.predict(Z), expected)
    np.testing.assert_allclose(model.casadi().map(20)(Z.T).full().T, expected, rtol=0.0, atol=SAME_FORMULA)
    assert model.vjp(Z, np.ones(expected.shape)).shape == model.parameters.shape == (0,)
    assert model.fit(Z, expected + 2.0).rmse == pytest.approx(2.0)


def test_casadi_functions() -> None:
    z = ca.SX.sym("z", 2)
    model = pf.learned_model(ca.Function("own", [z], [ca.vertcat(ca.sin(z[0]), z[1], z[0] * z[1])]))
    expected = np.column_stack([np.sin(Z[:, 0]), Z[:, 1], Z[:, 0] * Z[:, 1]])
    np.testing.assert_allclose(model.predict(Z), expected, rtol=0.0, atol=SAME_FORMULA)
    assert pf.learned_block(model)(Z[0]) == pytest.approx(expected[0], abs=SAME_FORMULA)
    with pytest.raises(ValueError, match=r"expected z \(2, 1\) -> f_theta \(1, 1\)"):
        FunctionModel(ca.Function("own", [z, ca.SX.sym("u")], [z[0]]), 2, 1)


@pytest.mark.parametrize(
    "function",
    [
        lambda z: np.array([[math.sin(v)] for v in z[:, 0]]),
        lambda z: np.searchsorted([0.0, 1.0], z[:, :1]).astype(float),
        lambda z: np.array([[v if v > 0.0 else 0.0] for v in z[:, 0]]),
        lambda z: z.astype(np.float32)[:, :1].astype(float),
    ],
)
def test_a_function_that_cannot_be_traced_predicts_and_says_so(
    function: Callable[[np.ndarray], np.ndarray],
) -> None:
    model = pf.learned_model(function, z=Z)
    assert np.array_equal(model.predict(Z), function(Z))
    with pytest.raises(
        ValueError, match=r"predicts, but is no expression .*fit a Network to its predictions"
    ):
        pf.learned_block(model)


def test_files_of_every_kind(tmp_path: Path) -> None:
    onnx = OnnxNetwork(OnnxGraph((OnnxNode("MatMul", ("z", "W"), ("f",)),), {"W": np.eye(2)}, (None, 2)))
    network = Network((3,), max_iterations=5).fit(Z, Z).model
    for model in (
        onnx,
        network,
        Chebyshev(1, n_d=0).fit(Z, Z).model,
        Koopman(Dictionary(2), 2, dt=0.1).fit(Z, Z).model,
    ):
        model.save(tmp_path / "model.npz")
        found = pf.learned_model(tmp_path / "model.npz", z=Z)
        assert type(found) is type(model)
        assert np.array_equal(found.predict(Z), model.predict(Z))
    assert pf.learned_model(network) is network


def test_a_function_has_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a function is code"):
        pf.learned_model(by_columns, z=Z).save(tmp_path / "model.npz")
    with pytest.raises(ValueError, match="a function is code"):
        FunctionModel.load(tmp_path / "model.npz")


class Estimator:
    """Has some of what a learned model has."""

    def predict(self, z: np.ndarray) -> np.ndarray:
        return z

    def fit(self, z: np.ndarray, f: np.ndarray) -> Estimator:
        return self


@pytest.mark.parametrize(
    "act",
    [
        lambda model, log, filter: pf.learned_block(model),
        lambda model, log, filter: pf.learn_jointly(log, model, filter.filter),
        lambda model, log, filter: joint_gradient(log, model, filter),
        lambda model, log, filter: refine(model, log, filter),
    ],
)
@pytest.mark.parametrize("model", [Estimator(), Network])
def test_everything_that_takes_a_model_names_the_way(act: Callable[..., object], model: object) -> None:
    log = pf.Recording.from_arrays(x=Z, dt=0.01, label=Z, features=Z)
    with pytest.raises(TypeError, match=r"expected a learned model, got .*; phyfilter_ctl\.learned_model"):
        act(model, log, pf.lowpass(1, 5.0).sampled(0.01))


@pytest.mark.parametrize(
    ("model", "z", "error", "words"),
    [
        (Estimator(), None, TypeError, "model: expected a scikit-learn estimator, .*, got Estimator"),
        (Network, None, TypeError, "expected a fitted model, got the class Network"),
        (by_columns, None, ValueError, "z: expected rows of features to know a function's sizes by"),
        (by_columns, Z[:, 0], ValueError, r"z: expected shape \(N, n\)"),
        (lambda z: z[0], Z, ValueError, r"expected a function of rows \(N, 2\) -> \(N, n_x\), got \(2,\)"),
        (lambda z: z - z.mean(axis=0), Z, ValueError, "another value for a row when others stand beside it"),
        ("model.pt", None, ValueError, r"model\.pt: expected a file \.onnx, or \.npz"),
        ("none.npz", None, FileNotFoundError, "none.npz"),
    ],
)
def test_what_is_refused(model: object, z: object, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        pf.learned_model(model, z=z)  # type: ignore[arg-type]  # wrong on purpose


def test_another_number_of_features() -> None:
    network = Network((3,), max_iterations=5).fit(Z, Z).model
    with pytest.raises(ValueError, match=r"z: expected shape \(N, 2\)"):
        pf.learned_model(network, z=np.zeros((4, 3)))
