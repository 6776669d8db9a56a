"""A learned model on windows of past signals."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Generic, Self, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from . import _arrays, _files
from ._window import window
from .model import FitResult, LearnedModel, expect_model
from .saved import saved_model

M = TypeVar("M", bound=LearnedModel)


@dataclass(frozen=True, eq=False)
class Windowed(Generic[M]):
    """A learned model of the recent past of signals: f_theta(x_k, x_{k-s}, ..., x_{k-(L-1)s}).

    Its features are the signals themselves, (N, n), in the order of time: of x alone, ``log.with_model(windowed)`` has
    what it predicts as f_theta.

    Parameters
    ----------
    model : LearnedModel
        Takes a row of :meth:`features`, (L n,).
    length : int
        Number L of samples in a window.
    stride : int
        Their spacing s in samples; before the first sample the signals are taken as constant.
    steps : bool
        Whether the model takes the newest sample and the L - 1 steps back from it, x_k, x_k - x_{k-s}, ..., which a
        network need not learn to subtract, or the samples as they are.

    Raises
    ------
    TypeError, ValueError
        If the model is no learned model, or ``length`` or ``stride`` is below 1.

    Examples
    --------
    The slope of a ramp, learned from windows of two samples:

    >>> from phyfilter_ctl.learned import Chebyshev, Windowed
    >>> t = 0.1 * np.arange(200.0)[:, None]
    >>> slope = Windowed(Chebyshev(1, n_d=0), 2).fit(np.sin(t), np.cos(t)).model
    >>> bool(abs(slope.predict(np.sin(t)) - np.cos(t))[1:].max() < 0.06)
    True
    """

    model: M
    length: int
    stride: int = 1
    _: KW_ONLY
    steps: bool = True

    def __post_init__(self) -> None:
        expect_model(self.model)
        for name in ("length", "stride"):
            _signals.count(name, getattr(self, name))

    @property
    def reach(self) -> int:
        """Samples before the present one that a window reaches back to."""
        return (self.length - 1) * self.stride

    def features(self, x: ArrayLike) -> FloatArray:
        """What the model takes, (N, L n), of signals x (N, n).

        Raises
        ------
        ValueError, TypeError
            If ``x`` is not a finite real array of shape (N, n).
        """
        past = window(x, self.length, stride=self.stride)
        if not self.steps:
            return past
        rows = past.reshape(len(past), self.length, -1)
        return np.concatenate([rows[:, :1], rows[:, :-1] - rows[:, 1:]], axis=1).reshape(len(past), -1)

    @property
    def parameters(self) -> FloatArray:
        """Those of the model."""
        return self.model.parameters

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """The same windows with a model of these parameters, shape (n_parameters,).

        Raises
        ------
        ValueError
            If their number is wrong or one is not finite.
        """
        return replace(self, model=self.model.with_parameters(parameters))

    def fit(self, z: ArrayLike | Sequence[ArrayLike], f: ArrayLike | Sequence[ArrayLike]) -> FitResult[Self]:
        """Fit the model to signals z (N, n) and unknown dynamics f (N, n_x), or to a list of both, one a flight.

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or values are not finite real numbers, or as many f are not given as z.
        """
        if isinstance(z, list | tuple) and z and np.ndim(z[0]) == 2:
            if not isinstance(f, list | tuple) or len(f) != len(z):
                raise ValueError(f"f: expected one for each of {len(z)} flights, as z")
            pairs = [_arrays.pairs(*flight) for flight in zip(z, f, strict=True)]
        else:
            pairs = [_arrays.pairs(z, f)]  # type: ignore[arg-type]  # one flight
        rows = np.concatenate([self.features(signal) for signal, _ in pairs])
        found = self.model.fit(rows, np.concatenate([force for _, force in pairs]))
        return FitResult(
            replace(self, model=found.model), found.rmse, found.iterations, found.status, found.message
        )

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta (N, n_x) at every sample of signals z (N, n); of the past alone.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n).
        """
        return self.model.predict(self.features(z))

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in the parameters, shape (n_parameters,)."""
        return self.model.vjp(self.features(z), cotangent)

    def casadi(self) -> ca.Function:
        """The model of one window, newest sample first, as :func:`window` has it: z (L n,) -> f_theta (n_x,).

        Raises
        ------
        ValueError
            If the model has no expression.
        """
        inner = self.model.casadi()
        z = ca.MX.sym("z", inner.numel_in(0))
        samples = ca.vertsplit(z, inner.numel_in(0) // self.length)
        taken = [samples[0], *(a - b for a, b in pairwise(samples))] if self.steps else samples
        return ca.Function("f_theta", [z], [inner(ca.vertcat(*taken))], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to the file ``path``, whole or not at all, the model with it.

        Raises
        ------
        ValueError
            If the model is code.
        """
        with tempfile.TemporaryDirectory() as folder:
            self.model.save(inner := Path(folder) / "model.npz")
            data = np.frombuffer(inner.read_bytes(), dtype=np.uint8)
        numbers = {name: np.array(int(getattr(self, name))) for name in ("length", "stride", "steps")}
        _files.write(path, "windowed", numbers | {"model": data})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read one that :meth:`save` wrote to ``path``; nothing in the file is executed.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        arrays = _files.read(path, "windowed")
        _arrays.expect_entries(path, arrays, ("length", "stride", "steps", "model"))
        if arrays["model"].dtype != np.uint8 or any(
            arrays[name].dtype.kind != "i" or arrays[name].shape for name in ("length", "stride", "steps")
        ):
            raise ValueError(
                f"{path}: damaged, its entries are of other types than save() writes; save it again"
            )
        with tempfile.TemporaryDirectory() as folder:
            (inner := Path(folder) / "model.npz").write_bytes(arrays["model"].tobytes())
            model = saved_model(inner)
        whole = (int(arrays[name]) for name in ("length", "stride"))
        return cls(model, *whole, steps=bool(arrays["steps"]))  # type: ignore[arg-type]  # of the kind in the file
