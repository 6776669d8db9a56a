"""Dense layers with the activations of networks trained elsewhere: value, vector-Jacobian product, expression."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.special import expit

from .._sections import FloatArray
from . import _arrays


@dataclass(frozen=True)
class Activation:
    """An elementwise function by name.

    Parameters
    ----------
    name : str
        "identity", "relu", "leaky_relu", "elu", "selu", "tanh", "sigmoid", "softplus", "softsign" or "clip".
    first, second : float
        Its numbers (slope, limits), if it has any.

    Raises
    ------
    ValueError
        If there is no such function, or its numbers are none for it.
    """

    name: str
    first: float = 0.0
    second: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in VALUE:
            raise ValueError(f"activation: expected one of {sorted(VALUE)}, got {self.name!r}")
        if not (np.isfinite(self.first) and np.isfinite(self.second)) and self.name != "clip":
            raise ValueError(f"activation: expected finite numbers, got {self.first}, {self.second}")
        if np.isnan(self.first) or np.isnan(self.second):
            raise ValueError("activation: expected limits, got nan")


# v: what goes in, a and b: first and second.
VALUE: dict[str, Callable[[FloatArray, float, float], FloatArray]] = {
    "identity": lambda v, a, b: v,
    "relu": lambda v, a, b: np.maximum(v, 0.0),
    "leaky_relu": lambda v, a, b: np.where(v < 0.0, a * v, v),
    "elu": lambda v, a, b: np.where(v < 0.0, a * np.expm1(np.minimum(v, 0.0)), v),
    "selu": lambda v, a, b: b * np.where(v < 0.0, a * np.expm1(np.minimum(v, 0.0)), v),
    "tanh": lambda v, a, b: np.tanh(v),
    "sigmoid": lambda v, a, b: expit(v),
    "softplus": lambda v, a, b: np.logaddexp(0.0, v),
    "softsign": lambda v, a, b: v / (1.0 + np.abs(v)),
    "clip": lambda v, a, b: np.clip(v, a, b),
}
SLOPE: dict[str, Callable[[FloatArray, float, float], FloatArray]] = {
    "identity": lambda v, a, b: np.ones_like(v),
    "relu": lambda v, a, b: np.where(v > 0.0, 1.0, 0.0),
    "leaky_relu": lambda v, a, b: np.where(v < 0.0, a, 1.0),
    "elu": lambda v, a, b: np.where(v < 0.0, a * np.exp(np.minimum(v, 0.0)), 1.0),
    "selu": lambda v, a, b: b * np.where(v < 0.0, a * np.exp(np.minimum(v, 0.0)), 1.0),
    "tanh": lambda v, a, b: 1.0 - np.tanh(v) ** 2,
    "sigmoid": lambda v, a, b: expit(v) * expit(-v),
    "softplus": lambda v, a, b: expit(v),
    "softsign": lambda v, a, b: 1.0 / (1.0 + np.abs(v)) ** 2,
    "clip": lambda v, a, b: np.where((v > a) & (v < b), 1.0, 0.0),
}
EXPRESSION: dict[str, Callable[[ca.MX, float, float], ca.MX]] = {
    "identity": lambda v, a, b: v,
    "relu": lambda v, a, b: ca.fmax(v, 0.0),
    "leaky_relu": lambda v, a, b: ca.if_else(v < 0.0, a * v, v),
    "elu": lambda v, a, b: ca.if_else(v < 0.0, a * ca.expm1(ca.fmin(v, 0.0)), v),
    "selu": lambda v, a, b: b * ca.if_else(v < 0.0, a * ca.expm1(ca.fmin(v, 0.0)), v),
    "tanh": lambda v, a, b: ca.tanh(v),
    "sigmoid": lambda v, a, b: 1.0 / (1.0 + ca.exp(-v)),
    "softplus": lambda v, a, b: ca.fmax(v, 0.0) + ca.log1p(ca.exp(-ca.fabs(v))),
    "softsign": lambda v, a, b: v / (1.0 + ca.fabs(v)),
    "clip": lambda v, a, b: ca.fmin(ca.fmax(v, a), b),
}


@dataclass(frozen=True, eq=False)
class Dense:
    """f = h_L,  h_i = activation_i(W_i' h_{i-1} + b_i),  h_0 = z.

    Parameters
    ----------
    weights : tuple of (n_{i-1}, n_i) arrays
        W_1 ... W_L.
    biases : tuple of (n_i,) arrays
        b_1 ... b_L.
    activations : tuple of Activation
        One for each layer.

    Raises
    ------
    ValueError
        If sizes do not fit together or a number is not finite.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    activations: tuple[Activation, ...]

    def __post_init__(self) -> None:
        for name in ("weights", "biases"):
            arrays = tuple(_arrays.frozen(f"{name}[{i}]", a) for i, a in enumerate(getattr(self, name)))
            object.__setattr__(self, name, arrays)
        if not 0 < len(self.weights) == len(self.biases) == len(self.activations):
            raise ValueError(
                f"expected as many biases and activations as weights, got {len(self.biases)}, "
                f"{len(self.activations)} and {len(self.weights)}"
            )
        before = self.weights[0].shape[:1]
        for i, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            if W.ndim != 2 or W.size == 0 or W.shape != before + b.shape:
                raise ValueError(
                    f"layer {i}: weights of shape {W.shape} and biases {b.shape} do not fit together"
                )
            before = b.shape

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of features, and of units in each layer."""
        return self.weights[0].shape[0], *(len(b) for b in self.biases)

    @property
    def parameters(self) -> FloatArray:
        """W_1 by rows, b_1, W_2 by rows, ..., b_L in one vector."""
        return np.concatenate(
            [a.ravel() for pair in zip(self.weights, self.biases, strict=True) for a in pair]
        )

    def with_parameters(self, parameters: FloatArray) -> Dense:
        """The same layers with other weights and biases, in the order of :attr:`parameters`."""
        weights, biases, first = [], [], 0
        for W, b in zip(self.weights, self.biases, strict=True):
            middle, last = first + W.size, first + W.size + b.size
            weights.append(parameters[first:middle].reshape(W.shape))
            biases.append(parameters[middle:last])
            first = last
        return replace(self, weights=tuple(weights), biases=tuple(biases))

    def predict(self, z: FloatArray) -> FloatArray:
        """f at features z (N, n_z)."""
        f = np.empty((len(z), self.sizes[-1]))
        for rows in self._chunks(len(z)):
            h = z[rows]
            for W, b, activation in zip(self.weights, self.biases, self.activations, strict=True):
                h = VALUE[activation.name](h @ W + b, activation.first, activation.second)
            f[rows] = h
        return f

    def vjp(self, z: FloatArray, cotangent: FloatArray) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, by back-propagation."""
        of_weights = [np.zeros_like(W) for W in self.weights]
        of_biases = [np.zeros_like(b) for b in self.biases]
        for rows in self._chunks(len(z)):
            inputs, sums = [z[rows]], []
            for W, b, activation in zip(self.weights, self.biases, self.activations, strict=True):
                sums.append(inputs[-1] @ W + b)
                inputs.append(VALUE[activation.name](sums[-1], activation.first, activation.second))
            back = cotangent[rows]
            for i in reversed(range(len(self.weights))):
                activation = self.activations[i]
                back = back * SLOPE[activation.name](sums[i], activation.first, activation.second)
                of_weights[i] += inputs[i].T @ back
                of_biases[i] += back.sum(axis=0)
                back = back @ self.weights[i].T
        return np.concatenate([a.ravel() for pair in zip(of_weights, of_biases, strict=True) for a in pair])

    def expression(self, z: ca.MX) -> ca.MX:
        """f at one sample z (n_z, 1)."""
        h = z
        for W, b, activation in zip(self.weights, self.biases, self.activations, strict=True):
            v = ca.mtimes(ca.DM(W.T), h) + ca.DM(b)
            h = EXPRESSION[activation.name](v, activation.first, activation.second)
        return h

    def _chunks(self, count: int) -> Iterator[slice]:
        return _arrays.chunks(count, max(W.size for W in self.weights))
