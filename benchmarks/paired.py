"""Speed of this tree beside that of a commit: the same work in both, process by process in turn.

    python benchmarks/paired.py [COMMIT] [--runs 5] [--limit 1.05] [--quick]

CPU time of one thread, one BLAS thread; of each process the least of some repetitions, of all processes the least
again: what a busy machine adds is never negative. Exits 1 where a ratio is above the limit. Needs git.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def work() -> dict[str, Callable[[], object]]:
    """What is timed, by name."""
    import control as ct
    import numpy as np

    import phyfilter_ctl as pf

    rng = np.random.default_rng(0)
    sampled = pf.lowpass(3, 20.0, family="butterworth").sampled(0.002)
    x = np.cumsum(0.01 * rng.standard_normal((28_000, 3)), axis=0)
    g, f_theta = rng.standard_normal((2, *x.shape))
    times = np.cumsum(0.002 * (1.0 + 0.2 * rng.random(len(x))))
    few = slice(8000)
    label = np.gradient(x[few], 0.002, axis=0) - g[few]
    log = pf.Recording.from_arrays(x=x[few], dt=0.002, g=g[few], label=label)
    omega = np.geomspace(0.1, 1000.0, 2000)
    lag = ct.tf([1.0], [0.05, 1.0])
    plant = ct.nlsys(
        lambda t, x, u, params: [u[0] + u[1] - 0.5 * x[0] * np.sqrt(x[0] ** 2 + 1e-9)],
        inputs=["u", "d"],
        outputs=["x[0]"],
        states=1,
        name="plant",
    )
    loop = ct.interconnect(
        [plant, pf.sampled_block(sampled, 1)],
        inputs=["u", "d", "g[0]", "f_theta[0]"],
        outputs=["x[0]", "f_hat[0]"],
        name="loop",
    )
    flat = pf.flatten(loop)
    t = 0.002 * np.arange(10_000)
    inputs = np.stack([np.ones_like(t), np.sin(t), np.ones_like(t), np.zeros_like(t)])

    def fresh() -> pf.PhyFilter:  # nothing that an earlier round has kept
        return pf.lowpass(3, 20.0, family="butterworth")

    def steps() -> None:
        state = sampled.start(x[0], g0=g[0], f_theta0=f_theta[0])
        for k in range(1, 2000):
            state, _ = sampled.step(state, x[k], g[k], f_theta[k])

    return {
        "run, 28,000 x 3": lambda: sampled.run(x, g, f_theta),
        "run, irregular times": lambda: sampled.run(x, g, f_theta, times=times),
        "2000 steps": steps,
        "a filter, sampled": lambda: fresh().sampled(0.002).run(x[:2]),
        "ultimate bound": lambda: pf.error_bound(fresh(), {1: 3.0}),
        "ultimate bound, sampled": lambda: pf.error_bound(fresh().sampled(0.002), {1: 3.0}),
        "prior margin": lambda: pf.margins(fresh(), pf.Loop(actuator=lag)),
        "frequency response": lambda: pf.frequency_response(fresh(), omega),
        "learn, n = 2": lambda: pf.learn(log, 2),
        "flatten": lambda: pf.flatten(loop),
        "simulate, 20 s": lambda: pf.simulate(flat, t, inputs),
    }


def least_seconds(job: Callable[[], object], budget: float) -> float:
    """Least CPU time of one call, repeated for about ``budget`` seconds."""
    job()
    least, ends = float("inf"), time.thread_time() + budget
    while time.thread_time() < ends:
        began = time.thread_time()
        job()
        least = min(least, time.thread_time() - began)
    return least


def measured(tree: Path, budget: float) -> dict[str, float]:
    """Seconds by name, of a fresh process on that tree's package."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, __file__, "--inside", str(budget)]
    run = subprocess.run(command, cwd=tree, env=environment, check=True, stdout=subprocess.PIPE)
    return json.loads(run.stdout)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit", nargs="?", default="HEAD")
    parser.add_argument("--runs", type=int, default=5, help="processes for each tree")
    parser.add_argument("--limit", type=float, default=1.05, help="largest ratio, this tree over the commit")
    parser.add_argument("--quick", action="store_true", help="one short process each, nothing judged")
    parser.add_argument("--inside", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.inside is not None:
        json.dump({name: least_seconds(job, options.inside) for name, job in work().items()}, sys.stdout)
        return 0
    runs, budget = (1, 0.05) if options.quick else (options.runs, 0.5)
    with tempfile.TemporaryDirectory() as folder:
        packed = subprocess.run(
            ["git", "-C", ROOT, "archive", "--format=zip", options.commit], check=True, stdout=subprocess.PIPE
        )
        with zipfile.ZipFile(io.BytesIO(packed.stdout)) as archive:
            archive.extractall(folder)
        found = [(measured(Path(folder), budget), measured(ROOT, budget)) for _ in range(runs)]
    print(f"{'CPU time, ms':<26}{options.commit[:10]:>12}{'this tree':>12}{'ratio':>8}")
    above = False
    for name in found[0][0]:
        before, after = (1e3 * min(pair[side][name] for pair in found) for side in (0, 1))
        print(f"{name:<26}{before:>12.3f}{after:>12.3f}{after / before:>8.2f}")
        above |= after > options.limit * before
    return int(above and not options.quick)


if __name__ == "__main__":
    sys.exit(main())
