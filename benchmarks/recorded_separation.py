"""Payload and wind told apart in recorded flights of a wind tunnel: one mass for all, winds in order?

    python benchmarks/recorded_separation.py FOLDER

FOLDER: the flights as CSV (see models/drone/replay.py). No label of the parts exists. Last the mass that all flights
have in common, by the mean of the single ones and by all recordings at once, in which wind, drag and gusts differ.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from separation import drone, table

import phyfilter_ctl as pf
from phyfilter_ctl.estimation import ColouredForce, Payload, Regressor, SteadyForce


def tunnel(folder: Path) -> None:
    """Recorded flights: no label of the parts exists, so what is shown is whether mass and winds agree."""
    rows, masses, logs, parts = [], [], [], []
    for path in sorted(folder.glob("*.csv")):
        flight = drone("replay_recordings").read(path, thrust_delay=0.06)
        log = pf.Recording(flight.log.times, flight.v, g=flight.g)
        logs.append(log)
        parts.append(
            [
                Payload(0.2, name="mass"),
                SteadyForce([5.0, 5.0, 0.5], name="wind"),
                Regressor(-flight.v, sd=0.5, name="drag"),
                ColouredForce(1.0, 3.0, name="gusts"),
            ]
        )
        found = pf.separate(log, parts[-1])
        mass, wind = found.parts["mass"], found.parts["wind"]
        masses.append((mass.value[0], mass.sd_value[0]))
        rows.append(
            [
                path.stem.removeprefix("custom_figure8_"),
                f"{100 * mass.value[0]:.1f} +- {196 * mass.sd_value[0]:.1f}",
                *(
                    f"{value:.2f} +- {1.96 * sd:.2f}"
                    for value, sd in zip(wind.value[:2], wind.sd_value[:2], strict=True)
                ),
                f"{wind.value[2]:.2f}" if wind.identified[2] else "not told apart",
                f"{found.parts['drag'].value[0]:.2f}",
                f"{found.consistency:.2f}",
            ]
        )
    print(
        table(
            [
                "flight",
                "mass beyond thrust/hover, %",
                "wind x, m/s^2",
                "y",
                "z",
                "drag, 1/s",
                "consistency",
            ],
            rows,
        )
    )
    value, sd = np.array(masses).T
    pooled = np.sum(value / sd**2) / np.sum(1.0 / sd**2)
    apart = np.sum(((value - pooled) / sd) ** 2)
    print(
        f"one mass for all: {100 * pooled:.1f} %, chi-square {apart:.0f} of {len(value) - 1} degrees of freedom"
    )
    common = pf.separate(logs, parts, shared=["mass"])[-1].parts["mass"]
    print(f"all recordings at once: {100 * common.value[0]:.1f} +- {196 * common.sd_value[0]:.1f} %")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    if not any(folder.glob("*.csv")):
        print(f"{folder}: no CSV there; not evaluated")
        return
    tunnel(folder)


if __name__ == "__main__":
    main()
