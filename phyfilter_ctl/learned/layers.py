"""The numbers of a fitted network, and what is computed from them: value, vector-Jacobian product, expression."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np

from .._sections import FloatArray
from .._signals import refuse_unusable

# Names of the standardisation, in the order of the class.
SCALES = ("z_mean", "z_scale", "f_mean", "f_scale")

# Multiplications in one matrix product. OpenBLAS shares larger ones among threads, which on products this narrow
# costs more than it gains (28,000 rows, 30 -> 20 -> 20 -> 3, on a busy machine: 50 ms instead of 5 ms) and makes
# the last digits depend on the number of cores. The activations then fit in the cache, and memory stays bounded.
_PRODUCT = 1 << 18
# A column that varies by less than this share of its size is constant but for rounding.
_CONSTANT = 1e-12


@dataclass(frozen=True, eq=False)
class Layers:
    """Weights of a fitted network with the standardisation of its inputs and outputs.

        f = m_f + S_f (W_L' h_{L-1} + b_L),   h_i = tanh(W_i' h_{i-1} + b_i),   h_0 = (z - m_z) / S_z

    Parameters
    ----------
    weights : tuple of (n_{i-1}, n_i) arrays
        W_1 ... W_L.
    biases : tuple of (n_i,) arrays
        b_1 ... b_L.
    z_mean, z_scale : (n_z,) arrays
        m_z and S_z in the units of the features; S_z > 0.
    f_mean, f_scale : (n_x,) arrays
        m_f and S_f in the unit of f; S_f > 0.

    Raises
    ------
    ValueError
        If sizes do not fit together, a number is not finite or a scale not above zero.
    """

    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    z_mean: FloatArray
    z_scale: FloatArray
    f_mean: FloatArray
    f_scale: FloatArray

    def __post_init__(self) -> None:
        for name in ("weights", "biases"):
            object.__setattr__(
                self, name, tuple(_own(f"{name}[{i}]", a) for i, a in enumerate(getattr(self, name)))
            )
        for name in ("z_mean", "z_scale", "f_mean", "f_scale"):
            object.__setattr__(self, name, _own(name, getattr(self, name)))
        if len(self.weights) == 0 or len(self.biases) != len(self.weights):
            raise ValueError(
                f"expected as many biases as weights, got {len(self.biases)} and {len(self.weights)}"
            )
        ends = zip([self.z_mean, *self.biases[:-1]], [*self.biases[:-1], self.f_mean], strict=True)
        for i, ((before, after), W, b) in enumerate(zip(ends, self.weights, self.biases, strict=True)):
            if b.ndim != 1 or b.size == 0 or W.shape != before.shape + after.shape or b.shape != after.shape:
                raise ValueError(
                    f"layer {i}: weights of shape {W.shape} and biases {b.shape} do not fit together"
                )
        for name, scale, mean in (("z", self.z_scale, self.z_mean), ("f", self.f_scale, self.f_mean)):
            if scale.shape != mean.shape or not np.all(scale > 0.0):
                raise ValueError(
                    f"{name}_scale: expected numbers > 0 of shape {mean.shape}, got {scale.tolist()}"
                )

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of features, of units in each hidden layer, and of outputs."""
        return len(self.z_mean), *(len(b) for b in self.biases)

    @property
    def parameters(self) -> FloatArray:
        """W_1 by rows, b_1, W_2 by rows, ..., b_L in one vector."""
        return flat(zip(self.weights, self.biases, strict=True))

    def with_parameters(self, parameters: FloatArray) -> Layers:
        """The same layers with other weights and biases, in the order of :attr:`parameters`."""
        weights, biases, first = [], [], 0
        for before, after in pairwise(self.sizes):
            middle, last = first + before * after, first + (before + 1) * after
            weights.append(parameters[first:middle].reshape(before, after))
            biases.append(parameters[middle:last])
            first = last
        return replace(self, weights=tuple(weights), biases=tuple(biases))

    def predict(self, z: FloatArray) -> FloatArray:
        """f at features z (N, n_z)."""
        f = np.empty((len(z), len(self.f_mean)))
        for rows in self._chunks(len(z)):
            f[rows] = self.forward(z[rows])[0]
        return f

    def vjp(self, z: FloatArray, cotangent: FloatArray) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, by back-propagation."""
        gradient = self.no_gradient()
        for rows in self._chunks(len(z)):
            self.backward(self.forward(z[rows])[1], cotangent[rows], gradient)
        return flat(gradient)

    def forward(self, z: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """f (N, n_x) at features z (N, n_z), and what :meth:`backward` needs: h_0 ... h_{L-1}."""
        activations = [(z - self.z_mean) / self.z_scale]
        for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            activations.append(np.tanh(activations[-1] @ W + b))
        return self.f_mean + self.f_scale * (
            activations[-1] @ self.weights[-1] + self.biases[-1]
        ), activations

    def backward(
        self,
        activations: list[FloatArray],
        cotangent: FloatArray,
        gradient: list[tuple[FloatArray, FloatArray]],
    ) -> FloatArray:
        """Cotangent of z (N, n_z) from that of f.

        Parameters
        ----------
        activations : list of (N, n_i) arrays
            From :meth:`forward`.
        cotangent : (N, n_x) array
            Of f.
        gradient : list of pairs of arrays
            From :meth:`no_gradient`; what belongs to weights and biases is added.
        """
        back = cotangent * self.f_scale
        for i in reversed(range(len(self.weights))):
            of_weights, of_biases = gradient[i]
            of_weights += activations[i].T @ back
            of_biases += back.sum(axis=0)
            back = back @ self.weights[i].T
            if i > 0:
                back *= 1.0 - activations[i] ** 2
        return back / self.z_scale

    def no_gradient(self) -> list[tuple[FloatArray, FloatArray]]:
        """Zeros for :meth:`backward` to add to, a pair for each layer."""
        return [(np.zeros_like(W), np.zeros_like(b)) for W, b in zip(self.weights, self.biases, strict=True)]

    def expression(self, z: ca.SX) -> ca.SX:
        """f at one sample z (n_z, 1)."""
        h = (z - ca.DM(self.z_mean)) / ca.DM(self.z_scale)
        for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = ca.tanh(ca.mtimes(ca.DM(W.T), h) + ca.DM(b))
        output = ca.mtimes(ca.DM(self.weights[-1].T), h) + ca.DM(self.biases[-1])
        return ca.DM(self.f_mean) + ca.DM(self.f_scale) * output

    def _chunks(self, count: int) -> Iterator[slice]:
        rows = max(1, _PRODUCT // max(W.size for W in self.weights))
        return (slice(first, first + rows) for first in range(0, count, rows))


def flat(pairs: Iterable[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Weights by rows and biases, layer after layer, in one vector."""
    return np.concatenate([array.ravel() for pair in pairs for array in pair])


def standardisation(name: str, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of each column; 1 for a column that does not vary."""
    refuse_unusable(name, values)
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    constant = deviation <= _CONSTANT * np.max(np.abs(values), axis=0)
    return mean, np.where(constant, 1.0, deviation)


def _own(name: str, values: FloatArray) -> FloatArray:
    """A finite, read-only copy; of any size, as the steps of an optimiser are."""
    array = np.array(values, dtype=float)
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name}: expected finite numbers")
    array.flags.writeable = False
    return array
