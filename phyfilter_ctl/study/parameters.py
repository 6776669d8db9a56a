"""The numbers of a system: a TOML file that gives each one its value, unit and reason, read into frozen dataclasses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from .._intake import limited
from ..filterfile.table import TomlTable, parsed

__all__ = ["parameter_file", "read_parameters"]

T = TypeVar("T")

_ENTRY = {"value", "unit", "reason"}


def parameter_file(path: str | Path, kind: type[T]) -> Callable[[], T]:
    """A function without arguments that gives the numbers of a file, which it reads once, when it is first called.

    Parameters
    ----------
    path : str or Path
    kind : type
        As for :func:`read_parameters`.

    Returns
    -------
    function () -> kind
        Raises what :func:`read_parameters` does.
    """
    return cache(lambda: read_parameters(path, kind))


def read_parameters(path: str | Path, kind: type[T], *, defaults: str | Path | None = None) -> T:
    """Read the numbers of a system.

    Parameters
    ----------
    path : str or Path
        TOML. A table for each field of ``kind``; in it, for each field of that table's dataclass,
        ``name = { value = .., unit = "..", reason = ".." }``.
    kind : type
        A frozen dataclass whose fields are frozen dataclasses, one for each table.
    defaults : str or Path, optional
        A complete file; ``path`` then has only what differs.

    Returns
    -------
    kind
        With the values; arrays are tuples.

    Raises
    ------
    OSError
        If there is no such file.
    ValueError
        If it is no TOML; for tables or keys that are missing or unknown, or a number that is not finite, or has no unit
        or reason.

    Examples
    --------
    >>> import tempfile
    >>> from dataclasses import make_dataclass
    >>> Body = make_dataclass("Body", [("mass", float)], frozen=True)
    >>> Cart = make_dataclass("Cart", [("body", Body)], frozen=True)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "cart.toml")
    ...     _ = file.write_text('[body]\\nmass = { value = 1.5, unit = "kg", reason = "weighed" }\\n')
    ...     read_parameters(file, Cart)
    Cart(body=Body(mass=1.5))
    """
    path = Path(path)
    data = _toml(path)
    tables = get_type_hints(kind)
    if defaults is not None:
        usual = _toml(Path(defaults))
        unknown = [
            f"{table}.{key}" for table in data for key in data[table] if key not in usual.get(table, {})
        ]
        if unknown:
            raise ValueError(
                f"{path.name}: unknown {', '.join(unknown)}; {Path(defaults).name} has no such entries"
            )
        data = {table: entries | data.get(table, {}) for table, entries in usual.items()}
    _expect_keys(path.name, "tables", tables, data)
    return kind(**{name: _table(f"{path.name}: [{name}]", data[name], tables[name]) for name in tables})


def _toml(path: Path) -> dict[str, Any]:
    top = TomlTable(path, "", parsed(path))
    return {name: top.table(name).values for name in top.values}


def _table(where: str, table: Mapping[str, Mapping[str, Any]], kind: type[T]) -> T:
    names = [entry.name for entry in fields(kind)]  # pyright: ignore[reportArgumentType] - a dataclass by contract
    _expect_keys(where, "keys", names, table)
    for name, entry in table.items():
        if not isinstance(entry, dict) or set(entry) != _ENTRY or not (entry["unit"] and entry["reason"]):
            raise ValueError(f"{where} {name}: expected value, unit and reason, got {str(entry)[:60]}")
    return kind(**{name: _frozen(f"{where} {name}", table[name]["value"]) for name in names})


def _expect_keys(where: str, what: str, expected: Iterable[str], got: Iterable[str]) -> None:
    wanted, given = sorted(expected), sorted(got)
    if wanted != given:
        raise ValueError(f"{where}: expected the {what} {', '.join(wanted)}, got {', '.join(given)}")


def _frozen(where: str, value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_frozen(where, entry) for entry in value)
    with limited(where):
        if isinstance(value, int | float) and not math.isfinite(value):
            raise ValueError(f"{where}: expected finite numbers, got {value}")
    return value
