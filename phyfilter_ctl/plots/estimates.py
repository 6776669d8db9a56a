"""Estimates over time beside what they estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ._style import COLOURS, SMALL, line_style, typeset

__all__ = ["estimate_plot"]

FloatArray = NDArray[np.float64]

# Longer curves go into a vector file as an image: as strokes they would make it many MB.
MANY = 5_000


def estimate_plot(
    times: FloatArray,
    truth: FloatArray,
    estimates: Mapping[str, FloatArray],
    errors: Mapping[str, FloatArray],
    rmse: Mapping[str, FloatArray],
    *,
    channels: Sequence[str],
    unit: str = "",
    totals: Mapping[str, float] | None = None,
    ax: Sequence[Axes] | None = None,
) -> ct.ControlPlot:
    """Truth and estimates of each channel over time, beneath it a strip with the errors and their RMSE.

    Parameters
    ----------
    times : (N,) array
        Seconds.
    truth : (N, n_x) array
    estimates, errors : dict of str to (N, n_x) array
        By name, of the same names.
    rmse : dict of str to (n_x,) array
        Written beside the errors.
    channels : sequence of str
        Names of the n_x channels.
    unit : str
        Of truth and estimates.
    totals : dict of str to float, optional
        RMSE over all channels, written into the legend.
    ax : 2 n_x Axes, optional
        For each channel one for the signals and one for the errors; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``lines`` (2 n_x, 1): for each channel truth and estimates, then their errors; ``axes`` (2 n_x, 1);
        ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If there is no estimate, the names differ, or ``ax`` does not hold 2 n_x axes.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> t, f = np.arange(3.0), np.array([[0.0], [1.0], [2.0]])
    >>> plot = estimate_plot(t, f, {"F": f - 1}, {"F": f - f + 1}, {"F": np.ones(1)}, channels=["v"], unit="N")
    >>> plot.axes.shape, plot.lines[1, 0][0].get_ydata().tolist()
    ((2, 1), [1.0, 1.0, 1.0])
    >>> plt.close(plot.figure)
    """
    if not estimates or not set(estimates) == set(errors) == set(rmse):
        raise ValueError(
            "estimate_plot: expected errors and RMSE for each of at least one estimate, got estimates "
            f"{sorted(estimates)}, errors {sorted(errors)}, RMSE {sorted(rmse)}"
        )
    axes = axes_over_time(len(channels), 2, "signals and errors", ax)
    rastered = len(times) > MANY
    lines = np.empty((2 * len(channels), 1), dtype=object)
    behind = f" {typeset(unit)}".rstrip()
    named = {
        name: typeset(name) if totals is None else f"{typeset(name)}, RMSE {totals[name]:.3g}{behind}"
        for name in estimates
    }
    of_unit = f" [{typeset(unit)}]" if unit else ""
    for i, channel in enumerate(channels):
        signals, strip = axes[2 * i], axes[2 * i + 1]
        drawn: list[Line2D] = signals.plot(
            times, truth[:, i], color="0.15", linewidth=2.0, alpha=0.55, label="truth", rasterized=rastered
        )
        wrong: list[Line2D] = []
        for k, name in enumerate(estimates):
            for where, values, into in ((signals, estimates, drawn), (strip, errors, wrong)):
                into += where.plot(
                    times,
                    values[name][:, i],
                    **line_style(k),
                    linewidth=1.0,
                    zorder=3.0 - 0.1 * k,
                    label=named[name],
                    rasterized=rastered,
                )
        _name_rmse(strip, {name: float(values[i]) for name, values in rmse.items()}, list(estimates))
        strip.axhline(0.0, color="0.6", linewidth=0.8, zorder=1)
        signals.set_ylabel(f"$f$ of {channel}{of_unit}", fontsize=SMALL)
        strip.set_ylabel("Error", fontsize=SMALL)
        lines[2 * i, 0], lines[2 * i + 1, 0] = drawn, wrong
    dress_over_time(axes, 2)
    legend = axes[0].legend(
        fontsize="x-small",
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        borderaxespad=0.4,
        frameon=False,
        ncols=min(2 if totals else 4, len(estimates) + 1),
        columnspacing=1.2,
    )
    grid = np.empty((len(axes), 1), dtype=object)
    grid[:, 0] = axes
    return ct.ControlPlot(lines, grid, axes[0].figure, legend=legend)


def axes_over_time(channels: int, panels: int, held: str, ax: Sequence[Axes] | None) -> list[Axes]:
    """``panels`` axes, one or two, for each channel one beneath the other: new ones, or those given."""
    if ax is None:
        figure, made = plt.subplots(
            panels * channels,
            1,
            sharex=True,
            layout="constrained",
            figsize=(6.4, 0.8 + (2.0 if panels == 2 else 1.4) * channels),
            height_ratios=(2, 1)[:panels] * channels,
            squeeze=False,
        )
        _tight(figure)
        return list(made[:, 0])
    given = list(ax)
    if len(given) != panels * channels:
        raise ValueError(
            f"ax: expected {panels * channels} axes, {held} of each of the {channels} channels, got {len(given)}"
        )
    return given


def _tight(figure: Figure) -> None:
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.set(h_pad=0.02, hspace=0.0)  # pyright: ignore[reportCallIssue]  the base class declares no option


def _name_rmse(strip: Axes, rmse: Mapping[str, float], names: Sequence[str]) -> None:
    """Figures in the colours of the curves, right of the strip, where they cover none."""
    figures = [(f"{rmse[name]:.3g}", COLOURS[k % len(COLOURS)]) for k, name in enumerate(names)]
    for k, (text, colour) in enumerate(reversed([("RMSE", "0.3"), *figures])):
        strip.annotate(
            text,
            (1.0, 0.0),
            (4, 10 * k),
            xycoords="axes fraction",
            textcoords="offset points",
            fontsize="x-small",
            color=colour,
            va="bottom",
        )


def dress_over_time(axes: Sequence[Axes], panels: int) -> None:
    """Grids, small letters, one axis of time for all; every second of two panels is a low one."""
    for k, each in enumerate(axes):
        each.grid(True, which="major", color="0.88", linewidth=0.7)
        each.tick_params(labelsize="x-small", labelbottom=k == len(axes) - 1)
        each.margins(x=0.0)
        each.set_axisbelow(True)
        each.locator_params(axis="y", nbins=5 if k % panels == 0 else 3)
    axes[-1].set_xlabel("Time [s]", fontsize=SMALL)
    figure = axes[0].figure
    if isinstance(figure, Figure):
        figure.align_ylabels(list(axes))
