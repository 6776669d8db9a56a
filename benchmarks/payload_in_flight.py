"""A payload that is found in flight and put into the model, against the filter that takes it together with the wind.

    python benchmarks/payload_in_flight.py [--flights 100] [--quick]

The drone of models/drone with 5 to 60 % of payload in a mean wind of 0 to 8 m/s with 15 % turbulence, at hover and on
circles. The observer with the gains it was tuned to: f_theta = 0 (lumped); f_theta the payload's reaction to motion,
its mass as the separation block finds it from the start on, and 0 until that is known to 5 % of the vehicle's (found);
the same with the mass told. Mean distance from the reference after 6 s, in cm, and by how much it is lower, paired
flight by flight, in per cent, with 95 % intervals; where f_theta was 0 all along in some flights, the others in a row
of their own, with the least and the largest. At hover that is most of them: motion has to tell the mass.

Of the estimate: rms of f - f_hat as flown, and as theory foretells it for the second from the flights of the first:
(1 - F)(f - f_theta) instead of (1 - F) f, with the noise of the first.
Last, the payload drops after 8 s, which the separation block notices, and of which the third is not told.
"""

from __future__ import annotations

import argparse
import importlib
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl import models
from phyfilter_ctl.study import median_interval, reduction

Array = NDArray[np.float64]
FIRST = 15_000
# m/s, and s at which the payload drops.
MISSIONS = ((0.0, None), (1.0, None), (2.0, None), (3.0, None), (2.0, 8.0))
STILL = 1e-9  # m/s: the circle needs some speed


class Flown(NamedTuple):
    """By flight: errors (B,) in m, parts (B, N, 3) of the unknown force in N after start-up, was f_theta ever not 0."""

    error: Array
    missed: Array
    f: Array
    wind: Array
    used: NDArray[np.bool_]


def part(name: str) -> Any:
    """A module of models/drone."""
    return importlib.import_module(f"{models.__name__}.drone.{name}")


def flown(method: Any, drawn: Any, others: dict[str, Any], seconds: float, *, compiled: bool) -> Flown:
    """The flights of one method."""
    keep = ("r", "r_ref", "f_hat", "f_mass", "f_wind", *(() if method.payload == "lumped" else ("f_theta",)))
    flights = part("experiment").fly(
        method,
        drawn,
        keep=keep,
        duration=seconds,
        others=others,
        backend="c" if compiled else "vm",
    )
    cut = {name: signal[:, flights.counted] for name, signal in flights.signals.items()}
    f = cut["f_mass"] + cut["f_wind"]
    used = np.any(flights.signals.get("f_theta", np.zeros((len(f), 1, 1))) != 0.0, axis=(1, 2))
    return Flown(flights.score().total, f - cut["f_hat"], f, cut["f_wind"], used)


def foretold(lumped: Flown, method: Any, drawn: Any) -> float:
    """rms of f - f_hat with the payload in the model, from flights without."""
    nominal, dt = part("params").params().vehicle.mass, part("params").params().sampling.dt
    F = part("methods").filter_of(method).sampled(dt)
    # f_theta is what the forces known make the whole mass do; of the wind it therefore takes over dm/(m + dm).
    share = (nominal / (nominal + drawn.added_mass))[:, None, None]

    def left(signal: Array) -> Array:
        """(1 - F) of it."""
        return signal - np.stack([F.run(np.zeros_like(each), -each) for each in signal])

    noise = rms(lumped.missed) ** 2 - rms(left(lumped.f)) ** 2
    return float(np.sqrt(rms(left(share * lumped.wind)) ** 2 + noise))


def rms(signal: Array) -> float:
    """Of (B, N, 3), once a filter begun with it has settled."""
    return float(np.sqrt(np.mean(np.sum(signal[:, signal.shape[1] // 8 :] ** 2, axis=-1))))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--quick", action="store_true", help="two flights of 8 s at 3 m/s")
    options = parser.parse_args()
    count = 2 if options.quick else options.flights
    drawn = part("payload").windy_payloads(range(FIRST, FIRST + count))
    lumped = part("tuning").tuned()["observer"].method
    print(f"{count} flights a mission, payload 5 to 60 %, wind 0 to 8 m/s")
    head = f"{'m/s':>6} {'lumped, cm':>20} {'found: below, %':>22} {'told: below, %':>22}"
    print(f"{'':10}{head}   f - f_hat, N: lumped  found  foretold   in use in")
    for speed, drop in MISSIONS[3:4] if options.quick else MISSIONS:
        others: dict[str, Any] = {"controller.reference.speed": max(speed, STILL)}
        if drop is not None:
            others["vehicle.quadrotor.drop_time"] = np.full(count, drop)
        runs = {
            form: flown(
                replace(lumped, payload=form),
                drawn,
                others,
                8.0 if options.quick else 14.0,
                compiled=not options.quick,
            )
            for form in (("lumped", "separated") if options.quick else ("lumped", "separated", "told"))
        }
        plain, found = runs["lumped"], runs["separated"]
        own = median_interval(100.0 * plain.error).text()
        below = [
            reduction(run.error, plain.error).text(1.0, 1) for form, run in runs.items() if form != "lumped"
        ]
        used = f"{100.0 * np.mean(found.used):.0f} %"
        rest = [rms(plain.missed), rms(found.missed)]
        if drop is None:
            rest.append(foretold(plain, lumped, drawn))
        columns = "".join(f"{value:>9.3f}" for value in rest)
        print(
            f"{'dropped' if drop else '':10}{speed:6.1f} {own:>20} " + " ".join(f"{b:>22}" for b in below),
            end="",
        )
        print(f"   {'':12}{columns:27}   {used:>9}", flush=True)
        if found.used.any() and not found.used.all():
            those = found.error[found.used], plain.error[found.used]
            each = 100.0 * (1.0 - those[0] / those[1])
            print(
                f"{'':10}{'':6} {f'in use in {len(each)} flights':>20} {reduction(*those).text(1.0, 1):>22} "
                f"  least {each.min():.1f}, largest {each.max():.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
