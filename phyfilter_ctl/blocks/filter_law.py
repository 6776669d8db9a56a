"""A sampled PhyFilter as the law of a sampled block: its recursion as CasADi functions of states, inputs and time.

It is ``sampled.loop`` on a grid of equal steps, started by itself: at the first instant f_hat = f_theta and the filter
remembers what it was given; every option acts as there. Two things are arranged otherwise, with the same result:

* Means over a (delayed) step are fixed weights of the present sample and of those before it, kept in registers.
* Where samples may be held (``nonfinite="hold"``), the residual of the longer step is only known when the gap ends. The
  recursion is linear in it, so the free motions of the state and of the equilibrium, (e^{At} - I) w and
  (e^{At} - I) equilibrium, are carried along meanwhile, and a gap may last as long as it likes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag

from .._sections import FloatArray
from ..filter import SampledPhyFilter, windows
from .functions import BlockFunctions, Variable

__all__ = ["filter_inputs", "filter_law"]

_LARGEST = float(np.finfo(float).max)


def filter_law(
    sampled: SampledPhyFilter, channels: int, *, inertia: FloatArray | str | None = None
) -> BlockFunctions:
    """The recursion of a sampled filter as a law: (t, s, v, q) -> f_hat and (t, s, v, q) -> the next s.

    Parameters
    ----------
    sampled : SampledPhyFilter
        ``precision="float32"`` rounds the coefficients; the law computes
        in double. ``nonfinite="raise"`` cannot raise here: a sample that is not finite shows in f_hat from then on.
    channels : int
        Number n_x of channels of x.
    inertia : (n_x,) or (n_x, n_x) array, {"scalar", "diagonal", "full"} or None
        Constant inertia; or which kind of inertia is an input; or None for I.

    Returns
    -------
    BlockFunctions
        Inputs x[i], g[i], f_theta[i] and M, outputs f_hat[i], no parameters. With ``g="hold"`` the filter uses the g of
        the instant before, so g does not act on f_hat without delay.

    Raises
    ------
    ValueError
        For numbers of channels that contradict each other.

    Notes
    -----
    State w[i,j] is that of section j of channel i. The others are what the filter remembers: the x it last accepted, g
    and f_theta of the instant before (g_1, f_theta_1 of the one before that, as far as a delay reaches back), and the
    inertia. ``started`` and ``accepted`` tell the first instant, and the first good sample.

    Examples
    --------
    >>> from phyfilter_ctl import PhyFilter
    >>> law = filter_law(PhyFilter([20.0]).sampled(0.002), 1)
    >>> [entry.name for entry in law.states]
    ['started', 'w[0,0]', 'g[0]', 'f_theta[0]', 'x[0]']
    >>> law.feedthrough.tolist()
    [[True, False, True]]
    """
    n_f = sampled.recursion.channels(channels)
    inputs = filter_inputs(channels, n_f, inertia)
    v = ca.SX.sym("v", len(inputs))
    x, g, f_theta, M = _split(v, [channels, channels, n_f, len(inputs) - 2 * channels - n_f])
    bank = _Bank.of(sampled, n_f)
    memory = _Memory(guarded=sampled.sampling.nonfinite == "hold")
    w = memory.state(bank.labels)
    memory.becomes(memory.started, ca.SX(1))

    acting, weights_g = g, windows.mean_weights(sampled.sampling.g, sampled.sampling.delay_steps)
    if sampled.sampling.g == "hold":  # over the step that ends now the g of the instant before acted
        acting, weights_g = memory.state(_labels("g", channels)), weights_g[1:]
        memory.becomes(acting, g)
    weights_f = windows.mean_weights(sampled.sampling.f_theta, sampled.sampling.delay_steps)
    weights_M = windows.mean_weights("hold", sampled.sampling.delay_steps)[1:]  # its value at one time
    _, g_mean = memory.signal("g", acting, weights_g, first=g, age=int(sampled.sampling.g == "hold"))
    f_now, f_mean = memory.signal("f_theta", f_theta, weights_f, first=f_theta)
    M_filled, M_now = memory.signal("M", M, weights_M, first=M, start=1.0)
    known = ca.mtimes(_measure(sampled, channels), g_mean) + f_mean

    x_before, M_before = memory.state(_labels("x", channels)), memory.state(_labels("M_before", M.shape[0]))
    moved = _times_inertia(inertia, 0.5 * (M_before + M_now), x - x_before)
    moved = ca.mtimes(_measure(sampled, channels), moved)
    if memory.guarded:
        same = _all_finite(x, f_theta, M)
        good = ca.logic_and(same, _all_finite(acting))
        keep = ca.if_else(memory.started, good, ca.logic_and(same, _all_finite(g)))
        accepted = memory.state(["accepted"])
        memory.becomes(accepted, ca.logic_or(accepted, keep))
        update = ca.logic_and(accepted, good)
        change = _longer_step(
            memory, bank, w, moved, known, holding=ca.logic_and(accepted, ca.logic_not(good))
        )
    else:
        keep, update = ca.SX(1), memory.started
        change = bank.advance(w - bank.equilibrium * bank.spread(moved / sampled.dt - known))
    memory.becomes(x_before, ca.if_else(keep, x, x_before))
    M_then = ca.if_else(memory.started, M_now, M_filled)  # before the first instant it was what it is then
    memory.becomes(M_before, ca.if_else(keep, M_then, M_before))
    w_next = w + ca.if_else(update, change, 0.0)
    memory.becomes(w, w_next)
    f_hat = f_now + ca.if_else(update, ca.mtimes(bank.C, w_next), 0.0)
    if sampled.sampling.limit is not None:
        f_hat = ca.fmin(ca.fmax(f_hat, -ca.DM(sampled.sampling.limit)), ca.DM(sampled.sampling.limit))

    arguments = [ca.SX.sym("t"), memory.vector, v, ca.SX.sym("q", 0)]
    return BlockFunctions(
        memory.variables,
        inputs,
        tuple(Variable(label) for label in _labels("f_hat", n_f)),
        (),
        ca.Function("dynamics", arguments, [ca.densify(memory.next_vector)]),
        ca.Function("output", arguments, [ca.densify(f_hat)]),
    )


def filter_inputs(n_x: int, n_f: int, inertia: FloatArray | str | None) -> tuple[Variable, ...]:
    """Inputs of a sampled filter: x, g, f_theta and, where it is one, the inertia with I as its default."""
    labels = [*_labels("x", n_x), *_labels("g", n_x), *_labels("f_theta", n_f)]
    inputs = [Variable(label) for label in labels]
    if isinstance(inertia, str) and inertia == "full":
        inputs += [Variable(f"M[{i},{j}]", float(i == j)) for i in range(n_x) for j in range(n_x)]
    elif isinstance(inertia, str):
        inputs += [Variable(label, 1.0) for label in _labels("M", 1 if inertia == "scalar" else n_x)]
    return tuple(inputs)


class _Memory:
    """The states of a law while it is written down: their names, their starts and what they become."""

    def __init__(self, guarded: bool) -> None:
        self.guarded = guarded
        self._variables: list[Variable] = []
        self._symbols: list[ca.SX] = []
        self._next: list[ca.SX] = []
        self.started = self.state(["started"])

    def state(self, names: Sequence[str], start: float = 0.0) -> ca.SX:
        """A new state; say with :meth:`becomes` what it becomes."""
        symbol = ca.SX.sym(names[0] if names else "none", len(names))
        self._variables += [Variable(name, start) for name in names]
        self._symbols.append(symbol)
        self._next.append(symbol)
        return symbol

    def becomes(self, symbol: ca.SX, value: ca.SX) -> None:
        self._next[next(i for i, known in enumerate(self._symbols) if known is symbol)] = value

    def signal(
        self,
        name: str,
        now: ca.SX,
        weights: NDArray[np.floating],
        *,
        first: ca.SX,
        age: int = 0,
        start: float = 0.0,
    ) -> tuple[ca.SX, ca.SX]:
        """A signal with bad entries filled by the last good ones, and its weighted mean with the samples before.

        Before the first instant it was what it is then, ``first``. ``age``: how many instants back it is kept from.
        """
        size = now.shape[0]
        count = max(len(weights) - 1, int(self.guarded)) if size else 0
        past = [
            self.state(_labels(f"{name}_{age + j}" if age + j else name, size), start) for j in range(count)
        ]
        if self.guarded and size:
            now, first = _where_finite(now, past[0]), _where_finite(first, ca.SX(start))
        for register, newer in zip(past, [now, *past], strict=False):
            self.becomes(register, ca.if_else(self.started, newer, first))
        mean = ca.SX.zeros(size)
        for weight, value in zip(weights, [now, *past], strict=False):
            mean += float(weight) * value if weight else 0.0
        return now, mean

    @property
    def variables(self) -> tuple[Variable, ...]:
        return tuple(self._variables)

    @property
    def vector(self) -> ca.SX:
        return ca.vertcat(*self._symbols)

    @property
    def next_vector(self) -> ca.SX:
        return ca.vertcat(*self._next)


class _Bank(NamedTuple):
    """The chains of sections of all channels as one system, for a nominal step."""

    sampled: SampledPhyFilter
    chains: tuple[FloatArray, ...]  # A of each channel
    dA: ca.DM
    equilibrium: ca.DM
    C: ca.DM
    labels: list[str]

    @staticmethod
    def of(sampled: SampledPhyFilter, n_f: int) -> _Bank:
        filters = sampled.filters * n_f if len(sampled.filters) == 1 else sampled.filters
        dA, equilibrium, C = zip(*sampled.with_filter(filters).recursion.transitions, strict=True)
        return _Bank(
            sampled,
            tuple(entry.sections[0] for entry in filters),
            _sparse(_diagonal(*dA)),
            ca.DM(np.concatenate(equilibrium)),
            _sparse(_diagonal(*[row[None, :] for row in C])),
            [f"w[{i},{j}]" for i, entry in enumerate(filters) for j in range(entry.order)],
        )

    def spread(self, u: ca.SX) -> ca.SX:
        """The input of each channel for each of its states."""
        return ca.vertcat(*[ca.repmat(u[i], len(A)) for i, A in enumerate(self.chains)])

    def advance(self, distance: ca.SX) -> ca.SX:
        return ca.mtimes(self.dA, distance)

    def tustin(self, steps: ca.SX, distance: ca.SX) -> ca.SX:
        """(I - A h/2)^-1 A h distance for h = steps dt, channel by channel."""
        h, change = steps * self.sampled.dt, []
        for A, part in zip(self.chains, _split(distance, [len(A) for A in self.chains]), strict=True):
            scaled = h * _sparse(A)
            change.append(ca.solve(ca.SX.eye(len(A)) - 0.5 * scaled, ca.mtimes(scaled, part)))
        return ca.vertcat(*change)


def _longer_step(
    memory: _Memory, bank: _Bank, w: ca.SX, moved: ca.SX, known: ca.SX, *, holding: ca.SX
) -> ca.SX:
    """Change of w over the steps since the last good sample, and what is carried along while samples are held."""
    gap, total = memory.state(["gap"]), memory.state(_labels("gap_mean", known.shape[0]))
    steps, summed = gap + 1.0, total + known
    memory.becomes(gap, ca.if_else(holding, steps, 0.0))
    memory.becomes(total, ca.if_else(holding, summed, 0.0))
    u = bank.spread((moved / bank.sampled.dt - summed) / steps)
    if bank.sampled.sampling.method == "euler":
        return steps * bank.advance(w - bank.equilibrium * u)
    if bank.sampled.sampling.method == "tustin":
        return bank.tustin(steps, w - bank.equilibrium * u)
    free = memory.state([label.replace("w", "free") for label in bank.labels])
    rest = memory.state([label.replace("w", "rest") for label in bank.labels])
    freed, rested = free + bank.advance(w + free), rest + bank.advance(bank.equilibrium + rest)
    memory.becomes(free, ca.if_else(holding, freed, 0.0))
    memory.becomes(rest, ca.if_else(holding, rested, 0.0))
    return freed - rested * u


def _measure(sampled: SampledPhyFilter, n_x: int) -> ca.DM:
    """Left inverse of E, or I, (n_f, n_x)."""
    E_left = sampled.recursion.E_left
    return ca.DM.eye(n_x) if E_left is None else ca.DM(E_left)


def _times_inertia(inertia: FloatArray | str | None, M: ca.SX, dx: ca.SX) -> ca.SX:
    if inertia is None:
        return dx
    if isinstance(inertia, str):
        n_x = dx.shape[0]
        return ca.mtimes(ca.reshape(M, n_x, n_x).T, dx) if inertia == "full" else M * dx
    matrix = np.asarray(inertia, dtype=float)
    return ca.mtimes(_sparse(matrix), dx) if matrix.ndim == 2 else ca.DM(matrix) * dx


def _all_finite(*parts: ca.SX) -> ca.SX:
    answer = ca.SX(1)
    for entry in ca.vertsplit(ca.vertcat(*parts)):
        answer = ca.logic_and(answer, ca.fabs(entry) <= _LARGEST)
    return answer


def _where_finite(value: ca.SX, otherwise: ca.SX) -> ca.SX:
    return ca.if_else(ca.fabs(value) <= _LARGEST, value, otherwise)


def _split(vector: ca.SX, sizes: Sequence[int]) -> list[ca.SX]:
    return ca.vertsplit(vector, np.cumsum([0, *sizes]).tolist())


def _diagonal(*blocks: FloatArray) -> FloatArray:
    return np.asarray(block_diag(*blocks), dtype=float)


def _sparse(matrix: ArrayLike) -> ca.DM:
    return ca.sparsify(ca.DM(np.asarray(matrix, dtype=float)))


def _labels(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(count)]
