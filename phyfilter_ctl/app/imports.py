"""From a file and the roles of its columns to a recording."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from .._sections import FloatArray
from .._units import unit_definition
from ..logfiles import open_log
from ..logfiles.clock import TimeUnit
from ..logfiles.formats import FORMATS, format_of
from ..recording import Recording
from ..recording.columns import VELOCITIES
from ..recording.columns import read_log as read_columns
from ..recording.header import unit_of_time
from .checking import Fields, MessageError, shown
from .inbox import Source
from .preview import base_name, columns_of, roles_of, table_of, times_of

__all__ = ["Roles", "force_unit", "import_log", "read_roles", "usual_roles"]

_MOST_COLUMNS = 64  # of a signal; an inertia may be a matrix
MOST_CHANNELS = 12
_LARGEST_MASS = 1e9
_LONGEST_KEY = 400
# Bytes that are held for a number of a column: text that is read, its copy in the recording, an estimate, its peaks.
_HELD = 40.0
_UNCOUNTED = 12.0  # bytes a number takes in a text, roughly
_SHORTEST, _LONGEST = 1e-6, 100.0  # s, of a step to resample to
_DATA = ("label", "g", "f_theta")


@dataclass(frozen=True)
class Roles:
    """Which columns are what.

    Parameters
    ----------
    x : tuple of str
        Keys of the columns of x.
    time : str or None
        Column of the times; None where the log has clocks of its own, or for the one that is called so.
    time_unit : {"s", "ms", "us", "ns"} or None
        What it counts, where its name does not say it.
    signals : dict of str to tuple of str
        Columns of "label", "g" and "f_theta", as many as of x, where there are any.
    inertia : tuple of float or of str
        M: numbers, or columns; one, a diagonal, or a matrix row by row. Empty: 1.
    units : dict of str to str
        Units of "x" and "f", where the columns do not say them.
    step : float or None
        Step in s to resample to.
    name : str or None
        Of the recording; None means that of the file.
    """

    x: tuple[str, ...]
    time: str | None = None
    time_unit: TimeUnit | None = None
    signals: dict[str, tuple[str, ...]] = field(default_factory=dict)
    inertia: tuple[float, ...] | tuple[str, ...] = ()
    units: dict[str, str] = field(default_factory=dict)
    step: float | None = None
    name: str | None = None


def read_roles(fields: Fields) -> Roles:
    """Roles out of a message.

    Parameters
    ----------
    fields : Fields

    Raises
    ------
    MessageError
        If one is not what it should be.
    """
    x = _keys(fields, "x", MOST_CHANNELS)
    if not x:
        raise fields.error("x", "choose the columns of the measured signal x")
    signals = {name: _keys(fields, name, MOST_CHANNELS) for name in _DATA if name in fields}
    for name, keys in signals.items():
        if keys and len(keys) != len(x):
            raise fields.error(name, f"expected {len(x)} columns, one for each of x, got {len(keys)}")
    inertia: tuple[float, ...] | tuple[str, ...] = ()
    if "inertia" in fields:
        given = fields.get("inertia")
        numbers = isinstance(given, list) and given and not isinstance(given[0], str)
        inertia = (
            tuple(fields.numbers("inertia", 1, _MOST_COLUMNS, size=_LARGEST_MASS))
            if numbers
            else _keys(fields, "inertia", _MOST_COLUMNS)
        )
        if len(inertia) not in (0, 1, len(x), len(x) ** 2):
            raise fields.error(
                "inertia", f"expected 1, {len(x)} or {len(x) ** 2} of them, got {len(inertia)}"
            )
    unit = fields.choice("time_unit", ("s", "ms", "us", "ns")) if "time_unit" in fields else None
    return Roles(
        x,
        fields.text("time", _LONGEST_KEY) if "time" in fields else None,
        cast(TimeUnit | None, unit),
        {name: keys for name, keys in signals.items() if keys},
        inertia,
        {of: fields.text(f"unit_{of}") for of in ("x", "f") if f"unit_{of}" in fields},
        fields.number("step", _SHORTEST, _LONGEST, unit="s") if "step" in fields else None,
    )


def usual_roles(source: Source) -> Roles | None:
    """Roles by names, where x is vx, vy, vz and the times leave no doubt; else None.

    Parameters
    ----------
    source : Source

    Raises
    ------
    ValueError, OSError
        If the file cannot be read.
    """
    columns = columns_of(source)[1]
    times = times_of(source, columns, None)
    roles = roles_of(source, columns, times)
    if tuple(roles["x"]) != VELOCITIES or times.recognised or times.step is None:
        return None
    signals = {name: tuple(roles[name]) for name in _DATA if roles[name]}
    unit = times.unit if times.choices else None
    return Roles(VELOCITIES, times.column, cast(TimeUnit | None, unit), signals, tuple(roles["inertia"]))


def _keys(fields: Fields, name: str, most: int) -> tuple[str, ...]:
    if name not in fields:
        return ()
    keys = fields.texts(name, 0, most, _LONGEST_KEY)
    if twice := next((key for key in keys if keys.count(key) > 1), None):
        raise fields.error(name, f"names {shown(twice)} twice")
    return tuple(keys)


def import_log(source: Source, roles: Roles) -> tuple[Recording, list[str]]:
    """The recording, and what was done to come to it and is to be looked at.

    Parameters
    ----------
    source : Source
    roles : Roles

    Raises
    ------
    MessageError
        If the file is broken there, or too large for this machine: the sentence names column and line.
    OSError
        If it cannot be read.
    """
    wanted = {"x": roles.x, **roles.signals}
    columns = tuple(key for key in roles.inertia if isinstance(key, str))
    if columns:
        wanted["inertia"] = columns
    try:
        known = {column.key: column for column in columns_of(source)[1]}
        for name, keys in wanted.items():
            if unknown := next((key for key in keys if key not in known), None):
                raise MessageError(name, f"there is no column {shown(unknown)}")
        _refuse_what_does_not_fit(source, sum(map(len, wanted.values())))
        units = {key: column.unit for key, column in known.items()}
        factors, names, said = _factors(wanted, units, roles.units)
        if FORMATS[format_of(source.path)].table:
            times, values = _table(source, roles, wanted)
        else:
            times, values, left_out = _topics(source, wanted)
            if left_out:
                said.append(
                    f"{left_out} rows were left out: they miss a signal, or their time does not advance."
                )
        values = {name: table * factors[name] for name, table in values.items()}
        log = Recording.from_arrays(
            x=values["x"],
            times=times,
            label=values.get("label"),
            g=values.get("g"),
            f_theta=values.get("f_theta"),
            inertia=_inertia(roles, values),
            name=Path(source.name).stem if roles.name is None else roles.name,
            channels=_channels(roles.x),
            unit=names["x"],
        )
        if roles.step is not None:
            before = log.n
            log = log.resample(roles.step)
            said.append(
                f"Resampled from {before} samples to {log.n}, every {roles.step:.4g} s, by straight lines."
            )
        elif not log.is_uniform:
            said.append(f"The steps differ around {log.dt:.4g} s; every one is taken as it is.")
    except MessageError:
        raise
    except (TypeError, ValueError) as error:
        text = str(error).replace(f"{source.path}: ", "").replace(str(source.path), shown(source.name))
        raise MessageError("file", text) from error
    return log, [*said, *(f"{finding.message}." for finding in log.check(time_unit_known=True))]


def force_unit(source: Source, roles: Roles) -> str:
    """SI name of the unit of label, g and f_theta, as the user or the columns say; empty where neither does.

    Parameters
    ----------
    source : Source
    roles : Roles
    """
    units = {column.key: column.unit for column in columns_of(source)[1]}
    given = roles.units.get("f", "")
    return _si(given, gravity=True)[1] if given else _factors(dict(roles.signals), units, {})[1]["f"]


def _channels(keys: Sequence[str]) -> list[str]:
    """Short names where they differ."""
    short = [base_name(key) for key in keys]
    return short if len(set(short)) == len(short) and all(short) else list(keys)


# -- reading ------------------------------------------------------------------------------------------------------

Values = dict[str, FloatArray]


def _table(source: Source, roles: Roles, wanted: dict[str, tuple[str, ...]]) -> tuple[FloatArray, Values]:
    """Times in s and signals of a table."""
    unit = roles.time_unit
    if (table := table_of(source)) is None:
        log = open_log(source.path, time_unit=unit, time=roles.time)
        topic = log.topics[0].name
        values = {name: log.read(topic, list(keys)).values for name, keys in wanted.items()}
        return log.read(topic, []).times, values
    time = times_of(source, columns_of(source)[1], roles.time, unit)
    if time.column is None:
        raise MessageError("time", "choose the column of times")
    if time.recognised and unit is None:
        raise MessageError("time_unit", f"{time.said} Confirm its unit")
    # One signal with no other to be matched by its width: what is wrong is named by line and column.
    every = tuple(dict.fromkeys(key for keys in wanted.values() for key in keys))
    read = read_columns(
        source.path,
        time=None,
        x=every,
        signals={},
        scale={},
        delimiter=table.delimiter,
        decimal=table.decimal,
    ).values["x"]
    place = {key: k for k, key in enumerate(every)}
    stated = bool(unit_of_time(time.column)) or not time.unit
    times = (
        open_log(source.path, time_unit=None if stated else unit or "s", time=time.column).read("", []).times
    )
    return times, {name: read[:, [place[key] for key in keys]] for name, keys in wanted.items()}


def _topics(source: Source, wanted: dict[str, tuple[str, ...]]) -> tuple[FloatArray, Values, int]:
    """Times of the topic of x, the signals at them, and how many rows were left out since they miss one."""
    topics = {key.rpartition("/")[0] for key in wanted["x"]}
    if len(topics) > 1:
        raise MessageError("x", f"expected columns of one topic, got those of {', '.join(sorted(topics))}")
    own = topics.pop()
    times, x = _samples(source, own, wanted["x"])
    values: Values = {"x": x}
    for name, keys in wanted.items():
        if name != "x":
            values[name] = np.stack([_at(source, key, times, hold=name == "g") for key in keys], axis=1)
    whole = np.isfinite(times) & np.all([np.isfinite(v).all(axis=1) for v in values.values()], axis=0)
    whole &= np.diff(np.fmax.accumulate(np.where(np.isfinite(times), times, -np.inf)), prepend=-np.inf) > 0.0
    return times[whole], {name: v[whole] for name, v in values.items()}, int(np.sum(~whole))


def _samples(source: Source, topic: str, keys: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    names = [key.rpartition("/")[2] if topic else key for key in keys]
    signal = source.log.read(topic, names)
    return signal.times, signal.values


def _at(source: Source, key: str, times: FloatArray, *, hold: bool) -> FloatArray:
    """A column at the times of x: NaN before its first sample and after its last."""
    own, values = _samples(source, key.rpartition("/")[0], [key])
    known = np.isfinite(own) & np.isfinite(values[:, 0])
    order = np.argsort(own[known], kind="stable")
    own, y = own[known][order], values[known, 0][order]
    if not len(own):
        return np.full_like(times, np.nan)
    if hold:
        k = np.searchsorted(own, times, side="right") - 1
        return np.where(k >= 0, y[np.maximum(k, 0)], np.nan)
    return np.interp(times, own, y, left=np.nan, right=np.nan)


def _inertia(roles: Roles, values: Values) -> FloatArray | float | None:
    n, n_x = values["x"].shape
    if "inertia" in values:
        rows = values["inertia"]
        if rows.shape[1] == 1:
            rows = np.repeat(rows, n_x, axis=1)
        if np.all(rows == rows[0]):
            return rows[0] if rows.shape[1] == n_x else rows[0].reshape(n_x, n_x)
        return rows if rows.shape[1] == n_x and n != n_x else _matrices(rows, n_x)
    numbers = [entry for entry in roles.inertia if not isinstance(entry, str)]
    if len(numbers) == 1:
        return numbers[0]
    given = np.array(numbers)
    return (given if len(numbers) == n_x else given.reshape(n_x, n_x)) if numbers else None


def _matrices(rows: FloatArray, n_x: int) -> FloatArray:
    return rows[:, :, None] * np.eye(n_x) if rows.shape[1] == n_x else rows.reshape(-1, n_x, n_x)


# -- units ------------------------------------------------------------------------------------------------------


def _factors(
    wanted: dict[str, tuple[str, ...]], units: dict[str, str], given: dict[str, str]
) -> tuple[dict[str, FloatArray], dict[str, str], list[str]]:
    """Factors to SI of the columns of each signal, SI names of the units of x and f, and what is said of it."""
    factors: dict[str, FloatArray] = {}
    names: dict[str, str] = {"x": "", "f": ""}
    said: list[str] = []
    for signal, keys in wanted.items():
        of = "x" if signal == "x" else "f"
        own = given.get(of, "") if signal != "inertia" else ""
        found = [own or units.get(key, "") for key in keys]
        found = [unit.replace("²", "^2").replace("³", "^3").replace("µ", "u") for unit in found]
        read = [_si(unit, gravity=signal in _DATA) for unit in found]
        if len({name for _, name in read}) > 1:
            raise MessageError(
                signal, f"its columns have different units: {', '.join(map(repr, found))}; say one"
            )
        factors[signal] = np.array([factor for factor, _ in read])
        name = read[0][1]
        if signal == "x" or (signal in _DATA and not names["f"]):
            names[of] = name
        if np.any(factors[signal] != 1.0):
            said.append(f"{signal}: {found[0]} was taken as {factors[signal][0]:.6g} {name}.")
        elif found[0] and name == found[0] and unit_definition(found[0]).exponents is None:
            said.append(f"{signal}: the unit {shown(found[0])} is not known; the numbers stay as they are.")
    return factors, names, said


_GRAVITY = 9.80665  # m/s^2, of the unit g of accelerations


def _si(unit: str, *, gravity: bool) -> tuple[float, str]:
    """Factor to SI and the name there; a unit that is not known stays as it is. Of a mass g is a gram."""
    if gravity and unit == "g":
        return _GRAVITY, "m/s^2"
    found = unit_definition(unit) if unit else None
    if found is None or found.exponents is None or found.factor == 1.0:
        return 1.0, unit
    up = " ".join(n if p == 1 else f"{n}^{p}" for n, p in found.exponents.items() if p > 0)
    down = [f"/{n}" if p == -1 else f"/{n}^{-p}" for n, p in found.exponents.items() if p < 0]
    return found.factor, (up or "1") + "".join(down)


# -- memory -----------------------------------------------------------------------------------------------------


def _refuse_what_does_not_fit(source: Source, columns: int) -> None:
    """Raise where the columns would not fit into the memory that is free."""
    if FORMATS[format_of(source.path)].table:
        width = max(len(columns_of(source)[1]), 1)
        rows = source.size / (_UNCOUNTED * width)
    else:
        rows = max(topic.count for topic in source.log.topics)
    needs, free = _HELD * rows * (columns + 1), free_memory()
    if needs > free:
        raise MessageError(
            "file",
            f"about {rows:.2g} rows and {columns} columns take some {needs / 1e9:.2g} GB of memory, of which "
            f"{free / 1e9:.2g} GB are free: choose fewer columns, or cut the log",
        )


def free_memory() -> float:
    """Bytes that a program may take; without end where the system does not say."""
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        return 1024.0 * int(text.partition("MemAvailable:")[2].split()[0])
    except (OSError, IndexError, ValueError):
        pass
    try:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):  # Windows, macOS
        return float("inf")
