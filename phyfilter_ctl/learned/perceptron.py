"""What the models made of layers of tanh units share, whatever they are fitted to."""

from __future__ import annotations

import os
from dataclasses import KW_ONLY, dataclass, replace
from typing import ClassVar, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _arrays, _files
from .layers import SCALES, Layers


@dataclass(frozen=True, eq=False, repr=False)
class Perceptron:
    """Layers of tanh units with a linear output, f_theta = layers(z).

    Parameters
    ----------
    hidden : tuple of int
        Units in each hidden layer.
    layers : Layers, optional
        Weights of a fitted network; None before the first fit.

    Raises
    ------
    ValueError, TypeError
        If ``hidden`` is empty or not of whole numbers, or the layers have other sizes.
    """

    hidden: tuple[int, ...] = (20, 20)
    _: KW_ONLY
    layers: Layers | None = None

    # Name in files, the fields saved there, and the method that fits.
    _kind: ClassVar[str]
    _options: ClassVar[tuple[str, ...]]
    _fitted_by: ClassVar[str]

    def __post_init__(self) -> None:
        hidden = tuple(_signals.count("hidden", units) for units in self.hidden)
        if not hidden:
            raise ValueError("hidden: expected the units of at least one layer, got none")
        object.__setattr__(self, "hidden", hidden)
        if self.layers is not None and self.layers.sizes[1:-1] != hidden:
            raise ValueError(
                f"layers: expected hidden layers of {hidden} units, got {self.layers.sizes[1:-1]}"
            )

    @property
    def parameters(self) -> FloatArray:
        """Weights and biases W_1 by rows, b_1, W_2 by rows, ..., b_L; shape (n_parameters,), (0,) before a fit."""
        return np.zeros(0) if self.layers is None else self.layers.parameters

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the model with these weights and biases, in the order of :attr:`parameters`.

        Raises
        ------
        ValueError
            If the model has not been fitted, the number is wrong or a value is not finite.
        """
        layers = self._fitted()
        vector = _arrays.parameter_vector(parameters, len(layers.parameters))
        return replace(self, layers=layers.with_parameters(vector))

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at features z (N, n_z), shape (N, n_x); memory beyond the result does not grow with N.

        Raises
        ------
        ValueError, TypeError
            If the model has not been fitted or ``z`` is not a finite real array of shape (N, n_z).
        """
        layers = self._fitted()
        return layers.predict(_arrays.rows("z", z, layers.sizes[0]))

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, shape (n_parameters,).

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`, and if ``cotangent`` is not of shape (N, n_x).
        """
        layers = self._fitted()
        return layers.vjp(*_arrays.with_cotangent(z, cotangent, layers.sizes[0], layers.sizes[-1]))

    def casadi(self) -> ca.Function:
        """The model at one sample as a CasADi function ``f_theta``: z (n_z,) -> f_theta (n_x,).

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        layers = self._fitted()
        z = ca.SX.sym("z", layers.sizes[0])
        return ca.Function("f_theta", [z], [layers.expression(z)], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to an .npz archive, whole or not at all; the path is taken as it is.

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        layers = self._fitted()
        arrays = {name: np.array(getattr(self, name)) for name in self._options}
        arrays |= {name: getattr(layers, name) for name in SCALES}
        arrays |= _arrays.weight_arrays(layers.weights, layers.biases)
        _files.write(path, self._kind, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model that :meth:`save` wrote to ``path``.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        arrays = _files.read(path, cls._kind)
        try:
            weights, biases = _arrays.read_weights(path, arrays, (*cls._options, *SCALES))
            layers = Layers(weights, biases, *(_arrays.floats(arrays, name) for name in SCALES))
            options = {name: arrays[name].item() for name in cls._options}
            return cls(layers.sizes[1:-1], layers=layers, **options)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({error}); save it again") from error

    def _fitted(self) -> Layers:
        if self.layers is None:
            raise ValueError(
                f"the model has no weights yet: call {self._fitted_by} and use the model of its result"
            )
        return self.layers

    def __repr__(self) -> str:
        name = type(self).__name__
        if self.layers is None:
            return f"{name}(hidden={self.hidden}, not fitted)"
        sizes = self.layers.sizes
        return f"{name}(hidden={self.hidden}, {sizes[0]} -> {sizes[-1]}, {len(self.layers.parameters)} parameters)"
