"""The circle as a block: position, velocity, acceleration and jerk over time.

    r = (R cos phi, R sin phi, h),   phi' = (V/R) S(t/T),   S(s) = s^3 (10 - 15 s + 6 s^2) up to s = 1, then 1

so that jerk is continuous and the flight begins at rest on the circle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from phyfilter_ctl.blocks import BlockFunctions, FunctionBlock, Variable

from .params import Mission, Vehicle, params

__all__ = ["check_feasible", "circle", "flown"]

_AXES = range(3)


def circle(mission: Mission | None = None) -> FunctionBlock:
    """The reference as a static block of time.

    Parameters
    ----------
    mission : Mission, optional
        None means that of ``params.toml``. Speed, radius, height and ramp become parameters of the block.

    Returns
    -------
    FunctionBlock
        Named "reference", outputs r_ref, v_ref, a_ref and j_ref in m, m/s, m/s^2, m/s^3.

    Examples
    --------
    >>> r, v, a, j = np.split(np.asarray(circle()._out(60.0, [], [])), 4)
    >>> round(float(np.hypot(*v[:2])), 9), round(float(np.hypot(*a[:2])), 9)
    (2.0, 2.666666667)
    """
    mission = params().mission if mission is None else mission
    starts = {
        "speed": (mission.speed, "m/s"),
        "radius": (mission.radius, "m"),
        "height": (mission.height, "m"),
        "ramp": (mission.ramp, "s"),
    }
    parameters = tuple(Variable(name, value, unit) for name, (value, unit) in starts.items())
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 0), ca.SX.sym("u", 0), ca.SX.sym("p", len(parameters))
    speed, radius, height, ramp = ca.vertsplit(p)
    s = ca.fmax(ca.fmin(t / ramp, 1.0), 0.0)
    rate = speed / radius
    # phi from 0, with the rest of a whole ramp flown at full speed.
    phi = rate * (ramp * s**4 * (2.5 - 3.0 * s + s**2) + ca.fmax(t - ramp, 0.0))
    d1 = rate * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    d2 = rate / ramp * 30.0 * s**2 * (1.0 - s) ** 2
    d3 = rate / ramp**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
    radial, along = ca.vertcat(ca.cos(phi), ca.sin(phi), 0.0), ca.vertcat(-ca.sin(phi), ca.cos(phi), 0.0)
    outputs = {
        "r_ref": (radius * radial + ca.vertcat(0.0, 0.0, height), "m"),
        "v_ref": (radius * d1 * along, "m/s"),
        "a_ref": (radius * (d2 * along - d1**2 * radial), "m/s^2"),
        "j_ref": (radius * ((d3 - d1**3) * along - 3.0 * d1 * d2 * radial), "m/s^3"),
    }
    functions = BlockFunctions(
        (),
        (),
        tuple(Variable(f"{name}[{i}]", 0.0, unit) for name, (_, unit) in outputs.items() for i in _AXES),
        parameters,
        ca.Function("dynamics", [t, x, u, p], [ca.DM(0, 1)]),
        ca.Function("output", [t, x, u, p], [ca.vertcat(*[value for value, _ in outputs.values()])]),
    )
    return FunctionBlock(functions, "reference", None)


def flown(others: Mapping[str, ArrayLike] | None = None) -> Mission:
    """The mission of ``params.toml`` on the circle that is flown.

    Parameters
    ----------
    others : mapping, optional
        Parameters of the diagram; of several radii and speeds the largest count.

    Examples
    --------
    >>> found = flown({"controller.reference.speed": 3.0})
    >>> found.radius, found.speed
    (1.5, 3.0)
    """
    given, mission = others or {}, params().mission

    def largest(name: str, default: float) -> float:
        return float(np.max(np.asarray(given.get(f"controller.reference.{name}", default), dtype=float)))

    return replace(mission, radius=largest("radius", mission.radius), speed=largest("speed", mission.speed))


# Of the rotors' thrust: what is left for attitude control and wind.
_USABLE = 0.85


def check_feasible(speed: float, radius: float, mass: float, vehicle: Vehicle | None = None) -> None:
    """Raise where the rotors cannot hold the circle.

    Parameters
    ----------
    speed, radius : float
        m/s, m.
    mass : float
        Heaviest mass in all, kg.
    vehicle : Vehicle, optional
        None means that of ``params.toml``.

    Raises
    ------
    ValueError
        Before anything flies: for numbers that are not positive, or a circle that needs more than 85 % of the thrust.

    Examples
    --------
    >>> check_feasible(12.0, 1.5, 3.9)
    Traceback (most recent call last):
    ...
    ValueError: a circle of 1.5 m at 12 m/s takes 376.5 N with 3.9 kg, more than 85 % of the rotors' 64.8 N: fly slower
    than 3.9 m/s, or on a larger circle
    """
    vehicle = params().vehicle if vehicle is None else vehicle
    for name, value, unit in (("speed", speed, "m/s"), ("radius", radius, "m"), ("mass", mass, "kg")):
        if not (np.isfinite(value) and value > 0.0):
            raise ValueError(f"{name}: expected a positive number of {unit}, got {value:g}")
    most = 4.0 * vehicle.rotor_max
    needed = _thrust(speed, radius, mass, vehicle)
    if needed <= _USABLE * most:
        return
    if mass * vehicle.gravity > _USABLE * most:
        raise ValueError(
            f"{mass:g} kg weigh {mass * vehicle.gravity:.1f} N, more than {100 * _USABLE:.0f} % of the rotors' "
            f"{most:.1f} N: take a smaller mass"
        )
    low, high = 0.0, speed
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _thrust(middle, radius, mass, vehicle) <= _USABLE * most else (low, middle)
        )
    raise ValueError(
        f"a circle of {radius:g} m at {speed:g} m/s takes {needed:.1f} N with {mass:g} kg, more than "
        f"{100 * _USABLE:.0f} % of the rotors' {most:.1f} N: fly slower than {low:.3g} m/s, or on a larger circle"
    )


def _thrust(speed: float, radius: float, mass: float, vehicle: Vehicle) -> float:
    """Thrust in N that holds the circle in still air: weight, centripetal force and drag."""
    return float(
        np.hypot(np.hypot(mass * vehicle.gravity, mass * speed**2 / radius), max(vehicle.drag) * speed)
    )
