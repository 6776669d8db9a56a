"""Signals on clocks of their own: values at any times, and means of what they make over the steps of another clock.

Between its samples a signal keeps the last one ("hold") or goes straight to the next ("linear"); where samples lie
further apart than its ``gap`` it is not known, and neither is it before its first sample or long after its last.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter.windows import window_means

__all__ = ["Between", "Track", "step_means", "values_at"]

Between = Literal["hold", "linear"]
_ROUNDING = 1e-9  # of a step

Evaluated = Callable[[Mapping[str, FloatArray]], FloatArray]


@dataclass(frozen=True, eq=False)
class Track:
    """A signal on its own clock.

    Attributes
    ----------
    times : (n,) array
        s, increasing.
    values : (n, ...) array
        NaN where the log has none.
    between : {"hold", "linear"}
    gap : float
        s that a sample lasts at most.
    tail : float
        s that the last sample of a held signal lasts.
    """

    times: FloatArray
    values: FloatArray
    between: Between
    gap: float
    tail: float

    @property
    def end(self) -> float:
        """Until when it is known."""
        return float(self.times[-1]) + (self.tail if self.between == "hold" else 0.0)

    def at(self, when: FloatArray) -> FloatArray:
        """Values (m, ...) at some times, at a sample that sample."""
        k = np.searchsorted(self.times, when, side="right") - 1
        on = self.times[np.maximum(k, 0)] == when
        return np.where(self._column(on), self.values[np.maximum(k, 0)], self._between(k, when, when))

    def within(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (m, ...) just after the beginnings and before the ends of intervals that have no sample inside."""
        begin, end = times[:-1], times[1:]
        k = np.searchsorted(self.times, begin, side="right") - 1
        return self._between(k, begin, end), self._between(k, end, end)

    def _between(self, k: NDArray[np.intp], when: FloatArray, until: FloatArray) -> FloatArray:
        """Values after sample k and before the next one, which must be near enough."""
        last = len(self.times) - 1
        left, right = np.clip(k, 0, last), np.clip(k + 1, 0, last)
        room = self.times[right] - self.times[left]
        known = (k >= 0) & np.where(k < last, room <= self.gap, until <= self.end)
        if self.between == "hold":
            found = self.values[left]
        else:
            known &= k < last
            part = self._column((when - self.times[left]) / np.where(room > 0.0, room, 1.0))
            found = self.values[left] + part * (self.values[right] - self.values[left])
        return np.where(self._column(known), found, np.nan)

    def _column(self, values: NDArray[Any]) -> NDArray[Any]:
        """One entry a row of the values."""
        return values.reshape(-1, *[1] * (self.values.ndim - 1))


def values_at(tracks: Mapping[str, Track], evaluate: Evaluated, when: FloatArray) -> FloatArray:
    """What an expression is at some times, (m, ...)."""
    found = evaluate({name: track.at(when) for name, track in tracks.items()})
    return np.broadcast_to(found, (len(when), *found.shape[1:]))


def step_means(tracks: Mapping[str, Track], evaluate: Evaluated, ends: FloatArray) -> FloatArray:
    """Means (m, ...) of an expression over the steps between ``ends`` (m + 1,), NaN where part of one is unknown.

    On the times of all signals together held signals are constant and linear ones straight between two instants;
    what is made of them is taken as straight there, which is exact where it is affine in the linear ones.
    """
    inner = [t.times[(t.times > ends[0]) & (t.times < ends[-1])] for t in tracks.values()]
    limits = [np.array([end]) for t in tracks.values() if ends[0] < (end := t.end) < ends[-1]]
    times = np.unique(np.concatenate([ends, *inner, *limits]))
    pairs = {name: track.within(times) for name, track in tracks.items()}
    first, last = (evaluate({name: pair[i] for name, pair in pairs.items()}) for i in (0, 1))
    first, last = (np.broadcast_to(part, (len(times) - 1, *part.shape[1:])) for part in (first, last))
    known = np.isfinite(first) & np.isfinite(last)
    if known.all():
        return np.asarray(window_means(times, first, last, ends[:-1], ends[1:]), dtype=float)
    means = window_means(times, np.where(known, first, 0.0), np.where(known, last, 0.0), ends[:-1], ends[1:])
    holes = window_means(times, ~known + 0.0, ~known + 0.0, ends[:-1], ends[1:])
    return np.where(holes > _ROUNDING, np.nan, means)
