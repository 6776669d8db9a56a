"""PX4's ULog, by pyulog: topics with their instances, dropouts, UTC from the GPS."""

from __future__ import annotations

import io
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from . import units
from .clock import since, utc_of
from .contents import TIME, Column, Contents, Dropout, Table

if TYPE_CHECKING:
    from pyulog import ULog

_GPS = ("vehicle_gps_position", "sensor_gps")


class _Watched(io.BufferedReader):
    """A file that knows whether its last read was cut short, which pyulog takes for the end."""

    cut = False

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size:
            self.cut = 0 < len(data) < size
        return data


def read(path: Path, time_unit: str | None, time: str | None) -> Contents:
    """Topics by name, further instances as ``name[1]``; a file that was cut is read up to there."""
    from pyulog import ULog

    file = _Watched(io.FileIO(path))
    with file:
        log = ULog(file)
        cut = file.cut
    zero = int(log.start_timestamp)
    tables: dict[str, Table] = {}
    for data in log.data_list:
        name = data.name if data.multi_id == 0 else f"{data.name}[{data.multi_id}]"
        if "timestamp" in data.data:
            tables[name] = _table(data, zero)
    notes = ["cut off: the last message is incomplete"] if cut else []
    if log.file_corruption:
        notes.append("damaged: messages that could not be read are missing")
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
        out = np.empty((len(values["timestamp"]), len(names)))
        for k, name in enumerate(names):
            out[:, k] = since(values[name], zero, "us") if name in times else values[name]
        return out

    return Table(tuple(columns), since(values["timestamp"], zero, "us"), load)


def _column(topic: str, field: str, kind: str) -> Column:
    if kind == "uint64_t" and field.startswith("timestamp"):  # timestamp_sample and the like: the same clock
        return Column(field, "s", TIME)
    return Column(field, units.px4(topic, field), kind.removesuffix("_t"))


def _start(log: ULog, zero: int) -> datetime | None:
    """UTC of the zero, by the first GPS message that knows it."""
    for data in log.data_list:
        if data.name in _GPS and {"timestamp", "time_utc_usec"} <= set(data.data):
            known = np.flatnonzero(data.data["time_utc_usec"])
            if len(known):
                k = known[0]
                return utc_of(int(data.data["time_utc_usec"][k]) - int(data.data["timestamp"][k]) + zero)
    return None
