"""A log file opened: its topics, and their signals on their own clocks."""

from __future__ import annotations

import contextlib
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path

import numpy as np

from .._intake import LARGEST
from .._sections import FloatArray
from . import clock as clocks
from .clock import Clock, TimeUnit
from .contents import TIME, Column, Contents, Dropout, Table
from .formats import FORMATS, format_of
from .sizes import check_size

__all__ = ["Field", "LogFile", "Signal", "Topic", "open_log"]

_ELEMENT = re.compile(r"^(.*)\[(\d+)\]$")


@dataclass(frozen=True)
class Field:
    """What a topic holds at each of its times.

    Attributes
    ----------
    name : str
        Its elements are ``name[0]``, ``name[1]``, ... where it has a shape.
    unit : str
        As the file says it, or the format's documentation; empty where neither does.
    dtype : str
        In the file; "time" for times, which are read in s from the log's zero.
    shape : tuple of int
        () for a number, (k,) for an array.
    """

    name: str
    unit: str = ""
    dtype: str = "float64"
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Topic:
    """Fields that share a clock.

    Attributes
    ----------
    name : str
    fields : tuple of Field
    count : int
        Samples.
    clock : Clock
        What its times are like.
    notes : tuple of str
        What the reader has to say.
    """

    name: str
    fields: tuple[Field, ...]
    count: int
    clock: Clock
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Signal:
    """Samples as they stand in the file: not sorted, not resampled; what is missing is NaN.

    Attributes
    ----------
    times : (N,) array
        s from the log's zero.
    values : (N, k) array
    fields : tuple of str
        Names of the k columns.
    units : tuple of str
        Theirs; empty where none is known.
    """

    times: FloatArray
    values: FloatArray
    fields: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LogFile:
    """A log of a robot: topics with clocks of their own, counted from one zero. Made by :func:`open_log`,
    which gives it what its reader found, ``_tables``.

    Attributes
    ----------
    path : Path
    format : str
        "ulog", "rosbag1", "rosbag2", "mcap", "dataflash", "crazyflie", "parquet", "arrow", "mat", "hdf5" or "csv".
    start : datetime or None
        UTC of time 0, where the file says it.
    notes : tuple of str
        What the reader has to say of the whole file.
    dropouts : tuple of Dropout
        Where the recorder noted what it lost.
    largest : int
        Bytes that one reading may take in memory.
    topics : tuple of Topic
    """

    path: Path
    format: str
    start: datetime | None
    notes: tuple[str, ...]
    dropouts: tuple[Dropout, ...]
    _tables: Mapping[str, Table] = field(repr=False)
    largest: int = LARGEST

    @cached_property
    def topics(self) -> tuple[Topic, ...]:
        """What it holds."""
        return tuple(
            Topic(name, _fields(table.columns), len(table.times), Clock.of(table.times), table.notes)
            for name, table in self._tables.items()
        )

    def read(self, topic: str, fields: Sequence[str] | None = None, *, clock: str | None = None) -> Signal:
        """Samples of a topic.

        Parameters
        ----------
        topic : str
            Its name; it may be left empty where the log has one only.
        fields : sequence of str, optional
            Names of fields or of single elements (``"q"``, ``"q[0]"``); None for all.
        clock : str, optional
            A field of times (``"header.stamp"``, ``"timestamp_sample"``) to take instead of the topic's own.

        Returns
        -------
        Signal

        Raises
        ------
        ValueError
            If there is no such topic, field or clock, the file is broken where they stand, or they take more memory
            than ``largest``.
        OSError
            If the file cannot be read any more.

        Examples
        --------
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "short.csv"
        ...     _ = path.write_text("time_ms,v [m/s]\\n5,1.0\\n15,\\n25,1.5\\n")
        ...     signal = open_log(path).read("table", ["v [m/s]"])
        >>> signal.times.tolist(), signal.values.ravel().tolist(), signal.units
        ([0.0, 0.01, 0.02], [1.0, nan, 1.5], ('m/s',))
        """
        if isinstance(fields, str):
            raise TypeError(f"fields: expected a sequence of names, got {fields!r}; write [{fields!r}]")
        table = self._table(topic)
        columns = {column.name: column for column in table.columns}
        grouped: dict[str, list[str]] = {}
        for name in columns:
            grouped.setdefault(name, []).append(name)
            if match := _ELEMENT.match(name):
                grouped.setdefault(match[1], []).append(name)
        wanted = list(columns) if fields is None else list(fields)
        for name in wanted if clock is None else [*wanted, clock]:
            if name not in grouped:
                where = f"{self.path}: topic {topic!r}"
                unknown = _unknown(f"{where} has no field", name, [f.name for f in _fields(table.columns)])
                raise ValueError("; ".join([unknown, *(note for note in table.notes if "left out" in note)]))
        names = tuple(name for each in wanted for name in grouped[each])
        if clock is not None and (clock not in columns or columns[clock].dtype != TIME):
            times = [column.name for column in table.columns if column.dtype == TIME]
            raise ValueError(
                f"clock: expected a field of times, one of {times or 'none here'}, got {clock!r}"
            )
        if not names:
            return Signal(table.times.copy(), np.empty((len(table.times), 0)), (), ())
        with refusing(self.path, self.format):
            check_size(8 * len(table.times) * (len(names) + 1), self.largest, f"topic {topic!r}")
            values = table.load(names if clock is None else (*names, clock))
        own = table.times.copy() if clock is None else values[:, -1].copy()
        return Signal(own, values[:, : len(names)], names, tuple(columns[name].unit for name in names))

    def _table(self, topic: str) -> Table:
        if not topic and len(self._tables) == 1:
            return next(iter(self._tables.values()))
        if topic not in self._tables:
            raise ValueError(_unknown(f"{self.path} has no topic", topic, list(self._tables)))
        return self._tables[topic]


def open_log(
    path: str | os.PathLike[str],
    *,
    time_unit: TimeUnit | None = None,
    time: str | None = None,
    largest: int = LARGEST,
) -> LogFile:
    """Open a log: its format is told by its first bytes, then by its name.

    Parameters
    ----------
    path : str or path-like
        A file; a folder for a ROS 2 bag.
    time_unit : {"s", "ms", "us", "ns"}, optional
        What a table's column of times counts, where the file does not say it.
    time : str, optional
        Name of a table's column of times; None for the one that is called so.
    largest : int
        Bytes that one quantity of the file (times, what one reading asks for, an unpacked part) may take in memory.
        What takes more is refused before it is read.

    Returns
    -------
    LogFile

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If its format is not known or needs a package that is not installed, it is broken, takes more memory than
        ``largest``, or its unit of time has to be given, or may not be.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "short.csv"
    ...     _ = path.write_text("time;x;y\\n2024-05-01T12:00:00+02:00;1,0;a\\n2024-05-01T12:00:00.5+02:00;2,0;b\\n")
    ...     log = open_log(path)
    >>> log.format, log.start.isoformat(), [field.name for field in log.topics[0].fields], log.topics[0].clock.dt
    ('csv', '2024-05-01T10:00:00+00:00', ['x'], 0.5)
    """
    path = Path(path)
    clocks.check_unit(time_unit)
    name = format_of(path)
    found = FORMATS[name]
    if not found.table and (time_unit is not None or time is not None):
        raise ValueError(f"{path}: a {name} log says its times itself; leave time_unit and time out")
    with refusing(path, name):
        contents: Contents = found.reader()(path, time_unit, time, largest)
    if not contents.tables:
        raise ValueError(f"{path}: the {name} log holds no samples")
    return LogFile(
        path, contents.format, contents.start, contents.notes, contents.dropouts, contents.tables, largest
    )


@contextlib.contextmanager
def refusing(path: Path, format: str) -> Iterator[None]:
    """Whatever a library raises on a broken file becomes one ValueError that names it; what it prints is dropped."""
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            yield
    except OSError as error:
        if error.filename is not None:
            raise
        raise ValueError(f"{path}: no readable {format} log: {error}") from error
    except ModuleNotFoundError as error:
        package = FORMATS[format].package
        if not package or (error.name or "").partition(".")[0] not in package.replace("-", "_"):
            raise
        raise ValueError(
            f"{path}: a {format} log needs the package {package}: pip install 'phyfilter-ctl[logs]'"
        ) from error
    except clocks.TimeUnitError as error:
        raise clocks.TimeUnitError(f"{path}: {error}") from error
    except ValueError as error:
        text = str(error)
        raise ValueError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    except Exception as error:  # a library's own, of whatever kind: struct.error, KeyError, zlib.error, ...
        raise ValueError(f"{path}: no readable {format} log: {type(error).__name__}: {error}") from error


def _unknown(problem: str, name: str, there: Sequence[str]) -> str:
    near = get_close_matches(name, there, 1)
    listed = ", ".join(there[:30]) + (f" and {len(there) - 30} more" if len(there) > 30 else "")
    return f"{problem} {name!r}{f'; did you mean {near[0]!r}?' if near else ''} It has: {listed}"


def _fields(columns: Sequence[Column]) -> tuple[Field, ...]:
    """Columns ``q[0]``, ``q[1]``, ... as one field of that shape."""
    grouped: dict[str, list[Column]] = {}
    for column in columns:
        match = _ELEMENT.match(column.name)
        grouped.setdefault(match[1] if match else column.name, []).append(column)
    return tuple(
        Field(name, each[0].unit, each[0].dtype, () if each[0].name == name else (len(each),))
        for name, each in grouped.items()
    )
