"""One step of the sampled filter, written once, and the numbers it takes.

    u = E^+ (M dx / h - g) - f_theta                    (means over the step)
    w <- w + dA (w - equilibrium u)
    f_hat = f_theta + C w

``residual``, ``advance`` and ``output`` take numbers of any kind: arrays with any leading axes (many systems at once),
or CasADi scalars in object arrays. :class:`Recursion` has the transitions of a bank of filters for steps of any length.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _sections, _signals
from .._sections import ComplexArray, FloatArray
from .blocked import BlockKernel
from .sampling import Method, Rule, Sampling

__all__ = [
    "GAP_ROUNDING",
    "Chain",
    "Recursion",
    "StepConstants",
    "advance",
    "applied",
    "increment",
    "mean",
    "momentum",
    "output",
    "residual",
    "transition",
]

Array = NDArray[np.floating]

# Steps near the nominal one by a Taylor series of |A d| <= 0.5: the first power left out is 0.5**17 / 17! = 2e-20.
_SERIES_NORM = 0.5
_POWERS = np.arange(17.0)

_LONGEST_GAP = 20.0  # nominal steps
_BELOW_STABLE = 1.0 - 1e-5  # of the longest step that is stable: GAP_ROUNDING beyond it still is
GAP_ROUNDING = 1.0 + 1e-6  # times are sums of steps


class StepConstants(NamedTuple):
    """What one step needs, in the arithmetic of the filter.

    Attributes
    ----------
    dA : (n, n) or (n_f, n, n) array
        Transposed for a filter that all channels share; one for each channel.
    equilibrium, C : (n,) or (n_f, n) arrays
    rate : float
        1/h.
    """

    dA: Array
    equilibrium: Array
    C: Array
    rate: np.floating


def transition(A: FloatArray, method: Method, dt: float | FloatArray) -> FloatArray:
    """The increment of w' = A w over a step of dt: e^(A dt) - I (exact, matched), A dt or the trapezoidal rule of it.

    Shape (n, n); for steps (m,) shape (m, n, n).
    """
    if method in ("exact", "matched"):
        return _sections.expm1(A, dt)
    scaled = A * np.asarray(dt)[..., None, None]
    if method == "euler":
        return scaled
    return np.asarray(np.linalg.solve(np.eye(len(A)) - 0.5 * scaled, scaled), dtype=float)


def momentum(M: Array, dx: Array) -> Array:
    """M dx for a diagonal M (..., n_x) or a full one (..., n_x, n_x), dx (..., n_x)."""
    return M * dx if M.ndim <= dx.ndim else (M @ dx[..., None])[..., 0]


def mean(rule: Rule, first: Array, last: Array) -> Array:
    """Mean over a step of a signal that keeps its first value, or runs straight from it to the last."""
    return first if rule == "hold" else (first + last) * 0.5


def residual(slope: Array, g: Array, f_theta: Array, into: Array | None) -> Array:
    """u (..., n_f) from the slope M dx / h (..., n_x), which is used up; ``into`` (n_x, n_f) is E^+ transposed."""
    slope -= g
    u = slope if into is None else slope @ into
    u -= f_theta
    return u


def increment(w: Array, u: Array, constants: StepConstants, carry: Array | None = None) -> Array:
    """dA (w + carry - equilibrium u) for states (..., n_f, n)."""
    rest = constants.equilibrium
    distance = w - (np.multiply.outer(u, rest) if rest.ndim == 1 else u[..., None] * rest)
    if carry is not None:
        distance += carry
    return applied(constants.dA, distance)


def applied(dA: Array, states: Array) -> Array:
    """dA of :class:`StepConstants` times the states (..., n_f, n) of each channel."""
    if dA.ndim == 2:
        return states.dot(dA) if states.ndim == 2 else states @ dA  # dot: half the time of a small product
    return (dA @ states[..., None])[..., 0]


def advance(w: Array, carry: Array | None, u: Array, constants: StepConstants) -> tuple[Array, Array | None]:
    """w + increment, with Kahan's compensation where there is a carry."""
    change = increment(w, u, constants, carry)
    if carry is None:
        return w + change, None
    change += carry
    after = w + change
    # Two-sum: what the addition rounded away, whichever of the two was larger.
    taken = after - w
    return after, (w - (after - taken)) + (change - taken)


def output(w: Array, carry: Array | None, C: Array) -> Array:
    """C w of each channel."""
    total = w if carry is None else w + carry
    if C.ndim == 1:
        return total.dot(C) if total.ndim == 2 else total @ C
    return (total * C).sum(axis=-1)


class Chain(NamedTuple):
    """One filter as its chain of sections.

    Attributes
    ----------
    poles : (n,) complex array
    A : (n, n) array
    equilibrium, C : (n,) arrays
        As in ``PhyFilter.sections``.
    """

    poles: ComplexArray
    A: FloatArray
    equilibrium: FloatArray
    C: FloatArray


@dataclass(frozen=True, init=False, eq=False)
class Recursion:
    """The numbers and rules that records, loops, blocks and C code run on.

    Parameters
    ----------
    chains : tuple of Chain
        One for all channels, or one per channel.
    sampling : Sampling

    Raises
    ------
    ValueError
        If the numbers of chains, columns of E and limits contradict each other, or forward
        Euler diverges.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> ((dA, equilibrium, C),) = PhyFilter([20.0]).sampled(0.05).recursion.transitions
    >>> dA.round(6).tolist(), equilibrium.tolist(), C.tolist()
    ([[-0.632121]], [1.0], [1.0])
    """

    chains: tuple[Chain, ...]
    sampling: Sampling

    def __init__(self, chains: tuple[Chain, ...], sampling: Sampling) -> None:
        object.__setattr__(self, "chains", chains)
        object.__setattr__(self, "sampling", sampling)
        count, limit, ends = len(chains), sampling.limit, sampling.g_limit
        if self.E is not None and count not in (1, self.E.shape[1]):
            raise ValueError(
                f"{count} filters for the {self.E.shape[1]} columns of E: expected one, or one per column"
            )
        known = count if count > 1 else None if self.E is None else self.E.shape[1]
        if limit is not None and limit.ndim == 1 and len(limit) != (known or len(limit)):
            raise ValueError(
                f"limit: {len(limit)} bounds for {known} channels; expected one number or {known}"
            )
        n_x = len(self.E) if self.E is not None else known
        if n_x is not None:
            _check_ends(ends, n_x)
            sampling.check_channels(n_x)
        self.check_step(sampling.dt)

    # -- channels -----------------------------------------------------------------------------------------------

    @property
    def order(self) -> int:
        """Largest order of the filters."""
        return max(len(chain.C) for chain in self.chains)

    def channels(self, n_x: int) -> int:
        """Number n_f of channels of f for a state of n_x.

        Parameters
        ----------
        n_x : int

        Raises
        ------
        ValueError
            If it contradicts the channels of the sampling, E, the filters or the limit.
        """
        self.sampling.check_channels(n_x)
        n_f, limit = n_x, self.sampling.limit
        if self.E is not None:
            if len(self.E) != n_x:
                raise ValueError(f"x has {n_x} channels but E has {len(self.E)} rows: expected as many")
            n_f = self.E.shape[1]
        if len(self.chains) not in (1, n_f):
            raise ValueError(
                f"{len(self.chains)} filters for {n_f} channels: expected one, or one per channel"
            )
        if limit is not None and limit.ndim == 1 and len(limit) != n_f:
            raise ValueError(f"limit: {len(limit)} bounds for {n_f} channels; expected one number or {n_f}")
        _check_ends(self.sampling.g_limit, n_x)
        return n_f

    @property
    def E(self) -> FloatArray | None:
        """Direction in which f acts, (n_x, n_f), as ``sampling`` has it."""
        return self.sampling.E

    @cached_property
    def E_left(self) -> FloatArray | None:
        """Left inverse of E, (n_f, n_x): what the residual of M x' says of f. None without E."""
        return None if self.E is None else np.asarray(np.linalg.pinv(self.E), dtype=float)

    @cached_property
    def into(self) -> Array | None:
        """``E_left`` transposed, in the arithmetic of the filter, as ``residual`` takes it."""
        return None if self.E_left is None else self.E_left.T.astype(self.sampling.precision)

    def limited(self, f_hat: Array, out: Array | None = None) -> Array:
        """f_hat within its bounds.

        Parameters
        ----------
        f_hat : (..., n_f) array
        out : (..., n_f) array, optional
            Where to put it; by default a new array, where there is a limit.
        """
        if self.sampling.limit is None:
            return f_hat
        limit = self.sampling.limit.astype(f_hat.dtype)
        return np.clip(f_hat, -limit, limit, out=out)

    def acting(self, g: Array) -> Array:
        """What acts of g within its limits; entries that are not usable stay as they are.

        Parameters
        ----------
        g : (..., n_x) array
        """
        if self.sampling.g_limit is None:
            return g
        low, high = self.sampling.g_limit.astype(g.dtype)
        within = np.clip(g, low, high)
        return within if _signals.usable(g) else np.where(_signals.unusable(g), g, within)

    # -- transitions --------------------------------------------------------------------------------------------

    @property
    def transitions(self) -> tuple[tuple[FloatArray, FloatArray, FloatArray], ...]:
        """(dA (n, n), equilibrium (n,), C (n,)) of each filter at the nominal step, rounded to the precision."""
        bank = zip(self.chains, *self.bank, strict=True)
        return tuple((dA[:n, :n], rest[:n], C[:n]) for chain, dA, rest, C in bank if (n := len(chain.C)))

    def at(self, dt: float | FloatArray, i: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dA, equilibrium and C of a filter, padded to the largest order, for a step of any length.

        Parameters
        ----------
        dt : float or (m,) array
            Steps give dA (m, n, n).
        i : int
            Which filter.
        """
        _, A, equilibrium, C = self.chains[i]
        dA = transition(A, self.sampling.method, dt)
        extra = self.order - len(C)
        if extra:
            dA = np.pad(dA, [(0, 0)] * (dA.ndim - 2) + [(0, extra), (0, extra)])
            equilibrium, C = np.pad(equilibrium, (0, extra)), np.pad(C, (0, extra))
        return self._rounded(dA), self._rounded(equilibrium), self._rounded(C)

    @cached_property
    def bank(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """dA (c, n, n), equilibrium (c, n) and C (c, n) of all filters at the nominal step."""
        return self._all_at(self.sampling.dt)

    def _all_at(self, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        dA, equilibrium, C = zip(*[self.at(dt, i) for i in range(len(self.chains))], strict=True)
        return np.stack(dA), np.stack(equilibrium), np.stack(C)

    @cached_property
    def _kernels(self) -> tuple[BlockKernel, ...]:
        """For records of equal steps: one block kernel per filter."""
        return tuple(BlockKernel.build(*parts) for parts in zip(*self.bank, strict=True))

    @cached_property
    def nominal(self) -> StepConstants:
        """What a nominal step needs."""
        return self._constants(self.sampling.dt, self.bank)

    def step(self, dt: float) -> StepConstants:
        """What a step of any length needs.

        Parameters
        ----------
        dt : float
        """
        nominal, distance = self.nominal, dt - self.sampling.dt
        if not distance:
            return nominal
        reach, terms = self._nearby
        if not abs(distance) <= reach:
            return self._constants(dt, self._all_at(dt))
        dA = ((distance / reach) ** _POWERS).dot(terms).reshape(nominal.dA.shape)
        kind = nominal.dA.dtype
        return StepConstants(
            dA if kind == np.float64 else dA.astype(kind), nominal.equilibrium, nominal.C, kind.type(1.0 / dt)
        )

    @cached_property
    def _nearby(self) -> tuple[float, FloatArray]:
        """For steps h + d, |d| <= reach: dA is the sum of terms[k] (d / reach)^k, laid out as ``StepConstants`` has it.

        The series of e^(A h) e^(A d) - I, in which nothing is subtracted from I; a step that jitters costs one product.
        """
        n, h = self.order, self.sampling.dt
        if self.sampling.method == "tustin":
            return -1.0, np.empty((0, 0))
        norms = [float(np.linalg.norm(chain.A, np.inf)) for chain in self.chains]
        reach = _SERIES_NORM / max(norms)
        terms = np.zeros((len(_POWERS), len(self.chains), n, n))
        for i, chain in enumerate(self.chains):
            inner = slice(0, len(chain.C))
            dA = transition(chain.A, self.sampling.method, h)
            terms[0, i, inner, inner] = dA
            term = np.eye(len(dA)) if self.sampling.method == "euler" else np.eye(len(dA)) + dA
            for k in range(1, 2 if self.sampling.method == "euler" else len(_POWERS)):
                term = term @ chain.A * (reach / k)
                terms[k, i, inner, inner] = term
        if len(self.chains) == 1:
            terms = terms.swapaxes(-1, -2)
        return reach, np.ascontiguousarray(terms.reshape(len(_POWERS), -1))

    def _constants(self, dt: float, bank: tuple[FloatArray, FloatArray, FloatArray]) -> StepConstants:
        precision = self.sampling.precision
        dA, equilibrium, C = (part.astype(precision) for part in bank)
        rate = np.dtype(precision).type(1.0 / dt)
        if len(self.chains) == 1:
            return StepConstants(np.ascontiguousarray(dA[0].T), equilibrium[0], C[0], rate)
        return StepConstants(dA, equilibrium, C, rate)

    @property
    def slowest(self) -> float:
        """Least |p| of all poles in rad/s."""
        return min(float(np.min(np.abs(chain.poles))) for chain in self.chains)

    @cached_property
    def longest_gap(self) -> float:
        """Seconds between two good samples up to which they make one step.

        20 nominal steps; with forward Euler no more than are stable as one step.
        """
        dt = self.sampling.dt
        return max(2.0 * dt, min(_LONGEST_GAP * dt, _BELOW_STABLE * self.stable_step))

    @cached_property
    def stable_step(self) -> float:
        """Seconds below which a step is stable: infinite but for forward Euler, |1 + p h| < 1."""
        if self.sampling.method != "euler":
            return float("inf")
        poles = np.concatenate([chain.poles for chain in self.chains])
        return float(np.min(-2.0 * poles.real / np.abs(poles) ** 2))

    def is_gap(self, length: ArrayLike) -> NDArray[np.bool_]:
        """Whether the filter starts again after so many seconds without a good sample, ``longest_gap`` or more.

        Parameters
        ----------
        length : float or (m,) array
        """
        return np.asarray(length) > self.longest_gap * GAP_ROUNDING

    def check_step(self, dt: float) -> None:
        """Refuse a step at which forward Euler would diverge, |1 + p h| >= 1.

        Parameters
        ----------
        dt : float

        Raises
        ------
        ValueError
            Naming the pole and the largest step.
        """
        for chain in self.chains if self.sampling.method == "euler" else ():
            growth = np.abs(1.0 + chain.poles * dt)
            worst = int(np.argmax(growth))
            if growth[worst] >= 1.0:
                raise ValueError(
                    f"forward Euler diverges: |1 + p h| = {growth[worst]:.4g} >= 1 for the pole "
                    f"{chain.poles[worst]:.6g} rad/s at h = {dt:g} s; expected h < {self.stable_step:.4g} s; "
                    "use method='exact'"
                )

    def _rounded(self, values: FloatArray) -> FloatArray:
        return values.astype(self.sampling.precision).astype(float)


def _check_ends(ends: FloatArray | None, n_x: int) -> None:
    if ends is not None and ends.ndim > 1 and ends.shape[1] != n_x:
        raise ValueError(
            f"g_limit: {ends.shape[1]} pairs for {n_x} channels of g; expected one pair of numbers or {n_x}"
        )
