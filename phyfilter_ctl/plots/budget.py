"""What an error is made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.container import BarContainer
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ._style import COLOURS, SMALL, line_style
from ._units import Units

__all__ = ["budget_curves", "budget_plot"]

FloatArray = NDArray[np.float64]

_HATCHES = ("", "////", "....", "xxxx", "----", "||||", "++++")
_TOTAL = "sum"


def budget_plot(
    parts: Mapping[str, FloatArray], names: Sequence[str], *, label: str, ax: Axes | None = None
) -> ct.ControlPlot:
    """One stacked bar a design, with its total in figures.

    Parameters
    ----------
    parts : dict of str to (m,) array
        Parts of the error by name, 0 or more; they add up.
    names : sequence of str
        The m designs, from top to bottom.
    label : str
        What the error is, with its unit.
    ax : Axes, optional
        Where to draw; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``lines`` (1, 1): one container of m bars for each part; ``axes`` (1, 1); ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If there is no part, or parts and names differ in length.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> parts = {"residual": np.array([0.4, 0.2]), "noise": np.array([0.1, 0.2])}
    >>> plot = budget_plot(parts, ["slow", "fast"], label="Error [N]")
    >>> [round(float(bar.get_width()), 9) for bar in plot.lines[0, 0][1]]
    [0.1, 0.2]
    >>> plt.close(plot.figure)
    """
    total = _total(parts, len(names), "names")
    if ax is None:
        _, ax = plt.subplots(layout="constrained", figsize=(5.4, 1.0 + 0.42 * len(names)))
    places = np.arange(len(names))
    start = np.zeros(len(names))
    bars: list[BarContainer] = []
    for k, (name, values) in enumerate(parts.items()):
        bars.append(
            ax.barh(
                places,
                values,
                0.6,
                left=start,
                label=name,
                color=COLOURS[k % len(COLOURS)],
                hatch=_HATCHES[(k + k // len(COLOURS)) % len(_HATCHES)],
                edgecolor="white",
                linewidth=0.0,
            )
        )
        start = start + values
    for place, value in zip(places, total, strict=True):
        ax.annotate(
            f"{value:.3g}",
            (value, place),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize="x-small",
        )
    ax.set_yticks(places, list(names))
    ax.invert_yaxis()
    # Room for the figure behind the longest bar.
    ax.set_xlim(0.0, 1.12 * float(total.max()) or 1.0)
    ax.set_xlabel(label, fontsize=SMALL)
    ax.tick_params(labelsize=SMALL)
    ax.tick_params(axis="y", length=0)
    ax.grid(True, axis="x", color="0.88", linewidth=0.7)
    ax.set_axisbelow(True)
    lines = np.empty((1, 1), dtype=object)
    lines[0, 0] = bars
    return ct.ControlPlot(lines, np.array([[ax]], dtype=object), ax.figure, legend=_legend(ax, len(parts)))


def budget_curves(
    parts: Mapping[str, FloatArray],
    bandwidth: FloatArray,
    *,
    label: str,
    ax: Axes | None = None,
    Hz: bool | None = None,
) -> ct.ControlPlot:
    """Each part of the error and their sum over bandwidth, with the least sum marked.

    Parameters
    ----------
    parts : dict of str to (m,) array
        Parts of the error by name, 0 or more; they add up.
    bandwidth : (m,) array
        In rad/s, ascending.
    label : str
        What the error is, with its unit.
    ax : Axes, optional
        Where to draw; None makes a new figure.
    Hz : bool, optional
        Draw over Hz; None: python-control's setting ``freqplot.Hz``.

    Returns
    -------
    control.ControlPlot
        ``lines`` (1, 1): the sum, then each part, then the mark; ``axes`` (1, 1); ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If there is no part, or parts and bandwidth differ in length.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> w = np.array([5.0, 10.0, 20.0])
    >>> plot = budget_curves({"residual": 8.0 / w, "noise": 0.02 * w}, w, label="Error [N]")
    >>> plot.lines[0, 0][0].get_ydata().round(3).tolist()
    [1.7, 1.0, 0.8]
    >>> plt.close(plot.figure)
    """
    total = _total(parts, len(bandwidth), "bandwidth")
    if ax is None:
        _, ax = plt.subplots(layout="constrained", figsize=(5.4, 3.6))
    units = Units.chosen(Hz=Hz)
    bandwidth = bandwidth / units.per_frequency
    lines: list[Line2D] = ax.loglog(bandwidth, total, color="0.15", linewidth=1.8, label=_TOTAL)
    for k, (name, values) in enumerate(parts.items()):
        lines += ax.loglog(bandwidth, values, **line_style(k + 1), label=name)
    best = int(np.argmin(total))
    name = f"least sum: {total[best]:.3g} at {bandwidth[best]:.3g} {units.frequency_name}"
    lines += ax.plot(
        [bandwidth[best]], [total[best]], "o", color="0.15", markerfacecolor="white", markersize=6, label=name
    )
    ax.set_xlabel(f"Bandwidth [{units.frequency_name}]", fontsize=SMALL)
    ax.set_ylabel(label, fontsize=SMALL)
    ax.tick_params(which="both", labelsize=SMALL)
    ax.grid(True, which="major", color="0.88", linewidth=0.7)
    ax.margins(x=0.0)
    grid = np.empty((1, 1), dtype=object)
    grid[0, 0] = lines
    return ct.ControlPlot(grid, np.array([[ax]], dtype=object), ax.figure, legend=_legend(ax, len(parts) + 2))


def _total(parts: Mapping[str, FloatArray], expected: int, name: str) -> FloatArray:
    if not parts or any(np.shape(values) != (expected,) for values in parts.values()) or not expected:
        shapes = {part: np.shape(values) for part, values in parts.items()}
        raise ValueError(f"parts: expected at least one, each of shape ({expected},) as {name}, got {shapes}")
    return np.sum(list(parts.values()), axis=0)


def _legend(ax: Axes, entries: int) -> Legend:
    """Above the axes, where it covers nothing."""
    return ax.legend(
        fontsize="x-small",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.4,
        frameon=False,
        ncols=min(3, entries),
        columnspacing=1.2,
    )
