"""scikit-learn's models as learned models, against their own predictions; files as skl2onnx writes them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.compose import TransformedTargetRegressor, make_column_transformer
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, RationalQuadratic, WhiteKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.linear_model import HuberRegressor, LinearRegression, LogisticRegression, Ridge
from sklearn.model_selection import GridSearchCV
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler, MinMaxScaler, PolynomialFeatures, RobustScaler, StandardScaler

import phyfilter_ctl as pf
from phyfilter_ctl.learned.onnx import OnnxNetwork

onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
skl2onnx = pytest.importorskip("skl2onnx", reason="the package skl2onnx is not installed (extra: onnx)")

pytestmark = pytest.mark.filterwarnings("ignore:lbfgs failed to converge")

# Next to the greatest value: the same formulas in another order in double precision; a Gaussian process sums large
# weights of both signs; a file in single precision.
SAME_FORMULA, WEIGHTS_OF_BOTH_SIGNS, SINGLE = 1e-12, 1e-8, 1e-5

RNG = np.random.default_rng(0)
Z = np.array([1.0, 20.0, 0.1]) * RNG.standard_normal((60, 3)) + np.array([0.0, 100.0, 0.0])
F = 50.0 + 7.0 * np.column_stack([np.sin(Z[:, 0]), 0.01 * Z[:, 1] * Z[:, 2]])


def perceptron(activation: str = "tanh") -> MLPRegressor:
    # Few iterations: what it learns does not matter here.
    return MLPRegressor(
        hidden_layer_sizes=(8, 5), activation=activation, solver="lbfgs", max_iter=3, random_state=0
    )


def scaled_targets(regressor: object, scaler: object) -> TransformedTargetRegressor:
    return TransformedTargetRegressor(regressor, transformer=scaler)


MODELS = {
    "linear": LinearRegression(),
    "pipeline": make_pipeline(StandardScaler(), perceptron()),
    "logistic units": make_pipeline(MinMaxScaler(), perceptron("logistic")),
    "polynomial": make_pipeline(PolynomialFeatures(3), StandardScaler(), Ridge()),
    "columns": make_pipeline(
        make_column_transformer((StandardScaler(), [0, 1]), ("passthrough", [2])), PCA(2), Ridge()
    ),
    "targets": scaled_targets(make_pipeline(RobustScaler(), perceptron("relu")), StandardScaler()),
    "targets in a pipeline": make_pipeline(MaxAbsScaler(), scaled_targets(perceptron(), MinMaxScaler())),
    "search": GridSearchCV(
        make_pipeline(StandardScaler(), scaled_targets(Ridge(), RobustScaler())),
        {"transformedtargetregressor__regressor__alpha": [0.1, 1.0]},
        cv=2,
    ),
    "process": GaussianProcessRegressor(
        ConstantKernel() * RBF([1.0, 20.0, 0.1]) + WhiteKernel(), normalize_y=True, optimizer=None
    ),
    "rational process": make_pipeline(
        StandardScaler(), GaussianProcessRegressor(RationalQuadratic(), alpha=1e-3, optimizer=None)
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_predictions_expression_and_gradient(name: str) -> None:
    estimator = clone(MODELS[name]).fit(Z, F)
    model = pf.learned_model(estimator, z=Z)
    expected, rounding = estimator.predict(Z), WEIGHTS_OF_BOTH_SIGNS if "process" in name else SAME_FORMULA
    atol = rounding * np.abs(expected).max()
    np.testing.assert_allclose(model.predict(Z), expected, rtol=0.0, atol=atol)
    np.testing.assert_allclose(model.casadi().map(60)(Z.T).full().T, expected, rtol=0.0, atol=atol)
    rng = np.random.default_rng(1)
    p, cotangent = model.parameters, rng.standard_normal(F.shape)
    direction = rng.standard_normal(len(p)) * np.maximum(np.abs(p), 0.1)
    above, below = (model.with_parameters(p + s * 1e-6 * direction).predict(Z) for s in (1.0, -1.0))
    slope = float(np.sum(cotangent * (above - below))) / 2e-6
    size = float(np.linalg.norm(cotangent) * np.linalg.norm(above - below)) / 2e-6
    assert model.vjp(Z, cotangent) @ direction == pytest.approx(slope, abs=1e-5 * size)


def test_one_channel() -> None:
    estimator = HuberRegressor().fit(Z, F[:, 0])
    assert pf.learned_model(estimator).predict(Z)[:, 0] == pytest.approx(
        estimator.predict(Z), rel=SAME_FORMULA
    )


def test_training_goes_on() -> None:
    model = pf.learned_model(make_pipeline(StandardScaler(), perceptron()).fit(Z, F))
    assert isinstance(model, OnnxNetwork)
    assert model.fit(Z, F).rmse < float(np.sqrt(np.mean((model.predict(Z) - F) ** 2)))


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_files_as_skl2onnx_writes_them(kind: type, tmp_path: Path) -> None:
    for name in ("linear", "pipeline", "polynomial", "columns"):
        estimator = clone(MODELS[name]).fit(Z, F)
        path = tmp_path / "model.onnx"
        path.write_bytes(skl2onnx.to_onnx(estimator, Z[:1].astype(kind)).SerializeToString())
        expected = estimator.predict(Z)
        np.testing.assert_allclose(
            pf.learned_model(path).predict(Z),
            expected,
            rtol=0.0,
            atol=100.0 * SINGLE * np.abs(expected).max(),
        )


@pytest.mark.parametrize(
    ("estimator", "words"),
    [
        (
            make_pipeline(StandardScaler(), Ridge()),
            "Pipeline: the number of features is unknown; fit it first",
        ),
        (LogisticRegression().fit(Z, Z[:, 0] > 0.0), "expected a regressor, got a classifier"),
        (
            RandomForestRegressor(2).fit(Z, F),
            r"operator 'ai\.onnx\.ml\.TreeEnsembleRegressor' is not supported \(node '.*'\); fit a Network",
        ),
        (
            KernelRidge().fit(Z, F),
            r"KernelRidge: skl2onnx cannot translate it .*give its predict as a function",
        ),
        (
            TransformedTargetRegressor(Ridge(), func=np.log, inverse_func=np.exp).fit(Z, F),
            "targets transformed by FunctionTransformer are not supported; export it",
        ),
    ],
)
def test_what_is_refused_names_a_way_round(estimator: object, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        pf.learned_model(estimator)


def test_a_translation_that_is_another_function_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    estimator, other = (LinearRegression().fit(Z, f) for f in (F, -F))
    monkeypatch.setattr(skl2onnx, "to_onnx", lambda e, z, **options: TO_ONNX(other, z))
    with pytest.raises(
        ValueError, match="translation of LinearRegression differs from its own predictions: up to"
    ):
        pf.learned_model(estimator)


TO_ONNX = skl2onnx.to_onnx


def test_without_the_extra_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "skl2onnx", None)
    with pytest.raises(ModuleNotFoundError, match=r"skl2onnx: pip install 'phyfilter-ctl\[onnx\]'"):
        pf.learned_model(LinearRegression().fit(Z, F))


@pytest.mark.slow
def test_as_an_fmu(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    estimator = clone(MODELS["targets"]).fit(Z, F)
    path = pf.export_fmu(pf.learned_block(pf.learned_model(estimator)), tmp_path / "model.fmu", fmi="2.0")
    times = 0.01 * np.arange(len(Z))
    inputs = np.rec.fromarrays([times, *Z.T], names=["time", "z[0]", "z[1]", "z[2]"])
    options = {"start_time": 0.0, "stop_time": times[-1], "step_size": 0.01, "output_interval": 0.01}
    found = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", input=inputs, output=["f_theta[0]", "f_theta[1]"], **options
    )
    rows = np.searchsorted(found["time"], times - 1e-6)
    expected = estimator.predict(Z)
    for i in range(2):
        np.testing.assert_allclose(
            found[f"f_theta[{i}]"][rows], expected[:, i], rtol=0.0, atol=SAME_FORMULA * np.abs(expected).max()
        )


def test_the_way_round_works() -> None:
    process = GaussianProcessRegressor(ConstantKernel() * Matern(nu=1.5), optimizer=None).fit(Z, F)
    assert np.array_equal(pf.learned_model(process.predict, z=Z).predict(Z), process.predict(Z))
