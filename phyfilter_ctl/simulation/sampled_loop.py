"""The linear model of a diagram with sampled blocks as those see it: from instant to instant, with hold and delay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from ..diagram import FlatModel, flatten
from ..diagram.opening import loop_gain, probed
from .arguments import Start, start_vector
from .steps import Layout, Results, advance_rk4, at_node, compose, cut, start_state

__all__ = ["linearize_sampled", "sampled_open_loop"]


def linearize_sampled(
    sys: ct.InputOutputSystem | FlatModel,
    initial_state: Start | None = None,
    *,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
    substeps: int = 1,
) -> ct.StateSpace:
    """Discrete linear model of a diagram whose sampled blocks share one period.

    What happens between one instant and the next, differentiated: the sampled blocks run, then Runge-Kutta 4 integrates
    the rest with their outputs held. So sampling, hold, order of the blocks and delays count, which
    :meth:`FlatModel.linearize` leaves out.

    Parameters
    ----------
    sys : control.InputOutputSystem or FlatModel
        With at least one sampled block, all of one period.
    initial_state : array, list, mapping or number, optional
        As for :func:`simulate`.
    settle : float
        Seconds that the diagram runs with its default inputs before it is linearised where it has come to.
    params : mapping, optional
        As for :func:`simulate`.
    substeps : int
        Steps of Runge-Kutta between instants.

    Returns
    -------
    control.StateSpace
        With the period as dt, inputs held between instants, outputs those at the instant. States are those of the
        model, of the sampled blocks, and what these hold.

    Raises
    ------
    ValueError
        For a diagram without sampled blocks, with several periods, without inputs or outputs; or if it does not stay
        finite while it settles.

    Examples
    --------
    A held command makes the loop of an integrator unstable where gain times period reaches 2:

    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> gain = sampled_block(ct.ss([], [], [], [[1.5, -1.5]], dt=1.0, inputs=["r", "y"], outputs="u", name="gain"))
    >>> body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    >>> loop = wired(
    ...     [gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, inputs={"r": "gain.r"}, outputs={"y": "body.y"}
    ... )
    >>> sorted(linearize_sampled(loop).poles().real.round(12).tolist())
    [-0.5, 0.0]
    """
    flat = sys if isinstance(sys, FlatModel) else flatten(sys)
    map_ = _period_map(flat, substeps)
    p = flat.start_parameters(params)
    state, t = _settled(flat, map_, start_state(flat, start_vector(flat, initial_state)), p, settle)
    u = flat.start_inputs()
    if not len(u) or not flat.outputs:
        raise ValueError(f"{flat.name} has no inputs or no outputs: a linear model needs one of each")
    A, B, C, D = (np.asarray(part, dtype=float) for part in map_.jacobian(state, t, u, p))
    names = [f"x[{i}]" for i in range(len(A))]
    return ct.StateSpace(
        A,
        B,
        C,
        D,
        map_.period,
        states=names,
        inputs=[v.name for v in flat.inputs],
        outputs=[v.name for v in flat.outputs],
        remove_useless_states=False,
    )


def sampled_open_loop(
    system: ct.InputOutputSystem,
    signal: str,
    initial_state: Start | None = None,
    *,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
    substeps: int = 1,
) -> ct.StateSpace:
    """Loop gain L of a sampled diagram opened at a signal, so that 1 + L is the return difference there.

    Parameters
    ----------
    system : control.InterconnectedSystem
        With sampled blocks of one period.
    signal : str
        As for :func:`phyfilter_ctl.diagram.open_loop`.
    initial_state, settle, params, substeps
        As for :func:`linearize_sampled`.

    Returns
    -------
    control.StateSpace
        Discrete, one input, one output.

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.diagram.open_loop` and :func:`linearize_sampled`.

    Examples
    --------
    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> gain = sampled_block(ct.ss([], [], [], [[-1.5]], dt=1.0, inputs="y", outputs="u", name="gain"))
    >>> body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    >>> loop = wired([gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, outputs={"y": "body.y"})
    >>> abs(1.0 + sampled_open_loop(loop, "gain.u")(-1.0)).round(9).item()  # 2/1.5 times the gain would be the limit
    0.25
    """
    flat = _probed(system, signal)
    closed = linearize_sampled(flat, initial_state, settle=settle, params=params, substeps=substeps)
    return loop_gain(closed, signal)


@lru_cache(maxsize=16)
def _probed(system: ct.InputOutputSystem, signal: str) -> FlatModel:
    return flatten(probed(system, signal), unconnected="zero")


@dataclass(frozen=True, eq=False)
class _PeriodMap:
    """(state, t, u, p) -> next state and outputs, and its derivatives."""

    period: float
    step: ca.Function
    jacobian: ca.Function


@lru_cache(maxsize=16)
def _period_map(flat: FlatModel, substeps: int) -> _PeriodMap:
    periods = {task.period for task in flat.tasks}
    if not periods:
        raise ValueError(f"{flat.name} has no sampled blocks: use flatten(...).linearize()")
    if len(periods) > 1:
        raise ValueError(
            f"{flat.name} has sampled blocks of several periods, {sorted(periods)} s: expected one for all"
        )
    if substeps < 1:
        raise ValueError(f"substeps: expected at least 1, got {substeps}")
    period, layout = periods.pop(), Layout(flat)
    node, advance, h = at_node(flat), advance_rk4(flat), period / substeps

    def body(state: ca.SX, t: ca.SX, u: ca.SX, p: ca.SX) -> Results:
        def data(at: ca.SX) -> ca.SX:
            rest = type(state)(np.ones(layout.data - 2 - 3 * layout.inputs))
            return ca.vertcat(at, h, u, u, u, rest)

        state, record = node(state, data(t), p)
        for i in range(substeps):
            state = advance(state, data(t + i * h), p)
        return state, cut(record, slice(len(flat.states), None))

    sizes = [layout.state, 1, layout.inputs, len(flat.parameters)]
    step = compose("pf_period", sizes, body)
    arguments = [ca.SX.sym(name, size) for name, size in zip("xtup", sizes, strict=True)]
    following, y = step(*arguments)
    parts = [ca.jacobian(value, arguments[i]) for value in (following, y) for i in (0, 2)]
    return _PeriodMap(period, step, ca.Function("pf_period_jacobian", arguments, parts))


def _settled(
    flat: FlatModel, map_: _PeriodMap, state: FloatArray, p: FloatArray, settle: float
) -> tuple[FloatArray, float]:
    """Where the diagram comes to, and when."""
    steps = round(settle / map_.period)
    if steps:
        many = map_.step.mapaccum("pf_settle", steps, {"base": 10})
        times = map_.period * np.arange(steps)[None]
        u = np.tile(flat.start_inputs()[:, None], (1, steps))
        state = np.asarray(
            many(state, times, u, np.tile(p[:, None], (1, steps)))[0][:, -1], dtype=float
        ).reshape(-1)
    if not np.isfinite(state).all():
        raise ValueError(
            f"{flat.name} does not stay finite over the {settle:g} s it settles: start nearer to its rest"
        )
    return state, steps * map_.period
