"""L1 adaptive estimate of an unknown force, with the piecewise-constant law."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from typing import SupportsIndex, get_args

import numpy as np

from .. import _signals
from ..blocks import SampledBlock, sampled_block
from ..filter.sampling import Rule
from ..plants.algebra import Array, where
from ..plants.declaration import Columns, Declaration
from ..plants.factory import Results, plant

__all__ = ["l1_adaptive"]


def l1_adaptive(
    *,
    dt: float,
    pole: float,
    bandwidth: float,
    channels: SupportsIndex = 3,
    g: Rule = "hold",
    name: str = "l1",
) -> SampledBlock:
    """L1 adaptive estimator of f in x' = g + f: state predictor, piecewise-constant law, first-order low-pass.

    With e = x_hat - x, the predictor x_hat' = g + sigma + pole e, h the period and phi = (exp(pole h) - 1)/pole,

        e_k     = exp(pole h) e_{k-1} + phi (g + sigma_{k-1} - (x_k - x_{k-1})/h)
        sigma_k = -exp(pole h) e_k/phi
        f_hat_k = f_hat_{k-1} + (1 - exp(-bandwidth h)) (sigma_k - f_hat_{k-1})

    Parameters
    ----------
    dt : float
        Sampling time h, s; it is also the adaptation gain.
    pole : float
        Pole of the predictor, rad/s, negative.
    bandwidth : float
        Corner of the low-pass, rad/s.
    channels : int
        Number n_x of entries of x.
    g : {"hold", "average"}
        How g goes on between samples: held by an actuator, or smooth. With "hold" the block takes the g that acts from
        this sample on, so that a command may depend on f_hat without an algebraic loop.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs x[i] (for a force: momentum m v, N s) and g[i] (the known force, N); outputs f_hat[i]. Parameters
        ``pole`` and ``bandwidth``.

    Raises
    ------
    ValueError, TypeError
        For a period or bandwidth that is not positive, a pole that is not negative, fewer channels than one, or another
        word for ``g``.

    Notes
    -----
    The step of the predictor is exact for g and sigma that are held (or the mean of a smooth g) and x on a straight
    line between samples. Whatever the numbers, sigma_{k-1} cancels e_{k-1}, so that sigma_k = exp(pole h) u_k with
    u_k = (x_k - x_{k-1})/h - mean of g, and the whole is exp(pole h) times a :class:`PhyFilter` of order 1 with
    a_0 = bandwidth and f_theta = 0. The law has its only pole at exp(-bandwidth h). A constant f is estimated as
    exp(pole h) f, hence 1 % low for a pole of -5 rad/s at 500 Hz; a ramp lags by 1/bandwidth.

    The law of the references estimates the part that control cannot reach too and leaves it out of the command; here
    all entries of f_hat are put out. In the linear model of a diagram the block is
    f_hat = exp(pole h) bandwidth/(s + bandwidth) (s x - g). The block's own ``linearize`` starts before the first
    instant, where f_hat = 0: give it a state with ``started`` = 1.

    N. Hovakimyan, C. Cao, "L1 Adaptive Control Theory", 2010, ch. 3.3; Z. Wu et al., "L1Quad: L1 adaptive augmentation
    of geometric control for agile quadrotors with performance guarantees", 2023; D. Hanover et al., "Performance,
    precision, and payloads: adaptive nonlinear MPC for quadrotors", RA-L 2022.

    Examples
    --------
    A constant force of 2 N on a mass of 1 kg, from the velocity alone:

    >>> import control as ct
    >>> import phyfilter_ctl as pf
    >>> block = l1_adaptive(dt=0.01, pole=-2.0, bandwidth=20.0, channels=1)
    >>> body = ct.ss(0.0, 1.0, 1.0, 0.0, inputs="f", outputs="x[0]", name="body")
    >>> diagram = ct.interconnect([body, block], inputs=["f", "g[0]"], outputs="f_hat[0]")
    >>> response = pf.simulate(diagram, [0.0, 1.0], [2.0, 0.0])
    >>> response.outputs["f_hat[0]"][-1].round(3).item(), (2.0 * np.exp(-0.02)).round(3).item()
    (1.96, 1.96)
    """
    n_x = _channels(channels)
    _signals.number("dt", dt, "s", above=0.0)
    _signals.number("bandwidth", bandwidth, "rad/s", above=0.0)
    if _signals.number("pole", pole, "rad/s") >= 0.0:
        raise ValueError(f"pole: expected a negative number of rad/s, got {pole!r}")
    if g not in get_args(Rule):
        raise ValueError(f"g: expected one of {get_args(Rule)}, got {g!r}")
    h, smooth = float(dt), g == "average"

    def equations(t: Array, s: Columns, v: Columns, p: Columns) -> tuple[Results, Results]:
        decay, phi = np.exp(p.pole * h), np.expm1(p.pole * h) / p.pole
        known = 0.5 * (s.g + v.g) if smooth else s.g
        e = decay * s.e + phi * (known + s.sigma - (v.x - s.x) / h)
        sigma = -decay * e / phi
        f_hat = s.f_hat - np.expm1(-p.bandwidth * h) * (sigma - s.f_hat)
        e, sigma, f_hat = (where(s.started, part, 0.0) for part in (e, sigma, f_hat))
        states = {"started": 1.0, "x": v.x, "g": v.g, "e": e, "sigma": sigma, "f_hat": f_hat}
        return states, {"f_hat": f_hat}

    def in_between(t: Array, s: Columns, v: Columns, p: Columns) -> tuple[Results, Results]:
        y = p.bandwidth * (v.x - s.z)
        return {"z": y + v.g}, {"f_hat": np.exp(p.pole * h) * y}

    zero = np.zeros(n_x)
    states: Mapping[str, Declaration] = {
        "started": 0.0,
        "x": (zero, "", "x of the instant before"),
        "g": (zero, "", "g of the instant before"),
        "e": (zero, "", "error of the prediction"),
        "sigma": (zero, "", "estimate before the low-pass"),
        "f_hat": (zero, "", "estimate"),
    }
    inputs = {"x": (zero, "", "measured"), "g": (zero, "", "known dynamics")}
    parameters = {
        "pole": (pole, "rad/s", "pole of the predictor"),
        "bandwidth": (bandwidth, "rad/s", "corner of the low-pass"),
    }
    block = sampled_block(plant(equations, states=states, inputs=inputs, params=parameters, name=name, dt=h))
    # The law's differences about its start would tell of the first instant, with f_hat = 0, for ever.
    block.continuous = plant(
        in_between, states={"z": zero}, inputs=inputs, params=parameters, name=name
    ).functions
    return block


def _channels(value: SupportsIndex) -> int:
    try:
        n_x = operator.index(value)
    except TypeError as error:
        raise TypeError(f"channels: expected a whole number, got {value!r}") from error
    if n_x < 1:
        raise ValueError(f"channels: expected at least 1, got {n_x}")
    return n_x
