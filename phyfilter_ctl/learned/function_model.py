"""A function that is there already as a model of the unknown dynamics."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Status
from . import _arrays
from .model import FitResult

# A function and its trace: the same formula in another order, next to its greatest value.
_SAME = 1e-9
_PROBED_ROWS = 16


@dataclass(frozen=True, eq=False, repr=False)
class FunctionModel:
    """A function f_theta(z) without parameters to train.

    Parameters
    ----------
    function : callable or casadi.Function
        Features (N, n_z) -> f_theta (N, n_x), row by row; a CasADi function takes one sample (n_z,).
    n_z, n_x : int
        Number of features and of channels of f.

    Raises
    ------
    ValueError, TypeError
        If a number is out of range, or a CasADi function has other sizes.

    Examples
    --------
    >>> drag = FunctionModel(lambda v: -0.3 * v * np.abs(v), 1, 1)
    >>> drag.predict([[2.0]]).tolist(), drag.casadi()(2.0)
    ([[-1.2]], DM(-1.2))
    """

    function: Callable[[FloatArray], ArrayLike] | ca.Function
    n_z: int
    n_x: int

    def __post_init__(self) -> None:
        for name in ("n_z", "n_x"):
            _signals.count(name, getattr(self, name))
        if not isinstance(self.function, ca.Function):
            if not callable(self.function):
                raise TypeError(f"function: expected a callable, got {type(self.function).__name__}")
            return
        got = [self.function.size_in(i) for i in range(self.function.n_in())]
        got += [self.function.size_out(i) for i in range(self.function.n_out())]
        if got != [(self.n_z, 1), (self.n_x, 1)]:
            raise ValueError(
                f"function: expected z ({self.n_z}, 1) -> f_theta ({self.n_x}, 1), got {self.function}"
            )

    @property
    def parameters(self) -> FloatArray:
        """None, shape (0,)."""
        return np.zeros(0)

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the model as it is, for ``parameters`` of shape (0,).

        Raises
        ------
        ValueError
            If there is a parameter.
        """
        _signals.array("parameters", parameters, (0,), empty=True)
        return self

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """The model as it is, with its error on features z (N, n_z) and unknown dynamics f (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays of these shapes with the same number of rows.
        """
        z, f = _arrays.pairs(z, f, self.n_z, self.n_x)
        return FitResult(
            self, _arrays.rms(self.predict(z) - f), 0, Status.CONVERGED, "a function has nothing to fit"
        )

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at features z (N, n_z), shape (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n_z), or what the function returns not one of (N, n_x).
        """
        z = _arrays.rows("z", z, self.n_z)
        if isinstance(self.function, ca.Function):
            return self.function.map(len(z))(z.T).full().T
        f = np.asarray(self.function(z))
        f = f[:, None] if self.n_x == 1 and f.ndim == 1 else f
        return _signals.array("what the function returned", f, (len(z), self.n_x))

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient in no parameters, shape (0,).

        Raises
        ------
        ValueError, TypeError
            If ``z`` or ``cotangent`` is not a finite real array of shape (N, n_z) or (N, n_x).
        """
        _arrays.with_cotangent(z, cotangent, self.n_z, self.n_x)
        return np.zeros(0)

    def casadi(self) -> ca.Function:
        """The model at one sample as a CasADi function ``f_theta``: z (n_z,) -> f_theta (n_x,).

        Raises
        ------
        ValueError
            If the function cannot be traced with CasADi's symbols: compiled code, branches, other people's arrays.
        """
        return self._traced

    def save(self, path: str | os.PathLike[str]) -> None:
        """Refused whatever ``path``: the function is code.

        Raises
        ------
        ValueError
            Always; the message says what can be saved.
        """
        raise ValueError(
            f"{os.fspath(path)}: a function is code; keep that, or save a Network fitted to its predictions"
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Refused whatever ``path``, as :meth:`save`.

        Raises
        ------
        ValueError
            Always.
        """
        raise ValueError(
            f"{os.fspath(path)}: a function is code and in no file; import it from where it is written"
        )

    @cached_property
    def _traced(self) -> ca.Function:
        if isinstance(self.function, ca.Function):
            z = ca.MX.sym("z", self.n_z)
            return ca.Function("f_theta", [z], [self.function(z)], ["z"], ["f_theta"])
        z = ca.SX.sym("z", self.n_z)
        elements = np.empty((1, self.n_z), dtype=object)
        elements[0, :] = ca.vertsplit(z)
        reasons: list[str] = []
        for row in (elements, z.T):  # numpy's functions want the one or the other
            try:
                with warnings.catch_warnings():
                    # CasADi's note on numpy functions; the probe is what counts.
                    warnings.simplefilter("ignore")
                    result: object = self.function(row)  # type: ignore[arg-type]  # symbols, to see what it does
                    entries = ca.vertsplit(ca.vec(result)) if isinstance(result, ca.SX) else np.ravel(result)
                    traced = ca.Function("f_theta", [z], [ca.vertcat(*entries)], ["z"], ["f_theta"])
                    self._compare(traced)
                return traced
            except Exception as error:  # whatever the function makes of symbols
                reasons.append((str(error).strip().splitlines() or [type(error).__name__])[-1].strip())
        raise ValueError(
            f"{self!r} predicts, but is no expression for diagrams, C and FMUs ({'; '.join(dict.fromkeys(reasons))}); "
            "write it with numpy on columns z[:, i] and without branches on z, or fit a Network to its predictions"
        )

    def _compare(self, traced: ca.Function) -> None:
        """Refuse a trace that is not the function at random points."""
        z = np.random.default_rng(0).standard_normal((_PROBED_ROWS, self.n_z))
        with np.errstate(all="ignore"):
            expected = np.reshape(np.asarray(self.function(z), dtype=float), (_PROBED_ROWS, -1))
        got = traced.map(_PROBED_ROWS)(z.T).full().T
        if got.shape != expected.shape or not np.any(np.isfinite(expected)):
            raise ValueError("its symbols have another shape than its numbers, or are not finite")
        same = np.isclose(got, expected, rtol=0.0, atol=_SAME * np.nanmax(np.abs(expected)), equal_nan=True)
        if not np.all(same):
            raise ValueError("traced with symbols it is another function")

    def __repr__(self) -> str:
        name = getattr(self.function, "__qualname__", None) or type(self.function).__name__
        return f"FunctionModel({name}, {self.n_z} -> {self.n_x})"
