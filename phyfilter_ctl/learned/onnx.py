"""Multilayer perceptrons trained elsewhere, brought in as ONNX files."""

from __future__ import annotations

import os
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from . import _arrays, _checks, _files
from ._descent import descend
from ._onnx_reader import RefusedError, dense_layers
from .dense import Activation, Dense
from .layers import standardisation
from .model import FitResult

_KIND = "onnx"
_OPTIONS = ("l2", "max_iterations", "tolerance")
_MOST_BYTES = 1 << 26


@dataclass(frozen=True, eq=False, repr=False)
class OnnxNetwork:
    """A chain of dense layers read from an ONNX file, evaluated here in double precision.

        f_theta = h_L,   h_i = activation_i(W_i' h_{i-1} + b_i),   h_0 = z

    :meth:`read` folds scalings, shifts and batch normalisation into the layers. The parameters are the weights and
    the biases; :meth:`fit` goes on from the ones read. The activations are identity, relu, leaky_relu, elu, selu,
    tanh, sigmoid, softplus, softsign and clip.

    Parameters
    ----------
    layers : Dense
        Weights, biases and activations.
    l2 : float
        Weight l of the penalty l |parameters - parameters read|^2 / 2 beside half the mean squared error, in units
        of the deviation of f.
    max_iterations : int
        Most iterations of L-BFGS in :meth:`fit`.
    tolerance : float
        Largest entry of the gradient at which :meth:`fit` stops.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range.

    Notes
    -----
    Format: ONNX operator specification, https://onnx.ai/onnx/operators.

    Examples
    --------
    >>> from phyfilter_ctl.learned import Activation, Dense
    >>> relu, last = Activation("relu"), Activation("identity")
    >>> network = OnnxNetwork(Dense((np.eye(2), np.ones((2, 1))), (np.zeros(2), np.zeros(1)), (relu, last)))
    >>> network.predict([[3.0, -1.0]]).tolist()
    [[3.0]]
    >>> network
    OnnxNetwork(2 -> 2 -> 1; relu, identity; 9 parameters)
    """

    layers: Dense
    _: KW_ONLY
    l2: float = 0.0
    max_iterations: int = 200
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        _checks.count("max_iterations", self.max_iterations)
        for name in ("l2", "tolerance"):
            _arrays.number(name, getattr(self, name))

    @classmethod
    def read(cls, source: str | os.PathLike[str] | bytes) -> Self:
        """Read a multilayer perceptron from an ONNX file, or from the bytes of one.

        The graph must be a chain from one input (N, n_z) to one output (N, n_x), of the operators Add,
        BatchNormalization, Cast, Clip, Constant, Div, Dropout, Elu, Flatten, Gemm, Identity, LeakyRelu, MatMul,
        Mul, Neg, Relu, Reshape, Selu, Sigmoid, Softplus, Softsign, Sub and Tanh, with constants inside the file.

        Parameters
        ----------
        source : str, path or bytes
            The file; at most 64 MiB.

        Raises
        ------
        ValueError
            If the file is damaged or too large, refers to other files, or is not such a chain; an operator that is
            not supported is named.
        ModuleNotFoundError
            If the package ``onnx`` is not installed.
        """
        try:
            import onnx  # an extra
            from google.protobuf.message import DecodeError
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "reading ONNX files needs the package onnx: pip install 'phyfilter-ctl[onnx]'"
            ) from error
        what = "model" if isinstance(source, bytes) else os.fspath(source)
        size = len(source) if isinstance(source, bytes) else Path(source).stat().st_size
        if size > _MOST_BYTES:
            raise ValueError(f"{what}: expected at most {_MOST_BYTES} bytes, got {size}")
        data = source if isinstance(source, bytes) else Path(source).read_bytes()
        try:
            return cls(dense_layers(onnx.load_model_from_string(data)))
        except DecodeError as error:
            raise ValueError(f"{what}: not an ONNX model, or damaged; export it again") from error
        except RefusedError as error:
            raise ValueError(f"{what}: {error}") from error
        except (
            ValueError,
            OverflowError,
            IndexError,
        ) as error:  # malformed fields that nothing above foresaw
            raise ValueError(f"{what}: damaged ({error}); export it again") from error

    @property
    def parameters(self) -> FloatArray:
        """Weights and biases W_1 by rows, b_1, W_2 by rows, ..., b_L; shape (n_parameters,)."""
        return self.layers.parameters

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the network with these weights and biases, in the order of :attr:`parameters`.

        Raises
        ------
        ValueError
            If the number is wrong or a value is not finite.
        """
        vector = _arrays.parameter_vector(parameters, len(self.layers.parameters))
        return replace(self, layers=self.layers.with_parameters(vector))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Train on from the weights at hand, on features z (N, n_z) and unknown dynamics f (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays of these shapes with the same number of rows.
        """
        z, f = _arrays.pairs(z, f, self.layers.sizes[0], self.layers.sizes[-1])
        _, scale = standardisation("f", f)
        first = self.parameters

        def loss(p: FloatArray) -> tuple[float, FloatArray]:
            layers = self.layers.with_parameters(p)
            error = (layers.predict(z) - f) / scale
            value = 0.5 * float(np.mean(error**2)) + 0.5 * self.l2 * float(np.sum((p - first) ** 2))
            return value, layers.vjp(z, error / (scale * error.size)) + self.l2 * (p - first)

        end = descend(loss, first, max_iterations=self.max_iterations, tolerance=self.tolerance)
        if end.status == "failed":
            return FitResult(self, float("inf"), end.iterations, "failed", end.message + "; scale z and f")
        model = self.with_parameters(end.parameters)
        return FitResult(model, _arrays.rms(model.predict(z) - f), end.iterations, end.status, end.message)

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at features z (N, n_z), shape (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n_z).
        """
        return self.layers.predict(_checks.rows("z", z, self.layers.sizes[0]))

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, shape (n_parameters,).

        At a kink the slope of relu and clip is taken as 0, that of leaky_relu as 1.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`, and if ``cotangent`` is not of shape (N, n_x).
        """
        return self.layers.vjp(
            *_arrays.with_cotangent(z, cotangent, self.layers.sizes[0], self.layers.sizes[-1])
        )

    def casadi(self) -> ca.Function:
        """The network at one sample as a CasADi function ``f_theta``: z (n_z,) -> f_theta (n_x,)."""
        # Matrix expressions: a network trained elsewhere may be too large to write out number by number.
        z = ca.MX.sym("z", self.layers.sizes[0])
        return ca.Function("f_theta", [z], [self.layers.expression(z)], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the network to an .npz archive at ``path``, whole or not at all; :meth:`load` does not need onnx."""
        arrays = {name: np.array(getattr(self, name)) for name in _OPTIONS}
        arrays["activations"] = np.array([a.name for a in self.layers.activations])
        arrays["constants"] = np.array([[a.first, a.second] for a in self.layers.activations])
        arrays |= _arrays.weight_arrays(self.layers.weights, self.layers.biases)
        _files.write(path, _KIND, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a network that :meth:`save` wrote to ``path``.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        arrays = _files.read(path, _KIND)
        try:
            weights, biases = _arrays.read_weights(path, arrays, (*_OPTIONS, "activations", "constants"))
            names = [str(name) for name in arrays["activations"]]
            constants = _arrays.floats(arrays, "constants")
            activations = [
                Activation(name, *row.tolist()) for name, row in zip(names, constants, strict=True)
            ]
            options = {name: arrays[name].item() for name in _OPTIONS}
            return cls(Dense(weights, biases, tuple(activations)), **options)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({error}); save it again") from error

    def __repr__(self) -> str:
        names = ", ".join(a.name for a in self.layers.activations)
        sizes = " -> ".join(map(str, self.layers.sizes))
        return f"OnnxNetwork({sizes}; {names}; {len(self.layers.parameters)} parameters)"
