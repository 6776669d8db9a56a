"""Draws results that were computed elsewhere; computes nothing. python-control's plotting conventions."""

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

__all__ = ["FrequencyCurve", "bound_plot", "frequency_plot", "learning_plot", "trade_off_plot"]

FloatArray = NDArray[np.float64]

# Wong, "Color blindness", Nature Methods 8 (2011): told apart in print and by every reader.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_SMALL = "small"


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
        colour = _COLOURS[k % len(_COLOURS)]
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
    magnitude.set_ylabel("Magnitude", fontsize=_SMALL)
    phase.set_ylabel("Phase of $F$ [deg]", fontsize=_SMALL)
    phase.set_xlabel("Frequency [rad/s]", fontsize=_SMALL)
    phase.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 1.5, 3, 4.5, 9, 10]))
    for axes in (magnitude, phase):
        axes.grid(True, which="major", color="0.88", linewidth=0.7)
        axes.tick_params(labelsize=_SMALL)
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


def learning_plot(
    events: Sequence[tuple[int, int, int, float]],
    curves: Sequence[FrequencyCurve],
    *,
    ax: Sequence[Axes] | None = None,
) -> ct.ControlPlot:
    """Root-mean-square error over the steps of every descent, above a frequency plot of what was learned.

    Parameters
    ----------
    events : sequence of (order, start, iteration, cost)
        Steps that lowered a cost, a mean square. One colour an order, one line a start.
    curves : sequence of FrequencyCurve
    ax : three Axes, optional
        Where to draw errors, magnitude and phase; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``axes`` (3, 1) and ``lines`` (3, 1).

    Raises
    ------
    ValueError
        If there is no curve, or ``ax`` does not hold three axes.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> omega = np.logspace(-1, 2)
    >>> F = 1.0 / (1.0 + 1j * omega)
    >>> curve = FrequencyCurve("n = 1", omega, F, 1.0 - F, np.angle(F))
    >>> plot = learning_plot([(1, 0, 1, 0.5), (1, 0, 2, 0.4)], [curve])
    >>> plot.axes.shape
    (3, 1)
    >>> plt.close(plot.figure)
    """
    if ax is None:
        _, made = plt.subplots(
            3, 1, layout="constrained", figsize=(5.4, 6.6), height_ratios=(3, 3, 2), squeeze=False
        )
        made[2, 0].sharex(made[1, 0])
        ax = list(made[:, 0])
    if len(ax) != 3:
        raise ValueError(f"ax: expected three axes, errors, magnitude and phase, got {len(ax)}")
    errors: Axes = ax[0]
    descents: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for order, start, iteration, cost in events:
        descents.setdefault((order, start), []).append((iteration, cost))
    lines: list[Line2D] = []
    named: dict[int, Line2D] = {}
    for (order, _), points in descents.items():
        steps, costs = zip(*points, strict=True)
        (line,) = errors.semilogy(
            steps,
            np.sqrt(costs),
            color=_COLOURS[(order - 1) % len(_COLOURS)],
            linewidth=1.0,
            marker=".",
            markersize=3,
        )
        lines.append(line)
        named.setdefault(order, line).set_label(f"order {order}")
    errors.set_xlabel("Step of a descent", fontsize=_SMALL)
    errors.set_ylabel("RMS error", fontsize=_SMALL)
    errors.grid(True, which="major", color="0.88", linewidth=0.7)
    errors.tick_params(which="both", labelsize=_SMALL)
    if named:
        errors.legend(handles=list(named.values()), fontsize="x-small", frameon=False)
    lower = frequency_plot(curves, ax=ax[1:])
    grid = np.empty((3, 1), dtype=object)
    grid[:, 0] = [lines, *lower.lines[:, 0]]
    axes = np.empty((3, 1), dtype=object)
    axes[:, 0] = list(ax)
    return ct.ControlPlot(grid, axes, errors.figure, legend=lower.legend)


def bound_plot(
    times: FloatArray, kernel: FloatArray, running: FloatArray, derivative: int, bound: float
) -> ct.ControlPlot:
    """How a worst-case bound builds up.

    Parameters
    ----------
    times : (N,) array
        Seconds.
    kernel : (N,) array
        Impulse response from the bounded derivative of the residual to the error.
    running : (N,) array
        Bound of the error reached after that time.
    derivative : int
        Order of the derivative that is bounded.
    bound : float
        Its limit.

    Returns
    -------
    control.ControlPlot
        ``axes`` (2, 1) and ``lines`` (2, 1).

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> t = np.linspace(0.0, 1.0)
    >>> bound_plot(t, np.exp(-20 * t), 0.05 * (1 - np.exp(-20 * t)), 1, 0.05).axes.shape
    (2, 1)
    >>> plt.close("all")
    """
    figure, axes = plt.subplots(2, 1, sharex=True, layout="constrained", figsize=(5.4, 4.4), squeeze=False)
    response, growth = axes[:, 0]
    (line,) = response.plot(times, kernel, color=_COLOURS[0])
    response.fill_between(times, kernel, color=_COLOURS[0], alpha=0.15)
    response.set_ylabel(f"response to gamma^({derivative})", fontsize=_SMALL)
    (grown,) = growth.plot(times, running, color=_COLOURS[0], label="reached by the worst residual")
    growth.axhline(bound, color="0.4", linestyle="--", linewidth=1.0, label=f"bound {bound:.4g}")
    growth.set_ylabel("error", fontsize=_SMALL)
    growth.set_xlabel("time (s)", fontsize=_SMALL)
    growth.legend(fontsize="x-small", frameon=False)
    for axis in (response, growth):
        axis.grid(True, which="major", color="0.88", linewidth=0.7)
        axis.tick_params(which="both", labelsize=_SMALL)
    lines = np.empty((2, 1), dtype=object)
    lines[:, 0] = [[line], [grown]]
    return ct.ControlPlot(lines, axes, figure)


def trade_off_plot(following: FloatArray, noise: FloatArray, best: int, label: str) -> ct.ControlPlot:
    """Error that noise causes against error that the residual leaves, one point per design.

    Parameters
    ----------
    following, noise : (m,) arrays
        The two parts of the error.
    best : int
        Design that is marked.
    label : str
        In which sense they are errors.

    Returns
    -------
    control.ControlPlot
        ``axes`` (1, 1) and ``lines`` (1, 1).

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> trade_off_plot(np.array([2.0, 1.0]), np.array([0.5, 1.0]), 1, "bound").axes.shape
    (1, 1)
    >>> plt.close("all")
    """
    figure, axes = plt.subplots(1, 1, layout="constrained", figsize=(4.6, 3.6), squeeze=False)
    (axis,) = axes[0]
    (line,) = axis.loglog(following, noise, color=_COLOURS[0])
    (mark,) = axis.loglog([following[best]], [noise[best]], "o", color=_COLOURS[1], label="least sum")
    axis.set_xlabel(f"error from the residual ({label})", fontsize=_SMALL)
    axis.set_ylabel("error from the noise", fontsize=_SMALL)
    axis.grid(True, which="major", color="0.88", linewidth=0.7)
    axis.tick_params(which="both", labelsize=_SMALL)
    axis.legend(fontsize="x-small", frameon=False)
    lines = np.empty((1, 1), dtype=object)
    lines[0, 0] = [line, mark]
    return ct.ControlPlot(lines, axes, figure)
