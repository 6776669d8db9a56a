"""The picture of the comparison, after the paper's Fig. 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter
from numpy.typing import NDArray

from phyfilter_ctl import Status
from phyfilter_ctl.plots import PAGE, dress, letter_panels
from phyfilter_ctl.recording import Recording

from .differentiator import counted, labels
from .experiment import Comparison
from .learning import Convergence, Descent
from .study import IntervalStudy, PoleMap

__all__ = ["COLOURS", "NAMES", "draw"]

FloatArray = NDArray[np.float64]

NAMES = {
    "network": "network",
    "phyfilter_1": "PhyFilter, n = 1",
    "phyfilter_2": "PhyFilter, n = 2",
    "phyfilter_3": "PhyFilter, n = 3",
    "difference": "difference",
    "tracking_differentiator": "tracking differentiator",
    "robust_differentiator": "robust differentiator",
    "kalman": "Kalman",
    "lowpass": "low-pass",
    "learned": "learned filter",
    "learned_axes": "learned, by axis",
    "fir": "FIR",
    "fir_axes": "FIR, by axis",
    "network_after": "learned, then network",
}
# One colour a method in all panels (Wong, Nature Methods 8, 2011); the filters are blues, learning is vermilion.
COLOURS = {
    "network": "#D55E00",
    "phyfilter_1": "#56B4E9",
    "phyfilter_2": "#0072B2",
    "phyfilter_3": "#00306B",
    "difference": "#999999",
    "tracking_differentiator": "#009E73",
    "robust_differentiator": "#CC79A7",
    "kalman": "#E69F00",
    "lowpass": "#555555",
    "learned": "#F0E442",
    "learned_axes": "#B5A800",
    "fir": "#8B5A2B",
    "fir_axes": "#C49A6C",
    "network_after": "#FF9E7A",
}
_ORDER_COLOURS = {
    1: COLOURS["phyfilter_1"],
    2: COLOURS["phyfilter_2"],
    3: COLOURS["phyfilter_3"],
    4: "#999999",
    5: "#CC79A7",
}
_AXIS_COLOURS = ("#0072B2", "#D55E00", "#009E73")
_TRAIN, _TEST = "#0072B2", "#D55E00"


def draw(
    comparison: Comparison,
    *,
    poles: PoleMap | None = None,
    intervals: IntervalStudy | None = None,
    convergence: Convergence | None = None,
) -> Figure:
    """Draw velocities, errors, the distribution of speeds and, where they were made, the studies.

    Parameters
    ----------
    comparison : Comparison
    poles : PoleMap, optional
    intervals : IntervalStudy, optional
    convergence : Convergence, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows = 2 + (poles is not None or intervals is not None) + (convergence is not None)
    figure = Figure(figsize=(PAGE, 2.7 * rows + 0.5), layout="constrained")
    layout = figure.add_gridspec(rows, 6)
    top = max(log.speed(100.0) for log in (*comparison.train, *comparison.test))
    _velocities(figure.add_subplot(layout[0, :2]), comparison.train, "Training flights", top)
    _velocities(figure.add_subplot(layout[0, 2:4]), comparison.test, "Test flights", top)
    _speeds(figure.add_subplot(layout[0, 4:]), comparison)
    left, right = figure.add_subplot(layout[1, :3]), figure.add_subplot(layout[1, 3:])
    _errors(left, comparison.train_estimates, comparison.train, comparison.train_rmse, "Errors in training")
    _errors(right, comparison.test_estimates, comparison.test, comparison.test_rmse, "Errors in the test")
    highest = max(left.get_ylim()[1], right.get_ylim()[1])
    for axes in (left, right):
        axes.set_ylim(0.0, highest)
    if poles is not None:
        _pole_map(figure.add_subplot(layout[2, :3]), poles, comparison.test_rmse["network"])
    if intervals is not None:
        _interval_study(figure.add_subplot(layout[2, 3:]), intervals)
    if convergence is not None:
        _convergence(figure.add_subplot(layout[-1, :3]), figure.add_subplot(layout[-1, 3:]), convergence)
    figure.suptitle(
        f"Acceleration from velocity: {comparison.data} flights, {sum(log.n for log in comparison.train)} training and "
        f"{sum(log.n for log in comparison.test)} test samples every {1e3 * comparison.dt:.3g} ms",
        fontsize="small",
    )
    letter_panels(figure)
    return figure


def _velocities(axes: Axes, logs: Sequence[Recording], title: str, top: float) -> None:
    begin = 0.0
    for k, log in enumerate(logs):
        t = begin + log.times - log.times[0]
        for i, (name, colour) in enumerate(zip(log.channels, _AXIS_COLOURS, strict=False)):
            axes.plot(t, log.x[:, i], color=colour, linewidth=0.8, label=name if k == 0 else None)
        if k:
            axes.axvline(begin, color="0.8", linewidth=0.6, zorder=0)
        begin = float(t[-1])
    axes.set(xlabel="Time, flight after flight [s]", ylabel="Velocity [m/s]", ylim=(-1.1 * top, 1.1 * top))
    axes.legend(
        fontsize="x-small", ncols=3, loc="lower center", frameon=False, columnspacing=0.8, handlelength=1.2
    )
    dress(axes, title)


def _errors(
    axes: Axes,
    estimates: Mapping[str, Sequence[FloatArray]],
    logs: Sequence[Recording],
    scores: Mapping[str, float],
    title: str,
) -> None:
    """Boxes from the 25th to the 75th percentile of |error|, whiskers to the 5th and 95th; diamonds are the RMSE."""
    names = list(estimates)
    errors = [
        np.concatenate(
            [
                np.abs(e - labels(log))[counted(log)].ravel()
                for e, log in zip(estimates[name], logs, strict=True)
            ]
        )
        for name in names
    ]
    boxes = axes.boxplot(
        errors,
        whis=(5.0, 95.0),
        showfliers=False,
        patch_artist=True,
        widths=0.6,
        medianprops={"color": "white", "linewidth": 1.2},
    )
    for name, box in zip(names, boxes["boxes"], strict=True):
        box.set(facecolor=COLOURS[name], edgecolor=COLOURS[name])
    at = np.arange(1, len(names) + 1)
    axes.plot(at, [scores[name] for name in names], "D", color="black", markersize=4, label="RMSE")
    axes.set_xticks(at, [NAMES[name] for name in names], rotation=50, ha="right", rotation_mode="anchor")
    axes.set_ylabel("Absolute error [m/s$^2$]")
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, title)


def _speeds(axes: Axes, comparison: Comparison) -> None:
    sets = {"training": (comparison.train, _TRAIN), "test": (comparison.test, _TEST)}
    speeds = {
        name: np.concatenate([np.linalg.norm(log.x, axis=1) for log in logs])
        for name, (logs, _) in sets.items()
    }
    edges = np.linspace(0.0, max(float(values.max()) for values in speeds.values()), 31)
    for name, (_, colour) in sets.items():
        axes.hist(speeds[name], edges.tolist(), density=True, color=colour, alpha=0.55, label=name)
    axes.set(xlabel="Speed [m/s]", ylabel="Density [s/m]")
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, "Distribution of speeds")


def _pole_map(axes: Axes, poles: PoleMap, network: float) -> None:
    for n, scores in zip(poles.orders, poles.rmse, strict=True):
        axes.semilogx(poles.poles, scores, color=_ORDER_COLOURS[n], label=f"n = {n}, equal poles")
    for n, (pole, score) in poles.tuned.items():
        axes.plot(pole, score, "*", color=_ORDER_COLOURS[n], markersize=12, markeredgecolor="black")
    for point in poles.learned:
        axes.plot(
            point.pole,
            point.test_rmse,
            "o" if point.form == "lowpass" else "s",
            color=_ORDER_COLOURS[point.order],
            markersize=6,
            markeredgecolor="black",
        )
    for marker, name in (("*", "tuned"), ("o", "learned, low-pass"), ("s", "learned, general")):
        axes.plot([], [], marker, color="white", markeredgecolor="black", markersize=7, label=name)
    axes.axhline(network, color=COLOURS["network"], linestyle="--", linewidth=1.0, label="network")
    axes.set(xlabel="Poles, geometric mean [rad/s]", ylabel="Test RMSE [m/s$^2$]")
    axes.set_ylim(0.0, 1.6 * max(network, float(np.median(poles.rmse))))
    axes.legend(fontsize="x-small", ncols=2, facecolor="white", edgecolor="none", framealpha=0.9)
    dress(axes, "Order and poles")


def _convergence(left: Axes, right: Axes, convergence: Convergence) -> None:
    """Wall time against the least RMSE so far, from the same starts, on the same axes."""
    ways = (
        (left, convergence.learned, "Learning: Gauss-Newton"),
        (right, convergence.adam, "The paper's Algorithm 2: Adam on the coefficients"),
    )
    descents = (*convergence.learned, *convergence.adam)
    # Every curve begins at its start, drawn at the left edge: 0 is not on the axis.
    edge = 0.5 * min((float(d.times[0]) for d in descents if len(d.times)), default=1.0)
    for axes, found, title in ways:
        for descent in found:
            _way_down(axes, descent, edge)
        for n, rate in convergence.rates.items():
            name = f"n = {n}" if axes is left else f"n = {n}, rate {rate:g}"
            axes.plot([], [], color=_ORDER_COLOURS[n], label=name)
        axes.set(xlabel="Wall time [s]", ylabel="Training RMSE [m/s$^2$]", xscale="log", yscale="log")
        axes.legend(fontsize="x-small", frameon=False, ncols=2)
        dress(axes, title)
    latest = max((float(d.times[-1]) for d in descents if len(d.times)), default=1.0)
    levels = [level for d in descents for level in (d.start, *d.rmse)]
    for axes in (left, right):
        axes.set(xlim=(edge, 1.3 * latest), ylim=(0.9 * min(levels), 1.5 * max(levels)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0)))


def _way_down(axes: Axes, descent: Descent, edge: float) -> None:
    """A cross at the end marks a descent that left the stable region."""
    colour = _ORDER_COLOURS[descent.order]
    times = np.concatenate([[edge], descent.times])
    scores = np.concatenate([[descent.start], descent.rmse])
    axes.plot(times, scores, color=colour, linewidth=1.0, drawstyle="steps-post")
    marker = "x" if descent.status is Status.DIVERGED else "."
    axes.plot(times[-1], scores[-1], marker, color=colour, markersize=6)


def _interval_study(axes: Axes, intervals: IntervalStudy) -> None:
    for name, scores in intervals.rmse.items():
        style = "s--" if name == "network" else "o-"
        axes.plot(1e3 * intervals.dt, scores, style, color=COLOURS[name], markersize=4, label=NAMES[name])
    axes.set(xlabel="Sampling interval [ms]", ylabel="Test RMSE [m/s$^2$]")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, "Sampling interval")
