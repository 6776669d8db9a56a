"""Models of scikit-learn and PyTorch by way of ONNX."""

from __future__ import annotations

import copy
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from typing import Any

import numpy as np

from .._sections import FloatArray
from .onnx import OnnxNetwork, OnnxNode

WAY_ROUND = (
    "export it to ONNX yourself and give the file, give its predict as a function (with z), or fit a Network to its "
    "predictions"
)
# Modules, estimators and what they return, of packages that bring no types.
Foreign = Any
Found = tuple[OnnxNetwork, Callable[[FloatArray], FloatArray]]


def of_scikit_learn(estimator: Foreign, z: FloatArray | None) -> Found:
    """The network, and the estimator's own predictions."""
    n_z = getattr(estimator, "n_features_in_", None) if z is None else z.shape[1]
    name = type(estimator).__name__
    if n_z is None:
        raise ValueError(
            f"{name}: the number of features is unknown; fit it first, or give z of shape (N, n_z)"
        )
    own = estimator.predict if hasattr(estimator, "predict") else estimator.transform

    def predict(z: FloatArray) -> FloatArray:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # names of features that it was fitted with
            return np.asarray(own(z), dtype=float)

    if type(estimator).__name__.endswith("Classifier") or hasattr(estimator, "classes_"):
        raise ValueError(f"{name}: expected a regressor, got a classifier")
    predict(np.zeros((1, n_z)))  # says so if it is not fitted
    inner, scales = _opened(estimator)
    network = OnnxNetwork.read(_exported(inner, n_z))
    for gain, offset in scales:
        network = _scaled(network, gain, offset, n_z)
    return network, predict


def _exported(estimator: Foreign, n_z: int) -> bytes:
    try:
        from skl2onnx import to_onnx
        from sklearn.gaussian_process import GaussianProcessRegressor
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a scikit-learn model comes in through the package skl2onnx: pip install 'phyfilter-ctl[onnx]'"
        ) from error
    with _refused(type(estimator).__name__, "skl2onnx"):
        # Distances as one operator: by default they are a loop.
        options = {GaussianProcessRegressor: {"optim": "cdist"}}
        proto: Foreign = to_onnx(estimator, np.zeros((1, n_z)), options=options)
        return proto.SerializeToString()


def _opened(estimator: Foreign) -> tuple[Foreign, list[tuple[FloatArray, FloatArray]]]:
    """Without a search around it and without the scaling of its targets, and that: (gain, offset), inner first."""
    from sklearn.compose import TransformedTargetRegressor
    from sklearn.pipeline import Pipeline

    estimator = getattr(estimator, "best_estimator_", estimator)
    if isinstance(estimator, Pipeline):
        (*before, (name, last)) = estimator.steps
        inner, scales = _opened(last)
        return (estimator if inner is last else Pipeline([*before, (name, inner)])), scales
    if isinstance(estimator, TransformedTargetRegressor):
        inner, scales = _opened(estimator.regressor_)
        return inner, [*scales, _back(estimator.transformer_)]
    return estimator, []


def _back(scaler: Foreign) -> tuple[FloatArray, FloatArray]:
    """f = offset + gain * output, of a fitted scaler of targets."""
    kind = type(scaler).__name__
    centre = {"StandardScaler": "mean_", "RobustScaler": "center_", "MaxAbsScaler": "none"}
    if kind in centre:
        gain, offset = getattr(scaler, "scale_", None), getattr(scaler, centre[kind], None)
    elif kind == "MinMaxScaler":
        gain, offset = 1.0 / scaler.scale_, -scaler.min_ / scaler.scale_
    elif kind == "FunctionTransformer" and scaler.inverse_func is None:
        gain, offset = None, None
    else:
        raise ValueError(f"targets transformed by {kind} are not supported; {WAY_ROUND}")
    return np.atleast_1d(1.0 if gain is None else gain), np.atleast_1d(0.0 if offset is None else offset)


def _scaled(network: OnnxNetwork, gain: FloatArray, offset: FloatArray, n_z: int) -> OnnxNetwork:
    """offset + gain f; the numbers of a scaling are no parameters."""
    graph, n_x = network.graph, network.predict(np.zeros((1, n_z))).shape[1]
    given = {"rows": np.array([-1, n_x]), "gain": gain, "negative offset": -offset}
    operands = {f"{what} of targets, {len(graph.nodes)}": array for what, array in given.items()}
    nodes, output = list(graph.nodes), graph.output
    for operator, operand in zip(("Reshape", "Mul", "Sub"), operands, strict=True):
        nodes.append(OnnxNode(operator, (output, operand), (f"after {operand}",)))
        output = nodes[-1].outputs[0]
    constants = {**graph.constants, **operands}
    return replace(network, graph=replace(graph, nodes=tuple(nodes), constants=constants, output=output))


def of_torch(module: Foreign, z: FloatArray | None) -> Found:
    """The network, and the module's own predictions."""
    import torch

    still = copy.deepcopy(module).eval().cpu()
    linear = (layer.in_features for layer in still.modules() if hasattr(layer, "in_features"))
    n_z = next(linear, None) if z is None else z.shape[1]
    name = type(module).__name__
    if n_z is None:
        raise ValueError(f"{name}: the number of features is unknown; give z of shape (N, n_z)")
    kind = next((p.dtype for p in still.parameters()), torch.get_default_dtype())

    def predict(z: FloatArray) -> FloatArray:
        with torch.no_grad():
            return np.asarray(still(torch.from_numpy(np.array(z)).to(kind)).double().numpy())

    try:
        import onnxscript  # noqa: F401  # what torch.onnx.export writes with
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "a PyTorch module comes in through the package onnxscript: pip install 'phyfilter-ctl[torch]'"
        ) from error
    with _refused(name, "torch.onnx.export"):
        # One sample: what looks at other ones then differs from the module, and is refused.
        program: Foreign = torch.onnx.export(
            still, (torch.zeros(1, n_z, dtype=kind),), dynamo=True, verbose=False
        )
    return OnnxNetwork.read(program.model_proto.SerializeToString()), predict


@contextmanager
def _refused(name: str, exporter: str) -> Iterator[None]:
    """Quiet; what an exporter raises says whose it is and the way round."""
    level = logging.root.manager.disable
    logging.disable(logging.WARNING)  # about packages that are not there
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    except Exception as error:
        first: BaseException = error
        while first.__cause__ is not None:  # the exporter's own is about the steps it takes
            first = first.__cause__
        words = (str(first).strip().splitlines() or [""])[0][:200]
        raise ValueError(
            f"{name}: {exporter} cannot translate it ({type(error).__name__}: {words}); {WAY_ROUND}"
        ) from error
    finally:
        logging.disable(level)
