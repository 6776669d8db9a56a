"""Training: residual PPO on the trot, on flat ground or a curriculum, with a filter in the loop or without.

What is trained and its record are here, the algorithm is in ``ppo.py``.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .environment import Walk
from .loop import FilterChoice
from .params import Params, params
from .policy import ACTIONS, Policy
from .ppo import Job, Learner, library, means, train

__all__ = ["Trainer", "Training", "curve_text", "measure", "throughput_text", "train"]


@dataclass(frozen=True)
class Training(Job):
    """What is trained.

    Parameters
    ----------
    seed, iterations, environments
        As for :class:`Job`.
    choice : FilterChoice, optional
        The filter in the loop; None: without.
    velocity : float
        Largest commanded forward speed, m/s.
    robot : str
        Of ``params.ROBOTS``.
    full : bool
        Full domain randomisation.
    curriculum : bool
        Tiles of growing difficulty instead of flat ground.

    Raises
    ------
    ValueError
        For counts below 1, a speed that is not positive or another robot.
    """

    choice: FilterChoice | None = None
    velocity: float = 1.0
    robot: str = "lite3-primitives"
    full: bool = False
    curriculum: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        fastest = params(self.robot).gait.speed_high
        if not 0.0 < self.velocity <= fastest:
            raise ValueError(f"velocity: expected a speed up to {fastest} m/s, got {self.velocity}")


class Trainer(Learner[Policy]):
    """PPO of a walk, iteration by iteration.

    Parameters
    ----------
    training : Training
    threads : int
        Of the simulator; the networks are too small for more than one.

    Raises
    ------
    ImportError
        Without the extras ``mujoco`` and ``train``.
    """

    def __init__(self, training: Training, *, threads: int = 2) -> None:
        self.parameters: Params = params(training.robot)
        self.training = training
        # Mean over the robots, of the curriculum.
        self.levels: list[float] = []
        wanted: dict[str, Any] = json.loads(json.dumps(asdict(training)))
        if not training.curriculum:
            del wanted["curriculum"]
        settings = self.parameters.training
        super().__init__(lambda: self._walk(threads), settings, training, wanted=wanted, actions=ACTIONS)

    def _walk(self, threads: int) -> Walk:
        training, usual = self.training, self.parameters.training.environments
        self.walk: Walk = Walk(
            usual if training.environments is None else training.environments,
            training.choice,
            seed=training.seed,
            velocity=training.velocity,
            threads=threads,
            parameters=self.parameters,
            full=training.full,
            curriculum=training.curriculum,
        )
        return self.walk

    def iterate(self) -> float:
        """One iteration: collect, learn; the mean reward per step."""
        reward = super().iterate()
        self.levels.append(float(self.walk.level.mean()))
        return reward

    def checkpoint(self) -> dict[str, NDArray[np.generic]]:
        """Everything, as arrays."""
        return super().checkpoint() | {"levels": np.array(self.levels)}

    def restore(self, checkpoint: dict[str, NDArray[np.generic]]) -> None:
        """Go on from a checkpoint, as any learner does."""
        super().restore(checkpoint)
        self.levels = [float(value) for value in checkpoint.get("levels", np.zeros(self.done))]

    def policy(self) -> Policy:
        """The policy as it is now."""
        return Policy(self.layers(), self.training.robot, self.record())

    def record(self) -> dict[str, Any]:
        """How it was trained."""
        tiles = {"curriculum": True, "level": means(self.levels)} if self.training.curriculum else {}
        return {
            "seed": self.training.seed,
            "filter": None if self.training.choice is None else asdict(self.training.choice),
            "velocity": self.training.velocity,
            "full_randomisation": self.training.full,
        } | (super().record() | tiles)


def _step_time() -> float:
    return params().control.dt * params().control.decimation


def measure(training: Training, *, iterations: int = 12, threads: int = 2) -> dict[str, float]:
    """Steps per second with learning, beside the simulation alone.

    Parameters
    ----------
    training : Training
    iterations : int
        Measured, after one that warms up.
    threads : int
        Of the simulator.

    Returns
    -------
    dict
        Policy steps per second: "collect_and_learn", "learn" (seconds per iteration), "environment" (no network),
        "mujoco" (constant torques).
    """
    from .comparison import throughput

    trainer = Trainer(training, threads=threads)
    trainer.iterate()
    update, spent = trainer.timed_update()
    begin = time.perf_counter()
    for _ in range(iterations):
        trainer.iterate()
    total = time.perf_counter() - begin
    update()
    steps = trainer.parameters.training.horizon * trainer.walk.size
    begin, action = time.perf_counter(), np.zeros((trainer.walk.size, ACTIONS))
    for _ in range(100):
        trainer.walk.step(action)
    alone = 100 * trainer.walk.size / (time.perf_counter() - begin)
    speed = throughput(robots=trainer.walk.size, threads=threads, parameters=trainer.parameters)
    return {
        "collect_and_learn": iterations * steps / total,
        "environment": alone,
        "mujoco": speed.bare / trainer.parameters.control.decimation,
        "learn_seconds_per_iteration": sum(spent) / iterations,
        "environments": float(trainer.walk.size),
    }


def throughput_text(found: dict[str, float]) -> str:
    """What :func:`measure` found, in words.

    Parameters
    ----------
    found : dict
    """
    return (
        f"steps of the policy (20 ms) per second, {found['environments']:.0f} robots, {library()}\n"
        f"  MuJoCo alone             {found['mujoco']:8.0f}\n"
        f"  training environment     {found['environment']:8.0f}\n"
        f"  collecting and learning  {found['collect_and_learn']:8.0f}   "
        f"({1e3 * found['learn_seconds_per_iteration']:.0f} ms of learning per iteration)"
    )


def curve_text(rewards: Sequence[float], points: int = 10) -> str:
    """A reward curve as a line of numbers, per second.

    Parameters
    ----------
    rewards : sequence of float
        Per step of the policy.
    points : int
        At most so many.
    """
    every = max(1, len(rewards) // points)
    return " ".join(f"{value / _step_time():.2f}" for value in rewards[::every])
