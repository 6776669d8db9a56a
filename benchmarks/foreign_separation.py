"""Coverage of `separate` on flights of a simulator that shares no code with the library's plants.

    python benchmarks/foreign_separation.py [--flights 100] [--first 0] [--quick]

A quadrotor as a point mass with a first-order lag of its thrust vector flies a circle with a payload, in a mean wind
with a vertical part and Dryden gusts, against quadratic drag of the relative wind: plain NumPy, Euler at 1 kHz, logged
at 100 Hz with white noise of the velocity. Prints how many 95 % intervals of the payload hold with the parts as
docs/separation.md declares them, and with less; the median half-width in kg; and how many flights have a note that the
answer depends on what was declared, or that the data prefer another declaration.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl.estimation import ColouredForce, Part, Payload, Regressor, SteadyForce

Array = NDArray[np.float64]
MASS, GRAVITY, STEP, EVERY, NOISE = 2.0, np.array([0.0, 0.0, 9.81]), 1e-3, 10, 0.01
DURATION = 12.0
LAG, DRAG = 0.05, 0.08  # s; N s^2/m^2 of |v_rel| v_rel


def fly(seed: int, duration: float = DURATION, *, gain: float = 1.0) -> tuple[pf.Recording, float]:
    """A flight, and its payload in kg; ``gain`` of the true thrust over that in g."""
    rng = np.random.default_rng(seed)
    payload = rng.uniform(0.1, 0.8)
    mean = np.array(
        [*rng.uniform(0.5, 8.0) * unit(rng.uniform(0.0, 2.0 * np.pi)), 0.5 * rng.standard_normal()]
    )
    spread = 0.15 * np.linalg.norm(mean) * np.array([1.0, 1.0, 0.5])
    eddy = max(float(np.linalg.norm(mean)), 1.0) / np.array(
        [20.0, 20.0, 5.0]
    )  # 1/s: length scales of 20 and 5 m
    radius, rate, phase = rng.uniform(1.0, 3.0), rng.uniform(0.6, 1.2), rng.uniform(0.0, 2.0 * np.pi)
    n = round(duration / STEP)
    p, v = np.array([radius, 0.0, 0.0]), np.zeros(3)
    gust, thrust, total = spread * rng.standard_normal(3), (MASS + payload) * GRAVITY, np.zeros(3)
    speeds, known = [], []
    for k in range(n):
        t = k * STEP
        ramp = min(1.0, 0.25 * t)
        angle = rate * t
        wanted = radius * np.array([np.cos(angle), np.sin(angle), 0.3 * ramp * np.sin(1.3 * angle + phase)])
        moving = (
            radius
            * rate
            * np.array([-np.sin(angle), np.cos(angle), 0.39 * ramp * np.cos(1.3 * angle + phase)])
        )
        total += STEP * 1.0 * (wanted - p)
        asked = MASS * (GRAVITY + 4.0 * (wanted - p) + 3.0 * (ramp * moving - v) + total)
        thrust = thrust + STEP / LAG * (asked - thrust)
        gust = gust * (1.0 - eddy * STEP) + spread * np.sqrt(2.0 * eddy * STEP) * rng.standard_normal(3)
        through = mean + gust - v
        if k % EVERY == 0:
            speeds.append(v.copy())
            known.append(thrust - MASS * GRAVITY)
        force = gain * thrust - (MASS + payload) * GRAVITY + DRAG * np.linalg.norm(through) * through
        v = v + STEP * force / (MASS + payload)
        p = p + STEP * v
    x = np.array(speeds) + NOISE * rng.standard_normal((len(speeds), 3))
    return pf.Recording.from_arrays(x=x, g=np.array(known), dt=EVERY * STEP, inertia=MASS), payload


def unit(angle: float) -> Array:
    """In the plane."""
    return np.array([np.cos(angle), np.sin(angle)])


def bare(log: pf.Recording) -> list[Part]:
    """Wind of one size for all axes, no drag."""
    return [Payload(1.0), SteadyForce(3.0, name="mean wind"), ColouredForce(1.0, 2.0, name="gusts")]


def declared(log: pf.Recording) -> list[Part]:
    """As docs/separation.md: drag, and a vertical wind that is small."""
    x = log.x
    return [
        Payload(1.0),
        Regressor(-x, sd=0.5, name="drag"),
        SteadyForce([3.0, 3.0, 0.3], drift=0.1, name="mean wind"),
        ColouredForce([0.5, 0.5, 0.2], 0.5, name="gusts"),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument(
        "--first", type=int, default=1000, help="first seed; parts were settled on seeds below 1000"
    )
    parser.add_argument("--quick", action="store_true", help="four flights")
    options = parser.parse_args()
    count = 4 if options.quick else options.flights
    flights = [fly(options.first + k) for k in range(count)]
    head = f"{'parts':<12}{'identified':>12}{'hold':>8}{'of these, %':>14}{'half-width, kg':>16}"
    print(f"{head}{'depends':>10}{'prefer':>8}")
    for parts in (bare, declared):
        inside, widths, depends, prefer = [], [], 0, 0
        for log, payload in flights:
            found = pf.separate(log, parts(log), noise=MASS * NOISE, g="average")
            depends += any("depends" in note for note in found.notes)
            prefer += any("prefer" in note for note in found.notes)
            low, high = found.parts["payload"].interval[0]
            if np.isfinite(low):
                inside.append(bool(low <= payload <= high))
                widths.append(0.5 * (high - low))
        share = f"{100.0 * np.mean(inside):.0f}" if inside else "-"
        width = f"{np.median(widths):.3f}" if widths else "-"
        row = f"{parts.__name__:<12}{len(inside):>12}{sum(inside):>8}{share:>14}{width:>16}"
        print(f"{row}{depends:>10}{prefer:>8}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
