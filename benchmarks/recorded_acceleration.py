"""Acceleration from velocity on recorded flights: trained on the slower half, tested on the faster half.

    python benchmarks/recorded_acceleration.py FOLDER [--seed 0] [--quick]

FOLDER holds CSV files with the columns t [s], vx vy vz [m/s], ax ay az [m/s^2], one a flight. The order of the flights
is that of the 99th percentile of their speed. Prints the scores of every method and whether each filter is below the
network and below every differentiator. A folder that is not there is not evaluated, which is no pass.
"""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path

from phyfilter_ctl import models
from phyfilter_ctl.recording import Recording, split_by_speed


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="folder of CSV files")
    parser.add_argument("--seed", type=int, default=0, help="of the network's first weights (default 0)")
    parser.add_argument("--quick", action="store_true", help="coarser training and tuning")
    options = parser.parse_args()
    paths = sorted(options.folder.glob("*.csv")) if options.folder.is_dir() else []
    if len(paths) < 2:
        print(f"not evaluated: expected at least 2 CSV files in {options.folder}, found {len(paths)}")
        return 0
    slower, faster = split_by_speed([Recording.from_csv(path) for path in paths])
    experiment = importlib.import_module(f"{models.__name__}.acceleration.experiment")
    effort = experiment.QUICK if options.quick else experiment.Effort()
    comparison = experiment.compare(slower, faster, data="recorded", seed=options.seed, effort=effort)
    train, test = comparison.train_rmse, comparison.test_rmse
    for name, logs in (("training", slower), ("test", faster)):
        speeds = [log.speed() for log in logs]
        print(
            f"{name}: {len(logs)} flights, 99th percentile of speed {min(speeds):.2f} to {max(speeds):.2f} m/s"
        )
    print(f"{'RMSE in m/s^2':<26}{'training':>10}{'test':>10}")
    for name in test:
        print(f"{name:<26}{train[name]:>10.4f}{test[name]:>10.4f}")
    others = {name: score for name, score in test.items() if not name.startswith("phyfilter")}
    rival = min(others, key=lambda name: others[name])
    for name in sorted(set(test) - set(others)):
        verdict = "below all of them" if test[name] < others[rival] else f"not below {rival}"
        print(f"{name}: {verdict} ({test[name] / others[rival] - 1.0:+.1%} against {rival})")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
