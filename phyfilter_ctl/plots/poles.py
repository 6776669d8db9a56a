"""Poles and zeros in the s-plane or the z-plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ._planes import Box, ComplexArray, outside, s_grid, z_grid
from ._style import COLOURS, SMALL

__all__ = ["PoleSet", "pole_plot"]

# A zero more than so many times as far out as the farthest pole is drawn at the rim, with its value.
_FAR_ZERO = 2.0
# Poles nearer to z = 1 than this are shown enlarged: at fast sampling all of them crowd there.
_CROWDED = 0.35
# Poles nearer together than this share of the picture are one mark with a count.
_SAME_MARK = 1e-3
# One mark each for the first seven filters, for the next seven, ...
_MARKERS = (("poles", "x+1"), ("zeros of $F$", "osp"), ("zeros of $1-F$", "D^v"))


def _no_zeros() -> ComplexArray:
    return np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True)
class PoleSet:
    """Poles and zeros of one filter.

    Attributes
    ----------
    label : str
        Entry of the legend.
    poles, zeros : complex arrays
        Of F, in rad/s; of a sampled filter in the z-plane.
    error_zeros : complex array
        Of 1 - F.
    dt : float or None
        Sampling interval in s; None for a continuous filter.
    """

    label: str
    poles: ComplexArray
    zeros: ComplexArray = field(default_factory=_no_zeros)
    error_zeros: ComplexArray = field(default_factory=_no_zeros)
    dt: float | None = None


def pole_plot(sets: Sequence[PoleSet], *, ax: Axes | None = None) -> ct.ControlPlot:
    """Poles (crosses) and zeros (circles: of F, diamonds: of 1 - F) over lines of equal damping and frequency.

    A pole that stands several times is one cross with its count. Zeros far outside are drawn at the rim with their
    value. In the z-plane, poles that all crowd near z = 1 are shown enlarged.

    Parameters
    ----------
    sets : sequence of PoleSet
        All continuous or all sampled.
    ax : Axes, optional
        Where to draw; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``lines`` (m, 3): for each filter its poles, zeros of F and zeros of 1 - F, those in view first, then one line
        for each at the rim; ``axes`` (1, 1); ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If there is no set, one has no pole, or continuous and sampled ones are mixed.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> plot = pole_plot([PoleSet("n = 2", np.array([-3 + 4j, -3 - 4j]))])
    >>> plot.lines[0, 0][0].get_xdata().tolist()
    [-3.0, -3.0]
    >>> plt.close(plot.figure)
    """
    if not sets or not all(len(entry.poles) for entry in sets):
        raise ValueError("pole_plot: expected at least one set, each with a pole")
    sampled = [entry.dt is not None for entry in sets]
    if any(sampled) and not all(sampled):
        raise ValueError(
            "pole_plot: expected all filters continuous or all sampled, got both; draw s-plane and z-plane apart"
        )
    if ax is None:
        _, ax = plt.subplots(layout="constrained", figsize=(5.4, 4.6))
    box = _z_box(sets) if sampled[0] else _s_box(sets)
    _dress(ax, box, "$z$" if sampled[0] else None)
    if sampled[0]:
        steps = {entry.dt for entry in sets}
        z_grid(ax, box, steps.pop() if len(steps) == 1 else None)
    else:
        s_grid(ax, box)
    lines = np.empty((len(sets), 3), dtype=object)
    for i, entry in enumerate(sets):
        for j, roots in enumerate((entry.poles, entry.zeros, entry.error_zeros)):
            lines[i, j] = _marks(ax, np.asarray(roots, dtype=np.complex128), i, j, box)
    legend = _legend(ax, sets)
    axes = np.array([[ax]], dtype=object)
    return ct.ControlPlot(lines, axes, ax.figure, legend=legend)


# -- what is in view ------------------------------------------------------------------------------------------------


def _s_box(sets: Sequence[PoleSet]) -> Box:
    """Left, right, bottom, top: all poles and the zeros that are not far out, the imaginary axis, and some air."""
    reach = max(float(np.max(np.abs(entry.poles))) for entry in sets)
    seen: ComplexArray = np.concatenate([np.concatenate([e.poles, e.zeros, e.error_zeros]) for e in sets])
    seen = seen[np.abs(seen) <= _FAR_ZERO * reach]
    scale = max(float(np.max(np.abs(seen))), reach)
    left, right = float(np.min(seen.real)) - 0.25 * scale, max(float(np.max(seen.real)), 0.0) + 0.2 * scale
    height = max(1.2 * float(np.max(np.abs(seen.imag))), 0.42 * (right - left))
    return left, right, -height, height


def _z_box(sets: Sequence[PoleSet]) -> Box:
    reach = max(float(np.max(np.abs(entry.poles - 1.0))) for entry in sets)
    if reach > _CROWDED:
        return -1.15, 1.15, -1.15, 1.15
    return 1.0 - 1.35 * reach, 1.0 + 0.3 * reach, -0.825 * reach, 0.825 * reach


# -- marks ----------------------------------------------------------------------------------------------------------


def _marks(ax: Axes, roots: ComplexArray, i: int, j: int, box: Box) -> list[Line2D]:
    if not len(roots):
        return []
    out = outside(roots, box)
    inside = _mark(roots[~out], i, j)
    ax.add_line(inside)
    _counts(ax, roots[~out], COLOURS[i % len(COLOURS)], box)
    far: dict[complex, list[complex]] = {}
    for root in roots[out & (roots.imag >= 0.0)]:
        far.setdefault(_rim(root, box), []).append(root)
    return [inside, *(_far_marks(ax, spot, there, i, j) for spot, there in far.items())]


def _mark(roots: ComplexArray, i: int, j: int, *, label: str = "", colour: str | None = None) -> Line2D:
    """Later filters get larger marks, so that marks on the same place all show."""
    size = (8.0, 7.0, 5.5)[j]
    return Line2D(
        roots.real,
        roots.imag,
        linestyle="none",
        marker=_MARKERS[j][1][i // len(COLOURS) % 3],
        markersize=size + 2.5 * min(i, 3),
        markeredgewidth=1.8 if j == 0 else 1.3,
        markeredgecolor=colour or COLOURS[i % len(COLOURS)],
        markerfacecolor="none",
        label=label,
        zorder=3.0 - 0.1 * j,
    )


def _counts(ax: Axes, roots: ComplexArray, colour: str, box: Box) -> None:
    """The count beside marks that cover each other."""
    near = _SAME_MARK * (box[1] - box[0])
    left = list(roots)
    while left:
        first = left[0]
        same = [root for root in left if abs(root - first) <= near]
        left = [root for root in left if abs(root - first) > near]
        if len(same) > 1:
            ax.annotate(
                f"$\\times${len(same)}",
                (first.real, first.imag),
                xytext=(5, -12),
                textcoords="offset points",
                fontsize="x-small",
                color=colour,
            )


def _rim(root: complex, box: Box) -> complex:
    """Where the way from the middle of the picture to the root leaves it, rounded to a hundredth of the picture."""
    left, right, bottom, top = box
    middle = complex(0.5 * (left + right), 0.0)
    way = root - middle
    half = (0.47 * (right - left), 0.47 * (top - bottom))
    share = min(h / abs(w) if w else np.inf for h, w in zip(half, (way.real, way.imag), strict=True))
    grain = 0.01 * (right - left)
    shift = grain * complex(round(share * way.real / grain), round(share * way.imag / grain))
    return middle + shift


def _far_marks(ax: Axes, spot: complex, roots: Sequence[complex], i: int, j: int) -> Line2D:
    """One mark at the rim for all roots in that direction, and their values."""
    mark = _mark(np.array([spot]), i, j)
    ax.add_line(mark)
    values = ", ".join(_value(root) for root in sorted(roots, key=abs))
    leftwards = spot.real < 0.5 * sum(ax.get_xlim()) if spot.imag else roots[0].real < spot.real
    ax.annotate(
        f"\N{LEFTWARDS ARROW} {values}" if leftwards else f"{values} \N{RIGHTWARDS ARROW}",
        (spot.real, spot.imag),
        xytext=(-4 if leftwards else 4, 9 + 11 * i),
        textcoords="offset points",
        ha="left" if leftwards else "right",
        va="bottom",
        fontsize="x-small",
        color=COLOURS[i % len(COLOURS)],
    )
    return mark


def _value(root: complex) -> str:
    if abs(root.imag) <= 1e-9 * abs(root):
        return f"{root.real:.3g}".replace("-", "\N{MINUS SIGN}")
    return f"{root.real:.3g}\N{PLUS-MINUS SIGN}{root.imag:.3g}j".replace("-", "\N{MINUS SIGN}")


def _dress(ax: Axes, box: Box, variable: str | None) -> None:
    left, right, bottom, top = box
    ax.set(xlim=(left, right), ylim=(bottom, top))
    ax.set_aspect("equal", adjustable="box")
    ax.set_xlabel("Real part [rad/s]" if variable is None else f"Real part of {variable}", fontsize=SMALL)
    ax.set_ylabel(
        "Imaginary part [rad/s]" if variable is None else f"Imaginary part of {variable}", fontsize=SMALL
    )
    ax.tick_params(labelsize=SMALL)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=7, steps=[1, 2, 2.5, 5, 10]))


def _legend(ax: Axes, sets: Sequence[PoleSet]) -> Legend:
    """Above the axes, where it covers no mark: colours of the filters, then the marks that occur."""
    filters = [_mark(_no_zeros(), i, 0, label=entry.label) for i, entry in enumerate(sets)]
    for line in filters:
        line.set_markersize(7.0)
    present = (True, any(len(e.zeros) for e in sets), any(len(e.error_zeros) for e in sets))
    marks = [
        _mark(_no_zeros(), 0, j, label=name, colour="0.3")
        for j, (name, _) in enumerate(_MARKERS)
        if present[j]
    ]
    # A legend fills its columns one after another; filled up with blanks, the marks get a row of their own.
    columns = min(3, max(len(filters), len(marks)))
    rows = [filters[k : k + columns] for k in range(0, len(filters), columns)] + [marks]
    blank = Line2D([], [], linestyle="none", label=" ")
    handles = [row[k] if k < len(row) else blank for k in range(columns) for row in rows]
    return ax.legend(
        handles=handles,
        fontsize="x-small",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.4,
        frameon=False,
        ncols=columns,
        columnspacing=1.2,
        handletextpad=0.3,
    )
