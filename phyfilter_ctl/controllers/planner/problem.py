"""The planner's quadratic programme: prediction over the horizon, costs, limits, and stopping inside the limits.

The six axes (platform in the world, end effector in body axes) are double integrators whose acceleration is held
over each step,

    p_{i+1} = p_i + dt v_i + dt^2/2 u_i,    v_{i+1} = v_i + dt u_i,

so with the states eliminated the N accelerations are all the unknowns (6 N). Positions and velocities of the steps
1 to N are p = p_free + S u and v = v_free + T u, axis by axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, repeat
from typing import Literal, NamedTuple

import numpy as np
from scipy.linalg import expm

from ..._sections import FloatArray
from .settings import PlannerLimits, PlannerWeights

__all__ = [
    "Horizon",
    "QuadraticProgram",
    "RotationPrediction",
    "axes_of",
    "braking",
    "end_effector",
    "quadratic_program",
    "roll_out",
    "rotations",
]

RotationPrediction = Literal["euler", "exponential"]

# States whose braking oversteps a limit by no more than this (m, m/s) count as inside: what rounding and a solver's
# tolerance leave of a plan that ran along the limit.
ROUNDING = 1e-6


class QuadraticProgram(NamedTuple):
    """min x' H x / 2 + g' x with lower <= A x <= upper, |x| <= bound; x = u[0, 0], u[0, 1], ... u[N - 1, 5]."""

    H: FloatArray  # (6 N, 6 N)
    g: FloatArray  # (6 N,)
    lower: FloatArray  # (m,)
    upper: FloatArray  # (m,)
    bound: FloatArray  # (6 N,)


@dataclass(frozen=True, eq=False)
class Horizon:
    """What of the programme is the same at every instant.

    Attributes
    ----------
    position, velocity : (N, N) arrays
        S and T.
    stopping : (K,) array
        Times sigma_k = (k - 1/2) dt of the stopping condition, see :func:`quadratic_program`.
    allowance : (K, 6) array
        Its constants a dt^2 k (k - 1) / 2, m.
    rows : (2 N + K, N) array
        Positions, velocities and stopping positions of one axis, as they depend on its accelerations.
    steady_cost : (6 N, 6 N) array
        Hessian of the costs that do not depend on the attitude.
    """

    dt: float
    limits: PlannerLimits
    weights: PlannerWeights
    position: FloatArray
    velocity: FloatArray
    stopping: FloatArray
    allowance: FloatArray
    rows: FloatArray
    steady_cost: FloatArray

    @classmethod
    def of(cls, steps: int, dt: float, limits: PlannerLimits, weights: PlannerWeights) -> Horizon:
        """The matrices for a number of steps of dt seconds."""
        i, j = np.arange(1, steps + 1)[:, None], np.arange(steps)[None, :]
        position = np.where(j < i, dt**2 * (i - j - 0.5), 0.0)
        velocity = np.where(j < i, dt, 0.0)
        k = np.arange(1, _stopping_steps(limits, dt) + 1)
        stopping: FloatArray = np.float64(dt) * (k - 0.5)
        rows = np.vstack([position, velocity, position[-1] + stopping[:, None] * velocity[-1]])
        moves = _differences(position)
        increments = _differences(np.eye(steps))
        steady_cost = 2.0 * (
            np.kron(increments.T @ increments, weights.smoothness)
            + np.kron(moves.T @ moves, weights.increment)
        )
        allowance = 0.5 * dt**2 * np.multiply.outer(k * (k - 1.0), limits.acceleration)
        return cls(dt, limits, weights, position, velocity, stopping, allowance, rows, steady_cost)

    @property
    def steps(self) -> int:
        """Number N of steps."""
        return len(self.position)

    def constrained(self, p: FloatArray, v: FloatArray, u: FloatArray) -> FloatArray:
        """Left-hand sides of the limits, (2 N + K, 6), for p, v (6,) now and accelerations u (N, 6)."""
        i = np.arange(1, self.steps + 1)[:, None]
        coasting = p + self.dt * i * v
        free = [coasting, np.tile(v, (self.steps, 1)), coasting[-1] + np.multiply.outer(self.stopping, v)]
        return np.vstack(free) + self.rows @ u


def _stopping_steps(limits: PlannerLimits, dt: float) -> int:
    """Most steps that a stop can take: from the largest speed, or from the one whose stop fills the box."""
    from_speed = limits.velocity / (limits.acceleration * dt)
    across_box = np.sqrt(2.0 * (limits.upper - limits.lower) / (limits.acceleration * dt**2))
    return max(1, int(np.ceil(np.minimum(from_speed, across_box)).max()))


def _differences(steps: FloatArray) -> FloatArray:
    """Row i less row i - 1; row 0 as it is."""
    return np.diff(steps, axis=0, prepend=0.0)


def axes_of(h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities of the six axes, (..., 6) each, out of states h (..., 12)."""
    parts = h.reshape(*h.shape[:-1], 2, 2, 3)
    shape = (*h.shape[:-1], 6)
    return parts[..., 0, :].reshape(shape), parts[..., 1, :].reshape(shape)


def roll_out(h: FloatArray, u: FloatArray, dt: float) -> FloatArray:
    """States (K + 1, 12) from h (12,) under accelerations u (K, 6), each held for dt."""
    p, v = axes_of(h)
    velocity = v + dt * np.vstack([np.zeros(6), np.cumsum(u, axis=0)])
    moves = 0.5 * dt * (velocity[:-1] + velocity[1:])
    position = p + np.vstack([np.zeros(6), np.cumsum(moves, axis=0)])
    return np.hstack([position[:, :3], velocity[:, :3], position[:, 3:], velocity[:, 3:]])


def braking(h: FloatArray, limits: PlannerLimits, dt: float, steps: int) -> FloatArray:
    """Accelerations (steps, 6) that bring every axis to rest as soon as its limit allows, without turning back."""
    _, v = axes_of(h)
    a = limits.acceleration
    # Speed left after i full steps; the last, shorter one takes off what remains.
    left = np.maximum(abs(v) - dt * a * np.arange(steps + 1)[:, None], 0.0)
    return np.sign(v) * np.diff(left, axis=0) / dt


def rotations(
    R: FloatArray, omega: FloatArray, dt: float, steps: int, kind: RotationPrediction
) -> FloatArray:
    """Predicted rotations R_1 ... R_N (steps, 3, 3), body to world, at a constant angular velocity (3,), body axes.

    "euler": R_i = R_{i-1} + dt R_{i-1} [omega]x, the paper's, which is not orthogonal; "exponential":
    R_i = R_{i-1} exp(dt [omega]x).
    """
    x, y, z = dt * omega
    turn = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    step = np.eye(3) + turn if kind == "euler" else expm(turn)
    return np.array(list(accumulate(repeat(step, steps), np.matmul, initial=R))[1:])


def end_effector(h: FloatArray, mount: FloatArray, turned: FloatArray) -> FloatArray:
    """P_e = P_b + R (P_o + P_ed) in the world, (K, 3), of states h (K, 12) at rotations (K, 3, 3)."""
    return h[:, :3] + np.einsum("kij,kj->ki", turned, mount + h[:, 6:9])


def quadratic_program(
    horizon: Horizon,
    h: FloatArray,
    *,
    u_before: FloatArray,
    turned: FloatArray,
    mount: FloatArray,
    target: FloatArray,
) -> QuadraticProgram:
    """The programme at state h (12,).

    With e_i the end effector's error and y the positions of the six axes, sums over the horizon:

        |e_i|^2_Lambda1 + |u_i - u_{i-1}|^2_Lambda2 + |y_i - y_{i-1}|^2_Lambda3

    The last state must be able to stop inside the box of positions. The least stopping distance of an axis at
    v >= 0, its speed brought down by a dt a step, is

        max over k >= 1 of  dt v (k - 1/2) - a dt^2 k (k - 1) / 2,

    piecewise linear and convex, so the condition is K linear rows an axis. Braking keeps it true: from a state that
    meets it there is a plan at every later instant.
    """
    p, v = axes_of(h)
    N, dt, limits, weights = horizon.steps, horizon.dt, horizon.limits, horizon.weights
    coasting = roll_out(h, np.zeros((N, 6)), dt)[1:]
    error = target - end_effector(coasting, mount, turned)
    reach = np.concatenate([np.broadcast_to(np.eye(3), (N, 3, 3)), turned], axis=2)
    gain = horizon.position[:, None, :, None] * reach[:, :, None, :]
    weighted = np.einsum("ab,ibjc->iajc", weights.tracking, gain).reshape(3 * N, 6 * N)
    H = horizon.steady_cost + 2.0 * gain.reshape(3 * N, 6 * N).T @ weighted

    moves = _differences(horizon.position)
    free_move = np.broadcast_to(dt * v @ weights.increment, (N, 6))
    g = moves.T @ free_move
    g[0] -= u_before @ weights.smoothness
    g = 2.0 * (g.ravel() - error.ravel() @ weighted)

    box = [N, N, len(horizon.stopping)]
    upper = np.repeat([limits.upper, limits.velocity, limits.upper], box, axis=0)
    lower = np.repeat([limits.lower, -limits.velocity, limits.lower], box, axis=0)
    upper[2 * N :] += horizon.allowance
    lower[2 * N :] -= horizon.allowance
    # An axis held still would make dependent equalities, which active-set methods stumble over.
    pinned = ROUNDING * (upper - lower < ROUNDING)
    upper, lower = upper + pinned, lower - pinned
    stop = horizon.constrained(p, v, braking(h, limits, dt, N))
    upper = np.where(stop <= upper + ROUNDING, np.maximum(upper, stop), upper)
    lower = np.where(stop >= lower - ROUNDING, np.minimum(lower, stop), lower)
    free = horizon.constrained(p, v, np.zeros((N, 6)))
    return QuadraticProgram(
        0.5 * (H + H.T), g, (lower - free).ravel(), (upper - free).ravel(), np.tile(limits.acceleration, N)
    )
