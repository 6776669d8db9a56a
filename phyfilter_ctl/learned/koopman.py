"""Unknown dynamics that evolve by themselves: extended dynamic mode decomposition, one sample ahead."""

from __future__ import annotations

import os
from dataclasses import KW_ONLY, dataclass, replace
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Status
from . import _arrays, _files
from ._least_squares import ridge
from .dictionary import Dictionary
from .model import FitResult

_KIND = "koopman"
_OF_DICTIONARY = ("n_z", "degree", "width")
_ARRAYS_OF_DICTIONARY = ("centres", "offset", "scale")
_OPTIONS = ("n_f", "dt", "l2")


@dataclass(frozen=True, eq=False, repr=False)
class Koopman:
    """The next sample of f from f, the state and outer influences now, linear in a dictionary of functions.

        f_theta[k+1] = f_k + dt W' psi(z_k),   z_k = (f_k, x_k, d_k)

    These are the rows for f of the Koopman operator on the dictionary, written as a rate, so that W = 0 means
    "f stays as it is". :class:`OnlineKoopman` finds W over a sliding window, in operation.

    Parameters
    ----------
    dictionary : Dictionary
        psi; its first ``n_f`` features are f.
    n_f : int
        Number of channels of f.
    dt : float
        Sampling time, s.
    l2 : float
        Weight l of the penalty l |W|^2 beside the mean squared error of the rate.
    W : array_like, shape (m, n_f), optional
        Weights of a fitted model, 1/s times the unit of f; None before the first fit.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, or shapes do not fit together.

    Notes
    -----
    Paper, supplement "Koopman operator-based uncertainty observer" (EVOLVER): f' = h(f, x, d).

    Examples
    --------
    >>> f = np.exp(-0.5 * 0.01 * np.arange(200.0))[:, None]
    >>> model = Koopman(Dictionary(1, degree=1), 1, dt=0.01, l2=0.0).fit(f[:-1], f[1:]).model
    >>> bool(abs(model.predict([[1.0]])[0, 0] - np.exp(-0.005)) < 1e-12), model.rate([[1.0]]).round(3).tolist()
    (True, [[-0.499]])
    """

    dictionary: Dictionary
    n_f: int
    _: KW_ONLY
    dt: float
    l2: float = 1e-8
    W: FloatArray | None = None

    def __post_init__(self) -> None:
        _signals.count("n_f", self.n_f)
        if self.n_f > self.dictionary.n_z:
            raise ValueError(
                f"n_f: expected at most the {self.dictionary.n_z} features of the dictionary, got {self.n_f}"
            )
        _arrays.number("dt", self.dt, positive=True)
        _arrays.number("l2", self.l2)
        if self.W is not None:
            object.__setattr__(self, "W", _arrays.frozen("W", self.W, (self.dictionary.size, self.n_f)))

    @property
    def parameters(self) -> FloatArray:
        """W by rows, shape (m n_f,); (0,) before a fit."""
        return np.zeros(0) if self.W is None else self.W.ravel()

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the model with these weights, in the order of :attr:`parameters`.

        Raises
        ------
        ValueError
            If the model has not been fitted, the number is wrong or a value is not finite.
        """
        W = self._fitted()
        return replace(self, W=_arrays.parameter_vector(parameters, W.size).reshape(W.shape))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Ridge least squares of W on z (N, n_z) and f (N, n_f), each row the f one sample after that row of z.

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays of these shapes with the same number of rows.
        """
        z, f = _arrays.pairs(z, f, self.dictionary.n_z, self.n_f)
        m = self.dictionary.size
        slices = _arrays.chunks(len(z), m)
        blocks = ((self.dictionary(z[rows]), (f[rows] - z[rows, : self.n_f]) / self.dt) for rows in slices)
        W, rank = ridge(blocks, self.l2, m)
        if not np.all(np.isfinite(W)):
            message = "the dictionary overflows: scale it with Dictionary.scaled_to(z)"
            return FitResult(self, float("inf"), 1, Status.FAILED, message)
        model, message = replace(self, W=W), "converged"
        if rank < m:
            message += f"; the data determine {rank} of {m} weights: lower degree, or use fewer features"
        return FitResult(model, _arrays.rms(model.predict(z) - f), 1, Status.CONVERGED, message)

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta one sample after z (N, n_z), shape (N, n_f).

        Raises
        ------
        ValueError, TypeError
            If the model has not been fitted or ``z`` is not a finite real array of shape (N, n_z).
        """
        z = _arrays.rows("z", z, self.dictionary.n_z)
        return z[:, : self.n_f] + self.dt * self.rate(z)

    def rate(self, z: ArrayLike) -> FloatArray:
        """Mean derivative of f_theta over the step after z (N, n_z), shape (N, n_f): what EVOLVER integrates.

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`.
        """
        W = self._fitted()
        z = _arrays.rows("z", z, self.dictionary.n_z)
        rate = np.empty((len(z), self.n_f))
        for rows in _arrays.chunks(len(z), W.size):
            rate[rows] = self.dictionary(z[rows]) @ W
        return rate

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in W by rows, shape (n_parameters,).

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`, and if ``cotangent`` is not of shape (N, n_f).
        """
        W = self._fitted()
        z, cotangent = _arrays.with_cotangent(z, cotangent, self.dictionary.n_z, self.n_f)
        gradient = np.zeros_like(W)
        for rows in _arrays.chunks(len(z), W.size):
            gradient += self.dictionary(z[rows]).T @ cotangent[rows]
        return self.dt * gradient.ravel()

    def casadi(self) -> ca.Function:
        """The model at one sample as a CasADi function ``f_theta``: z (n_z,) -> f_theta (n_f,) one sample later.

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        W = self._fitted()
        z = ca.SX.sym("z", self.dictionary.n_z)
        f = z[: self.n_f] + self.dt * ca.mtimes(ca.DM(W.T), self.dictionary.expression(z))
        return ca.Function("f_theta", [z], [f], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to an .npz archive, whole or not at all; the path is taken as it is.

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        arrays = {"W": self._fitted()} | {name: np.array(getattr(self, name)) for name in _OPTIONS}
        of_dictionary = (*_OF_DICTIONARY, *_ARRAYS_OF_DICTIONARY)
        _files.write(
            path, _KIND, arrays | {name: np.array(getattr(self.dictionary, name)) for name in of_dictionary}
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model that :meth:`save` wrote to ``path``.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        arrays = _files.read(path, _KIND)
        _arrays.expect_entries(path, arrays, ("W", *_OPTIONS, *_OF_DICTIONARY, *_ARRAYS_OF_DICTIONARY))
        try:
            n_z, degree, width = (arrays[name].item() for name in _OF_DICTIONARY)
            centres, offset, scale = (_arrays.floats(arrays, name) for name in _ARRAYS_OF_DICTIONARY)
            dictionary = Dictionary(
                n_z, degree=degree, width=width, centres=centres, offset=offset, scale=scale
            )
            n_f, dt, l2 = (arrays[name].item() for name in _OPTIONS)
            return cls(dictionary, n_f, dt=dt, l2=l2, W=_arrays.floats(arrays, "W"))
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({error}); save it again") from error

    def _fitted(self) -> FloatArray:
        if self.W is None:
            raise ValueError("the model has no weights yet: call fit(z, f) and use the model of its result")
        return self.W

    def __repr__(self) -> str:
        fitted = "not fitted" if self.W is None else f"{self.W.size} parameters"
        return f"Koopman({self.dictionary!r}, {self.n_f}, dt={self.dt:g}, {fitted})"
