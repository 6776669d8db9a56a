"""What a block diagram costs to draw: seconds, crossings and size of known and random diagrams.

    python benchmarks/drawing.py [--quick]

Processor seconds of this process, the least of some draws of the same diagram. Fails where a diagram of 40 blocks takes
more than 0.5 s, one of 150 more than 8 s, or the drone opened one level more than 0.15 s.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl import models

# s
LIMITS = {"40 blocks": 0.5, "150 blocks": 8.0, "drone, opened": 0.15}


def least(work: Callable[[], Any], runs: int) -> float:
    """Seconds of the quickest run."""
    seconds = np.inf
    for _ in range(runs):
        begin = time.process_time()
        work()
        seconds = min(seconds, time.process_time() - begin)
    return float(seconds)


def scattered(count: int, seed: int) -> ct.InterconnectedSystem:
    """First-order blocks in a chain, and half as many wires from anywhere to anywhere."""
    rng = np.random.default_rng(seed)
    parts = [ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name=f"b{k}") for k in range(count)]
    diagram = ct.InterconnectedSystem(parts, inputs=["r"], outputs=["y"], name="scattered")
    connect = np.eye(count, k=-1)
    connect[rng.integers(count, size=count // 2), rng.integers(count, size=count // 2)] = 1.0
    connect[0, -1] = -1.0
    diagram.connect_map = connect
    diagram.input_map = np.eye(count, 1)
    diagram.output_map = np.eye(1, 2 * count, count - 1)
    return diagram


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few draws: does everything run?")
    quick: bool = parser.parse_args().quick
    drone, arm = (models.load(name).build() for name in ("drone", "aerial_manipulator"))
    cases: list[tuple[str, list[ct.InputOutputSystem], int]] = [
        (f"{count} blocks", [scattered(count, seed) for seed in range(1 if quick else 5)], 0)
        for count in (5, 10, 20, 40) + (() if quick else (150,))
    ]
    cases += [
        ("drone", [drone], 0),
        ("drone, opened", [drone], 1),
        ("arm", [arm], 0),
        ("arm, opened", [arm], 1),
    ]
    late = []
    print(f"{'':16}{'median s':>10}{'slowest s':>11}{'wires':>7}{'width px':>10}")
    for name, systems, depth in cases:
        seconds = [least(lambda s=s, d=depth: pf.draw(s, depth=d), 2 if quick else 5) for s in systems]
        drawings = [pf.draw(system, depth=depth) for system in systems]
        wires, wide = (
            np.median(values) for values in zip(*((len(d.wires), d.width) for d in drawings), strict=True)
        )
        limit = LIMITS.get(name, np.inf)
        late += [name] if max(seconds) > limit else []
        told = f"  at most {limit:g}" if name in LIMITS else ""
        print(f"{name:16}{np.median(seconds):10.4f}{max(seconds):11.4f}{wires:7.0f}{wide:10.0f}{told}")
    print(f"too slow: {', '.join(late)}" if late else "all within their limits")
    return int(bool(late))


if __name__ == "__main__":
    sys.exit(main())
