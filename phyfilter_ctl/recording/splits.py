"""Recordings apart by a figure of each, so that a model is tested on another kind than it has seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from . import checks

if TYPE_CHECKING:
    from .recording import Recording

__all__ = ["split"]


def split(
    recordings: Sequence[Recording],
    by: Literal["speed"] | Callable[[Recording], float] = "speed",
    *,
    fraction: float = 0.5,
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split recordings by a figure of each: the lower ``fraction`` of them, and the rest, both sorted by it.

    Parameters
    ----------
    recordings : sequence of Recording
        At least two.
    by : "speed" or callable
        Recording -> float. "speed" is :meth:`Recording.speed`. Recordings of the same figure keep their order.
    fraction : float
        Share of the recordings in the first part, rounded, with at least one recording in each.

    Returns
    -------
    lower, upper : tuples of Recording

    Raises
    ------
    TypeError
        If it is one recording, or ``by`` is no function.
    ValueError
        If there are fewer than two recordings, ``by`` is another word, ``fraction`` is not between 0 and 1, or a figure
        is not finite.

    Examples
    --------
    >>> from phyfilter_ctl.recording import Recording, split
    >>> logs = [Recording.from_arrays(x=[[v], [v]], dt=0.1) for v in (2.0, -3.0, 1.0, 0.5)]
    >>> slower, faster = split(logs)
    >>> [log.x[0, 0].item() for log in slower], [log.x[0, 0].item() for log in faster]
    ([0.5, 1.0], [2.0, -3.0])
    >>> negative, rest = split(logs, by=lambda log: log.x.mean(), fraction=0.25)
    >>> [log.x[0, 0].item() for log in negative]
    [-3.0]
    """
    if hasattr(recordings, "times"):  # one has a length too
        raise TypeError(
            f"recordings: expected a sequence of them, got one: {recordings!r}; its parts are log.split(0.5)"
        )
    if len(recordings) < 2:
        raise ValueError(f"recordings: expected at least 2 to split, got {len(recordings)}")
    if by == "speed":
        figures = np.array([recording.speed() for recording in recordings])
    elif callable(by):
        figures = np.array([float(by(recording)) for recording in recordings])
    else:
        kind = ValueError if isinstance(by, str) else TypeError
        raise kind(f'by: expected "speed" or a function of a recording, got {by!r}')
    if not np.all(np.isfinite(figures)):
        raise ValueError(f"by: expected a finite figure for every recording, got {figures.tolist()}")
    order = np.argsort(figures, kind="stable")
    cut = min(max(round(checks.fraction_of(fraction) * len(recordings)), 1), len(recordings) - 1)
    return tuple(recordings[i] for i in order[:cut]), tuple(recordings[i] for i in order[cut:])
