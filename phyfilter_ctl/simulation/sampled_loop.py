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
from ..blocks.function_block import point
from ..diagram import FlatModel, flatten
from ..diagram.opening import loop_gain, probed, probed_inputs
from .arguments import Start, start_vector
from .steps import Layout, Results, advance_rk4, at_node, compose, cut, start_state

__all__ = ["linearize_sampled", "sampled_open_loop"]

# In a period, if none are given: each makes the function that is differentiated longer.
_MOST_STEPS = 64


def linearize_sampled(
    sys: ct.InputOutputSystem | FlatModel,
    initial_state: Start | None = None,
    *,
    u0: ArrayLike | None = None,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
    substeps: int | None = None,
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
    u0 : (inputs,) array, optional
        Inputs, held throughout; None means their defaults.
    settle : float
        Seconds that the diagram runs before it is linearised where it has come to: whole periods, and at least one,
        because at its first instant a sampled filter only starts and passes nothing on.
    params : mapping, optional
        As for :func:`simulate`.
    substeps : int, optional
        Steps of Runge-Kutta between instants; None means as many as the fastest mode at the start asks for.

    Returns
    -------
    control.StateSpace
        With the period as dt, inputs held between instants, outputs those at the instant. States are those of the
        model, of the sampled blocks, and what these hold.

    Raises
    ------
    ValueError
        For a diagram without sampled blocks, with several periods, without inputs or outputs; for inputs of the wrong
        shape, a negative time to settle, substeps below 1, or none given where a mode is so fast that it takes more
        than 64; or if the diagram does not stay finite while it settles.

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
    period = _common_period(flat)
    if not flat.inputs or not flat.outputs:
        raise ValueError(f"{flat.name} has no inputs or no outputs: a linear model needs one of each")
    u, p = point("u0", u0, flat.inputs), flat.start_parameters(params)
    x = start_vector(flat, initial_state)
    map_ = _period_map(flat, period, _enough_steps(flat, period, x, u, p) if substeps is None else substeps)
    state, t = _settled(flat, map_, start_state(flat, x), u, p, settle)
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
    u0: ArrayLike | None = None,
    settle: float = 0.0,
    params: Mapping[str, ArrayLike] | None = None,
    substeps: int | None = None,
) -> ct.StateSpace:
    """Loop gain L of a sampled diagram opened at a signal, so that 1 + L is the return difference there.

    Parameters
    ----------
    system : control.InterconnectedSystem
        With sampled blocks of one period.
    signal : str
        As for :func:`phyfilter_ctl.diagram.open_loop`.
    initial_state, u0, settle, params, substeps
        As for :func:`linearize_sampled`.

    Returns
    -------
    control.StateSpace
        Discrete, one input, one output.

    Raises
    ------
    TypeError, ValueError
        As for :func:`phyfilter_ctl.diagram.open_loop` and :func:`linearize_sampled`.

    Notes
    -----
    What is added at the signal is held from instant to instant. So L is that of the diagram where the signal itself is
    held, or only sampled blocks read it; where a continuous block drives a continuous one, it is that of a loop with a
    hold in this place. The closed loop that belongs to it, and whether that is stable, is the diagram's in any case.

    Examples
    --------
    >>> from phyfilter_ctl.blocks import sampled_block, wired
    >>> gain = sampled_block(ct.ss([], [], [], [[-1.5]], dt=1.0, inputs="y", outputs="u", name="gain"))
    >>> body = ct.tf([1.0], [1.0, 0.0], inputs="u", outputs="y", name="body")
    >>> loop = wired([gain, body], {"body.u": "gain.u", "gain.y": "body.y"}, outputs={"y": "body.y"})
    >>> abs(1.0 + sampled_open_loop(loop, "gain.u")(-1.0)).round(9).item()  # 2/1.5 times the gain would be the limit
    0.25
    """
    flat, u0 = probed_flat(system, signal), probed_inputs(system, u0)
    closed = linearize_sampled(flat, initial_state, u0=u0, settle=settle, params=params, substeps=substeps)
    return loop_gain(closed, signal)


@lru_cache(maxsize=16)
def probed_flat(system: ct.InputOutputSystem, signal: str) -> FlatModel:
    """The diagram with its probe at the signal, flat; see :func:`phyfilter_ctl.diagram.opening.probed`."""
    return flatten(probed(system, signal), unconnected="zero")


@dataclass(frozen=True, eq=False)
class _PeriodMap:
    """(state, t, u, p) -> next state and outputs, and its derivatives."""

    period: float
    step: ca.Function
    jacobian: ca.Function


def _common_period(flat: FlatModel) -> float:
    periods = {task.period for task in flat.tasks}
    if not periods:
        raise ValueError(f"{flat.name} has no sampled blocks: use flatten(...).linearize()")
    if len(periods) > 1:
        raise ValueError(
            f"{flat.name} has sampled blocks of several periods, {sorted(periods)} s: expected one for all"
        )
    return periods.pop()


def _enough_steps(flat: FlatModel, period: float, x: FloatArray, u: FloatArray, p: FloatArray) -> int:
    """In a step no mode at the start moves by more than half a radian: Runge-Kutta is (1/2)^5/120 of it off."""
    if not len(x):
        return 1
    slope = _slope(flat)(0.0, x, u, p, [variable.start for variable in flat.held])
    fastest = float(np.abs(np.linalg.eigvals(np.nan_to_num(np.asarray(slope, dtype=float)))).max())
    steps = max(1, int(np.ceil(2.0 * fastest * period)))
    if steps > _MOST_STEPS:
        raise ValueError(
            f"{flat.name} has a mode of {fastest:.3g} rad/s, which takes {steps} steps of Runge-Kutta in the period of "
            f"{period:g} s: give substeps if it may cost that, or leave the mode out"
        )
    return steps


@lru_cache(maxsize=16)
def _slope(flat: FlatModel) -> ca.Function:
    arguments = [ca.MX.sym(name, flat.dynamics.size1_in(i)) for i, name in enumerate("txupz")]
    return ca.Function(
        "pf_slope", arguments, [ca.densify(ca.jacobian(flat.dynamics(*arguments), arguments[1]))]
    )


@lru_cache(maxsize=16)
def _period_map(flat: FlatModel, period: float, substeps: int) -> _PeriodMap:
    if substeps < 1:
        raise ValueError(f"substeps: expected at least 1, got {substeps}")
    layout = Layout(flat)
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
    flat: FlatModel, map_: _PeriodMap, state: FloatArray, u: FloatArray, p: FloatArray, settle: float
) -> tuple[FloatArray, float]:
    """Where the diagram comes to, and when: past the first instant, at which what starts itself does not act."""
    if not (np.isfinite(settle) and settle >= 0.0):
        raise ValueError(f"settle: expected 0 or more seconds, got {settle}")
    steps = max(1, round(settle / map_.period))
    many = map_.step.mapaccum("pf_settle", steps, {"base": 10})
    times = map_.period * np.arange(steps)[None]
    columns = (np.tile(part[:, None], (1, steps)) for part in (u, p))
    state = np.asarray(many(state, times, *columns)[0][:, -1], dtype=float).reshape(-1)
    if not np.isfinite(state).all():
        raise ValueError(
            f"{flat.name} does not stay finite over the {steps * map_.period:g} s it settles: start nearer to its rest"
        )
    return state, steps * map_.period
