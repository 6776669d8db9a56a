"""Models that were made elsewhere, as learned models."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from . import _arrays, _foreign
from .function_model import FunctionModel
from .model import LearnedModel
from .onnx import OnnxNetwork
from .saved import KINDS, saved_model
from .windowed import Windowed

# Next to the greatest value: single precision on its way through many layers, far below another formula.
_SAME = 1e-4
_PROBED_ROWS = 8

Own = Callable[[FloatArray], ArrayLike]


def learned_model(model: object, *, z: ArrayLike | None = None) -> LearnedModel:
    """A model from elsewhere as a learned model f_theta(z), for residuals, diagrams, training on, C and FMUs.

    ======================================  ============================================================
    scikit-learn: fitted regressors,        through ``skl2onnx`` in double precision (extra ``onnx``), the scaling
    pipelines, scaled targets, searches     of targets included
    PyTorch: ``torch.nn.Module``            through its own export, in evaluation mode (extra ``torch``)
    ONNX: path, bytes or ``ModelProto``     read as a network, with the files of constants that it names
    ``.npz``                                what ``save`` of a learned model wrote
    function, ``casadi.Function``           a :class:`FunctionModel`: predictions always, an expression where numpy code
                                            can be traced, no parameters
    learned model                           as it is
    ======================================  ============================================================

    What scikit-learn and PyTorch models became is held against their own predictions before it is returned.

    Parameters
    ----------
    model : object
        One of those above, fitted.
    z : array_like, shape (N, n_z), optional
        Features as they will come: where the comparison is made (default: some standard normal rows), and how many
        there are, for functions and for modules whose first linear layer does not tell.

    Returns
    -------
    LearnedModel
        An :class:`OnnxNetwork` with the weights as parameters, unless the table says otherwise.

    Raises
    ------
    ValueError
        If the model is not fitted, something in it is not supported (the message names it and a way round), the number
        of features is unknown or not that of ``z``, or the predictions differ.
    TypeError
        For something that is none of these.
    ModuleNotFoundError
        If an extra is missing; the message names it.

    Examples
    --------
    >>> v = np.linspace(-2.0, 2.0, 9)[:, None]
    >>> drag = learned_model(lambda v: -0.3 * v * np.abs(v), z=v)
    >>> drag, drag.casadi()(2.0)
    (FunctionModel(<lambda>, 1 -> 1), DM(-1.2))
    """
    features = None if z is None else _arrays.rows("z", z)
    if isinstance(model, type):
        raise TypeError(f"model: expected a fitted model, got the class {model.__name__}")
    found, own = _found(model, features)
    if own is not None:
        rows = _random(_width(found)) if features is None else features
        _same(model, found, own, rows)
    elif features is not None:
        found.predict(features[:1])  # says so where their number is wrong
    return found


def _found(model: object, z: FloatArray | None) -> tuple[LearnedModel, Own | None]:
    """The learned model, and where it was translated what it must agree with."""
    if isinstance(model, LearnedModel):
        return model, None
    if isinstance(model, str | os.PathLike):
        return _from_file(os.fspath(model)), None
    if isinstance(model, bytes):
        return OnnxNetwork.read(model), None
    proto = getattr(model, "model_proto", model)  # what torch.onnx.export returns holds one
    if callable(written := getattr(proto, "SerializeToString", None)):
        return OnnxNetwork.read(cast(Callable[[], bytes], written)()), None
    if _is_a(model, "sklearn.base", "BaseEstimator"):
        return _foreign.of_scikit_learn(model, z)
    if _is_a(model, "torch.nn", "Module"):
        return _foreign.of_torch(model, z)
    if isinstance(model, ca.Function):
        return FunctionModel(model, int(model.numel_in(0)), int(model.numel_out(0))), None
    if callable(model):
        return _of_function(cast(Own, model), z), None
    raise TypeError(
        "model: expected a scikit-learn estimator, a PyTorch module, an ONNX model or file, an .npz file, a function "
        f"or a learned model, got {type(model).__name__}"
    )


def _from_file(path: str) -> LearnedModel:
    suffix = Path(path).suffix.lower()
    if suffix == ".onnx":
        return OnnxNetwork.read(path)
    if suffix == ".npz":
        return saved_model(path, {**KINDS, "windowed": Windowed})
    raise ValueError(
        f"{path}: expected a file .onnx, or .npz as save() writes, got {suffix or 'no suffix'!r}"
    )


def _of_function(function: Own, z: FloatArray | None) -> FunctionModel:
    if z is None:
        raise ValueError(
            "z: expected rows of features to know a function's sizes by, got none; give z of shape (N, n_z)"
        )
    whole = np.asarray(function(z), dtype=float)
    if whole.shape[:1] != (len(z),) or whole.ndim > 2:
        raise ValueError(
            f"model: expected a function of rows (N, {z.shape[1]}) -> (N, n_x), got {whole.shape} from N = {len(z)}"
        )
    first = np.asarray(function(z[:1]), dtype=float)
    if not np.allclose(first.ravel(), whole[:1].ravel(), rtol=_SAME, atol=0.0, equal_nan=True):
        raise ValueError("model: the function gives another value for a row when others stand beside it")
    return FunctionModel(function, z.shape[1], 1 if whole.ndim == 1 else whole.shape[1])


def _same(model: object, found: LearnedModel, own: Own, z: FloatArray) -> None:
    expected = np.asarray(own(z), dtype=float).reshape(len(z), -1)
    got = found.predict(z)
    size = float(np.max(np.abs(expected)))
    if got.shape != expected.shape or not np.max(np.abs(got - expected)) <= _SAME * size:
        by = (
            f"shape {got.shape} for {expected.shape}"
            if got.shape != expected.shape
            else f"up to {np.max(np.abs(got - expected)):.2g} of {size:.2g}"
        )
        raise ValueError(
            f"the translation of {type(model).__name__} differs from its own predictions: {by}; {_foreign.WAY_ROUND}"
        )


def _random(n_z: int) -> FloatArray:
    return np.random.default_rng(0).standard_normal((_PROBED_ROWS, n_z))


def _width(found: LearnedModel) -> int:
    return int(found.casadi().numel_in(0))


def _is_a(model: object, module: str, name: str) -> bool:
    """Whether it is of a class of a package that is not imported for the question."""
    return module in sys.modules and isinstance(model, getattr(sys.modules[module], name))
