"""What a reader finds in a file: tables on one common zero of time, and what it has to say about them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from .._sections import FloatArray

TIME = "time"  # dtype of a column of times: read in s from the log's zero


@dataclass(frozen=True)
class Column:
    """One column of numbers; ``unit`` is empty where the file says none."""

    name: str
    unit: str = ""
    dtype: str = "float64"


@dataclass(frozen=True)
class Table:
    """A topic: ``load`` reads columns by name, shape (N, k), at ``times`` in s from the log's zero."""

    columns: tuple[Column, ...]
    times: FloatArray
    load: Callable[[Sequence[str]], FloatArray]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Dropout:
    """Data that the recorder lost.

    Attributes
    ----------
    time : float
        When it was noticed, s from the log's zero.
    duration : float
        For how long, s.
    """

    time: float
    duration: float


@dataclass(frozen=True)
class Contents:
    """What a file holds."""

    format: str
    tables: Mapping[str, Table]
    start: datetime | None = None
    notes: tuple[str, ...] = ()
    dropouts: tuple[Dropout, ...] = ()
