"""What a model is worth on every system: as `pf.model_value` foretells it without labels, and as labels say.

    python benchmarks/model_worth.py [--system NAME ...] [--quick]

Recordings of each system with the model that it has, or one fitted to other recordings of its own:

    acceleration  network of past velocities; generated test flights, faster than those it was trained on
    drone         SEER-I; circle at 2 and at 3 m/s, payload, in the study's wind; adapting slowly and as tuned
    arm           SEER-I of the arm's force and torque; hover while the arm turns at 1.5 and 5 rad/s, in wind
    quadruped     affine in the joints' torques, fitted to walks of another policy (extra mujoco)
    humanoid      a twin with 10 % too much mass; a force of 10 N that changes pulls at a hand (extra mujoco)

Error with the model over that without, of the system's own filter and of the best for each: by labels, and predicted
with 95 % intervals. Then how many times faster the filter must be to need no model (at so many times the noise), and
what by labels error is then over that with the model: 1 if predicted right; "none" where no bandwidth up to 30 times
as wide does, with the least by labels. Systems whose extra is missing are named.
"""

from __future__ import annotations

import argparse
import copy
import importlib
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import models
from phyfilter_ctl.design.learning.constrained import at_speed
from phyfilter_ctl.filter.sampling import Rule

Array = NDArray[np.float64]
SETTLED = 2.0  # s left out, of the filters' start
FLIGHTS = 8
TOO_HEAVY, PULLS, PULL = 1.1, 4, 10.0  # of the twin; trials, and N
SPEEDS = np.geomspace(1.0, 30.0, 16)
SLOWER = 60.0  # 1/s, of SEER-I's adaptation
HUMANOID_A0 = 20.0  # rad/s
VELOCITY_NOISE = 1e-3  # rad/s and m/s, of the humanoid


@dataclass(frozen=True)
class Case:
    """Recordings with f_theta and label, and the filter that the system uses."""

    logs: Sequence[pf.Recording]
    filter: pf.PhyFilter
    g: Rule = "average"
    f_theta: Rule = "average"
    noise: ArrayLike | None = None  # of M x, where it is known; else it is found


def part(system: str, name: str) -> ModuleType:
    return importlib.import_module(f"{models.__name__}.{system}.{name}")


def recordings(x: Array, g: Array, label: Array, theta: Array, dt: float) -> list[pf.Recording]:
    """Flights (B, N, 3)."""
    return [
        pf.Recording.from_arrays(x=x[i], g=g[i], f_theta=theta[i], label=label[i], dt=dt)
        for i in range(len(x))
    ]


def acceleration(*, quick: bool) -> dict[str, Case]:
    experiment = part("acceleration", "experiment")
    effort, share = (experiment.QUICK, 0.25) if quick else (experiment.Effort(), 1.0)
    train, test = (
        part("acceleration", "flights").generate(kind, 0, share=share) for kind in ("train", "test")
    )
    logs, dt = experiment.prepare(train, test)
    learned = experiment.fit_learned(logs, dt, seed=0, effort=effort)
    return {
        "test flights": Case(
            [log.with_signals(f_theta=learned.network.predict(log.x)) for log in test],
            learned.filters[1].filter,
        )
    }


def drone(*, quick: bool) -> dict[str, Case]:
    tuned = part("drone", "tuning").tuned()["phyfilter"].method
    model, known = part("drone", "training").train().model, part("drone", "params").params()
    found = {}
    cases = [(speed, rate) for rate in (SLOWER, tuned.seer_rate) for speed in (2.0, 3.0)]
    for speed, rate in cases[:1] if quick else cases:
        method = replace(tuned, seer_rate=rate)
        flown = part("drone", "experiment").fly(
            method,
            part("drone", "flights").conditions(range(5000, 5002 if quick else 5000 + FLIGHTS), "wind"),
            model,
            keep=("v_m", "g", "f_theta", "f_mass", "f_wind"),
            duration=14.0 if quick else 18.0,
            others={"controller.reference.speed": speed},
        )
        got = {name: values[:, flown.counted] for name, values in flown.signals.items()}
        force, momentum = got["f_mass"] + got["f_wind"], known.vehicle.mass * got["v_m"]
        logs = recordings(momentum, got["g"], force, got["f_theta"], known.sampling.dt)
        found[f"{speed:g} m/s, {rate:.0f} 1/s"] = Case(logs, part("drone", "methods").filter_of(method))
    return found


def arm(*, quick: bool) -> dict[str, Case]:
    training, known = part("aerial_manipulator", "training"), part("aerial_manipulator", "params").params()
    method = part("aerial_manipulator", "tuning").tuned()["phyfilter"].method
    experiment = part("aerial_manipulator", "experiment")
    seer, found, dt = training.train().seer, {}, known.sampling.dt
    for rate in (1.5, 5.0):
        flown = experiment.fly(
            method,
            range(5000, 5000 + FLIGHTS),
            seer,
            goals=training.circling((rate, rate), 20.0),
            keep=(*experiment.ESTIMATED, "f_theta", "tau_theta"),
            others={"vehicle.load.mass": 0.0},
        )
        got = {name: values[:, round(6.0 / dt) :] for name, values in flown.signals.items()}
        force, torque = experiment.unknown(got)
        linear = recordings(force.x, force.g, force.f, got["f_theta"], dt)
        angular = recordings(torque.x, torque.g, torque.f, got["tau_theta"], dt)
        found[f"force, {rate:g} rad/s"] = Case(linear, method.force_filter())
        found[f"torque, {rate:g} rad/s"] = Case(angular, method.torque_filter())
    return found


def quadruped(*, quick: bool) -> dict[str, Case]:
    """The filter is that of the joint loop, of order 1; torques and their model act from one sample to the next."""
    walks, known = part("quadruped", "learned").walk_logs(), part("quadruped", "params").params()
    seen = [np.hstack([log.g, np.ones((log.n, 1))]) for log in walks]
    half = len(walks) // 2
    labels = np.concatenate([log.label[1:] for log in walks[:half]])
    gains = np.linalg.lstsq(np.concatenate([z[:-1] for z in seen[:half]]), labels, rcond=None)[0]
    logs = [log.with_signals(f_theta=z @ gains) for log, z in zip(walks[half:], seen[half:], strict=True)]
    noise = part("quadruped", "robot").joint_inertia() * known.randomisation.noise_rate
    return {"walks": Case(logs, pf.PhyFilter([1.0]), g="hold", f_theta="hold", noise=noise)}


def humanoid(*, quick: bool) -> dict[str, Case]:
    """x = v of all degrees of freedom; g the motors' torques, f_theta what a twin does beyond them."""
    robot, trial = part("humanoid", "robot").load(friction="pyramidal"), part("humanoid", "trial")
    stance = part("humanoid", "regulator").schedule(robot, "normal", largest=10.0, spacing=10.0)
    heavier = copy.deepcopy(robot.model)
    heavier.body_mass *= TOO_HEAVY
    heavier.body_inertia *= TOO_HEAVY
    robot.mujoco.mj_setConst(heavier, robot.mujoco.MjData(heavier))
    logs = [stood(robot, replace(robot, model=heavier), stance.upright, seed) for seed in range(PULLS)]
    noise = VELOCITY_NOISE * np.linalg.norm(np.mean(np.asarray(logs[0].inertia), axis=0), axis=1)
    return {"standing": Case(logs, trial.phyfilter(HUMANOID_A0), g="hold", f_theta="hold", noise=noise)}


def stood(robot: Any, nominal: Any, point: Any, seed: int) -> pf.Recording:
    """Standing by the LQR for 10 s; of the step up to each sample: inertia, motors, twin and truth."""
    rng, h = np.random.default_rng(seed), float(robot.model.opt.timestep)
    data, twin = robot.data(), nominal.data()
    data.qpos[:] = point.q
    robot.mujoco.mj_forward(robot.model, data)
    pull, rows = 0.0, []
    v = data.qvel + VELOCITY_NOISE * rng.standard_normal(robot.nv)
    for _ in range(round(10.0 / h)):
        pull += h * -2.0 * pull + PULL * np.sqrt(4.0 * h) * rng.standard_normal()
        control = point.posture.control - point.K @ np.concatenate([robot.difference(point.q, data.qpos), v])
        data.ctrl[:] = twin.ctrl[:] = np.clip(control, -1.0, 1.0)
        twin.qpos[:], twin.qvel[:], twin.qacc_warmstart[:] = data.qpos, v, data.qacc_warmstart
        data.xfrc_applied[robot.hand, 1] = pull
        before, begun = data.qvel.copy(), v
        robot.mujoco.mj_step(robot.model, data)
        robot.mujoco.mj_step(nominal.model, twin)
        M, g = nominal.implicit_inertia(twin), twin.qfrc_actuator.copy()
        v = data.qvel + VELOCITY_NOISE * rng.standard_normal(robot.nv)
        rows.append((v, M, g, M @ (twin.qvel - begun) / h - g, M @ (data.qvel - before) / h - g))
    x, M, g, theta, f = (np.array(each) for each in zip(*rows, strict=True))
    # Motors and twin of the step that begins at a sample.
    g, theta = (np.vstack([each[1:], each[-1:]]) for each in (g, theta))
    return pf.Recording.from_arrays(x=x, inertia=M, g=g, f_theta=theta, label=f, dt=h)


SYSTEMS: dict[str, Callable[..., dict[str, Case]]] = {
    "acceleration": acceleration,
    "drone": drone,
    "arm": arm,
    "quadruped": quadruped,
    "humanoid": humanoid,
}


def rms(case: Case, filter: pf.PhyFilter, *, model: bool) -> float:
    """Of f - f_hat at the samples, by the labels."""
    squares = []
    for log in case.logs:
        assert log.label is not None
        theta = log.f_theta if model and log.f_theta is not None else np.zeros_like(log.x)
        sampled = filter.sampled(log.dt, g=case.g, f_theta=case.f_theta)
        found = np.asarray(sampled.run(log.x, log.g, theta, log.inertia)) - theta
        missed = log.label - theta
        if case.f_theta == "hold":  # labels are those of the steps before, models of those to come
            over = log.label[1:] - theta[:-1]
            missed, found = 0.5 * (over[1:] + over[:-1]), found[1:-1]
        squares.append(np.mean((missed - found)[round(SETTLED / log.dt) :] ** 2))
    return float(np.sqrt(np.mean(squares)))


def row(case: Case) -> list[str]:
    found = pf.model_value(
        case.logs, case.filter, orders=(1,), g=case.g, f_theta=case.f_theta, noise=case.noise
    )
    ours, without = (rms(case, case.filter, model=model) for model in (True, False))
    best = rms(case, found.best.filter, model=True) / rms(case, found.best_without.filter, model=False)
    if np.isfinite(found.speed):
        there = rms(case, at_speed(case.filter, found.speed), model=False)
        faster = [f"{found.speed:.2f}", f"{found.speed_noise:.2f}", f"{there / ours:.2f}"]
    else:
        rates = case.filter.a[0] * SPEEDS
        there = min(rms(case, pf.PhyFilter([a0]), model=False) for a0 in rates[rates * case.logs[0].dt < 2.0])
        faster = ["none", "", f">= {there / ours:.2f}"]
    return [
        f"{ours:.3g}",
        f"{without:.3g}",
        f"{ours / without:.3f}",
        said(found.ratio),
        f"{best:.3f}",
        said(found.best_ratio),
        *faster,
    ]


def said(interval: Any) -> str:
    return f"{interval.value:.3f} [{interval.low:.3f}, {interval.high:.3f}]"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--system", nargs="+", choices=list(SYSTEMS), default=list(SYSTEMS))
    parser.add_argument("--quick", action="store_true", help="the drone, two short flights")
    options = parser.parse_args()
    heads = [
        "rms with",
        "without",
        "ratio",
        "predicted",
        "best",
        "predicted",
        "faster",
        "noise",
        "error there",
    ]
    widths = [9, 9, 7, 23, 7, 23, 7, 7, 12]
    print(f"{'':28}" + "".join(f"{head:>{w}}" for head, w in zip(heads, widths, strict=True)))
    for name in ["drone"] if options.quick else options.system:
        try:
            cases = SYSTEMS[name](quick=options.quick)
        except ImportError as error:
            print(f"{name}: not evaluated, {error}")
            continue
        for label, case in cases.items():
            cells = "".join(f"{cell:>{w}}" for cell, w in zip(row(case), widths, strict=True))
            print(f"{name + ', ' + label:28}" + cells, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
