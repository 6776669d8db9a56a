"""What a file that is to be opened as a log holds: its first rows, its times, and which columns may be what."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import islice

import numpy as np

from .._sections import FloatArray
from ..logfiles import LogFile, open_log
from ..logfiles.clock import TimeUnit, time_column
from ..logfiles.formats import FORMATS, format_of
from ..logfiles.suggesting import is_force, suggestions
from ..recording.csvfile import CsvFile, dialect, open_csv
from ..recording.header import unit_in, unit_of_time
from ..results import plain
from .inbox import Source

__all__ = ["Column", "Times", "base_name", "columns_of", "preview", "roles_of", "table_of", "times_of"]

SHOWN_ROWS = 8
_LOOKED_AT = 1000  # rows, for times and kinds of columns
_LONGEST_CELL = 40
_MOST_SHOWN = 400  # columns whose first rows are sent
_SHORTEST, _LONGEST = 1e-5, 1.0  # s, of a step that nobody asks about
_USUAL = 5e-3  # s
_EVEN = 1e-3  # by which a step may leave the median, relative, in a text of few digits
_TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}
_UNIT_IN_NAME = re.compile(r"[ _]*[\[(][^\])]*[\])]$")
# What ends a column's name and can be nothing but a unit.
_ENDINGS = {
    **{"kmh": "km/h", "kph": "km/h", "mps": "m/s", "cmps": "cm/s", "mmps": "mm/s", "mm": "mm", "cm": "cm"},
    **{"dps": "deg/s", "deg": "deg", "rpm": "rpm", "kN": "kN", "mN": "mN"},
}
_TEXTS = ("csv",)
_PREFIXES = {"label": "label_", "g": "g_", "f_theta": "f_theta_"}
_MASS = re.compile(r"(m|mass|m_hat|inertia|weight_kg|mass_kg)", re.IGNORECASE)
_VELOCITIES = (("vx", "vy", "vz"), ("u", "v", "w"), ("v_x", "v_y", "v_z"), ("vel_x", "vel_y", "vel_z"))
_ALONE = 3  # columns that are x where nothing says so


@dataclass(frozen=True)
class Column:
    """A column that can be chosen.

    Parameters
    ----------
    key : str
        By which it is chosen: its name; in a log of several topics "topic/field".
    unit : str
        As the file says it; may be empty.
    numeric : bool
    first : tuple of str
        Its first rows.
    """

    key: str
    unit: str = ""
    numeric: bool = True
    first: tuple[str, ...] = ()


@dataclass(frozen=True)
class Times:
    """What is known of the times.

    Parameters
    ----------
    column : str or None
        None where the log has clocks of its own, or no column can be told.
    unit : str
        What the column counts; empty where it says it otherwise, as dates do.
    said : str
        A sentence for the user.
    recognised : bool
        Whether ``unit`` is a guess from the steps, which the user has to confirm.
    choices : dict
        The step in s under each unit; empty where it is stated.
    even : bool
        Whether the first steps are equal.
    step : float or None
        Median of the first steps, s.
    fixed : bool
        Whether the log has clocks of its own, and no column is to be chosen.
    """

    column: str | None
    unit: str
    said: str
    recognised: bool = False
    choices: Mapping[str, float] = field(default_factory=dict)
    even: bool = True
    step: float | None = None
    fixed: bool = False


def preview(source: Source, time: str | None, unit: TimeUnit | None) -> dict[str, object]:
    """The reply to op "preview".

    Parameters
    ----------
    source : Source
    time : str, optional
        The column of times that the user chose.
    unit : {"s", "ms", "us", "ns"}, optional
        What the user says that it counts.

    Raises
    ------
    ValueError, OSError
        If the file cannot be read.
    """
    kind, columns = columns_of(source)
    times = times_of(source, columns, time, unit)
    roles = roles_of(source, columns, times)
    return {
        "file": {"name": source.name, "size": source.size, "format": kind},
        "columns": [
            {"key": c.key, "unit": c.unit, "numeric": c.numeric, "first": list(c.first[:SHOWN_ROWS])}
            for c in columns[:_MOST_SHOWN]
        ],
        "more_columns": max(len(columns) - _MOST_SHOWN, 0),
        "time": plain(times),
        "roles": roles,
        "messages": _notes(source, columns, roles),
    }


# -- columns ----------------------------------------------------------------------------------------------------


def table_of(source: Source) -> CsvFile | None:
    """The file as text in columns; None if it is something else."""
    return open_csv(source.path, *dialect(source.path)) if format_of(source.path) in _TEXTS else None


def columns_of(source: Source) -> tuple[str, list[Column]]:
    """Format of the file, and its columns; those of a log with topics in the order of the topics."""
    table = table_of(source)
    if table is not None:
        rows = table.head(_LOOKED_AT)
        kinds = [_holds_numbers(table, [row[k] for row in rows]) for k in range(len(table.header))]
        return "csv", [
            Column(
                name,
                unit_in(name) or _unit_of_ending(name),
                kinds[k],
                tuple(row[k][:_LONGEST_CELL] for row in rows[:SHOWN_ROWS]),
            )
            for k, name in enumerate(table.header)
        ]
    log = _opened(source)
    return log.format, list(_fields(log))


def _holds_numbers(table: CsvFile, texts: Sequence[str]) -> bool:
    """Some, or nothing: what is odd among them is said by its line when the column is read."""
    filled = [text for text in texts if text]
    return not filled or any(table.number(text) is not None for text in filled)


def _opened(source: Source) -> LogFile:
    try:
        return source.log
    except ValueError as error:
        # A table whose times nobody knows yet: what it holds can be shown all the same.
        if not FORMATS[format_of(source.path)].table or "unit" not in str(error):
            raise
        return open_log(source.path, time_unit="s")


def _fields(log: LogFile) -> Iterator[Column]:
    several = len(log.topics) > 1
    for topic in log.topics:
        names = [
            name
            for each in topic.fields
            for name in ([f"{each.name}[{k}]" for k in range(*each.shape)] if each.shape else [each.name])
        ]
        units = {each.name: each.unit for each in topic.fields}
        for name in names:
            key = f"{topic.name}/{name}" if several else name
            yield Column(key, units.get(re.sub(r"\[\d+\]$", "", name), ""), True, ())


def _unit_of_ending(name: str) -> str:
    """Unit that ends a column's name, as in ``speed_kmh``; nothing where there is none that cannot mean another."""
    return _ENDINGS.get(name.strip().rpartition("_")[2], "") if "_" in name else ""


def base_name(key: str) -> str:
    """A column's name without its topic and the unit in brackets at its end."""
    return _UNIT_IN_NAME.sub("", key).rpartition("/")[2].strip()


# -- times ------------------------------------------------------------------------------------------------------


def times_of(
    source: Source, columns: Sequence[Column], time: str | None, unit: TimeUnit | None = None
) -> Times:
    """Which column holds the times, and what it counts.

    Parameters
    ----------
    source : Source
    columns : sequence of Column
    time : str, optional
        As the user says.
    unit : {"s", "ms", "us", "ns"}, optional
        As the user says.

    Raises
    ------
    ValueError
        If there is no such column.
    """
    table = table_of(source)
    if table is None:
        return _own_times(source, time, unit)
    texts = [column.key for column in columns if not column.numeric and _is_date(column.first)]
    try:
        chosen = time_column([column.key for column in columns], texts, time)
    except ValueError:
        if time is not None:
            raise
        return Times(None, "", "No column is called time: choose the one that holds the times.")
    if chosen in texts:
        return Times(chosen, "", f"{chosen!r} holds dates, which say their unit themselves.")
    place = table.header.index(chosen)
    values = [table.number(row[place]) for row in table.head(_LOOKED_AT)]
    seconds = np.array([v for v in values if v is not None and np.isfinite(v)], dtype=float)
    return _counted(chosen, seconds, unit)


def _own_times(source: Source, time: str | None, unit: TimeUnit | None) -> Times:
    kind = format_of(source.path)
    if not FORMATS[kind].table:
        return Times(None, "", f"A {kind} log says its times itself; every topic has its own.", fixed=True)
    try:
        clock = open_log(source.path, time_unit=unit, time=time).topics[0].clock
    except ValueError as error:
        if unit is not None or "unit" not in str(error):
            return Times(None, "", f"The times are not known: {_bare(source, error)}")
        log = open_log(source.path, time_unit="s", time=time)
        ticks = log.read(log.topics[0].name, []).times[:_LOOKED_AT]
        return _counted(time or "the times", ticks, None)
    said = "The file says its times itself" if unit is None else f"The times count {_WORDS[unit]}, as you say"
    return Times(time, unit or "", f"{said}: steps of {clock.dt:.4g} s.", step=clock.dt)


def _counted(column: str, values: FloatArray, unit: TimeUnit | None) -> Times:
    """Times of a column of numbers: by what its name says, else by the user, else by what its steps can be."""
    steps = np.diff(values)
    steps = steps[steps > 0.0]
    if not len(steps):
        return Times(column, unit or "", f"{column!r} does not count forwards: choose another column.")
    step = float(np.median(steps))
    even = bool(np.all(np.abs(steps - step) <= _EVEN * step))
    stated = unit_of_time(column)
    choices = {} if stated else {name: step * size for name, size in _TICKS.items()}
    if unit is not None and stated and unit != stated:
        raise ValueError(
            f"time_unit: the name of {column!r} says {stated}, got {unit}: rename it, or leave the unit"
        )
    known = stated or unit
    if known:
        says = "its name says" if stated else "you say"
        dt = step * _TICKS[known]
        doubt = "" if _SHORTEST <= dt <= _LONGEST else "; such a step is unusual: is it another unit?"
        said = f"{column!r} counts {_WORDS[known]}, as {says}: steps of {dt:.4g} s{doubt}"
        return Times(column, known, f"{said}.", False, choices, even, dt)
    found = _recognised(choices)
    if found is None:
        said = f"Steps of {step:.6g} are no time between 10 µs and 1 s in s, ms, µs or ns: say what {column!r} counts."
        return Times(column, "", said, True, choices, even, None)
    dt = choices[found]
    said = f"{column!r} does not say what it counts. Steps of {step:.6g} were taken for {_WORDS[found]}: {dt:.4g} s"
    return Times(column, found, f"{said}.", found != "s", choices, even, dt)


def _recognised(choices: Mapping[str, float]) -> str | None:
    """Seconds where they can be; else the unit whose step is nearest to what recorders take."""
    fits = {unit: dt for unit, dt in choices.items() if _SHORTEST <= dt <= _LONGEST}
    if "s" in fits or not fits:
        return next(iter(fits), None)
    return min(fits, key=lambda unit: abs(np.log(fits[unit] / _USUAL)))


def _is_date(texts: Sequence[str]) -> bool:
    try:
        return bool(texts) and all(bool(datetime.fromisoformat(text)) for text in texts if text)
    except ValueError:
        return False


# -- what may be what ---------------------------------------------------------------------------------------------


def roles_of(source: Source, columns: Sequence[Column], times: Times) -> dict[str, list[str]]:
    """Columns for each signal, as far as their names tell."""
    empty: dict[str, list[str]] = {"x": [], "label": [], "g": [], "f_theta": [], "inertia": []}
    usable = [column.key for column in columns if column.numeric and column.key != times.column]
    if FORMATS[format_of(source.path)].table:
        return empty | _by_names({base_name(key): key for key in usable})
    log = source.log
    several = len(log.topics) > 1
    for each in suggestions(log):
        # What g is made of is no g yet: motors and attitudes need a model.
        if each.signal in ("x", "label") and not empty[each.signal]:
            found = [f"{each.topic}/{name}" if several else name for name in each.fields]
            empty[each.signal] = [
                key for name in found for key in usable if key == name or key.startswith(f"{name}[")
            ]
    if len(empty["label"]) != len(empty["x"]) or any(
        key.rpartition("/")[2].startswith(("Acc", "accel", "xyz", "linear_acc")) for key in empty["label"]
    ):
        empty["label"] = []  # a specific force in body axes is no x' in the axes of x
    return empty


def _by_names(keys: Mapping[str, str]) -> dict[str, list[str]]:
    """By the names that this project gives, else by usual ones of velocities."""
    lower = {name.lower(): name for name in keys}
    x, labels = _labelled(keys)
    if not x:
        x = next(([lower[n] for n in names] for names in _VELOCITIES if all(n in lower for n in names)), [])
    if not x:
        known = (*_PREFIXES.values(), "feature_", "inertia_")
        rest = [
            name
            for name in keys
            if not name.startswith(known) and not _MASS.fullmatch(name) and not is_force(name)
        ]
        x = rest if len(rest) <= _ALONE else []
    found = {"x": x, "label": labels}
    for signal in ("g", "f_theta"):
        names = [f"{_PREFIXES[signal]}{name}" for name in x]
        found[signal] = names if x and all(name in keys for name in names) else []
    inertia = [f"inertia_{i}" for i in range(len(x))]
    if x and all(name in keys for name in inertia):
        found["inertia"] = inertia
    else:
        masses = [name for name in keys if _MASS.fullmatch(name)]
        found["inertia"] = masses if x and len(masses) == 1 else []
    return {signal: [keys[name] for name in names] for signal, names in found.items()}


def _labelled(keys: Mapping[str, str]) -> tuple[list[str], list[str]]:
    """Columns of x that have a label, and the labels."""
    pairs = {name: f"label_{name}" for name in keys if f"label_{name}" in keys}
    # vx goes with ax.
    pairs |= {n: f"a{n[1:]}" for n in keys if n[:1] == "v" and f"a{n[1:]}" in keys and n not in pairs}
    return list(pairs), list(pairs.values())


def _notes(source: Source, columns: Sequence[Column], roles: Mapping[str, Sequence[str]]) -> list[str]:
    notes = []
    texts = [column.key for column in columns if not column.numeric]
    if texts:
        notes.append(f"Text, not numbers: {', '.join(islice(texts, 6))}{', …' if len(texts) > 6 else ''}.")
    if table := table_of(source):
        signs = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
        between = signs.get(table.delimiter, f"{table.delimiter!r}")
        notes.append(f"Columns between {between}, decimal {'commas' if table.decimal == ',' else 'points'}.")
    else:
        log = _opened(source)
        notes += log.notes
        if len(log.topics) > 1:
            notes.append(
                "Signals of other topics than that of x are taken at its times: g by the sample before, label and f_θ "
                "by straight lines. Frames and signs stay as recorded; a robot file turns them (docs: your robot)."
            )
    if not roles["x"]:
        notes.append("The names do not tell what x is: choose its columns.")
    return notes


def _bare(source: Source, error: Exception) -> str:
    return str(error).replace(f"{source.path}: ", "").replace(str(source.path), source.name)
