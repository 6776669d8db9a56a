"""Where a learned model pays: drone and arm flown with it and without it, over speed and wind.

    python benchmarks/model_map.py [--system drone arm] [--seeds 100] [--picture FILE] [--json FILE] [--quick]

Drone: circles of other speeds, SEER-I trained for it flying along. Arm: hover while the arm turns on the paper's path.
By how much the model lowers the mean error, in per cent, paired flight by flight: median and its 95 % interval, "0"
where it holds 0; against the same filter and gains without the model, and against the observer as tuned without one.
Then, for the same filter, only what the estimate is to blame for: rms of the compliance's answer to f - f_hat of the
flights, as it was and as :func:`model_value` foretells it from the flights with the model alone, without labels.
Positive: the model pays. Nothing is tuned here; the methods are those of the models' own studies.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import control as ct
import matplotlib
import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import models
from phyfilter_ctl.plots import COLOURS
from phyfilter_ctl.study import Interval, reduction

Array = NDArray[np.float64]
CHUNK = 20  # flights at a time
FORETOLD = 8  # flights the forecast is made of


class Cell(NamedTuple):
    """One speed and wind."""

    speed: float
    wind: float
    same: Interval
    tuned: Interval
    own: float
    foretold: float


def part(system: str, name: str) -> ModuleType:
    return importlib.import_module(f"{models.__name__}.{system}.{name}")


def drone(speed: float, wind: float, seeds: Sequence[int], seconds: float) -> Cell:
    """Circles at a speed in m/s, wind as a share of the study's."""
    flights, experiment = part("drone", "flights"), part("drone", "experiment")
    tuned, model = part("drone", "tuning").tuned(), part("drone", "training").train().model
    known = part("drone", "params").params()
    methods = [tuned["phyfilter"].method, tuned["observer"].method]
    methods.insert(1, replace(methods[0], with_model=False))
    errors: list[list[Array]] = [[], [], []]
    logs: list[list[pf.Recording]] = [[], []]
    for k in range(0, len(seeds), CHUNK):
        those = flights.conditions(seeds[k : k + CHUNK], "wind", strength=wind)
        for i, method in enumerate(methods):
            more = ("v_m", "g", "f_hat", "f_mass", "f_wind") if i < 2 and k == 0 else ()
            flown = experiment.fly(
                method,
                those,
                model if method.uses_seer else None,
                keep=("r", "r_ref", *more, *(("f_theta",) if more and i == 0 else ())),
                duration=seconds,
                others={"controller.reference.speed": speed},
            )
            errors[i].append(flown.score().total)
            if more:
                logs[i] = [
                    log(
                        {name: signal[j][flown.counted] for name, signal in flown.signals.items()},
                        known.vehicle.mass,
                        known.sampling.dt,
                    )
                    for j in range(min(FORETOLD, len(those.seeds)))
                ]
    kp, kd, _ = methods[0].gains
    compliance = ct.TransferFunction([1.0 / known.vehicle.mass], [1.0, kd, kp])
    own = [blamed(those, compliance) for those in logs]
    found = pf.model_value(logs[0], part("drone", "methods").filter_of(methods[0]), orders=(1,), g="average")
    told = found.through(compliance)
    ours, same, other = (np.concatenate(each) for each in errors)
    return Cell(speed, wind, reduction(ours, same), reduction(ours, other), less(*own), less(*told))


def log(signals: dict[str, Array], mass: float, dt: float) -> pf.Recording:
    """A flight as a recording, f - f_hat as its label."""
    missed = signals["f_mass"] + signals["f_wind"] - signals["f_hat"]
    theta = signals.get("f_theta")
    return pf.Recording.from_arrays(
        x=mass * signals["v_m"], g=signals["g"], f_theta=theta, label=missed, dt=dt
    )


def blamed(logs: Sequence[pf.Recording], compliance: ct.TransferFunction) -> float:
    """Rms of the position error that f - f_hat leads to."""
    squares = []
    for each in logs:
        assert each.label is not None
        for channel in each.label.T:
            answer = ct.forced_response(compliance, each.times - each.times[0], channel).outputs
            squares.append(float(np.mean(np.asarray(answer)[len(channel) // 4 :] ** 2)))
    return float(np.sqrt(np.mean(squares)))


def less(ours: float, theirs: float) -> float:
    return 100.0 * (1.0 - ours / theirs)


def arm(rate: float, wind: float, seeds: Sequence[int], seconds: float) -> Cell:
    """The arm turning at a rate in rad/s, wind as a share of the study's."""
    experiment, training = part("aerial_manipulator", "experiment"), part("aerial_manipulator", "training")
    tuned, seer = part("aerial_manipulator", "tuning").tuned(), training.train().seer
    known = part("aerial_manipulator", "params").params()
    methods = [tuned["phyfilter"].method, tuned["observer"].method]
    methods.insert(1, replace(methods[0], name="observer"))
    goals = training.circling((rate, rate), seconds)
    others = {"vehicle.wind.jet_speed": wind * known.wind.jet_speed, "vehicle.load.mass": 0.0}
    errors: list[list[Array]] = [[], [], []]
    counted = goals.time >= 0.3 * seconds
    for k in range(0, len(seeds), CHUNK):
        for i, method in enumerate(methods):
            flown = experiment.fly(
                method, seeds[k : k + CHUNK], seer if method.uses_seer else None, goals=goals, others=others
            )
            error = flown.error()
            fell = ~np.isfinite(error).all(axis=1)
            errors[i].append(np.where(fell, np.inf, error[:, counted].mean(axis=1)))
    ours, same, other = (np.concatenate(each) for each in errors)
    return Cell(rate, wind, reduction(ours, same), reduction(ours, other), np.nan, np.nan)


SYSTEMS = {
    "drone": (drone, "m/s", (1.0, 2.0, 3.0, 3.75), (0.0, 0.5, 1.0), 18.0),
    "arm": (arm, "rad/s", (1.5, 2.5, 3.5, 5.0, 6.5), (0.0, 1.0), 20.0),
}


def said(found: Interval) -> str:
    sure = "" if found.low > 0.0 or found.high < 0.0 else "  0"
    return f"{found.median:7.1f} [{found.low:6.1f}, {found.high:6.1f}]{sure:3}"


def draw(cells: dict[str, list[Cell]], path: Path) -> None:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(cells), layout="constrained", figsize=(4.2 * len(cells), 3.2), squeeze=False
    )
    for ax, (name, found) in zip(axes[0], cells.items(), strict=True):
        for k, wind in enumerate(sorted({cell.wind for cell in found})):
            row = [cell for cell in found if cell.wind == wind]
            speeds = [cell.speed for cell in row]
            colour = COLOURS[k]
            ax.fill_between(
                speeds, [c.tuned.low for c in row], [c.tuned.high for c in row], color=colour, alpha=0.2, lw=0
            )
            ax.plot(speeds, [c.tuned.median for c in row], "o-", color=colour, ms=3, label=f"wind {wind:g}")
        ax.axhline(0.0, color="0.3", lw=0.8)
        ax.set_xlabel(f"speed [{SYSTEMS[name][1]}]")
        ax.set_ylabel("model's reduction of the error [%]")
        ax.set_title(name, loc="left", fontsize="medium", fontweight="bold")
        ax.legend(fontsize="small", frameon=False)
    figure.savefig(path, dpi=150)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--system", nargs="+", choices=sorted(SYSTEMS), default=["drone", "arm"])
    parser.add_argument("--seeds", type=int, default=100, help="flights a point")
    parser.add_argument(
        "--first", type=int, default=5000, help="first seed: away from those of training and tuning"
    )
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--quick", action="store_true", help="one point of the drone, two short flights")
    options = parser.parse_args()
    seeds = range(options.first, options.first + (2 if options.quick else options.seeds))
    cells: dict[str, list[Cell]] = {}
    for name in options.system[:1] if options.quick else options.system:
        fly, unit, speeds, winds, seconds = SYSTEMS[name]
        if options.quick:
            speeds, winds, seconds = speeds[1:2], winds[:1], 9.0
        print(f"{name}: {len(seeds)} flights a point")
        print(
            f"{unit:>6} {'wind':>5}   {'same filter and gains':27}   {'observer as tuned':27}   own part   foretold"
        )
        cells[name] = []
        for wind in winds:
            for speed in speeds:
                cell = fly(speed, wind, seeds, seconds)
                cells[name].append(cell)
                figures = f"{said(cell.same)}   {said(cell.tuned)}   {cell.own:8.1f}   {cell.foretold:8.1f}"
                print(f"{speed:6.1f} {wind:5.1f}   {figures}", flush=True)
    if options.picture:
        draw(cells, options.picture)
    if options.json:
        options.json.write_text(
            json.dumps({name: [c._asdict() for c in found] for name, found in cells.items()}, default=vars)
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
