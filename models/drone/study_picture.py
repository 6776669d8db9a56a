"""The study on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from phyfilter_ctl.plots import PAGE, dress, letter_panels, typeset

from .flights import Scenario
from .methods import NAMES
from .params import params
from .picture import COLOURS
from .study import Outcome, Study
from .study_points import MAPPED, AxisName
from .study_report import label

__all__ = ["draw"]

# Colours that differ in any kind of colour blindness (Wong, Nature Methods 8, 2011).
_FAMILIES = {
    "applied": "#0072B2",
    "collective": "#E69F00",
    "commanded": "#D55E00",
    "order 1": "#0072B2",
    "order 2": "#009E73",
    "order 3": "#CC79A7",
    "type 2": "#56B4E9",
    **COLOURS,
}
_LABELS: dict[AxisName, str] = {
    "g": "Bandwidth of the filter [rad/s]",
    "order": "Bandwidth of equal poles [rad/s]",
    "learned": "",
    "delay": "Delay nobody was told [ms]",
    "wind": "Factor on the wind",
    "mass": "Factor on the added mass",
    "map": "Bandwidth of the filter [rad/s]",
}
_STYLES: tuple[tuple[Scenario, str], ...] = (("wind", "-"), ("mass", "--"))
# Of the worst error that is drawn over the median of all: a diverged flight must not hide the others.
_TALLEST = 6.0


def draw(study: Study) -> Figure:
    """Draw every axis that was studied: medians with bands from quartile to quartile, margins, and maps of winners.

    Parameters
    ----------
    study : Study

    Returns
    -------
    matplotlib.figure.Figure
    """
    panels: list[tuple[AxisName, str]] = []
    for axis in study.axes:
        views = {"map": ("wind", "mass"), "g": ("error", "margin")}.get(axis, ("error",))
        panels.extend((axis, what) for what in views)
    rows = -(-len(panels) // 3)
    figure = Figure(figsize=(PAGE, 2.8 * rows + 0.5), layout="constrained")
    for k, (axis, what) in enumerate(panels):
        axes = figure.add_subplot(rows, 3, k + 1)
        if axis == "map":
            _map(axes, study, "wind" if what == "wind" else "mass")
        elif axis == "learned":
            _learned(axes, study.curves(axis))
        elif what == "margin":
            _margins(axes, study)
        else:
            _errors(axes, axis, study.curves(axis))
    figure.suptitle(
        typeset(f"Mean |e| on the circle: median of {len(study.grid.seeds)} flights a point ")
        + f"({len(study.grid.map_seeds)} on maps), bands from quartile to quartile;\n"
        "solid with wind, dashed with unknown mass only",
        fontsize="small",
    )
    letter_panels(figure)
    return figure


def _errors(axes: Axes, axis: AxisName, curves: Mapping[str, Sequence[Outcome]]) -> None:
    scale = 1e3 if axis == "delay" else 1.0
    shown = []
    for family, curve in curves.items():
        x = scale * np.array([outcome.point.value for outcome in curve])
        for scenario, style in _STYLES:
            if scenario not in curve[0].errors:
                continue
            spreads = [outcome.spread(scenario) for outcome in curve]
            low, median, high = (
                100.0 * np.array([getattr(s, part) for s in spreads]) for part in ("low", "median", "high")
            )
            colour = _FAMILIES[family]
            name = label(axis, family) if style == "-" else None
            axes.plot(x, median, style, color=colour, lw=1.1, marker="o", ms=2.5, label=name)
            axes.fill_between(x, low, high, color=colour, alpha=0.15, lw=0)
            shown.append(median)
    values = np.concatenate(shown)
    values = values[np.isfinite(values)]
    if len(values):
        axes.set_ylim(0.0, 1.1 * min(values.max(), _TALLEST * float(np.median(values))))
    if axis in ("g", "order"):
        axes.set_xscale("log")
    axes.set(xlabel=_LABELS[axis], ylabel=typeset("Mean |e| [cm]"))
    axes.legend(fontsize="x-small", frameon=False)
    titles = {
        "g": "Choice of $g$",
        "order": "Order and type",
        "delay": "Delay",
        "wind": "Wind",
        "mass": "Unknown mass",
    }
    dress(axes, titles[axis])


def _margins(axes: Axes, study: Study) -> None:
    for family, curve in study.curves("g").items():
        margins = [np.nan if outcome.margin is None else outcome.margin for outcome in curve]
        x = [outcome.point.value for outcome in curve]
        axes.semilogx(x, margins, "o-", color=_FAMILIES[family], lw=1.1, ms=2.5, label=family)
    if study.limits is not None:
        for known, where in study.limits.all.items():
            if known in _FAMILIES and np.isfinite(where):
                axes.plot(where, 0.0, "x", color=_FAMILIES[known], ms=7, mew=1.6, clip_on=False)
        axes.plot([], [], "kx", ms=6, label="observer breaks, motors as modelled")
    wanted = params().tuning.modulus_margin
    axes.axhline(wanted, color="0.5", lw=0.8, ls=":", label="asked for in tuning")
    axes.set(xlabel=_LABELS["g"], ylabel="Modulus margin", ylim=(0.0, None))
    axes.legend(fontsize="x-small", frameon=False, loc="lower left")
    dress(axes, "Margin by choice of $g$")


def _learned(axes: Axes, curves: Mapping[str, Sequence[Outcome]]) -> None:
    names = list(curves)
    bars: tuple[tuple[Scenario, str, float], ...] = (("mass", "#999999", -0.2), ("wind", "#0072B2", 0.2))
    for k, (scenario, colour, shift) in enumerate(bars):
        for i, name in enumerate(names):
            outcome = curves[name][0]
            if scenario not in outcome.errors:
                if k:
                    axes.text(i, 0.0, "margin\ntoo small", fontsize="x-small", ha="center", va="bottom")
                continue
            spread = outcome.spread(scenario)
            low, median, high = (100.0 * value for value in (spread.low, spread.median, spread.high))
            legend = {"mass": "unknown mass", "wind": "with wind"}[scenario] if i == 0 else None
            axes.bar(i + shift, median, 0.38, color=colour, label=legend)
            axes.errorbar(i + shift, median, [[median - low], [high - median]], color="k", lw=0.8)
    axes.set_xticks(
        range(len(names)),
        [label("learned", name) for name in names],
        rotation=25,
        ha="right",
        rotation_mode="anchor",
    )
    axes.set_ylabel(typeset("Mean |e| [cm]"))
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, "Learned filters")


def _map(axes: Axes, study: Study, scenario: Scenario) -> None:
    winners = study.winners(scenario)
    bandwidths, speeds = sorted({w for w, _ in winners}), sorted({speed for _, speed in winners})
    names: list[str] = list(MAPPED)
    number = np.array([[names.index(winners[w, v]) for w in bandwidths] for v in speeds])
    colours = [COLOURS[name] for name in MAPPED]
    axes.pcolormesh(
        number, cmap=ListedColormap(colours), vmin=-0.5, vmax=len(MAPPED) - 0.5, edgecolors="white", lw=1.0
    )
    medians = study.least(scenario)
    for i, v in enumerate(speeds):
        for j, w in enumerate(bandwidths):
            axes.text(
                j + 0.5,
                i + 0.5,
                f"{NAMES[winners[w, v]][0].upper()} {100.0 * medians[w, v]:.1f}",
                ha="center",
                va="center",
                fontsize="x-small",
                color="white",
            )
    radius = params().mission.radius
    axes.set_xticks(np.arange(len(bandwidths)) + 0.5, [f"{w:.2g}" for w in bandwidths])
    axes.set_yticks(np.arange(len(speeds)) + 0.5, [f"{v / radius:.2f}" for v in speeds])
    axes.set(xlabel=_LABELS["map"], ylabel="Circle [rad/s]")
    handles = [Patch(color=colour, label=NAMES[name]) for colour, name in zip(colours, MAPPED, strict=True)]
    axes.legend(
        handles=handles,
        fontsize="x-small",
        ncols=2,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.18),
        frameon=False,
    )
    dress(axes, f"Least error [cm], {'wind' if scenario == 'wind' else 'unknown mass'}")
