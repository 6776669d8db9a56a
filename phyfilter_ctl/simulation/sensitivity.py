"""How a response depends on parameters and on where it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from ..blocks.functions import Variable
from ..diagram import FlatModel
from ..diagram.naming import override
from ..diagram.switches import located
from ..results import Result
from .arguments import Inputs, Interpolation, Parameters, Start, prepare
from .events import refuse_events
from .response import SimulationResponse, response_of, with_outputs_checked
from .simulate import as_flat
from .steplength import default_step
from .steps import KEPT, Results, compose, cut, start_state
from .vm import discrete_pieces, fixed_pieces, run_pieces

__all__ = ["Sensitivity", "sensitivity"]


@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(Result):
    """Derivatives of a response; made by :func:`sensitivity`.

    Parameters
    ----------
    response : SimulationResponse
        The run itself; its ``success`` and ``message`` hold for the derivatives too.
    names : tuple of str
        What the derivatives are by: n_q parameters, then initial states.
    outputs : (N, n_y, n_q) array
        d y / d q, in the unit of y over the unit of q.
    states : (N, n_x, n_q) array
    """

    _figures = ("names", "outputs", "states")

    response: SimulationResponse
    names: tuple[str, ...]
    outputs: FloatArray
    states: FloatArray


def sensitivity(
    sys: ct.InputOutputSystem | FlatModel,
    timepts: ArrayLike,
    inputs: Inputs | None = None,
    initial_state: Start | None = None,
    *,
    by: Sequence[str] = (),
    by_start: Sequence[str] = (),
    params: Parameters | None = None,
    max_step: float | None = None,
    interpolation: Interpolation = "linear",
) -> Sensitivity:
    """Derivatives of states and outputs by parameters and initial states.

    Parameters
    ----------
    sys, timepts, inputs, initial_state, params, max_step, interpolation
        As for :func:`simulate` with method="rk4".
    by : sequence of str
        Parameters, named as for ``params``; a name of several entries stands for all of them.
    by_start : sequence of str
        States whose initial values count.

    Returns
    -------
    Sensitivity

    Raises
    ------
    ValueError
        As for :func:`simulate`, or where both ``by`` and ``by_start`` are empty.

    Notes
    -----
    Forward sensitivities of the discrete scheme itself, sampled blocks included: S' = df/dx S + df/dq, carried through
    each Runge-Kutta step by automatic differentiation. They are exact for the numbers that method="rk4" gives.

    Examples
    --------
    >>> lag = ct.nlsys(lambda t, x, u, p: [p["rate"] * (u[0] - x[0])], None, inputs=1, outputs=1, states=1,
    ...                params={"rate": 1.0}, name="lag")
    >>> result = sensitivity(lag, np.linspace(0.0, 1.0, 101), 1.0, by=["rate"])
    >>> result.names, float(result.outputs[-1, 0, 0].round(6))
    (('rate',), 0.367879)
    """
    flat = as_flat(sys)
    refuse_events(located(flat), "sensitivity")
    run = prepare(flat, timepts, inputs, initial_state, params, interpolation)
    if max_step is not None and not max_step > 0.0:
        raise ValueError(f"max_step: expected a positive number of seconds or None, got {max_step!r}")
    parameters, starts = _places(flat.parameters, by, "by"), _places(flat.states, by_start, "by_start")
    if not parameters and not starts:
        raise ValueError("by, by_start: expected at least one parameter or state")
    if flat.dt > 0.0:
        pieces = discrete_pieces(flat, run)
    else:
        longest = default_step(flat, run) if max_step is None else max_step
        pieces = fixed_pieces(flat, run, "rk4", longest)
    state = start_state(flat, run.start)
    seeds = np.zeros((len(parameters) + len(starts), len(state)))
    for row, place in enumerate(starts, start=len(parameters)):
        seeds[row, place] = 1.0
    along = (tuple(parameters), len(starts))
    extended = (piece._replace(step=_with_derivatives(piece.step, along)) for piece in pieces)
    n_x, n_y, n_q = len(flat.states), len(flat.outputs), len(seeds)
    outcome, derivatives = run_pieces(flat, run, extended, state=np.concatenate([state, seeds.ravel()]))
    derivatives = derivatives.reshape(len(run.times), n_q, n_x + n_y).transpose(0, 2, 1)
    outcome = with_outputs_checked(flat, run, outcome)
    response = response_of(
        flat, run, outcome, method="discrete" if flat.dt > 0.0 else "rk4", backend="vm", squeeze=None
    )
    names = [flat.parameters[i].name for i in parameters] + [flat.states[i].name for i in starts]
    return Sensitivity(response, tuple(names), derivatives[:, n_x:], derivatives[:, :n_x])


@lru_cache(maxsize=KEPT)
def _with_derivatives(step: ca.Function, along: tuple[tuple[int, ...], int]) -> ca.Function:
    """The step with the derivatives of its state behind the state, and of its record behind the record."""
    parameters, starts = along
    n, n_p = step.size1_in(0), step.size1_in(2)
    n_q = len(parameters) + starts
    seed_p = ca.DM(n_p, n_q)
    for column, place in enumerate(parameters):
        seed_p[place, column] = 1.0
    forward = step.forward(n_q)

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        seeds = ca.reshape(cut(state, slice(n, None)), n, n_q)
        results = step(cut(state, slice(n)), data, p)
        changes = forward(
            cut(state, slice(n)),
            data,
            p,
            *results,
            seeds,
            ca.DM(data.numel(), n_q),
            type(state)(ca.densify(seed_p)),
        )
        return [ca.vertcat(value, ca.vec(change)) for value, change in zip(results, changes, strict=True)]

    return compose("pf_sensitivity", [n * (1 + n_q), step.size1_in(1), n_p], body)


def _places(variables: Sequence[Variable], names: Sequence[str], argument: str) -> list[int]:
    """Entries that names stand for."""
    if isinstance(names, str):
        raise ValueError(f"{argument}: expected a list of names, got the string {names!r}")
    places: list[int] = []
    for name in names:
        try:
            marked = override(variables, {name: np.nan})
        except ValueError as error:
            known = ", ".join(variable.name for variable in variables) or "none"
            raise ValueError(f"{argument}: {name!r} names none, or several; known: {known}") from error
        places += [i for i in np.flatnonzero(np.isnan(marked)).tolist() if i not in places]
    return places
