"""The mission: where the end effector shall be, what the planner makes of it, and when the load comes and goes.

The planner runs from its own planned states, so it is a generator of references: it depends on neither noise nor
method, and every flight has the same references.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d
from threadpoolctl import threadpool_limits

from phyfilter_ctl.controllers import CooperativePlanner, PlannedPath, PlannerLimits, follow
from phyfilter_ctl.controllers.planner import Attitude
from phyfilter_ctl.plants import SerialArm, small_arm
from phyfilter_ctl.study import flight_times

from .params import Mission, params

__all__ = ["Reference", "arm", "changed", "check", "home_offset", "planner", "reference", "target", "timepts"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reference:
    """What a flight is asked to do, at the samples.

    Attributes
    ----------
    time : (N,) array
        s.
    r, v, a, j : (N, 3) arrays
        Platform: position, velocity, acceleration, jerk; world.
    offset, offset_rate : (N, 3) arrays
        End effector less platform, along the world's axes, m and m/s.
    taken : (N,) array
        Share of the load that hangs at the gripper, 0 to 1.
    path : PlannedPath
        What the planner gave, with its solve times.
    """

    time: FloatArray
    r: FloatArray
    v: FloatArray
    a: FloatArray
    j: FloatArray
    offset: FloatArray
    offset_rate: FloatArray
    taken: FloatArray
    path: PlannedPath

    @property
    def end_effector(self) -> FloatArray:
        """Where the end effector shall be, (N, 3), m, world."""
        return self.r + self.offset

    def inputs(self) -> FloatArray:
        """Inputs of the diagram, (19, N): r_ref, v_ref, a_ref, j_ref, d_ref, d_rate_ref, taken."""
        parts = (self.r, self.v, self.a, self.j, self.offset, self.offset_rate, self.taken[:, None])
        return np.ascontiguousarray(np.hstack(parts).T)


@lru_cache(maxsize=1)
def arm() -> SerialArm:
    """The arm."""
    return small_arm()


def home_offset() -> FloatArray:
    """End effector less platform with the arm at home, m, body axes."""
    return np.asarray(arm().end_effector(arm().home), dtype=float)


def timepts(duration: float | None = None) -> FloatArray:
    """The instants of a flight, s."""
    return flight_times(params().mission.duration if duration is None else duration, params().sampling.dt)


def planner() -> CooperativePlanner:
    """The cooperative planner with the limits of ``params.toml`` and the paper's weights."""
    values = params().planner
    limits = PlannerLimits(
        values.platform,
        values.workspace,
        platform_velocity=values.platform_velocity,
        arm_velocity=values.arm_velocity,
        platform_acceleration=values.platform_acceleration,
        arm_acceleration=values.arm_acceleration,
    )
    return CooperativePlanner(limits, arm().mount, horizon=values.horizon)


def target(mission: Mission) -> Callable[[float], FloatArray]:
    """Where the end effector shall be: from knot to knot with s^3 (10 - 15 s + 6 s^2), held in between.

    Parameters
    ----------
    mission : Mission

    Returns
    -------
    function of time (s) -> (3,) array (m, world)
    """
    above = np.array([0.0, 0.0, mission.clearance])
    pick, place = np.array(mission.pick), np.array(mission.place)
    places = [np.array(mission.start) + home_offset(), pick + above, pick, pick + above, place + above, place]
    places.append(place + above)
    spans = (mission.approach, mission.descend, mission.lift, mission.carry, mission.lower, mission.leave)

    def at(t: float) -> FloatArray:
        point = places[0]
        for (begin, end), goal in zip(spans, places[1:], strict=True):
            s = float(np.clip((t - begin) / (end - begin), 0.0, 1.0))
            point = point + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * (goal - point)
        return point

    return at


def check(mission: Mission) -> None:
    """Refuse a mission that cannot be flown.

    Parameters
    ----------
    mission : Mission

    Raises
    ------
    ValueError
        Before anything is planned: for times out of order, a load that is negative or too heavy, or a target out of
        reach.
    """
    order = (
        *(*mission.approach, *mission.descend, *mission.grasp, mission.load, *mission.lift),
        *(*mission.carry, *mission.lower, *mission.settle, mission.release, *mission.leave, mission.duration),
    )
    if any(later < earlier for earlier, later in pairwise(order)):
        raise ValueError(
            f"mission: expected times in order, from approach to duration, got {[*map(float, order)]}"
        )
    vehicle = params().vehicle
    for name, value, unit in (("payload", mission.payload, "kg"), ("transfer", mission.transfer, "s")):
        if not (np.isfinite(value) and value >= 0.0):
            raise ValueError(f"{name}: expected 0 {unit} or more, got {value}")
    weight = (vehicle.mass + arm().mass + mission.payload) * vehicle.gravity
    most = 4.0 * vehicle.rotor_max
    if weight > _USABLE * most:
        raise ValueError(
            f"payload: with {mission.payload:g} kg the vehicle weighs {weight:.1f} N, expected at most "
            f"{100 * _USABLE:.0f} % of the rotors' {most:.1f} N: take a lighter load"
        )
    corners = np.array(params().planner.workspace)
    box = np.array(np.meshgrid(*corners.T)).reshape(3, -1).T
    arm().check_reachable(box + arm().mount)
    planner().check_targets([mission.pick, mission.place])


# Of the rotors' thrust: what is left for attitude control and wind.
_USABLE = 0.85


def reference(mission: Mission | None = None, *, attitude: Attitude | None = None) -> Reference:
    """Plan the mission.

    Parameters
    ----------
    mission : Mission, optional
        None means that of ``params.toml``.
    attitude : function (time, h, u_before) -> (R, omega), optional
        Attitude and angular velocity that the planner is told at each plan; None for level.

    Returns
    -------
    Reference

    Raises
    ------
    ValueError
        As for :func:`check`.

    Examples
    --------
    >>> goals = reference()
    >>> window = (goals.time >= 7.0) & (goals.time <= 8.0)
    >>> bool(np.abs(goals.end_effector[window] - params().mission.pick).max() < 1e-3)
    True
    """
    return _reference(params().mission if mission is None else mission, attitude)


@lru_cache(maxsize=8)
def _reference(mission: Mission, attitude: Attitude | None) -> Reference:
    check(mission)
    plans = planner()
    period, dt = plans.dt, params().sampling.dt
    h = np.zeros(12)
    h[:3], h[6:9] = mission.start, home_offset() - arm().mount
    steps = int(np.ceil((mission.duration + period) / period))
    with threadpool_limits(1):  # on matrices of this size threads wait for each other
        path = follow(plans, h, targets=target(mission), steps=steps, attitude=attitude)
    time = timepts(mission.duration)
    # The planner's accelerations jump; averaged over a period, as the plan ahead allows, they are continuous. Position,
    # velocity and acceleration are averaged alike, so that they still are each other's derivatives.
    width = 2 * round(0.5 * period / dt) + 1
    margin = width // 2 + 1
    wide = dt * np.arange(-margin, len(time) + margin)
    sampled = path.sample(np.clip(wide, 0.0, path.times[-1]))
    before = (wide < 0.0)[:, None]
    still = {"platform_velocity", "platform_acceleration", "arm_velocity"}

    def smooth(name: str) -> FloatArray:
        values = getattr(sampled, name)
        values = np.where(before, 0.0, values) if name in still else values
        return uniform_filter1d(values, width, axis=0, mode="nearest")

    keep = slice(margin, -margin)
    acceleration = smooth("platform_acceleration")
    return Reference(
        time,
        smooth("platform")[keep],
        smooth("platform_velocity")[keep],
        acceleration[keep],
        np.diff(acceleration, axis=0)[keep.start : keep.start + len(time)] / dt,
        smooth("arm")[keep] + arm().mount,
        smooth("arm_velocity")[keep],
        _taken(time, mission),
        path,
    )


def _taken(time: FloatArray, mission: Mission) -> FloatArray:
    """Share of the load that hangs, on straight lines over the transfer time."""
    comes, goes = (_ramp(time, begin, mission.transfer) for begin in (mission.load, mission.release))
    return comes - goes


def _ramp(time: FloatArray, begin: float, length: float) -> FloatArray:
    return np.clip((time - begin) / max(length, params().sampling.dt), 0.0, 1.0)


def changed(
    mission: Mission | None = None,
    *,
    pick: ArrayLike | None = None,
    place: ArrayLike | None = None,
    payload: float | None = None,
    transfer: float | None = None,
) -> Mission:
    """A mission with other places, another load, or another time in which it comes and goes.

    Parameters
    ----------
    mission : Mission, optional
        None means that of ``params.toml``.
    pick, place : (3,) array, optional
        m, world.
    payload : float, optional
        kg.
    transfer : float, optional
        s.
    """
    mission = params().mission if mission is None else mission
    for name, point in (("pick", pick), ("place", place)):
        if point is not None:
            x, y, z = np.asarray(point, dtype=float).tolist()
            mission = replace(mission, **{name: (x, y, z)})
    for name, value in (("payload", payload), ("transfer", transfer)):
        if value is not None:
            mission = replace(mission, **{name: float(value)})
    return mission
