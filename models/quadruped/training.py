"""Training: residual PPO on the trot, flat ground only, with a filter in the loop or without.

The algorithm is rsl_rl's (Rudin et al. 2022, the paper's baseline); collection, checkpoints and the record are here. A
checkpoint holds networks, optimiser, generators and environments as plain arrays: a resumed training goes on as if it
had not been interrupted.
"""

from __future__ import annotations

import contextlib
import io
import json
import time
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl._output import replacing

from .environment import PRIVILEGED, Step, Walk
from .loop import FilterChoice
from .params import Params, params
from .policy import ACTIONS, OBSERVATIONS, Policy

__all__ = ["Trainer", "Training", "curve_text", "measure", "throughput_text", "train"]

FloatArray = NDArray[np.float64]
_FORMAT = "phyfilter-ctl training 2"
# A point of the reward curve in the record: mean of so many iterations.
_CURVE = 10


@dataclass(frozen=True)
class Training:
    """What is trained.

    Parameters
    ----------
    seed : int
    choice : FilterChoice, optional
        The filter in the loop; None: without.
    iterations : int, optional
        None: those of ``params.toml``.
    environments : int, optional
    velocity : float
        Largest commanded forward speed, m/s.
    robot : str
        Of ``params.ROBOTS``.
    full : bool
        Full domain randomisation.

    Raises
    ------
    ValueError
        For counts below 1, a speed that is not positive or another robot.
    """

    seed: int
    choice: FilterChoice | None = None
    iterations: int | None = None
    environments: int | None = None
    velocity: float = 1.0
    robot: str = "lite3-primitives"
    full: bool = False

    def __post_init__(self) -> None:
        for name in ("iterations", "environments"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}: expected 1 or more, got {value}")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")
        fastest = params(self.robot).gait.speed_high
        if not 0.0 < self.velocity <= fastest:
            raise ValueError(f"velocity: expected a speed up to {fastest} m/s, got {self.velocity}")


def _torch() -> Any:
    try:
        torch = import_module("torch")
        import_module("rsl_rl")
    except ImportError as error:
        raise ImportError(
            f"training needs the extra train ({error.name} is missing): pip install 'phyfilter-ctl[train]'"
        ) from None
    return torch


class Trainer:
    """PPO that goes on iteration by iteration.

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
        self._t = _torch()
        self._t.set_num_threads(1)
        self._t.manual_seed(training.seed)
        self.parameters: Params = params(training.robot)
        p = self.parameters.training
        self.training = training
        self.iterations: int = p.iterations if training.iterations is None else training.iterations
        size = p.environments if training.environments is None else training.environments
        self.walk: Walk = Walk(
            size,
            training.choice,
            seed=training.seed,
            velocity=training.velocity,
            threads=threads,
            parameters=self.parameters,
            full=training.full,
        )
        self._last = self.walk.observations()
        self._algorithm = self._make(size)
        self.rewards: list[float] = []
        self.seconds: float = 0.0

    @property
    def done(self) -> int:
        """Iterations done."""
        return len(self.rewards)

    @property
    def steps(self) -> int:
        """Steps of the policy in all environments so far."""
        return self.done * self.parameters.training.horizon * self.walk.size

    def _tensors(self, seen: FloatArray, privileged: FloatArray) -> Any:
        as_tensor, number = self._t.as_tensor, self._t.float32
        parts = {"seen": as_tensor(seen, dtype=number), "privileged": as_tensor(privileged, dtype=number)}
        return import_module("tensordict").TensorDict(parts, batch_size=[len(seen)])

    def _make(self, size: int) -> Any:
        p = self.parameters.training
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
        shape = _Shape(size, ACTIONS)
        # The library prints its networks.
        with contextlib.redirect_stdout(io.StringIO()):
            made = import_module("rsl_rl.algorithms").PPO.construct_algorithm(
                self._tensors(np.zeros((size, OBSERVATIONS)), np.zeros((size, PRIVILEGED))),
                shape,
                settings,
                "cpu",
            )
        last = made.actor.mlp[-1]
        with self._t.no_grad():  # the untrained policy is the trot itself
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
            for _ in range(self.parameters.training.horizon):
                found = self.walk.step(algorithm.act(now).double().numpy())
                self._last = (found.observations, found.privileged)
                now = self._tensors(*self._last)
                self._remember(now, found)
                total += float(found.reward.mean())
            algorithm.compute_returns(now)
        algorithm.update()
        self.rewards.append(total / self.parameters.training.horizon)
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

    def policy(self) -> Policy:
        """The policy as it is now, its normalisation folded into the first layer."""
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
        return Policy(tuple(layers), self.training.robot, self.record())

    def record(self) -> dict[str, Any]:
        """How it was trained."""
        curve = [round(float(np.mean(self.rewards[k : k + _CURVE])), 4) for k in range(0, self.done, _CURVE)]
        return {
            "seed": self.training.seed,
            "filter": None if self.training.choice is None else asdict(self.training.choice),
            "velocity": self.training.velocity,
            "full_randomisation": self.training.full,
            "environments": self.walk.size,
            "iterations": self.done,
            "steps": self.steps,
            "seconds": round(self.seconds, 1),
            "library": _library(),
            "reward_every": _CURVE,
            "reward": curve,
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
            f"walk_{name}": value for name, value in self.walk.state().items()
        }
        for part in ("actor", "critic"):
            for name, value in getattr(algorithm, part).state_dict().items():
                found[f"{part}_{name}"] = value.numpy().copy()
        for k, entries in algorithm.optimizer.state_dict()["state"].items():
            found |= {f"optimizer_{k}_{name}": value.numpy().copy() for name, value in entries.items()}
        head = {
            "format": _FORMAT,
            "training": _json(self.training),
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
        mine, its = _json(self.training), head["training"]
        differing = [name for name in mine if name != "iterations" and mine[name] != its.get(name)]
        if differing:
            raise ValueError(
                f"a checkpoint of another training: {', '.join(f'{n} {its.get(n)}, not {mine[n]}' for n in differing)}"
            )
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
        self.walk.restore({name[5:]: value for name, value in checkpoint.items() if name.startswith("walk_")})
        self._last = (
            np.array(checkpoint["seen"], dtype=float),
            np.array(checkpoint["privileged"], dtype=float),
        )
        self.rewards = [float(value) for value in checkpoint["rewards"]]
        self.seconds = head["seconds"]


@dataclass(frozen=True)
class _Shape:
    """What the library asks of an environment when it makes the networks."""

    num_envs: int
    num_actions: int


def _json(training: Training) -> dict[str, Any]:
    """As it comes back out of a file: lists for tuples."""
    found: dict[str, Any] = json.loads(json.dumps(asdict(training)))
    return found


def _library() -> str:
    from importlib.metadata import version

    return f"rsl-rl-lib {version('rsl-rl-lib')}, torch {version('torch')}, mujoco {version('mujoco')}"


def train(
    trainer: Trainer,
    *,
    checkpoint: Path | None = None,
    every: int = 50,
    report: Callable[[str], None] | None = None,
) -> Policy:
    """Train a policy, or go on with one.

    Parameters
    ----------
    trainer : Trainer
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
        trainer.restore(found)
    while trainer.done < trainer.iterations:
        if report is not None:
            latest = f"{trainer.rewards[-1] / _step_time():.3f}" if trainer.rewards else "-"
            report(f"iteration {trainer.done + 1}/{trainer.iterations}, reward per second {latest}")
        trainer.iterate()
        if checkpoint is not None and (trainer.done % every == 0 or trainer.done == trainer.iterations):
            _write(checkpoint, trainer)
    return trainer.policy()


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
        f"steps of the policy (20 ms) per second, {found['environments']:.0f} robots, {_library()}\n"
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


def _write(path: Path, trainer: Trainer) -> None:
    with replacing(path) as file:
        np.savez(file, **trainer.checkpoint())  # pyright: ignore[reportArgumentType] - arrays by name
