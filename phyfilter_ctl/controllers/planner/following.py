"""The planner run over a mission, and the path it leaves as a reference for controllers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ..._sections import FloatArray
from ...results import Result, Status
from .planner import CooperativePlanner, Plan
from .problem import axes_of, end_effector
from .settings import vector

__all__ = ["Attitude", "PathSample", "PlannedPath", "follow"]

Attitude: TypeAlias = Callable[[float, FloatArray, FloatArray], tuple[ArrayLike, ArrayLike]]
"""(time, h, u_before) -> R (3, 3), omega (3,)."""


@dataclass(frozen=True, eq=False)
class PathSample:
    """A planned path at given times; (K, 3) arrays, SI units.

    Attributes
    ----------
    platform, platform_velocity, platform_acceleration : (K, 3) arrays
        Of the platform's centre of mass, world.
    arm, arm_velocity, arm_acceleration : (K, 3) arrays
        Of the end effector relative to the arm's base, body axes.
    """

    platform: FloatArray
    platform_velocity: FloatArray
    platform_acceleration: FloatArray
    arm: FloatArray
    arm_velocity: FloatArray
    arm_acceleration: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class PlannedPath(Result):
    """The first steps of one plan after the other.

    Attributes
    ----------
    times : (K + 1,) array
        s, one period apart.
    h : (K + 1, 12) array
        States.
    u : (K, 6) array
        Accelerations, each held for one period.
    end_effector : (K + 1, 3) array
        In the world, at the attitudes the planner was given.
    target : (K + 1, 3) array
        In the world.
    statuses : tuple of Status
        Status of each of the K plans.
    messages : tuple of str
        Their messages.
    solve_seconds : (K,) array
        Wall time of each plan.
    """

    times: FloatArray
    h: FloatArray
    u: FloatArray
    end_effector: FloatArray
    target: FloatArray
    statuses: tuple[Status, ...]
    messages: tuple[str, ...]
    solve_seconds: FloatArray

    def sample(self, times: ArrayLike) -> PathSample:
        """The path between its steps, accelerations held.

        Parameters
        ----------
        times : array_like, shape (K,)
            s, within ``times`` of the path.

        Returns
        -------
        PathSample
            At a step itself: the acceleration from there on; at the last one that before it.

        Raises
        ------
        ValueError
            For a time outside the path.
        """
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, last = self.times[[0, -1]]
        # A grid of samples ends on the last step but for rounding.
        margin = 1e-9 * max(1.0, abs(last))
        if t.ndim != 1 or not np.all((t >= first - margin) & (t <= last + margin)):
            raise ValueError(
                f"times: expected one row of times from {first:g} to {last:g} s, got {t.min():g} to {t.max():g}; "
                "follow for more steps"
            )
        step = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.u) - 1)
        since = (t - self.times[step])[:, None]
        p, v = axes_of(self.h[step])
        u = self.u[step]
        position, velocity = p + since * (v + 0.5 * since * u), v + since * u
        return PathSample(
            position[:, :3], velocity[:, :3], u[:, :3], position[:, 3:], velocity[:, 3:], u[:, 3:]
        )


def follow(
    planner: CooperativePlanner,
    h: ArrayLike,
    *,
    targets: ArrayLike | Callable[[float], ArrayLike],
    steps: int | None = None,
    attitude: Attitude | None = None,
    progress: Callable[[int], None] | None = None,
) -> PlannedPath:
    """Plan, take the first step, plan again.

    Parameters
    ----------
    planner : CooperativePlanner
        The planner.
    h : array_like, shape (12,)
        State at time 0: P_b, P_b', P_ed, P_ed'.
    targets : array_like, shape (K, 3), or function time -> (3,)
        Where the end effector shall be, m, world: at 0, dt, 2 dt, ..., the last one held; or as a function.
    steps : int, optional
        Number of plans; None means K - 1 for an array of targets.
    attitude : function (time, h, u_before) -> (R, omega), optional
        Attitude and angular velocity at each plan; None for level.
    progress : function of int, optional
        Called after each plan with the number of plans done.

    Returns
    -------
    PlannedPath
        A plan that failed shows in its statuses; the path goes on along the plan before.

    Raises
    ------
    ValueError
        Before anything is solved: for a target out of reach, or a start outside the limits or that cannot stop
        within them.

    Examples
    --------
    >>> from phyfilter_ctl.controllers.planner import CooperativePlanner, PlannerLimits, follow
    >>> limits = PlannerLimits([[-3, -3, 0.3], [3, 3, 2.5]], [[0.2, -0.15, -0.3], [0.4, 0.15, -0.1]])
    >>> h = [0, 0, 1.2, 0, 0, 0, 0.3, 0, -0.2, 0, 0, 0]
    >>> path = follow(CooperativePlanner(limits), h, targets=lambda t: [1.0, 0.2, 0.8], steps=60)
    >>> set(map(str, path.statuses)), bool(abs(path.end_effector[-1] - [1.0, 0.2, 0.8]).max() < 2e-3)
    ({'optimal'}, True)
    >>> path.sample([0.0, 0.1]).platform.shape
    (2, 3)
    """
    dt, N = planner.dt, planner.horizon
    state = vector("h", h, (12,))
    aims, steps = _targets(targets, steps, dt, N)
    planner.check_targets(aims)
    broken = planner.complaint(state)
    if broken:
        raise ValueError(f"h: {broken}; start inside the limits")
    times: FloatArray = np.float64(dt) * np.arange(steps + 1)
    attitudes: list[tuple[ArrayLike, ArrayLike]] = []
    plans: list[Plan] = []
    u = np.zeros(6)
    plan: Plan | None = None
    for k in range(steps):
        attitudes.append((np.eye(3), np.zeros(3)) if attitude is None else attitude(times[k], state, u))
        R, omega = attitudes[-1]
        plan = planner.plan(state, u, target=aims[k + 1 : k + 1 + N], R=R, omega=omega, before=plan)
        state, u = plan.h[1], plan.u[0]
        plans.append(plan)
        if progress is not None:
            progress(k + 1)
    attitudes.append(attitudes[-1] if attitude is None else attitude(times[-1], state, u))
    h_path = np.vstack([plans[0].h[:1], [plan.h[1] for plan in plans]])
    turned = np.array([np.asarray(R, dtype=np.float64) for R, _ in attitudes])
    return PlannedPath(
        times,
        h_path,
        np.array([plan.u[0] for plan in plans]),
        end_effector(h_path, np.asarray(planner.mount, dtype=np.float64), turned),
        aims[: steps + 1],
        tuple(plan.status for plan in plans),
        tuple(plan.message for plan in plans),
        np.array([plan.solve_seconds for plan in plans]),
    )


def _targets(
    targets: ArrayLike | Callable[[float], ArrayLike], steps: int | None, dt: float, horizon: int
) -> tuple[FloatArray, int]:
    """Targets at every step of every plan, (steps + 1 + horizon, 3), and the number of steps."""
    given = None
    if not callable(targets):
        given = np.asarray(targets, dtype=np.float64)
        if given.ndim != 2 or given.shape[1] != 3 or len(given) < 2:
            raise ValueError(f"targets: expected at least 2 rows of 3 coordinates, got shape {given.shape}")
        steps = len(given) - 1 if steps is None else steps
    if steps is None or isinstance(steps, bool) or not isinstance(steps, int) or steps < 1:
        raise ValueError(
            f"steps: expected a whole number >= 1, got {steps!r}; a function of targets needs one"
        )
    count = steps + 1 + horizon
    if given is not None:
        return vector("targets", given[np.minimum(np.arange(count), len(given) - 1)], (count, 3)), steps
    assert callable(targets)
    return np.array([vector("targets", targets(dt * k), (3,)) for k in range(count)]), steps
