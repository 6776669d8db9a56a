"""Frequency responses of filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ._style import COLOURS, SMALL

__all__ = ["FrequencyCurve", "frequency_plot"]


@dataclass(frozen=True)
class FrequencyCurve:
    """One filter of a frequency plot.

    Attributes
    ----------
    label : str
        Entry of the legend.
    omega : (N,) array
        Frequencies in rad/s.
    F, error : (N,) complex arrays
        F and 1 - F.
    phase : (N,) array
        Phase of F in rad, unwrapped.
    nyquist : float
        Nyquist frequency in rad/s; infinite for a continuous filter.
    """

    label: str
    omega: NDArray[np.float64]
    F: NDArray[np.complex128]
    error: NDArray[np.complex128]
    phase: NDArray[np.float64]
    nyquist: float = np.inf


def frequency_plot(curves: Sequence[FrequencyCurve], *, ax: Sequence[Axes] | None = None) -> ct.ControlPlot:
    """Magnitude of F (full) and 1 - F (dashed), and phase of F, over frequency, on one axis for all filters.

    Parameters
    ----------
    curves : sequence of FrequencyCurve
    ax : two Axes, optional
        Where to draw magnitude and phase; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``lines`` (2, 1): the magnitude lines (F and 1 - F of each filter in turn) and the phase lines; ``axes``
        (2, 1); ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If there is no curve, or ``ax`` does not hold two axes.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> omega = np.logspace(-1, 2)
    >>> F = 1.0 / (1.0 + 1j * omega)
    >>> plot = frequency_plot([FrequencyCurve("n = 1", omega, F, 1.0 - F, np.angle(F))])
    >>> plot.axes.shape
    (2, 1)
    >>> plt.close(plot.figure)
    """
    if not curves:
        raise ValueError("frequency_plot: expected at least one curve, got none")
    magnitude, phase = _two_axes(ax)
    lines: tuple[list[Line2D], list[Line2D]] = ([], [])
    for k, curve in enumerate(curves):
        colour = COLOURS[k % len(COLOURS)]
        lines[0].extend(magnitude.loglog(curve.omega, np.abs(curve.F), color=colour, label=curve.label))
        lines[0].extend(magnitude.loglog(curve.omega, np.abs(curve.error), color=colour, linestyle="--"))
        lines[1].extend(phase.semilogx(curve.omega, np.rad2deg(curve.phase), color=colour, label=curve.label))
    _mark_nyquist(curves, magnitude, phase)
    _dress(curves, magnitude, phase)
    legend = _legend(magnitude, lines[0][::2])
    grid = np.empty((2, 1), dtype=object)
    grid[:, 0] = lines
    axes = np.array([[magnitude], [phase]], dtype=object)
    return ct.ControlPlot(grid, axes, magnitude.figure, legend=legend)


def _two_axes(ax: Sequence[Axes] | None) -> tuple[Axes, Axes]:
    if ax is None:
        _, axes = plt.subplots(
            2, 1, sharex=True, layout="constrained", figsize=(5.4, 4.6), height_ratios=(3, 2), squeeze=False
        )
        return axes[0, 0], axes[1, 0]
    pair = np.ravel(np.asarray(ax, dtype=object))
    if len(pair) != 2 or not all(isinstance(entry, Axes) for entry in pair):
        raise ValueError(
            f"ax: expected two axes, magnitude and phase, got {len(pair)} of {type(pair[0]).__name__}"
        )
    return pair[0], pair[1]


def _mark_nyquist(curves: Sequence[FrequencyCurve], magnitude: Axes, phase: Axes) -> None:
    """One dotted line for each Nyquist frequency, named once."""
    for nyquist in sorted({curve.nyquist for curve in curves if np.isfinite(curve.nyquist)}):
        for axes in (magnitude, phase):
            axes.axvline(nyquist, color="0.5", linestyle=":", linewidth=1.0)
        magnitude.annotate(
            "Nyquist",
            (nyquist, 0.03),
            xycoords=("data", "axes fraction"),
            xytext=(-3, 0),
            textcoords="offset points",
            rotation=90,
            ha="right",
            va="bottom",
            fontsize="x-small",
            color="0.4",
        )


def _dress(curves: Sequence[FrequencyCurve], magnitude: Axes, phase: Axes) -> None:
    drawn = np.concatenate([np.abs(values) for curve in curves for values in (curve.F, curve.error)])
    drawn = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    if len(drawn):
        top = float(drawn.max())
        # Four decades: less is not read off, and a zero of 1 - F would stretch the axis without end.
        magnitude.set_ylim(max(0.7 * float(drawn.min()), 1e-4 * top), 1.6 * top)
    magnitude.set_ylabel("Magnitude", fontsize=SMALL)
    phase.set_ylabel("Phase of $F$ [deg]", fontsize=SMALL)
    phase.set_xlabel("Frequency [rad/s]", fontsize=SMALL)
    phase.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 1.5, 3, 4.5, 9, 10]))
    for axes in (magnitude, phase):
        axes.grid(True, which="major", color="0.88", linewidth=0.7)
        axes.tick_params(labelsize=SMALL)
        axes.margins(x=0.0)


def _legend(axes: Axes, filters: Sequence[Line2D]) -> Legend:
    """Above the axes, where it covers no curve."""
    styles = [
        Line2D([], [], color="0.3", label="$F$"),
        Line2D([], [], color="0.3", linestyle="--", label="$1-F$"),
    ]
    return axes.legend(
        handles=[*filters, *styles],
        fontsize="x-small",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.4,
        frameon=False,
        ncols=min(4, len(filters) + 2),
        columnspacing=1.2,
    )
