"""The picture of the comparison, after the paper's Fig. 4 and Fig. S1."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phyfilter_ctl.plots import dress

from .comparison import SCENARIOS, Comparison
from .experiment import Flights
from .methods import NAMES, MethodName
from .params import params

__all__ = ["COLOURS", "draw"]

FloatArray = NDArray[np.float64]

# One colour a method in all panels (Wong, Nature Methods 8, 2011); PhyFilters are blues.
COLOURS: dict[str, str] = {
    "baseline": "#999999",
    "integral": "#E69F00",
    "seer": "#D55E00",
    "observer": "#009E73",
    "indi": "#CC79A7",
    "l1": "#8C6D31",
    "phyfilter": "#0072B2",
    "phyfilter_type2": "#56B4E9",
    "accelerometer": "#1B3A6B",
    "known_mass": "#222222",
}
# In the panels over time: the paper's three.
_FLOWN: tuple[MethodName, ...] = ("baseline", "seer", "phyfilter")
_ESTIMATORS: tuple[MethodName, ...] = ("observer", "seer", "phyfilter")
# Below the bars there is room for two short lines.
_LABELS: dict[str, str] = {
    "integral": "PD with\nintegral",
    "observer": "observer\n(f_theta = 0)",
    "phyfilter": "PhyFilter,\norder 1",
    "phyfilter_type2": "PhyFilter,\ntype 2",
    "accelerometer": "PhyFilter,\naccelerom.",
    "known_mass": "PD, told\nthe mass",
}
# Every so many samples are drawn.
_EVERY = 10


def draw(comparison: Comparison) -> Figure:
    """Draw the circle, errors over time and over all flights, and estimated beside true forces.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    flown: list[MethodName] = [name for name in _FLOWN if name in comparison.methods]
    estimators: list[MethodName] = [name for name in _ESTIMATORS if name in comparison.methods]
    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    # Rows of their own: the long labels of one do not squeeze the others.
    rows = figure.add_gridspec(3, 1, height_ratios=[1.15, 1.0, 1.0])
    top, middle, bottom = (figure.add_subfigure(rows[k]) for k in range(3))
    circle, still, windy = top.subplots(1, 3, width_ratios=[1.0, 1.1, 1.1])
    _circle(circle, comparison, flown)
    _errors(still, {name: comparison.still[name] for name in flown}, "b  Unknown mass, still air")
    _errors(windy, {name: comparison.shown[name] for name in flown}, "c  Unknown mass and unseen wind")
    highest = max(axes.get_ylim()[1] for axes in (still, windy))
    for axes in (still, windy):
        axes.set_ylim(0.0, highest)
    still.legend(fontsize="xx-small", frameon=False, loc="center right")
    bars, parts = middle.subplots(1, 2, width_ratios=[2.3, 1.0])
    _bars(bars, comparison)
    _parts(parts, comparison)
    for axes, name, letter in zip(
        bottom.subplots(1, len(estimators), sharey=True, squeeze=False)[0], estimators, "fgh", strict=False
    ):
        _estimate(axes, comparison.shown[name], name, letter)
    mission = comparison.mission
    figure.suptitle(
        f"A circle of {mission.radius:g} m at {mission.speed:g} m/s with an unknown mass, in the wind of a fan: "
        f"{len(comparison.seeds)} simulated flights a method",
        fontsize="medium",
    )
    return figure


def _circle(axes: Axes, comparison: Comparison, names: list[MethodName]) -> None:
    wind = params().wind
    edge = 1.7 * comparison.mission.radius
    axes.axhspan(
        wind.jet_offset - wind.jet_width, wind.jet_offset + wind.jet_width, color="#56B4E9", alpha=0.15, lw=0
    )
    axes.annotate(
        "fan",
        (-0.4 * edge, wind.jet_offset),
        (-0.97 * edge, wind.jet_offset),
        fontsize="x-small",
        va="center",
        arrowprops={"arrowstyle": "->", "color": "0.4"},
    )
    for name in names:
        flights = comparison.shown[name]
        r = flights.signals["r"][0, flights.counted][::_EVERY]
        axes.plot(r[:, 0], r[:, 1], color=COLOURS[name], lw=0.8, label=NAMES[name])
    reference = comparison.shown[names[0]].signals["r_ref"][0, ::_EVERY]
    axes.plot(reference[:, 0], reference[:, 1], color="k", lw=0.8, ls="--", label="reference")
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(-edge, edge), ylim=(-edge, edge), aspect="equal")
    axes.legend(fontsize="xx-small", frameon=False, loc="center")
    dress(axes, "a  From above, in the wind")


def _errors(axes: Axes, flights: dict[MethodName, Flights], title: str) -> None:
    for name, flown in flights.items():
        e = np.linalg.norm(flown.signals["r"][0] - flown.signals["r_ref"][0], axis=1)
        axes.plot(flown.time[::_EVERY], e[::_EVERY], color=COLOURS[name], lw=0.9, label=NAMES[name])
    axes.axvspan(0.0, params().mission.left_out, color="0.95", lw=0, zorder=0)
    axes.set(xlabel="Time [s]; start-up is shaded", ylabel="Error |e| [m]", ylim=(0.0, None))
    dress(axes, title)


def _bars(axes: Axes, comparison: Comparison) -> None:
    names: list[MethodName] = list(comparison.methods)
    for k, scenario in enumerate(SCENARIOS):
        hatch = "////" if scenario == "wind" else None
        mae = comparison.mae(scenario)
        values = np.array([100.0 * mae[name].median for name in names])
        spread = np.array(
            [[100.0 * (mae[n].median - mae[n].low), 100.0 * (mae[n].high - mae[n].median)] for n in names]
        ).T
        x = np.arange(len(names)) + 0.4 * k - 0.2
        axes.bar(
            x,
            values,
            0.38,
            color=[COLOURS[name] for name in names],
            alpha=0.45 if hatch is None else 0.9,
            hatch=hatch,
            edgecolor="white",
            lw=0,
            yerr=spread,
            error_kw={"lw": 0.8, "capsize": 2},
        )
        for at, value, over in zip(x, values, spread[1], strict=True):
            axes.annotate(
                f"{value:.1f}",
                (at, value + over),
                (0, 2),
                textcoords="offset points",
                fontsize=6,
                ha="center",
            )
    axes.set_xticks(np.arange(len(names)), [_LABELS.get(name, NAMES[name]) for name in names])
    axes.set_ylabel("Mean |e|, median of the flights [cm]")
    axes.set_yscale("log")
    dress(axes, "d  Mean error: plain in still air, hatched in the wind")
    axes.tick_params(axis="x", labelsize=6.5)


def _parts(axes: Axes, comparison: Comparison) -> None:
    names: list[MethodName] = [name for name in comparison.methods if ("wind", name) in comparison.estimation]
    for row, name in enumerate(names):
        estimation = comparison.estimation["wind", name]
        for marker, values, label in (
            ("o", estimation.force, "whole force"),
            ("s", estimation.mass_part, "mass part: f_theta"),
            ("^", estimation.wind_part, "wind part: f_hat - f_theta"),
        ):
            if values is not None:
                axes.plot(
                    np.median(values),
                    row,
                    marker,
                    color=COLOURS[name],
                    ms=5,
                    mfc=COLOURS[name] if marker == "o" else "none",
                    ls="none",
                    label=label if name == "seer" else None,
                )
    axes.set_yticks(range(len(names)), [NAMES[name] for name in names])
    axes.set(xlabel="RMSE of the estimate [N]", xlim=(0.0, None))
    axes.invert_yaxis()
    axes.legend(fontsize="xx-small", frameon=False)
    dress(axes, "e  Errors of the estimates in the wind")


def _estimate(axes: Axes, flights: Flights, name: MethodName, letter: str) -> None:
    """The component along the fan's jet, where mass and wind both show."""
    t = flights.time[::_EVERY]
    signals = {key: values[0, ::_EVERY, 0] for key, values in flights.signals.items() if key.startswith("f_")}
    axes.plot(t, signals["f_mass"], color="0.55", lw=0.9, ls="--", label="true, mass part")
    axes.plot(t, signals["f_mass"] + signals["f_wind"], color="k", lw=0.9, label="true, with wind")
    axes.plot(t, signals["f_hat"], color=COLOURS[name], lw=0.9, alpha=0.85, label="estimated")
    end = flights.time[-1]
    axes.set(xlabel="Time [s]", ylabel="f along the jet [N]", xlim=(max(0.0, end - 15.0), end))
    axes.legend(fontsize="xx-small", frameon=False, ncols=3, loc="upper center")
    dress(axes, f"{letter}  {NAMES[name]}")
