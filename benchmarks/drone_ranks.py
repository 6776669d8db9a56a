"""The drone's nine methods on 100 new flights each: medians, paired differences, ranks, and a wrong model of the mass.

    python benchmarks/drone_ranks.py [--flights 100] [--quick]

Methods as `phyfilter-ctl run drone` tunes them, seeds away from those of tuning and of its own table. Per method the
median of the mean distance from the circle with its 95 % interval, by how much PhyFilter of order 1 is below it, paired
flight by flight, its mean rank, and on how many flights it is the best of those that are not told the mass. Then the
same for a payload beyond what SEER-I was trained on, 30 to 60 % instead of 5 to 30 %: an error of the model.
"""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence

import numpy as np
from scipy.stats import rankdata

from phyfilter_ctl import models
from phyfilter_ctl.study import median_interval, reduction

comparison, drone_methods, drone_params = (
    importlib.import_module(f"{models.__name__}.drone.{name}") for name in ("comparison", "methods", "params")
)
OURS, TOLD = "phyfilter", "known_mass"
FIRST = 7000
HEAVY = (0.3, 0.6)  # of the mass


def table(seeds: Sequence[int], title: str, **options: object) -> None:
    found = comparison.compare(seeds, **options)
    for scenario, words in (("mass", "still air"), ("wind", "wind")):
        errors = {name: 100.0 * found.scores[scenario, name].total for name in found.methods}
        fair = [name for name in errors if name != TOLD]
        ranks = rankdata(np.stack([errors[name] for name in fair]), axis=0)
        print(f"\n{title}, {words}: {len(seeds)} flights, cm")
        print(f"{'':26} {'median':>20}  {'PhyFilter below it, %':>24} {'mean rank':>10} {'best on':>8}")
        for name, values in errors.items():
            middle = median_interval(values)
            own = f"{middle.median:6.2f} [{middle.low:5.2f}, {middle.high:5.2f}]"
            versus = ""
            if name not in (OURS, TOLD):
                less = reduction(errors[OURS], values)
                versus = f"{less.median:6.1f} [{less.low:5.1f}, {less.high:5.1f}]"
            rank = ""
            if name in fair:
                row = ranks[fair.index(name)]
                rank = f"{row.mean():10.2f} {np.sum(row == 1.0):8}"
            print(f"{drone_methods.NAMES[name]:26} {own:>20}  {versus:>24} {rank}", flush=True)


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
        return
    mass = drone_params.params().vehicle.mass
    table(seeds, "payload of 5 to 30 %, as trained")
    table(seeds, "payload of 30 to 60 %, beyond", payload=(HEAVY[0] * mass, HEAVY[1] * mass))


if __name__ == "__main__":
    main()
