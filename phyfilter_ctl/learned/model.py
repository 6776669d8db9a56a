"""What a learned model of the unknown dynamics is."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Protocol, Self, TypeVar, runtime_checkable

import casadi as ca
from numpy.typing import ArrayLike

from .._sections import FloatArray
from ..results import Result, SearchResult, Status

M_co = TypeVar("M_co", covariant=True)


@dataclass(frozen=True, repr=False)
class FitResult(Result, SearchResult[M_co]):
    """What fitting a learned model gave.

    Attributes
    ----------
    model : LearnedModel
        The fitted model; the model as it was if ``status`` is FAILED.
    rmse : float
        Root-mean-square error on the data it was fitted to, in the unit of f; inf if ``status`` is FAILED.
    iterations : int
        Iterations of the optimiser.
    status : Status
        CONVERGED, ITERATION_LIMIT, STALLED or FAILED.
    message : str
        The status in words, and what to try.
    """

    model: M_co
    rmse: float
    iterations: int
    status: Status
    message: str

    @property
    def best(self) -> M_co:
        """``model``: what every search calls what it found."""
        return self.model


@runtime_checkable
class LearnedModel(Protocol):
    """A model f_theta of the unknown dynamics f, from features z; frozen: fitting returns another one."""

    @property
    def parameters(self) -> FloatArray:
        """All trainable parameters theta, flat, shape (n_parameters,); empty before the first fit."""
        ...

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the model with these parameters, shape (n_parameters,).

        Raises
        ------
        ValueError
            If their number is wrong or one is not finite.
        """
        ...

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Fit the model to features z (N, n_z) and unknown dynamics f (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or values are not finite real numbers.
        """
        ...

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at features z (N, n_z), shape (N, n_x)."""
        ...

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, shape (n_parameters,).

        ``cotangent`` has the shape (N, n_x) of the prediction.
        """
        ...

    def casadi(self) -> ca.Function:
        """The model at one sample as a CasADi function: z (n_z,) -> f_theta (n_x,)."""
        ...

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to a file, whole or not at all."""
        ...

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model that :meth:`save` wrote; nothing in the file is executed.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        ...


def expect_model(model: object) -> None:
    """Refuse what is no learned model, and name the way to one.

    Raises
    ------
    TypeError
        For everything else, a class of models too.
    """
    if isinstance(model, type) or not isinstance(model, LearnedModel):
        got = f"the class {model.__name__}" if isinstance(model, type) else type(model).__name__
        raise TypeError(
            f"model: expected a learned model, got {got}; phyfilter_ctl.learned_model(...) makes one of models from "
            "scikit-learn, PyTorch and ONNX and of functions"
        )
