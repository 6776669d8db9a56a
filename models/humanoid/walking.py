"""Training of the Berkeley Humanoid's policy: residual PPO on the steps, by the quadruped's learner.

phyfilter-ctl run humanoid --robot berkeley --train --seed 0 --checkpoint berkeley-0.npz --out berkeley-0.json
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ..quadruped.ppo import Job, Learner
from .crowd import JOINTS
from .practice import Practice
from .walk_params import walk_params
from .walks import Policy

__all__ = ["Trainer"]


class Trainer(Learner[Policy]):
    """PPO of steps and walks, iteration by iteration.

    Parameters
    ----------
    training : Job
    threads : int
        Of the simulator.

    Raises
    ------
    ImportError
        Without the extra ``train``.
    ValueError
        Without the extra ``mujoco``.
    """

    def __init__(self, training: Job, *, threads: int = 1) -> None:
        self.training = training
        numbers = walk_params().training
        size = numbers.environments if training.environments is None else training.environments
        super().__init__(
            lambda: Practice(size, seed=training.seed, threads=threads),
            numbers,
            training,
            wanted=asdict(training),
            actions=JOINTS,
        )

    def record(self) -> dict[str, Any]:
        """How it was trained."""
        return {"seed": self.training.seed} | super().record()

    def policy(self) -> Policy:
        """The policy as it is now."""
        return Policy(self.layers(), "berkeley", self.record())
