"""Flying the circle, and what is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.simulation import BackendChoice, simulate_batch
from phyfilter_ctl.study import flight_signals, unit_noise

from .diagram import NOISES, build
from .events import EVENTS
from .flights import Conditions, timepts
from .methods import Method
from .params import params
from .reference import check_feasible, flown

__all__ = ["Flights", "Score", "flat_model", "fly", "start_state"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """Tracking errors of some flights, start-up left out, in m.

    Attributes
    ----------
    total, horizontal, vertical : (B,) array
        Mean over time of |e|, of its horizontal part and of its vertical part. inf where a flight failed.
    """

    total: FloatArray
    horizontal: FloatArray
    vertical: FloatArray


@dataclass(frozen=True)
class Flights:
    """Flights of one method.

    Attributes
    ----------
    method : Method
    conditions : Conditions
    time : (N,) array
        s.
    signals : dict of str to (B, N, k) array
        By name; those that were kept.
    message : str
        What failed, "" if nothing did.
    """

    method: Method
    conditions: Conditions
    time: FloatArray
    signals: dict[str, FloatArray]
    message: str

    @property
    def counted(self) -> slice:
        """Samples after the start-up."""
        return slice(int(np.searchsorted(self.time, params().mission.left_out)), None)

    def score(self, *, whole: bool = False) -> Score:
        """Tracking errors; ``whole`` counts the start-up too."""
        e = (self.signals["r"] - self.signals["r_ref"])[:, slice(None) if whole else self.counted]
        parts = [np.linalg.norm(e, axis=2), np.linalg.norm(e[..., :2], axis=2), np.abs(e[..., 2])]
        means = [np.where(np.isfinite(part).all(axis=1), part.mean(axis=1), np.inf) for part in parts]
        return Score(*means)


@lru_cache(maxsize=32)
def flat_model(method: Method, model: Chebyshev | None, events: bool = False) -> FlatModel:
    """The flat model of a method's closed loop, with the gains left open as parameters."""
    return flatten(build(method, model, events=events))


def start_state(radius: float | None = None) -> dict[str, ArrayLike]:
    """Hover on the circle, at its first point; a radius of None means that of ``params.toml``."""
    mission = params().mission
    return {"vehicle.quadrotor.r": [mission.radius if radius is None else radius, 0.0, mission.height]}


def fly(
    method: Method,
    conditions: Conditions,
    model: Chebyshev | None = None,
    *,
    keep: Sequence[str] = ("r", "r_ref"),
    duration: float | None = None,
    others: Mapping[str, ArrayLike] | None = None,
    backend: BackendChoice = "auto",
    workers: int | None = None,
) -> Flights:
    """Fly the circle once for every seed.

    Parameters
    ----------
    method : Method
    conditions : Conditions
        Masses and winds.
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    keep : sequence of str
        Outputs of the diagram to keep.
    duration : float, optional
        s; None means that of ``params.toml``.
    others : mapping, optional
        Other parameters of the diagram; those of ``EVENTS`` let the payload drop or a motor turn weak.
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
        Before anything flies, if the rotors cannot hold the circle.
    """
    given = dict(others or {})
    mission, vehicle = flown(given), params().vehicle
    check_feasible(mission.speed, mission.radius, vehicle.mass + float(conditions.added_mass.max()))
    time = timepts(duration)
    flat = flat_model(method.structure, model, any(name in given for name in EVENTS))
    settings = {**conditions.parameters(), **method.parameters(), **given}
    if method.name == "known_mass":
        known = vehicle.mass + conditions.added_mass
        settings |= {"controller.position.mass": known, "controller.attitude.mass": known}
    if method.payload == "told":
        settings |= {"estimator.told.mass": conditions.added_mass}
    runs = simulate_batch(
        flat,
        time,
        unit_noise(conditions.seeds, 3 * len(NOISES), len(time)),
        start_state(mission.radius),
        params=settings,
        method="rk4",
        max_step=params().sampling.max_step,
        interpolation="hold",
        backend=backend,
        limits={"workers": workers},
    )
    return Flights(method, conditions, time, *flight_signals(runs, conditions.seeds, keep))
