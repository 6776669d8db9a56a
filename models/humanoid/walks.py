"""Trials of the policy: many robots at once step in place or walk while a force pulls at torso or pelvis.

The filter is that of ``trial.py``: f_hat = F(s) (M + h D)(v - v_twin)/h, the twin one step of the same model, with the
same drives, from what was measured. The force that explains it best, F_hat, is told to the policy, which was trained to
be told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.controllers import JointTorqueFilter
from phyfilter_ctl.plants import JointQuantities, JointSpacePrior

from ..quadruped.network import Network, read, shipped
from .crowd import JOINTS, Crowd
from .limits import PROFILES
from .params import params
from .practice import OBSERVATIONS, observe, turned
from .robot import FloatArray, unit
from .stepping import Clock, neutral
from .trial import Mode, settings
from .walk_params import walk_params

__all__ = ["Case", "Fate", "Policy", "load", "march"]

_FOLDER = Path(__file__).with_name("policies")
_LIFTED, _DOWN = 0.01, 0.004  # m, of a sole: a step begins, and is done


@dataclass(frozen=True, eq=False)
class Policy(Network):
    """A :class:`Network` that moves the Berkeley Humanoid."""

    def sizes(self) -> tuple[int, int, float]:
        """Observations, actions, and the limit of an action."""
        return OBSERVATIONS, JOINTS, walk_params().servo.action_limit


def load(name: str) -> Policy:
    """Read a policy.

    Parameters
    ----------
    name : str
        A file, or one that comes with the model: "berkeley-0".

    Raises
    ------
    ValueError
        If there is none, or the file is none of this robot.
    """
    return read(shipped(_FOLDER, name), Policy, ("berkeley",))


@dataclass(frozen=True)
class Case:
    """One robot's trial.

    Parameters
    ----------
    force : float
        N.
    heading : float
        Where it points to, degrees: 0 forwards, 90 to the left.
    profile : {"sudden", "slow"}
    mode : {"alone", "torque", "filter", "told"}
        "torque": f_hat of the joint rows taken off the motors; "filter": the policy is told F_hat; "told": the true
        force.
    speed : float
        Commanded, forwards, m/s.
    """

    force: float
    heading: float
    profile: str
    mode: Mode
    speed: float = 0.0


@dataclass(frozen=True)
class Fate:
    """How a trial ended.

    Attributes
    ----------
    case : Case
    held : bool
        Whether it stood to the end.
    time : float
        To the end or the fall, s.
    velocity : (2,) tuple
        Mean in the world after the force was there, m/s.
    steps : int
        Footfalls.
    estimate : float
        Mean of F_hat along the heading over the last second, N; nan without a filter.
    """

    case: Case
    held: bool
    time: float
    velocity: tuple[float, float]
    steps: int
    estimate: float


def march(
    cases: Sequence[Case],
    policy: Callable[[FloatArray], FloatArray] | None,
    *,
    grip: str = "torso",
    filter: PhyFilter | None = None,
    noise: float | None = None,
    seed: int = 100,
    duration: float | None = None,
    threads: int = 1,
    report: Callable[[str], None] | None = None,
) -> tuple[Fate, ...]:
    """Let every case happen, all at once.

    Parameters
    ----------
    cases : sequence of Case
    policy : callable, optional
        (E, 53) observations to (E, 12) actions; None: the steps alone.
    grip : {"torso", "pelvis"}
    filter : PhyFilter, optional
        None takes a_0 of ``params.toml``.
    noise, duration : float, optional
        As for :func:`run`.
    seed : int
        Of the noise and of which foot begins.
    threads : int
        Of MuJoCo's pool.
    report : callable, optional
        Called every simulated second with a few words.

    Returns
    -------
    tuple of Fate
        In the order of the cases.

    Raises
    ------
    ValueError
        For no cases, or forces and durations that are not finite.
    """
    rules = params().trial
    law, noise, duration = settings(filter, noise, duration, robot="berkeley")
    if not cases or not np.isfinite([case.force for case in cases]).all():
        raise ValueError("cases: expected at least one, with finite forces")
    if not (np.isfinite([duration, noise]).all() and duration > rules.onset and noise >= 0.0):
        raise ValueError(
            f"expected a duration above {rules.onset:g} s and noise >= 0, got {duration} and {noise}"
        )
    parade = _Parade(cases, policy, grip, law, noise, seed, threads)
    servo = walk_params().servo
    count = round(duration / (servo.timestep * servo.decimation))
    for k in range(count):
        if report is not None and k % 50 == 0:
            report(f"{k // 50} s, {int(parade.standing.sum())} of {len(cases)} stand")
        if not parade.standing.any():
            break
        parade.step(k * servo.timestep * servo.decimation)
    return parade.fates(duration)


class _Parade:
    """Robots, twins, clock and filter, step by step."""

    def __init__(
        self,
        cases: Sequence[Case],
        policy: Callable[[FloatArray], FloatArray] | None,
        grip: str,
        law: PhyFilter,
        noise: float,
        seed: int,
        threads: int,
    ) -> None:
        size, self.cases, self.policy, self.noise = len(cases), tuple(cases), policy, noise
        self.rng = np.random.default_rng(seed)
        self.crowd, self.clock = Crowd(size, grip=grip, threads=threads), Clock(size)
        everyone = np.arange(size)
        self.crowd.reset(everyone, np.tile(neutral().q, (size, 1)))
        self.clock.restart(everyone, 0.5 * self.rng.integers(0, 2, size).astype(float))
        self.along = np.array([case.force * unit(case.heading) for case in cases])
        self.rise = np.array([PROFILES[case.profile] for case in cases])
        self.command = np.array([[case.speed, 0.0, 0.0] for case in cases])
        modes = np.array([case.mode for case in cases])
        self.truly, self.guessed = modes == "told", modes == "filter"
        self.watched = np.flatnonzero((modes == "filter") | (modes == "torque"))
        self.relieved = np.flatnonzero(modes[self.watched] == "torque")
        self.action, self.force = np.zeros((size, JOINTS)), np.zeros((size, 2))
        self.estimate, self.relief = np.zeros((size, 2)), np.zeros((size, JOINTS))
        self.standing, self.time = np.ones(size, dtype=bool), np.zeros(size)
        self.steps, self.lifted = np.zeros(size, dtype=np.int64), np.zeros((size, 2), dtype=bool)
        self.start, self.last = np.full((size, 3), np.nan), np.zeros((size, 3))
        self.seconds: list[FloatArray] = []
        if len(self.watched):
            self.twin = Crowd(len(self.watched), grip=grip, threads=threads)
            prior = JointSpacePrior(inertia="full", bias="none", contact="omitted")
            self.law = JointTorqueFilter(law.sampled(float(self.crowd.model.opt.timestep), g="hold"), prior)
            self.state = self.law.start(self.crowd.qvel[self.watched])

    def step(self, now: float) -> None:
        """One step of the policy."""
        rules, servo, crowd = params().trial, walk_params().servo, self.crowd
        since = now - rules.onset
        share = np.where(self.rise > 0.0, np.clip(since / np.maximum(self.rise, 1e-9), 0.0, 1.0), 1.0)
        self.force = self.along * (share * (since > -1e-9) * self.standing)[:, None]
        measured = self._measured()
        motion = crowd.seen(measured)
        known = np.where(self.truly[:, None], self.force, self.estimate)
        told = (
            np.concatenate([turned(known, motion.yaw), (self.truly | self.guessed)[:, None]], axis=1)
            * (self.truly | self.guessed)[:, None]
        )
        if self.policy is not None:
            seen = observe(motion, self.clock.phase, self.command, self.action, told)
            self.action = self.policy(seen)
        target = self.clock.target(motion.velocity, motion.up, motion.rate, self.command)
        target = target + servo.action_scale * self.action
        for _ in range(servo.decimation):
            self._sample(target, measured)
            measured = self._measured()
        self._book(now + servo.timestep * servo.decimation)

    def _measured(self) -> FloatArray:
        qvel = self.crowd.qvel.copy()
        return qvel + self.noise * self.rng.standard_normal(qvel.shape) if self.noise else qvel

    def _sample(self, target: FloatArray, measured: FloatArray) -> None:
        crowd, rows = self.crowd, self.watched
        wanted = target - self.relief / crowd.kp
        crowd.push(self.force)
        if not len(rows):
            crowd.step(wanted)
            return
        before = measured[rows]
        self.twin.follow(crowd, rows, before)
        crowd.step(wanted)
        self.twin.step(wanted[rows])
        M = self.twin.implicit_inertia()
        h = float(crowd.model.opt.timestep)
        known = np.matmul(M, (self.twin.qvel - before)[..., None])[..., 0] / h
        after = crowd.qvel[rows]
        if self.noise:
            after = after + self.noise * self.rng.standard_normal(after.shape)
        state = self.state._replace(qd=before)
        self.state, f_hat = self.law.step(state, after, JointQuantities(after, M), known)
        J = self.twin.force_jacobian()
        base = np.matmul(J, f_hat[:, :6, None])
        self.estimate[rows] = np.linalg.solve(J @ J.swapaxes(1, 2), base)[..., 0]
        self.relief[rows[self.relieved]] = f_hat[self.relieved, 6:]

    def _book(self, now: float) -> None:
        """Footfalls, places, falls; who has fallen stands aside."""
        crowd, rules = self.crowd, params().trial
        lifted = np.where(self.lifted, crowd.soles > _DOWN, crowd.soles > _LIFTED)
        self.steps += (self.lifted & ~lifted).sum(axis=1) * self.standing
        self.lifted = lifted
        place = np.concatenate([crowd.qpos[:, :2], np.full((len(self.cases), 1), now)], axis=1)
        begins = np.isnan(self.start[:, 0]) & (now >= rules.onset + rules.rise)
        self.start[begins] = place[begins]
        falling = crowd.fallen & self.standing
        self.last[self.standing & ~falling] = place[self.standing & ~falling]
        self.time[self.standing] = now
        self.standing &= ~falling
        self.seconds = [*self.seconds[-49:], np.einsum("ei,ei->e", self.estimate, self._headings())]
        aside = np.flatnonzero(~self.standing)
        if len(aside):
            crowd.reset(aside, np.tile(neutral().q, (len(aside), 1)))
            self.action[aside] = 0.0
            self.clock.restart(aside, np.zeros(len(aside)))

    def _headings(self) -> FloatArray:
        return np.array([unit(case.heading) for case in self.cases])

    def fates(self, duration: float) -> tuple[Fate, ...]:
        """What became of each."""
        taken = self.last[:, 2] - self.start[:, 2]
        velocity = (self.last[:, :2] - self.start[:, :2]) / np.where(taken > 0.0, taken, np.nan)[:, None]
        estimates = np.mean(self.seconds, axis=0)
        watched: NDArray[np.bool_] = np.isin(np.arange(len(self.cases)), self.watched)
        return tuple(
            Fate(
                case,
                bool(self.standing[k]),
                float(self.time[k]),
                (float(velocity[k, 0]), float(velocity[k, 1])),
                int(self.steps[k]),
                float(estimates[k]) if watched[k] else float("nan"),
            )
            for k, case in enumerate(self.cases)
        )
