"""Acceleration from velocity on generated flights, all methods, over seeds; paired intervals over seeds.

    python benchmarks/generated_acceleration.py [--seeds 10] [--workers N] [--quick]

Each seed makes other flights and another network; everything is trained and tuned on its training flights. Prints the
test RMSE by seed, of the network, of filters, and of the best method that has no PhyFilter in it; and of each filter
over each of the others the ratio over all seeds with a 95 % bootstrap interval: a seed is what is independent. A filter
is ahead where that lies below 0.
"""

from __future__ import annotations

import argparse
import importlib
from functools import partial

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from phyfilter_ctl import models
from phyfilter_ctl.execution import Executor

SHOWN = ("network", "phyfilter_3", "learned", "learned_axes", "network_after")


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0 to this less one (default 10)")
    parser.add_argument("--quick", action="store_true", help="one seed, short flights, coarse tuning")
    parser.add_argument("--workers", type=int, help="processes (default one per core)")
    options = parser.parse_args()
    experiment, scores = (
        importlib.import_module(f"{models.__name__}.acceleration.{name}") for name in ("experiment", "scores")
    )
    effort, share = (experiment.QUICK, 0.1) if options.quick else (experiment.Effort(), 1.0)
    squares: dict[str, list[NDArray[np.float64]]] = {}
    print(
        f"{'seed':>4}" + "".join(f"{name:>14}" for name in SHOWN) + f"{'order':>6}   best without a PhyFilter"
    )
    seeds = range(1 if options.quick else options.seeds)
    work = partial(experiment.compare_generated, effort=effort, share=share)
    with Executor(1 if options.quick else options.workers) as executor:
        for found in tqdm(executor.map(work, seeds), total=len(seeds), disable=None, unit="seed"):
            for name, values in found.test_squares.items():
                squares.setdefault(name, []).append(values.sum(axis=0))
            rmse = found.test_rmse
            best = scores.best_rival(rmse)
            print(
                f"{found.seed:4d}"
                + "".join(f"{rmse[name]:14.4f}" for name in SHOWN)
                + f"{found.linear.result.filter.order:6d}   {best} {rmse[best]:.4f}",
                flush=True,
            )
    table = {name: np.array(values) for name, values in squares.items()}
    ours, rivals = ([name for name in table if (name in scores.OURS) == own] for own in (True, False))
    print("\nall seeds: RMSE in m/s^2, and of the filters over the others")
    print(f"{'':<26}{'RMSE':>8}   " + "".join(f"{name:<28}" for name in ours))
    print(f"{'':<37}" + "".join(f"{scores.root_mean(table[name]):<28.4f}" for name in ours))
    for rival in rivals:
        ratios = [scores.over(table[name], table[rival]) for name in ours]
        cells = [f"{ratio}{' *' if ratio.is_ahead else ''}" for ratio in ratios]
        print(f"{rival:<26}{scores.root_mean(table[rival]):8.4f}   " + "".join(f"{c:<28}" for c in cells))
    print("* ahead")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
