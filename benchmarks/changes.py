"""A payload that drops, a motor that weakens, noticed: false alarms of `Separation.changes`, and how soon.

    python benchmarks/changes.py [--hours 10] [--flights 100] [--quick]

A body of 3 kg with 5 to 60 % of payload, held on a course by its velocity, in a mean wind and gusts as declared,
velocity with noise, at 250 Hz, flights of 10 s. False alarms (one an hour is accepted), and how often and when a drop
is noticed. Parts and noise as in `separation.py`.

Then the drone of models/drone itself, on its circle with 5 to 60 % of payload in a mean wind of 0 to 8 m/s with 15 %
turbulence that is not the one declared, its observer flying, 500 Hz: `separation_block(watch="payload")` in C. After 6
of 12 s the payload drops; or the first of four motors loses a quarter or half of its thrust, which looks like a payload
that appears. Noticed within 0.3 s, median delay, error of the mass 0.5 s and 4 s later with and without the restart
(the lost thrust read as mass), and alarms before that.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray
from separation import BANDWIDTH, NOISE, NOMINAL, WEIGHT, side_by_side
from separation import drone as part
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


def in_flight(count: int, *, quick: bool) -> None:
    """The drone."""
    payload, dt = part("payload"), part("params").params().sampling.dt
    method = (
        part("methods").Method("observer", 2.0, 6.0) if quick else part("tuning").tuned()["observer"].method
    )
    duration, begun = (4.0, 1000) if quick else (12.0, 3000)
    at = np.full(count, begun * dt)
    events = {
        "payload dropped": ({"drop_time": at}, 0.0),
        "a motor at 75 %": ({"weak_time": at, "weak": np.full(count, 0.75)}, 0.0625),
        "a motor at 50 %": ({"weak_time": at, "weak": np.full(count, 0.5)}, 0.125),
    }
    waits = round(0.5 / dt), round(1.5 / dt if quick else 4.0 / dt)
    print(
        f"\nthe drone, {count} flights an event; error of the mass in kg, median, without restart in brackets"
    )
    print(f"{'':24} {'in 0.3 s':>8} {'delay, ms':>10} {'0.5 s later':>14} {f'{waits[1] * dt:g} s later':>14}")
    counts, follows = monitor(restart=True), monitor(restart=False)
    early = bold = 0
    for k, (name, (event, lost)) in enumerate(list(events.items())[: 1 if quick else None]):
        drawn = payload.windy_payloads(range(20_000 + k * count, 20_000 + (k + 1) * count))
        flown = part("experiment").fly(
            method,
            drawn,
            keep=("v_m", "g"),
            duration=duration,
            others={f"vehicle.quadrotor.{key}": value for key, value in event.items()},
            backend="vm" if quick else "c",
        )
        alarm, counted = seen(counts, flown, quick=quick)
        _, followed = seen(follows, flown, quick=quick)
        early += int(alarm[:, :begun].sum())
        after = alarm[:, begun:] > 0.5
        delay = np.where(after.any(axis=1), dt * after.argmax(axis=1), np.inf)
        # The share of thrust that is lost and the mass that would need it: 1 - lost = (m + dm)/(m + dm + apparent).
        truth = (NOMINAL + drawn.added_mass) / (1.0 - lost) - NOMINAL if lost else 0.0
        errors = [
            f"{np.median(np.abs(counted[:, begun + wait] - truth)):.2f}"
            f" ({np.median(np.abs(followed[:, begun + wait] - truth)):.2f})"
            for wait in waits
        ]
        caught = f"{100.0 * np.mean(delay <= 0.3):.0f} %"
        print(
            f"{name:24} {caught:>8} {1e3 * np.median(delay):>10.0f} {errors[0]:>14} {errors[1]:>14}",
            flush=True,
        )
        if not lost:
            for low, high in ((0.05, 0.1), (0.1, 0.2), (0.2, 0.6)):
                own = delay[(drawn.added_mass >= low * NOMINAL) & (drawn.added_mass < high * NOMINAL)]
                if len(own):
                    share = f"{100.0 * np.mean(own <= 0.3):.0f} %"
                    group = f"  of {100 * low:g} to {100 * high:g} %"
                    print(f"{group:24} {share:>8} {1e3 * np.median(own):>10.0f}    {len(own)} flights")
        if quick or not lost:
            alarm, _ = seen(monitor(restart=True, gusts=0.5), flown, quick=quick)
            bold = int(np.sum(alarm[:, :begun].any(axis=1)))
    hours = (1 if quick else len(events)) * count * begun * dt / 3600.0
    print(f"alarms before anything happened: {early} in {hours:.2f} h; accepted: one an hour")
    print(
        f"with 0.5 N of gusts declared, which strong winds exceed: in {bold} of {count} flights of {begun * dt:g} s"
    )


def monitor(*, restart: bool, gusts: float | None = None) -> pf.FlatModel:
    """The block alone."""
    payload, dt = part("payload"), part("params").params().sampling.dt
    block = pf.separation_block(
        payload.parts() if gusts is None else payload.parts(gusts),
        3,
        dt=dt,
        noise=payload.NOISE,
        g="average",
        watch="payload",
        restart=restart,
        name="block",
    )
    return pf.flatten(block)


def seen(flat: pf.FlatModel, flown: Any, *, quick: bool) -> tuple[Array, Array]:
    """Alarms (B, N) and payload (B, N) over flights."""
    x, g = NOMINAL * flown.signals["v_m"], flown.signals["g"]
    runs = pf.simulate_batch(
        flat,
        flown.time,
        np.swapaxes(np.concatenate([x, g, np.zeros_like(x)], axis=2), 1, 2),
        interpolation="hold",
        backend="vm" if quick else "c",
    )
    labels = [entry.name for entry in flat.outputs]
    at = [labels.index(label) for label in ("alarm", "payload")]
    alarm, mass = (np.array([np.asarray(run.outputs)[i] for run in runs]) for i in at)
    return alarm, mass


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=10.0, help="of flights in which nothing drops")
    parser.add_argument("--flights", type=int, default=100, help="of the drone, for each event")
    parser.add_argument(
        "--quick", action="store_true", help="three minutes, eight drops of a kind, two flights"
    )
    options = parser.parse_args()
    changes(0.05 if options.quick else options.hours, 8 if options.quick else 40)
    in_flight(2 if options.quick else options.flights, quick=options.quick)


if __name__ == "__main__":
    main()
