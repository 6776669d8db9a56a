"""Colours and sizes that all pictures share."""

from __future__ import annotations

from matplotlib.axes import Axes

# Wong, "Color blindness", Nature Methods 8 (2011): told apart in print and by every reader.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
SMALL = "small"


def dress(axes: Axes, title: str) -> None:
    """One panel of a page: a short title, small letters, a light grid, no box.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    title : str
        Such as "a  Training flights".
    """
    axes.set_title(title, loc="left", fontsize=SMALL, fontweight="bold")
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_fontsize(SMALL)
    axes.tick_params(labelsize="x-small")
    axes.grid(True, axis="y", color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
