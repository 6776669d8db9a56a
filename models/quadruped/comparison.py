"""Every method through every test: the content of the paper's Fig. 2."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.plants.legged import Contact
from phyfilter_ctl.study import Report, silent

from .batch import Batch
from .evaluation import Case, Group, Outcome, Trace, phases, walk
from .gait import trot
from .loop import JointLoop, paper_filter
from .methods import METHODS, Method, told
from .params import Params, params
from .terrain import KINDS, RANDOM, Kind, Terrain

__all__ = [
    "TERRAINS",
    "Comparison",
    "Plan",
    "Scores",
    "Throughput",
    "compare",
    "score",
    "steps",
    "throughput",
]

FloatArray = NDArray[np.float64]

TERRAINS: tuple[Kind, ...] = KINDS[1:5]


@dataclass(frozen=True)
class Plan:
    """What is run.

    Parameters
    ----------
    methods : tuple of str
        Keys of ``METHODS``.
    seeds : tuple of int
        Of the policies.
    phases : int
        Of the gait at the start.
    payloads, speeds, difficulties : tuple of float
        Parts of the robot's weight, m/s, and of the terrains.
    duration : float
        Of a walk, s.
    terrains : tuple of str
    grounds : int
        So many of each kind that is random; every robot then walks on each once, from another phase.
    contact : {"omitted", "known", "estimated"}, optional
        What all filters are told of the forces on the feet; None: what each was chosen with.

    Raises
    ------
    ValueError
        For unknown methods, or nothing to run.
    """

    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    phases: int
    payloads: tuple[float, ...]
    speeds: tuple[float, ...]
    difficulties: tuple[float, ...]
    duration: float
    terrains: tuple[Kind, ...] = TERRAINS
    grounds: int = 1
    contact: Contact | None = None

    def __post_init__(self) -> None:
        unknown = [name for name in self.methods if name not in METHODS]
        if unknown or not self.methods:
            raise ValueError(
                f"methods: expected some of {', '.join(METHODS)}, got {', '.join(unknown) or 'none'}"
            )
        if self.grounds < 1:
            raise ValueError(f"grounds: expected at least 1, got {self.grounds}")
        if self.phases < 1 or not self.seeds or not self.payloads or not self.speeds:
            raise ValueError("expected at least one phase, seed, payload and speed")
        _ = self.cases  # checks payloads and speeds
        for kind in self.terrains:
            for difficulty in self.difficulties:
                Terrain(kind, difficulty)

    @property
    def cases(self) -> tuple[Case, ...]:
        """On flat ground: payloads, speeds, weak motors without and with the heaviest payload, a push."""
        test, weight = params().test, params().robot.mass
        heaviest = max(self.payloads) * weight
        return (
            *(Case(part * weight) for part in self.payloads),
            *(Case(speed=speed) for speed in self.speeds),
            Case(strength=test.strength),
            Case(heaviest, strength=test.strength),
            Case(push=params().push.force),
        )


@dataclass(frozen=True)
class Scores:
    """Of one method.

    Attributes
    ----------
    payload, speed, strength : (cases, policies, phases) array
        Velocity errors, m/s; strength: without and with the heaviest payload.
    payload_fallen, speed_fallen : (cases,) array
        Part of the robots.
    push : (policies, phases) array
        1 where the robot kept standing.
    terrain : dict
        Kind to (difficulties, policies, walks) of 1 where it passed: walks from several phases on one ground, or one
        walk on each of several grounds.
    estimate : (payloads,) array
        Mean |f_hat|, N m.
    trace : Trace
        Of the first policy, all cases on flat ground.
    """

    payload: FloatArray
    speed: FloatArray
    strength: FloatArray
    payload_fallen: FloatArray
    speed_fallen: FloatArray
    push: FloatArray
    terrain: dict[Kind, FloatArray]
    estimate: FloatArray
    trace: Trace


@dataclass(frozen=True)
class Throughput:
    """Steps of 5 ms per second of computing, all robots.

    Attributes
    ----------
    bare : float
        MuJoCo alone, constant torques.
    loop, filtered : float
        With the joint loop in Python, and with the filter too.
    robots : int
    """

    bare: float
    loop: float
    filtered: float
    robots: int


@dataclass(frozen=True)
class Comparison:
    """All that was run.

    Attributes
    ----------
    plan : Plan
    methods : dict
    scores : dict
        By method.
    curves : dict
        Rewards per iteration of training, family to (policies, points).
    throughput : Throughput
    """

    plan: Plan
    methods: dict[str, Method]
    scores: dict[str, Scores]
    curves: dict[str, list[list[float]]]
    throughput: Throughput


def steps(plan: Plan) -> int:
    """How often :func:`compare` reports.

    Parameters
    ----------
    plan : Plan
    """
    return 2 + len(plan.terrains) * len(plan.difficulties)


def compare(
    plan: Plan, *, own: Mapping[str, Method] | None = None, report: Report = silent, threads: int = 2
) -> Comparison:
    """Run everything.

    Parameters
    ----------
    plan : Plan
    own : mapping, optional
        Methods besides the plan's.
    report : callable
        Told of every step.
    threads : int
        Of the simulator.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    report("steps per second")
    speed = throughput(threads=threads)
    methods = {name: METHODS[name] for name in plan.methods} | dict(own or {})
    if plan.contact is not None:
        methods = {name: told(method, plan.contact) for name, method in methods.items()}
    scores = score(methods, plan, report=report, threads=threads)
    curves: dict[str, list[list[float]]] = {}
    for method in methods.values():
        curves.setdefault(
            method.family, [list(policy.record["reward"]) for policy in method.policies(plan.seeds)]
        )
    return Comparison(plan, methods, scores, curves, speed)


def score(
    methods: Mapping[str, Method],
    plan: Plan,
    *,
    report: Report = silent,
    starts: FloatArray | None = None,
    terrain_seed: int = 0,
    threads: int = 2,
) -> dict[str, Scores]:
    """Of several methods, side by side.

    Parameters
    ----------
    methods : mapping of str to Method
    plan : Plan
        Its own methods are not looked at.
    report : callable
    starts : array, optional
        Phases at the start; None: those of the test.
    terrain_seed : int
        Of the random heights.
    threads : int
    """
    begin = phases(count=plan.phases) if starts is None else starts
    groups = [Group(method.policies(plan.seeds), method.choice) for method in methods.values()]

    def on(cases: Sequence[Case], terrain: Terrain | None, far: float) -> list[Outcome]:
        at = begin if terrain is None or terrain.count == 1 else phases(count=terrain.count)
        return walk(
            groups, cases, starts=at, terrain=terrain, duration=plan.duration, far=far, threads=threads
        )

    report("flat")
    flat = on(plan.cases, None, np.inf)
    passed: list[dict[Kind, list[FloatArray]]] = [{kind: [] for kind in plan.terrains} for _ in groups]
    for kind in plan.terrains:
        for difficulty in plan.difficulties:
            report(f"{kind} {difficulty:g}")
            ground = Terrain(kind, difficulty, terrain_seed, plan.grounds if kind in RANDOM else 1)
            rows = on([Case()], ground, params().test.distance)
            for entry, row in zip(passed, rows, strict=True):
                far = row.distance[0] >= params().test.distance
                entry[kind].append((far & ~row.fallen[0]).astype(float))
    return {
        name: _scores(plan, outcome, {kind: np.array(rows) for kind, rows in terrain.items()})
        for name, outcome, terrain in zip(methods, flat, passed, strict=True)
    }


def _scores(plan: Plan, flat: Outcome, terrain: dict[Kind, FloatArray]) -> Scores:
    a, b = len(plan.payloads), len(plan.payloads) + len(plan.speeds)
    return Scores(
        flat.error[:a],
        flat.error[a:b],
        flat.error[b : b + 2],
        1.0 - flat.survived[:a],
        1.0 - flat.survived[a:b],
        1.0 - flat.fallen[b + 2].astype(float),
        terrain,
        flat.estimate[:a].mean(axis=(1, 2)),
        flat.trace,
    )


def throughput(
    *, robots: int = 128, seconds: float = 0.7, threads: int = 2, parameters: Params | None = None
) -> Throughput:
    """Steps per second of the trotting robot.

    Parameters
    ----------
    robots : int
    seconds : float
        Of each of three measurements.
    threads : int
    parameters : Params, optional
        The robot; None: that of ``params.toml``.
    """
    decimation = (params() if parameters is None else parameters).control.decimation
    found = []
    for kind in ("bare", "loop", "filtered"):
        batch = Batch(robots, threads=threads, parameters=parameters)
        loop = JointLoop(batch, paper_filter() if kind == "filtered" else None)
        target = trot(np.linspace(0.0, 6.0, robots), np.zeros((robots, 3)), parameters=parameters)
        loop.advance(target)
        count, begin = 0, time.perf_counter()
        while time.perf_counter() - begin < seconds:
            if kind == "bare":
                batch.step(loop.torque, count=decimation)
            else:
                loop.advance(target)
            count += decimation
        found.append(count * robots / (time.perf_counter() - begin))
    bare, looped, filtered = found
    return Throughput(bare, looped, filtered, robots)
