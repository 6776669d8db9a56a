"""Logs of the Crazyflie's uSD card deck: events of fixed layout, each with a time.

The format is that of the firmware's documentation of the deck and its decoder ``tools/usdlog/cfusdlog.py``: 0xBC,
version and number of event types; for each its number, name and variables as ``name(type)``, types of Python's struct;
then events with a time in ms (version 1) or us (version 2); last the CRC-32 of all before.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from . import units
from .clock import since
from .contents import Column, Contents, Table
from .records import gathered, layout_of, side_by_side

_KINDS = {
    **{"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "q": "i8", "Q": "u8"},
    **{"e": "f2", "f": "f4", "d": "f8"},
}
_TIMES = {1: ("u4", "ms"), 2: ("u8", "us")}
_ID, _TIME = "event number", "time"  # names that no variable can have


@dataclass
class _Event:
    name: str
    layout: np.dtype[np.void]
    offsets: list[int] = field(default_factory=list)


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """Events by name; a file that was cut is read up to there."""
    data = path.read_bytes()
    version, kinds = struct.unpack_from("<HH", data, 1)
    if version not in _TIMES:
        raise ValueError(f"version {version} of the Crazyflie's log is not known, only 1 and 2")
    whole = len(data) > 9 and zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little")
    events, start = _events(data, kinds, _TIMES[version][0])
    end = _find(data, start, len(data) - 4 if whole else len(data), events)
    notes = (
        ()
        if whole
        else (f"its checksum is wrong: cut off or damaged; {len(data) - end} bytes are left unread",)
    )
    raw = np.frombuffer(data, np.uint8)
    found = {e.name: gathered(raw, np.array(e.offsets), e.layout) for e in events.values() if e.offsets}
    zero = min((int(rows[_TIME][0]) for rows in found.values()), default=0)
    return Contents(
        "crazyflie", {name: _table(rows, zero, version) for name, rows in found.items()}, None, notes
    )


def _events(data: bytes, count: int, time: str) -> tuple[dict[int, _Event], int]:
    """Types of events by number, and where the events begin."""
    events: dict[int, _Event] = {}
    at = 5
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        name, at = _text(data, at + 2)
        (variables,) = struct.unpack_from("<H", data, at)
        at += 2
        names, kinds = [_ID, _TIME], ["u2", time]
        for _ in range(variables):
            text, at = _text(data, at)
            if text[-3:-2] != "(" or text[-2] not in _KINDS:
                raise ValueError(f"event {name!r}: expected a variable as name(type), got {text!r}")
            names.append(text[:-3])
            kinds.append(_KINDS[text[-2]])
        events[number] = _Event(name, layout_of(names, kinds))
    return events, at


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(0, at)
    return data[at:end].decode("utf-8"), end + 1


def _find(data: bytes, at: int, stop: int, events: dict[int, _Event]) -> int:
    """Note where each event stands; return the end of the last one that is whole."""
    while at + 2 <= stop:
        event = events.get(data[at] | data[at + 1] << 8)
        if event is None or at + event.layout.itemsize > stop:
            break
        event.offsets.append(at)
        at += event.layout.itemsize
    return at


def _table(rows: NDArray[np.void], zero: int, version: int) -> Table:
    names = [name for name in rows.dtype.names or () if name not in (_ID, _TIME)]
    columns = tuple(Column(name, units.crazyflie(name), rows.dtype[name].name) for name in names)

    def load(wanted: Sequence[str]) -> FloatArray:
        return side_by_side([rows[name] for name in wanted])

    return Table(columns, since(rows[_TIME], zero, _TIMES[version][1]), load)
