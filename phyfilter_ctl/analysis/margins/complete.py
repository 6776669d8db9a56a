"""Margins of the complete loop: filter, actuator and an outer loop on position and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct

from ...filter import PhyFilter, SampledPhyFilter
from ..channels import per_channel
from ..options import Told
from .prior import _positive
from .ratio_margins import RatioMargins, build_loop

__all__ = ["LoopMargin", "loop_margin"]


@dataclass(frozen=True, eq=False, repr=False)
class LoopMargin(RatioMargins):
    """Margins of 1 + F (mu Act - g/v) + mu Act (Kp/s^2 + Kd/s) = 0; made by :func:`loop_margin`.

    Parameters
    ----------
    inertia_ratio : float
        mu = M_hat / M at which gain, phase, delay, modulus and disk margins are taken.
    loop : Loop
        The characteristic function on the boundary of stability.
    filter : PhyFilter or SampledPhyFilter
        As it runs.
    """


@per_channel
def loop_margin(
    filter: PhyFilter | SampledPhyFilter,
    *,
    kp: float,
    kd: float,
    actuator: ct.TransferFunction | ct.StateSpace | None = None,
    delay: float = 0.0,
    inertia_ratio: float = 1.0,
    g: Told = "commanded",
    dt: float | None = None,
) -> LoopMargin:
    """Margins of the complete loop: f_hat fed back inside an outer loop on position and velocity.

        1 + F (mu Act e^(-s delay) - 1) + mu Act e^(-s delay) (Kp/s^2 + Kd/s) = 0,    mu = M_hat / M

    Parameters
    ----------
    filter : PhyFilter, SampledPhyFilter or several
        As for :func:`prior_margin`.
    kp, kd : float
        Gains per unit of modelled inertia, tau = M_hat (-kp position - kd x) - f_hat: kp in 1/s^2, kd in 1/s.
    actuator, delay, dt
        As for :func:`prior_margin`.
    inertia_ratio : float
        mu at which gain, phase, delay, modulus and disk margins are taken.
    g : {"commanded", "applied"}
        What the filter is told: the command v, or the force Act e^(-s delay) v that acts, lag and delay and all: a
        measured motor current times the torque constant, say; sampled, its mean over the step.

    Returns
    -------
    LoopMargin, or PerChannel of it

    Raises
    ------
    TypeError, ValueError
        As for :func:`prior_margin`, and if a gain is negative; with ``g="applied"`` for a delay of the measurement.

    Notes
    -----
    x is the velocity. Sampled, the outer loop acts on the samples of position and velocity, late like the filter's if
    that has a delay. :func:`prior_margin` alone overestimates the limits where the actuator lags.

    Told what acts, the loop is

        1 + Act e^(-s delay) [(mu - 1) F + mu (Kp/s^2 + Kd/s)] = 0

    and with an exact inertia the filter is not in it. Gain, phase, delay, modulus and disk margins are those of this
    loop opened at the command, at ``inertia_ratio``; a gain of the actuator is told too, so that the gain margin and
    ``stable_ratios``, over mu, are two things here. A current that reads wrong by a gain is not covered.

    Examples
    --------
    A first-order lag of 100 ms and 20 ms of delay: 15 rad/s is fine, 20 rad/s is not.

    >>> import control as ct
    >>> lag = ct.tf(1, [0.1, 1])
    >>> [loop_margin(PhyFilter([w]), kp=10.0, kd=6.0, actuator=lag, delay=0.02).is_stable for w in (15.0, 20.0)]
    [True, False]

    A filter that is told what acts may be faster, as far as the inertia is known:

    >>> found = loop_margin(PhyFilter([20.0]), kp=10.0, kd=6.0, actuator=lag, delay=0.02, g="applied")
    >>> found.is_stable, [tuple(round(ratio, 2) for ratio in ends) for ends in found.stable_ratios]
    (True, [(0.26, 5.89)])
    """
    system, loop = build_loop(filter, actuator, delay, dt, kp, kd, g)
    return LoopMargin(_positive(inertia_ratio), loop, system)
