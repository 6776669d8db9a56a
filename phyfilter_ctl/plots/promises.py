"""What a filter promises: bounds, trade-offs, the page that ``analyze`` draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ._style import COLOURS, LINES, SMALL, entitle, typeset
from ._units import Units
from .frequency import FrequencyCurve, frequency_plot

__all__ = ["analysis_plot", "bound_plot", "trade_off_plot"]

FloatArray = NDArray[np.float64]


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
    (line,) = response.plot(times, kernel, color=COLOURS[0])
    response.fill_between(times, kernel, color=COLOURS[0], alpha=0.15)
    unit = {0: " [1/s]", 1: ""}.get(derivative, f" [s$^{derivative - 1}$]" if derivative > 2 else " [s]")
    response.set_ylabel(f"Response to $\\gamma^{{({derivative})}}${unit}", fontsize=SMALL)
    (grown,) = growth.plot(times, running, color=COLOURS[0], label="reached by the worst residual")
    growth.axhline(bound, color="0.4", linestyle="--", linewidth=1.0, label=f"bound {bound:.4g}")
    growth.set_ylabel("Error [unit of f]", fontsize=SMALL)
    growth.set_xlabel("Time [s]", fontsize=SMALL)
    growth.legend(fontsize="x-small", frameon=False)
    for axis in (response, growth):
        axis.grid(True, which="major", color="0.88", linewidth=0.7)
        axis.tick_params(which="both", labelsize=SMALL)
    lines = np.empty((2, 1), dtype=object)
    lines[:, 0] = [[line], [grown]]
    return ct.ControlPlot(lines, axes, figure)


def trade_off_plot(
    across: FloatArray,
    up: FloatArray,
    best: int | None,
    label: str,
    *,
    names: tuple[str, str] = ("Error from the residual [unit of f]", "Error from the noise [unit of f]"),
    log: bool = True,
    ax: Axes | None = None,
) -> ct.ControlPlot:
    """What is gained against what it costs, one point per design: by default error that noise causes against error that
    the residual leaves.

    Parameters
    ----------
    across, up : (m,) arrays
        The two. Designs with a nan are left out.
    best : int or None
        Design of the least sum, which is marked.
    label : str
        Heading: in which sense they are errors.
    names : (str, str)
        Of the axes.
    log : bool
        Whether the axes are logarithmic.
    ax : Axes, optional
        Where to draw; None makes a new figure.

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
    axis = ax or plt.subplots(layout="constrained", figsize=(4.6, 3.6))[1]
    lines = np.empty((1, 1), dtype=object)
    lines[0, 0] = axis.plot(across, up, ".-", color=COLOURS[0])
    if log:
        axis.set(xscale="log", yscale="log")
    if best is not None:
        lines[0, 0] += axis.plot([across[best]], [up[best]], "o", color=COLOURS[1], label="least sum")
        axis.legend(fontsize="x-small", frameon=False)
    if label:
        entitle(axis, typeset(label[0].upper() + label[1:]))
    axis.set_xlabel(names[0], fontsize=SMALL)
    axis.set_ylabel(names[1], fontsize=SMALL)
    axis.grid(True, which="major", color="0.88", linewidth=0.7)
    axis.tick_params(which="both", labelsize=SMALL)
    axes = np.empty((1, 1), dtype=object)
    axes[0, 0] = axis
    return ct.ControlPlot(lines, axes, axis.figure)


def _colours(count: int) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(count)]


def analysis_plot(
    curves: Sequence[FrequencyCurve],
    omega: FloatArray,
    sensitivities: Mapping[str, Sequence[FloatArray]],
    growths: Sequence[tuple[FloatArray, FloatArray, float]],
    *,
    dB: bool | None = None,
    Hz: bool | None = None,
    deg: bool | None = None,
) -> ct.ControlPlot:
    """One page on a filter: its response, how its loops treat the residual, how large the error can become.

    Parameters
    ----------
    curves : sequence of FrequencyCurve
        One, or one for each channel.
    omega : (N,) array
        Frequencies in rad/s of the sensitivities.
    sensitivities : dict of str to sequence of (N,) array
        |1/(1 + L)| by loop, one for each curve.
    growths : sequence of (m,) array, (m,) array, float
        Times in s, bound of the error up to them, its limit; one for each curve, or none.
    dB, Hz, deg : bool, optional
        As for :func:`frequency_plot`.

    Returns
    -------
    control.ControlPlot
        ``axes`` (2, 2): magnitude, bound; phase, sensitivity. Without ``growths`` the bound's is hidden, and the
        sensitivity takes its column.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> omega = np.logspace(-1, 2)
    >>> F = 1.0 / (1.0 + 1j * omega)
    >>> curve = FrequencyCurve("n = 1", omega, F, 1.0 - F, np.angle(F))
    >>> analysis_plot([curve], omega, {"inner loop": [np.abs(1.0 - F)]}, []).axes.shape
    (2, 2)
    >>> plt.close("all")
    """
    figure, axes = plt.subplots(
        2, 2, layout="constrained", figsize=(8.4, 5.2), height_ratios=(3, 2), squeeze=False
    )
    units = Units.chosen(dB=dB, Hz=Hz, deg=deg)
    left = frequency_plot(curves, ax=list(axes[:, 0]), dB=dB, Hz=Hz, deg=deg)
    top, bottom = axes[:, 1]
    axes[0, 0].sharex(axes[1, 0])
    axes[0, 0].tick_params(labelbottom=False)
    lines = np.empty((2, 2), dtype=object)
    lines[:, 0] = left.lines[:, 0]
    lines[0, 1] = []
    if not growths:  # the loops have the whole column
        top.set_axis_off()
        top.set_visible(False)
        bottom.set_subplotspec(bottom.get_gridspec()[:, 1])
    else:
        for colour, (times, running, limit) in zip(_colours(len(growths)), growths, strict=True):
            label = None if len(growths) > 1 else "largest error so far"
            lines[0, 1] += top.plot(times, running, color=colour, label=label)
            other = "0.4" if len(growths) == 1 else colour
            top.axhline(limit, color=other, linestyle="--", linewidth=1.0, label=f"bound {limit:.4g}")
        top.set_xlabel("Time [s]", fontsize=SMALL)
        top.set_ylabel("Error [unit of f]", fontsize=SMALL)
        top.margins(x=0.0)
        top.legend(fontsize="x-small", frameon=False)
    lines[1, 1] = []
    for i, (name, rows) in enumerate(sensitivities.items()):
        # One curve: a colour a loop. Several: the colour of the curve, and a style a loop, named once.
        for k, (colour, values) in enumerate(zip(_colours(len(rows)), rows, strict=True)):
            lines[1, 1] += bottom.plot(
                omega / units.per_frequency,
                units.magnitude(values),
                color=COLOURS[i % len(COLOURS)] if len(rows) == 1 else colour,
                linestyle=LINES[(i + i // len(COLOURS)) % len(LINES)],
                label=name if k == 0 else None,
            )
    bottom.axhline(float(units.magnitude(1.0)), color="0.6", linewidth=0.8)
    units.dress_frequency(bottom)
    units.dress_magnitude(bottom, "Residual left, $|1/(1 + L)|$")
    bottom.margins(x=0.0)
    bottom.legend(fontsize="x-small", frameon=False, loc="lower right")
    for axis in (top, bottom):
        axis.grid(True, which="major", color="0.88", linewidth=0.7)
        axis.tick_params(which="both", labelsize=SMALL)
    return ct.ControlPlot(lines, axes, figure)
