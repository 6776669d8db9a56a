"""Flying the mission, and what is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.simulation import simulate_batch
from phyfilter_ctl.study import flight_signals

from .diagram import build
from .features import trim_torque
from .flights import check_seeds, noise
from .methods import Method
from .mission import Reference, reference
from .params import Mission, params
from .seer import Seer
from .vehicle import nominal

__all__ = [
    "ESTIMATED",
    "Backend",
    "Flights",
    "Score",
    "Unknown",
    "flat_model",
    "fly",
    "start_state",
    "unknown",
]

FloatArray = NDArray[np.float64]
Backend = Literal["auto", "vm", "c"]


ESTIMATED = (
    "v_m",
    "omega_m",
    "g",
    "g_tau",
    "f_coupling",
    "f_payload",
    "f_wind",
    "tau_coupling",
    "tau_payload",
)
"""Signals that :func:`unknown` takes."""


class Unknown(NamedTuple):
    """What a filter of force or torque is to find, (B, N, 3), and what it finds it from.

    Attributes
    ----------
    x : array
        Momentum of the nominal mass or inertia as measured, kg m/s or N m s.
    g, f : array
        Known and unknown force or torque, N or N m; torque beyond what the trim carries.
    """

    x: FloatArray
    g: FloatArray
    f: FloatArray


def unknown(signals: Mapping[str, FloatArray]) -> tuple[Unknown, Unknown]:
    """Force and torque of flights that kept ``ESTIMATED``.

    Parameters
    ----------
    signals : mapping of str to (B, N, 3) array
    """
    force = signals["f_coupling"] + signals["f_payload"] + signals["f_wind"]
    torque = signals["tau_coupling"] + signals["tau_payload"] - trim_torque()
    return (
        Unknown(nominal().mass * signals["v_m"], signals["g"], force),
        Unknown(np.array(nominal().J) * signals["omega_m"], signals["g_tau"], torque),
    )


@dataclass(frozen=True, eq=False)
class Score:
    """Errors of the end effector in some flights, in m; inf where a flight failed.

    Attributes
    ----------
    mean, variance, largest : (B,) arrays
        Of |e| over the mission, start-up left out: against the planned end effector; variance in m^2.
    grasp, settle : (B,) arrays
        Largest |e| in the windows, against the object and the place.
    lift_off : (B,) array
        Largest |e| in the time after the load begins to come.
    grasped, placed : (B,) bool arrays
        Within the tolerance for the whole window; placed needs what was grasped.
    """

    mean: FloatArray
    variance: FloatArray
    largest: FloatArray
    grasp: FloatArray
    settle: FloatArray
    lift_off: FloatArray
    grasped: NDArray[np.bool_]
    placed: NDArray[np.bool_]

    @property
    def windows(self) -> FloatArray:
        """Largest |e| in both windows, (B,), m."""
        return np.maximum(self.grasp, self.settle)


@dataclass(frozen=True, eq=False)
class Flights:
    """Flights of one method.

    Attributes
    ----------
    method : Method
    seeds : tuple of int
    mission : Mission
    goals : Reference
    signals : dict of str to (B, N, k) array
        By name; those that were kept.
    message : str
        What failed, "" if nothing did.
    """

    method: Method
    seeds: tuple[int, ...]
    mission: Mission
    goals: Reference
    signals: dict[str, FloatArray]
    message: str

    @property
    def time(self) -> FloatArray:
        """s, (N,)."""
        return self.goals.time

    def error(self) -> FloatArray:
        """Distance of the end effector from where it shall be, (B, N), m."""
        return np.linalg.norm(self.signals["r_e"] - self.goals.end_effector, axis=2)

    def score(self) -> Score:
        """Errors of the end effector."""
        mission, time, error = self.mission, self.time, self.error()
        counted = error[:, time >= mission.left_out]
        failed = ~np.isfinite(error).all(axis=1)
        grasp, settle = (
            self._largest(window, place)
            for window, place in ((mission.grasp, mission.pick), (mission.settle, mission.place))
        )
        after = (time >= mission.load) & (time <= mission.load + mission.lift_off)
        grasped = ~failed & (grasp <= mission.tolerance)

        def kept(values: FloatArray) -> FloatArray:
            return np.where(failed, np.inf, values)

        return Score(
            kept(counted.mean(axis=1)),
            kept(counted.var(axis=1)),
            kept(counted.max(axis=1)),
            kept(grasp),
            kept(settle),
            kept(error[:, after].max(axis=1)),
            grasped,
            grasped & (settle <= mission.tolerance),
        )

    def _largest(self, window: tuple[float, float], place: ArrayLike) -> FloatArray:
        inside = (self.time >= window[0]) & (self.time <= window[1])
        distance = np.linalg.norm(self.signals["r_e"][:, inside] - np.asarray(place), axis=2)
        return distance.max(axis=1)


@lru_cache(maxsize=64)
def flat_model(method: Method, seer: Seer | None) -> FlatModel:
    """The flat model of a method's closed loop, with the gains left open as parameters."""
    return flatten(build(method, seer))


def start_state() -> dict[str, ArrayLike]:
    """Hover at the start of the mission, the arm at home."""
    return {"vehicle.manipulator.r": params().mission.start}


def fly(
    method: Method,
    seeds: Sequence[int],
    seer: Seer | None = None,
    *,
    mission: Mission | None = None,
    goals: Reference | None = None,
    keep: Sequence[str] = ("r_e",),
    others: Mapping[str, ArrayLike] | None = None,
    backend: Backend = "auto",
    workers: int | None = None,
) -> Flights:
    """Fly the mission once for every seed.

    Parameters
    ----------
    method : Method
    seeds : sequence of int
        Of noise and gusts.
    seer : Seer, optional
        SEER-I's models, for the methods that use them.
    mission : Mission, optional
        None means that of ``params.toml``.
    goals : Reference, optional
        Other references than those of the mission.
    keep : sequence of str
        Outputs of the diagram to keep.
    others : mapping, optional
        Other parameters of the diagram.
    backend : {"auto", "vm", "c"}
        As for ``simulate``.
    workers : int, optional
        Threads; None means one per core.

    Returns
    -------
    Flights
        A flight that fails (falls, or diverges) is NaN from there on.

    Raises
    ------
    ValueError
        Before anything flies, for a mission that cannot be flown.
    """
    seeds = check_seeds(seeds)
    mission = params().mission if mission is None else mission
    goals = reference(mission) if goals is None else goals
    samples = len(goals.time)
    wanted = goals.inputs()
    given = np.broadcast_to(wanted, (len(seeds), *wanted.shape))
    runs = simulate_batch(
        flat_model(method.structure, seer if method.uses_seer else None),
        goals.time,
        np.concatenate([given, noise(seeds, samples)], axis=1),
        start_state() | {"vehicle.manipulator.r": goals.r[0]},
        params={"vehicle.load.mass": mission.payload, **method.parameters(), **(others or {})},
        method="rk4",
        max_step=params().sampling.max_step,
        interpolation="hold",
        backend=backend,
        limits={"workers": workers},
    )
    return Flights(method, seeds, mission, goals, *flight_signals(runs, seeds, keep))
