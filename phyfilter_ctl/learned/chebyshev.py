"""Chebyshev polynomials of the state times Chebyshev polynomials of an unknown parameter, as a learned model."""

from __future__ import annotations

import os
from dataclasses import KW_ONLY, dataclass, replace
from typing import Literal, Self

import casadi as ca
import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from ..results import Status
from . import _arrays, _files
from ._least_squares import ridge
from .model import FitResult

_KIND = "chebyshev"
_OPTIONS = ("degree", "n_d", "degree_d", "l2", "outside")
_OUTSIDE = ("clip", "extrapolate")
# Most columns of Xi: the triangle of the least squares then has 34 MB.
_MOST_TERMS = 2048


@dataclass(frozen=True, eq=False, repr=False)
class Chebyshev:
    """Tensor Chebyshev basis of the state times that of an unknown parameter d, linear in its coefficients.

        f_theta(x, d) = Xi Phi(x) varsigma(d),   Phi(x) = phi(x) kron I,   phi, varsigma = products of T_0 ... T_p

    z = (x, d): the features of the state first, the ``n_d`` parameters last, each scaled from ``bounds`` to
    [-1, 1]. :meth:`fit` finds Xi from data with known d, by ridge least squares. In operation d is unknown, but f
    is linear in varsigma: :class:`AdaptiveChebyshev` estimates varsigma from the motion alone.

    Parameters
    ----------
    degree : int
        Highest degree p of each feature of the state.
    n_d : int
        Number of parameters d, the last columns of z; 0 for none.
    degree_d : int, optional
        Highest degree of each parameter; ``degree`` if None.
    l2 : float
        Weight l of the penalty l |Xi|^2 beside the mean squared error.
    outside : {"clip", "extrapolate"}
        What becomes of a feature outside its bounds: held at the bound, so that f_theta stays as large as it was
        there, or taken as it is; a polynomial of degree p grows like the distance to the power p.
    bounds : array_like, shape (n_z, 2), optional
        Least and greatest value of each column of z. If None, :meth:`fit` takes those of its data; the fitted
        model keeps them when it is fitted again.
    Xi : array_like, shape (n_x, m), optional
        Coefficients of a fitted model, m = (degree + 1)^(n_z - n_d) (degree_d + 1)^n_d; the last parameter varies
        fastest. None before the first fit.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, or shapes do not fit together.

    Notes
    -----
    Paper, "Implementation details of drone flight example" (SEER-I), there with p the same for all, three state
    features and one parameter: Xi (3, (p+1)^4), Phi ((p+1)^4, p+1). The estimate is a linear map of the labels, so
    a quadratic loss has one minimum.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> v, mass = rng.uniform(-3.0, 3.0, 500), rng.uniform(0.5, 1.5, 500)
    >>> result = Chebyshev(2).fit(np.column_stack([v, mass]), (-mass * v**2)[:, None])
    >>> bool(result.rmse < 1e-6), result.model.predict([[2.0, 1.0]]).round(4).tolist()
    (True, [[-4.0]])
    >>> result.model
    Chebyshev(degree=2, n_d=1, degree_d=2, 2 -> 1, 9 parameters)
    """

    degree: int = 3
    _: KW_ONLY
    n_d: int = 1
    degree_d: int | None = None
    l2: float = 1e-10
    outside: Literal["clip", "extrapolate"] = "clip"
    bounds: FloatArray | None = None
    Xi: FloatArray | None = None

    def __post_init__(self) -> None:
        _signals.count("degree", self.degree, 0)
        _signals.count("n_d", self.n_d, 0)
        object.__setattr__(self, "degree_d", self.degree if self.degree_d is None else self.degree_d)
        _signals.count("degree_d", self._degree_d, 0)
        _arrays.number("l2", self.l2)
        if self.outside not in _OUTSIDE:
            raise ValueError(f"outside: expected one of {_OUTSIDE}, got {self.outside!r}")
        if self.bounds is not None:
            bounds = _arrays.frozen("bounds", self.bounds, (-1, 2))
            if not np.all(bounds[:, 0] < bounds[:, 1]):
                raise ValueError(f"bounds: expected rows (least, greatest), got {bounds.tolist()}")
            self._terms(len(bounds))
            object.__setattr__(self, "bounds", bounds)
        if self.Xi is not None:
            if self.bounds is None:
                raise ValueError("Xi: expected bounds beside it, got none")
            object.__setattr__(self, "Xi", _arrays.frozen("Xi", self.Xi, (-1, self._terms(len(self.bounds)))))

    @property
    def parameters(self) -> FloatArray:
        """Xi by rows, shape (n_x m,); (0,) before a fit."""
        return np.zeros(0) if self.Xi is None else self.Xi.ravel()

    def with_parameters(self, parameters: ArrayLike, /) -> Self:
        """Return the model with these coefficients, in the order of :attr:`parameters`.

        Raises
        ------
        ValueError
            If the model has not been fitted, the number is wrong or a value is not finite.
        """
        Xi, _ = self._fitted()
        return replace(self, Xi=_arrays.parameter_vector(parameters, Xi.size).reshape(Xi.shape))

    def fit(self, z: ArrayLike, f: ArrayLike) -> FitResult[Self]:
        """Ridge least squares of Xi on z = (x, d) (N, n_z) with known d, and unknown dynamics f (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If ``z`` and ``f`` are not finite real arrays with the same number of rows, ``z`` has fewer than
            ``n_d`` + 1 columns, or the basis has more than 2048 terms.
        """
        z, f = _arrays.pairs(z, f, None if self.bounds is None else len(self.bounds))
        m = self._terms(z.shape[1])
        bounds = _range(z) if self.bounds is None else self.bounds
        scaled = replace(self, bounds=bounds, Xi=None)
        blocks = ((scaled._basis(z[rows]), f[rows]) for rows in _arrays.chunks(len(z), m))
        W, rank = ridge(blocks, self.l2, m)
        if not np.all(np.isfinite(W)):
            message = (
                "the coefficients are not finite: f is too large for double precision; choose another unit"
            )
            return FitResult(self, float("inf"), 1, Status.FAILED, message)
        model = replace(scaled, Xi=W.T)
        message = "converged"
        if rank < m:
            how = "held near zero by l2" if self.l2 > 0.0 else "taken with the least norm"
            message += (
                f"; the data determine {rank} of {m} coefficients, the others are {how}: fly through more of the "
                "range, or lower degree"
            )
        return FitResult(model, _arrays.rms(model.predict(z) - f), 1, Status.CONVERGED, message)

    def predict(self, z: ArrayLike) -> FloatArray:
        """f_theta at z = (x, d) (N, n_z), shape (N, n_x).

        Raises
        ------
        ValueError, TypeError
            If the model has not been fitted or ``z`` is not a finite real array of shape (N, n_z).
        """
        Xi, bounds = self._fitted()
        z = _arrays.rows("z", z, len(bounds))
        f = np.empty((len(z), len(Xi)))
        for rows in _arrays.chunks(len(z), Xi.size):
            f[rows] = self._basis(z[rows]) @ Xi.T
        return f

    def vjp(self, z: ArrayLike, cotangent: ArrayLike) -> FloatArray:
        """Gradient of sum(cotangent * predict(z)) in Xi by rows, shape (n_parameters,).

        Raises
        ------
        ValueError, TypeError
            As for :meth:`predict`, and if ``cotangent`` is not of shape (N, n_x).
        """
        Xi, bounds = self._fitted()
        z, cotangent = _arrays.with_cotangent(z, cotangent, len(bounds), len(Xi))
        gradient = np.zeros_like(Xi)
        for rows in _arrays.chunks(len(z), Xi.size):
            gradient += cotangent[rows].T @ self._basis(z[rows])
        return gradient.ravel()

    def varsigma(self, d: ArrayLike) -> FloatArray:
        """Basis of the parameters d (N, n_d), shape (N, (degree_d + 1)^n_d).

        Raises
        ------
        ValueError, TypeError
            If there are no bounds yet, ``n_d`` is 0, or ``d`` is not a finite real array of shape (N, n_d).
        """
        bounds = self._bounds()
        if self.n_d == 0:
            raise ValueError("varsigma: the model has no parameter d (n_d = 0)")
        d = _arrays.rows("d", d, self.n_d)
        return _tensor(self._scale(d, bounds[-self.n_d :]), self._degree_d)

    def d_from_varsigma(self, varsigma: ArrayLike) -> FloatArray:
        """Parameters d (N, n_d) whose basis has the first-degree entries of ``varsigma`` (N, q).

            d_i = centre_i + half-width_i varsigma[T_1(d_i)] / varsigma[T_0]

        An estimated varsigma need not be the basis of any d; this reads off what its first-degree part says.

        Raises
        ------
        ValueError, TypeError
            If ``varsigma`` is not a finite real array of shape (N, q), an entry of T_0 is 0, or ``degree_d`` or
            ``n_d`` is 0.
        """
        if self.n_d == 0 or self._degree_d == 0:
            raise ValueError("varsigma: expected n_d >= 1 and degree_d >= 1 to read d off")
        bounds = self._bounds()[-self.n_d :]
        varsigma = _arrays.rows("varsigma", varsigma, (self._degree_d + 1) ** self.n_d)
        if np.any(varsigma[:, 0] == 0.0):
            raise ValueError("varsigma: expected the entry of T_0 to be about 1, got 0")
        first = (self._degree_d + 1) ** np.arange(self.n_d - 1, -1, -1)
        return bounds.mean(axis=1) + 0.5 * np.diff(bounds)[:, 0] * varsigma[:, first] / varsigma[:, :1]

    def regressor(self, x: ArrayLike) -> FloatArray:
        """Xi Phi(x) (N, n_x, q) at features of the state x (N, n_z - n_d): f_theta = regressor varsigma.

        Raises
        ------
        ValueError, TypeError
            If the model has not been fitted, or ``x`` is not a finite real array of shape (N, n_z - n_d).
        """
        Xi, bounds = self._fitted()
        features = len(bounds) - self.n_d
        x = _arrays.rows("x", x, features)
        n_x, q = len(Xi), (self._degree_d + 1) ** self.n_d
        matrix = Xi.reshape(n_x, -1, q).transpose(1, 0, 2).reshape(-1, n_x * q)
        Y = np.empty((len(x), n_x * q))
        for rows in _arrays.chunks(len(x), matrix.size):
            Y[rows] = _tensor(self._scale(x[rows], bounds[:features]), self.degree) @ matrix
        return Y.reshape(len(x), n_x, q)

    def casadi(self) -> ca.Function:
        """The model at one sample as a CasADi function ``f_theta``: z = (x, d) (n_z,) -> f_theta (n_x,).

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        Xi, bounds = self._fitted()
        z = ca.SX.sym("z", len(bounds))
        s = (z - ca.DM(bounds.mean(axis=1))) / ca.DM(0.5 * np.diff(bounds)[:, 0])
        s = ca.fmin(ca.fmax(s, -1.0), 1.0) if self.outside == "clip" else s
        basis = ca.SX(1)
        for i in range(len(bounds)):
            degree = self.degree if i < len(bounds) - self.n_d else self._degree_d
            T = [ca.SX(1), s[i]]
            for _ in range(degree - 1):
                T.append(2.0 * s[i] * T[-1] - T[-2])
            basis = ca.kron(basis, ca.vertcat(*T[: degree + 1]))
        return ca.Function("f_theta", [z], [ca.mtimes(ca.DM(Xi), basis)], ["z"], ["f_theta"])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the model to an .npz archive, whole or not at all; the path is taken as it is.

        Raises
        ------
        ValueError
            If the model has not been fitted.
        """
        Xi, bounds = self._fitted()
        arrays = {name: np.array(getattr(self, name)) for name in _OPTIONS}
        _files.write(path, _KIND, arrays | {"bounds": bounds, "Xi": Xi})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a model that :meth:`save` wrote to ``path``.

        Raises
        ------
        ValueError
            If the file is damaged, of another kind of model or of an unknown version.
        """
        arrays = _files.read(path, _KIND)
        _arrays.expect_entries(path, arrays, (*_OPTIONS, "bounds", "Xi"))
        try:
            options = {name: arrays[name].item() for name in _OPTIONS}
            return cls(bounds=_arrays.floats(arrays, "bounds"), Xi=_arrays.floats(arrays, "Xi"), **options)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path}: damaged ({error}); save it again") from error

    @property
    def _degree_d(self) -> int:
        assert self.degree_d is not None  # set in __post_init__
        return self.degree_d

    def _bounds(self) -> FloatArray:
        if self.bounds is None:
            raise ValueError("the model has no bounds yet: give them, or call fit(z, f)")
        return self.bounds

    def _fitted(self) -> tuple[FloatArray, FloatArray]:
        if self.Xi is None or self.bounds is None:
            raise ValueError(
                "the model has no coefficients yet: call fit(z, f) and use the model of its result"
            )
        return self.Xi, self.bounds

    def _terms(self, n_z: int) -> int:
        """Number of columns of Xi, checked before memory is set aside for them."""
        if n_z <= self.n_d:
            raise ValueError(
                f"z: expected at least one column beside the n_d = {self.n_d} parameters, got {n_z}"
            )
        terms = (self.degree + 1) ** (n_z - self.n_d) * (self._degree_d + 1) ** self.n_d
        if terms > _MOST_TERMS:
            raise ValueError(
                f"degree: {n_z} columns make {terms} terms, more than {_MOST_TERMS}; lower degree, or use fewer "
                "features"
            )
        return terms

    def _scale(self, values: FloatArray, bounds: FloatArray) -> FloatArray:
        s = (values - bounds.mean(axis=1)) / (0.5 * np.diff(bounds)[:, 0])
        return np.clip(s, -1.0, 1.0) if self.outside == "clip" else s

    def _basis(self, z: FloatArray) -> FloatArray:
        """phi(x) kron varsigma(d), (N, m)."""
        s = self._scale(z, self._bounds())
        middle = z.shape[1] - self.n_d
        state, parameter = _tensor(s[:, :middle], self.degree), _tensor(s[:, middle:], self._degree_d)
        return (state[:, :, None] * parameter[:, None, :]).reshape(len(z), -1)

    def __repr__(self) -> str:
        options = f"degree={self.degree}, n_d={self.n_d}, degree_d={self.degree_d}"
        if self.Xi is None or self.bounds is None:
            return f"Chebyshev({options}, not fitted)"
        return f"Chebyshev({options}, {len(self.bounds)} -> {len(self.Xi)}, {self.Xi.size} parameters)"


def _tensor(s: FloatArray, degree: int) -> FloatArray:
    """Products of T_0 ... T_degree of the columns of s (N, k), the last column fastest: (N, (degree + 1)^k)."""
    product = np.ones((len(s), 1))
    for column in s.T:
        product = (product[:, :, None] * chebvander(column, degree)[:, None, :]).reshape(len(s), -1)
    return product


def _range(z: FloatArray) -> FloatArray:
    """Least and greatest value of each column; one around a column that does not vary."""
    least, greatest = z.min(axis=0), z.max(axis=0)
    constant = ~(greatest - least > 1e-12 * np.maximum(np.abs(least), np.abs(greatest)))
    half = np.maximum(1.0, np.abs(least))
    return np.column_stack(
        [np.where(constant, least - half, least), np.where(constant, least + half, greatest)]
    )
