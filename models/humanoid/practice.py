"""Training environment of the Berkeley Humanoid: steps, walks, constant forces and shoves, told of them or not.

Reward per second, weights in ``berkeley/walk.toml``:

    r = w_v exp(-|v - v_c|^2/width) + w_t exp(-(omega_z - omega_c)^2/width) + w_z v_z^2 + w_r |omega_xy|^2
        + w_u |up_xy|^2 + w_h (z - z_0)^2 + w_tau |tau|^2 + w_a |a - a_last|^2 + w_b |a|^2,    and w_f for a fall

Half of the episodes tell the policy the force (and that they do): what an estimate can later be put in for.
"""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from ..quadruped.bodies import Motion
from ..quadruped.ppo import Step
from .crowd import JOINTS, Crowd
from .robot import FloatArray
from .stepping import Clock, neutral
from .walk_params import walk_params

__all__ = ["OBSERVATIONS", "Practice", "observe"]

OBSERVATIONS = 53
_FORCE = 20.0  # N, one unit of what is seen
_SHOVE_STEPS = 10


def observe(
    motion: Motion, phase: FloatArray, command: FloatArray, action: FloatArray, told: FloatArray
) -> FloatArray:
    """What the policy sees.

    Parameters
    ----------
    motion : Motion
    phase : (E,) array
        Of the cycle, in [0, 1).
    command : (E, 3) array
    action : (E, 12) array
        The last one.
    told : (E, 3) array
        Horizontal force in the trunk's heading, N, and whether it is one (1) or nothing is known (0).

    Returns
    -------
    (E, 53) array
    """
    angle = 2.0 * np.pi * phase[:, None]
    parts = (
        motion.up,
        0.25 * motion.rate,
        2.0 * motion.velocity,
        2.0 * command,
        motion.q - neutral().q,
        0.05 * motion.qd,
        action,
        np.sin(angle),
        np.cos(angle),
        told[:, :2] / _FORCE,
        told[:, 2:],
    )
    return np.concatenate(parts, axis=1)


def turned(force: FloatArray, yaw: FloatArray) -> FloatArray:
    """Horizontal forces (E, 2) of the world in the headings of the trunks."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]], axis=1)


class Practice:
    """E robots that practise.

    Parameters
    ----------
    size : int
        Number of robots.
    seed : int
    threads : int
        Of MuJoCo's pool.
    """

    def __init__(self, size: int, *, seed: int, threads: int = 1) -> None:
        self.size = size
        self.rng: np.random.Generator = np.random.default_rng(seed)
        numbers, servo = walk_params().training, walk_params().servo
        coarse = walk_params().practice.timestep
        self.crowd: Crowd = Crowd(size, friction="pyramidal", timestep=coarse, threads=threads)
        self.clock: Clock = Clock(size)
        self._step_time = servo.timestep * servo.decimation
        self._count = round(self._step_time / coarse)
        self._episode = round(numbers.episode / self._step_time)
        self._resample = round(numbers.resample / self._step_time)
        self.command: FloatArray = np.zeros((size, 3))
        self.action: FloatArray = np.zeros((size, JOINTS))
        self.age: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self.friction: FloatArray = np.zeros(size)
        self.gain: FloatArray = np.ones((size, 1))
        self.force: FloatArray = np.zeros((size, 2))
        self.shove: FloatArray = np.zeros((size, 2))
        self.told: FloatArray = np.zeros((size, 1))
        self._restart(np.arange(size))
        # Episodes end at different times.
        self.age = self.rng.integers(0, self._episode, size)

    def _restart(self, which: NDArray[np.intp]) -> None:
        if not len(which):
            return
        numbers, rng, k = walk_params().practice, self.rng, len(which)
        self.friction[which] = rng.uniform(*numbers.friction, k)
        self.gain[which, 0] = rng.uniform(*numbers.gain, k)
        self.told[which, 0] = rng.uniform(size=k) < numbers.told
        self.action[which], self.age[which] = 0.0, 0
        self._stretch(which)
        self.shove[which] = 0.0
        self.crowd.set_friction(self.friction)
        self.crowd.reset(which, np.tile(neutral().q, (k, 1)), rng.uniform(-np.pi, np.pi, k))
        self.clock.restart(which, 0.5 * rng.integers(0, 2, k).astype(float))

    def _stretch(self, which: NDArray[np.intp]) -> None:
        """A new command, force and shove."""
        numbers, rng, k = walk_params().practice, self.rng, len(which)
        fastest = np.array(numbers.velocity)
        moving = rng.uniform(size=(k, 1)) >= numbers.still
        self.command[which] = moving * rng.uniform(-fastest, fastest, (k, 3))
        for force, largest, share in (
            (self.force, numbers.force, numbers.free),
            (self.shove, numbers.shove, numbers.free),
        ):
            angle, size = rng.uniform(0.0, 2.0 * np.pi, k), rng.uniform(0.0, largest, k)
            size *= rng.uniform(size=k) >= share
            force[which] = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def observations(self) -> tuple[FloatArray, FloatArray]:
        """What policy and critic see now, (E, 53) and (E, 8)."""
        return self._observe(self.crowd.motion)

    def _observe(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        force = turned(self.force, motion.yaw)
        told = np.concatenate([self.told * force, self.told], axis=1)
        seen = observe(motion, self.clock.phase, self.command, self.action, told)
        numbers = walk_params().practice
        noise = np.repeat(
            [
                numbers.noise_angle,
                0.25 * numbers.noise_rate,
                2.0 * numbers.noise_velocity,
                0.0,
                numbers.noise_angle,
                0.05 * numbers.noise_rate,
                0.0,
            ],
            [3, 3, 3, 3, JOINTS, JOINTS, JOINTS + 5],
        )
        seen += noise * self.rng.uniform(-1.0, 1.0, seen.shape)
        shove = turned(self._shoving(), motion.yaw)
        height = 10.0 * (motion.position[:, 2:] - neutral().height)
        friction = self.friction[:, None]
        privileged = [force / _FORCE, shove / _FORCE, height, friction, self.gain, motion.velocity[:, :1]]
        return seen, np.concatenate(privileged, axis=1)

    def _shoving(self) -> FloatArray:
        return self.shove * ((self.age % self._resample) < _SHOVE_STEPS)[:, None]

    def step(self, action: FloatArray) -> Step:
        """Advance by one step of the policy; robots that fell or whose time is up start afresh.

        Parameters
        ----------
        action : (E, 12) array
        """
        servo, crowd = walk_params().servo, self.crowd
        action = np.clip(action, -servo.action_limit, servo.action_limit)
        change = np.square(action - self.action).sum(axis=1)
        self.action = action
        motion = crowd.motion
        steps = self.clock.target(motion.velocity, motion.up, motion.rate, self.command)
        target = steps + servo.action_scale * action
        target = neutral().q + self.gain * (target - neutral().q)
        crowd.push(self.force + self._shoving())
        crowd.step(target, count=self._count)
        self.age += 1
        motion, fallen = crowd.motion, crowd.fallen
        timeout = (self.age >= self._episode) & ~fallen
        reward = self._reward(motion, change, fallen)
        done = fallen | timeout
        self._stretch(np.flatnonzero((self.age % self._resample == 0) & ~done))
        if done.any():
            self._restart(np.flatnonzero(done))
            motion = crowd.motion
        seen, privileged = self._observe(motion)
        return Step(seen, privileged, reward, done, timeout)

    def _reward(self, motion: Motion, change: FloatArray, fallen: NDArray[np.bool_]) -> FloatArray:
        weights = walk_params().reward
        off = np.square(motion.velocity[:, :2] - self.command[:, :2]).sum(axis=1)
        turn = np.square(motion.rate[:, 2] - self.command[:, 2])
        found = self._step_time * (
            weights.velocity * np.exp(-off / weights.width)
            + weights.turn * np.exp(-turn / weights.width)
            + weights.vertical * motion.velocity[:, 2] ** 2
            + weights.rolling * np.square(motion.rate[:, :2]).sum(axis=1)
            + weights.tilt * np.square(motion.up[:, :2]).sum(axis=1)
            + weights.height * (motion.position[:, 2] - neutral().height) ** 2
            + weights.torque * np.square(self.crowd.torque).sum(axis=1)
            + weights.change * change
            + weights.action * np.square(self.action).sum(axis=1)
            + weights.fall * fallen
        )
        return np.nan_to_num(found, nan=self._step_time * weights.fall)

    # -- to go on later --------------------------------------------------------------------------------------------

    _KEPT = ("command", "action", "age", "friction", "gain", "force", "shove", "told")

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Everything that the next step depends on, as arrays."""
        found: dict[str, NDArray[np.generic]] = {name: np.array(getattr(self, name)) for name in self._KEPT}
        found["rng"] = np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), dtype=np.uint8)
        found |= {f"crowd_{name}": value for name, value in self.crowd.state().items()}
        found |= {f"clock_{name}": value for name, value in self.clock.state().items()}
        return found

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there.

        Parameters
        ----------
        state : dict
            Of :meth:`state`, of as many robots.

        Raises
        ------
        ValueError
            If it is of another number of robots.
        """
        if len(state["age"]) != self.size:
            raise ValueError(f"a state of {len(state['age'])} robots, expected {self.size}")
        for name in self._KEPT:
            setattr(self, name, np.array(state[name]))
        self.rng.bit_generator.state = json.loads(state["rng"].tobytes().decode())
        self.crowd.set_friction(self.friction)
        for name, part in (("crowd_", self.crowd), ("clock_", self.clock)):
            part.restore(
                {key.removeprefix(name): value for key, value in state.items() if key.startswith(name)}
            )
