"""PPO for a batch of robots: collection, learning, checkpoints. What is trained comes as an :class:`Environment`.

The algorithm is rsl_rl's (Rudin et al. 2022, the paper's baseline). A checkpoint holds networks, optimiser, generators
and environments as plain arrays: a resumed training goes on as if it had not been interrupted.
"""

from __future__ import annotations

import contextlib
import io
import json
import time
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl._output import replacing

from .network import Network
from .params import Training as Settings

__all__ = ["Environment", "Job", "Learner", "Step", "library", "means", "train"]

N = TypeVar("N", bound=Network)

FloatArray = NDArray[np.float64]
_FORMAT = "phyfilter-ctl training 2"
# A point of the reward curve in the record: mean of so many iterations.
_CURVE = 10
# Steps of the policy, of all robots here; for what is reported.
_PER_SECOND = 50.0


@dataclass(frozen=True)
class Step:
    """What one step of all environments gave.

    Attributes
    ----------
    observations : (E, n) array
    privileged : (E, m) array
    reward : (E,) array
    done, timeout : (E,) bool array
        done: the episode ended; timeout: because its time was up.
    """

    observations: FloatArray
    privileged: FloatArray
    reward: FloatArray
    done: NDArray[np.bool_]
    timeout: NDArray[np.bool_]


class Environment(Protocol):
    """E robots that are trained together."""

    size: int

    def observations(self) -> tuple[FloatArray, FloatArray]:
        """What policy and critic see now, (E, n) and (E, m)."""
        ...

    def step(self, action: FloatArray) -> Step:
        """Advance by one step of the policy; what fell or timed out starts afresh."""
        ...

    def state(self) -> dict[str, NDArray[np.generic]]:
        """Everything that the next step depends on, as arrays."""
        ...

    def restore(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Go on from there."""
        ...


def _torch() -> Any:
    try:
        torch = import_module("torch")
        import_module("rsl_rl")
    except ImportError as error:
        raise ImportError(
            f"training needs the extra train ({error.name} is missing): pip install 'phyfilter-ctl[train]'"
        ) from None
    return torch


@dataclass(frozen=True)
class Job:
    """What is trained.

    Parameters
    ----------
    seed : int
    iterations, environments : int, optional
        None: those of the parameter file.

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


class Learner(ABC, Generic[N]):
    """PPO that goes on iteration by iteration.

    Parameters
    ----------
    make : callable
        Makes the environment; called once the extra is known to be there.
    settings : Settings
        Of the algorithm, from a parameter file.
    job : Job
        Its seed is that of the networks and of exploration.
    wanted : dict
        What is trained, as JSON; a checkpoint of another is refused.
    actions : int
        Of the policy.

    Raises
    ------
    ImportError
        Without the extra ``train``.
    """

    def __init__(
        self,
        make: Callable[[], Environment],
        settings: Settings,
        job: Job,
        *,
        wanted: dict[str, Any],
        actions: int,
    ) -> None:
        self._t = _torch()
        self._t.set_num_threads(1)
        self._t.manual_seed(job.seed)
        self.settings: Settings = settings
        self.iterations: int = settings.iterations if job.iterations is None else job.iterations
        self._wanted = wanted
        self.environment: Environment = make()
        self._last = self.environment.observations()
        self._algorithm = self._make(actions)
        self.rewards: list[float] = []
        self.seconds: float = 0.0

    @property
    def done(self) -> int:
        """Iterations done."""
        return len(self.rewards)

    @property
    def steps(self) -> int:
        """Steps of the policy in all environments so far."""
        return self.done * self.settings.horizon * self.environment.size

    @abstractmethod
    def policy(self) -> N:
        """The policy as it is now."""

    def _tensors(self, seen: FloatArray, privileged: FloatArray) -> Any:
        as_tensor, number = self._t.as_tensor, self._t.float32
        parts = {"seen": as_tensor(seen, dtype=number), "privileged": as_tensor(privileged, dtype=number)}
        return import_module("tensordict").TensorDict(parts, batch_size=[len(seen)])

    def _make(self, actions: int) -> Any:
        p = self.settings
        network = {"class_name": "MLPModel", "activation": "elu", "obs_normalization": True}
        noise = {"class_name": "GaussianDistribution", "init_std": p.deviation}
        settings: dict[str, Any] = {
            "actor": network | {"hidden_dims": list(p.actor), "distribution_cfg": noise},
            "critic": network | {"hidden_dims": list(p.critic)},
            "algorithm": {
                "class_name": "PPO",
                "num_learning_epochs": p.epochs,
                "num_mini_batches": p.batches,
                "gamma": p.discount,
                "lam": p.trace,
                "entropy_coef": p.entropy,
                "learning_rate": p.learning_rate,
                "schedule": "fixed",
                "desired_kl": None,
            },
            "obs_groups": {"actor": ["seen"], "critic": ["seen", "privileged"]},
            "num_steps_per_env": p.horizon,
            "multi_gpu": None,
        }
        shape = _Shape(self.environment.size, actions)
        # The library prints its networks.
        with contextlib.redirect_stdout(io.StringIO()):
            made = import_module("rsl_rl.algorithms").PPO.construct_algorithm(
                self._tensors(*(np.zeros_like(part) for part in self._last)),
                shape,
                settings,
                "cpu",
            )
        last = made.actor.mlp[-1]
        with self._t.no_grad():  # the untrained policy is the reference itself
            last.weight *= 0.1
            last.bias *= 0.0
        made.actor.train()
        made.critic.train()
        return made

    def iterate(self) -> float:
        """One iteration: collect, learn; the mean reward per step."""
        begin = time.perf_counter()
        t, algorithm = self._t, self._algorithm
        total = 0.0
        with t.inference_mode():
            now = self._tensors(*self._last)
            for _ in range(self.settings.horizon):
                found = self.environment.step(algorithm.act(now).double().numpy())
                self._last = (found.observations, found.privileged)
                now = self._tensors(*self._last)
                self._remember(now, found)
                total += float(found.reward.mean())
            algorithm.compute_returns(now)
        algorithm.update()
        self.rewards.append(total / self.settings.horizon)
        self.seconds += time.perf_counter() - begin
        return self.rewards[-1]

    def _remember(self, now: Any, found: Step) -> None:
        t = self._t
        self._algorithm.process_env_step(
            now,
            t.as_tensor(found.reward, dtype=t.float32),
            t.as_tensor(found.done),
            {"time_outs": t.as_tensor(found.timeout, dtype=t.float32)},
        )

    def layers(self) -> tuple[tuple[FloatArray, FloatArray], ...]:
        """The policy as it is now, its normalisation folded into the first layer: weights and biases."""
        actor = self._algorithm.actor
        mean = actor.obs_normalizer.mean.double().numpy()
        scale = 1.0 / (actor.obs_normalizer.std.double().numpy() + actor.obs_normalizer.eps)
        layers = [
            (part.weight.detach().double().numpy(), part.bias.detach().double().numpy())
            for part in actor.mlp
            if hasattr(part, "weight")
        ]
        weights, bias = layers[0]
        layers[0] = (weights * scale, bias - weights @ (scale * mean))
        return tuple(layers)

    def record(self) -> dict[str, Any]:
        """How it was trained so far."""
        return {
            "environments": self.environment.size,
            "iterations": self.done,
            "steps": self.steps,
            "seconds": round(self.seconds, 1),
            "library": library(),
            "reward_every": _CURVE,
            "reward": means(self.rewards),
        }

    def timed_update(self) -> tuple[Callable[[], None], list[float]]:
        """Time the library's learning; returns what stops it, and the list that fills with seconds."""
        plain, spent = self._algorithm.update, []

        def update() -> object:
            begin = time.perf_counter()
            found = plain()
            spent.append(time.perf_counter() - begin)
            return found

        def stop() -> None:
            self._algorithm.update = plain

        self._algorithm.update = update
        return stop, spent

    # -- to go on later --------------------------------------------------------------------------------------------

    def checkpoint(self) -> dict[str, NDArray[np.generic]]:
        """Everything, as arrays."""
        algorithm = self._algorithm
        found: dict[str, NDArray[np.generic]] = {
            f"walk_{name}": value for name, value in self.environment.state().items()
        }
        for part in ("actor", "critic"):
            for name, value in getattr(algorithm, part).state_dict().items():
                found[f"{part}_{name}"] = value.numpy().copy()
        for k, entries in algorithm.optimizer.state_dict()["state"].items():
            found |= {f"optimizer_{k}_{name}": value.numpy().copy() for name, value in entries.items()}
        head = {
            "format": _FORMAT,
            "training": self._wanted,
            "seconds": self.seconds,
            "learning_rate": algorithm.learning_rate,
        }
        found |= {
            "rewards": np.array(self.rewards),
            "torch": self._t.get_rng_state().numpy().copy(),
            "seen": self._last[0],
            "privileged": self._last[1],
            "head": np.frombuffer(json.dumps(head).encode(), dtype=np.uint8),
        }
        return found

    def restore(self, checkpoint: dict[str, NDArray[np.generic]]) -> None:
        """Go on from a checkpoint.

        Parameters
        ----------
        checkpoint : dict
            Of :meth:`checkpoint`.

        Raises
        ------
        ValueError
            If it is none, or of another training.
        """
        try:
            head = json.loads(checkpoint["head"].tobytes().decode())
        except (KeyError, ValueError):
            raise ValueError("no checkpoint of a training") from None
        if head.get("format") != _FORMAT:
            raise ValueError(f"a checkpoint of the format {head.get('format')!r}, expected {_FORMAT!r}")
        mine, its = self._wanted, head["training"]
        names = [*mine, *(name for name in its if name not in mine)]
        differing = [name for name in names if name != "iterations" and mine.get(name) != its.get(name)]
        if differing:
            told = ", ".join(f"{name} {its.get(name)}, not {mine.get(name)}" for name in differing)
            raise ValueError(f"a checkpoint of another training: {told}")
        t, algorithm = self._t, self._algorithm
        for part in ("actor", "critic"):
            prefix = f"{part}_"
            values = {
                name.removeprefix(prefix): t.as_tensor(np.array(value))
                for name, value in checkpoint.items()
                if name.startswith(prefix)
            }
            getattr(algorithm, part).load_state_dict(values)
        state = algorithm.optimizer.state_dict()
        state["state"] = {}
        for name, value in checkpoint.items():
            if name.startswith("optimizer_"):
                _, k, entry = name.split("_", 2)
                state["state"].setdefault(int(k), {})[entry] = t.as_tensor(np.array(value))
        algorithm.optimizer.load_state_dict(state)
        algorithm.learning_rate = head["learning_rate"]
        for group in algorithm.optimizer.param_groups:
            group["lr"] = head["learning_rate"]
        t.set_rng_state(t.as_tensor(np.array(checkpoint["torch"])))
        self.environment.restore(
            {name[5:]: value for name, value in checkpoint.items() if name.startswith("walk_")}
        )
        self._last = (
            np.array(checkpoint["seen"], dtype=float),
            np.array(checkpoint["privileged"], dtype=float),
        )
        self.rewards = [float(value) for value in checkpoint["rewards"]]
        self.seconds = head["seconds"]


def means(values: Sequence[float]) -> list[float]:
    """A curve as the record has it, each point the mean of ten iterations.

    Parameters
    ----------
    values : sequence of float
        One an iteration.
    """
    return [round(float(np.mean(values[k : k + _CURVE])), 4) for k in range(0, len(values), _CURVE)]


@dataclass(frozen=True)
class _Shape:
    """What the library asks of an environment when it makes the networks."""

    num_envs: int
    num_actions: int


def library() -> str:
    """What trains, with versions."""
    from importlib.metadata import version

    return f"rsl-rl-lib {version('rsl-rl-lib')}, torch {version('torch')}, mujoco {version('mujoco')}"


def train(
    learner: Learner[N],
    *,
    checkpoint: Path | None = None,
    every: int = 50,
    report: Callable[[str], None] | None = None,
) -> N:
    """Train a policy, or go on with one.

    Parameters
    ----------
    learner : Learner
    checkpoint : Path, optional
        An .npz file: read if it is there, written every so often and at the end.
    every : int
        Iterations between checkpoints.
    report : callable, optional
        Called with a few words at the beginning of every iteration.

    Raises
    ------
    ValueError
        If the checkpoint is of another training.
    """
    if checkpoint is not None and checkpoint.is_file():
        try:
            with np.load(checkpoint, allow_pickle=False) as file:
                found = dict(file)
        except (ValueError, zipfile.BadZipFile) as error:
            raise ValueError(f"{checkpoint}: no checkpoint of a training: {error}") from None
        learner.restore(found)
    while learner.done < learner.iterations:
        if report is not None:
            latest = f"{learner.rewards[-1] * _PER_SECOND:.3f}" if learner.rewards else "-"
            report(f"iteration {learner.done + 1}/{learner.iterations}, reward per second {latest}")
        learner.iterate()
        if checkpoint is not None and (learner.done % every == 0 or learner.done == learner.iterations):
            _write(checkpoint, learner)
    return learner.policy()


def _write(path: Path, learner: Learner[N]) -> None:
    with replacing(path) as file:
        np.savez(file, **learner.checkpoint())  # pyright: ignore[reportArgumentType] - arrays by name
