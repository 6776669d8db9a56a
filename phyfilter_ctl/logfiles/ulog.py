"""PX4's ULog, by pyulog: topics with their instances, dropouts, UTC from the GPS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from . import units
from .clock import since, utc_of
from .contents import TIME, Column, Contents, Dropout, Table
from .records import side_by_side

if TYPE_CHECKING:
    from pyulog import ULog

_LARGEST = 10_000  # bytes of a message that pyulog believes
_MOST = 0xFFFF  # bytes of a message
_HEADER = 16  # bytes before the first message
_GPS = ("vehicle_gps_position", "sensor_gps")


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """Topics by name, further instances as ``name[1]``; a file that was cut is read up to there."""
    from pyulog import ULog

    _check_definitions(path)
    with path.open("rb") as file:  # which pyulog leaves open where it fails
        log = ULog(file)
    zero = int(log.start_timestamp)
    tables: dict[str, Table] = {}
    for data in log.data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
        if "timestamp" in data.data:
            tables[name] = _table(data, zero)
    notes: list[str] = []
    if log.file_corruption:
        notes.append("damaged: messages that could not be read are missing")
    elif _is_cut(path):
        notes.append("cut off: the last message is incomplete")
    dropouts = tuple(Dropout((int(d.timestamp) - zero) / 1e6, d.duration / 1e3) for d in log.dropouts)
    return Contents("ulog", tables, _start(log, zero), tuple(notes), dropouts)


def _table(data: ULog.Data, zero: int) -> Table:
    values: dict[str, NDArray[np.generic]] = data.data
    columns = [
        _column(data.name, field.field_name, field.type_str)
        for field in data.field_data
        if field.field_name != "timestamp"
        and not field.field_name.rpartition(".")[2].startswith("_padding")
        and field.type_str != "char"
    ]
    times = {column.name for column in columns if column.dtype == TIME}

    def load(names: Sequence[str]) -> FloatArray:
        return side_by_side([since(values[n], zero, "us") if n in times else values[n] for n in names])

    return Table(tuple(columns), since(values["timestamp"], zero, "us"), load)


def _column(topic: str, field: str, kind: str) -> Column:
    if kind == "uint64_t" and field.startswith("timestamp"):  # timestamp_sample and the like: the same clock
        return Column(field, "s", TIME)
    return Column(field, units.px4(topic, field), kind.removesuffix("_t"))


def _check_definitions(path: Path) -> None:
    """Refuse a file that ends before its data begin: on some of them pyulog reads the end for ever.

    And topics of more elements than a message has bytes, of which pyulog would make a list each.
    """
    formats: dict[str, list[tuple[str, int]]] = {}
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        at = _HEADER
        while at + 3 <= len(data):
            size, kind = data[at] | data[at + 1] << 8, data[at + 2]
            if kind in b"ALC":
                break
            if at + 3 + size > len(data):
                at = len(data)
                break
            if kind in b"F":
                name, fields, *_ = [*data[at + 3 : at + 3 + size].decode("utf-8", "replace").split(":"), ""]
                formats[name] = [_type(field) for field in fields.split(";") if field]
            damaged = kind not in b"FIMPQB" and (kind == 0 or size == 0 or size > _LARGEST)
            at += 1 if damaged else 3 + size  # as pyulog goes on
        if at + 3 > len(data):
            raise ValueError("cut off or damaged within its definitions, before any data")
    for name in formats:
        if _elements(name, formats, _MOST) > _MOST:
            raise ValueError(
                f"format {name[:60]!r}: expected at most {_MOST} elements, as a message has bytes"
            )


def _type(field: str) -> tuple[str, int]:
    """Kind and number of a field such as ``float[4] q``."""
    kind, _, length = field.partition(" ")[0].partition("[")
    return kind, int(length.partition("]")[0] or 1)


def _elements(name: str, formats: Mapping[str, Sequence[tuple[str, int]]], most: int) -> int:
    """Elements of a format with those of the formats in it; one that holds itself has more than any."""
    count = 0
    for kind, length in formats[name]:
        count += length * (
            _elements(kind, formats, most - 1 - count) if kind in formats and count < most else 1
        )
        if count > most:
            break
    return max(count, 1)


def _is_cut(path: Path) -> bool:
    """Whether the messages end beyond the file, which pyulog takes for its end: each begins with its length."""
    at = _HEADER
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        end = len(data) - 3
        while at <= end:
            at += 3 + data[at] + (data[at + 1] << 8)
        return at != len(data)


def _start(log: ULog, zero: int) -> datetime | None:
    """UTC of the zero, by the first GPS message that knows it."""
    for data in log.data_list:
        if data.name in _GPS and {"timestamp", "time_utc_usec"} <= set(data.data):
            known = np.flatnonzero(data.data["time_utc_usec"])
            if len(known):
                k = known[0]
                return utc_of(int(data.data["time_utc_usec"][k]) - int(data.data["timestamp"][k]) + zero)
    return None
