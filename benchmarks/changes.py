"""A payload that drops, noticed: false alarms of the test behind `detect_changes`, and how soon it sees a drop.

    python benchmarks/changes.py [--hours 10] [--quick]

A body of 3 kg with 5 to 60 % of payload, held on a course by its velocity, in a mean wind and gusts as declared,
velocity with noise, at 250 Hz, flights of 10 s. False alarms (one an hour is accepted), and how often and when a drop
is noticed. Parts and noise as in `separation.py`.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from separation import BANDWIDTH, NOISE, NOMINAL, WEIGHT, side_by_side
from tqdm import tqdm

import phyfilter_ctl as pf
from phyfilter_ctl.estimation.separation.changes import Schedule, evidence
from phyfilter_ctl.estimation.separation.kalman import forward

Array = NDArray[np.float64]


def bodies(rng: np.random.Generator, payload: Array, drop: float) -> list[pf.Recording]:
    """Flights of 10 s at 250 Hz, held on a course by their velocity; the payload drops at ``drop`` s."""
    dt, count = 0.004, len(payload)
    t = dt * np.arange(2501)
    stay = np.exp(-BANDWIDTH * dt)
    mean = np.column_stack([rng.uniform(-5.0, 5.0, (count, 2)), rng.normal(0.0, 0.3, count)])
    gust, v, held = 0.5 * rng.standard_normal((count, 3)), np.zeros((count, 3)), np.zeros((count, 3))
    x, g = np.zeros((2, len(t), count, 3))
    course = 2.0 * np.stack([np.sin(t), 1.0 - np.cos(t), 0.3 * np.sin(2.0 * t)], axis=1)
    for k, now in enumerate(t):
        added = np.where(now < drop, payload, 0.0)[:, None]
        x[k] = NOMINAL * v + NOISE * rng.standard_normal((count, 3))
        held += 4.0 * dt * (course[k] - x[k] / NOMINAL)
        g[k] = NOMINAL * (4.0 * (course[k] - x[k] / NOMINAL) + held)
        following = stay * gust + 0.5 * np.sqrt(1.0 - stay**2) * rng.standard_normal((count, 3))
        force = g[k] + mean + 0.5 * (gust + following) - added * np.array([0.0, 0.0, WEIGHT])
        v = v + dt * force / (NOMINAL + added)
        gust = following
    return [pf.Recording.from_arrays(x=x[:, i], g=g[:, i], dt=dt) for i in range(count)]


def changes(hours: float, batch: int) -> None:
    """False alarms, and drops that are noticed."""
    rng, dt = np.random.default_rng(0), 0.004
    schedule = Schedule.of(dt, 1, false_alarms=1.0, within=0.3)

    def tested(payload: Array, drop: float) -> tuple[NDArray[np.intp], Array]:
        working, data = side_by_side(bodies(rng, payload, drop), 0.5)
        begins, statistic, _ = evidence(working, forward(working, data), np.array([0]), schedule)
        return begins, np.asarray(statistic > schedule.threshold, dtype=float)

    alarms, runs = 0, round(hours * 360.0 / batch)
    progress = tqdm(range(runs), "false alarms")
    for _ in progress:
        _, over = tested(NOMINAL * rng.uniform(0.05, 0.6, batch), np.inf)
        alarms += int(np.sum(np.any(over > 0.0, axis=(0, 1))))
        progress.set_postfix(alarms=alarms)
    print(
        f"flights of 10 s with a false alarm: {alarms} in {runs * batch / 360.0:.2f} h; accepted: one an hour"
    )
    for size in (0.15, 0.3, 0.6, 1.2):
        begins, over = tested(np.full(batch, size), 5.0)
        ends = (begins[None] + np.array(schedule.ages)[:, None])[:, :, None] * dt - 5.0
        delay = np.min(np.where((over > 0.0) & (ends > 0.0), ends, np.inf), axis=(0, 1))
        print(
            f"{size:g} kg dropped: noticed within 0.3 s in {100 * np.mean(delay <= 0.3):.0f} % of {batch} flights, "
            f"median delay {1e3 * np.median(delay):.0f} ms"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=10.0, help="of flights in which nothing drops")
    parser.add_argument("--quick", action="store_true", help="three minutes, eight drops of a kind")
    options = parser.parse_args()
    changes(0.05 if options.quick else options.hours, 8 if options.quick else 40)


if __name__ == "__main__":
    main()
