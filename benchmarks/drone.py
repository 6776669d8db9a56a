"""The drone's whole closed loop: how much faster than real time, and how long a study of 1,000 flights takes.

    python benchmarks/drone.py [--quick] [--json FILE]

Plant of six degrees of freedom, wind, sensors with noise, tracking and attitude control, delay, SEER-I with its
adaptive law, and PhyFilter at 500 Hz; Runge-Kutta 4 at 2 ms. Promise: 60 s compiled on one core at least 100 times
faster than real time.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from phyfilter_ctl import models
from phyfilter_ctl.codegen import CompilerError, find_compiler
from phyfilter_ctl.diagram import flatten

SECONDS, FLIGHT, RUNS = 60.0, 30.0, 1000
LIMIT = 100.0
# Flights at a time: noise and signals of all 1,000 would take 12 GB.
CHUNK = 40
WORKERS = 2


def room(name: str) -> ModuleType:
    return importlib.import_module(f"{models.__name__}.drone.{name}")


diagram, experiment, flights, training, tuning = map(
    room, ("diagram", "experiment", "flights", "training", "tuning")
)


def least_time(work: Callable[[], object], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        before = time.perf_counter()
        work()
        times.append(time.perf_counter() - before)
    return min(times)


def flown(seeds: Sequence[int], seconds: float, backend: str, workers: int) -> Any:
    """Flights of the tuned PhyFilter on SEER-I with unknown mass in wind."""
    method, model = tuning.tuned()["phyfilter"].method, training.train().model
    wind = flights.conditions(seeds, "wind")
    return experiment.fly(method, wind, model, duration=seconds, backend=backend, workers=workers)


def many(runs: int, seconds: float) -> tuple[float, float]:
    """Seconds that so many flights take, and the median of their errors, m."""
    errors = []
    before = time.perf_counter()
    for first in range(0, runs, CHUNK):
        seeds = range(first, min(first + CHUNK, runs))
        errors.append(flown(seeds, seconds, "c", WORKERS).score().total)
    return time.perf_counter() - before, float(np.median(np.concatenate(errors)))


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="short flights and few, nothing judged")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    try:
        find_compiler()
    except CompilerError as failure:
        print(f"not evaluated: {failure}")
        return 0
    seconds, flight, runs = (8.0, 8.0, 2 * CHUNK) if options.quick else (SECONDS, FLIGHT, RUNS)
    method = tuning.tuned()["phyfilter"].method
    flat = flatten(diagram.build(method, training.train().model))
    print(f"{len(flat.states)} states, {len(flat.order)} blocks, {len(flat.tasks)} of them sampled")
    found = {}
    for backend, name in (("c", "compiled C"), ("vm", "virtual machine")):
        # Drawing the noise of the flight is part of it.
        taken = least_time(lambda b=backend: flown([0], seconds, b, 1), 2 if options.quick else 5)
        found[backend] = seconds / taken
        print(f"{name}, {seconds:g} s on one core: {taken:.3f} s, {found[backend]:.0f}x real time")
    c, vm = (flown([0], min(seconds, 20.0), backend, 1).signals["r"] for backend in ("c", "vm"))
    difference = float(np.abs(c - vm).max())
    print(f"greatest difference of position between them: {difference:.1e} m")
    taken, error = many(runs, flight)
    print(
        f"{runs} flights of {flight:g} s with wind and noise on {WORKERS} of {os.cpu_count()} cores: {taken:.1f} s, "
        f"{runs * flight / taken:.0f}x real time, median error {100 * error:.2f} cm"
    )
    holds = found["c"] >= LIMIT
    verdict = "not judged in a short run" if options.quick else "holds" if holds else "DOES NOT HOLD"
    print(f"compiled on one core over real time: {found['c']:.0f}, at least {LIMIT:g}: {verdict}")
    if options.json:
        answer = {
            "realtime_factor": found,
            "agreement": difference,
            "study": {
                "runs": runs,
                "seconds_each": flight,
                "workers": WORKERS,
                "seconds": taken,
                "median_error": error,
            },
        }
        options.json.write_text(json.dumps(answer, indent=1) + "\n")
    return 0 if options.quick or holds else 1


if __name__ == "__main__":
    sys.exit(main())
