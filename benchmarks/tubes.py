"""Tubes for the drone's tracking error, from residuals measured on other flights, and how many flights stay in them.

    python benchmarks/tubes.py           20 test flights of 30 s in wind with an unknown mass
    python benchmarks/tubes.py --quick   four of 14 s, nothing judged

The observer of the drone study flies its circle. Per axis its loop is that of ``tracking_error``: PD gains, 10 ms of
delay, a lag for the actuator (the motors' vertically; 0.12 s horizontally, where the attitude loop turns the thrust:
fitted to the six measuring flights), the filter told the force that acts. On the measuring flights (seeds 100 to 105)
are measured: the residual f, split into a slow part (moving average over 0.3 s) with a bound on its slope and a rough
rest with a bound on itself; d, what the actuator does beyond that lag; their autocovariances. Noise is taken at three
standard deviations. On the test flights: the radius from the largest bounds measured, the largest error, how many of
the flights have no larger bounds, how many stay within, and within the tubes of their own bounds; the pointwise 95 %
band from the autocovariances, and the share of all samples within it. That the filter is told the force that acts to
within the noise of the attitude only is in no bound: it adds 0.5 mm. Exits with status 1 if a flight leaves the tube of
its own bounds.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl import models

Array = NDArray[np.float64]
TURNING, SLOW, SIGMAS, LAGS = 0.12, 0.3, 3.0, 4000
MEASURING = range(100, 106)
KEPT = ("r", "r_ref", "v", "v_ref", "r_m", "v_m", "f_hat", "f_mass", "f_wind")


def room(name: str) -> ModuleType:
    return importlib.import_module(f"{models.__name__}.drone.{name}")


experiment, flights, tuning, parameters = map(room, ("experiment", "flights", "tuning", "params"))


@dataclass(frozen=True)
class Axis:
    """One axis of some flights, start-up left out: position error, residual f, d of every step, fed back command."""

    error: Array
    f: Array
    d: Array
    command: Array

    @property
    def bounds(self) -> Array:
        """|slope of the slow part|, |rough part|, |d|: the largest of each flight, (flights, 3)."""
        h = parameters.params().sampling.dt
        slow = uniform_filter1d(self.f, round(SLOW / h), axis=1)
        parts = (np.diff(slow, axis=1) / h, self.f - slow, self.d)
        return np.stack([np.abs(part).max(axis=1) for part in parts], axis=1)

    def autocovariance(self, signal: Array) -> Array:
        """Mean of all flights, about each flight's own mean: a constant force leaves no error."""
        apart = signal - signal.mean(axis=1, keepdims=True)
        size = 2 * apart.shape[1]
        power = (np.abs(np.fft.rfft(apart, size)) ** 2).mean(axis=0)
        return np.fft.irfft(power, size)[: min(LAGS, apart.shape[1])] / apart.shape[1]


def flown(method: Any, seeds: Sequence[int], duration: float | None) -> list[Axis]:
    """The three axes."""
    values = parameters.params()
    h, m, (kp, kd, _) = values.sampling.dt, values.vehicle.mass, method.gains
    done = experiment.fly(method, flights.conditions(seeds, "wind"), keep=KEPT, duration=duration, workers=1)
    assert not done.message, done.message
    s, late = done.signals, round(values.vehicle.delay / h)
    f = s["f_mass"] + s["f_wind"]
    command = -m * (kp * (s["r_m"] - s["r_ref"]) + kd * (s["v_m"] - s["v_ref"])) - s["f_hat"]
    sent = np.concatenate([np.repeat(command[:, :1], late, axis=1), command[:, :-late]], axis=1)
    speed = s["v"] - s["v_ref"]
    axes, counted = [], done.counted
    for i in range(3):
        lag = values.vehicle.motor_lag if i == 2 else TURNING
        fade = -np.expm1(-h / lag)
        acting = np.asarray(lfilter([0.0, fade], [1.0, fade - 1.0], sent[..., i], axis=1))
        mean = sent[:, :-1, i] + (acting[:, :-1] - sent[:, :-1, i]) * fade * lag / h
        d = m * np.diff(speed[..., i], axis=1) / h - 0.5 * (f[:, 1:, i] + f[:, :-1, i]) - mean
        error = (s["r"] - s["r_ref"])[..., i]
        axes.append(Axis(error[:, counted], f[:, counted, i], d[:, counted], command[:, counted, i]))
    return axes


def loop_of(method: Any, i: int) -> pf.Loop:
    """That of an axis."""
    vehicle, (kp, kd, _) = parameters.params().vehicle, method.gains
    lag = vehicle.motor_lag if i == 2 else TURNING
    return pf.Loop(kp, kd, actuator=lag, delay=vehicle.delay, g="applied")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="four short flights, nothing judged")
    options = parser.parse_args()
    method, sensors = tuning.tuned()["observer"].method, parameters.params().sensors
    seeds, duration = (range(4), 14.0) if options.quick else (range(20), None)
    measured = flown(method, MEASURING[: 2 if options.quick else None], duration)
    tested = flown(method, seeds, duration)
    values, left = parameters.params(), 0
    filter = pf.PhyFilter([method.bandwidth]).sampled(values.sampling.dt, inertia=values.vehicle.mass)
    most = {"noise": SIGMAS * sensors.velocity, "position_noise": SIGMAS * sensors.position}
    heads = ("radius", "largest error", "bounds hold", "within", "own tubes", "95 % band", "within")
    print(f"{'':<4}" + "".join(f"{head:>14}" for head in heads))
    for i, (name, before, now) in enumerate(zip("xyz", measured, tested, strict=True)):
        loop = loop_of(method, i)

        def radius(bounds: Array, loop: pf.Loop = loop) -> float:
            slope, rough, d = bounds.tolist()
            met = pf.Bounded([{1: slope}, {0: rough}], actuation={0: d}, **most)
            return pf.tracking_error(filter, loop, met).radius

        tube, own = radius(before.bounds.max(axis=0)), np.array([radius(row) for row in now.bounds])
        errors = np.abs(now.error).max(axis=1)
        kept = np.all(now.bounds <= before.bounds.max(axis=0), axis=1)
        left += int(np.sum(errors > own))
        met = pf.Gaussian(
            before.autocovariance(before.f),
            noise=sensors.velocity,
            actuation=before.autocovariance(before.d),
            position_noise=sensors.position,
        )
        band = pf.tracking_error(filter, loop, met).band(0.95)
        cells = (
            f"{tube:.3f} m",
            f"{errors.max():.3f} m",
            f"{kept.sum()} of {len(kept)}",
            f"{np.sum(errors <= tube)} of {len(kept)}",
            f"{np.sum(errors <= own)} of {len(kept)}",
            f"{band:.4f} m",
            f"{np.mean(np.abs(now.error) < band):.1%}",
        )
        print(f"{name:<4}" + "".join(f"{cell:>14}" for cell in cells))
    print(
        "a flight leaves the tube of its own bounds"
        if left
        else "every flight stays in the tube of its own bounds"
    )
    return 1 if left and not options.quick else 0


if __name__ == "__main__":
    sys.exit(main())
