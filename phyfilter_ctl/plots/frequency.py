"""Frequency responses of filters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ._style import COLOURS, MARKERS, SMALL, PhaseLocator
from ._units import Units

__all__ = ["FrequencyCurve", "FrequencyLimit", "frequency_plot"]

_LIMIT = "0.35"


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


@dataclass(frozen=True)
class FrequencyLimit:
    """What |F| or |1 - F| must stay below over a range of frequencies.

    Attributes
    ----------
    of : {"F", "error"}
        |F| or |1 - F|.
    magnitude : float
        The limit, positive.
    low, high : float
        The range in rad/s; 0 and infinity leave it open.

    Raises
    ------
    ValueError
        If the magnitude is not positive or the range is empty.
    """

    of: Literal["F", "error"]
    magnitude: float
    low: float = 0.0
    high: float = np.inf

    def __post_init__(self) -> None:
        if self.of not in ("F", "error"):
            raise ValueError(f"of: expected 'F' or 'error', got {self.of!r}")
        if not (np.isfinite(self.magnitude) and self.magnitude > 0.0):
            raise ValueError(f"magnitude: expected a positive number, got {self.magnitude}")
        if not 0.0 <= self.low < self.high:
            raise ValueError(f"expected 0 <= low < high rad/s, got {self.low} and {self.high}")


def frequency_plot(
    curves: Sequence[FrequencyCurve],
    *,
    limits: Sequence[FrequencyLimit] = (),
    ax: Sequence[Axes] | None = None,
    dB: bool | None = None,
    Hz: bool | None = None,
    deg: bool | None = None,
) -> ct.ControlPlot:
    """Magnitude of F (full) and 1 - F (dashed), and phase of F, over frequency, on one axis for all filters.

    Parameters
    ----------
    curves : sequence of FrequencyCurve
    limits : sequence of FrequencyLimit
        Drawn grey, full for F and dashed for 1 - F, with hatches on the side to be kept clear.
    ax : two Axes, optional
        Where to draw magnitude and phase; None makes a new figure.
    dB, Hz, deg : bool, optional
        Magnitudes in dB, frequencies in Hz, phase in degrees; None: python-control's settings ``freqplot.dB``,
        ``freqplot.Hz`` and ``freqplot.deg``. Curves and limits are given in rad/s all the same.

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
    units = Units.chosen(dB=dB, Hz=Hz, deg=deg)
    per = units.per_frequency
    curves = [replace(curve, omega=curve.omega / per, nyquist=curve.nyquist / per) for curve in curves]
    limits = [replace(limit, low=limit.low / per, high=limit.high / per) for limit in limits]
    magnitude, phase = _two_axes(ax, len(curves))
    lines: tuple[list[Line2D], list[Line2D]] = ([], [])
    for k, curve in enumerate(curves):
        marker = MARKERS[k // len(COLOURS) % len(MARKERS)]  # beyond the colours
        style = {"color": COLOURS[k % len(COLOURS)], "marker": marker, "markevery": 0.1, "markersize": 3.5}
        F, error = (units.magnitude(np.abs(values)) for values in (curve.F, curve.error))
        lines[0].extend(magnitude.plot(curve.omega, F, **style, label=curve.label))
        lines[0].extend(magnitude.plot(curve.omega, error, **style, linestyle="--"))
        lines[1].extend(phase.plot(curve.omega, units.phase(curve.phase), **style, label=curve.label))
    _dress(curves, limits, magnitude, phase, units)
    _mark_nyquist(curves, magnitude, phase, units)
    for limit in limits:
        _draw_limit(magnitude, limit, units)
    legend = _legend(magnitude, lines[0][::2], limits)
    grid = np.empty((2, 1), dtype=object)
    grid[:, 0] = lines
    axes = np.array([[magnitude], [phase]], dtype=object)
    return ct.ControlPlot(grid, axes, magnitude.figure, legend=legend)


def _two_axes(ax: Sequence[Axes] | None, count: int) -> tuple[Axes, Axes]:
    if ax is None:
        height = 4.6 + 0.16 * max(0, count - len(COLOURS))  # the legend stands above
        _, axes = plt.subplots(
            2,
            1,
            sharex=True,
            layout="constrained",
            figsize=(5.4, height),
            height_ratios=(3, 2),
            squeeze=False,
        )
        return axes[0, 0], axes[1, 0]
    pair = np.ravel(np.asarray(ax, dtype=object))
    if len(pair) != 2 or not all(isinstance(entry, Axes) for entry in pair):
        raise ValueError(
            f"ax: expected two axes, magnitude and phase, got {len(pair)} of {type(pair[0]).__name__}"
        )
    return pair[0], pair[1]


def _mark_nyquist(curves: Sequence[FrequencyCurve], magnitude: Axes, phase: Axes, units: Units) -> None:
    """One dotted line for each Nyquist frequency, named once."""
    for nyquist in sorted({curve.nyquist for curve in curves if np.isfinite(curve.nyquist)}):
        for axes in (magnitude, phase):
            axes.axvline(nyquist, color="0.5", linestyle=":", linewidth=1.0)
        # Right of the line, where this filter draws nothing, and away from the others.
        magnitude.annotate(
            "Nyquist",
            (nyquist, _free_height(curves, nyquist, magnitude, units)),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            rotation=90,
            ha="left",
            va="center",
            fontsize="x-small",
            color="0.4",
        )


def _free_height(curves: Sequence[FrequencyCurve], omega: float, axes: Axes, units: Units) -> float:
    """Height of the axes, as a share, that is farthest from all curves at a frequency."""
    bottom, top = units.height(axes.get_ylim())
    taken = [
        (20.0 * np.log10(max(float(np.interp(omega, curve.omega, np.abs(values))), 1e-300)) - bottom)
        / (top - bottom)
        for curve in curves
        if curve.omega[-1] > omega
        for values in (curve.F, curve.error)
    ]
    heights = (0.5, 0.15, 0.3, 0.7)
    return max(heights, key=lambda height: min((abs(height - each) for each in taken), default=1.0))


def _draw_limit(axes: Axes, limit: FrequencyLimit, units: Units) -> None:
    left, right = axes.get_xlim()
    low, high = max(limit.low, left), min(limit.high, right)
    if low >= high:
        return
    level, above = (float(value) for value in units.magnitude([limit.magnitude, 1.35 * limit.magnitude]))
    style = "-" if limit.of == "F" else "--"
    axes.plot([low, high], [level, level], color=_LIMIT, linestyle=style, linewidth=1.6, scalex=False)
    axes.fill_between(
        [low, high], level, above, facecolor="none", edgecolor="0.6", hatch="////", linewidth=0.0
    )
    axes.set_xlim(left, right)


def _dress(
    curves: Sequence[FrequencyCurve],
    limits: Sequence[FrequencyLimit],
    magnitude: Axes,
    phase: Axes,
    units: Units,
) -> None:
    units.dress_magnitude(magnitude, "Magnitude")
    drawn = np.concatenate([np.abs(values) for curve in curves for values in (curve.F, curve.error)])
    drawn = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    drawn = np.append(drawn, [limit.magnitude for limit in limits])
    if len(drawn):
        top = float(drawn.max())
        # Four decades: less is not read off, and a zero of 1 - F would stretch the axis without end.
        magnitude.set_ylim(*units.magnitude([max(0.7 * float(drawn.min()), 1e-4 * top), 1.6 * top]))
    phase.set_ylabel(f"Phase of $F$ [{'deg' if units.deg else 'rad'}]", fontsize=SMALL)
    magnitude.set_xscale("log")
    units.dress_frequency(phase)
    if units.deg:
        phase.yaxis.set_major_locator(PhaseLocator())
    for axes in (magnitude, phase):
        axes.grid(True, which="major", color="0.88", linewidth=0.7)
        axes.tick_params(labelsize=SMALL)
        axes.margins(x=0.0)


def _legend(axes: Axes, filters: Sequence[Line2D], limits: Sequence[FrequencyLimit]) -> Legend:
    """Above the axes, where it covers no curve."""
    styles = [
        Line2D([], [], color="0.3", label="$F$"),
        Line2D([], [], color="0.3", linestyle="--", label="$1-F$"),
    ]
    if limits:
        styles.append(Line2D([], [], color=_LIMIT, linewidth=1.6, label="limits"))
    entries = len(filters) + len(styles)
    # Filled column after column: the filters in the first, what the lines mean in the next.
    columns = entries if len(filters) == 1 else max(2, -(-entries // len(filters)))
    return axes.legend(
        handles=[*filters, *styles],
        fontsize="x-small",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.4,
        frameon=False,
        ncols=columns,
        columnspacing=1.2,
    )
