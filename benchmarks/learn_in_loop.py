"""Filters learned for estimation alone and for the loop they are fed back in: who stands, and what standing costs.

    python benchmarks/learn_in_loop.py [--quick]

For every loop the filters that fit best, and those that keep a modulus margin besides (`learn(..., loop=...)`): poles,
RMSE of f_hat on the log, the margin by the exact functions, and whether the simulated loop comes to rest after a push.

* plain: a mass behind a lag of 50 ms and a delay of 10 ms, PD, 100 Hz; gusts and a slow swing; low-pass orders 1 and
  2 and the general form of orders 2 and 3. Simulated with ten steps of the plant a sample.
* drone: the vertical axis of `models/drone`, its motor lag, delay and rate. Simulated in the whole vehicle's diagram.
* quadruped: the standing robot of `models/quadruped` in MuJoCo (extra `mujoco`; not with --quick), learned from walks.

For plain and drone a second table: filters learned for estimation and for tracking (`cost="tracking"`) under the same
margin, the second also with a bound on the noise of f_hat, flown in the loop on gusts that none was learned from (five
seeds; ten steps of the plant a sample): RMSE of f_hat on the log, root-mean-square position error and standard
deviation of the command's changes from sample to sample. The quadruped's joints are no loop of that form.

Exits with 1 where a constrained filter does not stand or misses its margin, or all unconstrained ones of a loop stand,
or one learned for tracking tracks worse than that learned for estimation.
"""

from __future__ import annotations

import argparse
import importlib
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from phyfilter_ctl import Loop, LoopGoal, Recording, SampledPhyFilter, Search, learn, models
from phyfilter_ctl.analysis import frequency_response
from phyfilter_ctl.design.learning import LearnResult, MarginsLike
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants.legged.simulator import simulator
from phyfilter_ctl.simulation import simulate

FloatArray = NDArray[np.float64]
KP, KD, LAG, DELAY, DT = 10.0, 6.0, 0.05, 0.01, 0.01
FINER = 10
MARGIN = 0.5
# Of the margin that PD alone has; filters slower than 2 pi over a walk's 5 s, which would leave more, no walk shows.
QUADRUPED_SHARE = 0.15
PUSH, SECONDS = 0.1, 20.0
# A loop that stands has come back to less than this share of the push.
BACK = 0.05
# Of the flown comparison; none of them is the record's.
SEEDS = (11, 12, 13, 14, 15)
# Errors of one filter that both costs choose.
SAME = 1e-2


def part(name: str) -> ModuleType:
    """A module of a model."""
    return importlib.import_module(f"{models.__name__}.{name}")


class Timing(NamedTuple):
    """Step, outer gains, lag and delay."""

    dt: float
    kp: float
    kd: float
    lag: float
    delay: float


def signals(dt: float, samples: int, noise: float, seed: int) -> tuple[FloatArray, FloatArray]:
    """Gusts of 0.4 s and a slow swing; noise of the velocity."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-dt / 0.4)
    drive = rng.standard_normal(samples)
    f = np.asarray(lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], drive)) + np.sin(
        1.7 * dt * np.arange(samples)
    )
    return f, noise * rng.standard_normal(samples)


def gusts(dt: float, samples: int, noise: float, seed: int = 0) -> Recording:
    """A record of them."""
    f, nu = signals(dt, samples, noise, seed)
    x = np.cumsum(dt * f) + nu
    return Recording.from_arrays(x=x[:, None], dt=dt, label=f[:, None])


def flown(
    filter: SampledPhyFilter, loop: Timing, f: FloatArray, noise: FloatArray, start: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Speed and place (N, 2), and commands (N,), with a force and noise of the speed at the samples: lag, speed and
    place in ten exact steps a sample."""
    dt, kp, kd, lag, delay = loop
    h = dt / FINER
    line = [0.0] * round(delay / h)
    A = np.zeros((5, 5))
    A[0, [0, 3]], A[1, [0, 4]], A[2, 1] = [-1.0 / lag, 1.0 / lag], 1.0, 1.0
    step = expm(A * h)[:3]
    state, command = np.array([0.0, start, 0.0]), 0.0
    memory = filter.start(state[1:2] + noise[0])
    states, commands = np.zeros((len(f), 2)), np.zeros(len(f))
    for k in range(len(f)):
        for j in range(FINER if k else 0):
            line.append(command)
            force = f[k - 1] + (f[k] - f[k - 1]) * (j + 0.5) / FINER
            state = step @ np.array([*state, line.pop(0), force])
        measured = state[1:2] + noise[k]
        memory, f_hat = filter.step(memory, measured, np.array([command]))
        command = -kp * state[2] - kd * float(measured[0]) - float(f_hat[0])
        states[k], commands[k] = state[1:], command
        if not np.all(np.abs(state) < 1e3):
            states[k:], commands[k:] = np.inf, np.inf
            break
    return states, commands


def plain_stands(filter: SampledPhyFilter) -> bool:
    """A push of the velocity, then nothing but the loop."""
    nothing = np.zeros(round(SECONDS / filter.dt))
    states, _ = flown(filter, Timing(DT, KP, KD, LAG, DELAY), nothing, nothing, PUSH)
    return bool(np.all(np.abs(states[-1]) < BACK * PUSH))


def drone_loop() -> tuple[LoopGoal, float, Callable[[SampledPhyFilter], bool]]:
    """The vertical axis' constraint, the rate, and whether the simulated vehicle stands."""

    build, held_force = part("drone.diagram").build, part("drone.margins").held_force
    start_state, params = part("drone.experiment").start_state, part("drone.params").params
    Method = part("drone.methods").Method
    vehicle, dt = params().vehicle, params().sampling.dt
    w = 1.9  # rad/s, of the outer loop

    def made(filter: SampledPhyFilter) -> Any:
        coefficients = tuple(filter.filter.a.tolist()), tuple(filter.filter.b.tolist())
        return Method(
            "phyfilter",
            w,
            1.0,
            known="commanded",
            damping=params().tuning.damping,
            with_model=False,
            coefficients=coefficients,
        )

    kp, kd, _ = Method("observer", w, 1.0, damping=params().tuning.damping).gains

    def stands(filter: SampledPhyFilter) -> bool:
        chosen = made(filter)
        flat = flatten(build(chosen, prior=held_force()))
        start = {**start_state(), "vehicle.quadrotor.v": [0.0, 0.0, 1e-4]}
        settings = chosen.parameters() | {
            "controller.reference.speed": 1e-9,
            "controller.attitude.tilt_max": 1e-7,
        }
        flight = simulate(
            flat,
            dt * np.arange(round(10.0 / dt) + 1),
            None,
            start,
            params=settings,
            method="rk4",
            max_step=params().sampling.max_step,
            backend="vm",
        )
        height = np.asarray(flight.outputs["r[2]"])
        if not np.abs(height - height[0]).max() < 0.005:
            return False
        swing = np.abs(np.diff(height, 2))
        quarter = len(swing) // 4
        return bool(swing[3 * quarter :].max() <= swing[quarter : 2 * quarter].max())

    constraint = LoopGoal(
        Loop(kp, kd, actuator=vehicle.motor_lag, delay=vehicle.delay), modulus_margin=MARGIN
    )
    return constraint, dt, stands


@dataclass(frozen=True)
class Standing:
    """Margins of the standing quadruped at its motors."""

    is_stable: bool
    modulus_margin: float
    delay_margin: float = np.inf
    gain_margin: tuple[float, float] = (0.0, np.inf)


def quadruped_loop() -> tuple[LoopGoal, Sequence[Recording], Callable[[SampledPhyFilter], bool]]:
    """Constraint by the linearised robot, walks to learn from, and whether the robot in MuJoCo stands."""

    stance, p = part("quadruped.stance"), part("quadruped.params").params()
    plant = stance.linearized()
    joint_inertia, walk_logs = part("quadruped.robot").joint_inertia, part("quadruped.learned").walk_logs
    mujoco = simulator("the quadruped's stance")
    kp, kd = p.control.kp, p.control.kd

    def margins(filter: SampledPhyFilter) -> MarginsLike:
        (row,) = stance.study([stance.Case("", filter.filter, kp, kd)], plant=plant)
        return Standing(row.stands, row.modulus_margin)

    def stands(filter: SampledPhyFilter) -> bool:
        model, data = stance.settled()
        inertia, damping = joint_inertia(), p.robot.damping
        posture, load = data.qpos[7:].copy(), data.ctrl.copy()  # the prior knows what holds the weight
        rate, torque = data.qvel[6:].copy(), load.copy()
        memory, speeds = filter.start(inertia * rate), []
        data.qvel[2] -= 0.05  # the push, m/s
        for _ in range(round(10.0 / p.control.dt)):
            mujoco.mj_step(model, data)
            now = data.qvel[6:].copy()
            g = torque - load - 0.5 * damping * (now + rate)
            memory, f_hat = filter.step(memory, inertia * now, g)
            rate = now
            torque = load + kp * (posture - data.qpos[7:]) - kd * now - f_hat
            data.ctrl[:] = torque
            speeds.append(float(np.abs(data.qvel[6:]).max()))
        return bool(max(speeds[-200:]) < 0.1)

    alone = stance.study([stance.Case("", None, kp, kd)], plant=plant)[0].modulus_margin
    return LoopGoal(modulus_margin=QUADRUPED_SHARE * alone, margins=margins), walk_logs(), stands


def learned(logs: Recording | Sequence[Recording], n: int, form: str, loop: LoopGoal | None) -> LearnResult:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return learn(
            logs,
            n,
            loop=loop,
            shape="general" if form == "general" else "lowpass",
            search=Search(starts=2, cross_validate=False),
        )


def compare(
    name: str,
    logs: Recording | Sequence[Recording],
    kinds: Sequence[tuple[int, str]],
    loop: LoopGoal,
    stands: Callable[[SampledPhyFilter], bool],
) -> bool:
    """Print the rows of a loop; whether all is as it should be."""
    fell, good = 0, True
    for n, form in kinds:
        begin = time.process_time()
        free = learned(logs, n, form, None)
        between = time.process_time()
        kept = learned(logs, n, form, loop)
        spent = between - begin, time.process_time() - between
        for label, result, seconds in (("free", free, spent[0]), ("in the loop", kept, spent[1])):
            filter = result.sampled()
            spare = loop.spare(filter)["modulus margin"]
            holds = stands(filter)
            poles = ", ".join(f"{p:.3g}" if p.imag else f"{p.real:.3g}" for p in result.filter.poles)
            margin = "unstable" if spare == -1.0 else f"{spare + loop.modulus_margin:.3f}"
            price = f"{100.0 * (result.rmse / free.rmse - 1.0):+.1f} %"
            print(
                f"{name:<10}{form:<8}{n:>2}  {label:<12}{result.rmse:>9.4g}{price:>10}{margin:>10}"
                f"{'stands' if holds else 'falls':>8}{seconds:>8.1f}   {poles} rad/s"
            )
            fell += label == "free" and not holds
            good = good and (label == "free" or (holds and spare >= 0.0))
    print(f"{name:<10}{fell} of {len(kinds)} learned without the loop fall")
    return good and fell > 0


def tracked(
    name: str,
    log: Recording,
    kinds: Sequence[tuple[int, str]],
    limits: LoopGoal,
    loop: Timing,
    noise: float,
    seeds: Sequence[int],
) -> bool:
    """Print what filters learned for estimation and for tracking leave of the gusts; whether the second leave less."""
    good = True
    for n, form in kinds:
        first, quiet = np.nan, np.inf
        for label in ("estimation", "tracking", "and quiet")[: 3 if len(seeds) > 1 else 2]:
            limited = limits if label == "estimation" else replace(limits, cost="tracking")
            if label == "and quiet":  # no more noise of f_hat than the estimator has
                limited = replace(limited, noise_gain=quiet)
            result = learned(log, n, form, limited)
            filter = result.sampled()
            flights = [flown(filter, loop, *signals(loop.dt, len(log.x), noise, seed)) for seed in seeds]
            place = float(np.sqrt(np.mean([states[:, 1] ** 2 for states, _ in flights])))
            jitter = float(np.std([np.diff(commands) for _, commands in flights]))
            if label == "estimation":
                first, quiet = place, frequency_response(filter).noise_gain
            good = good and place <= first * (1.0 + SAME)
            price = f"{100.0 * (place / first - 1.0):+.1f} %"
            spare = limits.spare(filter)["modulus margin"] + limits.modulus_margin
            poles = ", ".join(f"{p:.3g}" if p.imag else f"{p.real:.3g}" for p in result.filter.poles)
            print(
                f"{name:<10}{form:<8}{n:>2}  {label:<12}{result.rmse:>9.4g}{place:>11.4g}{price:>10}{jitter:>9.3g}"
                f"{spare:>8.3f}   {poles} rad/s"
            )
    return good


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="short logs, no general form, no quadruped")
    quick = parser.parse_args().quick
    print(
        f"{'loop':<10}{'form':<8}{'n':>2}  {'learned':<12}{'RMSE':>9}{'price':>10}{'margin':>10}{'flown':>8}"
        f"{'CPU s':>8}   poles"
    )
    plain = LoopGoal(Loop(KP, KD, actuator=LAG, delay=DELAY), modulus_margin=MARGIN)
    kinds = [(1, "lowpass")] if quick else [(1, "lowpass"), (2, "lowpass"), (2, "general"), (3, "general")]
    good = compare("plain", gusts(DT, 1500 if quick else 3000, 3e-3), kinds, plain, plain_stands)
    loop, dt, stands = drone_loop()
    drones = [(1, "lowpass")] if quick else [(1, "lowpass"), (2, "general")]
    drone_log = gusts(dt, 1500 if quick else 6000, 3e-4)
    good &= compare("drone", drone_log, drones, loop, stands)
    if not quick:
        constraint, walks, standing = quadruped_loop()
        good &= compare("quadruped", walks, [(1, "lowpass")], constraint, standing)
    print(
        f"\n{'loop':<10}{'form':<8}{'n':>2}  {'learned for':<12}{'RMSE':>9}{'tracking':>11}{'':>10}{'jitter':>9}"
        f"{'margin':>8}   poles"
    )
    kinds = [(2, "general")] if quick else [(1, "lowpass"), (2, "general"), (3, "general")]
    log, seeds = gusts(DT, 800 if quick else 3000, 3e-3), SEEDS[: 1 if quick else None]
    good &= tracked("plain", log, kinds, plain, Timing(DT, KP, KD, LAG, DELAY), 3e-3, seeds)
    if not quick:
        motor = part("drone.params").params().vehicle
        drone = Timing(dt, loop.loop.kp, loop.loop.kd, motor.motor_lag, motor.delay)
        good &= tracked(
            "drone", drone_log, [(1, "lowpass"), (2, "general"), (3, "general")], loop, drone, 3e-4, seeds
        )
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
