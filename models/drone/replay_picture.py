"""The picture of a replay: estimates over time, scores, and how late the thrust acts."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from phyfilter_ctl.plots import COLOURS, PAGE, dress, letter_panels, typeset

from .replay import Flight, Replay, title
from .replay_recordings import AXES, BAND

__all__ = ["draw"]

_NOT_DRAWN = ("zero", "difference", "lowpass", "mean")
_SHOWN = 10.0  # s


def draw(replay: Replay) -> Figure:
    """Estimates over time on the flight with the strongest force, the scores, and the scan of delays.

    Parameters
    ----------
    replay : Replay

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(PAGE, 6.4), layout="constrained")
    # Rows of their own: the long names of one do not squeeze the other.
    top, bottom = (figure.add_subfigure(cell) for cell in figure.add_gridspec(2, 1))
    shown = max(replay.flights, key=lambda each: float(np.mean(each.recording.label**2)))
    left, right = top.subplots(1, 2)
    _series(left, shown, replay, 0)
    _series(right, shown, replay, 2)
    handles, labels = left.get_legend_handles_labels()
    top.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    scores, delays = bottom.subplots(1, 2, width_ratios=[1.3, 1.0])
    _dots(scores, replay)
    _delays(delays, replay)
    figure.suptitle(f"Residual force per unit mass, {len(replay.flights)} recorded flights", fontsize="small")
    letter_panels(figure)
    return figure


def _series(axes: Axes, flight: Flight, replay: Replay, i: int) -> None:
    """Ten seconds after the start-up: the label, every filter, and the learned model alone."""
    log = flight.recording.log
    t = log.times - log.times[0]
    rows = (t >= replay.start_up) & (t <= replay.start_up + _SHOWN)
    axes.plot(t[rows], flight.recording.label[rows, i], color="0.75", linewidth=2.0, label="fa / m")
    drawn = [name for name in replay.scores if name not in _NOT_DRAWN]
    for k, name in enumerate(drawn):
        f_hat = flight.estimates[name][rows, i]
        axes.plot(t[rows], f_hat, color=COLOURS[k % len(COLOURS)], linewidth=0.9, label=typeset(title(name)))
    axes.set(xlabel="Time [s]", ylabel="Force per unit mass [m/s$^2$]")
    dress(axes, f"{log.name}, {AXES[i]}")


def _dots(axes: Axes, replay: Replay) -> None:
    """A logarithmic axis, where no estimate at all and a good one both have room; so dots, bars have no foot there."""
    # One that diverged has no dot.
    finite = {key: s for key, s in replay.scores.items() if np.isfinite([s.total, s.ahead]).all()}
    at = np.arange(len(finite))
    axes.plot([s.total for s in finite.values()], at, "o", color=COLOURS[0], label="against fa")
    ahead = [s.ahead for s in finite.values()]
    axes.plot(ahead, at, "D", color=COLOURS[1], markersize=5, label=f"{replay.horizon:.3g} s ahead")
    axes.set_yticks(at, [typeset(title(name)) for name in finite])
    axes.invert_yaxis()
    axes.set(xlabel="RMSE over all flights [m/s$^2$]", xscale="log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize="x-small", frameon=False)
    dress(axes, "Scores")


def _delays(axes: Axes, replay: Replay) -> None:
    for each in replay.flights:
        scan = each.recording.delays
        axes.plot(1e3 * scan.delays, scan.rms / scan.rms[0], color=COLOURS[0], linewidth=0.7, alpha=0.6)
        axes.plot(1e3 * scan.best, 1.0 - scan.reduction, ".", color=COLOURS[1], markersize=6)
    axes.set(
        xlabel="Delay of the thrust set-point [ms]",
        ylabel=f"Left at {BAND[0]:g} to {BAND[1]:g} Hz, relative",
    )
    dress(axes, "How late the thrust acts")
