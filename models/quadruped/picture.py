"""The picture of the comparison, after the paper's Fig. 2."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from phyfilter_ctl.plots import PAGE, dress, letter_panels

from .comparison import Comparison
from .params import params

__all__ = ["COLOURS", "draw"]

FloatArray = NDArray[np.float64]

# One colour a method in all panels (Wong, Nature Methods 8, 2011); those with a filter are blues.
COLOURS: dict[str, str] = {
    "base": "#999999",
    "observer": "#009E73",
    "filter": "#0072B2",
    "off": "#D55E00",
    "improved": "#56B4E9",
    "basewide": "#CC79A7",
    "wide": "#222222",
    "early_base": "#999999",
    "early_observer": "#009E73",
    "early_filter": "#0072B2",
    "early_off": "#D55E00",
    "early_improved": "#56B4E9",
    "own": "#E69F00",
    "own_off": "#F0E442",
}
_SMALL = "x-small"


def draw(found: Comparison) -> Figure:
    """Draw training, payload, speed, terrains, weak motors and pushes, and a walk.

    Parameters
    ----------
    found : Comparison

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(PAGE, 7.0), layout="constrained")
    (a, b, c), (d, e, f) = figure.subplots(2, 3)
    _rewards(a, found)
    plan = found.plan
    _lines(b, found, "payload", 100.0 * np.array(plan.payloads))
    b.axhline(0.2, color="0.6", linestyle=":", linewidth=0.9)
    b.text(0.02, 0.21, "the paper: at most", fontsize=_SMALL, color="0.5", transform=b.get_yaxis_transform())
    b.set_xlabel("Payload [% of the weight]")
    dress(b, "Payload at 1 m/s")
    _lines(c, found, "speed", np.array(plan.speeds))
    low, high = params().randomisation.velocity
    c.axvspan(max(low, 0.0), high, color="0.95", zorder=-1)
    c.set_xlabel("Commanded speed [m/s], trained: grey")
    dress(c, "Speed")
    _terrains(d, found)
    _others(e, found)
    _walk(f, found)
    handles, labels = b.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    letter_panels(figure)
    return figure


def _rewards(axes: Axes, found: Comparison) -> None:
    step = params().control.dt * params().control.decimation
    for family, curves in found.curves.items():
        for curve in curves:
            points = 10.0 * np.arange(1, len(curve) + 1)
            axes.plot(
                points,
                np.array(curve) / step,
                color=COLOURS[family],
                linewidth=1.0,
                alpha=0.85,
            )
    axes.set_xlabel("Iteration")
    axes.set_ylabel("Reward per second")
    dress(axes, "Training, every policy")


def _lines(axes: Axes, found: Comparison, name: str, x: FloatArray) -> None:
    for method, score in found.scores.items():
        errors: FloatArray = getattr(score, name)
        by_policy = errors.mean(axis=2)
        axes.plot(
            x,
            by_policy.mean(axis=1),
            color=COLOURS[method],
            marker="o",
            markersize=3.5,
            label=found.methods[method].label,
        )
        axes.fill_between(
            x, by_policy.min(axis=1), by_policy.max(axis=1), color=COLOURS[method], alpha=0.12, linewidth=0.0
        )
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("Velocity error [m/s], band: policies")


def _bars(axes: Axes, found: Comparison, groups: list[str], values: dict[str, list[float]]) -> None:
    width = 0.8 / len(found.scores)
    for k, method in enumerate(found.scores):
        x = np.arange(len(groups)) + (k - 0.5 * (len(found.scores) - 1)) * width
        axes.bar(x, values[method], width=0.9 * width, color=COLOURS[method])
    axes.set_xticks(np.arange(len(groups)), groups)


def _terrains(axes: Axes, found: Comparison) -> None:
    kinds = list(found.plan.terrains)
    push = params().push
    values = {
        method: [100.0 * float(score.terrain[kind].mean()) for kind in kinds]
        + [100.0 * float(score.push.mean())]
        for method, score in found.scores.items()
    }
    _bars(axes, found, [*kinds, f"push\n{push.force:g} N"], values)
    axes.set_ylim(0.0, 105.0)
    axes.set_ylabel("Passed, or stood [%]")
    dress(axes, "Grounds and pushes never trained on")


def _others(axes: Axes, found: Comparison) -> None:
    weak = f"motors {100 * params().test.strength:.0f} %"
    groups = [weak, f"{weak},\n{100 * max(found.plan.payloads):.0f} % payload"]
    values = {m: score.strength.mean(axis=(1, 2)).tolist() for m, score in found.scores.items()}
    _bars(axes, found, groups, values)
    axes.set_ylabel("Velocity error [m/s]")
    dress(axes, "Weak motors at 1 m/s")


def _walk(axes: Axes, found: Comparison) -> None:
    """Forward speed under the heaviest payload, averaged over one gait period."""
    case = len(found.plan.payloads) - 1
    step = params().control.dt * params().control.decimation
    window = max(1, round(1.0 / (params().gait.frequency * step)))
    for method, score in found.scores.items():
        if method == "off":
            continue
        speed = score.trace.speed[:, case]
        smooth = np.convolve(speed, np.full(window, 1.0 / window), mode="valid")
        axes.plot(score.trace.time[window - 1 :], smooth, color=COLOURS[method], linewidth=1.1)
    axes.axhline(1.0, color="0.6", linestyle=":", linewidth=0.9)
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("Forward speed [m/s], one period")
    dress(axes, f"A walk with {100 * max(found.plan.payloads):.0f} % payload")
