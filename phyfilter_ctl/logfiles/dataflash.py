"""ArduPilot's DataFlash: indexed and described by pymavlink, its records decoded all at once.

Units and multipliers are those of the messages UNIT, MULT and FMTU. Values are multiplied, so that m is m and not cm;
a unit that is not SI (deg, Gauss) stays what it is.
"""

from __future__ import annotations

import os
from bisect import bisect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from .clock import since
from .contents import Column, Contents, Table
from .records import gathered, layout_of, side_by_side

if TYPE_CHECKING:
    from pymavlink.DFReader import DFFormat, DFReader_binary

# Format characters: numpy's type, and what the number is multiplied with.
_NUMBERS: dict[str, tuple[str, float]] = {
    **{"b": ("i1", 1.0), "B": ("u1", 1.0), "M": ("u1", 1.0), "h": ("i2", 1.0), "H": ("u2", 1.0)},
    **{"i": ("i4", 1.0), "I": ("u4", 1.0), "q": ("i8", 1.0), "Q": ("u8", 1.0)},
    **{"g": ("f2", 1.0), "f": ("f4", 1.0), "d": ("f8", 1.0)},
    **{"c": ("i2", 1e-2), "C": ("u2", 1e-2), "e": ("i4", 1e-2), "E": ("u4", 1e-2), "L": ("i4", 1e-7)},
}
_OTHERS = {"n": "S4", "N": "S16", "Z": "S64", "a": "V64"}  # text; 32 numbers of 16 bits
_KINDS = {**_OTHERS, **{character: kind for character, (kind, _) in _NUMBERS.items()}}
_CLOCKS = {"TimeUS": "us", "TimeMS": "ms"}
_HEAD = 3  # bytes before the fields
_GPS_ZERO = datetime(1980, 1, 6, tzinfo=UTC)
# From when on GPS has been ahead of UTC by how many seconds (IERS, Bulletin C).
_LEAPS = (
    (datetime(2009, 1, 1), 15),
    (datetime(2012, 7, 1), 16),
    (datetime(2015, 7, 1), 17),
    (datetime(2017, 1, 1), 18),
)


@dataclass(frozen=True)
class _Message:
    rows: NDArray[np.void]
    clock: str
    columns: tuple[Column, ...]
    factors: dict[str, float]


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """Messages by name, instances as ``IMU[0]``; a file that was cut is read up to there."""
    from pymavlink.DFReader import DFReader_binary

    class Indexed(DFReader_binary):
        def __init__(self, filename: str) -> None:
            try:
                super().__init__(filename)
            except BaseException:
                self.filehandle.close()
                raise

        def init_arrays_fast(self, progress_callback: Callable[[int], None] | None = None) -> None:
            with _silenced():
                super().init_arrays_fast(progress_callback)

        def init_clock(self) -> None:
            """Nothing: it would read all messages one by one."""

    data = np.fromfile(path, np.uint8)
    with Indexed(str(path)) as log:
        found = _messages(log, data)
        notes = _notes(log, len(data))
    clocks = {message.clock for message in found.values()}
    if len(clocks) > 1:
        raise ValueError(f"its messages count time by {' and '.join(sorted(clocks))}: no common clock")
    zero = min((int(message.rows[message.clock][0]) for message in found.values()), default=0)
    tables = {name: _table(message, zero) for name, message in found.items()}
    return Contents("dataflash", tables, _start(found, zero), notes)


@contextmanager
def _silenced() -> Iterator[None]:
    """No lines on the process's standard error: compiled code writes one for every byte that is no message."""
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _messages(log: DFReader_binary, data: NDArray[np.uint8]) -> dict[str, _Message]:
    forms = {form.name: (kind, form) for kind, form in log.formats.items()}
    ids: dict[int, tuple[str, str]] = {}
    if "FMTU" in forms:
        for row in _rows(log, *forms["FMTU"], data):
            ids[int(row["FmtType"])] = row["UnitIds"].decode("latin-1"), row["MultIds"].decode("latin-1")
    found: dict[str, _Message] = {}
    for name, (kind, form) in forms.items():
        clock = next((clock for clock in _CLOCKS if clock in form.columns), "")
        if not clock or name == "FMTU" or not len(rows := _rows(log, kind, form, data)):
            continue
        columns, factors = _columns(log, form, clock, *ids.get(kind, ("", "")))
        by = form.instance_field
        for instance in [None] if by is None else np.unique(rows[by]):
            text = instance.decode("latin-1") if isinstance(instance, bytes) else instance
            own = rows if by is None else rows[rows[by] == instance]
            found[f"{name}[{text}]" if by else str(name)] = _Message(own, clock, columns, factors)
    return found


def _rows(log: DFReader_binary, kind: int, form: DFFormat, data: NDArray[np.uint8]) -> NDArray[np.void]:
    offsets = np.asarray(log.offsets[kind], np.int64)
    if not len(offsets):
        return np.empty(0, np.dtype([]))
    layout = layout_of(form.columns, [_KINDS[character] for character in form.format])
    if layout.itemsize + _HEAD != form.len:
        raise ValueError(
            f"message {form.name}: expected {form.len} bytes, its format makes {layout.itemsize + _HEAD}"
        )
    return gathered(data, offsets[offsets + form.len <= len(data)] + _HEAD, layout)


def _columns(
    log: DFReader_binary, form: DFFormat, clock: str, units: str, multipliers: str
) -> tuple[tuple[Column, ...], dict[str, float]]:
    """Columns of numbers, and what to multiply each with."""
    columns: list[Column] = []
    factors: dict[str, float] = {}
    for k, (name, character) in enumerate(zip(form.columns, form.format, strict=True)):
        if character not in _NUMBERS or name == clock:
            continue
        kind, factor = _NUMBERS[character]
        said = log.mult_lookup.get(multipliers[k : k + 1], 0.0)
        factors[name] = said if factor == 1.0 and said else factor  # 0 says that there is none
        unit = log.unit_lookup.get(units[k : k + 1], "")
        columns.append(Column(name, "" if unit in ("UNKNOWN", "instance") else unit, np.dtype(kind).name))
    return tuple(columns), factors


def _table(message: _Message, zero: int) -> Table:
    rows = message.rows

    def load(names: Sequence[str]) -> FloatArray:
        out = side_by_side([rows[name] for name in names])
        for k, name in enumerate(names):
            factor = message.factors[name]
            out[:, k] = out[:, k] / round(1.0 / factor) if factor in _TENTHS else out[:, k] * factor
        return out

    return Table(message.columns, since(rows[message.clock], zero, _CLOCKS[message.clock]), load)


# Divided by, for 0.01 itself is rounded.
_TENTHS = {float(f"1e-{k}") for k in range(1, 10)}


def _notes(log: DFReader_binary, size: int) -> tuple[str, ...]:
    ends = {kind: np.asarray(log.offsets[kind], np.int64) + form.len for kind, form in log.formats.items()}
    cut = any(len(end) and end[-1] > size for end in ends.values())
    whole = sum(int(np.count_nonzero(end <= size)) * log.formats[kind].len for kind, end in ends.items())
    if cut:
        return ("cut off: the last message is incomplete",)
    return (f"{size - whole} bytes are no messages",) if size > whole else ()


def _start(found: dict[str, _Message], zero: int) -> datetime | None:
    """UTC of the zero, by the first GPS message that knows it."""
    for name, message in found.items():
        rows = message.rows
        if name.partition("[")[0] != "GPS" or not {"GWk", "GMS"} <= set(rows.dtype.names or ()):
            continue
        known = np.flatnonzero(rows["GWk"] > 0)
        if not len(known):
            continue
        row = rows[known[0]]
        gps = _GPS_ZERO + timedelta(weeks=int(row["GWk"]), milliseconds=int(row["GMS"]))
        leaps = _LEAPS[max(bisect(_LEAPS, (gps.replace(tzinfo=None), 99)) - 1, 0)][1]
        later = float(since(rows[message.clock][known[:1]], zero, _CLOCKS[message.clock])[0])
        return gps - timedelta(seconds=leaps + later)
    return None
