"""When what happens in a run: instants of the sampled blocks, times of the record, and steps between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray

__all__ = ["Nodes", "Steps", "nodes", "steps_between"]

# Instants coincide within this part of the shorter period (FlatModel), plus what k * period is off by rounding.
_COINCIDE = 1e-9
_TIME_ROUNDING = 4 * np.finfo(float).eps
# Nodes handled at once: enough to hide the cost of numpy, small enough for the cache.
WINDOW = 4000


class Nodes(NamedTuple):
    """Times at which something happens besides integration."""

    times: FloatArray  # (J + 1,): J nodes, and where the last of them leads to
    due: NDArray[np.bool_]  # (J, tasks)
    row: NDArray[np.intp]  # (J,) row of the record, -1 for none
    left: NDArray[np.intp]  # (J,) row of the last time at or before it


class Steps(NamedTuple):
    """Steps of integration, each inside one interval between nodes."""

    node: NDArray[np.intp]  # (S,) the node whose interval it is in
    first: NDArray[np.bool_]  # (S,) starts at the node itself
    times: FloatArray  # (S,)
    ends: FloatArray  # (S,)


def nodes(times: FloatArray, periods: Sequence[float], window: int = WINDOW) -> Iterator[Nodes]:
    """Nodes of a run in windows of about ``window``; together they cover every node once."""
    clock = _Clock(times, periods)
    while True:
        at, due, row = clock.upto(clock.horizon(window))
        # The last node of a window is executed by the next one, which knows where it leads.
        last = clock.finished
        left = np.maximum.accumulate(np.where(row >= 0, row, clock.left))
        if last:
            yield Nodes(np.append(at, at[-1]), due, row, left)
            return
        yield Nodes(at, due[:-1], row[:-1], left[:-1])
        clock.hold_back(at[-1], due[-1], int(row[-1]), int(left[-1]))


@dataclass(eq=False)
class _Clock:
    """Counts the events of a run: ticks k * period after its start, and its times."""

    times: FloatArray
    periods: Sequence[float]

    def __post_init__(self) -> None:
        self.next = np.zeros(len(self.periods), dtype=np.int64)
        self.row = 0
        self.left = 0
        self.held: tuple[float, NDArray[np.bool_], int] | None = None

    @property
    def finished(self) -> bool:
        return self.row == len(self.times)

    def horizon(self, window: int) -> float:
        start = self.times[0]
        ends = [start + (k + window) * period for k, period in zip(self.next, self.periods, strict=True)]
        return float(min([*ends, self.times[min(self.row + window, len(self.times) - 1)]]))

    def upto(self, horizon: float) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.intp]]:
        """Events up to the horizon, and those that coincide with it, as nodes."""
        start, tasks = self.times[0], len(self.periods)
        slack = _TIME_ROUNDING * max(abs(horizon), abs(start))
        shortest = min(self.periods, default=0.0)
        when, kind = [], []
        for i, period in enumerate(self.periods):
            limit = horizon + _COINCIDE * period + slack
            stop = max(int((limit - start) / period) + 2, int(self.next[i]))
            ticks = start + period * np.arange(self.next[i], stop)
            ticks = ticks[ticks <= limit]
            self.next[i] += len(ticks)
            when.append(ticks)
            kind.append(np.full(len(ticks), i))
        stop = int(np.searchsorted(self.times, horizon + _COINCIDE * shortest + slack, side="right"))
        when.append(self.times[self.row : stop])
        kind.append(np.full(stop - self.row, tasks))
        rows = np.arange(self.row, stop)
        self.row = stop
        return self._grouped(np.concatenate(when), np.concatenate(kind), rows, slack)

    def _grouped(
        self, when: FloatArray, kind: NDArray[np.intp], rows: NDArray[np.intp], slack: float
    ) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.intp]]:
        tasks = len(self.periods)
        order = np.argsort(when, kind="stable")
        when, kind = when[order], kind[order]
        width = np.append(_COINCIDE * np.asarray(self.periods, dtype=float), np.inf)[kind]
        apart = np.ones(len(when), dtype=bool)
        tolerance = np.minimum(width[1:], width[:-1])
        # Two times of the record never fall together: they are further apart than any coincidence.
        tolerance[np.isinf(tolerance)] = -1.0
        apart[1:] = np.diff(when) > tolerance + np.where(tolerance < 0.0, 0.0, slack)
        group = np.cumsum(apart) - 1
        at = when[apart].copy()
        due = np.zeros((len(at), tasks), dtype=bool)
        tick = kind < tasks
        due[group[tick], kind[tick]] = True
        row = np.full(len(at), -1, dtype=np.intp)
        row[group[~tick]] = rows
        at[group[~tick]] = self.times[rows]
        if self.held is not None:
            time, held_due, held_row = self.held
            at, due = np.insert(at, 0, time), np.vstack([held_due[None], due])
            row = np.insert(row, 0, held_row)
            self.held = None
        return at, due, row

    def hold_back(self, time: float, due: NDArray[np.bool_], row: int, left: int) -> None:
        self.held = (time, due, row)
        self.left = left


def steps_between(window: Nodes, longest: float | None, size: int = WINDOW) -> Iterator[Steps]:
    """Equal steps no longer than ``longest`` from node to node, about ``size`` at a time.

    The last node of a run leads nowhere: it gets one step of no length, so that it is executed.
    """
    length = np.diff(window.times)
    count = np.ones(len(length), dtype=np.int64)
    if longest is not None:
        count = np.maximum(np.ceil(length / longest - _COINCIDE), 1.0).astype(np.int64)
    ends = np.cumsum(count)
    for start in range(0, int(ends[-1]), size):
        index = np.arange(start, min(start + size, int(ends[-1])))
        node = np.searchsorted(ends, index, side="right")
        part = index - (ends[node] - count[node])
        begin, span, n = window.times[node], length[node], count[node]
        times = begin + span * part / n
        later = np.where(part + 1 == n, window.times[node + 1], begin + span * (part + 1) / n)
        yield Steps(node, part == 0, times, later)
