"""What a saturated actuator does to the estimate, and to the loop that it is fed back in.

    python benchmarks/saturation.py           the table
    python benchmarks/saturation.py --quick   one filter, one flight

A mass of 1 kg on which the actuator can put 5 N, a PD controller of kp = 10 1/s^2, kd = 6 1/s, 500 Hz, and f_hat fed
back: command = PD - f_hat. Three flights of 40 s: from rest a gust of 8 N for 2 s, more than the actuator has; from a
position error of 10 m; from rest a force of 4 N for good, which it has. Each without filter, with the filter given the
command as g, and with ``g_limit``, so that it counts what acts. Printed: how many times the limit the command may be
before the circle criterion no longer proves the loop stable; the largest error of f_hat against F f (what the filter
would say without saturation), the largest command, and when the position error last exceeded 5 cm. Exits with status 1
if, told what acts, the estimate is off by more than rounding or a flight does not come back.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

import phyfilter_ctl as pf

H, LIMIT, KP, KD, END = 0.002, 5.0, 10.0, 6.0, 40.0
FILTERS = {
    "order 1, 20 rad/s": pf.PhyFilter([20.0]),
    "order 2, Butterworth, 20 rad/s": pf.lowpass(2, 20.0, family="butterworth"),
    "order 2, type 2, 20 rad/s": pf.place_poles([-20.0] * 2, type=2),
}
FLIGHTS: dict[str, tuple[float, Callable[[float], float]]] = {
    "gust of 8 N for 2 s": (0.0, lambda t: 8.0 * (1.0 <= t < 3.0)),
    "10 m off": (10.0, lambda t: 0.0),
    "4 N for good": (0.0, lambda t: 4.0 * (t >= 1.0)),
}
# Of sums of 20,000 steps of up to 500 m/s^2 a step.
ROUNDING = 1e-8
NEAR = 0.05


@dataclass(frozen=True)
class Flight:
    """Largest |f_hat - F f| in N, largest command in N, time in s after which the position error stays below NEAR."""

    error: float
    command: float
    back: float


def flown(sampled: pf.SampledPhyFilter | None, position: float, force: Callable[[float], float]) -> Flight:
    """The mass, exactly: force and command are constant over a step."""
    times = H * np.arange(round(END / H))
    forces = np.array([force(t) for t in times])
    speed = f_hat = command = error = largest = last = 0.0
    fed_back = sampled is not None
    filter = sampled if fed_back else FILTERS["order 1, 20 rad/s"].sampled(H)
    truth = filter.run(np.concatenate([[0.0], H * np.cumsum(forces[:-1])]))[:, 0]
    state = filter.start([0.0])
    for k, t in enumerate(times):
        if fed_back and k:
            state, out = filter.step(state, [speed], [command])
            f_hat = float(out[0])
            error = max(error, abs(f_hat - truth[k]))
        command = -KP * position - KD * speed - f_hat
        largest = max(largest, abs(command))
        last = t if abs(position) > NEAR else last
        acceleration = float(np.clip(command, -LIMIT, LIMIT)) + forces[k]
        position += H * speed + 0.5 * H**2 * acceleration
        speed += H * acceleration
    return Flight(error, largest, last)


def compared(filter: pf.PhyFilter, flights: int) -> dict[str, dict[str, Flight]]:
    """flight -> what the filter is told -> how it went."""
    told = {
        "without filter": None,
        "told the command": filter.sampled(H),
        "told what acts": filter.sampled(H, g_limit=(-LIMIT, LIMIT)),
    }
    return {
        name: {kind: flown(sampled, *flight) for kind, sampled in told.items()}
        for name, flight in list(FLIGHTS.items())[:flights]
    }


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one filter, one flight")
    options = parser.parse_args()
    fine = True
    for name, filter in list(FILTERS.items())[: 1 if options.quick else None]:
        print(f"{name}\n{'':<42}{'error of f_hat':>16}{'command':>12}{'back after':>12}")
        for told in ("commanded", "saturated"):
            margin = pf.saturation_margin(filter, pf.Loop(KP, KD), g=told, dt=H)
            print(
                f"  told what is {told}: stable for commands up to {margin.command_excess:.2f} times the limit"
            )
        for flight, answers in compared(filter, 1 if options.quick else 3).items():
            for kind, found in answers.items():
                back = (
                    "never"
                    if found.back > END - 2.0 * H
                    else f"{found.back:.2f} s"
                    if found.back
                    else "at once"
                )
                error = f"{found.error:.2g} N" if kind != "without filter" else ""
                print(f"  {flight:<22}{kind:<18}{error:>16}{f'{found.command:.4g} N':>12}{back:>12}")
            fine &= answers["told what acts"].error < ROUNDING and answers["told what acts"].back < 0.5 * END
    print("told what acts: " + ("f_hat is F f, every flight comes back" if fine else "DOES NOT HOLD"))
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
