"""Long recordings as they are looked at: their peaks by levels, and the estimate where it is drawn."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..filter import Sampling
from ..recording import Recording
from .designs import Design

__all__ = ["Peaks", "Views", "at_once", "run"]

_AT_ONCE = 300_000  # samples that the filter runs over for one answer; fewer where the steps differ
_UNEVEN = 20  # times slower: those are summed sample by sample
_GROUP = 64  # samples whose least and largest stand for them
_COARSEST = 4000  # candidates of the last level
_FINER = 16  # candidates for each that is drawn: one that straddles an edge is off by so much of an interval
_FADES = 40.0  # times the slowest time constant: what was before is lost in the noise of rounding

Indices = NDArray[np.intp]
Errors = tuple[float | None, float | None]


def _peaks_within(values: FloatArray, size: int) -> Indices:
    """Of every ``size`` samples in a row the least and the largest, in order; the rest at the end counts too."""
    groups = len(values) // size
    table = values[: groups * size].reshape(groups, size)
    start = size * np.arange(groups)
    ends = np.stack([start + table.argmin(axis=1), start + table.argmax(axis=1)], axis=1)
    rest = values[groups * size :]
    last = groups * size + np.array([rest.argmin(), rest.argmax()] if len(rest) else [], dtype=np.intp)
    return np.unique(np.append(ends.ravel(), last))


@dataclass(frozen=True, eq=False)
class Peaks:
    """A series and, by levels, which of its samples are the least and the largest of their group.

    Parameters
    ----------
    values : (N,) array
    levels : tuple of arrays
        Ascending indices, each level about a thirty-second of the one before; no extremum is lost.
    """

    values: FloatArray
    levels: tuple[Indices, ...]

    @classmethod
    def of(cls, values: FloatArray) -> Peaks:
        """Levels of a series, one pass over it.

        Examples
        --------
        >>> values = np.zeros(500_000)
        >>> values[123_456] = 1.0
        >>> 123_456 in Peaks.of(values).drawn(0, 500_000, 100)
        True
        """
        levels: list[Indices] = []
        at = np.arange(len(values))
        while len(at) > _COARSEST:
            at = at[_peaks_within(values[at], _GROUP)]
            levels.append(at)
        return cls(values, tuple(levels))

    def drawn(self, first: int, last: int, most: int) -> Indices:
        """At most ``most`` samples from ``first`` to before ``last`` that show every peak of the view.

        Parameters
        ----------
        first, last, most : int
        """
        if last - first <= most:
            return np.arange(first, last)
        candidates = np.arange(first, last) if last - first <= _FINER * _GROUP * most else None
        for level in self.levels:
            low, high = np.searchsorted(level, [first, last]).tolist()
            if candidates is None or high - low >= _FINER * most:
                candidates = level[low:high]
        assert candidates is not None  # a series of that length has levels
        return candidates[_peaks_within(self.values[candidates], -(-2 * len(candidates) // (most - 2)))]


def run(log: Recording, design: Design, channel: int, seen: slice) -> FloatArray:
    """f_hat of one channel over some samples, as if the filter had run from the beginning.

    It starts early enough before ``seen`` for its start to have faded.

    Parameters
    ----------
    log : Recording
    design : Design
    channel : int
    seen : slice
        Of first and last sample.

    Raises
    ------
    ValueError
        If forward Euler diverges at the log's step.
    """
    slowest = -float(np.max(design.filter.poles.real))
    early = int(np.searchsorted(log.times, log.times[seen.start] - _FADES / slowest))
    part = slice(early, seen.stop)
    # An inertia may couple the channels; without one each stands alone.
    inertia = own_inertia(design, log) if log.inertia is None else log.inertia
    pick = slice(channel, channel + 1) if inertia is None else slice(None)
    if log.inertia is not None and part != slice(0, log.n):
        inertia = log.segment(part.start, part.stop).inertia
    f_hat = design.sampled_at(log.dt).run(
        log.x[part, pick],
        None if log.g is None else log.g[part, pick],
        None if log.f_theta is None else log.f_theta[part, pick],
        inertia,
        None if log.is_uniform else log.times[part],
    )
    return np.asarray(f_hat[seen.start - early :, 0 if inertia is None else channel], dtype=float)


def own_inertia(design: Design, log: Recording) -> FloatArray | None:
    """The design's constant inertia, where it has one of the log's size.

    Parameters
    ----------
    design : Design
    log : Recording
    """
    sampling = Sampling(log.dt, **design.signals.options)
    fits = sampling.n_x in (None, log.n_x)
    return sampling.inertia if fits and isinstance(sampling.inertia, np.ndarray) else None


class Views:
    """What has been computed of the open recording, for the design that was last asked about."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._log: Recording | None = None
        self._peaks: dict[tuple[str, int], Peaks] = {}
        self._key = ""
        self._whole: Peaks | None = None
        self._work: threading.Thread | None = None
        self._error: ValueError | None = None
        self._scored: tuple[str, Errors] = "", (None, None)

    def peaks(self, log: Recording, signal: str, channel: int) -> Peaks:
        """Levels of a signal of the recording, computed once.

        Parameters
        ----------
        log : Recording
        signal : {"label", "f_theta"}
        channel : int
        """
        self._turn_to(log)
        key = signal, channel
        if key not in self._peaks:
            self._peaks[key] = Peaks.of(np.ascontiguousarray(getattr(log, signal)[:, channel]))
        return self._peaks[key]

    def whole(self, log: Recording, design: Design, channel: int) -> Peaks | None:
        """f_hat over all of a long recording; None while it is computed in the background.

        Parameters
        ----------
        log : Recording
        design : Design
        channel : int

        Raises
        ------
        ValueError
            If forward Euler diverges at the log's step.
        """
        self._turn_to(log)
        key = _key(design, channel)
        with self._lock:
            if self._key == key:
                if self._error is not None:
                    raise self._error
                return self._whole
            if self._work is not None and self._work.is_alive():
                return None  # of the design before; the next question finds it done
            self._key, self._whole, self._error = key, None, None
            self._work = threading.Thread(
                target=self._run, args=(log, design, channel, key), name="phyfilter-estimate", daemon=True
            )
            self._work.start()
        return None

    def ready(self, log: Recording, design: Design, channel: int) -> Peaks | None:
        """The same if it has been computed already; nothing is begun.

        Parameters
        ----------
        log : Recording
        design : Design
        channel : int
        """
        self._turn_to(log)
        key = _key(design, channel)
        with self._lock:
            return self._whole if self._key == key else None

    def errors(self, log: Recording, design: Design, channel: int, found: Callable[[], Errors]) -> Errors:
        """RMSE of f_hat and of the model over the whole log, ``found`` once a design.

        Parameters
        ----------
        log : Recording
        design : Design
        channel : int
        found : callable
        """
        self._turn_to(log)
        key = _key(design, channel)
        if self._scored[0] != key:
            self._scored = key, found()
        return self._scored[1]

    def _run(self, log: Recording, design: Design, channel: int, key: str) -> None:
        found, problem = None, None
        try:
            found = Peaks.of(run(log, design, channel, slice(0, log.n)))
        except ValueError as error:
            problem = error
        except Exception as error:  # a thread must not die in silence
            problem = ValueError(f"the estimate failed ({type(error).__name__}): look at a part of the log")
        with self._lock:
            if self._key == key and self._log is log:
                self._whole, self._error = found, problem

    def _turn_to(self, log: Recording) -> None:
        with self._lock:
            if self._log is not log:
                self._log, self._peaks = log, {}
                self._key, self._whole, self._error = "", None, None
                self._scored = "", (None, None)


def _key(design: Design, channel: int) -> str:
    """What f_hat depends on."""
    return json.dumps([{**design.as_json(), "assume": None, "limits": None}, channel])


def at_once(log: Recording) -> int:
    """Samples of a recording that are run over for one answer."""
    return _AT_ONCE if log.is_uniform else _AT_ONCE // _UNEVEN
