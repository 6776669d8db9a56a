"""Where the time of a policy step of many legged robots goes, beside ``mujoco.rollout``.

    python benchmarks/legged_speed.py [--quick] [--robots 128] [--threads 2] [--robot lite3-primitives go1]

Each line adds something to the one before: MuJoCo's own rollout of given torques, the same torques on the pool that is
used here (MuJoCo's memory seen as arrays, nothing is copied), joint loop, filter of all robots in one pass,
observations, rewards and restarts, policy and learning (extra train). All begin from the same walk. CPU time of all
threads in us a policy step (20 ms) and robot; policy steps a second by the clock; medians of rounds that take turns.
Fails where the pool costs more than 1.3 times the rollout, or joint loop, filter and environment together more than
MuJoCo.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from phyfilter_ctl import models
from phyfilter_ctl.plants.legged.simulator import simulator

STEPS = 10  # of the policy, in a round
POOL_FACTOR, OURS_FACTOR = 1.3, 1.0
SEED = 7


def part(name: str) -> ModuleType:
    return importlib.import_module(f"{models.__name__}.quadruped.{name}")


def walkers(robots: int, threads: int, kind: str, *, filtered: bool) -> Any:
    choice = part("loop").paper_filter() if filtered else None
    return part("environment").Walk(
        robots, choice, seed=SEED, threads=threads, parameters=part("params").params(kind)
    )


def layers(robots: int, threads: int, kind: str, begun: dict[str, Any]) -> dict[str, Callable[[], object]]:
    """What is measured, by name: each call makes ``STEPS`` steps of the policy."""
    mujoco = simulator("this")
    roller = importlib.import_module("mujoco.rollout").Rollout(nthread=threads)
    begun["roller"] = roller  # closed at the end
    walk = walkers(robots, threads, kind, filtered=False)
    filtered = walkers(robots, threads, kind, filtered=True)
    trot, control = part("gait").trot, walk.parameters.control
    for each in (walk, filtered):
        for _ in range(50):
            each.step(np.zeros((robots, 12)))
    start, torque = walk.batch.state(), walk.loop.torque.copy()
    model, count = walk.batch.model, STEPS * control.decimation

    def target() -> Any:
        return trot(walk.phase, walk.command, parameters=walk.parameters)

    data, states = mujoco.MjData(model), []
    whole = mujoco.mjtState.mjSTATE_FULLPHYSICS
    for qpos, qvel in zip(start["qpos"], start["qvel"], strict=True):
        data.qpos[:], data.qvel[:] = qpos, qvel
        states.append(np.empty(mujoco.mj_stateSize(model, whole)))
        mujoco.mj_getState(model, data, states[-1], whole)
    controls = np.repeat(torque[:, None], count, axis=1)
    datas = [mujoco.MjData(model) for _ in range(threads)]

    def pool() -> None:
        walk.batch.restore(start)
        walk.batch.step(torque, count=count)

    def loop(one: Any) -> None:
        one.batch.restore(start)
        for _ in range(STEPS):
            one.loop.advance(target())

    def environment() -> None:
        for _ in range(STEPS):
            filtered.step(np.zeros((robots, 12)))

    return {
        "mujoco.rollout": lambda: roller.rollout(model, datas, np.array(states), controls),
        "pool of this project": pool,
        "+ joint loop": lambda: loop(walk),
        "+ filter, order 1": lambda: loop(filtered),
        "+ environment": environment,
    }


def with_learning(robots: int, threads: int, kind: str) -> tuple[int, Callable[[], object]] | None:
    """Steps of the policy in a call, and one iteration of training; None without the extra."""
    training = part("training")
    try:
        wanted = training.Training(SEED, choice=part("loop").paper_filter(), environments=robots, robot=kind)
        trainer = training.Trainer(wanted, threads=threads)
    except ImportError:
        return None
    return trainer.parameters.training.horizon, trainer.iterate


def measured(call: Callable[[], object]) -> tuple[float, float]:
    """Seconds of processors and of the clock."""
    cpu, clock = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - cpu, time.perf_counter() - clock


def study(robots: int, threads: int, kind: str, rounds: int) -> bool:
    begun: dict[str, Any] = {}
    calls: dict[str, tuple[int, Callable[[], object]]] = {
        name: (STEPS, call) for name, call in layers(robots, threads, kind, begun).items()
    }
    learning = with_learning(robots, threads, kind)
    if learning is not None:
        calls["+ policy and learning"] = learning
    for _, call in calls.values():
        call()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, (steps, call) in calls.items():
            cpu, clock = measured(call)
            found[name].append((1e6 * cpu / (steps * robots), steps * robots / clock))
    begun["roller"].close()
    cost, rate = (
        {name: float(np.median(np.array(rows)[:, k])) for name, rows in found.items()} for k in (0, 1)
    )
    print(f"{kind}, {robots} robots, {threads} threads")
    before = 0.0
    for name in calls:
        print(f"  {name:24}{cost[name]:9.1f} us{cost[name] - before:+9.1f}{rate[name]:12.0f} policy steps/s")
        before = cost[name]
    if learning is None:
        print("  policy and learning need the extra train: pip install 'phyfilter-ctl[train]'")
    pool = cost["pool of this project"]
    return pool <= POOL_FACTOR * cost["mujoco.rollout"] and cost["+ environment"] - pool <= OURS_FACTOR * pool


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="32 robots, one round, nothing judged")
    parser.add_argument("--robots", type=int, default=128)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--robot", nargs="+", default=["lite3-primitives", "go1"])
    options = parser.parse_args()
    try:
        simulator("this benchmark")
    except ImportError as error:
        print(error)
        return 0
    size, rounds = (32, 1) if options.quick else (options.robots, 9)
    within = [study(size, options.threads, kind, rounds) for kind in options.robot]
    return int(not all(within) and not options.quick)


if __name__ == "__main__":
    sys.exit(main())
