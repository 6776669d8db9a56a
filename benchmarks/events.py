"""How accurately events are located, and what they cost.

A bouncing ball, a thermostat and stick-slip friction against closed forms, a hopper's touchdowns
and lift-offs against a piecewise integration by SciPy (rtol = 1e-13). Errors are the largest of all event times; the
table has them over the tolerance of the integration.

    python benchmarks/events.py [--quick]

Exits 1 where an error at rtol = 1e-10 is above 1e-7 s.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import phyfilter_ctl as pf

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.simulation import hybrid_models as models

LIMIT = 1e-7
# Diagram, start, end in s, the events' times.
Case = tuple[Callable[[], Any], list[float], float, Callable[[], np.ndarray]]
CASES: dict[str, Case] = {
    "bouncing ball": (models.bouncing_ball, [1.0, 0.0, 1.0], 4.0, lambda: models.bounces(1.0, 200)),
    "thermostat": (models.thermostat, [20.0, 1.0], 40.0, lambda: models.thermostat_times(200)),
    "stick-slip": (models.stick_slip, [0.0, 0.5, 1.0], 40.0, lambda: models.stick_slip_times(200)),
    "hopper": (models.hopper, [1.0, 0.0, 0.0], 2.0, lambda: models.hopper_times(1.0, 2.0)),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one method")
    quick = parser.parse_args().quick
    worst = 0.0
    print(
        f"{'':14} {'method':9} {'events':>6} "
        + " ".join(f"{f'rtol {rtol:.0e}':>11}" for rtol in (1e-6, 1e-8, 1e-10))
        + "  ms an event"
    )
    for name, (make, start, end, expected) in CASES.items():
        flat, exact = pf.flatten(make()), expected()
        exact = exact[exact < end]
        for method in ("adaptive",) if quick else ("adaptive", "stiff"):
            errors, spent = [], 0.0
            for rtol in (1e-6, 1e-8, 1e-10):
                begin = time.perf_counter()
                answer = pf.simulate(
                    flat,
                    [0.0, end],
                    initial_state=start,
                    method=method,
                    backend="vm",
                    rtol=rtol,
                    atol=rtol * 1e-2,
                )
                spent = time.perf_counter() - begin
                found = np.array([at for at, _ in answer.events])
                errors.append(float(np.abs(found - exact).max()) if len(found) == len(exact) else np.inf)
            worst = max(worst, errors[-1])
            print(
                f"{name:14} {method:9} {len(exact):6d} "
                + " ".join(f"{error:11.1e}" for error in errors)
                + f" {1e3 * spent / len(exact):12.2f}"
            )
    return int(worst > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
