"""Koopman weights over a sliding window: one rank-one update and one downdate a sample."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._sections import FloatArray
from .._signals import LARGEST, unmasked
from ..results import Result
from . import _arrays
from .koopman import Koopman

# A downdate whose pivot is smaller than this loses more than a quarter of the digits: factorise instead.
_PIVOT = 1e-4
# A second refinement of W that is not this much smaller than the first shows that the inverse has gone stale, unless
# it is at the rounding of W already.
_SHRINK = 1e-4
_ROUNDING = 1e-11
# Gram matrices of a larger condition are not solved but factorised from their window, one by one.
_CONDITION = 1e12
# Numbers in the Gram matrices of a chunk of the record (8 MB).
_CHUNK = 1 << 20


@dataclass(frozen=True, eq=False)
class KoopmanState:
    """What the sliding window carries from one sample to the next.

    Attributes
    ----------
    lifted, rates : (window, m), (window, n_f) arrays
        psi and the rate of f that followed it, oldest first; zero where the window is not full yet.
    gram, cross, inverse : (m, m), (m, n_f), (m, m) arrays
        l2 window I + lifted' lifted, lifted' rates, and the inverse of the former.
    W : (m, n_f) array
        Weights.
    psi, f : (m,), (n_f,) arrays
        Dictionary and f at the last sample.
    age : int
        Steps since the last factorisation.
    """

    lifted: FloatArray
    rates: FloatArray
    gram: FloatArray
    cross: FloatArray
    inverse: FloatArray
    W: FloatArray
    psi: FloatArray
    f: FloatArray
    age: int


@dataclass(frozen=True, eq=False, repr=False)
class KoopmanRun(Result):
    """The sliding window over a record.

    Attributes
    ----------
    f_next : (N, n_f) array
        Prediction of f_{k+1} from samples up to k.
    rate : (N, n_f) array
        (f_next - f) / dt: the mean derivative of f_theta over the step to come.
    f_theta : (N, n_f) array
        Prediction of f_k from samples up to k - 1, for the filter; the given f at the first sample.
    model : Koopman
        Model with the weights after the last sample.
    """

    f_next: FloatArray
    rate: FloatArray
    f_theta: FloatArray
    model: Koopman


@dataclass(frozen=True, eq=False)
class OnlineKoopman:
    """Online extended dynamic mode decomposition over the latest samples.

    The weights minimise

        sum over the window of |(f_k - f_{k-1}) / dt - W' psi(z_{k-1})|^2 + l2 window |W|^2

    :meth:`step` carries the inverse of the Gram matrix on by the matrix inversion lemma (the newest pair in, the
    oldest out) and refines W against the Gram matrix itself, so that errors of the inverse do not add up. Every
    ``refresh`` steps, where a downdate would lose digits, and where the refinement does not converge, all is
    factorised anew from the window.
    :meth:`run` does a whole record at once, by sums.

    Parameters
    ----------
    model : Koopman
        Dictionary, n_f, dt and l2; its weights are not used. l2 > 0 keeps the first steps determined.
    window : int
        Number of pairs of samples the weights are fitted to.
    refresh : int, optional
        Most steps between two factorisations; the window if None.

    Raises
    ------
    ValueError, TypeError
        If ``window`` or ``refresh`` is below 1, or l2 is 0.

    Notes
    -----
    H. Zhang, C. W. Rowley, E. A. Deem, L. N. Cattafesta, "Online dynamic mode decomposition for time-varying
    systems", SIAM J. Appl. Dyn. Syst. 18(3), 2019. Paper, supplement "Koopman operator-based uncertainty
    observer" (EVOLVER).

    Examples
    --------
    >>> from phyfilter_ctl.learned import Dictionary
    >>> f = np.cos(0.03 * np.arange(400.0)[:, None] - [0.0, 1.0])
    >>> online = OnlineKoopman(Koopman(Dictionary(2, degree=1), 2, dt=0.01, l2=1e-12), 50)
    >>> run = online.run(f)
    >>> bool(np.max(np.abs(run.f_theta[60:] - f[60:])) < 1e-6)
    True
    """

    model: Koopman
    window: int
    _: KW_ONLY
    refresh: int | None = None

    def __post_init__(self) -> None:
        _signals.count("window", self.window)
        if self.refresh is not None:
            _signals.count("refresh", self.refresh)
        if self.model.l2 == 0.0:
            raise ValueError(
                "l2: expected a number > 0 for a sliding window, whose first steps determine nothing"
            )

    def start(self, z: ArrayLike) -> KoopmanState:
        """State at the first sample z = (f, x, d) (n_z,): an empty window, W = 0.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (n_z,).
        """
        psi, f = self._lift(z)
        m, n_f, ridge = len(psi), self.model.n_f, self.model.l2 * self.window
        zero = np.zeros((m, n_f))
        empty = np.zeros((self.window, m)), np.zeros((self.window, n_f))
        return KoopmanState(*empty, ridge * np.eye(m), zero, np.eye(m) / ridge, zero, psi, f, 0)

    def step(self, state: KoopmanState, z: ArrayLike) -> tuple[KoopmanState, FloatArray]:
        """One sample on: the next state and f_theta (n_f,) one sample ahead; ``state`` is left as it was.

        Parameters
        ----------
        state : KoopmanState
            From :meth:`start` or the step before.
        z : array_like, shape (n_z,)
            (f, x, d) at this sample.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (n_z,).
        """
        psi, f = self._lift(z)
        rate = (f - state.f) / self.model.dt
        lifted = np.concatenate([state.lifted[1:], state.psi[None]])
        rates = np.concatenate([state.rates[1:], rate[None]])
        solved, age = None, state.age + 1
        if age < (self.refresh or self.window):
            solved = _updated(state, rate)
        if solved is None:
            solved, age = _factorised(lifted, rates, self.model.l2 * self.window), 0
        gram, cross, inverse, W = solved
        f_next = f + self.model.dt * (psi @ W)
        return KoopmanState(lifted, rates, gram, cross, inverse, W, psi, f, age), f_next

    def model_at(self, state: KoopmanState) -> Koopman:
        """The model with the weights of ``state``."""
        return replace(self.model, W=state.W)

    def run(self, z: ArrayLike) -> KoopmanRun:
        """The window over a record z = (f, x, d) (N, n_z), without a Python loop per sample.

        The Gram matrices are summed up from the window afresh in every chunk, and inverted directly: the same
        weights as :meth:`step` by another route. Only windows that hardly determine the weights (a Gram matrix of
        condition above 1e12) are taken one by one. Costs N m^3 operations; memory beyond the result does not grow
        with N.

        Raises
        ------
        ValueError, TypeError
            If ``z`` is not a finite real array of shape (N, n_z).
        """
        z = _arrays.rows("z", z, self.model.dictionary.n_z)
        n, m, n_f = len(z), self.model.dictionary.size, self.model.n_f
        slopes, W = np.zeros((n, n_f)), np.zeros((m, n_f))
        lifted, rates = np.zeros((self.window, m)), np.zeros((self.window, n_f))
        length = max(1, min(_CHUNK // m**2, max(self.window, 256)))
        for first in range(1, n, length):
            rows = slice(first, min(first + length, n))
            psi = self._lifted(z[first - 1 : rows.stop])
            lifted = np.vstack([lifted, psi[:-1]])
            rates = np.vstack([rates, np.diff(z[first - 1 : rows.stop, :n_f], axis=0) / self.model.dt])
            weights = self._weights(lifted, rates)
            slopes[rows] = np.einsum("ka,kaf->kf", psi[1:], weights)
            lifted, rates, W = lifted[-self.window :], rates[-self.window :], weights[-1]
        f_next = z[:, :n_f] + self.model.dt * slopes
        return KoopmanRun(f_next, slopes, np.vstack([z[:1, :n_f], f_next[:-1]]), replace(self.model, W=W))

    def _weights(self, lifted: FloatArray, rates: FloatArray) -> FloatArray:
        """W (steps, m, n_f) of every window of ``window`` rows but the first."""
        joined = np.hstack([lifted, rates])
        old, new = joined[: -self.window], joined[self.window :]
        m = lifted.shape[1]
        change = new[:, :m, None] * new[:, None] - old[:, :m, None] * old[:, None]
        change[0] += lifted[: self.window].T @ joined[: self.window]
        sums = np.cumsum(change, axis=0)
        ridge = self.model.l2 * self.window
        gram, cross = sums[:, :, :m] + ridge * np.eye(m), sums[:, :, m:]
        try:
            inverse = np.linalg.inv(gram)
        except np.linalg.LinAlgError:
            inverse = np.full_like(gram, np.inf)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is done again below
            weights = inverse @ cross
            weights += inverse @ (cross - gram @ weights)
            condition = np.abs(gram).sum(axis=1).max(axis=1) * np.abs(inverse).sum(axis=1).max(axis=1)
        for k in np.flatnonzero(~(condition < _CONDITION)):
            window = slice(k + 1, k + 1 + self.window)
            weights[k] = _factorised(lifted[window], rates[window], ridge)[3]
        return weights.astype(float, copy=False)

    def _lift(self, z: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """psi and f of one sample."""
        row = _arrays.rows("z", np.asarray(unmasked(z))[None], self.model.dictionary.n_z)
        return self._lifted(row)[0], row[0, : self.model.n_f]

    def _lifted(self, z: FloatArray) -> FloatArray:
        """psi, refused where its square overflows: the window would be lost for good."""
        with np.errstate(over="ignore", invalid="ignore"):
            psi = self.model.dictionary(z)
        if not np.max(np.abs(psi)) <= LARGEST:
            raise ValueError(
                "z: the dictionary overflows; scale it with Dictionary.scaled_to(z), or lower degree"
            )
        return psi


_Solution = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # Gram matrix, right side, inverse, weights


def _factorised(lifted: FloatArray, rates: FloatArray, ridge: float) -> _Solution:
    """From the window itself, by singular values: the condition of the window is not squared."""
    m = lifted.shape[1]
    augmented = np.vstack([lifted, np.sqrt(ridge) * np.eye(m)])
    right = np.vstack([rates, np.zeros((m, rates.shape[1]))])
    left, s, V = np.linalg.svd(augmented, full_matrices=False)
    s = np.maximum(s, np.finfo(float).eps * s[0])  # what rounding leaves of the ridge beside large values
    return augmented.T @ augmented, lifted.T @ rates, (V.T / s**2) @ V, (V.T / s) @ (left.T @ right)


def _updated(state: KoopmanState, rate: FloatArray) -> _Solution | None:
    """The newest pair in, the oldest out, and two steps of refinement; None where that would lose digits."""
    U, sign = np.column_stack([state.psi, state.lifted[0]]), np.array([1.0, -1.0])
    gram = state.gram + (U * sign) @ U.T
    cross = state.cross + (U * sign) @ np.vstack([rate, state.rates[0]])
    PU = state.inverse @ U
    core = np.diag(sign) + U.T @ PU
    pivot = -np.linalg.det(core) / core[0, 0]  # 1 - old' P old after the newest pair is in
    if not pivot > _PIVOT:
        return None
    inverse = state.inverse - PU @ np.linalg.solve(core, PU.T)
    inverse = 0.5 * (inverse + inverse.T)
    first = inverse @ (cross - gram @ state.W)
    second = inverse @ (cross - gram @ (state.W + first))
    W = state.W + first + second
    # Measured in W: a residual hides what is wrong in directions that the window hardly excites.
    allowed = _SHRINK * float(np.max(np.abs(first))) + _ROUNDING * float(np.max(np.abs(W)))
    sound = bool(np.max(np.abs(second)) <= allowed)  # false too where it is not a number
    return (gram, cross, inverse, W) if sound else None
