"""How long the aerial manipulator's planner takes for one plan, by solver and horizon.

A mission of two transfers with a pick and a place, sudden targets, a swaying attitude and limits that are met on the
way is flown once with the solver daqp. Every solver then plans from each state of that flight. Times are CPU
times of a whole call, on one thread: building the programme, solving it, checking the answer. Solvers start cold.

    python benchmarks/planner.py [--quick] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import get_args

import numpy as np
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

from phyfilter_ctl.controllers.planner import (
    CooperativePlanner,
    PlannedPath,
    PlannerLimits,
    SolverName,
    follow,
)
from phyfilter_ctl.results import Status

# The default's promise: a tenth of the planner's period.
SOLVER, HORIZON, MILLISECONDS = "daqp", 15, 7.0

LIMITS = PlannerLimits([[-3.0, -3.0, 0.3], [3.0, 3.0, 2.5]], [[0.18, -0.15, -0.3], [0.42, 0.15, -0.05]])
MOUNT = (0.05, 0.0, -0.05)
START = (0.0, 0.0, 1.3, 0.0, 0.0, 0.0, 0.3, 0.0, -0.15, 0.0, 0.0, 0.0)
# End of each leg in s, and where the end effector shall be until then.
LEGS = (
    (3.0, (1.5, 0.5, 1.2)),
    (5.0, (1.5, 0.5, 0.8)),
    (6.5, (1.5, 0.5, 1.2)),
    (11.0, (-2.0, 1.0, 1.5)),
    (13.0, (-2.0, 1.0, 0.6)),
    (15.0, (-2.0, 1.0, 1.2)),
    (20.0, (0.4, 0.0, 1.1)),
)


def target(t: float) -> tuple[float, float, float]:
    """Where the end effector shall be, m."""
    return next((place for end, place in LEGS if t < end), LEGS[-1][1])


def attitude(t: float, h: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sway of 0.1 rad, with its rate to first order."""
    angle = np.array([0.7, 0.9]) * t
    tilt = 0.1 * np.array([np.sin(angle[0]), np.cos(angle[1]), 0.0])
    rate = 0.1 * np.array([0.7 * np.cos(angle[0]), -0.9 * np.sin(angle[1]), 0.0])
    return Rotation.from_rotvec(tilt).as_matrix(), rate


def replayed(planner: CooperativePlanner, path: PlannedPath) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Milliseconds, distance of the first accelerations from the path's, and success, of plans along a path."""
    rows, u = [], np.zeros(6)
    for k, t in enumerate(path.times[:-1]):
        aims = [target(t + planner.dt * (i + 1)) for i in range(planner.horizon)]
        R, omega = attitude(t, path.h[k], u)
        began = time.thread_time()
        plan = planner.plan(path.h[k], u, target=aims, R=R, omega=omega)
        seconds = time.thread_time() - began
        solved = plan.status is Status.OPTIMAL
        off = float(abs(plan.u[0] - path.u[k]).max()) if solved else np.nan
        rows.append((1e3 * seconds, off, solved))
        u = path.u[k]
    times, off, solved = np.array(rows).T
    return times, off, solved.astype(bool)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="the default solver and horizon, a third of the mission"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    steps = 95 if options.quick else 285
    rows: list[dict[str, str | float]] = []
    missed: list[str] = []
    for horizon in (HORIZON,) if options.quick else (10, 15, 20):
        path = follow(
            CooperativePlanner(LIMITS, MOUNT, horizon=horizon),
            START,
            targets=target,
            steps=steps,
            attitude=attitude,
        )
        for solver in (SOLVER,) if options.quick else get_args(SolverName):
            planner = CooperativePlanner(LIMITS, MOUNT, horizon=horizon, solver=solver)
            planner.plan(START, target=target(0.0))
            times, off, solved = replayed(planner, path)
            rows.append(
                {
                    "solver": solver,
                    "horizon": horizon,
                    "p50": float(np.median(times)),
                    "p99": float(np.percentile(times, 99)),
                    "longest": float(times.max()),
                    "failed": int((~solved).sum()),
                    "off": float(np.nanmax(off)),
                }
            )
    print(
        f"{steps} plans; times in ms, off: largest difference of the first acceleration from daqp's, m/s^2\n"
    )
    print(f"{'N':>3} {'solver':8} {'p50':>7} {'p99':>7} {'longest':>8} {'failed':>7} {'off':>9}")
    for row in rows:
        print(
            f"{row['horizon']:3} {row['solver']:8} {row['p50']:7.2f} {row['p99']:7.2f} {row['longest']:8.2f} "
            f"{row['failed']:7} {row['off']:9.1e}"
        )
        if (row["solver"], row["horizon"]) == (SOLVER, HORIZON):
            # A short run on a shared machine has no 99th percentile to speak of.
            quantile = "p50" if options.quick else "p99"
            if float(row[quantile]) > MILLISECONDS or row["failed"]:
                missed.append(f"{quantile} {row[quantile]:.2f} ms, {row['failed']} failed")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    for line in missed:
        print("missed:", line)
    return int(bool(missed))


if __name__ == "__main__":
    with threadpool_limits(1):
        sys.exit(main())
