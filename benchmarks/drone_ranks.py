"""The drone's ten methods on 100 new flights each: medians, paired differences, ranks, and two errors of the model.

    python benchmarks/drone_ranks.py [--flights 100] [--quick]

Methods as `phyfilter-ctl run drone` tunes them, seeds drawn after that tuning. Per method the bandwidth of its
estimator and whether the search went beyond it on both sides; the median of the mean distance from the circle with its
95 % interval, by how much PhyFilter of order 1 is below it, paired flight by flight, its mean rank, and on how many
flights it is the best of those that are not told the mass. All know the nominal mass and carry its weight by
feed-forward, PD too; what is not trimmed is the payload. Then the same for a payload beyond what SEER-I was trained
on, 30 to 60 % instead of 5 to 30 %: an error of the model. Last, f_theta off by a factor, with the same filter and
gains: error below that of the filter without a model (factor 0), and below the observer as tuned without one; and the
error of the estimate itself, rms of f - f_hat. Factor 1 need not track best: the actuators lag, what is too much leads.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import rankdata

from phyfilter_ctl import models
from phyfilter_ctl.study import median_interval, reduction

comparison, drone_methods, drone_params, experiment, drone_flights, training, tuning = (
    importlib.import_module(f"{models.__name__}.drone.{name}")
    for name in ("comparison", "methods", "params", "experiment", "flights", "training", "tuning")
)
OURS, TOLD = "phyfilter", "known_mass"
FIRST = 12000
FACTORS = (0.5, 0.75, 1.0, 1.25, 1.5, 2.0)
HEAVY = (0.3, 0.6)  # of the mass


def table(seeds: Sequence[int], title: str, **options: object) -> None:
    found = comparison.compare(seeds, **options)
    for scenario, words in (("mass", "still air"), ("wind", "wind")):
        errors = {name: 100.0 * found.scores[scenario, name].total for name in found.methods}
        fair = [name for name in errors if name != TOLD]
        ranks = rankdata(np.stack([errors[name] for name in fair]), axis=0)
        print(f"\n{title}, {words}: {len(seeds)} flights, cm")
        print(
            f"{'':26} {'rad/s':>8} {'':4} {'median':>20}  {'PhyFilter below it, %':>24}"
            f" {'mean rank':>10} {'best on':>8}"
        )
        for name, values in errors.items():
            middle = median_interval(values)
            own = f"{middle.value:6.2f} [{middle.low:5.2f}, {middle.high:5.2f}]"
            versus = ""
            if name not in (OURS, TOLD):
                less = reduction(errors[OURS], values)
                versus = f"{less.value:6.1f} [{less.low:5.1f}, {less.high:5.1f}]"
            rank = ""
            if name in fair:
                row = ranks[fair.index(name)]
                rank = f"{row.mean():10.2f} {np.sum(row == 1.0):8}"
            entry = found.methods[name]
            gain = f"{entry.method.bandwidth:8.3g}" if entry.method.tunable else ""
            edge = "" if entry.interior else "edge"
            print(
                f"{drone_methods.NAMES[name]:26} {gain:>8} {edge:4} {own:>20}  {versus:>24} {rank}",
                flush=True,
            )

        if "indi" in errors and "accelerometer" in errors:
            less = reduction(errors["accelerometer"], errors["indi"]).text(1.0, 1)
            print(f"on the sensors of INDI, PhyFilter on an accelerometer is below it by {less} %")


def wrong_model(seeds: Sequence[int], factors: Sequence[float], seconds: float) -> None:
    """PhyFilter of order 1 with f_theta off by a factor."""
    model, tuned = training.train().model, tuning.tuned()
    ours = tuned[OURS].method
    for scenario, words in (("mass", "still air"), ("wind", "wind")):
        drawn = drone_flights.conditions(seeds, scenario)

        def errors(method: Any, drawn: Any = drawn) -> tuple[np.ndarray, float]:
            keep = ("r", "r_ref", "f_hat", "f_mass", "f_wind")
            used = model if method.uses_seer else None
            flown = experiment.fly(method, drawn, used, keep=keep, duration=seconds)
            f_hat, f_mass, f_wind = (flown.signals[name][:, flown.counted] for name in keep[2:])
            rms = np.sqrt(np.mean(np.sum((f_mass + f_wind - f_hat) ** 2, axis=2), axis=1))
            return 100.0 * flown.score().total, float(np.median(rms))

        (without, rms), (observer, _) = (
            errors(replace(ours, with_model=False)),
            errors(tuned["observer"].method),
        )
        print(f"\nf_theta off by a factor, {words}: {len(seeds)} flights, cm; error below, %")
        print(f"{'factor':>8} {'median':>20}  {'without the model':>24}  {'the observer':>24}  f - f_hat, N")
        print(f"{0.0:8.2f} {median_interval(without).text():>20}  {'':>24}  {'':>24}  {rms:12.3f}")
        for factor in factors:
            values, rms = errors(replace(ours, model_scale=factor))
            own = median_interval(values).text()
            below = [reduction(values, other).text(1.0, 1) for other in (without, observer)]
            print(f"{factor:8.2f} {own:>20}  {below[0]:>24}  {below[1]:>24}  {rms:12.3f}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--flights", type=int, default=100)
    parser.add_argument("--quick", action="store_true", help="two flights of 8 s, payloads as trained only")
    options = parser.parse_args()
    seeds = range(FIRST, FIRST + (2 if options.quick else options.flights))
    if options.quick:
        table(seeds, "payload as trained", methods=("baseline", "observer", OURS, TOLD), duration=8.0)
        wrong_model(seeds, FACTORS[:1], 8.0)
        return
    mass = drone_params.params().vehicle.mass
    table(seeds, "payload of 5 to 30 %, as trained")
    table(seeds, "payload of 30 to 60 %, beyond", payload=(HEAVY[0] * mass, HEAVY[1] * mass))
    wrong_model(seeds, FACTORS, 18.0)


if __name__ == "__main__":
    main()
