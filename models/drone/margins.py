"""Why the choice of g matters: the bandwidth at which the loop breaks, by formula, by linearisation and in flight.

    1 + F (mu Act - e^(-s late)) + mu Act (Kp/s^2 + Kd/s) = 0,    Act = e^(-s delay) / (motor_lag s + 1)

is the complete loop of the vertical axis at hover with the commanded thrust as g; without the last term it is the inner
loop. With the thrust that acts as g a model of Act stands beside mu Act; where both agree F drops out of the loop, and
with it the limit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Literal

import control as ct
import numpy as np
from threadpoolctl import threadpool_limits

from phyfilter_ctl import Loop, PhyFilter, sampled_open_loop
from phyfilter_ctl.analysis import largest_bandwidth
from phyfilter_ctl.blocks import FunctionBlock
from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.plants import Columns, plant, rotate, rotate_back
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results
from phyfilter_ctl.simulation import simulate

from .diagram import build
from .experiment import start_state
from .methods import Known, Method
from .params import params

__all__ = [
    "CHOICES",
    "Limits",
    "Prediction",
    "breaking_bandwidth",
    "exact_bandwidth",
    "held_force",
    "limits",
    "predicted",
]

Which = Literal["vertical", "all"]
KnownForce = Known | Literal["held"]

CHOICES: tuple[KnownForce, ...] = ("held", "commanded", "collective", "applied")
"""What may stand as g: ``held`` is the force commanded over each step, as the formulas have it; ``commanded`` is what
an estimator can have of it without an algebraic loop, a sample late; the others as in the comparison."""

_UP = np.array([0.0, 0.0, 1.0])
# m/s upwards at the start: small enough for the loop to stay linear, far above rounding.
_PUSH = 1e-4
# m: a hundred times where the push takes it; beyond it swings as large as the rotors' limits let it.
_AWAY = 0.005
# rad: the vehicle is kept upright where only its vertical axis is looked at.
_UPRIGHT = 1e-7
# s: enough for the filter to have started, too short for anything to drift away from hover.
_STARTED = 0.02
# Of eigenvalues on the unit circle.
_ROUND_OFF = 1e-7
# Of a mode in the wanted vertical force; rounding leaves 1e-15 of the horizontal ones there.
_TAKES_PART = 1e-9


@dataclass(frozen=True)
class Prediction:
    """Largest bandwidth of a filter of order 1 by formula, rad/s.

    Attributes
    ----------
    inner : float
        Of the inner loop, continuous; the hold of the command counts as half a sample of delay.
    complete : float
        Of the complete loop, continuous.
    sampled : float
        Of the complete loop as it is sampled.
    """

    inner: float
    complete: float
    sampled: float


@dataclass(frozen=True)
class Limits:
    """Bandwidths at which the loop of a filter of order 1 breaks, rad/s; inf where it does not.

    Attributes
    ----------
    position_bandwidth : float
        Of the outer loop.
    predicted : Prediction
        For ``held``, vertical.
    simulated : dict of str to float
        Vertical, in flight, by choice of g.
    vertical, all : dict of str to float
        From the linearised sampled loop, by choice of g: of the vertical axis, and of the whole vehicle.
    """

    position_bandwidth: float
    predicted: Prediction
    simulated: dict[KnownForce, float]
    vertical: dict[KnownForce, float]
    all: dict[KnownForce, float]


@cache
def predicted(position_bandwidth: float) -> Prediction:
    """What the formulas of the module say for ``held``, at mu = 1.

    Parameters
    ----------
    position_bandwidth : float
        Of the outer loop, rad/s.

    Examples
    --------
    >>> found = predicted(1.9)
    >>> round(found.inner, 1), round(found.complete, 1), round(found.sampled, 1)
    (94.8, 77.9, 85.0)
    """
    vehicle, dt = params().vehicle, params().sampling.dt
    kp, kd, _ = _method(position_bandwidth, 1.0, "commanded").gains
    lag = ct.tf(1, [vehicle.motor_lag, 1])
    late = vehicle.delay + 0.5 * dt
    return Prediction(
        largest_bandwidth(_first, Loop(actuator=lag, delay=late), modulus_margin=0.0).limit,
        largest_bandwidth(_first, Loop(kp, kd, actuator=lag, delay=late), modulus_margin=0.0).limit,
        largest_bandwidth(
            lambda w: _first(w).sampled(dt, g="hold"),
            Loop(kp, kd, actuator=lag, delay=vehicle.delay),
            dt=dt,
            modulus_margin=0.0,
        ).limit,
    )


def breaking_bandwidth(
    position_bandwidth: float,
    known: KnownForce = "held",
    *,
    low: float = 10.0,
    high: float = 400.0,
    tolerance: float = 0.005,
    duration: float = 10.0,
) -> float:
    """Bandwidth at which the height begins to swing up in flight, by bisection.

    The vehicle hovers, kept upright, is pushed upwards at 0.1 mm/s, and flies with the observer of order 1. The flight
    breaks where the vertical acceleration is larger in its last quarter than in its second, or the height leaves by
    5 mm.

    Parameters
    ----------
    position_bandwidth : float
        Of the outer loop, rad/s.
    known : {"held", "commanded", "collective", "applied"}
        What stands as g.
    low, high : float
        Range of bandwidths, rad/s.
    tolerance : float
        Relative.
    duration : float
        s of every flight.

    Returns
    -------
    float
        rad/s; inf if the flight holds at ``high``.

    Raises
    ------
    ValueError
        If it breaks at ``low``.
    """
    return _bisected(
        lambda w: _holds(_method(position_bandwidth, w, known), known, duration), low, high, tolerance
    )


def exact_bandwidth(
    position_bandwidth: float,
    known: KnownForce = "held",
    *,
    which: Which = "vertical",
    low: float = 1.0,
    high: float = 400.0,
    tolerance: float = 1e-3,
) -> float:
    """Bandwidth at which a pole of the sampled loop at hover leaves the unit circle, by bisection.

    Parameters
    ----------
    position_bandwidth : float
        Of the outer loop, rad/s.
    known : {"held", "commanded", "collective", "applied"}
        What stands as g.
    which : {"vertical", "all"}
        The poles of the loop gain of the vertical axis, or all of the vehicle.
    low, high : float
        Range of bandwidths, rad/s.
    tolerance : float
        Relative.

    Returns
    -------
    float
        rad/s; inf if the loop is stable at ``high``.

    Raises
    ------
    ValueError
        If it is unstable at ``low``.
    """
    return _bisected(
        lambda w: _is_stable(_method(position_bandwidth, w, known), known, which), low, high, tolerance
    )


def limits(position_bandwidth: float) -> Limits:
    """All limits for one outer loop.

    Parameters
    ----------
    position_bandwidth : float
        rad/s.
    """
    with threadpool_limits(1):  # two threads are slower on matrices of this size
        return Limits(
            position_bandwidth,
            predicted(position_bandwidth),
            {known: breaking_bandwidth(position_bandwidth, known) for known in CHOICES},
            {known: exact_bandwidth(position_bandwidth, known) for known in CHOICES},
            {known: exact_bandwidth(position_bandwidth, known, which="all") for known in CHOICES},
        )


def _first(bandwidth: float) -> PhyFilter:
    return PhyFilter([bandwidth])


def _method(position_bandwidth: float, bandwidth: float, known: KnownForce) -> Method:
    flown: Known = "commanded" if known == "held" else known
    return Method("observer", position_bandwidth, bandwidth, known=flown, damping=params().tuning.damping)


def _bisected(holds: Callable[[float], bool], low: float, high: float, tolerance: float) -> float:
    if holds(high):
        return float("inf")
    if not holds(low):
        raise ValueError(f"low: the loop breaks at {low:g} rad/s already; start lower")
    while high / low > 1.0 + tolerance:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if holds(middle) else (low, middle)
    return float(np.sqrt(low * high))


def _holds(method: Method, known: KnownForce, duration: float) -> bool:
    dt = params().sampling.dt
    start = {**start_state(), "vehicle.quadrotor.v": [0.0, 0.0, _PUSH]}
    flat = _flat(method.structure, known)
    flight = simulate(
        flat,
        dt * np.arange(round(duration / dt) + 1),
        None,
        start,
        params=_hovering(method) | {"controller.attitude.tilt_max": _UPRIGHT},
        method="rk4",
        max_step=params().sampling.max_step,
        backend="vm",
    )
    height = np.asarray(flight.outputs["r[2]"])
    if not np.abs(height - height[0]).max() < _AWAY:  # nan too
        return False
    # Of second differences: the slow way back to the height that is wanted does not count.
    swing = np.abs(np.diff(height, 2))
    quarter = len(swing) // 4
    return bool(swing[3 * quarter :].max() <= swing[quarter : 2 * quarter].max())


def _is_stable(method: Method, known: KnownForce, which: Which) -> bool:
    L = sampled_open_loop(
        _loop(method.structure, known),
        "controller.position.F[2]",
        start_state(),
        settle=_STARTED,
        params=_hovering(method),
    )
    A, B, C, D = (np.asarray(part, dtype=float) for part in (L.A, L.B, L.C, L.D))
    poles, right = np.linalg.eig(A - B @ C / (1.0 + D[0, 0]))
    outside = np.abs(poles) > 1.0 + _ROUND_OFF
    if which == "vertical":
        # A mode that the wanted vertical force does not show is one of another axis.
        outside &= np.abs(C[0] @ right) > _TAKES_PART * np.linalg.norm(C)
    return not outside.any()


def _hovering(method: Method) -> dict[str, float]:
    return method.parameters() | {"controller.reference.speed": 1e-9}


@lru_cache(maxsize=4)
def _flat(method: Method, known: KnownForce) -> FlatModel:
    return flatten(_loop(method, known))


def _loop(method: Method, known: KnownForce) -> ct.InterconnectedSystem:
    """Where ``known`` is "held", the filter takes over each step the force that was commanded for it."""
    return build(method, prior=held_force() if known == "held" else None)


def held_force() -> FunctionBlock:
    """g from the command of this instant, which the filter keeps until the next."""
    vehicle = params().vehicle

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        drag = rotate(u.q, np.array(vehicle.drag) * rotate_back(u.q, u.v))
        return {}, {"g": u.F - vehicle.mass * vehicle.gravity * _UP - drag}

    return plant(
        equations,
        name="prior",
        states={},
        inputs={"F": (np.zeros(3), "N"), "q": np.array([1.0, 0.0, 0.0, 0.0]), "v": (np.zeros(3), "m/s")},
        outputs={"g": "N"},
    )
