"""CSV of any dialect as a log: one table with a column of times."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..recording.csvfile import CsvFile, dialect, open_csv
from ..recording.header import unit_in
from .clock import column_times, time_column
from .contents import Column, Contents, Table
from .sizes import check_size

TABLE = "table"  # the one topic of a table

_CALENDAR = re.compile(r"(\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:\.\d{1,9})?)?) ?(Z|UTC|[+-]\d\d:?\d\d)?")


def read(path: Path, time_unit: str | None, time: str | None, largest: int) -> Contents:
    """The table; columns of text are left out, empty fields are NaN."""
    file = open_csv(path, *dialect(path))
    check_size(8 * file.lines, largest, "a column")
    numeric = file.numeric()
    texts = [name for name in file.header if name not in numeric]
    calendar = [name for name in texts if _CALENDAR.fullmatch(file.first(name))]
    chosen = time_column(file.header, calendar, time)
    values, utc = _times(file, chosen, chosen in numeric)
    found = column_times(chosen, values, time_unit, utc=utc)
    columns = tuple(Column(name, unit_in(name)) for name in numeric if name != chosen)
    left_out = [name for name in texts if name != chosen]
    notes = (f"left out, as text: {', '.join(left_out)}",) if left_out else ()
    table = Table(columns, found.seconds, lambda names: file.read(names, gaps=True), notes)
    return Contents("csv", {TABLE: table}, found.start, (found.note,))


def _times(file: CsvFile, name: str, numeric: bool) -> tuple[NDArray[np.generic], bool]:
    """Whole numbers as such: nanoseconds since 1970 are more than a float64 holds. And whether dates are UTC."""
    if not numeric:
        return _calendar(file, name, file.texts(name))
    whole = file.whole_numbers(name)
    return (file.read([name], gaps=True)[:, 0] if whole is None else whole), True


def _calendar(file: CsvFile, name: str, texts: list[str]) -> tuple[NDArray[np.datetime64], bool]:
    matches = [_CALENDAR.fullmatch(text) if text else None for text in texts]
    for row, (text, match) in enumerate(zip(texts, matches, strict=True)):
        if text and match is None:
            line = file.line_numbers()[row]
            raise ValueError(
                f"line {line}, column {name!r}: {text[:60]!r} is neither a number nor an ISO 8601 time"
            )
    zones = {match[2] for match in matches if match}
    if None in zones and len(zones) > 1:
        raise ValueError(f"column {name!r}: some times have a time zone and some do not")
    local = np.array([match[1] if match else "NaT" for match in matches], "datetime64[ns]")
    ahead = np.array([_offset(match[2]) if match else 0 for match in matches], "timedelta64[m]")
    return local - ahead, None not in zones


def _offset(zone: str | None) -> int:
    """Minutes ahead of UTC."""
    if zone in (None, "Z", "UTC"):
        return 0
    minutes = int(zone[1:3]) * 60 + int(zone[-2:])
    return -minutes if zone[0] == "-" else minutes
