"""Walks that are judged: every policy from every phase of the gait, under loads, speeds, grounds, pushes.

Velocity error of a walk: |mean forward velocity - command| over all but its beginning; a robot that fell stands still
(error = |command|). Terrain: passed if it got far enough without a fall. Push: survived if it did not fall.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .adaptive import AdaptiveChoice
from .batch import Batch
from .gait import following, sent, trot
from .loop import FilterChoice, JointLoop, advance
from .params import Params, params
from .policy import ACTIONS, Policy, blurred, observe
from .robot import GRAVITY, check_payload
from .terrain import LANE, Terrain

__all__ = ["Case", "Group", "Outcome", "Trace", "phases", "recorded", "walk"]

FloatArray = NDArray[np.float64]

Side = Literal["sides", "left", "right", "front", "back"]
# Where a push drives the robot: x, y.
_TOWARDS = {
    "sides": (0.0, 1.0),
    "left": (0.0, -1.0),
    "right": (0.0, 1.0),
    "front": (-1.0, 0.0),
    "back": (1.0, 0.0),
}

# The command is reached in this time, s; the heading is held by a turn rate per rad, 1/s, up to so much, rad/s.
_RAMP = 1.0
_HEADING, _TURN = 1.0, 0.5
# Pushes begin here, s; so far to the side do robots of one batch start, m.
_PUSH_AT = 5.0
_ASIDE = 1.0
# A foot swings higher than this part of its heights; way below which a robot stood, m.
_SWINGS, _NOWHERE = 0.95, 0.1


@dataclass(frozen=True)
class Case:
    """What a robot is asked to do.

    Parameters
    ----------
    payload : float
        kg.
    speed : float
        Forward, m/s.
    strength : float
        Part of the commanded torque that the motors give.
    push : float
        Force on the trunk, N.
    push_from : {"sides", "left", "right", "front", "back"}
        "sides": half of the robots from the left, half from the right.
    disabled : str
        Joint whose motor gives nothing; "": none.
    robot : str
        Of ``params.ROBOTS``.

    Raises
    ------
    ValueError
        For a payload that the legs cannot carry, a speed beyond the gait's, another strength than (0, 1], or an unknown
        side, joint or robot.
    """

    payload: float = 0.0
    speed: float = 1.0
    strength: float = 1.0
    push: float = 0.0
    push_from: Side = "sides"
    disabled: str = ""
    robot: str = "lite3-primitives"

    def __post_init__(self) -> None:
        if not 0.0 < self.strength <= 1.0:
            raise ValueError(f"strength: expected more than 0 and at most 1, got {self.strength}")
        if not np.isfinite(self.push):
            raise ValueError(f"push: expected a force in N, got {self.push}")
        if self.push_from not in get_args(Side):
            raise ValueError(
                f"push_from: expected one of {', '.join(get_args(Side))}, got {self.push_from!r}"
            )
        p = params(self.robot)
        check_payload(self.payload, strength=self.strength, parameters=p)
        if not abs(self.speed) <= p.gait.speed_high:
            raise ValueError(f"speed: expected up to {p.gait.speed_high} m/s, got {self.speed}")
        if self.disabled and self.disabled not in p.robot.joints:
            raise ValueError(f"disabled: expected one of {', '.join(p.robot.joints)}, got {self.disabled!r}")


@dataclass(frozen=True)
class Trace:
    """One instant after the other, for the first policy and phase of every case.

    Attributes
    ----------
    time : (N,) array
        s.
    speed : (N, cases) array
        Forward, m/s.
    f_hat : (N, cases, 12) array
        N m.
    qpos : (N, cases, 19) array
    """

    time: FloatArray
    speed: FloatArray
    f_hat: FloatArray
    qpos: FloatArray


@dataclass(frozen=True)
class Outcome:
    """How walks ended; axes (cases, policies, phases).

    Attributes
    ----------
    error : array
        |mean forward velocity - command|, m/s.
    ripple : array
        Standard deviation of the forward velocity, m/s; nan for a fall.
    fallen : bool array
    distance : array
        Along x, until the fall, m.
    estimate : array
        Mean of |f_hat| over joints and time, N m.
    clearance : array
        Height above the ground that a foot exceeds in a twentieth of the time, mean of the feet, m; nan for a fall.
    transport : array
        Cost of transport: positive mechanical work of the motors over weight, payload included, times way; nan for a
        fall.
    trace : Trace
    """

    error: FloatArray
    ripple: FloatArray
    fallen: NDArray[np.bool_]
    distance: FloatArray
    estimate: FloatArray
    clearance: FloatArray
    transport: FloatArray
    trace: Trace

    @property
    def survived(self) -> FloatArray:
        """Part of the robots that did not fall, per case."""
        return 1.0 - self.fallen.mean(axis=(1, 2))

    @property
    def passed(self) -> FloatArray:
        """Part of the robots that crossed the terrain, per case."""
        return ((self.distance >= params().test.distance) & ~self.fallen).mean(axis=(1, 2))


def phases(*, validation: bool = False, count: int | None = None) -> FloatArray:
    """Phases of the gait at the start, rad.

    Parameters
    ----------
    validation : bool
        Those between the test's: what is chosen, is chosen on them.
    count : int, optional
        None: as in ``params.toml``.
    """
    n = params().test.phases if count is None else count
    return 2.0 * np.pi * (np.arange(n) + (0.5 if validation else 0.0)) / n


@dataclass(frozen=True)
class Group:
    """Policies that share a joint loop.

    Parameters
    ----------
    policies : sequence of Policy
    choice : FilterChoice or AdaptiveChoice, optional
        None: no filter.

    Raises
    ------
    ValueError
        Without policies.
    """

    policies: Sequence[Policy]
    choice: FilterChoice | AdaptiveChoice | None = None

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("expected at least one policy")


def walk(
    groups: Sequence[Group],
    cases: Sequence[Case],
    *,
    starts: FloatArray | None = None,
    terrain: Terrain | None = None,
    duration: float | None = None,
    far: float = np.inf,
    threads: int = 2,
) -> list[Outcome]:
    """Let every policy walk every case from every phase.

    Parameters
    ----------
    groups : sequence of Group
    cases : sequence of Case
    starts : (P,) array, optional
        Phases; None: those of the test.
    terrain : Terrain, optional
        None: flat. Of several side by side the phases take turns.
    duration : float, optional
        s; None: as in ``params.toml``.
    far : float
        The walk ends as soon as every robot fell or got so far, m.
    threads : int

    Returns
    -------
    list of Outcome
        Of each group.

    Raises
    ------
    ValueError
        Without groups or cases, or if they are of several robots.
    """
    if not groups or not cases:
        raise ValueError("walk: expected at least one group of policies and one case")
    crowd = _Crowd(groups, cases, phases() if starts is None else starts, terrain, threads)
    p = crowd.parameters
    step = p.control.dt * p.control.decimation
    count = round((p.test.duration if duration is None else duration) / step)
    skipped = min(round(p.test.left_out / step), count // 2)
    velocity, estimate = np.zeros((count, crowd.size)), np.zeros(crowd.size)
    lifted = np.zeros((count, crowd.size, len(p.robot.feet)))
    work = np.zeros(crowd.size)

    def spend(torque: FloatArray) -> None:
        work[:] += p.control.dt * np.maximum(torque * crowd.batch.qd, 0.0).sum(axis=1)

    f_hat: list[FloatArray] = []
    qpos: list[FloatArray] = []
    for k in range(count):
        crowd.step(k * step, spend if k >= skipped else None)
        lifted[k] = crowd.batch.lift
        velocity[k] = np.where(crowd.fallen, 0.0, crowd.motion.velocity[:, 0])
        now = np.concatenate([loop.f_hat for loop in crowd.loops])
        estimate += np.abs(now).mean(axis=1) / count
        f_hat.append(now[crowd.shown])
        qpos.append(crowd.batch.qpos[crowd.shown].copy())
        if (crowd.fallen | (crowd.distance >= far)).all():
            break
    scored = velocity[skipped:]
    error = np.abs(np.where(crowd.fallen, 0.0, scored.mean(axis=0)) - crowd.speed)
    ripple = np.where(crowd.fallen, np.nan, scored.std(axis=0))
    # A robot that goes nowhere has no cost of transport.
    way = np.maximum(step * len(scored) * np.abs(scored.mean(axis=0)), _NOWHERE)
    transport = np.where(crowd.fallen, np.nan, work / (GRAVITY * (p.robot.mass + crowd.payload) * way))
    clearance = np.quantile(lifted[skipped:], _SWINGS, axis=0).mean(axis=1)
    clearance[crowd.fallen] = np.nan
    time = np.array([step * (k + 1) for k in range(len(f_hat))])
    estimates, poses = np.array(f_hat), np.array(qpos)
    found = []
    for k, (rows, shape) in enumerate(zip(crowd.rows, crowd.shapes, strict=True)):
        of = slice(k * len(cases), (k + 1) * len(cases))
        trace = Trace(time, velocity[: len(time), crowd.shown[of]], estimates[:, of], poses[:, of])
        fallen = crowd.fallen[rows].reshape(shape)
        a, b, c, d, e, f = (
            v[rows].reshape(shape) for v in (error, ripple, crowd.distance, estimate, clearance, transport)
        )
        found.append(Outcome(a, b, fallen, c, d, e, f, trace))
    return found


def recorded(
    group: Group, cases: Sequence[Case], *, starts: FloatArray, duration: float, threads: int = 2
) -> list[tuple[FloatArray, FloatArray]]:
    """Joint velocities and torques of walks, at the rate of the joint loop; those that fall are left out.

    Parameters
    ----------
    group : Group
    cases : sequence of Case
    starts : (P,) array
        Phases, rad.
    duration : float
        s.
    threads : int

    Returns
    -------
    list of (qd, torque)
        (N, 12) each, rad/s and N m; a row's torque acts from that row to the next one.
    """
    crowd = _Crowd([group], cases, starts, None, threads)
    step = crowd.parameters.control.dt * crowd.parameters.control.decimation
    qd, torques = [crowd.batch.qd.copy()], []

    def watch(torque: FloatArray) -> None:
        torques.append(torque.copy())
        qd.append(crowd.batch.qd.copy())

    for k in range(round(duration / step)):
        crowd.step(k * step, watch)
    velocity, torque = np.array(qd), np.array([*torques, torques[-1]])
    return [(velocity[:, i], torque[:, i]) for i in np.flatnonzero(~crowd.fallen)]


def _alike(groups: Sequence[Group]) -> list[tuple[FilterChoice | AdaptiveChoice | None, list[int]]]:
    """Choices and the groups, next to one another, that have them."""
    runs = itertools.groupby(range(len(groups)), key=lambda k: groups[k].choice)
    return [(choice, list(same)) for choice, same in runs]


class _Crowd:
    """All robots of one walk, ordered (group, case, policy, phase)."""

    def __init__(
        self,
        groups: Sequence[Group],
        cases: Sequence[Case],
        start: FloatArray,
        terrain: Terrain | None,
        threads: int,
    ) -> None:
        robots = {policy.robot for group in groups for policy in group.policies} | {
            case.robot for case in cases
        }
        if len(robots) > 1:
            raise ValueError(f"policies and cases of one robot at a time, got {', '.join(sorted(robots))}")
        self.parameters: Params = params(next(iter(robots)))
        self.shapes = [(len(cases), len(group.policies), len(start)) for group in groups]
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in self.shapes)])
        self.rows = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
        self.size = int(ends[-1])
        index = np.concatenate([np.indices(shape).reshape(3, -1) for shape in self.shapes], axis=1)
        case, number, self.phase = index[0], index[1], start[index[2]]
        member = np.concatenate([np.full(int(np.prod(s)), k) for k, s in enumerate(self.shapes)])
        self._brains = [
            (policy, np.flatnonzero((member == k) & (number == i)))
            for k, group in enumerate(groups)
            for i, policy in enumerate(group.policies)
        ]
        self.shown = np.flatnonzero((index[1] == 0) & (index[2] == 0))
        self.speed, self._push = (
            np.array([getattr(entry, name) for entry in cases])[case] for name in ("speed", "push")
        )
        # Half of them is pushed to the left.
        sides = np.array([entry.push_from == "sides" for entry in cases])[case]
        self._push = self._push * np.where(sides & (index[2] % 2 == 1), -1.0, 1.0)
        self._towards = np.array([_TOWARDS[entry.push_from] for entry in cases])[case]
        self.batch = Batch(self.size, terrain=terrain, threads=threads, parameters=self.parameters)
        self.payload = np.array([entry.payload for entry in cases])[case]
        self.batch.set_payload(self.payload)
        # Every robot of a group starts at another place of the lane.
        each = np.array([max(1, len(group.policies) * len(start) - 1) for group in groups])[member]
        place = np.zeros((self.size, 3))
        place[:, 1] = _ASIDE * (2.0 * (index[1] * len(start) + index[2]) / each - 1.0)
        place[:, 1] += LANE * (index[2] % self.batch.terrain.count)
        p = self.parameters
        joints = sent(trot(self.phase, np.zeros((self.size, 3)), parameters=p), parameters=p)
        self.batch.reset(np.arange(self.size), joints=joints, place=place)
        # Neighbours that are corrected alike share a loop.
        self.loops = [
            JointLoop(self.batch, choice, rows=slice(self.rows[same[0]].start, self.rows[same[-1]].stop))
            for choice, same in _alike(groups)
        ]
        names = np.array(p.robot.joints)
        strength = np.array([np.where(names == entry.disabled, 0.0, entry.strength) for entry in cases])[case]
        for loop in self.loops:
            loop.strength = strength[loop.rows]
        self._rng = np.random.default_rng(0)
        self.action = np.zeros((self.size, ACTIONS))
        self.fallen = np.zeros(self.size, dtype=bool)
        self.distance = np.zeros(self.size)
        self.motion = self.batch.motion

    def step(self, time: float, watch: Callable[[FloatArray], None] | None = None) -> None:
        """One step of the policies."""
        p, motion = self.parameters, self.motion
        command = np.zeros((self.size, 3))
        command[:, 0] = self.speed * min(1.0, time / _RAMP)
        command[:, 2] = np.clip(-_HEADING * motion.yaw, -_TURN, _TURN)
        seen = observe(motion, self.phase, command, self.action, parameters=p)
        if p.control.observed_noise > 0.0:
            clean = seen.copy()
            seen = clean + p.control.observed_noise * (blurred(seen, self._rng, parameters=p) - clean)
        for policy, mine in self._brains:
            self.action[mine] = policy(seen[mine])
        self.phase = following(self.phase, command, parameters=p)
        pushed = _PUSH_AT <= time < _PUSH_AT + p.push.duration
        force = np.zeros((self.size, 3))
        force[:, :2] = self._push[:, None] * self._towards if pushed else 0.0
        self.batch.push(force)
        target = trot(self.phase, command, parameters=p) + p.control.action_scale * self.action
        advance(self.batch, self.loops, target, watch=watch)
        self.motion = self.batch.motion
        self.fallen |= self.batch.fallen(self.motion)
        self.distance = np.where(self.fallen, self.distance, self.motion.position[:, 0])
