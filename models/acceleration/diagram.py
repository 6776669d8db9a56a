"""The study as a python-control diagram: measured velocity in, acceleration out, at the filter's rate."""

from __future__ import annotations

from typing import Any

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.blocks import (
    BlockFunctions,
    FunctionBlock,
    PhyFilterBlock,
    Variable,
    function_block,
    phyfilter_block,
)
from phyfilter_ctl.filter import PhyFilter, SampledPhyFilter
from phyfilter_ctl.learned import Windowed

from .differentiator import least_squares_slope
from .params import params

__all__ = ["build", "differentiator_block", "rest_state"]

FloatArray = NDArray[np.float64]

_AXES = 3
_DEFAULT_SPAN = 0.07  # s, the middle of the candidate windows
_DEFAULT_POLE = -20.0  # rad/s, twice


def build(
    differentiator: Windowed[Any] | None = None, filter: SampledPhyFilter | None = None
) -> ct.InputOutputSystem:
    """The learned differentiator and the PhyFilter that repairs it, as one discrete python-control system.

        v[i] --+--> differentiator --> f_theta[i] --> phyfilter --> f_hat[i]
               +------------------------- x[i] ---------^           (g = 0, M = 1)

    Parameters
    ----------
    differentiator : Windowed, optional
        For instance ``compare(...).learned.network``. None: the least-squares slope of a window of 70 ms, a linear
        model that needs no training.
    filter : SampledPhyFilter, optional
        None: two poles at -20 rad/s, sampled at 500 Hz.

    Returns
    -------
    control.InputOutputSystem
        Named "acceleration", inputs v[0..2] in m/s, outputs f_hat[0..2] and f_theta[0..2] in m/s^2. It starts
        bumplessly from :func:`rest_state`.

    Examples
    --------
    >>> system = build()
    >>> system.name, system.dt, system.input_labels
    ('acceleration', 0.002, ['v[0]', 'v[1]', 'v[2]'])
    """
    if filter is None:
        filter = PhyFilter.from_poles([_DEFAULT_POLE] * 2).sampled(params().sampling.dt)
    if differentiator is None:
        length = params().network.length
        stride = max(1, round(_DEFAULT_SPAN / (filter.dt * (length - 1))))
        differentiator = Windowed(least_squares_slope(length, stride * filter.dt), length, stride)
    learned = differentiator_block(differentiator, filter.dt)
    repair = phyfilter_block(filter, _AXES, name="phyfilter")
    axes = range(_AXES)
    # g = 0: nothing of v' is known. python-control has no block without inputs.
    nothing = ct.StateSpace(
        [],
        [],
        [],
        np.zeros((_AXES, _AXES)),
        None,
        inputs=_AXES,
        outputs=[f"g[{i}]" for i in axes],
        name="nothing",
    )
    return ct.interconnect(
        [learned, repair, nothing],
        connections=[
            [f"phyfilter.{name}[{i}]", f"{block}.{name}[{i}]"]
            for block, name in (("differentiator", "f_theta"), ("nothing", "g"))
            for i in axes
        ],
        inplist=[[f"differentiator.v[{i}]", f"phyfilter.x[{i}]", f"nothing.u[{i}]"] for i in axes],
        inputs=[f"v[{i}]" for i in axes],
        outlist=[f"phyfilter.f_hat[{i}]" for i in axes] + [f"differentiator.f_theta[{i}]" for i in axes],
        outputs=[f"f_hat[{i}]" for i in axes] + [f"f_theta[{i}]" for i in axes],
        name="acceleration",
        dt=filter.dt,
    )


def differentiator_block(differentiator: Windowed[Any], dt: float) -> FunctionBlock:
    """A learned differentiator as a discrete block; its states are the past velocities, the newest first.

    Parameters
    ----------
    differentiator : Windowed
    dt : float
        Sampling interval, s.

    Returns
    -------
    FunctionBlock
        Inputs v[0..2], outputs f_theta[0..2].

    Examples
    --------
    >>> block = differentiator_block(Windowed(least_squares_slope(4, 0.02), 4, 10), 0.002)
    >>> block.nstates
    90
    """
    reach, stride = differentiator.reach, differentiator.stride
    t, x, u = ca.SX.sym("t"), ca.SX.sym("x", _AXES * reach), ca.SX.sym("u", _AXES)
    p = ca.SX(0, 1)
    past = ca.vertcat(u, x)
    window = [past[_AXES * lag : _AXES * (lag + 1)] for lag in range(0, reach + 1, stride)]
    prediction = differentiator.casadi()(ca.vertcat(*window))
    functions = BlockFunctions(
        tuple(Variable(f"past[{j},{i}]", unit="m/s") for j in range(1, reach + 1) for i in range(_AXES)),
        tuple(Variable(f"v[{i}]", unit="m/s") for i in range(_AXES)),
        tuple(Variable(f"f_theta[{i}]", unit="m/s^2") for i in range(_AXES)),
        (),
        ca.Function("dynamics", [t, x, u, p], [past[: _AXES * reach]]),
        ca.Function("output", [t, x, u, p], [prediction]),
    )
    return function_block(functions, name="differentiator", dt=dt)


def rest_state(system: ct.InputOutputSystem, v0: ArrayLike) -> FloatArray:
    """Initial state of :func:`build`'s system for a first velocity v0 (3,) in m/s: window full of it, a bumpless start.

    Raises
    ------
    ValueError
        If the system is not one of :func:`build`, or the velocity not of three axes.
    """
    v0 = np.asarray(v0, dtype=float)
    blocks = getattr(system, "syslist", ())
    if len(blocks) != 3 or not isinstance(blocks[1], PhyFilterBlock):
        raise ValueError(f"expected the system that build() returned, got {system.name!r}")
    if v0.shape != (_AXES,):
        raise ValueError(f"v0: expected shape ({_AXES},), got {v0.shape}")
    learned, repair, _ = blocks
    window = np.tile(v0, learned.nstates // _AXES)
    f_theta0 = np.asarray(learned.output(0.0, window, v0), dtype=float)
    return np.concatenate([window, repair.rest_state(v0, np.zeros(_AXES), f_theta0)])
