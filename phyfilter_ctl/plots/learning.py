"""How learning went."""

from __future__ import annotations

from collections.abc import Sequence

import control as ct
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ._style import COLOURS, MARKERS, SMALL
from .frequency import FrequencyCurve, frequency_plot

__all__ = ["learning_plot"]


def learning_plot(
    events: Sequence[tuple[int, int, int, float]],
    curves: Sequence[FrequencyCurve],
    *,
    ax: Sequence[Axes] | None = None,
    dB: bool | None = None,
    Hz: bool | None = None,
    deg: bool | None = None,
) -> ct.ControlPlot:
    """Root-mean-square error over the steps of every descent, above a frequency plot of what was learned.

    Parameters
    ----------
    events : sequence of (order, start, iteration, cost)
        Steps that lowered a cost, a mean square. One colour an order, one line a start.
    curves : sequence of FrequencyCurve
    ax : three Axes, optional
        Where to draw errors, magnitude and phase; None makes a new figure.
    dB, Hz, deg : bool, optional
        As for :func:`frequency_plot`.

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
        made[1, 0].tick_params(labelbottom=False)
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
            color=COLOURS[(order - 1) % len(COLOURS)],
            linewidth=1.0,
            marker=MARKERS[(order + (order - 1) // len(COLOURS)) % len(MARKERS)],
            markersize=3,
        )
        lines.append(line)
        named.setdefault(order, line).set_label(f"order {order}")
    errors.set_xlabel("Step of a descent", fontsize=SMALL)
    errors.set_ylabel("RMS error [unit of f]", fontsize=SMALL)
    drawn = [cost for *_, cost in events]
    if drawn and max(drawn) < 100.0 * min(drawn):  # less than a decade of errors: powers of ten would not do
        errors.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
        errors.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        errors.yaxis.set_minor_formatter(NullFormatter())
    errors.grid(True, which="major", color="0.88", linewidth=0.7)
    errors.tick_params(which="both", labelsize=SMALL)
    if named:
        errors.legend(handles=list(named.values()), fontsize="x-small", frameon=False)
    lower = frequency_plot(curves, ax=ax[1:], dB=dB, Hz=Hz, deg=deg)
    grid = np.empty((3, 1), dtype=object)
    grid[:, 0] = [lines, *lower.lines[:, 0]]
    axes = np.empty((3, 1), dtype=object)
    axes[:, 0] = list(ax)
    return ct.ControlPlot(grid, axes, errors.figure, legend=lower.legend)
