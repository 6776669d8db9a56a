"""One procedure tunes every method: the least error on missions in still air, at a given modulus margin.

The margin is 1/max |S| of the sampled loop, S from what is added to a wanted force or torque to the sum, each of the
six by itself, without load and with it, with motors slower than the model says. For given bandwidths of the estimators

1. the outer loop is made as fast as the margin lets it be around an attitude loop that is as stiff as it lets it be,
   horizontally, and then vertically,
2. and the missions that tune are flown, with the load, in still air.

What makes the rotor commands noisier than allowed is left out.
Of the bandwidths of the torque's estimator, then of the force's, the one with the least error is taken. No method sees
wind before the test.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import schur, solve_triangular
from threadpoolctl import threadpool_limits

from phyfilter_ctl import linearize_sampled
from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.study import (
    Executor,
    Report,
    TunedMethod,
    command_jitter,
    fastest,
    least_error,
    read_tuned,
    silent,
    tuned_text,
)

from .diagram import build
from .experiment import Flights, fly
from .methods import METHODS, Method, MethodName
from .params import params
from .seer import Seer
from .vehicle import nominal

__all__ = ["PATH", "jitter", "modulus_margin", "steps", "text", "tune", "tune_all", "tuned"]

FloatArray = NDArray[np.float64]

PATH = Path(__file__).with_name("tuned.toml")
_GAINS = ("position_bandwidth", "bandwidth", "torque_bandwidth", "attitude_margin", "vertical_bandwidth")

# rad/s; the first below anything in the loop, the last just below the Nyquist frequency.
_OMEGA = np.geomspace(0.05, 1500.0, 200)
# s in which the hover settles.
_SETTLE = 5.0
# Poles on the unit circle are states that nothing moves (an integral without gain); several of them scatter.
_ROUND_OFF = 1e-6
# rad/s of the force's estimator while the torque's is chosen.
_FORCE = 4.0
_ATTITUDE_STEP = 0.02


def jitter(flights: Flights) -> float:
    """Noise of the rotor commands over the hover thrust: rms of their change from sample to sample, over sqrt 2.

    Parameters
    ----------
    flights : Flights
        With ``thrust`` kept.
    """
    hover = nominal().hover
    return command_jitter(flights.signals["thrust"][:, flights.time >= flights.mission.left_out], hover)


def modulus_margin(
    method: Method, seer: Seer | None = None, *, others: Mapping[str, float] | None = None
) -> float:
    """Least 1/max |S| at hover over the six channels, without load and with it; 0 where the loop is unstable.

    Parameters
    ----------
    method : Method
    seer : Seer, optional
        SEER-I's models, for the methods that use them.
    others : mapping, optional
        Other parameters of the diagram.
    """
    return float(_all_margins(method, seer, others or {}).min())


def _all_margins(method: Method, seer: Seer | None, others: Mapping[str, float]) -> FloatArray:
    """The lesser of the margins without load and with it, (6,)."""
    with threadpool_limits(1):  # two threads are slower on matrices of this size
        return np.minimum(*(_margins(method, seer, held, others) for held in (0.0, params().mission.payload)))


def _margins(method: Method, seer: Seer | None, held: float, others: Mapping[str, float]) -> FloatArray:
    """Margins of the force's channels and of the torque's, (6,)."""
    settings = (
        method.parameters()
        | dict(others)
        | {
            "vehicle.load.held": held,
            "vehicle.manipulator.motor_lag": params().tuning.lag_factor * params().vehicle.motor_lag,
            "vehicle.wind.jet_speed": 0.0,
        }
    )
    flat = _flat(method.structure, seer if method.uses_seer else None)
    closed = linearize_sampled(flat, settle=_SETTLE, params=settings)
    A, B, C, D = (np.asarray(part) for part in (closed.A, closed.B, closed.C, closed.D))
    if not np.isfinite(A).all():
        return np.zeros(6)
    # One Schur form gives poles and responses; six channels of 170 states take a tenth of what they take by themselves.
    U, Z = (np.asarray(part) for part in schur(A, output="complex")[:2])
    if np.abs(np.diag(U)).max() > 1.0 + _ROUND_OFF:
        return np.zeros(6)
    ends = [f"{signal}[{i}]" for signal in ("F", "tau") for i in range(3)]
    u = [closed.input_labels.index(f"d_{end}") for end in ends]
    y = [closed.output_labels.index(end) for end in ends]
    inwards, outwards, one = Z.conj().T @ B[:, u], C[y] @ Z, np.eye(len(A))
    S = [
        1.0 + np.diag(outwards @ solve_triangular(z * one - U, inwards) + D[np.ix_(y, u)])
        for z in np.exp(1j * _OMEGA * params().sampling.dt)
    ]
    return 1.0 / np.abs(S).max(axis=0)


@lru_cache(maxsize=64)
def _flat(structure: Method, seer: Seer | None) -> FlatModel:
    return flatten(build(structure, seer, probed=True))


def tune(
    name: MethodName, seer: Seer, *, report: Report = silent, executor: Executor | None = None
) -> TunedMethod[Method]:
    """Tune one method.

    Parameters
    ----------
    name : str
        One of ``METHODS``.
    seer : Seer
        SEER-I's models.
    report : callable
        Called with a few words at the beginning of every step, :func:`steps` times.
    executor : Executor, optional
        What tunes the candidates; None tunes one after the other, here.

    Raises
    ------
    ValueError
        If no gains have the margin.
    """
    values = params().tuning
    start = Method(
        name,
        values.slowest,
        _FORCE if name in ("observer", "phyfilter") else (values.integral[0] if name == "integral" else 0.0),
        values.torque[0] if name in ("observer", "phyfilter") else 0.0,
        damping=values.damping,
    )
    wanted = f"a modulus margin of {values.modulus_margin}"

    def best(candidates: list[tuple[str, Method]]) -> TunedMethod[Method]:
        work = partial(_tuned, seer=seer)
        return least_error(name, candidates, work, wanted=wanted, report=report, executor=executor)

    found: TunedMethod[Method] | None = None
    for which in _stages(name):
        low, high = getattr(values, which)
        field = "torque_bandwidth" if which == "torque" else "bandwidth"
        before, inside = (start, True) if found is None else (found.method, found.interior)
        found = best(
            [
                (f"{name}: {which} {value:.3g} rad/s", replace(before, **{field: round(float(value), 3)}))
                for value in np.geomspace(low, high, values.points)
            ]
        )
        found = replace(found, interior=found.interior and inside)
    return best([(name, start)]) if found is None else found


def _stages(name: MethodName) -> tuple[str, ...]:
    """Which bandwidths a method has, in the order of their tuning."""
    if name in ("observer", "phyfilter"):
        return ("torque", "force")
    return ("integral",) if name == "integral" else ()


def _tuned(candidate: Method, seer: Seer) -> TunedMethod[Method] | None:
    """Attitude loop and outer loop as fast as the margin lets them be, flown; None where nothing is allowed."""
    found = _fastest(candidate, seer)
    if found is None:
        return None
    method, margin = found
    still = {"vehicle.wind.jet_speed": 0.0}
    flown = fly(method, params().tuning.seeds, seer, others=still, keep=("r_e", "thrust"))
    noise = jitter(flown)
    if noise > params().tuning.jitter:
        return None
    return TunedMethod(method, margin, float(np.median(flown.score().mean)), noise)


def _fastest(candidate: Method, seer: Seer) -> tuple[Method, float] | None:
    """The fastest outer loop that the margin allows around the stiffest attitude loop that it allows there."""
    values = params().tuning
    soft, stiff = values.attitude[1], values.attitude[0]
    attitudes = np.round(np.arange(soft, stiff - 1e-9, -_ATTITUDE_STEP), 3)
    speeds = np.round(np.arange(values.slowest, values.fastest + 1e-9, values.step), 6)
    known: dict[Method, FloatArray] = {}

    def margins(method: Method) -> FloatArray:
        if method not in known:
            known[method] = _all_margins(method, seer, {})
        return known[method]

    def at(speed: float, attitude: float) -> Method:
        return replace(candidate, position_bandwidth=float(speed), attitude_margin=float(attitude))

    last = len(attitudes) // 2

    def allowed(speed: float) -> Method | None:
        """With the stiffest attitude loop that the torque's channels allow, looked for from the last one on."""
        nonlocal last
        while last > 0 and margins(at(speed, attitudes[last]))[3:].min() < values.modulus_margin:
            last -= 1
        while (
            last + 1 < len(attitudes)
            and margins(at(speed, attitudes[last + 1]))[3:].min() >= values.modulus_margin
        ):
            last += 1
        return holding(at(speed, attitudes[last]))

    def holding(method: Method) -> Method | None:
        return method if margins(method).min() >= values.modulus_margin else None

    level = fastest(speeds, allowed)
    if level is None:
        return None
    faster = speeds[speeds >= level.position_bandwidth]
    found = fastest(faster, lambda speed: holding(replace(level, vertical_bandwidth=float(speed))))
    found = level if found is None else found
    return found, float(margins(found).min())


def tune_all(
    seer: Seer, *, report: Report = silent, executor: Executor | None = None
) -> dict[MethodName, TunedMethod[Method]]:
    """Tune every method, in the order of ``METHODS``."""
    found: dict[MethodName, TunedMethod[Method]] = {}
    for name in METHODS:
        found[name] = tune(name, seer, report=report, executor=executor)
    return found


def steps(name: MethodName) -> int:
    """Number of reports of :func:`tune`."""
    return max(1, len(_stages(name)) * params().tuning.points)


def text(found: Mapping[MethodName, TunedMethod[Method]]) -> str:
    """The tuned methods as TOML."""
    header = [
        "Found by `phyfilter-ctl run aerial_manipulator --tune` on missions in still air, before any test flight.",
        "Bandwidths in rad/s, the mean error over the tuning missions (median) in m.",
    ]
    return tuned_text(header, found, _GAINS)


@cache
def tuned() -> dict[MethodName, TunedMethod[Method]]:
    """The methods as ``tuned.toml`` has them.

    Raises
    ------
    ValueError
        If a method is missing there.

    Examples
    --------
    >>> all(entry.modulus_margin >= 0.5 for entry in tuned().values())
    True
    """
    make = partial(Method, damping=params().tuning.damping)
    return read_tuned(PATH, METHODS, make, _GAINS, command="phyfilter-ctl run aerial_manipulator --tune")
