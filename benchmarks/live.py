"""Cost of a live filter's step beside ``step``, in a loop without pause and after a pause, as a 500 Hz loop has it.

    python benchmarks/live.py [--quick] [--json FILE]

Promise: a live step of 3 channels, with stamps that jitter, below 25 us in a loop without pause.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.filter import LiveRules

DT = 0.002
LIMIT = 25e-6  # s
N = 400


def seconds(step: Callable[[int], object], pause: float = 0.0) -> float:
    """Median time of a step, of N."""
    times = []
    for k in range(N):
        if pause:
            time.sleep(pause)
        before = time.perf_counter()
        step(k)
        times.append(time.perf_counter() - before)
    return float(np.median(times))


def measured(order: int, n_x: int, pause: float) -> dict[str, float]:
    """Seconds of one step of each kind."""
    rng = np.random.default_rng(0)
    sampled = PhyFilter.from_poles([-20.0] * order).sampled(DT)
    x = np.cumsum(0.01 * rng.standard_normal((N, n_x)), axis=0)
    g, f_theta = rng.standard_normal((2, N, n_x))
    grid = (DT * np.arange(1, N + 1)).tolist()
    jitter = np.cumsum(rng.uniform(0.7 * DT, 1.3 * DT, N)).tolist()
    state, _ = sampled.step(sampled.start(x[0]), x[0], g[0], f_theta[0])
    lengths = np.diff(jitter, prepend=0.0).tolist()
    answer = {
        "step": seconds(lambda k: sampled.step(state, x[k], g[k], f_theta[k]), pause),
        "step, dt given": seconds(
            lambda k: sampled.step(state, x[k], g[k], f_theta[k], dt=lengths[k]), pause
        ),
    }
    policies = {"live": (LiveRules(), grid), "live, jitter": (LiveRules(), jitter)}
    policies["live, jitter, stuck_after"] = (LiveRules(stuck_after=5), jitter)
    for name, (rules, stamps) in policies.items():
        live = sampled.live(n_x, rules)
        live.step(0.0, x[0])
        answer[name] = seconds(
            lambda k, live=live, stamps=stamps: live.step(stamps[k], x[k], g[k], f_theta[k]), pause
        )
    return answer


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one case and no verdict, to see that it runs")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    cases = [(2, 3, 0.0)] if options.quick else [(1, 1, 0.0), (2, 3, 0.0), (4, 6, 0.0), (2, 3, DT)]
    rows = {}
    for order, n_x, pause in cases:
        name = f"n = {order}, {n_x} channels" + (f", after {1e3 * pause:g} ms of sleep" if pause else "")
        rows[name] = measured(order, n_x, pause)
        print(name)
        for kind, value in rows[name].items():
            print(f"{kind:>28}: {1e6 * value:6.1f} us")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    if options.quick:
        return 0
    worst = rows["n = 2, 3 channels"]["live, jitter"]
    print(f"live, jitter: limit {1e6 * LIMIT:g} us: {'holds' if worst < LIMIT else 'DOES NOT HOLD'}")
    return 0 if worst < LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
