"""Where a diagram with sampled blocks comes to, and its linear model there.

The model is exact for diagrams linear in their states, and for others at rest; where they move, every interval between
instants has the derivatives at its beginning.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from .._sections import FloatArray
from ..diagram import FlatModel
from ..results import Result
from ..simulation.arguments import Run
from ..simulation.chains import Chain
from ..simulation.events import refuse_events
from ..simulation.flow import is_flow
from ..simulation.steplength import default_step
from ..simulation.steps import KEPT, SYMBOLS, Layout, at_node, cut, start_state
from ..simulation.vm import fixed_pieces
from .hyperperiod import Instants, instants_of
from .periodic import Flow, Instant, PeriodicModel

__all__ = ["OperatingPoint", "settled"]

# Steps of Runge-Kutta while it settles are that much longer than those of a simulation: what is at rest stays there.
_COARSER = 2.5
# A larger change of a state in a period, relative, is no rest.
_REST = 1e-6


def _linearized(
    flat: FlatModel, instants: Instants, start: float, state: FloatArray, u: FloatArray, p: FloatArray
) -> PeriodicModel:
    """The model around the run that starts at a state.

    Parameters
    ----------
    flat : FlatModel
    instants : Instants
    start : float
        Seconds.
    state : (n,) array
        (x, s, z) before the first instant.
    u, p : arrays
        Inputs, held throughout, and parameters.
    """
    layout = Layout(flat)
    n_x, n_s, _ = layout.sizes
    node, slopes = _node_jacobian(flat), _slopes(flat)
    at, between = [], []
    for time, due, length in zip(instants.times, instants.due, instants.lengths, strict=True):
        data = np.zeros(layout.data)
        data[0] = start + time
        data[layout.input(0)] = u
        data[layout.due] = due
        after, *parts = (np.asarray(part, dtype=float) for part in node(state, data, p))
        state = after.ravel()
        at.append(Instant(*parts))
        x, z = state[:n_x], state[n_x + n_s :]
        flow = Flow(*(np.asarray(part, dtype=float) for part in slopes(data[0], x, u, p, z)))
        same = between and all(map(np.array_equal, between[-1], flow))
        between.append(between[-1] if same else flow)
        if time + length < instants.period:
            quiet = np.concatenate([x, z])
            x = _run(_without_tasks(flat), (data[0], data[0] + length), quiet, u, p)[:n_x]
            state = np.concatenate([x, state[n_x:]])
    return PeriodicModel(instants, layout.sizes, at, between)


@dataclass(frozen=True, eq=False, repr=False)
class OperatingPoint(Result):
    """Where a diagram was linearised.

    Parameters
    ----------
    time : float
        Seconds after its start.
    states : dict
        Values of the states there, by name.
    drift : float
        Largest change of a state over the next common period of the sampled blocks, relative to 1 and to its size.
    linear : bool
        Whether the continuous part is linear in its states, so that the point does not matter to it.
    """

    time: float
    states: dict[str, float]
    drift: float
    linear: bool

    @property
    def at_rest(self) -> bool:
        """Whether it is an equilibrium, as far as the run shows."""
        return self.drift <= _REST

    def describe(self) -> str:
        """One line.

        Returns
        -------
        str
        """
        if self.at_rest:
            return f"at rest after {self.time:g} s"
        moving = f"after {self.time:g} s, where states still move by {self.drift:.2g} of themselves a period"
        return moving + (
            "; its continuous part is linear anyway" if self.linear else ": let it settle longer"
        )


def settled(
    flat: FlatModel, x: FloatArray, u: FloatArray, p: FloatArray, settle: float
) -> tuple[PeriodicModel, OperatingPoint]:
    """The model where a diagram has come to, some hyperperiods after its start: at its first instant a filter only
    starts and passes nothing on.

    Raises
    ------
    ValueError
        For a negative time, periods without a common multiple, or a diagram that does not stay finite.
    """
    if not (np.isfinite(settle) and settle >= 0.0):
        raise ValueError(f"settle: expected 0 or more seconds, got {settle}")
    refuse_events(flat, "the linear model of a sampled diagram")
    instants = instants_of(flat)
    period = instants.period
    # A part of 1e-9 of a period is rounding.
    time = period * max(1.0, np.ceil(settle / period - 1e-9))
    state = _run(flat, (0.0, time), start_state(flat, x), u, p)
    later = _run(flat, (time, time + period), state, u, p)
    if not (np.isfinite(state).all() and np.isfinite(later).all()):
        raise ValueError(
            f"{flat.name} does not stay finite over the {time:g} s it settles: start nearer to its rest"
        )
    drift = float(np.max(np.abs(later - state) / (1.0 + np.abs(state)), initial=0.0))
    names = {variable.name: float(value) for variable, value in zip(flat.states, state, strict=False)}
    point = OperatingPoint(time, names, drift, is_flow(flat))
    return _linearized(flat, instants, time, state, u, p), point


def _run(
    flat: FlatModel, span: tuple[float, float], state: FloatArray, u: FloatArray, p: FloatArray
) -> FloatArray:
    """The state at the end of a run, before what is due there."""
    n_x = len(flat.states)
    run = Run(np.array(span), np.tile(u, (2, 1)), state[:n_x], p, "hold")
    method, longest = ("exact", None) if is_flow(flat) else ("rk4", default_step(flat, run))
    pieces = list(fixed_pieces(flat, run, method, longest and _COARSER * longest))
    for i, (step, parameters, data, _) in enumerate(pieces):
        chain = Chain(step, state, parameters)
        chain.run(data[:-1] if i == len(pieces) - 1 else data)
        state = chain.state
    return state


@lru_cache(maxsize=KEPT)
def _without_tasks(flat: FlatModel) -> FlatModel:
    return replace(flat, tasks=(), turns=())


@lru_cache(maxsize=KEPT)
def _node_jacobian(flat: FlatModel) -> ca.Function:
    """(state, data, p) -> state after an instant, J, K, C, D."""
    node, layout = at_node(flat), Layout(flat)
    kind = SYMBOLS[0 if node.is_a("SXFunction") else 1]
    state, data, p = (kind.sym(name, node.size1_in(i)) for i, name in enumerate(("state", "data", "p")))
    after, record = node(state, data, p)
    y = cut(record, slice(layout.sizes[0], None))
    inputs = layout.input(0)
    parts = [
        ca.jacobian(after, state),
        ca.jacobian(after, data)[:, inputs],
        ca.jacobian(y, state),
        ca.jacobian(y, data)[:, inputs],
    ]
    return ca.Function("pf_node_jacobian", [state, data, p], [after, *(ca.densify(part) for part in parts)])


@lru_cache(maxsize=KEPT)
def _slopes(flat: FlatModel) -> ca.Function:
    """(t, x, u, p, z) -> derivatives of x' and y by x, z and u."""
    scalar = flat.dynamics.is_a("SXFunction") and flat.output.is_a("SXFunction")
    kind = SYMBOLS[0 if scalar else 1]
    t, x, u, p, z = (kind.sym(name, flat.dynamics.size1_in(i)) for i, name in enumerate("txupz"))
    values = flat.dynamics(t, x, u, p, z), flat.output(t, x, u, p, z)
    parts = [ca.densify(ca.jacobian(value, by)) for value in values for by in (x, z, u)]
    return ca.Function("pf_slopes", [t, x, u, p, z], parts)
