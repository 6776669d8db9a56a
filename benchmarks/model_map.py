"""Where a learned model pays: drone and arm flown with it and without it, over speed and wind.

    python benchmarks/model_map.py [--system drone arm] [--seeds 100] [--picture FILE] [--json FILE] [--quick]

Drone: circles of other speeds, SEER-I trained for it flying along. Arm: hover while the arm turns on the paper's path.
By how much the model lowers the mean error, in per cent, paired flight by flight: median and its 95 % interval, "0"
where it holds 0; against the same filter and gains without the model, and against the observer as tuned without one.
Then, for the same filter, only what the estimate is to blame for: rms of the position error that f - f_hat of the
flights leads to (of the arm: force and torque, horizontally), as it was and as :func:`model_value` foretells it from
the flights with the model alone, without labels. Positive: the model pays. Nothing is tuned here; the methods are those
of the models' own studies.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import control as ct
import matplotlib
import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl import models
from phyfilter_ctl.plots import COLOURS, dress, letter_panels
from phyfilter_ctl.results import Interval
from phyfilter_ctl.study import reduction

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


@dataclass(frozen=True, eq=False)
class Estimated:
    """Signals (B, N, k) of an estimate in some flights, and what makes a position error of f - f_hat."""

    x: Array
    g: Array
    f: Array
    f_hat: Array
    f_theta: Array | None
    compliance: ct.TransferFunction

    def taken(self, channels: Sequence[int], over: Array) -> Estimated:
        """Some channels, over a mass or inertia each."""
        names = [name for name in ("x", "g", "f", "f_hat", "f_theta") if getattr(self, name) is not None]
        return replace(self, **{name: getattr(self, name)[:, :, channels] / over for name in names})

    def position(self, dt: float) -> Array:
        """That f - f_hat leads to, in the flights the forecast is made of."""
        missed = (self.f - self.f_hat)[:FORETOLD]
        rows = np.moveaxis(missed, 1, 2).reshape(-1, missed.shape[1])
        system, time = ct.ss(self.compliance), dt * np.arange(rows.shape[1])
        return np.array([ct.forced_response(system, time, row.tolist()).outputs for row in rows])

    def foretold(self, filter: pf.PhyFilter, dt: float) -> Array:
        """Squares of the rms position error, with the model and without it."""
        assert self.f_theta is not None
        logs = [
            pf.Recording.from_arrays(x=x, g=g, f_theta=theta, dt=dt)
            for x, g, theta in zip(self.x, self.g, self.f_theta[:FORETOLD], strict=False)
        ]
        found = pf.model_value(logs, filter, orders=(1,), g="average")
        return np.square(found.through(self.compliance))


def shares(
    with_model: Sequence[Estimated], without: Sequence[Estimated], filters: Sequence[pf.PhyFilter], dt: float
) -> tuple[float, float]:
    """By how much the model lowers what the estimates are to blame for, as flown and foretold.

    One entry for force and one for torque, whose errors are taken for independent when foretold.
    """
    flown = []
    for parts in (with_model, without):
        positions = np.sum([each.position(dt) for each in parts], axis=0)
        flown.append(float(np.sqrt(np.mean(positions[:, positions.shape[1] // 4 :] ** 2))))
    told = [each.foretold(filter, dt) for each, filter in zip(with_model, filters, strict=True)]
    squares = np.sum(told, axis=0)
    return less(flown[0], flown[1]), less(*np.sqrt(squares).tolist())


def drone(speed: float, wind: float, seeds: Sequence[int], seconds: float) -> Cell:
    """Circles at a speed in m/s, wind as a share of the study's."""
    flights, experiment = part("drone", "flights"), part("drone", "experiment")
    tuned, model = part("drone", "tuning").tuned(), part("drone", "training").train().model
    known = part("drone", "params").params()
    methods = [tuned["phyfilter"].method, tuned["observer"].method]
    methods.insert(1, replace(methods[0], with_model=False))
    kp, kd, _ = methods[0].gains
    compliance = ct.TransferFunction([1.0 / known.vehicle.mass], [1.0, kd, kp])
    errors: list[list[Array]] = [[], [], []]
    forces: list[list[Estimated]] = [[], []]
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
                got = {name: signal[:, flown.counted] for name, signal in flown.signals.items()}
                momentum, force = known.vehicle.mass * got["v_m"], got["f_mass"] + got["f_wind"]
                theta = got.get("f_theta")
                forces[i].append(Estimated(momentum, got["g"], force, got["f_hat"], theta, compliance))
    ours, same, other = (np.concatenate(each) for each in errors)
    filters = [part("drone", "methods").filter_of(methods[0])]
    found = shares(forces[0], forces[1], filters, known.sampling.dt)
    return Cell(speed, wind, reduction(ours, same), reduction(ours, other), *found)


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
    parts: list[list[Estimated]] = [[], []]
    counted = goals.time >= 0.3 * seconds
    for k in range(0, len(seeds), CHUNK):
        for i, method in enumerate(methods):
            more = (*experiment.ESTIMATED, "f_hat", "tau_hat") if i < 2 and k == 0 else ()
            flown = experiment.fly(
                method,
                seeds[k : k + CHUNK],
                seer if method.uses_seer else None,
                goals=goals,
                keep=("r_e", *more, *(("f_theta", "tau_theta") if more and i == 0 else ())),
                others=others,
            )
            error = flown.error()
            fell = ~np.isfinite(error).all(axis=1)
            errors[i].append(np.where(fell, np.inf, error[:, counted].mean(axis=1)))
            if more:
                parts[i] = horizontal(
                    {name: signal[:, counted] for name, signal in flown.signals.items()}, methods[0]
                )
    ours, same, other = (np.concatenate(each) for each in errors)
    filters = [methods[0].force_filter(), methods[0].torque_filter()]
    return Cell(
        rate,
        wind,
        reduction(ours, same),
        reduction(ours, other),
        *shares(parts[0], parts[1], filters, known.sampling.dt),
    )


def horizontal(signals: dict[str, Array], method: Any) -> list[Estimated]:
    """Force and torque of the arm, by their answers in x and y: a torque tilts the thrust, which carries the weight."""
    vehicle = part("aerial_manipulator", "vehicle")
    mass, inertia = vehicle.nominal().mass, np.array(vehicle.nominal().J)
    gravity = part("aerial_manipulator", "params").params().vehicle.gravity
    kp, kd = (method.gains[name][0] for name in ("kp", "kd"))
    moved = ct.TransferFunction([1.0], [1.0, kd, kp])
    tilted = ct.TransferFunction([gravity], [1.0, method.attitude.kw[0], method.attitude.kR[0]])
    # About y and -x.
    level = inertia[[1, 0]] * np.array([1.0, -1.0])
    force, torque = part("aerial_manipulator", "experiment").unknown(signals)
    linear = Estimated(force.x, force.g, force.f, signals["f_hat"], signals.get("f_theta"), moved)
    angular = Estimated(
        torque.x, torque.g, torque.f, signals["tau_hat"], signals.get("tau_theta"), moved * tilted
    )
    return [linear.taken([0, 1], np.array([mass, mass])), angular.taken([1, 0], level)]


SYSTEMS = {
    "drone": (drone, "m/s", (1.0, 2.0, 3.0, 3.75), (0.0, 0.5, 1.0), 18.0),
    "arm": (arm, "rad/s", (1.5, 2.5, 3.5, 5.0, 6.5), (0.0, 1.0), 20.0),
}


def said(found: Interval) -> str:
    sure = "" if found.low > 0.0 or found.high < 0.0 else "  0"
    return f"{found.value:7.1f} [{found.low:6.1f}, {found.high:6.1f}]{sure:3}"


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
            ax.plot(speeds, [c.tuned.value for c in row], "o-", color=colour, ms=3, label=f"wind {wind:g}")
        ax.axhline(0.0, color="0.3", lw=0.8)
        ax.set_xlabel(f"Speed [{SYSTEMS[name][1]}]")
        ax.set_ylabel("Reduction of the error by the model [%]")
        ax.legend(fontsize="x-small", frameon=False)
        dress(ax, name)
    letter_panels(figure)
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
            f"{unit:>6} {'wind':>5}   {'same filter and gains':27}   {'observer as tuned':27}   own part  predicted"
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
