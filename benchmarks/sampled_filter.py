"""Speed of the sampled filter, as ratios in one run: records against one bare ``scipy.signal.sosfilt`` pass, steps.

    python benchmarks/sampled_filter.py [--quick] [--json FILE]

Promises: ``run`` at n = 4 on 28,000 x 3 samples within 4x of one sosfilt pass of the same order, with irregular times
within 40x; ``step`` of 3 channels below 15 us.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
from scipy import signal

from phyfilter_ctl import PhyFilter, phyfilter_block

DT = 0.002
# Its default, inputs=0.0, makes a type checker refuse arrays.
FORCED_RESPONSE: Any = ct.forced_response
RUN_LIMIT = 4.0  # sosfilt passes
IRREGULAR_LIMIT = 40.0
STEP_LIMIT = 15e-6  # s


def median_time(work: Callable[[], object], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        before = time.perf_counter()
        work()
        times.append(time.perf_counter() - before)
    return float(np.median(times))


def record_times(order: int, N: int, repeats: int) -> dict[str, float]:
    """Seconds of a bare sosfilt pass and of records of N x 3 samples."""
    rng = np.random.default_rng(0)
    x = np.cumsum(0.01 * rng.standard_normal((N, 3)), axis=0)
    g, f_theta = rng.standard_normal((2, N, 3))
    inertia = np.eye(3) + 0.1 * rng.standard_normal((N, 3, 3))
    times = np.cumsum(rng.uniform(0.5 * DT, 1.5 * DT, N))
    sos = signal.butter(order, 0.01, output="sos")
    sampled = PhyFilter.from_poles([-20.0] * order).sampled(DT)
    single = PhyFilter.from_poles([-20.0] * order).sampled(DT, precision="float32")
    block = phyfilter_block(sampled, 3)
    inputs, instants = np.hstack([x, g, f_theta]).T, DT * np.arange(N)
    return {
        "sosfilt": median_time(lambda: signal.sosfilt(sos, x, axis=0), repeats),
        "run": median_time(lambda: sampled.run(x, g, f_theta), repeats),
        "run, float32": median_time(lambda: single.run(x, g, f_theta), repeats),
        "run, M(t)": median_time(lambda: sampled.run(x, g, f_theta, inertia), repeats),
        "run, irregular times": median_time(
            lambda: sampled.run(x, g, f_theta, times=times), max(3, repeats // 4)
        ),
        "python-control": median_time(lambda: FORCED_RESPONSE(block, instants, inputs), 1 + repeats // 30),
    }


def step_times(repeats: int) -> dict[str, float]:
    """Seconds of one step of 3 channels."""
    x, g, f_theta = np.zeros(3), np.ones(3), np.ones(3)
    answer = {}
    for order in (1, 2, 4):
        for precision in ("float64", "float32"):
            sampled = PhyFilter.from_poles([-20.0] * order).sampled(DT, precision=precision)
            state = sampled.start(x)

            def work(sampled=sampled, state=state) -> None:
                for _ in range(200):
                    state, _ = sampled.step(state, x, g, f_theta)

            answer[f"step, n = {order}, {precision}"] = median_time(work, repeats) / 200
    return answer


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="few repeats and no verdict, to see that it runs"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    repeats = 3 if options.quick else 60
    lengths = (2_800, 28_000) if options.quick else (2_800, 28_000, 280_000)
    records = {
        f"n = {order}, {N:,} x 3": record_times(order, N, repeats) for order in (2, 4, 6) for N in lengths
    }
    print(f"{'record':>22} {'':>22} {'time':>10} {'sosfilt = 1':>12} {'per sample':>11}")
    for name, row in records.items():
        N = int(name.split(", ", 1)[1].split(" x")[0].replace(",", ""))
        for kind, seconds in row.items():
            ratio = seconds / row["sosfilt"]
            print(f"{name:>22} {kind:>22} {1e3 * seconds:7.2f} ms {ratio:12.2f} {1e9 * seconds / N:8.1f} ns")
    steps = step_times(repeats)
    for name, seconds in steps.items():
        print(f"{name:>34}: {1e6 * seconds:5.1f} us")
    headline = records["n = 4, 28,000 x 3"]
    checks = {
        "run / sosfilt": (headline["run"] / headline["sosfilt"], RUN_LIMIT),
        "irregular / sosfilt": (headline["run, irregular times"] / headline["sosfilt"], IRREGULAR_LIMIT),
        "slowest float64 step": (max(v for k, v in steps.items() if "float64" in k), STEP_LIMIT),
    }
    for name, (value, limit) in checks.items():
        verdict = (
            "not judged in a short run" if options.quick else "holds" if value < limit else "DOES NOT HOLD"
        )
        print(f"{name}: {value:.3g}, limit {limit:g}: {verdict}")
    if options.json:
        options.json.write_text(json.dumps({"records": records, "steps": steps}, indent=1))
    return 0 if options.quick or all(value < limit for value, limit in checks.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
