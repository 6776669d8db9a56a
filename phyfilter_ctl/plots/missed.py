"""The force that a model missed, over time and over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ._style import COLOURS, SMALL, entitle, line_style, typeset
from ._units import frequency_unit
from .estimates import MANY, dress_over_time

__all__ = ["density_plot", "missed_plot"]

FloatArray = NDArray[np.float64]


def missed_plot(
    times: FloatArray,
    f_hat: FloatArray,
    band: FloatArray,
    beside: Mapping[str, FloatArray],
    spectrum: tuple[FloatArray, FloatArray, FloatArray],
    *,
    channels: Sequence[str],
    title: str = "",
    ax: Sequence[Axes] | None = None,
    Hz: bool | None = None,
) -> ct.ControlPlot:
    """f_hat of each channel over time with its noise band, and beneath them the spectrum of what the model misses.

    Parameters
    ----------
    times : (N,) array
        Seconds.
    f_hat : (N, n_x) array
    band : (n_x,) array
        Half the width of the noise band.
    beside : dict of str to (N, n_x) array
        Other signals, by name.
    spectrum : three (K,) arrays
        omega in rad/s, density of the measured residual, density of the noise in it.
    channels : sequence of str
        Names of the n_x channels.
    title : str
        Above the figure.
    ax : n_x + 1 Axes, optional
        None makes a new figure.
    Hz : bool, optional
        The spectrum over Hz, its densities per Hz; None: python-control's setting ``freqplot.Hz``.

    Returns
    -------
    control.ControlPlot
        ``lines`` and ``axes`` (n_x + 1, 1); ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If ``ax`` does not hold n_x + 1 axes.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> t, one = np.arange(3.0), np.ones((3, 1))
    >>> plot = missed_plot(t, one, np.ones(1), {"label": one}, (t + 1.0, t + 1.0, t + 1.0), channels=["v"])
    >>> plot.axes.shape
    (2, 1)
    >>> plt.close(plot.figure)
    """
    count = len(channels) + 1
    if ax is None:
        size = (6.4, 1.0 + 1.6 * count)
        axes = list(plt.subplots(count, 1, layout="constrained", figsize=size, squeeze=False)[1][:, 0])
    elif len(axes := list(ax)) != count:
        raise ValueError(f"ax: expected {count} axes, one for each channel and one more, got {len(axes)}")
    rastered = len(times) > MANY
    lines = np.empty((count, 1), dtype=object)
    for i, channel in enumerate(channels):
        axes[i].fill_between(
            times,
            f_hat[:, i] - band[i],
            f_hat[:, i] + band[i],
            color=COLOURS[0],
            alpha=0.25,
            linewidth=0.0,
            rasterized=rastered,
        )
        drawn = axes[i].plot(
            times, f_hat[:, i], color=COLOURS[0], linewidth=1.0, label=typeset("f_hat"), rasterized=rastered
        )
        for k, (name, values) in enumerate(beside.items()):
            drawn += axes[i].plot(
                times,
                values[:, i],
                **line_style(k + 1),
                linewidth=0.8,
                label=typeset(name),
                rasterized=rastered,
            )
        axes[i].set_ylabel(f"$f$ of {channel}", fontsize=SMALL)
        axes[i].sharex(axes[0])
        lines[i, 0] = drawn
    dress_over_time(axes[:-1], 1)
    omega, residual, noise = (values[1:] for values in spectrum)
    below = density_plot(omega, {"measured residual": residual, "noise in it": noise}, ax=axes[-1], Hz=Hz)
    lines[-1, 0] = list(below.lines[0, 0])
    legend = axes[0].legend(fontsize="x-small", frameon=False, ncols=len(beside) + 1)
    if title:
        entitle(axes[0], title)
    grid = np.empty((count, 1), dtype=object)
    grid[:, 0] = axes
    return ct.ControlPlot(lines, grid, axes[0].figure, legend=legend)


def density_plot(
    omega: FloatArray,
    densities: Mapping[str, FloatArray],
    *,
    ax: Axes | None = None,
    Hz: bool | None = None,
) -> ct.ControlPlot:
    """Spectral densities over frequency; the last, noise, dashed.

    Parameters
    ----------
    omega : (K,) array
        rad/s, above 0.
    densities : dict of str to (K,) array
        Per rad/s, by name. What is 0 is not drawn.
    ax : Axes, optional
        None makes a new figure.
    Hz : bool, optional
        Over Hz, densities per Hz; None: python-control's setting ``freqplot.Hz``.

    Returns
    -------
    control.ControlPlot
        ``lines`` and ``axes`` (1, 1); ``figure``; ``legend``.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> omega = np.geomspace(1.0, 100.0, 5)
    >>> plot = density_plot(omega, {"signal": omega**-2.0, "noise": 0.01 + 0.0 * omega})
    >>> [line.get_label() for line in plot.lines[0, 0]]
    ['signal', 'noise']
    >>> plt.close(plot.figure)
    """
    if ax is None:
        ax = plt.subplots(layout="constrained", figsize=(6.4, 3.2))[1]
    unit, per = frequency_unit(Hz)
    drawn = []
    for k, (name, density) in enumerate(densities.items()):
        last = k == len(densities) - 1
        drawn += ax.loglog(
            omega / per,
            np.where(density > 0.0, per * density, np.nan),
            color=COLOURS[1] if last else "0.15" if k == 0 else COLOURS[0],
            linewidth=1.0,
            linestyle="--" if last else "-",
            label=name,
        )
    ax.set_xlabel(f"Frequency [{unit}]", fontsize=SMALL)
    ax.set_ylabel("Density", fontsize=SMALL)
    ax.tick_params(labelsize="x-small")
    ax.grid(True, which="major", color="0.88", linewidth=0.7)
    legend = ax.legend(fontsize="x-small", frameon=False)
    lines, grid = np.empty((1, 1), dtype=object), np.empty((1, 1), dtype=object)
    lines[0, 0], grid[0, 0] = drawn, ax
    return ct.ControlPlot(lines, grid, ax.figure, legend=legend)
