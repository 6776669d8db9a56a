"""Test, tuning and training flights: what is drawn for a seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.study import flight_times

from .params import params

__all__ = ["Conditions", "Scenario", "conditions", "timepts"]

FloatArray = NDArray[np.float64]

Scenario = Literal["mass", "wind"]


@dataclass(frozen=True)
class Conditions:
    """What the flights of some seeds meet.

    Attributes
    ----------
    seeds : tuple of int
    added_mass : (B,) array
        kg.
    jet_speed : (B,) array
        m/s; 0 where there is no wind.
    mean : (B, 3) array
        Wind of the hall, m/s.
    """

    seeds: tuple[int, ...]
    added_mass: FloatArray
    jet_speed: FloatArray
    mean: FloatArray

    def parameters(self) -> dict[str, FloatArray]:
        """Parameters of the diagram, one row a flight."""
        return {
            "vehicle.quadrotor.added_mass": self.added_mass,
            "vehicle.wind.jet_speed": self.jet_speed,
            "vehicle.wind.mean": self.mean,
        }


def conditions(
    seeds: Sequence[int],
    scenario: Scenario,
    *,
    strength: float = 1.0,
    payload: tuple[float, float] | None = None,
) -> Conditions:
    """Mass and wind of some flights; the mass of a seed is the same in both scenarios.

    Parameters
    ----------
    seeds : sequence of int
        Not negative.
    scenario : {"mass", "wind"}
        Unknown mass in still air; the same masses in wind.
    strength : float
        Factor on the wind.
    payload : (float, float), optional
        Range of the unknown mass, kg; None means that of ``params.toml``.

    Raises
    ------
    ValueError
        For an unknown scenario, negative seeds, a negative factor or an empty or negative range of masses.

    Examples
    --------
    >>> still, windy = (conditions([3], kind) for kind in ("mass", "wind"))
    >>> bool(still.added_mass == windy.added_mass), still.jet_speed.tolist(), bool(4.0 < windy.jet_speed[0] < 6.0)
    (True, [0.0], True)
    """
    if scenario not in ("mass", "wind"):
        raise ValueError(f"scenario: expected 'mass' or 'wind', got {scenario!r}")
    if any(seed < 0 for seed in seeds):
        raise ValueError(f"seeds: expected 0 or more, got {list(seeds)}")
    if not (np.isfinite(strength) and strength >= 0.0):
        raise ValueError(f"strength: expected 0 or more, got {strength}")
    low, high = (params().mass.low, params().mass.high) if payload is None else payload
    if not 0.0 <= low <= high < np.inf:
        raise ValueError(f"payload: expected 0 <= least <= greatest mass in kg, got {low:g} and {high:g}")
    wind = params().wind
    drawn = np.array([np.random.default_rng([seed, 0]).random(3) for seed in seeds])
    added = low + (high - low) * drawn[:, 0]
    blow = strength if scenario == "wind" else 0.0
    speed = blow * (wind.jet_speed_low + (wind.jet_speed_high - wind.jet_speed_low) * drawn[:, 1])
    angle = 2.0 * np.pi * drawn[:, 2]
    mean = blow * wind.mean * np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    return Conditions(tuple(seeds), added, speed, mean)


def timepts(duration: float | None = None) -> FloatArray:
    """The instants of a flight, s."""
    return flight_times(params().mission.duration if duration is None else duration, params().sampling.dt)
