"""Signals of a response by name: one entry, or all entries of a vector."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Any

import control as ct
import numpy as np
from control.iosys import NamedSignal
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.wiring import signal_names

__all__ = ["BatchSignals", "Signals", "SignalsByName", "SimulationBatch", "rows_of"]


def rows_of(labels: Sequence[str], name: str) -> int | slice | list[int]:
    """Where a signal is: the entry of that label, else all entries of the vector, ``r`` for r[0], r[1], ...

    Parameters
    ----------
    labels : sequence of str
    name : str

    Raises
    ------
    ValueError
        For an unknown name; the message has those close to it.

    Examples
    --------
    >>> labels = ["r[0]", "r[1]", "t"]
    >>> rows_of(labels, "r"), rows_of(labels, "r[1]"), rows_of(labels, "t")
    (slice(0, 2, None), 1, 2)
    """
    if name in labels:
        return labels.index(name)
    at = [i for i, label in enumerate(labels) if re.sub(r"\[[\d,]+\]$", "", label) == name]
    if not at:
        known = [*signal_names(labels), *labels]
        close = difflib.get_close_matches(name, dict.fromkeys(known), 3)
        said = f"close to it: {', '.join(close)}" if close else f"known: {', '.join(signal_names(labels))}"
        raise ValueError(f"unknown signal name '{name}'; {said}")
    return slice(at[0], at[-1] + 1) if at[-1] - at[0] == len(at) - 1 else at


def _rows(labels: Sequence[str], key: object) -> Any:
    """The key with numbers for names."""
    if isinstance(key, str):
        return rows_of(labels, key)
    if isinstance(key, list) and any(isinstance(entry, str) for entry in key):
        every = np.arange(len(labels))
        parts = [np.atleast_1d(every[rows_of(labels, e) if isinstance(e, str) else e]) for e in key]
        return np.concatenate(parts).tolist()
    return key


class Signals(NamedSignal):
    """python-control's named signal, (n, N): ``["r"]`` is a whole vector, (k, N), ``["r[0]"]`` one entry, (N,)."""

    def __getitem__(self, key: Any) -> Any:
        labels = self.signal_labels
        first = key[0] if isinstance(key, tuple) and key else key
        if not labels or not isinstance(first, str | list) or (first is key and first in labels):
            return super().__getitem__(key)
        rows = _rows(labels, first)
        if rows is first:
            return super().__getitem__(key)
        if np.ndim(self) < 2:  # squeezed: the only signal
            return super().__getitem__(None if isinstance(first, str) and first is key else key)
        found = super().__getitem__(rows if first is key else (rows, *key[1:]))
        if isinstance(found, Signals) and not isinstance(rows, int):
            found.signal_labels = labels[rows] if isinstance(rows, slice) else [labels[i] for i in rows]
            found.data_shape = found.shape
        return found


class BatchSignals(np.ndarray):
    """Signals of all runs of a batch, (B, n, N): ``["r"]`` is (B, k, N), ``["r[0]"]`` (B, N)."""

    signal_labels: list[str]

    def __array_finalize__(self, obj: object) -> None:
        self.signal_labels = getattr(obj, "signal_labels", [])

    def __getitem__(self, key: Any) -> Any:
        rows = _rows(self.signal_labels, key)
        return super().__getitem__(key) if rows is key else np.asarray(self)[:, rows]


class SignalsByName(ct.TimeResponseData):
    """python-control's response with signals as :class:`Signals`."""

    @property
    def outputs(self) -> NamedSignal:
        return _named(super().outputs)

    @property
    def states(self) -> NamedSignal:
        return _named(super().states)

    @property
    def inputs(self) -> NamedSignal | None:
        found = super().inputs
        return None if found is None else _named(found)


def _named(signals: NamedSignal) -> Signals:
    return Signals(np.asarray(signals), signals.signal_labels, signals.trace_labels)


class SimulationBatch(ct.TimeResponseList):
    """Responses of B runs: a ``control.TimeResponseList``, which also has the signals of all runs in one array.

    Parameters
    ----------
    iterable : iterable of SimulationResponse
    """

    @property
    def outputs(self) -> NDArray[np.float64]:
        """(B, n_y, N) array; by name (B, N), or (B, k, N) for a whole vector."""
        return _stacked([run.y for run in self], self[0].output_labels)

    @property
    def states(self) -> NDArray[np.float64]:
        """(B, n_x, N) array, by name as ``outputs``."""
        return _stacked([run.x for run in self], self[0].state_labels)

    @property
    def inputs(self) -> NDArray[np.float64]:
        """(B, n_u, N) array, by name as ``outputs``."""
        return _stacked([run.u for run in self], self[0].input_labels)


def _stacked(tables: Sequence[FloatArray], labels: Sequence[str]) -> BatchSignals:
    found = np.stack(tables).view(BatchSignals)
    found.signal_labels = list(labels)
    return found
