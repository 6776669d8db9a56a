"""Adaptive law for the parameter vector of a Chebyshev model: what the motion says about the unknown d."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import get_lapack_funcs
from scipy.signal import lfilter

from .._sections import FloatArray
from .._signals import unmasked
from ..results import Result
from . import _arrays
from .chebyshev import Chebyshev

_BETWEEN = ("hold", "average")
# Numbers in the largest array of a chunk of the record (8 MB): memory does not grow with the record.
_CHUNK = 1 << 20


@dataclass(frozen=True, eq=False)
class AdaptationState:
    """What the adaptive law carries from one sample to the next.

    Attributes
    ----------
    varsigma : (q,) array
        Estimated basis of the unknown parameter.
    residual, regressor : (n_x,), (n_x, q) arrays
        Filtered x' - g and filtered Xi Phi(x).
    gram, moment : (q, q), (q,) arrays
        Fading mean of regressor' regressor and of regressor' residual: the memory of the composite law.
    x, g : (n_x,) arrays
        Signal and known dynamics at the sample before.
    Y : (n_x, q) array
        Xi Phi(x) at the sample before.
    """

    varsigma: FloatArray
    residual: FloatArray
    regressor: FloatArray
    gram: FloatArray
    moment: FloatArray
    x: FloatArray
    g: FloatArray
    Y: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class AdaptationRun(Result):
    """The adaptive law over a record.

    Attributes
    ----------
    f_theta : (N, n_x) array
        Xi Phi(x_k) varsigma_k, from data up to sample k.
    varsigma : (N, q) array
        Estimates varsigma_k.
    prediction_error : (N, n_x) array
        x_k - x_hat_k, where x_hat is the state predicted with the estimate of the sample before; in the unit of x.
    state : AdaptationState
        State after the last sample: where the next record goes on.
    """

    f_theta: FloatArray
    varsigma: FloatArray
    prediction_error: FloatArray
    state: AdaptationState


@dataclass(frozen=True, eq=False)
class AdaptiveChebyshev:
    """Adaptive law for varsigma in f_theta = Xi Phi(x) varsigma, driven by the error of a state prediction.

    The plant is x' = g + Y varsigma with Y = Xi Phi(x) known. With u_k = (x_k - x_{k-1})/h - mean of g, Ybar_k the
    mean of Y over the step and c = 1 - exp(-bandwidth h),

        W_k = W_{k-1} + c (Ybar_k - W_{k-1}),   r_k = r_{k-1} + c (u_k - r_{k-1})
        (1 + h leakage) varsigma_k + h Gamma G_k varsigma_k = varsigma_{k-1} + h Gamma m_k + h leakage prior

    Here r_k - W_k varsigma = (c/h) (x_k - x_hat_k), where x_hat is the state predicted with a constant varsigma,

        x_hat_k = x_hat_{k-1} + h (g + Ybar_k varsigma) + c (x_{k-1} - x_hat_{k-1})

    Gradient law: G_k = W_k' W_k, m_k = W_k' r_k. Composite law (``memory`` > 0): the means of W' W and W' r that
    fade with the time constant ``memory`` are added, so that motion past still counts. Gamma = gain I, but for a
    zero at T_0: that entry of varsigma(d) is 1 for every d.

    Parameters
    ----------
    model : Chebyshev
        A fitted model with n_d >= 1.
    dt : float
        Sampling time h, s.
    rate : float
        Speed of the adaptation, 1/s, for a regressor of the size of Xi: gain = rate q / |Xi|^2. Any value is stable.
    bandwidth : float
        Feedback of the state prediction, rad/s: above the motion that tells about d, below the noise on x.
    memory : float
        Time constant of the composite law, s; 0 for the gradient law.
    leakage : float
        Pull towards ``prior``, 1/s: bounds varsigma where disturbances outside the model meet poor excitation, at
        the price of a bias.
    prior : array_like, shape (q,), optional
        Estimate at the start; the basis at the middle of the bounds of d if None.
    adapt_constant : bool
        Whether the entry of T_0 is estimated too, for models whose f is scaled by something else than d.
    g : {"hold", "average"}
        How g goes on between samples: held by an actuator, or smooth. With "hold", ``run``, ``step`` and the block take
        the g that acts from this sample on: the state keeps it. So this ``step`` takes another g than
        :meth:`SampledPhyFilter.step`. With "average" all take g at this sample.

    Raises
    ------
    ValueError, TypeError
        If the model has not been fitted or has no d, or an option is out of range.

    Notes
    -----
    V = |varsigma_k - varsigma|^2 never rises where the model holds and leakage is 0: the step is the implicit Euler
    step of the gradient flow on |r - W varsigma|^2, (I + h gain G_k) tilde_k = tilde_{k-1} with G_k >= 0, for every
    h and gain. V falls exponentially where the mean of G over some time is positive definite (persistent
    excitation); without it varsigma stays bounded and W tilde goes to zero. Leakage makes the step a contraction
    by 1 / (1 + h leakage), so that a bounded disturbance leaves varsigma bounded. Continuous forms:
    J.-J. Slotine, W. Li, "Composite adaptive control of robot manipulators", Automatica 25(4), 1989;
    P. Ioannou, J. Sun, "Robust Adaptive Control", 1996, ch. 4. Paper: SEER-I's "converged adaptive law".

    Examples
    --------
    A drag whose coefficient is learned offline and recognised in flight:

    >>> rng = np.random.default_rng(0)
    >>> v, d = rng.uniform(-3.0, 3.0, 500), rng.uniform(0.0, 1.0, 500)
    >>> model = Chebyshev(2, degree_d=1).fit(np.column_stack([v, d]), (-d * v)[:, None]).model
    >>> x, g, h = np.zeros((4000, 1)), 2.0 * np.sin(0.01 * np.arange(4000.0))[:, None], 0.01
    >>> for k in range(1, 4000):
    ...     x[k] = x[k - 1] * np.exp(-0.7 * h) + g[k - 1] * -np.expm1(-0.7 * h) / 0.7
    >>> run = AdaptiveChebyshev(model, h, rate=20.0).run(x, x, g)
    >>> model.d_from_varsigma(run.varsigma[-1:]).round(2).tolist()
    [[0.7]]
    """

    model: Chebyshev
    dt: float
    _: KW_ONLY
    rate: float = 1.0
    bandwidth: float = 10.0
    memory: float = 0.0
    leakage: float = 0.0
    prior: FloatArray | None = None
    adapt_constant: bool = False
    g: Literal["hold", "average"] = "hold"

    def __post_init__(self) -> None:
        if self.model.Xi is None:
            raise ValueError("model: expected a fitted model; call fit(z, f) and use the model of its result")
        if self.model.n_d == 0:
            raise ValueError("model: expected an unknown parameter to adapt (n_d >= 1), got n_d = 0")
        for name in ("dt", "rate", "bandwidth"):
            _arrays.number(name, getattr(self, name), positive=True)
        for name in ("memory", "leakage"):
            _arrays.number(name, getattr(self, name))
        if self.g not in _BETWEEN:
            raise ValueError(f"g: expected one of {_BETWEEN}, got {self.g!r}")
        if not isinstance(self.adapt_constant, bool):
            raise TypeError(f"adapt_constant: expected True or False, got {self.adapt_constant!r}")
        if not np.any(self.model.Xi):
            raise ValueError("model: every coefficient is zero, so the motion says nothing about d")
        middle = self.model.varsigma(self._bounds_of_d().mean(axis=1)[None])[0]
        prior = middle if self.prior is None else self.prior
        object.__setattr__(self, "prior", _arrays.frozen("prior", prior, middle.shape))

    @property
    def gain(self) -> float:
        """Gain of the gradient: 1/s over the square of the unit of f."""
        assert self.model.Xi is not None
        return self.rate * len(self._prior) / float(np.sum(self.model.Xi**2))

    def start(self, z: ArrayLike, x: ArrayLike, g: ArrayLike | None = None) -> AdaptationState:
        """State at the first sample.

        Parameters
        ----------
        z : array_like, shape (n_z - n_d,)
            Features of the state.
        x, g : array_like, shape (n_x,)
            Measured signal and known dynamics; g is 0 if None.

        Raises
        ------
        ValueError, TypeError
            If a shape is wrong or a value is not finite.
        """
        return self._begin(*(a[0] for a in self._signals(*_as_rows(z, x, g))))

    def step(
        self, state: AdaptationState, z: ArrayLike, x: ArrayLike, g: ArrayLike | None = None
    ) -> tuple[AdaptationState, FloatArray]:
        """One sample on: the next state and f_theta (n_x,); ``state`` is left as it was.

        Parameters
        ----------
        state : AdaptationState
            From :meth:`start` or the step before.
        z, x, g : array_like
            As for :meth:`start`, at this sample; with ``g="hold"`` the g that acts from this sample on.

        Raises
        ------
        ValueError, TypeError
            If a shape is wrong or a value is not finite.
        """
        run = self.run(*_as_rows(z, x, g), state=state)
        return run.state, run.f_theta[0]

    def run(
        self, z: ArrayLike, x: ArrayLike, g: ArrayLike | None = None, *, state: AdaptationState | None = None
    ) -> AdaptationRun:
        """The law over a record, without a Python loop per sample; memory beyond the result does not grow with N.

        Parameters
        ----------
        z : array_like, shape (N, n_z - n_d)
            Features of the state.
        x, g : array_like, shape (N, n_x)
            Measured signal and known dynamics; g is 0 if None.
        state : AdaptationState, optional
            State at the sample before the first; if None the record starts with :meth:`start`.

        Raises
        ------
        ValueError, TypeError
            If a shape is wrong or a value is not finite.
        """
        Y, x, g = self._signals(z, x, g)
        n, (_, n_x, q) = len(x), Y.shape
        f_theta, error, varsigma = np.empty((n, n_x)), np.zeros((n, n_x)), np.empty((n, q))
        done = 0
        if state is None:
            state = self._begin(Y[0], x[0], g[0])
            f_theta[0], varsigma[0], done = Y[0] @ self._prior, self._prior, 1
        length = max(1, _CHUNK // (q * max(q, n_x)))
        for first in range(done, n, length):
            rows = slice(first, first + length)
            state, varsigma[rows], error[rows] = self._advance(state, Y[rows], x[rows], g[rows])
            f_theta[rows] = np.einsum("kij,kj->ki", Y[rows], varsigma[rows])
        return AdaptationRun(f_theta, varsigma, error, state)

    def _advance(
        self, state: AdaptationState, Y: FloatArray, x: FloatArray, g: FloatArray
    ) -> tuple[AdaptationState, FloatArray, FloatArray]:
        """Estimates and prediction errors over some samples."""
        h, c, q = self.dt, -np.expm1(-self.bandwidth * self.dt), len(self._prior)
        Y_before, x_before, g_before = (
            np.concatenate([before[None], after[:-1]])
            for before, after in ((state.Y, Y), (state.x, x), (state.g, g))
        )
        u = (x - x_before) / h - (g_before if self.g == "hold" else 0.5 * (g_before + g))
        W, r = _lag(0.5 * (Y_before + Y), c, state.regressor), _lag(u, c, state.residual)
        G, m = np.einsum("kia,kib->kab", W, W), np.einsum("kia,ki->ka", W, r)
        gram, moment = state.gram, state.moment
        if self.memory > 0.0:
            fading = -np.expm1(-h / self.memory)
            grams, moments = _lag(G, fading, gram), _lag(m, fading, moment)
            G, m, gram, moment = G + grams, m + moments, grams[-1], moments[-1]
        gain = np.full(q, h * self.gain)
        gain[0] *= self.adapt_constant
        implicit = np.linalg.inv((1.0 + h * self.leakage) * np.eye(q) + gain[:, None] * G)
        drive = np.einsum("kab,kb->ka", implicit, gain * m + h * self.leakage * self._prior)
        varsigma = _scan(implicit, drive, state.varsigma)
        a_priori = np.concatenate([state.varsigma[None], varsigma[:-1]])
        error = (h / c) * (r - np.einsum("kij,kj->ki", W, a_priori))
        return AdaptationState(varsigma[-1], r[-1], W[-1], gram, moment, x[-1], g[-1], Y[-1]), varsigma, error

    def _begin(self, Y: FloatArray, x: FloatArray, g: FloatArray) -> AdaptationState:
        n_x, q = Y.shape
        return AdaptationState(
            self._prior, np.zeros(n_x), np.zeros((n_x, q)), np.zeros((q, q)), np.zeros(q), x, g, Y
        )

    def _signals(
        self, z: ArrayLike, x: ArrayLike, g: ArrayLike | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Y, x and g of as many samples each."""
        assert self.model.Xi is not None
        assert self.model.bounds is not None
        z = _arrays.rows("z", z, len(self.model.bounds) - self.model.n_d)
        x = _arrays.rows("x", x, len(self.model.Xi))
        g = np.zeros_like(x) if g is None else _arrays.rows("g", g, x.shape[1])
        Y = self.model.regressor(z)
        if not len(Y) == len(x) == len(g):
            raise ValueError(
                f"z, x, g: expected the same number of rows, got {len(Y)}, {len(x)} and {len(g)}"
            )
        return Y, x, g

    def _bounds_of_d(self) -> FloatArray:
        assert self.model.bounds is not None
        return self.model.bounds[-self.model.n_d :]

    @property
    def _prior(self) -> FloatArray:
        assert self.prior is not None  # set in __post_init__
        return self.prior


def _as_rows(
    z: ArrayLike, x: ArrayLike, g: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike, ArrayLike | None]:
    """One sample as a record of one row."""
    row = [np.asarray(unmasked(part))[None] for part in (z, x)]
    return row[0], row[1], None if g is None else np.asarray(unmasked(g))[None]


def _lag(values: FloatArray, c: float, before: FloatArray) -> FloatArray:
    """y_k = y_{k-1} + c (v_k - y_{k-1}) along the first axis."""
    return lfilter([c], [1.0, c - 1.0], values, axis=0, zi=(1.0 - c) * before[None])[0]


def _scan(A: FloatArray, b: FloatArray, start: FloatArray) -> FloatArray:
    """w_k = A_k w_{k-1} + b_k for all k at once, as a banded triangular system.

    Parameters
    ----------
    A : (m, q, q) array
    b : (m, q) array
    start : (q,) array
    """
    m, q = b.shape
    right = b.copy()
    right[0] += A[0] @ start
    # Unknowns in the order (step, entry): entry (i, j) of step k couples row k q + i to column (k - 1) q + j.
    band = np.zeros((m, q, 2 * q))
    for i in range(q):
        for j in range(q):
            band[: m - 1, j, q + i - j] = -A[1:, i, j]
    (tbtrs,) = get_lapack_funcs(("tbtrs",), (band, right))
    solution, info = tbtrs(band.reshape(m * q, 2 * q).T, right.reshape(-1, 1), uplo="L", diag="U")
    assert info == 0  # a unit diagonal cannot be singular
    return solution.reshape(m, q)
