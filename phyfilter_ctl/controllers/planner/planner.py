"""Cooperative planner of an aerial manipulator: platform and arm share the way to the target."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from time import perf_counter
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _signals
from ..._sections import FloatArray
from ...results import Result, Status
from .problem import (
    ROUNDING,
    Horizon,
    QuadraticProgram,
    RotationPrediction,
    axes_of,
    braking,
    end_effector,
    quadratic_program,
    roll_out,
    rotations,
)
from .settings import AXES, PlannerLimits, PlannerWeights, vector
from .solver import ConicSolver, SolverName

__all__ = ["CooperativePlanner", "Plan"]


# A solution that oversteps a limit by more than this (m, m/s, m/s^2) is no solution.
_ACCEPTED = 1e-6
# A measured rotation may be this far from orthogonal.
_ORTHOGONAL = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Result):
    """States and accelerations over the horizon.

    Attributes
    ----------
    h : (N + 1, 12) array
        States from now on: platform position and velocity (world), end effector position and velocity relative to
        the arm's base (body axes); m, m/s.
    u : (N, 6) array
        Accelerations of platform and end effector, each held for one period, m/s^2.
    end_effector : (N, 3) array
        Predicted position of the end effector at the steps 1 to N, m, world.
    status : Status
        OPTIMAL, KEPT or BRAKING.
        kept: the plan before, one step on, because this solve failed or came late; braking: there was none before,
        so every axis stops.
    message : str
        What happened and what to try; empty for OPTIMAL.
    solve_seconds : float
        Wall time of the call.
    age : int
        Steps since the plan was solved; 0 for OPTIMAL.

    A plan ends at rest or in a state from which it can stop within its limits.
    """

    h: FloatArray
    u: FloatArray
    end_effector: FloatArray
    status: Status
    message: str
    solve_seconds: float
    age: int


@dataclass(frozen=True, eq=False)
class CooperativePlanner:
    """Model-predictive planner of platform and end effector by a quadratic programme.

        min  sum_i |e_i|^2_Lambda1 + |u_i - u_{i-1}|^2_Lambda2 + |y_i - y_{i-1}|^2_Lambda3
        e_i = target_i - P_b,i - R_i (P_o + P_ed,i)

    with h = (P_b, P_b', P_ed, P_ed'), u = (P_b'', P_ed''), y = (P_b, P_ed), limits at the steps, and a last state that
    can stop inside its box. With the stopping condition a plan that exists now has a successor at the next instant
    (recursive feasibility), whatever the target does. Limits hold at the steps, to 2e-6 (3e-6 for a box without
    width); in between a position may overstep by a dt^2 / 8.

    Parameters
    ----------
    limits : PlannerLimits
        Boxes of positions, velocities, accelerations.
    mount : array_like, shape (3,)
        P_o, from the platform's centre of mass to the arm's base, m, body axes.
    horizon : int
        Number N of steps.
    dt : float
        dt, seconds.
    weights : PlannerWeights
        Lambda_1 to Lambda_3.
    rotation : "euler" or "exponential"
        How the attitude is predicted from the angular velocity: R_i = R_{i-1} + dt R_{i-1} [omega]x, or exactly.
    solver : "daqp", "qpoases", "piqp" or "osqp"
        CasADi's plugin. daqp, a dual active-set method, is the fastest and exact; osqp fails now and then
        (benchmarks/planner.py).
    time_limit : float, optional
        Seconds; a solve that took longer has come late and the plan before is kept. It is checked when the solver
        returns; the solver's own iteration limit bounds the wait. None, which repeats a run exactly, means no limit.
    tilt_limit : float
        Largest tilt of the platform, rad, that the check of a target's reach allows for.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    Notes
    -----
    The supplement of the paper, "Trajectory generation of aerial manipulator". Its matrix A has a zero for the block
    of the end effector's velocity, which is the identity. Its end effector, P_b - R P_o - R P_ed, has the signs of
    offsets counted from the effector upwards: with a world that points down and an arm that hangs in front the two
    minus signs would put the gripper behind and above. Here the world's z axis points up, offsets go from the
    centre of mass to the base and on to the effector, and both signs are plus. The states are eliminated, which
    leaves 6 N unknowns.

    Examples
    --------
    >>> limits = PlannerLimits([[-3, -3, 0.3], [3, 3, 2.5]], [[0.2, -0.15, -0.3], [0.4, 0.15, -0.1]])
    >>> planner = CooperativePlanner(limits, [0.05, 0.0, -0.05])
    >>> h = [0, 0, 1.2, 0, 0, 0, 0.3, 0, -0.2, 0, 0, 0]
    >>> plan = planner.plan(h, target=[0.45, 0.05, 1.0])
    >>> str(plan.status), plan.u.shape
    ('optimal', (15, 6))
    >>> bool(np.linalg.norm(plan.end_effector[-1] - [0.45, 0.05, 1.0]) < 5e-3)
    True
    """

    limits: PlannerLimits
    mount: ArrayLike = (0.0, 0.0, 0.0)
    _: KW_ONLY
    horizon: int = 15
    dt: float = 0.07
    weights: PlannerWeights = field(default_factory=PlannerWeights)
    rotation: RotationPrediction = "euler"
    solver: SolverName = "daqp"
    time_limit: float | None = None
    tilt_limit: float = 0.35

    def __post_init__(self) -> None:
        object.__setattr__(self, "mount", vector("mount", self.mount, (3,)))
        if isinstance(self.horizon, bool) or not isinstance(self.horizon, int) or self.horizon < 2:
            raise ValueError(f"horizon: expected a whole number of steps >= 2, got {self.horizon!r}")
        for name, seconds in (("dt", self.dt), ("time_limit", self.time_limit)):
            if seconds is None and name == "time_limit":
                continue
            if seconds is None or not (np.isfinite(seconds) and seconds > 0.0):
                raise ValueError(f"{name}: expected seconds > 0, got {seconds!r}")
        if not 0.0 <= self.tilt_limit <= np.pi:
            raise ValueError(f"tilt_limit: expected 0 to pi rad, got {self.tilt_limit!r}")
        for name, value, known in (
            ("rotation", self.rotation, get_args(RotationPrediction)),
            ("solver", self.solver, get_args(SolverName)),
        ):
            if value not in known:
                raise ValueError(f"{name}: expected one of {', '.join(known)}, got {value!r}")

    @cached_property
    def _horizon(self) -> Horizon:
        return Horizon.of(self.horizon, self.dt, self.limits, self.weights)

    @cached_property
    def _solver(self) -> ConicSolver:
        return ConicSolver(self.solver, self._horizon.rows)

    @property
    def _mount(self) -> FloatArray:
        return np.asarray(self.mount, dtype=np.float64)

    def plan(
        self,
        h: ArrayLike,
        u_before: ArrayLike = (0.0,) * 6,
        *,
        target: ArrayLike,
        R: ArrayLike | None = None,
        omega: ArrayLike = (0.0, 0.0, 0.0),
        before: Plan | None = None,
    ) -> Plan:
        """Plan from a state.

        Parameters
        ----------
        h : array_like, shape (12,)
            State now: P_b, P_b', P_ed, P_ed'; m, m/s. Start the next plan at ``h[1]`` of this one: a measured state
            beside an active limit lies outside half of the time, and nothing is solved from there.
        u_before : array_like, shape (6,)
            Accelerations of the step before, m/s^2.
        target : array_like, shape (N, 3) or (3,)
            Where the end effector shall be at the steps 1 to N, m, world.
        R : array_like, shape (3, 3), optional
            Attitude now, body to world; None for level.
        omega : array_like, shape (3,)
            Angular velocity now, rad/s, body axes.
        before : Plan, optional
            The plan of the instant before, kept if this solve fails or comes late.

        Returns
        -------
        Plan
            Always finite; look at ``status``.

        Raises
        ------
        ValueError
            For numbers of the wrong shape or not finite, an R that is no rotation, a target that stays out of reach
            (see :meth:`reachable`), or a ``before`` of another horizon.
        """
        begun = perf_counter()
        N = self.horizon
        state, last = vector("h", h, (12,)), vector("u_before", u_before, (6,))
        aims = vector("target", target, (N, 3))
        attitude = _rotation(np.eye(3) if R is None else R)
        rate = vector("omega", omega, (3,))
        if before is not None and before.u.shape != (N, 6):
            raise ValueError(
                f"before: expected a plan of {N} steps, got {len(before.u)}; pass what this planner gave"
            )
        self.check_targets(aims)
        turned = rotations(attitude, rate, self.dt, N, self.rotation)
        programme = quadratic_program(
            self._horizon, state, u_before=last, turned=turned, mount=self._mount, target=aims
        )
        u, why = self._solved(programme, state)
        seconds = perf_counter() - begun
        if not why and self.time_limit is not None and seconds > self.time_limit:
            why = (
                f"the plan took {1e3 * seconds:.1f} ms, expected at most {1e3 * self.time_limit:.1f} ms; "
                "shorten the horizon or use the solver daqp"
            )
        if not why:
            states = roll_out(state, u, self.dt)
            effector = end_effector(states[1:], self._mount, turned)
            return Plan(states, u, effector, Status.OPTIMAL, "", seconds, 0)
        return self._fallback(state, turned, before, why, begun)

    def reachable(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Whether some state within the limits has its end effector at a point, at any yaw.

        Parameters
        ----------
        points : array_like, shape (K, 3)
            m, world.

        Returns
        -------
        (K,) bool array
            Exact for a level platform; tilts up to ``tilt_limit`` are allowed for by the largest shift they can cause.

        Examples
        --------
        >>> limits = PlannerLimits([[-1, -1, 1.0], [1, 1, 2.0]], [[0.2, -0.1, -0.3], [0.4, 0.1, -0.1]])
        >>> CooperativePlanner(limits, tilt_limit=0.0).reachable([[1.4, 0, 0.7], [1.4, 0, 0.6], [1.5, 0, 1.0]]).tolist()
        [True, False, False]
        """
        points = _signals.array("points", points, ("K", 3), empty=True)
        lower, upper = self.limits.lower, self.limits.upper
        near, far = lower[3:] + self._mount, upper[3:] + self._mount
        farthest = np.maximum(abs(near), abs(far))
        slack = 2.0 * np.sin(0.5 * self.tilt_limit) * float(np.linalg.norm(farthest)) + ROUNDING
        # Level, at any yaw: a ring about every platform position, and an interval of heights.
        inner = float(np.linalg.norm(np.maximum(np.maximum(near, -far), 0.0)[:2]))
        outer = float(np.linalg.norm(farthest[:2]))
        beside = np.maximum(np.maximum(lower[:2] - points[:, :2], points[:, :2] - upper[:2]), 0.0)
        across = np.maximum(points[:, :2] - lower[:2], upper[:2] - points[:, :2])
        return (
            (np.linalg.norm(beside, axis=1) <= outer + slack)
            & (np.linalg.norm(across, axis=1) >= inner - slack)
            & (points[:, 2] >= lower[2] + near[2] - slack)
            & (points[:, 2] <= upper[2] + far[2] + slack)
        )

    def check_targets(self, targets: ArrayLike) -> None:
        """Raise if a target stays out of reach.

        Parameters
        ----------
        targets : array_like, shape (K, 3)
            m, world.

        Raises
        ------
        ValueError
            Naming the first such target.
        """
        points = _signals.array("targets", targets, ("K", 3), empty=True)
        out = np.flatnonzero(~self.reachable(points))
        if len(out):
            low, high = self.limits.lower, self.limits.upper
            raise ValueError(
                f"target {out[0]}: {points[out[0]].tolist()} m is out of reach of every state within the limits: "
                f"platform {low[:3].tolist()} to {high[:3].tolist()} m, arm from {(low[3:] + self._mount).tolist()} to "
                f"{(high[3:] + self._mount).tolist()} m off it; move the target or widen the platform's box"
            )

    def complaint(self, h: ArrayLike) -> str:
        """Which limit a state breaks, or oversteps when it brakes; empty for none.

        Parameters
        ----------
        h : array_like, shape (12,)
            State.
        """
        state, limits = vector("h", h, (12,)), self.limits
        p, v = axes_of(state)
        spans = [f"{low:g} to {high:g} m" for low, high in zip(limits.lower, limits.upper, strict=True)]
        for i, axis in enumerate(AXES):
            if not limits.lower[i] - ROUNDING <= p[i] <= limits.upper[i] + ROUNDING:
                return f"{axis} is at {p[i]:g} m, expected {spans[i]}"
            if abs(v[i]) > limits.velocity[i] + ROUNDING:
                return f"{axis} moves at {v[i]:g} m/s, expected at most {limits.velocity[i]:g} m/s"
        steps = len(self._horizon.stopping) + int(np.max(abs(v) / (limits.acceleration * self.dt)))
        stop = axes_of(roll_out(state, braking(state, limits, self.dt, steps + 1), self.dt)[-1])[0]
        for i, axis in enumerate(AXES):
            if not limits.lower[i] - ROUNDING <= stop[i] <= limits.upper[i] + ROUNDING:
                return f"{axis} at {p[i]:g} m and {v[i]:g} m/s stops at {stop[i]:g} m at best, expected {spans[i]}"
        return ""

    def _solved(self, programme: QuadraticProgram, h: FloatArray) -> tuple[FloatArray, str]:
        """Accelerations (N, 6), and why they are of no use, if so."""
        x, solved, status = self._solver(programme)
        u = x.reshape(self.horizon, 6)
        if solved and np.isfinite(x).all():
            sides = (self._horizon.rows @ u).ravel()
            excess = [programme.lower - sides, sides - programme.upper, abs(x) - programme.bound]
            worst = max(float(part.max()) for part in excess)
            if worst <= _ACCEPTED:
                return np.clip(u, -self.limits.acceleration, self.limits.acceleration), ""
            return u, f"{self.solver} oversteps a limit by {worst:.2g}; use the solver daqp"
        failed = f"{self.solver} found no plan ({status})"
        broken = self.complaint(h)
        if broken:
            return u, f"{failed}: {broken}; plan from the planned state, or widen the limits"
        return u, f"{failed}; use the solver daqp, or weights of closer scales"

    def _fallback(
        self, h: FloatArray, turned: FloatArray, before: Plan | None, why: str, begun: float
    ) -> Plan:
        """The plan before, one step on and stopping at its end; without one, a stop from here."""
        if before is None:
            u = braking(h, self.limits, self.dt, self.horizon)
            states, status, age = roll_out(h, u, self.dt), Status.BRAKING, 0
            message = f"no plan, every axis brakes: {why}"
        else:
            tail = braking(before.h[-1], self.limits, self.dt, 1)
            u = np.vstack([before.u[1:], tail])
            states = np.vstack([before.h[1:], roll_out(before.h[-1], tail, self.dt)[1:]])
            status, age = Status.KEPT, before.age + 1
            message = f"the plan of {age} step{'s' if age > 1 else ''} ago is kept: {why}"
        effector = end_effector(states[1:], self._mount, turned)
        return Plan(states, u, effector, status, message, perf_counter() - begun, age)


def _rotation(R: ArrayLike) -> FloatArray:
    """R checked to be a rotation."""
    array = vector("R", R, (3, 3))
    if abs(array @ array.T - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(array) < 0.0:
        raise ValueError(
            f"R: expected a rotation matrix, got {array.tolist()}; from a quaternion, normalise it first"
        )
    return array
