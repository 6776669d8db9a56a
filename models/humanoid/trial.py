"""One trial: the humanoid stands, a lateral force takes hold of its hand, with the filter and without.

The known part of the filter is a state-synchronised nominal twin: MuJoCo makes one step from the true state with the
true motors but without the force. What the true robot did beyond that is the residual,

    u_k = (M + h D) (v_k - v_k^twin) / h = J_hand' F + (change of the contact forces),    f_hat = F(s) u

and the hand force is what explains f_hat best: F_hat = argmin |J_hand' F - f_hat|.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants import JointQuantities, JointSpacePrior

from .params import params
from .regulator import Schedule
from .robot import FloatArray, Humanoid, unit

__all__ = ["Mode", "Trial", "phyfilter", "run", "settings"]

Mode = Literal["alone", "filter", "torque", "told"]


@dataclass(frozen=True, eq=False)
class Trial:
    """What happened.

    Attributes
    ----------
    stood : bool
        Whether the robot stood to the end.
    time : (N,) array
        s, to the end or to the fall.
    force, f_hat : (N,) arrays
        The force and its estimate along the heading, N.
    centre : (N, 3) array
        Centre of mass relative to the feet's centre at the start, m.
    q : (N, 28) array
        Configurations.
    control : (N,) array
        Greatest share of a motor's torque that was asked for.
    slide : float
        How far the foot that moved most is from its place at the end, m.
    """

    stood: bool
    time: FloatArray
    force: FloatArray
    f_hat: FloatArray
    centre: FloatArray
    q: FloatArray
    control: FloatArray
    slide: float

    @property
    def held(self) -> bool:
        """Whether the robot stood to the end with its feet where they were, within the slide of ``params.toml``."""
        return self.stood and self.slide <= params().trial.slide


def phyfilter(a0: float | None = None, order: int | None = None) -> PhyFilter:
    """The filter: poles at -a0, repeated.

    Parameters
    ----------
    a0 : float, optional
        rad/s; None takes that of ``params.toml``.
    order : int, optional
        None takes that of ``params.toml``.

    Examples
    --------
    >>> phyfilter(2.0, 2).a.tolist()
    [4.0, 4.0]
    """
    a0 = params().filter.a0 if a0 is None else a0
    order = params().filter.order if order is None else order
    return PhyFilter.from_poles([-a0] * order)


def settings(
    filter: PhyFilter | None, noise: float | None, duration: float | None, *, robot: str = "suite"
) -> tuple[PhyFilter, float, float]:
    """Filter, noise and duration of a trial; in place of None those of ``params.toml``.

    Parameters
    ----------
    filter, noise, duration
        As for :func:`run`.
    robot : {"suite", "berkeley"}
        Whose filter.
    """
    p = params()
    usual = phyfilter(p.berkeley.a0, 1) if robot == "berkeley" else phyfilter()
    return (
        usual if filter is None else filter,
        p.sensors.velocity_noise if noise is None else noise,
        p.trial.duration if duration is None else duration,
    )


def run(
    humanoid: Humanoid,
    schedule: Schedule,
    force: float,
    *,
    mode: Mode = "filter",
    heading: float = 90.0,
    rise: float = 0.0,
    filter: PhyFilter | None = None,
    noise: float | None = None,
    seed: int = 0,
    duration: float | None = None,
) -> Trial:
    """Stand under a horizontal force on the right hand, or where the robot's grip is.

    Parameters
    ----------
    humanoid : Humanoid
    schedule : Schedule
        Set-points of the stance.
    force : float
        N, along the heading; with its default positive pushes the right hand across the body, negative pulls it away.
    mode : {"alone", "filter", "torque", "told"}
        "alone": the LQR of the stance. "filter": its target follows the estimated force. "torque": the estimated
        residual is taken off the motors, -f_hat of the joint rows, and the target stays. "told": the target follows
        the true force, the limit of what an estimate can do.
    heading : float
        Of the force in degrees: 0 forwards, 90 to the left.
    rise : float
        Seconds over which the force grows; 0 for a step.
    filter : PhyFilter, optional
        None takes :func:`phyfilter`.
    noise : float, optional
        Standard deviation of white noise on the velocities that controller and filter measure, rad/s and m/s; None
        takes that of ``params.toml``.
    seed : int
        Of the noise.
    duration : float, optional
        s; None takes that of ``params.toml``.

    Returns
    -------
    Trial

    Raises
    ------
    ValueError
        For an unknown mode, a force that is not finite, or negative times and noise.
    """
    rules = params().trial
    law, noise, duration = settings(filter, noise, duration)
    if mode not in get_args(Mode):
        raise ValueError(f"mode: expected one of {', '.join(get_args(Mode))}, got {mode!r}")
    if not np.isfinite(force):
        raise ValueError(f"force: expected a finite force in N, got {force}")
    if not (np.isfinite([rise, noise, duration]).all() and rise >= 0.0 and noise >= 0.0 and duration > 0.0):
        raise ValueError(f"expected rise, noise >= 0 and duration > 0, got {rise}, {noise} and {duration}")
    along = unit(heading)
    robot = _Robot(humanoid, schedule, mode, law, noise, seed)
    h = float(humanoid.model.opt.timestep)
    steps = round(duration / h)
    rows: list[tuple[float, float, float]] = []
    centre, q = [], []
    stood = True
    for k in range(steps):
        since = k * h - rules.onset
        pull = 0.0 if since < -1e-9 else force * (min(1.0, since / rise) if rise else 1.0)
        robot.step(pull * along)
        rows.append((pull, float(robot.estimate @ along), float(np.abs(robot.data.ctrl).max())))
        centre.append(robot.data.subtree_com[1] - robot.origin)
        q.append(robot.data.qpos.copy())
        if centre[-1][2] < rules.fallen * centre[0][2] or not np.isfinite(q[-1]).all():
            stood = False
            break
    table = np.array(rows)
    time: FloatArray = np.arange(1, len(rows) + 1, dtype=float) * h
    return Trial(
        stood, time, table[:, 0], table[:, 1], np.array(centre), np.array(q), table[:, 2], robot.slide
    )


class _Robot:
    """True robot, twin, controller and filter, step by step."""

    def __init__(
        self,
        humanoid: Humanoid,
        schedule: Schedule,
        mode: Mode,
        filter: PhyFilter,
        noise: float,
        seed: int,
    ) -> None:
        self.humanoid, self.schedule, self.mode, self.noise = humanoid, schedule, mode, noise
        self.data, self.twin = humanoid.data(), humanoid.data()
        self.data.qpos[:] = schedule.upright.q
        humanoid.mujoco.mj_forward(humanoid.model, self.data)
        corners = schedule.upright.posture.feet
        self.origin = np.array([*corners.mean(axis=(0, 1))[:2], 0.0])
        self.random = np.random.default_rng(seed)
        self.estimate, self.f_hat = np.zeros(2), np.zeros(humanoid.nv)
        prior = JointSpacePrior(inertia="full", bias="none", contact="omitted")
        self.law = JointTorqueFilter(filter.sampled(float(humanoid.model.opt.timestep), g="hold"), prior)
        self.state = self.law.start(self.data.qvel)

    def step(self, force: FloatArray) -> None:
        """Measure, act, let the force and the motors work for one step, estimate."""
        humanoid, data = self.humanoid, self.data
        measured = self._measured(data.qvel)
        known = {"filter": self.estimate, "told": force}.get(self.mode, np.zeros(2))
        q, control, K = self.schedule.at(humanoid, known)
        data.ctrl[:] = control - K @ np.concatenate([humanoid.difference(q, data.qpos), measured])
        if self.mode == "torque":
            data.ctrl[:] -= (self.f_hat / np.where(humanoid.torque > 0.0, humanoid.torque, np.inf))[
                humanoid.motor_dof
            ]
        data.ctrl[:] = np.minimum(np.maximum(data.ctrl, -1.0), 1.0)
        humanoid.pull(data, [*force, 0.0])
        estimating = self.mode in ("filter", "torque")
        if estimating:
            self._start_twin(measured)
        humanoid.mujoco.mj_step(humanoid.model, data)
        if estimating:
            self._estimate(measured)

    @property
    def slide(self) -> float:
        """Horizontal way from its place at the start of the foot that moved most, m."""
        moved = (self.humanoid.corners(self.data) - self.schedule.upright.posture.feet).mean(axis=1)
        return float(np.linalg.norm(moved[:, :2], axis=1).max())

    def _measured(self, velocity: FloatArray) -> FloatArray:
        if not self.noise:
            return velocity.copy()
        return velocity + self.noise * self.random.standard_normal(len(velocity))

    def _start_twin(self, velocity: FloatArray) -> None:
        twin, data = self.twin, self.data
        twin.qpos[:], twin.qvel[:], twin.ctrl[:] = data.qpos, velocity, data.ctrl
        twin.qacc_warmstart[:] = data.qacc_warmstart
        self.humanoid.mujoco.mj_step(self.humanoid.model, twin)

    def _estimate(self, before: FloatArray) -> None:
        """The filter's x is v, its known torque what carried the twin from the measured state to its end."""
        humanoid, h = self.humanoid, float(self.humanoid.model.opt.timestep)
        M = humanoid.implicit_inertia(self.twin)
        known = M @ (self.twin.qvel - before) / h
        after = self._measured(self.data.qvel)
        state = self.state._replace(qd=before)
        self.state, self.f_hat = self.law.step(state, after, JointQuantities(after, M), known)
        J = humanoid.hand_jacobian(self.twin)
        self.estimate = np.linalg.solve(J @ J.T, J @ self.f_hat)[:2]
