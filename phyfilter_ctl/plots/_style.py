"""Colours, lines, letters and sizes that all pictures share."""

from __future__ import annotations

import re
from typing import TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import Locator

# Wong, "Color blindness", Nature Methods 8 (2011): told apart in print and by every reader.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
LINES = ("-", "--", "-.", ":", (0, (1, 1)), (0, (6, 1)), (0, (3, 1, 1, 1)))
MARKERS = ("", "o", "s", "^", "D", "v", "x")
SMALL = "small"
# Width in inches of a page with several panels: its smallest letters have 8 pixels where it is shown 736 px wide.
PAGE = 8.4

_MATHEMATICS = {
    r"\b([fF])_hat\b": r"$\\hat \1$",
    r"\bf_theta\b": r"$f_\\theta$",
    r"\ba(\d)\b": r"$a_\1$",
    r"\|gamma\^\((\d)\)\|": r"$|\\gamma^{(\1)}|$",
    r"\|nu\|": r"$|\\nu|$",
    r"\|e\|": "$|e|$",
    r"\^(\d)": r"$^\1$",
}


class LineStyle(TypedDict):
    """Colour and dashes of a curve, as keywords of ``plot``."""

    color: str
    linestyle: str | tuple[int, tuple[int, ...]]


def line_style(k: int) -> LineStyle:
    """Of the k-th of several curves: 49 that differ, the first seven in colour and dashes alike.

    Parameters
    ----------
    k : int
        From 0.
    """
    return {
        "color": COLOURS[k % len(COLOURS)],
        "linestyle": LINES[(k + k // len(COLOURS)) % len(LINES)],
    }


def typeset(text: str) -> str:
    """A text with ``f_hat``, ``f_theta``, ``a0``, ``|e|`` and powers as mathematics, for labels.

    Parameters
    ----------
    text : str

    Examples
    --------
    >>> typeset("f_hat in m/s^2")
    '$\\\\hat f$ in m/s$^2$'
    """
    for words, mathematics in _MATHEMATICS.items():
        text = re.sub(words, mathematics, text)
    return text


def entitle(axes: Axes, text: str) -> None:
    """A short bold title at the left."""
    axes.set_title(text, loc="left", fontsize=SMALL, fontweight="bold")


def dress(axes: Axes, title: str) -> None:
    """One panel of a page: a short title, small letters, a light grid, no box.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    title : str
        Such as "Training flights"; :func:`letter_panels` puts the letter before it.
    """
    entitle(axes, typeset(title))
    for label in (axes.xaxis.label, axes.yaxis.label):
        label.set_fontsize(SMALL)
    axes.tick_params(which="both", labelsize="x-small")
    axes.grid(True, axis="y", color="0.92", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        if side in axes.spines:
            axes.spines[side].set_visible(False)


def letter_panels(figure: Figure) -> None:
    """Put a, b, c, ... before the titles of panels, row after row from left to right.

    Panels whose tops differ by less than a twentieth of the page stand in one row. One without a title, or alone on
    its page, gets no letter.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    """
    titled = [axes for axes in figure.axes if axes.get_title(loc="left")]
    if len(titled) < 2:
        return
    rows: list[list[Axes]] = []
    for axes in sorted(titled, key=lambda each: -each.bbox.y1):
        if rows and rows[-1][0].bbox.y1 - axes.bbox.y1 < 0.05 * figure.bbox.height:
            rows[-1].append(axes)
        else:
            rows.append([axes])
    ordered = [axes for row in rows for axes in sorted(row, key=lambda each: each.bbox.x0)]
    for letter, axes in zip("abcdefghijklmnopqrstuvwxyz", ordered, strict=False):
        entitle(axes, f"{letter}  {axes.get_title(loc='left')}")


class PhaseLocator(Locator):
    """Ticks of a phase in degrees: multiples of 45, over many turns of 90, 180, ..., in a narrow range of 15 or 5."""

    def tick_values(self, vmin: float, vmax: float) -> list[float]:
        """Ticks between two phases.

        Parameters
        ----------
        vmin, vmax : float
            deg.
        """
        low, high = sorted((vmin, vmax))
        span = high - low
        wide = 45.0 * 2.0 ** max(0.0, np.ceil(np.log2(max(span, 1.0) / (7.0 * 45.0))))
        step = 5.0 if span <= 20.0 else 15.0 if span <= 60.0 else wide
        return (step * np.arange(np.ceil(low / step), np.floor(high / step) + 1.0)).tolist()

    def __call__(self) -> list[float]:
        assert self.axis is not None
        return self.tick_values(*self.axis.get_view_interval())
