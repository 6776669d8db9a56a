"""The training environment: E robots on flat ground, or on a curriculum of grounds, randomised as the paper's Table S1.

Reward per second, weights in ``params.toml``; a step of the policy gives its share, so that returns stay near 1:

    r = w_v exp(-|v - v_c|^2/width) + w_t exp(-(omega_z - omega_c)^2/width) + w_z v_z^2 + w_r |omega_xy|^2
        + w_u |up_xy|^2 + w_h (z - z_0)^2 + w_tau |tau|^2 + w_a |a - a_last|^2,    and w_f for a fall

For commands beyond 1 m/s the first width grows with the square of the commanded speed.

In the curriculum every robot belongs to a column of tiles, one kind of ground. An episode ends, as timed out, at the
edge of the tile too; who gets there starts a level higher, who falls a level lower, who passed the last anywhere (after
N. Rudin et al., CoRL 2022).
"""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from .batch import Batch, Motion
from .gait import following, trot
from .loop import FilterChoice, JointLoop
from .params import Params, params
from .policy import ACTIONS, blurred, observe
from .ppo import Step
from .terrain import COLUMNS, HALF_TILE, LEVELS, Terrain, tile_centre

__all__ = ["PRIVILEGED", "Step", "Walk"]

FloatArray = NDArray[np.float64]

# Seen by the critic alone: velocity 3, height, payload, friction, gains 2.
PRIVILEGED = 8
# Part of the commands without a turn and a way to the side.
_STRAIGHT, _STRAIGHT_TILES = 0.2, 0.6


class Walk:
    """Randomised walking on flat ground.

    Parameters
    ----------
    size : int
        Number of environments.
    choice : FilterChoice, optional
        The filter in the loop; None: none.
    seed : int
    velocity : float
        Largest commanded forward speed, m/s; sideways speed and turn rate are the table's.
    threads : int
    parameters : Params, optional
        The robot; None: that of ``params.toml``.
    full : bool
        Full randomisation: heavier payloads, weak motors and pushes besides.
    curriculum : bool
        Tiles of growing difficulty instead of flat ground.
    """

    def __init__(
        self,
        size: int,
        choice: FilterChoice | None,
        *,
        seed: int,
        velocity: float | None = None,
        threads: int = 2,
        parameters: Params | None = None,
        full: bool = False,
        curriculum: bool = False,
    ) -> None:
        self.size = size
        self.parameters: Params = params() if parameters is None else parameters
        self.rng: np.random.Generator = np.random.default_rng(seed)
        self._tiles = curriculum
        ground = Terrain("tiles", 1.0) if curriculum else None
        self.batch: Batch = Batch(size, terrain=ground, threads=threads, parameters=self.parameters)
        self.loop: JointLoop = JointLoop(self.batch, choice, rng=self.rng)
        self._full = full
        training, control = self.parameters.training, self.parameters.control
        self._forward = self.parameters.randomisation.velocity[1] if velocity is None else velocity
        self._step_time = control.dt * control.decimation
        self._episode = round(training.episode / self._step_time)
        held = training.episode if curriculum else training.resample
        self._resample = round(held / self._step_time)
        self._push_steps = round(self.parameters.push.duration / self._step_time)
        self.phase: FloatArray = np.zeros(size)
        self.command: FloatArray = np.zeros((size, 3))
        self.action: FloatArray = np.zeros((size, ACTIONS))
        self.age: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self.payload: FloatArray = np.zeros(size)
        self.friction: FloatArray = np.zeros(size)
        self.force: FloatArray = np.zeros((size, 3))
        self.level: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self._column = np.arange(size) % len(COLUMNS)
        self._restart(np.arange(size))
        # Episodes end at different times.
        self.age = self.rng.integers(0, self._episode, size)

    def _restart(self, which: NDArray[np.intp]) -> None:
        if not len(which):
            return
        table, rng, k = self.parameters.randomisation, self.rng, len(which)
        nominal = self.parameters.control
        self.payload[which] = rng.uniform(*(table.full_payload if self._full else table.payload), k)
        if self._full:
            self.loop.strength[which, 0] = rng.uniform(*table.full_strength, k)
        self.friction[which] = rng.uniform(*table.friction, k)
        self.loop.kp[which, 0] = nominal.kp * rng.uniform(*table.gain, k)
        self.loop.kd[which, 0] = nominal.kd * rng.uniform(*table.gain, k)
        self.phase[which] = rng.uniform(0.0, 2.0 * np.pi, k)
        self.action[which] = 0.0
        self.age[which] = 0
        self._new_commands(which)
        self._physical()
        joints = trot(self.phase[which], np.zeros((k, 3)), parameters=self.parameters)
        place = None
        if self._tiles:
            yaw = rng.uniform(-np.pi, np.pi, k)
            place = np.column_stack([tile_centre(self.level[which], self._column[which]), yaw])
        self.batch.reset(which, joints=joints, place=place)
        chosen = np.zeros(self.size, dtype=bool)
        chosen[which] = True
        self.loop.restart(chosen)

    def _physical(self) -> None:
        self.batch.set_payload(self.payload)
        self.batch.set_friction(self.friction)

    def _new_commands(self, which: NDArray[np.intp]) -> None:
        low, high = self.parameters.randomisation.velocity
        k = len(which)
        self.command[which, 0] = self.rng.uniform(-self._forward, self._forward, k)
        self.command[which, 1:] = self.rng.uniform(low, high, (k, 2))
        # Some walk straight: what is judged later must not be rare, and nobody reaches the edge of a tile in circles.
        straight = self.rng.uniform(size=k) < (_STRAIGHT_TILES if self._tiles else _STRAIGHT)
        self.command[which, 1:] *= np.where(straight, 0.0, 1.0)[:, None]

    def observations(self) -> tuple[FloatArray, FloatArray]:
        """What policy and critic see now, (E, 47) and (E, 8)."""
        return self._observe(self.batch.motion)

    def _observe(self, motion: Motion) -> tuple[FloatArray, FloatArray]:
        p, nominal = self.parameters, self.parameters.control
        seen = observe(motion, self.phase, self.command, self.action, parameters=p)
        seen = blurred(seen, self.rng, parameters=p)
        privileged = np.column_stack(
            [
                motion.velocity,
                10.0 * (self._above(motion) - 0.3),
                self.payload / 3.0,
                self.friction,
                self.loop.kp[:, 0] / nominal.kp,
                self.loop.kd[:, 0] / nominal.kd,
            ]
        )
        return seen, privileged

    def step(self, action: FloatArray) -> Step:
        """Advance by one step of the policy; robots that fell or whose time is up start afresh.

        Parameters
        ----------
        action : (E, 12) array
        """
        p = self.parameters
        action = np.clip(action, -p.control.action_limit, p.control.action_limit)
        change = np.square(action - self.action).sum(axis=1)
        self.action = action
        self.phase = following(self.phase, self.command, parameters=p)
        if self._full:
            self._pushes()
        self.loop.advance(trot(self.phase, self.command, parameters=p) + p.control.action_scale * action)
        self.age += 1
        motion = self.batch.motion
        fallen = self.batch.fallen(motion)
        timeout = (self.age >= self._episode) & ~fallen
        if self._tiles:
            timeout |= self._climb(motion, fallen)
        reward = self._reward(motion, change, fallen)
        done = fallen | timeout
        self._new_commands(np.flatnonzero((self.age % self._resample == 0) & ~done))
        if done.any():
            self._restart(np.flatnonzero(done))
            motion = self.batch.motion
        seen, privileged = self._observe(motion)
        return Step(seen, privileged, reward, done, timeout)

    def _above(self, motion: Motion) -> FloatArray:
        """Heights of the trunks above the ground, m."""
        return motion.position[:, 2] - self.batch.terrain.height(*motion.position[:, :2].T)

    def _climb(self, motion: Motion, fallen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Who reached the edge of the tile; levels for the next start."""
        away = np.abs(motion.position[:, :2] - tile_centre(self.level, self._column)).max(axis=1)
        arrived = (away > HALF_TILE) & ~fallen
        level = np.maximum(self.level + arrived - fallen, 0)
        self.level = np.where(level < LEVELS, level, self.rng.integers(0, LEVELS, self.size))
        return arrived

    def _pushes(self) -> None:
        """A push begins with every new command, in any direction."""
        since = self.age % self._resample
        begins = np.flatnonzero((since == 0) & (self.age > 0))
        angle = self.rng.uniform(0.0, 2.0 * np.pi, len(begins))
        size = self.rng.uniform(0.0, self.parameters.randomisation.full_push, len(begins))
        self.force[begins, :2] = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self.force[(since >= self._push_steps) | (self.age == 0)] = 0.0
        self.batch.push(self.force)

    def _reward(self, motion: Motion, change: FloatArray, fallen: NDArray[np.bool_]) -> FloatArray:
        p, weights = self.parameters, self.parameters.reward
        off = np.square(motion.velocity[:, :2] - self.command[:, :2]).sum(axis=1)
        turn = np.square(motion.rate[:, 2] - self.command[:, 2])
        height = self._above(motion) - (p.gait.height + p.robot.foot_radius)
        return self._step_time * (
            weights.velocity
            * np.exp(-off / (weights.width * np.maximum(1.0, np.abs(self.command[:, 0])) ** 2))
            + weights.turn * np.exp(-turn / weights.width)
            + weights.vertical * motion.velocity[:, 2] ** 2
            + weights.rolling * np.square(motion.rate[:, :2]).sum(axis=1)
            + weights.tilt * np.square(motion.up[:, :2]).sum(axis=1)
            + weights.height * height**2
            + weights.torque * np.square(self.loop.torque).sum(axis=1)
            + weights.change * change
            + weights.fall * fallen
        )

    # -- to go on later --------------------------------------------------------------------------------------------

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Everything that the next step depends on, as arrays."""
        found: dict[str, NDArray[np.generic]] = {
            name: np.array(getattr(self, name)) for name in ("phase", "command", "action", "age", "payload")
        }
        found |= {"friction": self.friction.copy(), "force": self.force.copy()}
        if self._tiles:
            found["level"] = self.level.copy()
        found["rng"] = np.frombuffer(json.dumps(self.rng.bit_generator.state).encode(), dtype=np.uint8)
        found |= {f"batch_{name}": value for name, value in self.batch.state().items()}
        found |= {f"loop_{name}": value for name, value in self.loop.state().items()}
        return found

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there.

        Parameters
        ----------
        state : dict
            Of :meth:`state`, of as many environments.

        Raises
        ------
        ValueError
            If it is of another number of environments.
        """
        if len(state["phase"]) != self.size:
            raise ValueError(f"a state of {len(state['phase'])} environments, expected {self.size}")
        tiles = ("level",) if self._tiles else ()
        for name in ("phase", "command", "action", "age", "payload", "friction", "force", *tiles):
            setattr(self, name, np.array(state[name]))
        self.rng.bit_generator.state = json.loads(state["rng"].tobytes().decode())
        self._physical()
        self.batch.restore(_part(state, "batch_"))
        self.loop.restore(_part(state, "loop_"))


def _part(state: dict[str, NDArray[np.generic]], prefix: str) -> dict[str, NDArray[np.generic]]:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}
