"""What can be flown of the circle, ``phyfilter_ctl.plants.circle``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from .params import Mission, Vehicle, params

__all__ = ["check_feasible", "flown"]


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
