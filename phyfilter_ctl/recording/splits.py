"""Flights apart by a figure of each, so that a model is tested on flights of another kind than it has seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from . import checks

if TYPE_CHECKING:
    from .recording import Recording

__all__ = ["split_by_speed", "split_flights"]


def split_flights(
    flights: Sequence[Recording], *, key: Callable[[Recording], float], fraction: float = 0.5
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split flights by a figure of each: the lower ``fraction`` of them, and the rest, both sorted by it.

    Parameters
    ----------
    flights : sequence of Recording
        At least two.
    key : callable
        Recording -> float. Flights of the same figure keep their order.
    fraction : float
        Share of the flights in the first part, rounded, with at least one flight in each.

    Returns
    -------
    lower, upper : tuples of Recording

    Raises
    ------
    TypeError
        If it is one log.
    ValueError
        If there are fewer than two flights, ``fraction`` is not between 0 and 1, or a figure is not finite.

    Examples
    --------
    >>> from phyfilter_ctl.recording import Recording, split_flights
    >>> logs = [Recording.from_arrays(x=[[0.0]] * n, dt=0.1) for n in (9, 5, 7)]
    >>> short, long = split_flights(logs, key=lambda log: log.duration)
    >>> [log.n for log in short], [log.n for log in long]
    ([5, 7], [9])
    """
    if hasattr(flights, "times"):  # a log has a length too
        raise TypeError(
            f"flights: expected a sequence of logs, got one: {flights!r}; its parts are log.split(0.5)"
        )
    if len(flights) < 2:
        raise ValueError(f"flights: expected at least 2 to split, got {len(flights)}")
    figures = np.array([float(key(flight)) for flight in flights])
    if not np.all(np.isfinite(figures)):
        raise ValueError(f"key: expected a finite figure for every flight, got {figures.tolist()}")
    order = np.argsort(figures, kind="stable")
    cut = min(max(round(checks.fraction_of(fraction) * len(flights)), 1), len(flights) - 1)
    return tuple(flights[i] for i in order[:cut]), tuple(flights[i] for i in order[cut:])


def split_by_speed(
    flights: Sequence[Recording], fraction: float = 0.5, *, percentile: float = 99.0
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Split flights into slower and faster ones, sorted by :meth:`Recording.speed`.

    Parameters
    ----------
    flights : sequence of Recording
        At least two.
    fraction : float
        Share of the flights among the slower, rounded, with at least one flight in each part.
    percentile : float
        Percentile of \\|x\\| that counts as the speed of a flight.

    Returns
    -------
    slower, faster : tuples of Recording

    Raises
    ------
    ValueError
        As for :func:`split_flights`, and if ``percentile`` is not from 0 to 100.

    Examples
    --------
    >>> from phyfilter_ctl.recording import Recording, split_by_speed
    >>> logs = [Recording.from_arrays(x=[[v], [v]], dt=0.1) for v in (2.0, -3.0, 1.0, 0.5)]
    >>> slower, faster = split_by_speed(logs)
    >>> [log.x[0, 0].item() for log in slower], [log.x[0, 0].item() for log in faster]
    ([0.5, 1.0], [2.0, -3.0])
    """
    return split_flights(flights, key=lambda flight: flight.speed(percentile), fraction=fraction)
