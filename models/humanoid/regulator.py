"""LQR about a posture, and set-points for every force: what a known hand force changes in the target.

    x_{k+1} = A x_k + B u_k   about (posture, its motors, its force),    u = u*(F) - K(F) (x - x*(F))

F is the force that the filter has estimated ("retarget"): it moves the steady state, leaning the body into the force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from phyfilter_ctl.study import Report, silent

from .params import params
from .posture import Posture, stand
from .robot import FloatArray, Humanoid, unit

__all__ = ["Schedule", "SetPoint", "lqr", "regulate", "schedule"]

# Doublings of the Riccati iteration: 2^14 steps of 5 ms. Feet that creep never settle; their places have no weight.
_SQUARINGS = 14
_HEIGHTS = np.linspace(-0.004, 0.002, 121)  # m, searched for the soft contacts that carry the weight


@dataclass(frozen=True, eq=False)
class SetPoint:
    """A posture on its soft contacts with the regulator about it.

    Attributes
    ----------
    posture : Posture
    q : (28,) array
        The posture, lowered so that the contacts carry it.
    K : (21, 54) array
        Gain on configuration and velocity.
    A, B
        Discrete linearisation.
    """

    posture: Posture
    q: FloatArray
    K: FloatArray
    A: FloatArray
    B: FloatArray


@dataclass(frozen=True, eq=False)
class Schedule:
    """Set-points of one stance over the horizontal force, bilinear in between.

    Attributes
    ----------
    stance : str
    forward, forces : (m,), (n,) arrays
        Forward and lateral forces in N, increasing. One forward force alone: it has no influence.
    points : tuple of SetPoint
        For each forward force those of all lateral ones.
    """

    stance: str
    forward: FloatArray
    forces: FloatArray
    points: tuple[SetPoint, ...]

    def at(self, humanoid: Humanoid, force: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Configuration, motors and gain for a horizontal force; beyond the last set-point the last one.

        Parameters
        ----------
        humanoid : Humanoid
        force : (2,) array
            Forwards and to the left, N.
        """
        x, y = np.asarray(force, dtype=float)
        weighed = [
            (wx * wy, self.points[i * len(self.forces) + j])
            for i, wx in _weighed(self.forward, x)
            for j, wy in _weighed(self.forces, y)
            if wx * wy > 0.0
        ]
        first = weighed[0][1]
        change = sum(
            (part * humanoid.difference(first.q, point.q) for part, point in weighed[1:]),
            np.zeros(humanoid.nv),
        )
        control = sum(part * point.posture.control for part, point in weighed)
        K = sum(part * point.K for part, point in weighed)
        return humanoid.moved(first.q, change), np.asarray(control), np.asarray(K)

    @property
    def upright(self) -> SetPoint:
        """The set-point without a force."""
        row = int(np.argmin(np.abs(self.forward))) * len(self.forces)
        return self.points[row + int(np.argmin(np.abs(self.forces)))]

    def reach(self, heading: float) -> float:
        """Largest force of a heading that has set-points, N.

        Parameters
        ----------
        heading : float
            In degrees: 0 forwards, 90 to the left.
        """
        largest = np.array([self.forward[-1], self.forces[-1]])
        along = np.abs(unit(heading))
        return float(np.min(largest[along > 0.0] / along[along > 0.0]))


def _weighed(levels: FloatArray, value: float) -> list[tuple[int, float]]:
    """Neighbours of a value among increasing levels and their weights."""
    if len(levels) == 1:
        return [(0, 1.0)]
    value = float(min(max(value, levels[0]), levels[-1]))
    i = min(max(int(levels.searchsorted(value, side="right")) - 1, 0), len(levels) - 2)
    part = (value - levels[i]) / (levels[i + 1] - levels[i])
    return [(i, 1.0 - part), (i + 1, part)]


def lqr(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray) -> FloatArray:
    """Gain K of the discrete LQR, by the doubling form of the Riccati iteration.

    G <- G + A W G A',  H <- H + A' H W A,  A <- A W A  with W = (I + G H)^{-1}; after j rounds H is the cost of
    2^j steps. Unlike a solver of the algebraic equation it needs no stabilisable drift where Q sees none.

    Parameters
    ----------
    A, B, Q, R
        As usual.

    References
    ----------
    Chu, Fan, Lin, Wang, "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations", Int.
    J. Control 77 (2004).
    """
    step, H = A, Q
    G = B @ np.linalg.solve(R, B.T)
    for _ in range(_SQUARINGS):
        W = np.linalg.inv(np.eye(len(A)) + G @ H)
        G, H, step = G + step @ W @ G @ step.T, H + step.T @ H @ W @ step, step @ W @ step
        G, H = 0.5 * (G + G.T), 0.5 * (H + H.T)
    return np.asarray(np.linalg.solve(R + B.T @ H @ B, B.T @ H @ A), dtype=float)


def regulate(humanoid: Humanoid, posture: Posture) -> SetPoint:
    """Set a posture on its contacts and close the loop about it.

    Parameters
    ----------
    humanoid : Humanoid
    posture : Posture

    Returns
    -------
    SetPoint
    """
    mujoco, model, data = humanoid.mujoco, humanoid.model, humanoid.data()
    data.qpos[:] = posture.q
    mujoco.mj_kinematics(model, data)
    humanoid.pull(data, posture.force)
    q = np.array(posture.q)

    def unbalanced(lower: float) -> float:
        data.qpos[:] = q
        data.qpos[2] += lower
        data.qvel[:] = 0.0
        data.qacc[:] = 0.0
        mujoco.mj_inverse(model, data)
        return abs(float(data.qfrc_inverse[2]))

    q[2] += min(_HEIGHTS, key=unbalanced)
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.ctrl[:] = q, posture.control
    mujoco.mj_kinematics(model, data)
    humanoid.pull(data, posture.force)
    dry = np.array(model.dof_frictionloss)
    model.dof_frictionloss[:] = 0.0  # about rest it would look like a lock
    try:
        mujoco.mj_forward(model, data)
        A, B = np.zeros((2 * model.nv, 2 * model.nv)), np.zeros((2 * model.nv, model.nu))
        mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    finally:
        model.dof_frictionloss[:] = dry
    K = lqr(A, B, _weights(humanoid, data), params().regulator.control * np.eye(model.nu))
    return SetPoint(posture, q, K, A, B)


def _weights(humanoid: Humanoid, data: object) -> FloatArray:
    """Q: the centre of mass over the feet, the torso, the joints; the place in the world has no weight."""
    weights, nv, model = params().regulator, humanoid.nv, humanoid.model
    centre = humanoid.centre_jacobian(data)
    level, height = centre[:2].T @ centre[:2], centre[2:].T @ centre[2:]
    joints = np.full(nv, weights.joint)
    joints[:3], joints[3:6] = 0.0, weights.root
    for i in range(1, model.njnt):
        if any(part in model.joint(i).name for part in ("shoulder", "elbow")):
            joints[model.jnt_dofadr[i]] = weights.arm
    rates = np.full(nv, weights.rate)
    rates[:3] = 0.0
    Q = np.zeros((2 * nv, 2 * nv))
    Q[:nv, :nv] = weights.centre * level + weights.height * height + np.diag(joints)
    Q[nv:, nv:] = weights.centre_rate * level + np.diag(rates)
    return Q


def schedule(
    humanoid: Humanoid,
    name: str,
    *,
    largest: float | None = None,
    spacing: float | None = None,
    report: Report = silent,
) -> Schedule:
    """Set-points of a stance for lateral forces, and for forward ones where ``params.toml`` has a range for the robot.

    Parameters
    ----------
    humanoid : Humanoid
    name : str
        The stance.
    largest, spacing : float, optional
        Of the lateral forces, in N; None takes those of ``params.toml``.
    report : Report
        Told what is being computed.

    Returns
    -------
    Schedule

    Raises
    ------
    ValueError
        For an unknown stance, or forces that are not positive.
    """
    grid = params().berkeley if humanoid.robot == "berkeley" else params().schedule
    largest = grid.largest if largest is None else largest
    spacing = grid.spacing if spacing is None else spacing
    if not (np.isfinite(largest) and np.isfinite(spacing) and 0.0 < spacing <= largest):
        raise ValueError(f"schedule: expected 0 < spacing <= largest in N, got {spacing} and {largest}")
    report(f"postures, {name} stance")
    forward, lateral = _levels(grid.forward, grid.spacing), _levels(largest, spacing)
    points = dict[tuple[float, float], SetPoint]()
    for x in sorted(forward, key=abs):
        for y in sorted(lateral, key=abs):
            # The neighbour towards the origin, from which the search begins.
            near = (x, y - spacing * np.sign(y)) if y else (x - grid.spacing * np.sign(x), y)
            start = points[near].posture if points else None
            points[x, y] = regulate(humanoid, stand(humanoid, name, (x, y, 0.0), start=start))
    grid_points = tuple(points[x, y] for x in forward for y in lateral)
    return Schedule(name, np.array(forward), np.array(lateral), grid_points)


def _levels(largest: float, spacing: float) -> list[float]:
    count = round(largest / spacing)
    return [float(k * spacing) for k in range(-count, count + 1)]
