"""Gymnasium's Pendulum-v1 with a payload at its tip that nobody told the controller: what the filter gives back.

    python benchmarks/gymnasium_payload.py [--quick] [--json FILE]

M theta'' = G sin(theta) + u + f, M = 1/3 + p, G = 5 + 10 p (rod of 1 kg and 1 m, payload p in kg, g = 10 m/s^2); the
controller and the filter know p = 0, |u| <= 2 N m, 20 samples a second. A rod of another mass and length obeys the very
same equation, so the environment itself is the standard one. One controller: energy is pumped until the pendulum comes
near the top, where computed torque takes it (4 rad/s, critically damped). Three ways: plain; with f_hat (first order,
10 rad/s) taken off the torque; told the payload. 10 seeds; near the top the environment's own options start it there.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.study import median_interval, reduction
from phyfilter_ctl.wrappers import FeedForward, LoopModel
from phyfilter_ctl.wrappers.environments import FeedForwardEnv

DT = 0.05
GRAVITY, LENGTH, MASS = 10.0, 1.0, 1.0
RATE = 4.0  # rad/s
POLE = 10.0  # rad/s
WAYS = ("plain", "filter", "told")
STARTS = {"near the top": {"x_init": 0.12, "y_init": 0.1}, "anywhere": {}}
PAYLOADS = (0.2, 0.3, 0.4, 0.5)


def constants(payload: float) -> tuple[float, float]:
    """Inertia in kg m^2 and gravity torque at right angles in N m."""
    inertia = MASS * LENGTH**2 / 3.0 + payload * LENGTH**2
    return inertia, (0.5 * MASS + payload) * GRAVITY * LENGTH


def environment(payload: float) -> gymnasium.Env:
    """Pendulum-v1 as the rod that moves like ours with its payload."""
    inertia, torque = constants(payload)
    env = gymnasium.make("Pendulum-v1")
    rod: object = env.unwrapped
    length = 1.5 * GRAVITY * inertia / torque
    rod.l, rod.m = length, 3.0 * inertia / length**2  # pyright: ignore[reportAttributeAccessIssue]
    return env


def controller(y: np.ndarray, payload: float) -> np.ndarray:
    """Torque for the observation (cos, sin, rate), for a pendulum of this payload."""
    inertia, gravity = constants(payload)
    angle, rate = float(np.arctan2(y[1], y[0])), float(y[2])
    if abs(angle + rate / RATE) < 0.25 and abs(angle) < 0.5:
        torque = -gravity * np.sin(angle) - inertia * (RATE**2 * angle + 2.0 * RATE * rate)
    else:
        missing = gravity - (0.5 * inertia * rate**2 + gravity * np.cos(angle))
        torque = 2.0 * np.sign(rate or 1.0) * np.clip(2.0 * missing, -1.0, 1.0)
    return np.array([np.clip(torque, -2.0, 2.0)], dtype=np.float32)


def with_filter(env: gymnasium.Env) -> FeedForwardEnv:
    """The environment with the wrapper, whose model is the pendulum without a payload."""
    inertia, gravity = constants(0.0)
    model: LoopModel[np.ndarray] = LoopModel(
        x=lambda y: y[2:],
        g=lambda y, u: gravity * y[1] + u,
        compensate=lambda y, f_hat: -f_hat,
        inertia=lambda y: inertia,
        low=-2.0,
        high=2.0,
    )
    live = PhyFilter([POLE]).sampled(DT).live(1)
    return FeedForwardEnv(env, FeedForward(live, model), dt=DT)


def episode(seed: int, payload: float, way: str, start: dict[str, float]) -> float:
    """Return of one episode of 200 steps."""
    env = environment(payload)
    env = with_filter(env) if way == "filter" else env
    y, _ = env.reset(seed=seed, options=start or None)
    total, over = 0.0, False
    while not over:
        y, reward, _, over, _ = env.step(controller(y, payload if way == "told" else 0.0))
        total += float(reward)
    return total


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="two seeds, one payload")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seeds = range(2 if options.quick else 10)
    print(
        f"{'start':>14} {'payload':>8} " + "".join(f"{way:>9}" for way in WAYS) + "   cost below plain in %"
    )
    rows = []
    for name, start in STARTS.items():
        for payload in PAYLOADS[-1:] if options.quick else PAYLOADS:
            returns = {way: [episode(seed, payload, way, start) for seed in seeds] for way in WAYS}
            costs = {way: -np.array(values) for way, values in returns.items()}
            gains = {way: reduction(costs[way], costs["plain"]) for way in WAYS[1:]}
            medians = "".join(f"{median_interval(returns[way]).value:9.3f}" for way in WAYS)
            text = ", ".join(f"{way} {gain.text(1.0, 1)}" for way, gain in gains.items())
            print(f"{name:>14} {payload:5.1f} kg {medians}   {text}")
            rows.append({"start": name, "payload": payload, "returns": returns})
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
