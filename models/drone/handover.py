"""The tuned filter handed over: as FMUs and as C, each replayed on a recorded flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import control as ct
import numpy as np

from phyfilter_ctl import SampledPhyFilter, fmi
from phyfilter_ctl.fmi import HandOver, Reference
from phyfilter_ctl.learned import Chebyshev

from .diagram import controller_part, filter_part, vehicle_part
from .experiment import Flights, fly
from .flights import Scenario, conditions
from .methods import Method, estimator
from .params import params

__all__ = [
    "controller_system",
    "filter_system",
    "hand_over",
    "record_flight",
    "sampled_filter",
    "vehicle_system",
]

_NAME = "drone_filter"
_AXES = range(3)
_NAMES = ("x", "y", "z")
_UNITS = {"x": "kg m/s", "g": "N", "f": "N"}
# Of the exports of the repository: a method that needs no training.
_PLAIN = Method("observer", 2.0, 6.0)


def sampled_filter(method: Method) -> SampledPhyFilter:
    """The PhyFilter that a method flies with.

    Parameters
    ----------
    method : Method

    Raises
    ------
    ValueError
        If the method has none.

    Examples
    --------
    >>> sampled_filter(Method("observer", 2.0, 6.0)).filter.a.tolist()
    [6.0]
    """
    block = estimator(method)
    if block is None or block.filter is None:
        raise ValueError(
            f"{method.name}: expected a method with a PhyFilter (observer, phyfilter, phyfilter_type2) to hand over"
        )
    return block.filter.sampled


def record_flight(
    method: Method,
    model: Chebyshev | None = None,
    *,
    seed: int = 0,
    scenario: Scenario = "wind",
    duration: float | None = None,
) -> Flights:
    """One flight in CasADi's virtual machine, with the signals at the filter.

    Parameters
    ----------
    method : Method
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    seed : int
    scenario : {"mass", "wind"}
    duration : float, optional
        s; None means that of ``params.toml``.

    Raises
    ------
    ValueError
        If the method has no PhyFilter.

    Examples
    --------
    >>> record_flight(Method("observer", 2.0, 6.0), duration=0.1).signals["f_hat"].shape
    (1, 51, 3)
    """
    sampled_filter(method)
    keep = ("r", "r_ref", "v_m", "g", "f_hat", *(("f_theta",) if method.uses_seer else ()))
    # Not in C: what it is compared with is.
    return fly(method, conditions([seed], scenario), model, keep=keep, duration=duration, backend="vm")


def hand_over(
    method: Method,
    model: Chebyshev | None,
    folder: str | Path,
    *,
    flight: Flights | None = None,
) -> HandOver:
    """Export the filter of a method as C and FMU (FMI 2.0 and 3.0), and replay a flight through all of them.

    FMPy runs the FMUs: it shares no code with what made them.

    Parameters
    ----------
    method : Method
    model : Chebyshev or None
        SEER-I's model, for the methods that use it; it flies where ``flight`` is None.
    folder : str or Path
        As for :func:`phyfilter_ctl.fmi.hand_over`; the files are called drone_filter.
    flight : Flights, optional
        Of this method, with v_m, g, f_hat and, where it has one, f_theta; its first one is replayed. None: the one of
        :func:`record_flight`.

    Raises
    ------
    ValueError
        If the method has no PhyFilter, or the flight lacks a signal or failed.
    FileNotFoundError, FileExistsError, CompilerError
        As for :func:`phyfilter_ctl.fmi.hand_over`.
    """
    sampled = sampled_filter(method)
    return fmi.hand_over(
        replace(sampled, sampling=replace(sampled.sampling, channels=_NAMES, units=_UNITS)),
        folder,
        lambda: _record(method, record_flight(method, model) if flight is None else flight),
        name=_NAME,
        importer="fmpy",
    )


def vehicle_system() -> ct.InterconnectedSystem:
    """The vehicle in still air, for its export: commands and noise in, measurements and truth out."""
    return vehicle_part()


def controller_system() -> ct.InterconnectedSystem:
    """The controller at 2 rad/s, for its export."""
    return controller_part(_PLAIN)


def filter_system() -> ct.InterconnectedSystem:
    """The observer of order 1 at 6 rad/s with its known force, for its export."""
    part = filter_part(_PLAIN)
    assert part is not None
    return part


def _record(method: Method, flight: Flights) -> Reference:
    """Inputs and output of the filter in one flight."""
    if flight.method != method:
        raise ValueError(
            f"flight: expected one of {method.name} with these gains, got one of {flight.method.name}"
        )
    needed = ["v_m", "g", "f_hat", *(["f_theta"] if method.uses_seer else [])]
    missing = [name for name in needed if name not in flight.signals]
    if missing:
        raise ValueError(
            f"flight: expected the signals {', '.join(needed)}, got none called {', '.join(missing)}; "
            "record_flight keeps them"
        )
    signals = {name: flight.signals[name][0] for name in needed}
    if not all(np.isfinite(values).all() for values in signals.values()):
        raise ValueError(f"flight: expected one that came to its end; {flight.message}")
    x, g, f_hat = params().vehicle.mass * signals["v_m"], signals["g"], signals["f_hat"]
    inputs = {"x": x, "g": g, "f_theta": signals.get("f_theta", np.zeros_like(g))}
    return Reference(
        flight.time,
        {f"{name}[{i}]": values[:, i] for name, values in inputs.items() for i in _AXES},
        {f"f_hat[{i}]": f_hat[:, i] for i in _AXES},
    )
