"""A recorded flight over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import control as ct
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ._style import SMALL, entitle, line_style, typeset
from .estimates import MANY, axes_over_time, dress_over_time

__all__ = ["log_plot"]

FloatArray = NDArray[np.float64]


def log_plot(
    times: FloatArray,
    x: FloatArray,
    forces: Mapping[str, FloatArray],
    *,
    channels: Sequence[str],
    unit: str = "",
    force_unit: str = "",
    title: str = "",
    ax: Sequence[Axes] | None = None,
) -> ct.ControlPlot:
    """Each channel of x over time and, beneath it, what acts on it.

    Parameters
    ----------
    times : (N,) array
        Seconds.
    x : (N, n_x) array
    forces : dict of str to (N, n_x) array
        Signals in the unit of M x', by name; none leaves their panels out.
    channels : sequence of str
        Names of the n_x channels.
    unit, force_unit : str
        Of x, and of the forces.
    title : str
        Above the figure.
    ax : sequence of Axes, optional
        One for each channel, two where there are forces; None makes a new figure.

    Returns
    -------
    control.ControlPlot
        ``lines`` and ``axes`` have shape (n_x, 1), or (2 n_x, 1) where there are forces; ``figure``; ``legend``.

    Raises
    ------
    ValueError
        If ``ax`` does not hold as many axes.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("Agg")
    >>> t = np.arange(3.0)
    >>> plot = log_plot(t, t[:, None], {"g": np.ones((3, 1))}, channels=["v"], unit="m/s")
    >>> plot.axes.shape, plot.axes[0, 0].get_ylabel(), plot.lines[1, 0][0].get_label()
    ((2, 1), 'v [m/s]', 'g')
    """
    panels = 2 if forces else 1
    axes = axes_over_time(len(channels), panels, "x and what acts on it" if forces else "x", ax)
    rastered = len(times) > MANY
    lines = np.empty((len(axes), 1), dtype=object)
    for i, channel in enumerate(channels):
        top = axes[panels * i]
        lines[panels * i, 0] = top.plot(times, x[:, i], color="0.15", linewidth=1.0, rasterized=rastered)
        top.set_ylabel(f"{channel}{f' [{typeset(unit)}]' if unit else ''}", fontsize=SMALL)
        if not forces:
            continue
        beneath, drawn = axes[panels * i + 1], []
        for k, (name, values) in enumerate(forces.items()):
            drawn += beneath.plot(
                times,
                values[:, i],
                **line_style(k),
                linewidth=1.0,
                label=typeset(name),
                rasterized=rastered,
            )
        lines[panels * i + 1, 0] = drawn
        beneath.set_ylabel(f"$g$, $f${f' [{typeset(force_unit)}]' if force_unit else ''}", fontsize=SMALL)
    dress_over_time(axes, panels)
    legend = axes[1].legend(fontsize="x-small", ncols=len(forces), frameon=False) if forces else None
    if title:
        entitle(axes[0], title)
    grid = np.empty((len(axes), 1), dtype=object)
    grid[:, 0] = axes
    return ct.ControlPlot(lines, grid, axes[0].figure, legend=legend)
