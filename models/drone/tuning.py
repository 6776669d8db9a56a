"""One procedure tunes every method: the least error on flights with unknown mass alone, at a given modulus margin.

For every bandwidth of the estimator the outer loop is made as fast as the margin lets it be: the least distance of the
loop gain from -1, opened at the wanted force, horizontal and vertical, without payload and with the heaviest, with
motors slower than the model says. Of these pairs the one that flies the tuning flights with the least error is taken,
among those whose rotor commands jitter no more than allowed. These flights are short and scored from the moment the
unknown mass takes hold, so that the speed of an estimate counts. No method sees wind before the test.

In still air SEER-I leaves a filter behind it nothing to do, and errors there would tune it away. What it is for are
forces that the model does not know; so its bandwidth is found with f_theta = 0, among those that have margin and quiet
rotors with SEER-I too, and the outer loop then with SEER-I.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache, lru_cache, partial
from pathlib import Path

import control as ct
import numpy as np
from threadpoolctl import threadpool_limits

from phyfilter_ctl import sampled_open_loop
from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.learned import Chebyshev
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
from .experiment import Flights, fly, start_state
from .flights import conditions
from .methods import METHODS, Method, MethodName
from .params import params

__all__ = ["PATH", "jitter", "modulus_margin", "text", "tune", "tune_all", "tuned"]

PATH = Path(__file__).with_name("tuned.toml")
_GAINS = ("position_bandwidth", "bandwidth", "seer_rate")

# rad/s; the first below anything in the loop, the last just below the Nyquist frequency.
_OMEGA = np.geomspace(0.05, 1500.0, 300)
# s in which the hover settles, with the adaptation.
_SETTLE = 4.0
# Poles on the unit circle are states that nothing moves (an integral without gain, coefficients without excitation).
_ROUND_OFF = 1e-7
_FILTERS = ("phyfilter", "phyfilter_type2", "accelerometer")
_CHANNELS = ("F[0]", "F[2]")


def jitter(flights: Flights) -> float:
    """Noise of the rotor commands over the hover thrust: rms of their change from sample to sample, over sqrt 2.

    Parameters
    ----------
    flights : Flights
        With ``thrust`` kept.
    """
    hover = 0.25 * params().vehicle.mass * params().vehicle.gravity
    return command_jitter(flights.signals["thrust"][:, flights.counted], hover)


def modulus_margin(method: Method, model: Chebyshev | None = None) -> float:
    """Least distance of the sampled loop gain from -1 at hover; 0 where the loop is unstable.

    Parameters
    ----------
    method : Method
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    """
    return min(_margin(method, model, *point) for point in _points())


def _points() -> list[tuple[str, float]]:
    """Channels and payloads where the margin is taken, the narrowest first."""
    return [(channel, mass) for channel in _CHANNELS for mass in (params().mass.high, 0.0)]


def _margin(method: Method, model: Chebyshev | None, channel: str, added_mass: float) -> float:
    settings = method.parameters() | {
        "vehicle.quadrotor.added_mass": added_mass,
        "vehicle.quadrotor.motor_lag": params().tuning.lag_factor * params().vehicle.motor_lag,
        "controller.reference.speed": 1e-9,
    }
    if method.name == "known_mass":
        mass = params().vehicle.mass + added_mass
        settings |= {"controller.position.mass": mass, "controller.attitude.mass": mass}
    with threadpool_limits(1):  # two threads are slower on matrices of this size
        return _distance(method, model, channel, settings)


def _distance(method: Method, model: Chebyshev | None, channel: str, settings: Mapping[str, float]) -> float:
    L = sampled_open_loop(
        _diagram(method.structure, model),
        f"controller.position.{channel}",
        start_state(),
        settle=_SETTLE,
        params=settings,
    )
    through = 1.0 + float(np.asarray(L.D)[0, 0])
    closed = np.linalg.eigvals(np.asarray(L.A) - np.asarray(L.B) @ np.asarray(L.C) / through)
    if np.abs(closed).max() > 1.0 + _ROUND_OFF:
        return 0.0
    return float(np.abs(1.0 + np.asarray(frequency_response(L, _OMEGA).frdata).reshape(-1)).min())


@lru_cache(maxsize=64)
def _diagram(structure: Method, model: Chebyshev | None) -> ct.InterconnectedSystem:
    return build(structure, model)


def tune(
    name: MethodName,
    model: Chebyshev,
    *,
    seer_rate: float = 0.0,
    report: Report = silent,
    executor: Executor | None = None,
) -> TunedMethod[Method]:
    """Tune one method.

    Parameters
    ----------
    name : str
        One of ``METHODS``.
    model : Chebyshev
        Of SEER-I.
    seer_rate : float
        Of the SEER-I that a PhyFilter repairs, 1/s: that of SEER-I flown alone, which the filter is plugged onto.
    report : callable
        Called with a few words at the beginning of every step, :func:`steps` times.
    executor : Executor, optional
        What tunes the candidates; None tunes one after the other, here.
    """
    wanted = f"a modulus margin of {params().tuning.modulus_margin} and quiet rotors"
    flown = partial(_tuned, model=model)
    alone = partial(_tuned_alone, model=model, seer_rate=seer_rate) if name in _FILTERS else flown
    starts = [(f"{name}: {each.bandwidth:.3g}" if each.tunable else name, each) for each in _candidates(name)]
    best = least_error(name, starts, alone, wanted=wanted, report=report, executor=executor)
    if name not in _FILTERS:
        return best
    # Found without a model; now onto SEER-I.
    onto = _onto(best.method, seer_rate)
    return replace(least_error(name, [(name, onto)], flown, wanted=wanted), interior=best.interior)


def _onto(alone: Method, seer_rate: float) -> Method:
    return replace(alone, with_model=True, seer_rate=seer_rate)


def _tuned_alone(start: Method, model: Chebyshev, seer_rate: float) -> TunedMethod[Method] | None:
    """Without SEER-I; None too where even the slowest outer loop is not allowed with it."""
    return _tuned(start, model) if _allowed(_onto(start, seer_rate), model) else None


def _tuned(start: Method, model: Chebyshev) -> TunedMethod[Method] | None:
    method = _fastest(start, model)
    return None if method is None else _flown(method, model)


def _flown(method: Method, model: Chebyshev) -> TunedMethod[Method]:
    """What the method does on the tuning flights."""
    flights = conditions(params().seeds.tune, "mass")
    flown = fly(method, flights, model, keep=("r", "r_ref", "thrust"), duration=params().tuning.duration)
    mae = float(np.median(flown.score(whole=True).total))
    return TunedMethod(method, modulus_margin(method, model), mae, jitter(flown))


def tune_all(
    model: Chebyshev, *, report: Report = silent, executor: Executor | None = None
) -> dict[MethodName, TunedMethod[Method]]:
    """Tune every method, in the order of ``METHODS``: PhyFilters take SEER-I as it was tuned alone."""
    found: dict[MethodName, TunedMethod[Method]] = {}
    for name in METHODS:
        rate = found["seer"].method.bandwidth if "seer" in found else 0.0
        found[name] = tune(name, model, seer_rate=rate, report=report, executor=executor)
    return found


def _candidates(name: MethodName) -> Iterator[Method]:
    values = params().tuning
    start = Method(name, values.slowest, damping=values.damping, with_model=name not in _FILTERS)
    low, high = values.integral if name == "integral" else values.bandwidths
    for bandwidth in np.geomspace(low, high, values.points) if start.tunable else [0.0]:
        yield start.with_bandwidth(round(float(bandwidth), 3))


def _fastest(start: Method, model: Chebyshev) -> Method | None:
    """The method with the fastest outer loop that has the margin and quiet rotors; None where there is none."""
    values = params().tuning
    grid = np.round(np.arange(values.slowest, values.fastest + 1e-9, values.step), 6)

    def allowed(speed: float) -> Method | None:
        method = replace(start, position_bandwidth=speed)
        return method if _allowed(method, model) else None

    return fastest(grid, allowed)


def _allowed(method: Method, model: Chebyshev) -> bool:
    """Whether it has quiet rotors and the margin."""
    values, one = params().tuning, conditions(params().seeds.tune[:1], "mass")
    if jitter(fly(method, one, model, keep=("thrust",), duration=values.duration)) > values.jitter:
        return False
    return all(_margin(method, model, *at) >= values.modulus_margin for at in _points())


def steps(name: MethodName) -> int:
    """Number of reports of :func:`tune`."""
    return len(list(_candidates(name)))


def text(found: Mapping[MethodName, TunedMethod[Method]]) -> str:
    """The tuned methods as TOML."""
    header = [
        "Found by `phyfilter-ctl run drone --tune` on flights with unknown mass in still air, before any test.",
        "Rates in rad/s (1/s for SEER-I), the mean error over the tuning flights (median) in m;",
        "jitter is noise of the rotor commands over the hover thrust.",
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
    return read_tuned(PATH, METHODS, make, _GAINS, command="phyfilter-ctl run drone --tune")
