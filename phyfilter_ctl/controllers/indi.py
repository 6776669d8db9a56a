"""Incremental nonlinear dynamic inversion as an estimate of the unknown force, from accelerometers."""

from __future__ import annotations

import numpy as np

from .. import _signals
from ..blocks import SampledBlock, sampled_block
from ..plants.algebra import Array, rotate
from ..plants.declaration import Columns
from ..plants.factory import Results, plant
from ._equations import UP

__all__ = ["indi"]


def indi(
    *,
    mass: float,
    gravity: float = 9.81,
    bandwidth: float,
    damping: float = 0.5**0.5,
    dt: float,
    name: str = "indi",
) -> SampledBlock:
    """Outer loop of incremental nonlinear dynamic inversion, as a force estimate like the others.

        f_hat = H(s) [m (R a - gravity e_z) - g],    H = w^2/(s^2 + 2 damping w s + w^2)

    a is the measured specific force, R the measured attitude, m v' = g + f; R a - gravity e_z is v'.

    Parameters
    ----------
    mass : float
        Nominal mass m, kg.
    gravity : float
        m/s^2; the world's z points up.
    bandwidth : float
        w of both filters, rad/s.
    damping : float
        Of both filters; 1/sqrt(2) makes them Butterworth.
    dt : float
        Seconds between instants.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs a[3] (m/s^2, body frame), q[4] (body to world, scalar part first) and g[3] (known force, N, world);
        output f_hat[3] (N, world). Parameters ``mass``, ``gravity``, ``bandwidth`` and ``damping``.

    Raises
    ------
    ValueError
        For a number that is not positive, or a gravity that is not finite.

    Notes
    -----
    The law adds the increment m (a_des - v'_f) to the force that acts, g_f, both filtered by H so that they tell of the
    same time: m a_des - f_hat = H g + m (a_des - H v'). Equal filters make the two forms one, because H is linear.
    g should be the force that acts (the modelled rotors', not the command), with m gravity e_z taken off.

    Against :class:`PhyFilter` with f_theta = 0, a_0 = w^2, a_1 = 2 damping w and b = (w^2,): the same F, on the
    acceleration measured at the instants instead of the mean one that the velocity tells. H is discretised by Tustin's
    rule, so it is stable at every period and its value at w = 0 is 1 exactly; it starts at rest, at f_hat = 0.

    E. J. J. Smeur, G. C. H. E. de Croon, Q. Chu, "Cascaded incremental nonlinear dynamic inversion for MAV disturbance
    rejection", Control Engineering Practice 73, 2018; E. Tal, S. Karaman, "Accurate tracking of aggressive quadrotor
    trajectories using incremental nonlinear dynamic inversion and differential flatness", IEEE TCST 29(3), 2021.

    Examples
    --------
    >>> block = indi(mass=3.0, bandwidth=30.0, dt=0.002)
    >>> block.input_labels[:3], block.output_labels
    (['a[0]', 'a[1]', 'a[2]'], ['f_hat[0]', 'f_hat[1]', 'f_hat[2]'])
    """
    _signals.number("mass", mass, "kg", above=0.0)
    _signals.number("bandwidth", bandwidth, "rad/s", above=0.0)
    _signals.number("dt", dt, "s", above=0.0)
    _signals.number("damping", damping, above=0.0)
    _signals.number("gravity", gravity, "m/s^2")
    h = float(dt)

    def at_instants(t: Array, s: Columns, v: Columns, p: Columns) -> tuple[Results, Results]:
        residual = _residual(v, p)
        # f_hat and f_hat'/w by the trapezoidal rule. The states are both an instant on, but for the residual then.
        half = 0.5 * h * p.bandwidth
        share = half / (1.0 + 2.0 * p.damping * half + half * half)
        f_hat = s.f_ahead + share * half * residual
        rate = s.rate_ahead + share * residual
        push = 0.5 * residual - f_hat - 2.0 * p.damping * rate
        ahead = {
            "f_ahead": f_hat + 2.0 * share * (rate + half * (2.0 * p.damping * rate + push)),
            "rate_ahead": rate + 2.0 * share * (push - half * rate),
        }
        return ahead, {"f_hat": f_hat}

    def in_between(t: Array, s: Columns, v: Columns, p: Columns) -> tuple[Results, Results]:
        push = _residual(v, p) - s.f_hat - 2.0 * p.damping * s.rate
        return {"f_hat": p.bandwidth * s.rate, "rate": p.bandwidth * push}, {"f_hat": s.f_hat}

    zero = np.zeros(3)
    inputs = {
        "a": (zero, "m/s^2", "measured specific force, body frame"),
        "q": ([1.0, 0.0, 0.0, 0.0], "", "measured attitude"),
        "g": (zero, "N", "known force"),
    }
    parameters = {
        "mass": (mass, "kg", "nominal mass"),
        "gravity": (gravity, "m/s^2", "gravity"),
        "bandwidth": (bandwidth, "rad/s", "natural frequency of both filters"),
        "damping": (damping, "", "damping of both filters"),
    }
    outputs = {"f_hat": ("N", "estimate of the unknown force")}
    discrete, continuous = (
        plant(law, states=states, inputs=inputs, outputs=outputs, params=parameters, name=name, dt=dt)
        for law, states, dt in (
            (at_instants, {"f_ahead": (zero, "N"), "rate_ahead": (zero, "N")}, h),
            (in_between, {"f_hat": (zero, "N"), "rate": (zero, "N")}, 0.0),
        )
    )
    block = sampled_block(discrete)
    # H itself; the law's differences would be H to first order in the period only.
    block.continuous = continuous.functions
    return block


def _residual(v: Columns, p: Columns) -> Array:
    """m v' - g by the accelerometer."""
    return p.mass * (rotate(v.q, v.a) - p.gravity * UP) - v.g
