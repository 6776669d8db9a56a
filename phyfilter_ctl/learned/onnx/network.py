"""Networks trained elsewhere, brought in as ONNX files."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ... import _signals
from ..._sections import FloatArray
from ...results import Status
from .. import _arrays, _files
from .._descent import descend
from ..layers import standardisation
from ..model import FitResult
from ._columns import Traced
from ._reader import read_graph
from ._walk import Walk, features, mixes_samples, walk
from .graph import OnnxGraph, RefusedError, entries_of, graph_of, values_of, with_values

_KIND = "onnx"
_OPTIONS = ("l2", "max_iterations", "tolerance")
# Of the results on the way, about so many are held at once for each that is counted.
_REUSED = 8


@dataclass(frozen=True, eq=False, repr=False)
class OnnxNetwork:
    """A network read from an ONNX file, evaluated here in double precision.

    The parameters are the network's weights and biases: constants of more than a single number that Gemm, MatMul,
    Add, PRelu or a normalisation takes. :meth:`fit` goes on from the ones read.

    Parameters
    ----------
    graph : OnnxGraph
        Operators and constants.
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
        If an operator is not supported, sizes do not fit together, or an option is out of range.

    Notes
    -----
    Format: ONNX operator specification, https://onnx.ai/onnx/operators.

    Examples
    --------
    >>> from phyfilter_ctl.learned.onnx import OnnxGraph, OnnxNode
    >>> nodes = OnnxNode("Gemm", ("z", "W", "b"), ("v",)), OnnxNode("Relu", ("v",), ("f",))
    >>> network = OnnxNetwork(OnnxGraph(nodes, {"W": np.eye(2), "b": np.array([0.0, 0.5])}, (None, 2)))
    >>> network.predict([[3.0, -1.0]]).tolist()
    [[3.0, 0.0]]
    >>> network
    OnnxNetwork(2 -> 2; Gemm, Relu; 6 parameters)
    """

    graph: OnnxGraph
    _: KW_ONLY
    l2: float = 0.0
    max_iterations: int = 200
    tolerance: float = 1e-6

    def __post_init__(self) -> None:
        _signals.count("max_iterations", self.max_iterations)
        for name in ("l2", "tolerance"):
            _arrays.number(name, getattr(self, name))
        assert self._walk.numbers  # walked here, so that what is not supported is said at once

    @classmethod
    def read(cls, source: str | os.PathLike[str] | bytes) -> Self:
        """Read a network from an ONNX file, or from the bytes of one.

        The graph must have one input (N, n_z), or (N, ...) taken as its numbers by rows, and one output. Supported
        operators: Abs, Add, And, Atan, BatchNormalization, Cast, Celu, Clip, Concat, Constant, ConstantOfShape, Cos,
        Div, Dropout, Elu, Equal, Erf, Exp, Expand, Flatten, Gather, Gelu, Gemm, Greater, GreaterOrEqual, HardSigmoid,
        HardSwish, Identity, IsNaN, LayerNormalization, LeakyRelu, Less, LessOrEqual, Log, LogSoftmax, MatMul, Max,
        Mean, Min, Mish, Mul, Neg, Not, Or, PRelu, Pow, RMSNormalization, Reciprocal, ReduceL1, ReduceL2, ReduceMax,
        ReduceMean, ReduceMin, ReduceProd, ReduceSum, ReduceSumSquare, Relu, Reshape, Selu, Shape, Sigmoid, Sign, Sin,
        Slice, Softmax, Softplus, Softsign, Split, Sqrt, Squeeze, Sub, Sum, Swish, Tanh, Transpose, Unsqueeze, Where,
        ai.onnx.ml.ArrayFeatureExtractor, ai.onnx.ml.LinearRegressor, ai.onnx.ml.Normalizer, ai.onnx.ml.Scaler,
        com.microsoft.CDist.

        Parameters
        ----------
        source : str, path or bytes
            The file, at most 64 MiB; constants in files beside it are read along.

        Raises
        ------
        ValueError
            If the file is damaged or too large, or an operator is not supported; the message names it and a way round.
        ModuleNotFoundError
            If the package ``onnx`` is not installed.
        """
        graph = read_graph(source)
        try:
            network = cls(graph)
            if mixes_samples(graph):
                raise RefusedError(
                    "the output for one sample depends on the others; export the form for inference"
                )
        except RefusedError as error:
            what = "model" if isinstance(source, bytes) else os.fspath(source)
            raise ValueError(f"{what}: {error}") from error
        return network

    @property
    def parameters(self) -> FloatArray:
        """Weights and biases in the order of their first use, each by rows as in the file; shape (n_parameters,)."""
        return values_of(self.graph, self._walk.trained)

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the network with these weights and biases, in the order of :attr:`parameters`.

        Raises
        ------
        ValueError
            If the number is wrong or a value is not finite.
        """
        vector = _arrays.parameter_vector(parameters, len(self.parameters))
        return replace(self, graph=with_values(self.graph, self._walk.trained, vector))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Train on from the weights at hand, on features z (N, n_z) and unknown dynamics f (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays of these shapes with the same number of rows.
        """
        z, f = _arrays.pairs(z, f, self._n_z, self._n_x)
        _, scale = standardisation("f", f)
        first = self.parameters

        def loss(p: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = 0.5 * self.l2 * float(np.sum((p - first) ** 2)), self.l2 * (p - first)
            for rows in self._chunks(len(z)):
                traced, weights = self._traced(z[rows], p)
                error = (traced.value.T - f[rows]) / scale
                value += 0.5 * float(np.sum(error**2)) / f.size
                gradient = gradient + _pulled(traced, weights, error / (scale * f.size))
            return value, gradient

        end = descend(loss, first, max_iterations=self.max_iterations, tolerance=self.tolerance)
        if end.status is Status.FAILED:
            return FitResult(
                self, float("inf"), end.iterations, Status.FAILED, end.message + "; scale z and f"
            )
        model = self.with_parameters(end.parameters)
        return FitResult(model, _arrays.rms(model.predict(z) - f), end.iterations, end.status, end.message)

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at features z (N, n_z), shape (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n_z).
        """
        z = _arrays.rows("z", z, self._n_z)
        f = np.empty((len(z), self._n_x))
        for rows in self._chunks(len(z)):
            f[rows] = walk(self.graph, z[rows].T).f.T
        return f

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, shape (n_parameters,).

        At a kink, such as that of relu at 0, the slope is the mean of those beside it.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`, and if ``cotangent`` is not of shape (N, n_x).
        """
        z, cotangent = _arrays.with_cotangent(z, cotangent, self._n_z, self._n_x)
        p, gradient = self.parameters, np.zeros(len(self.parameters))
        for rows in self._chunks(len(z)):
            gradient += _pulled(*self._traced(z[rows], p), cotangent[rows])
        return gradient

    def casadi(self) -> ca.Function:
        """The network at one sample as a CasADi function ``f_theta``: z (n_z,) -> f_theta (n_x,)."""
        # Matrix expressions: a network trained elsewhere may be too large to write out number by number.
        z = ca.MX.sym("z", self._n_z)
        return ca.Function("f_theta", [z], [walk(self.graph, z).f], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the network to an .npz archive at ``path``, whole or not at all; :meth:`load` does not need onnx."""
        arrays = {name: np.array(getattr(self, name)) for name in _OPTIONS}
        _files.write(path, _KIND, arrays | entries_of(self.graph))

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
            options = {name: arrays.pop(name).item() for name in _OPTIONS}
            return cls(graph_of(path, arrays), **options)
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise ValueError(f"{path}: damaged ({error}); save it again") from error

    @cached_property
    def _walk(self) -> Walk:
        return walk(self.graph, np.zeros((self._n_z, 1)))

    @property
    def _n_z(self) -> int:
        return math.prod(features(self.graph))

    @property
    def _n_x(self) -> int:
        return self._walk.f.shape[0]

    def _chunks(self, count: int) -> Iterator[slice]:
        return _arrays.chunks(count, max(1, self._walk.numbers // _REUSED))

    def _traced(self, z: FloatArray, p: FloatArray) -> tuple[Traced, list[Traced]]:
        """f (n_x, N), and the weights that it remembers."""
        names, tape = self._walk.trained, []
        ends = np.cumsum([self.graph.constants[name].size for name in names])
        weights = [Traced(part[:, None], tape=tape) for part in np.split(p, ends[:-1])] if names else []
        f = walk(self.graph, z.T, weights=dict(zip(names, weights, strict=True))).f
        return (f if isinstance(f, Traced) else Traced(f, tape=tape)), weights

    def __repr__(self) -> str:
        names = ", ".join(node.operator for node in self.graph.nodes[:8])
        more = ", ..." if len(self.graph.nodes) > 8 else ""
        return f"OnnxNetwork({self._n_z} -> {self._n_x}; {names}{more}; {len(self.parameters)} parameters)"


def _pulled(f: Traced, weights: list[Traced], cotangent: FloatArray) -> FloatArray:
    """Gradient of sum(cotangent * f') in the weights."""
    with np.errstate(all="ignore"):
        f.pull(np.broadcast_to(cotangent.T, f.shape) if f.shape[1] == 1 else cotangent.T)
    zero = np.zeros((0, 1))
    parts = [np.zeros_like(w.value) if w.cotangent is None else w.cotangent for w in weights]
    return np.concatenate([zero, *parts])[:, 0]
