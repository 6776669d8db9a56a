"""The study as a python-control diagram: measured velocity in, acceleration out, at the filter's rate."""

from __future__ import annotations

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.blocks import PhyFilterBlock, phyfilter_block
from phyfilter_ctl.filter import PhyFilter
from phyfilter_ctl.sampled import SampledPhyFilter

from .differentiator import LeastSquaresSlope, WindowDifferentiator
from .params import params

__all__ = ["build", "differentiator_block", "rest_state"]

FloatArray = NDArray[np.float64]

_AXES = 3
_DEFAULT_SPAN = 0.07  # s, the middle of the candidate windows
_DEFAULT_POLE = -20.0  # rad/s, twice


def build(
    differentiator: WindowDifferentiator | None = None, filter: SampledPhyFilter | None = None
) -> ct.InputOutputSystem:
    """The learned differentiator and the PhyFilter that repairs it, as one discrete python-control system.

        v[i] --+--> differentiator --> f_theta[i] --> phyfilter --> f_hat[i]
               +------------------------- x[i] ---------^           (g = 0, M = 1)

    Parameters
    ----------
    differentiator : WindowDifferentiator, optional
        For instance ``compare(...).learned.network``. None: the least-squares slope of a window of 70 ms, a linear
        model that needs no training.
    filter : SampledPhyFilter, optional
        None: two poles at -20 rad/s, sampled at 500 Hz.

    Returns
    -------
    control.InputOutputSystem
        Named "acceleration", inputs v[0..2] in m/s, outputs f_hat[0..2] and f_theta[0..2] in m/s^2. It starts
        without a bump from :func:`rest_state`.

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
        slope = LeastSquaresSlope(length, stride * filter.dt)
        differentiator = WindowDifferentiator(slope, length, stride)
    learned = differentiator_block(differentiator, filter.dt)
    repair = phyfilter_block(filter, _AXES, name="phyfilter")
    axes = range(_AXES)
    return ct.interconnect(
        [learned, repair],
        connections=[[f"phyfilter.f_theta[{i}]", f"differentiator.f_theta[{i}]"] for i in axes],
        inplist=[[f"differentiator.v[{i}]", f"phyfilter.x[{i}]"] for i in axes],
        inputs=[f"v[{i}]" for i in axes],
        outlist=[f"phyfilter.f_hat[{i}]" for i in axes] + [f"differentiator.f_theta[{i}]" for i in axes],
        outputs=[f"f_hat[{i}]" for i in axes] + [f"f_theta[{i}]" for i in axes],
        ignore_inputs=[f"phyfilter.g[{i}]" for i in axes],  # g = 0: nothing of v' is known
        name="acceleration",
        dt=filter.dt,
    )


def differentiator_block(differentiator: WindowDifferentiator, dt: float) -> ct.NonlinearIOSystem:
    """A learned differentiator as a discrete block; its states are the past velocities, the newest first.

    Parameters
    ----------
    differentiator : WindowDifferentiator
    dt : float
        Sampling interval, s.

    Returns
    -------
    control.NonlinearIOSystem
        Inputs v[0..2], outputs f_theta[0..2].

    Examples
    --------
    >>> block = differentiator_block(WindowDifferentiator(LeastSquaresSlope(4, 0.02), 4, 10), 0.002)
    >>> block.nstates
    90
    """
    reach = differentiator.reach

    def update(t: float, x: FloatArray, u: FloatArray, parameters: dict[str, float]) -> FloatArray:
        return np.concatenate([u, x[:-_AXES]])

    def output(t: float, x: FloatArray, u: FloatArray, parameters: dict[str, float]) -> FloatArray:
        past = np.concatenate([u, x]).reshape(reach + 1, _AXES)
        return differentiator.predict(past[::-1])[-1]

    return ct.nlsys(
        update,
        output,
        inputs=[f"v[{i}]" for i in range(_AXES)],
        outputs=[f"f_theta[{i}]" for i in range(_AXES)],
        states=[f"v[{i}]_{j}" for j in range(1, reach + 1) for i in range(_AXES)],
        dt=dt,
        name="differentiator",
    )


def rest_state(system: ct.InputOutputSystem, v0: ArrayLike) -> FloatArray:
    """Initial state of :func:`build`'s system for a first velocity v0 (3,) in m/s: window full of it, no bump.

    Raises
    ------
    ValueError
        If the system is not one of :func:`build`, or the velocity not of three axes.
    """
    v0 = np.asarray(v0, dtype=float)
    blocks = getattr(system, "syslist", ())
    if len(blocks) != 2 or not isinstance(blocks[1], PhyFilterBlock):
        raise ValueError(f"expected the system that build() returned, got {system.name!r}")
    if v0.shape != (_AXES,):
        raise ValueError(f"v0: expected shape ({_AXES},), got {v0.shape}")
    learned, repair = blocks
    window = np.tile(v0, learned.nstates // _AXES)
    f_theta0 = np.asarray(learned.output(0.0, window, v0), dtype=float)
    return np.concatenate([window, repair.rest_state(v0, np.zeros(_AXES), f_theta0)])
