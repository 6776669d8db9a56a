"""Acceleration from velocity on generated flights, over seeds: how often the filter wins, and by how much.

    python benchmarks/generated_acceleration.py [--seeds 10] [--quick]

Each seed makes other flights and another network; everything is trained and tuned on its training flights. Prints the
test RMSE of network, third-order filter and the best method that learns nothing.
"""

from __future__ import annotations

import argparse
import importlib

from tqdm import tqdm

from phyfilter_ctl import models


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0 to this less one (default 10)")
    parser.add_argument("--quick", action="store_true", help="two seeds, short flights, coarse tuning")
    options = parser.parse_args()
    experiment, flights = (
        importlib.import_module(f"{models.__name__}.acceleration.{name}")
        for name in ("experiment", "flights")
    )
    effort, share = (experiment.QUICK, 0.25) if options.quick else (experiment.Effort(), 1.0)
    rows: dict[int, dict[str, float]] = {}
    for seed in tqdm(range(2 if options.quick else options.seeds), disable=None, unit="seed"):
        train, test = (flights.generate(kind, seed, share=share) for kind in ("train", "test"))
        rows[seed] = experiment.compare(train, test, data="generated", seed=seed, effort=effort).test_rmse
    print(
        f"{'seed':>4} {'network':>8} {'phyfilter_3':>11} {'network / it':>12} {'best of the rest':>25} {'it / best':>9}"
    )
    wins = []
    for seed, scores in rows.items():
        ours = scores["phyfilter_3"]
        rest = {name: score for name, score in scores.items() if not name.startswith("phyfilter")}
        best = min(rest, key=lambda name: rest[name])
        if ours < rest[best]:
            wins.append(seed)
        named = f"{best} {rest[best]:.4f}"
        ratio = scores["network"] / ours
        print(
            f"{seed:4d} {scores['network']:8.4f} {ours:11.4f} {ratio:12.2f} {named:>25} {ours / rest[best]:9.3f}"
        )
    print(f"phyfilter_3 is below every other method at {len(wins)} of {len(rows)} seeds: {wins}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
