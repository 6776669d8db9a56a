"""Margins of the complete loop: filter, actuator and an outer loop on position and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct

from ...filter import PhyFilter, SampledPhyFilter
from ..channels import per_channel
from .prior import _positive
from .ratio_margins import RatioMargins, build_loop

__all__ = ["LoopMargin", "loop_margin"]


@dataclass(frozen=True, eq=False, repr=False)
class LoopMargin(RatioMargins):
    """Margins of 1 + F (mu Act - 1) + mu Act (Kp/s^2 + Kd/s) = 0; made by :func:`loop_margin`.

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

    Returns
    -------
    LoopMargin, or PerChannel of it

    Raises
    ------
    TypeError, ValueError
        As for :func:`prior_margin`, and if a gain is negative.

    Notes
    -----
    x is the velocity. Sampled, the outer loop acts on the samples of position and velocity, late like the filter's if
    that has a delay. :func:`prior_margin` alone overestimates the limits where the actuator lags.

    Examples
    --------
    A first-order lag of 100 ms and 20 ms of delay: 15 rad/s is fine, 20 rad/s is not.

    >>> import control as ct
    >>> lag = ct.tf(1, [0.1, 1])
    >>> [loop_margin(PhyFilter([w]), kp=10.0, kd=6.0, actuator=lag, delay=0.02).is_stable for w in (15.0, 20.0)]
    [True, False]
    """
    system, loop = build_loop(filter, actuator, delay, dt, kp, kd)
    return LoopMargin(_positive(inertia_ratio), loop, system)
