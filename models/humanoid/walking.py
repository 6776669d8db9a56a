"""Training of the Berkeley Humanoid's policy: residual PPO on the steps, by the quadruped's learner.

phyfilter-ctl run humanoid --robot berkeley --train --seed 0 --checkpoint berkeley-0.npz --out berkeley-0.json
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..quadruped.ppo import Learner, learn
from .crowd import JOINTS
from .practice import Practice
from .walk_params import walk_params
from .walks import Policy

__all__ = ["Trainer", "Training", "train"]


@dataclass(frozen=True)
class Training:
    """What is trained.

    Parameters
    ----------
    seed : int
    iterations, environments : int, optional
        None: those of ``berkeley/walk.toml``.

    Raises
    ------
    ValueError
        For counts below 1.
    """

    seed: int
    iterations: int | None = None
    environments: int | None = None

    def __post_init__(self) -> None:
        for name in ("iterations", "environments"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}: expected 1 or more, got {value}")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")


class Trainer(Learner):
    """PPO of steps and walks, iteration by iteration.

    Parameters
    ----------
    training : Training
    threads : int
        Of the simulator.

    Raises
    ------
    ImportError
        Without the extra ``train``.
    ValueError
        Without the extra ``mujoco``.
    """

    def __init__(self, training: Training, *, threads: int = 1) -> None:
        self.training = training
        numbers = walk_params().training
        size = numbers.environments if training.environments is None else training.environments
        super().__init__(
            lambda: Practice(size, seed=training.seed, threads=threads),
            numbers,
            wanted=asdict(training),
            seed=training.seed,
            actions=JOINTS,
            iterations=training.iterations,
        )

    def record(self) -> dict[str, Any]:
        """How it was trained."""
        return {"seed": self.training.seed} | super().record()

    def policy(self) -> Policy:
        """The policy as it is now."""
        return Policy(self.layers(), "berkeley", self.record())


def train(
    trainer: Trainer,
    *,
    checkpoint: Path | None = None,
    every: int = 20,
    report: Callable[[str], None] | None = None,
) -> Policy:
    """Train a policy, or go on with one.

    Parameters
    ----------
    trainer : Trainer
    checkpoint, every, report
        As for :func:`models.quadruped.ppo.learn`.

    Raises
    ------
    ValueError
        If the checkpoint is of another training.
    """
    learn(trainer, checkpoint=checkpoint, every=every, report=report)
    return trainer.policy()
