"""Which columns of a CSV file hold which signal of a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import EllipsisType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .._sections import FloatArray
from .._signals import refuse_ticks, refuse_unordered, refuse_unusable
from . import checks
from .csvfile import CsvFile, open_csv

VELOCITIES = ("vx", "vy", "vz")
_ACCELERATIONS = ("ax", "ay", "az")


class Header(Protocol):
    """A file with named columns."""

    @property
    def path(self) -> Path: ...
    @property
    def header(self) -> tuple[str, ...]: ...


@dataclass(frozen=True)
class LogColumns:
    """Signals of a file: ``values`` has x, and time, g, f_theta, label, features, inertia where there are any."""

    x_names: tuple[str, ...]
    values: dict[str, FloatArray]


def default_columns(signal: str, x: Sequence[str], width: int) -> list[str]:
    """Names of the columns of a signal of ``width`` columns where none are given."""
    if signal == "features":
        return [f"feature_{k}" for k in range(width)]
    if signal == "inertia":
        n_x = len(x)
        pairs = [f"inertia_{i}_{j}" for i in range(n_x) for j in range(n_x)]
        return [f"inertia_{i}" for i in range(n_x)] if width == n_x else pairs
    if signal == "label" and tuple(x) == VELOCITIES:
        return list(_ACCELERATIONS)
    return [f"{signal}_{name}" for name in x]


def inertia_option(
    inertia: ArrayLike | EllipsisType | None,
) -> tuple[Sequence[str] | EllipsisType | None, ArrayLike | None]:
    """What an option that takes numbers or column names holds: (columns, constant)."""
    if inertia is None or isinstance(inertia, EllipsisType):
        return inertia, None
    array = np.atleast_1d(np.asarray(inertia))
    if array.dtype.kind == "U":
        return tuple(str(name) for name in array.ravel()), None
    return None, inertia


def read_log(
    path: Path,
    *,
    time: str | None,
    x: Sequence[str],
    signals: Mapping[str, Sequence[str] | EllipsisType | None],
    scale: Mapping[str, float],
    delimiter: str,
    decimal: str = ".",
) -> LogColumns:
    """Read and check the columns; what is wrong is named by its line in the file.

    Parameters
    ----------
    signals : mapping
        For each further signal its columns, None to leave it out, ``...`` for the default ones where the file has
        them.
    """
    file = open_csv(path, delimiter, decimal)
    x, wanted = wanted_columns(file, time=time, x=x, signals=signals)
    names = tuple(dict.fromkeys(name for columns in wanted.values() for name in columns))
    table = _scaled(file, names, file.read(names), scale)
    if time is not None and time not in scale:
        _refuse_ticks(file, time, table[:, names.index(time)])
    _check(file, names, table, time)
    values = {key: table[:, [names.index(name) for name in columns]] for key, columns in wanted.items()}
    if "time" in values:
        values["time"] = values["time"][:, 0]
    return LogColumns(x, with_inertia(values))


def wanted_columns(
    file: Header,
    *,
    time: str | None,
    x: Sequence[str],
    signals: Mapping[str, Sequence[str] | EllipsisType | None],
) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Columns of x, and columns by signal, as :func:`read_log` takes them; every one of them is there."""
    x = _names("x", x)
    given = {
        key: _names(key, value)
        for key, value in signals.items()
        if not isinstance(value, EllipsisType | None)
    }
    for key, names in given.items():
        expected = {"features": (len(names),), "inertia": (len(x), len(x) ** 2)}.get(key, (len(x),))
        if len(names) not in expected:
            raise ValueError(
                f"{key}: expected {' or '.join(map(str, expected))} columns for the {len(x)} of x, got {len(names)}"
            )
    wanted = {**({} if time is None else {"time": (time,)}), "x": x, **given}
    _refuse_missing(file, wanted)
    for key, value in signals.items():
        if isinstance(value, EllipsisType) and (found := _found_defaults(file, key, x)):
            wanted[key] = found
    return x, wanted


def with_inertia(values: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """Signals with the columns of M as matrices, where there are any."""
    if "inertia" not in values:
        return values
    n, n_x = values["x"].shape
    rows = values["inertia"]
    full = rows.reshape(n, n_x, n_x) if rows.shape[1] == n_x * n_x else rows
    return {**values, "inertia": checks.full_inertia(full, n, n_x, varies=True)}


def _names(option: str, names: Sequence[str]) -> tuple[str, ...]:
    # A string is a sequence of its letters; taken as such it would look for columns "v" and "x".
    if not isinstance(names, Iterable):
        raise TypeError(f"{option}: expected names of columns, got {names!r}")
    names = (names,) if isinstance(names, str) else tuple(names)
    if not names or not all(isinstance(name, str) for name in names):
        raise TypeError(f"{option}: expected names of columns, got {names!r}")
    if len(set(names)) < len(names):
        raise ValueError(f"{option}: names a column twice: {names}")
    return names


def _refuse_missing(file: Header, wanted: Mapping[str, Sequence[str]]) -> None:
    missing = [
        f"{name!r} ({key})" for key, names in wanted.items() for name in names if name not in file.header
    ]
    if missing:
        raise ValueError(
            f"{file.path}: no column {', '.join(missing)}; {_place(file)} {', '.join(file.header)}; name "
            "the columns by the options time=, x=, ... or check the delimiter"
        )


def _place(file: Header) -> str:
    return f"line {file.header_line} has" if isinstance(file, CsvFile) else "it has"


def _found_defaults(file: Header, signal: str, x: tuple[str, ...]) -> tuple[str, ...]:
    """The default columns of a signal if the file has them; some without the others are a mistake."""
    widths = {"features": (len(file.header),), "inertia": (len(x), len(x) ** 2)}.get(signal, (len(x),))
    for width in widths:
        names = default_columns(signal, x, width)
        present = tuple(name for name in names if name in file.header)
        if signal == "features":
            names = names[: len(present)]  # as many as there are, but none left out between
        if present == tuple(names):
            return present
        if present:
            absent = [name for name in names if name not in present]
            raise ValueError(
                f"{file.path}: has {', '.join(present)} but no {', '.join(absent)}; name the columns of {signal}= or "
                f"leave it out by {signal}=None"
            )
    return ()


def _scaled(file: CsvFile, names: Sequence[str], table: FloatArray, scale: Mapping[str, float]) -> FloatArray:
    for column, factor in scale.items():
        if column not in names:
            raise ValueError(f"scale: no column {column!r} is read from {file.path}, only {', '.join(names)}")
        if not (np.isfinite(factor) and factor != 0.0):
            raise ValueError(f"scale: expected a finite factor other than 0 for {column!r}, got {factor!r}")
    with np.errstate(over="ignore"):  # an infinity is refused by its line
        return table * np.array([scale.get(name, 1.0) for name in names]) if scale else table


def _refuse_ticks(file: CsvFile, time: str, times: FloatArray) -> None:
    if file.first(time).lstrip("+-").isdigit():
        name = f"{file.path}: column {time!r}"
        factors = f"scale={{{time!r}: 1e-3}} (ms), 1e-6 (us) or 1e-9 (ns)"
        refuse_ticks(name, times, f"a factor, {factors}; if they are seconds, the factor 1.0")


def _check(file: CsvFile, names: Sequence[str], table: FloatArray, time: str | None) -> None:
    def line(index: int) -> str:  # a pass over the file, for an error only
        return f"line {file.line_numbers()[index]}"

    refuse_unusable(str(file.path), table, [f"column {name!r}" for name in names], line)
    if time is not None:
        refuse_unordered(f"{file.path}: column {time!r}", table[:, names.index(time)], line)
    if len(table) < 2:
        raise ValueError(f"{file.path}: expected at least 2 rows, got {len(table)}")
