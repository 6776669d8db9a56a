"""The picture of the comparison, after the paper's panels e and f: the path of the end effector, and its errors."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from numpy.typing import NDArray

from phyfilter_ctl.plots import PAGE, dress, letter_panels, typeset

from .comparison import Comparison
from .methods import NAMES, MethodName
from .params import params
from .turning import PLACE, Turning

__all__ = ["COLOURS", "draw", "draw_turning"]

FloatArray = NDArray[np.float64]

# One colour a method in all panels (Wong, Nature Methods 8, 2011).
COLOURS: dict[MethodName, str] = {
    "baseline": "#999999",
    "integral": "#E69F00",
    "seer": "#D55E00",
    "observer": "#009E73",
    "phyfilter": "#0072B2",
}
# Along the ways: the paper's three.
_FLOWN: tuple[MethodName, ...] = ("baseline", "seer", "phyfilter")
# Every so many samples are drawn.
_EVERY = 10


def draw(comparison: Comparison) -> Figure:
    """Draw one mission, errors over time, and those of all missions.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    flown: list[MethodName] = [name for name in _FLOWN if name in comparison.methods]
    figure = Figure(figsize=(PAGE, 8.0), layout="constrained")
    top, bottom = np.asarray(figure.subfigures(2, 1, height_ratios=[1.25, 1.0])).tolist()
    sides = np.asarray(top.subfigures(1, 2, width_ratios=[1.15, 1.0]))
    left, right = sides.tolist()
    _ways(left.add_subplot(projection="3d"), comparison, flown)
    errors, near = right.subplots(2, 1, sharex=True)
    _errors(errors, comparison, list(comparison.methods), "Error of the end effector")
    close: list[MethodName] = [name for name in comparison.methods if name in ("observer", "phyfilter")]
    _errors(near, comparison, close or list(comparison.methods), "The same, nearer")
    windows, force, torque = bottom.subplots(1, 3)
    _windows(windows, comparison)
    shown: MethodName = "phyfilter" if "phyfilter" in comparison.methods else next(iter(comparison.methods))
    _estimate(force, comparison, shown, "f", 0, "Force along the jet")
    _estimate(torque, comparison, shown, "tau", 1, "Pitching torque")
    mission = params().mission
    figure.suptitle(
        f"Pick and place of {mission.payload:g} kg in a jet of {params().wind.jet_speed:g} m/s: "
        f"{len(comparison.seeds)} simulated missions a method, one of them shown",
        fontsize="small",
    )
    letter_panels(figure)
    return figure


def draw_turning(found: Turning) -> Figure:
    """Draw the errors of all methods over the arm's rate.

    Parameters
    ----------
    found : Turning

    Returns
    -------
    matplotlib.figure.Figure
    """
    cases = list(dict.fromkeys(case for case, _ in found.scores))
    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    for k, (name, colour) in enumerate(COLOURS.items()):
        errors = [found.scores.interval(case, name, "mean") for case in cases]
        middle = 100.0 * np.array([v.value for v in errors])
        spread = np.abs(100.0 * np.array([[v.low, v.high] for v in errors]).T - middle)
        x = np.arange(len(cases)) + 0.08 * (k - 2)
        axes.errorbar(
            x, middle, spread, fmt="o", ms=4, lw=0.8, capsize=2, color=colour, label=typeset(NAMES[name])
        )
    axes.set_xticks(range(len(cases)), [case if case == PLACE else f"{case} rad/s" for case in cases])
    axes.set(
        ylabel=typeset("Mean |e| of the end effector [cm]"), ylim=(0.0, None), xlim=(-0.5, len(cases) - 0.5)
    )
    axes.legend(fontsize="x-small", frameon=False)
    dress(
        axes,
        f"Hover in a jet of {params().wind.jet_speed:g} m/s while the arm turns: {len(found.seeds)} flights a method",
    )
    return figure


def _ways(axes: Axes3D, comparison: Comparison, names: list[MethodName]) -> None:
    for name in names:
        x, y, z = comparison.shown[name].signals["r_e"][0, ::_EVERY].T
        axes.plot(x, y, z, color=COLOURS[name], lw=0.9, label=typeset(NAMES[name]))
    goals = comparison.shown[names[0]].goals
    x, y, z = goals.end_effector[::_EVERY].T
    axes.plot(x, y, z, color="k", lw=0.8, ls="--", label="planned")
    for point, label in ((comparison.mission.pick, "pick"), (comparison.mission.place, "place")):
        axes.plot(*([value] for value in point), "o", color="k", ms=3)
        axes.text(*point, f" {label}", fontsize="x-small")
    axes.set_xlabel("x [m]", fontsize="small")
    axes.set_ylabel("y [m]", fontsize="small")
    axes.set_zlabel("z [m]", fontsize="small")
    axes.tick_params(labelsize="x-small")
    axes.set_box_aspect((1.4, 1.4, 0.8))
    axes.view_init(elev=28.0, azim=-62.0)
    axes.legend(fontsize="x-small", frameon=False, loc="upper right")
    axes.set_title("Path of the end effector", loc="left", fontsize="small", fontweight="bold")


def _errors(axes: Axes, comparison: Comparison, names: list[MethodName], title: str) -> None:
    mission = comparison.mission
    for name in names:
        flights = comparison.shown[name]
        axes.plot(
            flights.time[::_EVERY],
            100.0 * flights.error()[0, ::_EVERY],
            color=COLOURS[name],
            lw=0.8,
            label=typeset(NAMES[name]),
        )
    axes.axhline(100.0 * mission.tolerance, color="k", lw=0.7, ls=":")
    for begin, end in (mission.grasp, mission.settle):
        axes.axvspan(begin, end, color="#0072B2", alpha=0.12, lw=0)
    for at in (mission.load, mission.release):
        axes.axvline(at, color="0.5", lw=0.7, ls="--")
    axes.set(ylabel=typeset("|e| [cm]"), xlim=(0.0, mission.duration))
    axes.set_ylim(0.0, 1.45 * axes.get_ylim()[1])  # room for the legend
    axes.set_xlabel("Time [s]; windows shaded, load changes at the dashes")
    axes.legend(fontsize="x-small", frameon=False, ncols=2, loc="upper left")
    dress(axes, title)


def _windows(axes: Axes, comparison: Comparison) -> None:
    names: list[MethodName] = list(comparison.methods)
    rng = np.random.default_rng(0)
    for row, name in enumerate(names):
        score = comparison.scores["mission", name]
        for marker, values, label in (("o", score.grasp, "grasp"), ("^", score.settle, "place")):
            beside = row + (0.16 if marker == "^" else -0.16) + rng.uniform(-0.08, 0.08, len(values))
            axes.plot(
                100.0 * values,
                beside,
                marker,
                color=COLOURS[name],
                ms=3,
                mfc="none",
                mew=0.7,
                label=label if row == 0 else None,
            )
    axes.axvline(100.0 * comparison.mission.tolerance, color="k", lw=0.7, ls=":")
    axes.set_xscale("log")
    axes.set_yticks(
        range(len(names)),
        [typeset(NAMES[name]).replace(" with ", "\nwith ").replace(" (", "\n(") for name in names],
    )
    axes.set_xlabel(typeset("Largest |e| [cm], every mission"))
    axes.invert_yaxis()
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, "Windows")


def _estimate(
    axes: Axes, comparison: Comparison, name: MethodName, letter: str, axis: int, title: str
) -> None:
    from .features import trim_torque

    flights = comparison.shown[name]
    signals = {key: values[0, ::_EVERY, axis] for key, values in flights.signals.items() if values.ndim == 3}
    parts = [f"{letter}_coupling", f"{letter}_payload"] + (["f_wind"] if letter == "f" else [])
    true = sum(signals[part] for part in parts) - (0.0 if letter == "f" else trim_torque()[axis])
    t = flights.time[::_EVERY]
    axes.plot(t, true, color="k", lw=0.8, label="true")
    if f"{letter}_hat" in signals:
        axes.plot(t, signals[f"{letter}_hat"], color=COLOURS[name], lw=0.8, alpha=0.85, label="estimated")
    axes.set(xlabel="Time [s]", ylabel="Force [N]" if letter == "f" else "Torque [N m]", xlim=(0.0, t[-1]))
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, f"{title}, {NAMES[name]}")
