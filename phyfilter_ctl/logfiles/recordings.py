"""A table (CSV, Parquet, Arrow, Feather, MAT, HDF5, a frame) as a recording, by the names of its columns."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import EllipsisType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._intake import LARGEST
from .._sections import FloatArray
from ..recording import Recording
from ..recording.columns import VELOCITIES, inertia_option, read_log, wanted_columns, with_inertia
from ..recording.csvfile import dialect, open_csv
from ..recording.header import TICKS, Columns, unit_of_time
from .clock import TimeUnit, TimeUnitError
from .formats import FORMATS, format_of
from .logfile import LogFile, open_log
from .sizes import check_size

__all__ = ["read_recording"]

# s, between which the steps of times without a unit must be.
_SHORTEST, _LONGEST = 1e-5, 1.0


def read_recording(
    source: str | os.PathLike[str] | object,
    *,
    time: str | None = None,
    time_unit: TimeUnit | None = None,
    dt: float | None = None,
    x: Sequence[str] = VELOCITIES,
    label: Sequence[str] | EllipsisType | None = ...,
    g: Sequence[str] | EllipsisType | None = ...,
    f_theta: Sequence[str] | EllipsisType | None = ...,
    features: Sequence[str] | EllipsisType | None = ...,
    inertia: ArrayLike | EllipsisType | None = ...,
    channels: Sequence[str] | None = None,
    unit: str | None = None,
    largest: int = LARGEST,
) -> Recording:
    """A recording from a table of any format that :func:`open_log` reads, or a frame; see :meth:`Recording.read`.

    Parameters
    ----------
    source, time, time_unit, dt, x, label, g, f_theta, features, inertia, channels, unit
        As for :meth:`Recording.read`.
    largest : int
        Bytes that the file may take in memory, as for :func:`open_log`.

    Returns
    -------
    Recording

    Raises
    ------
    OSError, TypeError, ValueError
        As for :meth:`Recording.read`; for a file that takes more memory than ``largest``.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "short.csv"
    ...     _ = path.write_text("t [ms];v [m/s];label_v\\n0;1.0;0.5\\n10;1.005;0.5\\n")
    ...     read_recording(path, x=["v"])
    Recording('short': 2 samples of v [m/s], 0.01 s, dt 0.01 s; label)
    """
    if time_unit is not None and time_unit not in TICKS:
        raise ValueError(f"time_unit: expected one of {', '.join(TICKS)}, got {time_unit!r}")
    if dt is not None and (time is not None or time_unit is not None):
        raise ValueError("dt: is for tables without times; leave time and time_unit out, or dt")
    columns, constant = inertia_option(inertia)
    signals = {"label": label, "g": g, "f_theta": f_theta, "features": features, "inertia": columns}
    asked = _Asked(time, time_unit, dt, x, signals)
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        found = _of_csv(path, asked, largest) if format_of(path) == "csv" else _of_log(path, asked, largest)
    else:
        found = _of_frame(source, asked)
    if unit is not None and found.unit and unit != found.unit:
        raise ValueError(f"unit: the columns of x say {found.unit}, got {unit!r}")
    known = found.unit or ("m/s" if found.x == VELOCITIES else "")
    return Recording.from_arrays(
        **{"inertia": constant, **with_inertia(found.values)},
        times=found.times,
        dt=dt,
        name=found.name,
        channels=found.x if channels is None else channels,
        unit=known if unit is None else unit,
    )


class _Asked(NamedTuple):
    """Which columns, as the caller names them."""

    time: str | None
    time_unit: TimeUnit | None
    dt: float | None
    x: Sequence[str]
    signals: Mapping[str, Sequence[str] | EllipsisType | None]

    def of(self, file: Columns) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
        """Bare names of x, and of the columns by signal."""
        x = file.found((self.x,) if isinstance(self.x, str) else self.x)
        signals = {
            key: value if isinstance(value, EllipsisType | None) else file.found(value)
            for key, value in self.signals.items()
        }
        return wanted_columns(file, time=None, x=x, signals=signals)

    def times_of(self, file: Columns) -> str | None:
        """Bare name of the column of times; None where the table has none by its own account."""
        if self.dt is not None:
            return None
        if self.time is None:
            return file.times()
        found = file.found(self.time)
        if not isinstance(found, str) or found not in file.header:
            raise ValueError(f"{file.path}: time: no column {self.time!r}, only {', '.join(file.names)}")
        return found


class _Found(NamedTuple):
    """What a table holds."""

    name: str
    x: tuple[str, ...]
    unit: str
    values: dict[str, FloatArray]
    times: FloatArray | NDArray[np.generic] | None


def _of_csv(path: Path, asked: _Asked, largest: int) -> _Found:
    """What is wrong is named by its line."""
    file = open_csv(path, *dialect(path))
    columns = Columns(path, file.header)
    time = asked.times_of(columns)
    if asked.dt is None and (time is None or file.number(file.first(columns.own(time))) is None):
        return _of_log(path, asked, largest)  # dates, or which column holds the times is to be asked
    check_size(8 * file.lines, largest, "a column")
    x, wanted = asked.of(columns)
    own = None if time is None else columns.own(time)
    unit = None if own is None else asked.time_unit or unit_of_time(own)
    if own is not None and asked.time_unit and unit_of_time(own) not in ("", asked.time_unit):
        raise ValueError(
            f"{path}: column {own!r} is in {unit_of_time(own)}, got time_unit={asked.time_unit!r}"
        )
    named = {key: [columns.own(name) for name in names] for key, names in wanted.items() if key != "x"}
    log = read_log(
        path,
        time=own,
        x=[columns.own(name) for name in x],
        signals=dict.fromkeys(asked.signals) | named,
        scale={own: TICKS[unit]} if own is not None and unit else {},
        delimiter=file.delimiter,
        decimal=file.decimal,
    )
    values = dict(log.values)
    times = values.pop("time", None)
    if times is not None and not unit:
        _refuse_odd_steps(f"{path}: column {own!r}", times)
    return _Found(path.stem, x, columns.unit(x), values, times)


def _of_log(path: Path, asked: _Asked, largest: int) -> _Found:
    if asked.dt is not None:
        raise ValueError(f"{path}: dt: is for CSV and frames without times; this table has a column of them")
    log, known = _opened(path, asked, largest)
    if not FORMATS[log.format].table:
        raise ValueError(
            f"{path}: a {log.format} log has topics on clocks of their own: say what they are in a robot file, and "
            "read it by Robot.load(...).read"
        )
    topic, *others = log.topics
    if others:
        listed = ", ".join(each.name for each in log.topics)
        raise ValueError(f"{path}: expected one table, got {listed}; read them by open_log")
    columns = Columns(
        log.path,
        tuple(
            name
            for field in topic.fields
            for name in ([f"{field.name}[{k}]" for k in range(*field.shape)] if field.shape else [field.name])
        ),
    )
    x, wanted = asked.of(columns)
    names = list(dict.fromkeys(columns.own(name) for each in wanted.values() for name in each))
    signal = log.read(topic.name, names)
    place = {name: k for k, name in enumerate(names)}
    values = {}
    for key, each in wanted.items():
        own = [columns.own(name) for name in each]
        values[key] = signal.values if own == names else signal.values[:, [place[name] for name in own]]
    if not known:
        _refuse_odd_steps(f"{path}: its times", signal.times)
    return _Found(log.path.stem, x, columns.unit(x), values, signal.times)


def _opened(path: Path, asked: _Asked, largest: int) -> tuple[LogFile, bool]:
    """The log, and whether the unit of its times is known; one that nobody says is s."""
    try:
        return open_log(path, time=asked.time, time_unit=asked.time_unit, largest=largest), True
    except TimeUnitError:
        return open_log(path, time=asked.time, time_unit="s", largest=largest), False


def _of_frame(frame: Any, asked: _Asked) -> _Found:
    """Of pandas or polars, by their columns; times may be the index of one of pandas."""
    names = getattr(frame, "columns", None)
    if names is None or isinstance(frame, Mapping):
        raise TypeError(
            f"source: expected a path, or a frame with named columns, got {type(frame).__name__}; arrays are for "
            "Recording.from_arrays"
        )
    columns = Columns(Path("the frame"), tuple(str(name) for name in names))
    x, wanted = asked.of(columns)
    own = dict(zip(columns.names, names, strict=True))

    def column(name: str) -> NDArray[np.generic]:
        return np.asarray(frame[own[columns.own(name)]])

    values = {
        key: np.column_stack([column(name) for name in each]).astype(float) for key, each in wanted.items()
    }
    times, what = None, "the frame's index"
    unit: str | None = asked.time_unit
    if asked.dt is None:
        time = asked.times_of(columns)
        if time is not None:
            times, what = column(time), f"the frame: column {columns.own(time)!r}"
            unit = unit or unit_of_time(columns.own(time))
        elif hasattr(frame, "index"):
            times = np.asarray(frame.index)
            if times.dtype.kind in "iu" and not unit:
                raise ValueError(
                    "the frame: no column is called t or time, and its index counts rows: name the times by time=, or "
                    "say dt=, or time_unit= of the index"
                )
        else:
            raise ValueError(
                f"the frame has no column that is called t or time, only {', '.join(columns.names)}"
            )
        if times.dtype.kind not in "mM":
            times = times.astype(float) * (TICKS[unit] if unit else 1.0)
            if not unit:
                _refuse_odd_steps(what, times)
        elif unit:
            raise ValueError(f"time_unit: {what} has its unit, {times.dtype}; leave time_unit out")
    return _Found("", x, columns.unit(x), values, times)


def _refuse_odd_steps(name: str, times: FloatArray) -> None:
    """Raise for times without a unit that can hardly be seconds."""
    steps = np.abs(np.diff(times))
    step = float(np.median(steps)) if len(steps) else 0.0
    if step and not _SHORTEST <= step <= _LONGEST:
        likely = [f"{step * s:.6g} s if it counts {unit}" for unit, s in TICKS.items() if unit != "s"]
        raise ValueError(
            f"{name}: the time steps are {step:.6g} s, expected 10 us to 1 s, where nobody says the unit; "
            f"{', '.join(likely)}: say it by time_unit=, one of {', '.join(TICKS)}"
        )
