"""A sampled PhyFilter as the law of a sampled block: its recursion as CasADi functions of states, inputs and time.

It is ``filter.loop`` on a grid of equal steps, started by itself: at the first instant f_hat = f_theta and the filter
remembers what it was given; every option acts as there. Two things are arranged otherwise, with the same result:

* Means over a (delayed) step are fixed weights of the present sample and of those before it, kept in registers.
* Where samples may be held (``nonfinite="hold"``), the residual of the longer step is only known when the gap ends. The
  recursion is linear in it, so the free motions of the state and of the equilibrium, (e^{At} - I) w and
  (e^{At} - I) equilibrium, are carried along meanwhile. After the longest gap they are dropped: there is no such step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter import Chain, Recursion, SampledPhyFilter, Sampling, StepConstants, windows
from ..filter.matrices import signal_labels
from ..filter.recursion import GAP_ROUNDING, applied, increment, mean, momentum, output, residual
from .functions import BlockFunctions, Variable

__all__ = ["filter_inputs", "filter_law"]

_LARGEST = float(np.finfo(float).max)


def filter_law(
    sampled: SampledPhyFilter,
    channels: int,
    *,
    inertia: FloatArray | str | None = None,
    f_theta: bool = True,
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
    f_theta : bool
        Whether f_theta is an input; else it is 0.

    Returns
    -------
    BlockFunctions
        Inputs x[i], g[i], f_theta[i] and M, outputs f_hat[i], no parameters. With ``g="hold"`` g is the one that acts
        from this sample on: the law keeps it and uses it at the next one, so g does not act on f_hat without delay.

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
    recursion, sampling = sampled.recursion, sampled.sampling
    n_f = recursion.channels(channels)
    inputs = filter_inputs(channels, n_f, inertia, f_theta)
    v = ca.SX.sym("v", len(inputs))
    n_learned = n_f if f_theta else 0
    x, g, model, M = _split(v, [channels, channels, n_learned, len(inputs) - 2 * channels - n_learned])
    if sampling.g_limit is not None:
        g = _where_finite(_clipped(g, *sampling.g_limit), g)
    sections = _Sections.of(recursion, n_f)
    memory = _Memory(guarded=sampling.nonfinite == "hold")
    w = memory.state(sections.labels("w"))
    memory.becomes(memory.started, ca.SX(1))

    acting, weights_g = g, windows.mean_weights(sampling.g, sampling.delay_steps)
    if sampling.g == "hold":  # over the step that ends now the g of the instant before acted
        acting, weights_g = memory.state(_labels("g", channels)), weights_g[1:]
        memory.becomes(acting, g)
    if memory.guarded:
        same = _all_finite(x, model, M)
        good = ca.logic_and(same, _all_finite(acting))
        keep = ca.if_else(memory.started, good, ca.logic_and(same, _all_finite(g)))
        accepted, gap = memory.state(["accepted"]), memory.state(["gap"])
        memory.becomes(accepted, ca.logic_or(accepted, keep))
        update, holding = ca.logic_and(accepted, good), ca.logic_and(accepted, ca.logic_not(good))
        longest = math.floor(recursion.longest_gap * GAP_ROUNDING / sampling.dt)
        resumes = ca.logic_and(update, gap >= longest)
        memory.fresh = ca.logic_or(memory.fresh, resumes)
        update = ca.logic_and(update, ca.logic_not(resumes))
    else:
        keep, update, gap, holding = ca.SX(1), memory.started, ca.SX(0), ca.SX(0)
    weights_f = windows.mean_weights(sampling.f_theta, sampling.delay_steps)
    weights_M = windows.mean_weights("hold", sampling.delay_steps)[1:]  # its value at one time
    _, g_mean = memory.signal("g", acting, weights_g, first=g, age=int(sampling.g == "hold"))
    f_now, f_mean = memory.signal("f_theta", model, weights_f, first=model)
    if not f_theta:
        f_now = f_mean = ca.SX.zeros(n_f)
    M_filled, M_now = memory.signal("M", M, weights_M, first=M, start=1.0)

    x_before, M_before = memory.state(_labels("x", channels)), memory.state(_labels("M_before", M.shape[0]))
    slope = _moved(inertia, mean("average", _entries(M_before), _entries(M_now)), _entries(x - x_before))
    means = _entries(g_mean), _entries(f_mean), None if recursion.E_left is None else recursion.E_left.T
    u = residual(slope / sampling.dt, *means)
    if memory.guarded:
        known = -residual(_entries(ca.SX.zeros(channels)), *means)
        change = _longer_step(memory, sections, sampling, w, u, known, gap, holding)
    else:
        change = sections.column(increment(sections.grid(w), u, sections.constants))
    memory.becomes(x_before, ca.if_else(keep, x, x_before))
    M_then = ca.if_else(memory.fresh, M_filled, M_now)  # before that instant it was what it is then
    memory.becomes(M_before, ca.if_else(keep, M_then, M_before))
    w_next = w + ca.if_else(update, change, 0.0)
    memory.becomes(w, w_next)
    y = output(sections.grid(w_next), None, sections.constants.C)
    f_hat = f_now + ca.if_else(memory.started, ca.vertcat(*y), 0.0)
    if sampling.limit is not None:
        f_hat = _clipped(f_hat, -sampling.limit, sampling.limit)

    arguments = [ca.SX.sym("t"), memory.vector, v, ca.SX.sym("q", 0)]
    return BlockFunctions(
        memory.variables,
        inputs,
        tuple(Variable(label) for label in _labels("f_hat", n_f)),
        (),
        ca.Function("dynamics", arguments, [ca.densify(memory.next_vector)]),
        ca.Function("output", arguments, [ca.densify(f_hat)]),
    )


def filter_inputs(
    n_x: int, n_f: int, inertia: FloatArray | str | None, f_theta: bool = True
) -> tuple[Variable, ...]:
    """Inputs of a sampled filter: x, g and, where they are some, f_theta and the inertia with I as its default."""
    labels = signal_labels(n_x, n_f, f_theta)[0]
    inputs = [Variable(label, optional=label.startswith("f_theta[")) for label in labels]
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
        self.fresh = ca.logic_not(self.started)  # whether what was before this instant is not known

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

        Before the first instant, and that after a gap, it was what it is then, ``first``. ``age``: how many instants
        back it is kept from.
        """
        size = now.shape[0]
        count = max(len(weights) - 1, int(self.guarded)) if size else 0
        past = [
            self.state(_labels(f"{name}_{age + j}" if age + j else name, size), start) for j in range(count)
        ]
        if self.guarded and size:
            now, first = _where_finite(now, past[0]), _where_finite(first, ca.SX(start))
        for register, newer in zip(past, [now, *past], strict=False):
            self.becomes(register, ca.if_else(self.fresh, first, newer))
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


class _Sections(NamedTuple):
    """Sections of all channels: one column of states for CasADi, a grid (n_f, n) of its scalars for the recursion."""

    chains: tuple[Chain, ...]  # one per channel
    constants: StepConstants  # of a nominal step, in double

    @staticmethod
    def of(recursion: Recursion, n_f: int) -> _Sections:
        shared = len(recursion.chains) == 1
        return _Sections(
            recursion.chains * n_f if shared else recursion.chains,
            StepConstants(*recursion.bank, np.float64(1.0 / recursion.sampling.dt)),
        )

    @property
    def places(self) -> list[tuple[int, int]]:
        """Of the states in the grid; it is zero elsewhere, where a chain is shorter than the longest."""
        return [(i, j) for i, chain in enumerate(self.chains) for j in range(len(chain.C))]

    def labels(self, name: str) -> list[str]:
        return [f"{name}[{i},{j}]" for i, j in self.places]

    def grid(self, column: ca.SX) -> Any:
        grid = np.zeros((len(self.chains), max(len(chain.C) for chain in self.chains)), dtype=object)
        for place, entry in zip(self.places, ca.vertsplit(column), strict=True):
            grid[place] = entry
        return grid

    def column(self, grid: Any) -> ca.SX:
        return ca.vertcat(*[grid[place] for place in self.places])

    def tustin(self, h: ca.SX, distance: Any) -> ca.SX:
        """(I - A h/2)^-1 A h distance, channel by channel."""
        change = []
        for chain, row in zip(self.chains, distance, strict=True):
            n = len(chain.C)
            scaled = h * ca.sparsify(ca.DM(chain.A))
            change.append(ca.solve(ca.SX.eye(n) - 0.5 * scaled, ca.mtimes(scaled, ca.vertcat(*row[:n]))))
        return ca.vertcat(*change)


def _longer_step(
    memory: _Memory,
    sections: _Sections,
    sampling: Sampling,
    w: ca.SX,
    u: Any,
    known: Any,
    gap: ca.SX,
    holding: ca.SX,
) -> ca.SX:
    """Change of w over the steps since the last good sample, and what is carried along while samples are held."""
    total, steps = memory.state(_labels("gap_mean", len(known))), gap + 1.0
    memory.becomes(gap, ca.if_else(holding, steps, 0.0))
    memory.becomes(total, ca.if_else(holding, total + ca.vertcat(*known), 0.0))
    u = (u - _entries(total)) / _entries(steps)
    constants = sections.constants
    if sampling.method == "euler":
        longer = constants._replace(dA=constants.dA * _entries(steps))
        return sections.column(increment(sections.grid(w), u, longer))
    rest = constants.equilibrium
    if sampling.method == "tustin":
        return sections.tustin(steps * sampling.dt, sections.grid(w) - u[:, None] * rest)
    free_w, free_rest = memory.state(sections.labels("free")), memory.state(sections.labels("rest"))
    moved, turned = sections.grid(free_w), sections.grid(free_rest)
    moved = moved + applied(constants.dA, sections.grid(w) + moved)
    turned = turned + applied(constants.dA, rest + turned)
    memory.becomes(free_w, ca.if_else(holding, sections.column(moved), 0.0))
    memory.becomes(free_rest, ca.if_else(holding, sections.column(turned), 0.0))
    return sections.column(moved - turned * u[:, None])


def _moved(inertia: FloatArray | str | None, M: Any, dx: Any) -> Any:
    if inertia is None:
        return dx
    if isinstance(inertia, str):
        return momentum(M.reshape(len(dx), -1) if inertia == "full" else M, dx)
    return momentum(np.asarray(inertia, dtype=float), dx)


def _entries(column: ca.SX) -> Any:
    """Scalars of a column in an array, with which numpy's arithmetic writes CasADi's."""
    entries = np.empty(column.numel(), dtype=object)
    for i, entry in enumerate(ca.vertsplit(column) if column.numel() else ()):
        entries[i] = entry
    return entries


def _all_finite(*parts: ca.SX) -> ca.SX:
    answer = ca.SX(1)
    for entry in ca.vertsplit(ca.vertcat(*parts)):
        answer = ca.logic_and(answer, ca.fabs(entry) <= _LARGEST)
    return answer


def _clipped(value: ca.SX, low: FloatArray, high: FloatArray) -> ca.SX:
    return ca.fmin(ca.fmax(value, ca.DM(low)), ca.DM(high))


def _where_finite(value: ca.SX, otherwise: ca.SX) -> ca.SX:
    return ca.if_else(ca.fabs(value) <= _LARGEST, value, otherwise)


def _split(vector: ca.SX, sizes: Sequence[int]) -> list[ca.SX]:
    return ca.vertsplit(vector, np.cumsum([0, *sizes]).tolist())


def _labels(name: str, count: int) -> list[str]:
    return [f"{name}[{i}]" for i in range(count)]
