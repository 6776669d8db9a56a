"""The picture of all arms: how they were trained, and where they stay near their command."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from phyfilter_ctl.plots import PAGE, dress, letter_panels

from .params import params
from .policy import Policy
from .robustness import Judged

__all__ = ["draw"]

# Wong, Nature Methods 8, 2011; one colour an arm, dashed: put on policies that were trained without.
_SHOWN: dict[str, tuple[str, str, str]] = {
    "base": ("#999999", "-", "base"),
    "rival": ("#D55E00", "--", "base, adaptive rival"),
    "tuned": ("#009E73", "--", "base, filter put on, tuned"),
    "filter": ("#0072B2", "-", "trained with the filter"),
    "improved": ("#56B4E9", "-", "the same, improved filter"),
    "full": ("#CC79A7", "-", "full randomisation"),
}
_FAMILIES = {"base": "base", "filter": "filter", "basefull": "full"}


def draw(judged: Judged, found: Mapping[str, Sequence[Policy]]) -> Figure:
    """Draw training rewards, velocity errors over payload and speed, and falls on grounds.

    Parameters
    ----------
    judged : Judged
    found : mapping
        Family to policies.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = Figure(figsize=(PAGE, 6.6), layout="constrained")
    (a, b), (c, d) = figure.subplots(2, 2)
    _curves(a, found)
    _lines(b, judged, r"payload ([\d.]+) %")
    b.axhline(0.2, color="0.6", linestyle=":", linewidth=0.9)
    b.set_xlabel("Payload [% of the weight], dotted: the paper's bound")
    b.set_ylabel("Velocity error [m/s], band: policies")
    dress(b, "Payload at 1 m/s, a fall counts 1 m/s")
    _lines(c, judged, r"([\d.]+) m/s")
    c.set_xlabel("Commanded speed [m/s]")
    c.set_ylabel("Velocity error [m/s]")
    dress(c, "Speed")
    _falls(d, judged)
    handles, labels = b.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    letter_panels(figure)
    return figure


def _curves(axes: Axes, found: Mapping[str, Sequence[Policy]]) -> None:
    for family, name in _FAMILIES.items():
        colour, _, _ = _SHOWN[name]
        for policy in found.get(family, ()):
            record, numbers = policy.record, params(policy.robot)
            if "reward" not in record:
                continue
            each = record["reward_every"] * numbers.training.horizon * record["environments"] / 1e6
            rate = np.array(record["reward"]) / (numbers.control.dt * numbers.control.decimation)
            axes.plot(each * np.arange(1, len(rate) + 1), rate, color=colour, linewidth=1.0)
    axes.set_xlabel("Million steps")
    axes.set_ylabel("Reward per second, each policy")
    dress(axes, "Training, on flat ground")


def _lines(axes: Axes, judged: Judged, pattern: str) -> None:
    rows = {label: match for label, _ in judged.values if (match := re.fullmatch(pattern, label))}
    if not rows:
        return
    x = np.array([float(match[1]) for match in rows.values()])
    order = np.argsort(x)
    for name, (colour, line, words) in _SHOWN.items():
        error = np.array([judged.values[label, name]["error"] for label in rows])[order]
        axes.plot(x[order], error.mean(axis=1), line, color=colour, marker="o", markersize=3.5, label=words)
        low, high = error.min(axis=1), error.max(axis=1)
        axes.fill_between(x[order], low, high, color=colour, alpha=0.1, linewidth=0.0)
    axes.set_ylim(bottom=0.0)


_PLACES = {"slopes": "up |down ", "stairs": "stairs", "rough": "rough", "wave": "wave", "gravel": "gravel"}
_PLACES |= {"pushes": "push", "dead motor": "no motor"}


def _falls(axes: Axes, judged: Judged) -> None:
    labels = dict.fromkeys(label for label, _ in judged.values)
    places = {
        place: rows
        for place, start in _PLACES.items()
        if (rows := [label for label in labels if re.match(start, label)])
    }
    width = 0.8 / len(_SHOWN)
    for k, (name, (colour, line, _)) in enumerate(_SHOWN.items()):
        falls = [
            100.0 * np.mean([judged.values[label, name]["fallen"] for label in rows])
            for rows in places.values()
        ]
        x = np.arange(len(falls)) + (k - 0.5 * (len(_SHOWN) - 1)) * width
        hatch = "//" if line == "--" else None
        axes.bar(x, falls, width=0.9 * width, color=colour, hatch=hatch, edgecolor="white")
    axes.set_xticks(np.arange(len(places)), [place.replace(" ", "\n") for place in places])
    axes.set_ylabel("Falls [%], mean of conditions and policies")
    dress(axes, "Grounds, pushes, a dead motor")
