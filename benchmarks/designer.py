"""How long the designer waits for Python: op "design" on random designs of orders 1 to 8, one core, one BLAS thread.

    python benchmarks/designer.py [--quick] [--json FILE]

Every order has designs with real, complex and repeated poles, low-pass and other numerators, an actuator's lag and a
delay. Printed are the median and the 99th percentile over them, JSON text included, the median of the process's own
time, which other work on the machine does not lengthen, and what the parts take. Exits with status 1 if that median
over all orders is above 25 ms, unless --quick: then the figures are shown, not required.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from phyfilter_ctl.app import answers
from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import Design, read_design
from phyfilter_ctl.app.handling import Session, handle
from phyfilter_ctl.app.loops import assumed_loop
from phyfilter_ctl.app.steps import settling_time

LIMIT = 25.0  # ms
ORDERS = range(1, 9)


def designs(order: int, count: int) -> list[dict[str, object]]:
    """As a user might leave them: poles of 3 to 100 rad/s, damping 0.2 to 1, every third of them repeated."""
    rng = np.random.default_rng(order)
    found: list[dict[str, object]] = []
    for i in range(count):
        poles: list[list[float]] = []
        size = float(np.exp(rng.uniform(np.log(3.0), np.log(100.0))))
        while len(poles) < order:
            if i % 3:
                size = float(np.exp(rng.uniform(np.log(3.0), np.log(100.0))))
            damping = float(rng.uniform(0.2, 1.0))
            if order - len(poles) == 1 or rng.random() < 0.4:
                poles.append([-size, 0.0])
            else:
                im = size * float(np.sqrt(1.0 - damping**2))
                poles += [[-size * damping, im], [-size * damping, -im]]
        numerator: dict[str, object] = {"kind": "lowpass"}
        if i % 2:
            numerator = {"kind": "type", "type": int(rng.integers(1, order + 1))}
        sampling = {"dt": [0.001, 0.002, 0.01][i % 3], "method": "exact"}
        assume = {"slope": 1.0, "noise": 1e-3, "ratio": 1.0, "lag": 0.02, "delay": 0.005, "unit": "N"}
        found.append({"poles": poles, "numerator": numerator, "sampling": sampling, "assume": assume})
    return found


def seconds(work: Callable[[], object]) -> tuple[float, float]:
    """Time by the wall and of this process alone: other work on the machine is in the first only."""
    before, busy = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - before, time.process_time() - busy


def measure(count: int) -> dict[str, object]:
    session = Session()
    rows: dict[str, dict[str, float]] = {}
    every: list[tuple[float, float]] = []

    def ask(design: dict[str, object]) -> None:
        reply = handle(session, {"id": 1, "op": "design", "design": design})
        if not reply["ok"]:
            raise AssertionError(reply["error"])
        json.dumps(reply, allow_nan=False)

    for order in ORDERS:
        drawn = designs(order, count)
        ask(drawn[0])
        times = [seconds(lambda design=design: ask(design)) for design in drawn]
        every += times
        rows[str(order)] = shown(str(order), times)
    return {"ms": rows | {"all": shown("all", every)}, "parts_ms": parts(count)}


def shown(name: str, times: list[tuple[float, float]]) -> dict[str, float]:
    wall, busy = 1e3 * np.array(times).T
    row = {
        "median": float(np.median(wall)),
        "p99": float(np.percentile(wall, 99)),
        "cpu": float(np.median(busy)),
    }
    print(f"{name:>5}{row['median']:>12.1f}{row['p99']:>10.1f}{row['cpu']:>16.1f}", flush=True)
    return row


def parts(count: int) -> dict[str, float]:
    """Medians of what an answer is made of, order 4."""
    times: dict[str, list[float]] = {}
    for message in designs(4, count):
        for name, work in work_of(read_design(Fields({"design": message}))).items():
            times.setdefault(name, []).append(seconds(work)[0])
    medians = {name: 1e3 * float(np.median(values)) for name, values in times.items()}
    print("order 4: " + ", ".join(f"{name} {value:.1f} ms" for name, value in medians.items()))
    return medians


def work_of(design: Design) -> dict[str, Callable[[], object]]:
    filter, sampled = design.filter, design.sampled
    settling = settling_time(filter)
    return {
        "curves": lambda: answers._frequency(design, filter, sampled),
        "step": lambda: answers._step(filter, settling),
        "bounds": lambda: answers._bounds(design, filter, sampled),
        "margins": lambda: answers._margins(design, assumed_loop(design, sampled)),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few designs; the limit is shown, not required")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    options = parser.parse_args(arguments)
    print(f"{'order':>5}{'median ms':>12}{'p99 ms':>10}{'median CPU ms':>16}     required: CPU {LIMIT:g} ms")
    with threadpool_limits(1):
        figures = measure(4 if options.quick else 60)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    overall = figures["ms"]
    assert isinstance(overall, dict)
    return int(not options.quick and overall["all"]["cpu"] > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
