"""The numbers of a model: a TOML file that gives each one its value, unit and reason, read into frozen dataclasses."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

__all__ = ["read"]

T = TypeVar("T")

_ENTRY = {"value", "unit", "reason"}


def read(path: Path, kind: type[T]) -> T:
    """Read the parameters of a model.

    Parameters
    ----------
    path : Path
        TOML. A table for each field of ``kind``; in it, for each field of that table's dataclass,
        ``name = { value = .., unit = "..", reason = ".." }``.
    kind : type
        A frozen dataclass whose fields are frozen dataclasses, one for each table.

    Returns
    -------
    kind
        With the values; arrays are tuples.

    Raises
    ------
    ValueError
        For tables or keys that are missing or unknown, or a number without unit or reason.
    """
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    tables = get_type_hints(kind)
    _expect_keys(path.name, "tables", tables, data)
    return kind(**{name: _table(f"{path.name}: [{name}]", data[name], tables[name]) for name in tables})


def _table(where: str, table: Mapping[str, Mapping[str, Any]], kind: type[T]) -> T:
    names = [entry.name for entry in fields(kind)]  # pyright: ignore[reportArgumentType] - a dataclass by contract
    _expect_keys(where, "keys", names, table)
    for name, entry in table.items():
        if set(entry) != _ENTRY or not (entry["unit"] and entry["reason"]):
            raise ValueError(f"{where} {name}: expected value, unit and reason, got {sorted(entry)}")
    return kind(**{name: _frozen(table[name]["value"]) for name in names})


def _expect_keys(where: str, what: str, expected: Iterable[str], got: Iterable[str]) -> None:
    wanted, given = sorted(expected), sorted(got)
    if wanted != given:
        raise ValueError(f"{where}: expected the {what} {', '.join(wanted)}, got {', '.join(given)}")


def _frozen(value: Any) -> Any:
    return tuple(_frozen(entry) for entry in value) if isinstance(value, list) else value
