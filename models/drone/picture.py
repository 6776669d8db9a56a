"""The picture of the comparison, after the paper's Fig. 4 and Fig. S1."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from phyfilter_ctl.plots import PAGE, dress, letter_panels, typeset

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
# Every so many samples are drawn.
_EVERY = 10
_LETTERS = "x-small"


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
    figure = Figure(figsize=(PAGE, 8.4), layout="constrained")
    # Rows of their own: the long labels of one do not squeeze the others.
    rows = figure.add_gridspec(3, 1, height_ratios=[1.0, 1.1, 0.9])
    top, middle, bottom = (figure.add_subfigure(rows[k]) for k in range(3))
    circle, still, windy = top.subplots(1, 3, width_ratios=[1.1, 1.0, 1.0])
    _circle(circle, comparison, flown)
    _errors(still, {name: comparison.still[name] for name in flown}, "Unknown mass, still air")
    _errors(windy, {name: comparison.shown[name] for name in flown}, "Unknown mass, wind")
    highest = max(axes.get_ylim()[1] for axes in (still, windy))
    for axes in (still, windy):
        axes.set_ylim(0.0, highest)
    errors, parts = middle.subplots(1, 2, width_ratios=[1.5, 1.0])
    _mean_errors(errors, comparison)
    _parts(parts, comparison)
    for axes, name in zip(
        bottom.subplots(1, len(estimators), sharey=True, squeeze=False)[0], estimators, strict=True
    ):
        _estimate(axes, comparison.shown[name], name)
    still.legend(fontsize=_LETTERS, frameon=False, loc="center right")
    handles, labels = bottom.axes[0].get_legend_handles_labels()
    bottom.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=_LETTERS, frameon=False)
    mission = comparison.mission
    figure.suptitle(
        f"A circle of {mission.radius:g} m at {mission.speed:g} m/s with an unknown mass, in the wind of a fan: "
        f"{len(comparison.seeds)} simulated flights a method",
        fontsize=_LETTERS,
    )
    letter_panels(figure)
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
        fontsize=_LETTERS,
        va="center",
        arrowprops={"arrowstyle": "->", "color": "0.4"},
    )
    for name in names:
        flights = comparison.shown[name]
        r = flights.signals["r"][0, flights.counted][::_EVERY]
        axes.plot(r[:, 0], r[:, 1], color=COLOURS[name], lw=0.8)
    reference = comparison.shown[names[0]].signals["r_ref"][0, ::_EVERY]
    axes.plot(reference[:, 0], reference[:, 1], color="k", lw=0.8, ls="--", label="reference")
    axes.set(xlabel="x [m]", ylabel="y [m]", xlim=(-edge, edge), ylim=(-edge, edge), aspect="equal")
    axes.legend(fontsize=_LETTERS, frameon=False, loc="center")
    dress(axes, "From above, in the wind")


def _errors(axes: Axes, flights: dict[MethodName, Flights], title: str) -> None:
    for name, flown in flights.items():
        e = np.linalg.norm(flown.signals["r"][0] - flown.signals["r_ref"][0], axis=1)
        axes.plot(flown.time[::_EVERY], e[::_EVERY], color=COLOURS[name], lw=0.9, label=NAMES[name])
    axes.axvspan(0.0, params().mission.left_out, color="0.95", lw=0, zorder=0)
    axes.set(xlabel="Time [s], start-up shaded", ylabel=typeset("Error |e| [m]"), ylim=(0.0, None))
    dress(axes, title)


def _mean_errors(axes: Axes, comparison: Comparison) -> None:
    """Dots with intervals: a logarithmic axis has no foot for bars to stand on."""
    names: list[MethodName] = list(comparison.methods)
    for scenario, marker, shift in zip(SCENARIOS, "os", (-0.14, 0.14), strict=True):
        mae = comparison.mae(scenario)
        for row, name in enumerate(names):
            low, median, high = (100.0 * v for v in (mae[name].low, mae[name].value, mae[name].high))
            axes.errorbar(
                median,
                row + shift,
                xerr=[[median - low], [high - median]],
                fmt=marker,
                color=COLOURS[name],
                mfc=COLOURS[name] if marker == "s" else "white",
                ms=4.5,
                lw=0.9,
                capsize=2,
            )
    for row, text in enumerate(
        [
            "still, wind",
            *(
                ", ".join(f"{100.0 * comparison.mae(scenario)[name].value:.1f}" for scenario in SCENARIOS)
                for name in names
            ),
        ]
    ):
        axes.annotate(
            text,
            (1.0, row - 1.0),
            (4, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            fontsize=_LETTERS,
            va="center",
        )
    for marker, face, label in (("o", "white", "still air"), ("s", "0.3", "wind")):
        axes.plot([], [], marker, color="0.3", mfc=face, ms=4.5, label=label)
    axes.set_yticks(range(len(names)), [typeset(NAMES[name]) for name in names])
    axes.set(xlabel=typeset("Mean |e| [cm], median with 95 % interval"), xscale="log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.legend(fontsize=_LETTERS, frameon=False, loc="upper left")
    dress(axes, "Mean error")


def _parts(axes: Axes, comparison: Comparison) -> None:
    names: list[MethodName] = [name for name in comparison.methods if ("wind", name) in comparison.estimation]
    for row, name in enumerate(names):
        estimation = comparison.estimation["wind", name]
        for marker, values, label in (
            ("o", estimation.force, "whole force"),
            ("s", estimation.mass_part, "mass: f_theta"),
            ("^", estimation.wind_part, "wind: f_hat - f_theta"),
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
                    label=typeset(label) if name == "seer" else None,
                )
    axes.set_yticks(range(len(names)), [typeset(NAMES[name]) for name in names])
    axes.set(xlabel="RMSE of the estimate [N]", xlim=(0.0, None))
    axes.invert_yaxis()
    axes.legend(fontsize=_LETTERS, frameon=False)
    dress(axes, "Errors of the estimates, wind")


def _estimate(axes: Axes, flights: Flights, name: MethodName) -> None:
    """The component along the fan's jet, where mass and wind both show."""
    t = flights.time[::_EVERY]
    signals = {key: values[0, ::_EVERY, 0] for key, values in flights.signals.items() if key.startswith("f_")}
    axes.plot(t, signals["f_mass"], color="0.55", lw=0.9, ls="--", label="true, mass part")
    axes.plot(t, signals["f_mass"] + signals["f_wind"], color="k", lw=0.9, label="true, with wind")
    axes.plot(t, signals["f_hat"], color=COLOURS[name], lw=0.9, alpha=0.85, label="estimate")
    end = flights.time[-1]
    axes.set(xlabel="Time [s]", ylabel="$f$ along the jet [N]", xlim=(max(0.0, end - 15.0), end))
    dress(axes, NAMES[name])
