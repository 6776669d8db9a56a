"""Typed reading of TOML tables: every complaint names the file and the key."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

__all__ = ["TomlTable", "parsed", "refuse_oversize"]

_Entry = TypeVar("_Entry")
_LARGEST = 500_000  # bytes; parsed in a fraction of a second
# A key of more parts, a.b.c...: the reader takes time and memory with the square of their number.
_DEEPEST = 16
_PART = r"""(?:[\w-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*')[ \t]*\.[ \t]*"""
_DEEP_KEY = re.compile(rf"(?:^|[\[{{,\n])[ \t]*(?:{_PART}){{{_DEEPEST}}}")
_SHOWN = 60  # characters of an offending value that an error repeats
_KINDS = {
    bool: "true or false",
    int: "an integer",
    float: "a number",
    str: "text",
    list: "a list",
    dict: "a table",
}


@dataclass(frozen=True)
class TomlTable:
    """One table of a file.

    Attributes
    ----------
    file : Path
    where : str
        What stands before a key of this table in a message: "", "sampled.", "filters[1].", ...
    values : mapping
        As the TOML reader gives them.
    """

    file: Path
    where: str
    values: Mapping[str, object]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def error(self, key: str, problem: str) -> ValueError:
        """The error to raise about a key."""
        return ValueError(f"{self.file}: {self.where}{key}: {problem}")

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Raise for a key that means nothing here: most likely a misspelt one, which would be passed over."""
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                hint = f"did you mean {near[0]!r}? " if near else ""
                raise self.error(key[:_SHOWN], f"unknown key; {hint}expected one of {', '.join(known)}")

    def refuse_other_formats(self, name: str, version: int, kind: str) -> None:
        """Raise unless the file says that it is of this format and version."""
        if "format" not in self:
            raise self.error("format", f'missing: no {kind} file; expected format = "{name}"')
        if (found := self.text("format")) != name:
            raise self.error("format", f"expected {name!r}, got {found!r}: not a {kind} file")
        if "version" not in self:
            raise self.error("version", f"missing; expected version = {version}")
        if (given := self.integer("version")) != version:
            remedy = "update phyfilter-ctl" if given > version else "there is no such version"
            said = f"this file has version {given}, this library reads version {version}; {remedy}"
            raise self.error("version", said)

    def number(self, key: str) -> float:
        """A finite number."""
        return self._number(key, self._get(key))

    def integer(self, key: str) -> int:
        """A whole number, written as such."""
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._wrong(key, "an integer", value)
        return value

    def text(self, key: str) -> str:
        """A string."""
        return self._text(key, self._get(key))

    def texts(self, key: str) -> list[str]:
        """A list of strings."""
        return self._list(key, self._get(key), "a list of text", self._text)

    def numbers(self, key: str) -> list[float]:
        """A list of finite numbers."""
        return self._numbers(key, self._get(key))

    def number_or_numbers(self, key: str) -> float | list[float | list[float]]:
        """A number, a list of them, or one of lists of them; ``inf`` is allowed."""

        def number(key: str, value: object) -> float:
            return self._number(key, value, infinite=True)

        def entry(key: str, value: object) -> float | list[float]:
            return self._list(key, value, "", number) if isinstance(value, list) else number(key, value)

        value = self._get(key)
        return self._list(key, value, "", entry) if isinstance(value, list) else number(key, value)

    def matrix(self, key: str, *, columns: int | None = None) -> list[list[float]]:
        """A list of rows of finite numbers, all of one length."""
        expected = "a list of rows" if columns is None else f"a list of rows of {columns} numbers"
        rows = self._list(key, self._get(key), expected, self._numbers)
        width = columns if columns is not None else len(rows[0]) if rows else 0
        for i, row in enumerate(rows):
            if len(row) != width:
                raise self.error(f"{key}[{i}]", f"expected {width} numbers, got {len(row)}")
        return rows

    def numbers_of_any_shape(self, key: str) -> float | list[float] | list[list[float]]:
        """A number, a list of numbers or a matrix."""
        value = self._get(key)
        if not isinstance(value, list):
            return self._number(key, value)
        return self.matrix(key) if value and isinstance(value[0], list) else self.numbers(key)

    def table(self, key: str) -> TomlTable:
        """A table within this one."""
        return self._table(key, self._get(key))

    def tables(self, key: str) -> list[TomlTable]:
        """A list of at least one table."""
        found = self._list(key, self._get(key), f"[[{key}]] tables", self._table)
        if not found:
            raise self.error(key, "expected at least one table, got none")
        return found

    def _get(self, key: str) -> object:
        if key not in self.values:
            raise self.error(key, "missing")
        return self.values[key]

    def _wrong(self, key: str, expected: str, value: object) -> ValueError:
        kind = _KINDS.get(type(value), "a date or time")
        return self.error(key, f"expected {expected}, got {kind}: {_short(value)}")

    def _number(self, key: str, value: object, *, infinite: bool = False) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._wrong(key, "a number", value)
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isnan(number) or (math.isinf(number) and not (infinite and isinstance(value, float))):
            raise self.error(key, f"expected a finite number, got {_short(value)}")
        return number

    def _text(self, key: str, value: object) -> str:
        if not isinstance(value, str):
            raise self._wrong(key, "text", value)
        return value

    def _numbers(self, key: str, value: object) -> list[float]:
        return self._list(key, value, "a list of numbers", self._number)

    def _table(self, key: str, value: object) -> TomlTable:
        if not isinstance(value, dict):
            raise self._wrong(key, "a table", value)
        return TomlTable(self.file, f"{self.where}{key}.", value)

    def _list(
        self, key: str, value: object, expected: str, entry: Callable[[str, object], _Entry]
    ) -> list[_Entry]:
        if not isinstance(value, list):
            raise self._wrong(key, expected, value)
        return [entry(f"{key}[{i}]", item) for i, item in enumerate(value)]


def parsed(path: Path) -> Mapping[str, object]:
    """What a TOML file holds, read in a time that goes with its length.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is no TOML (the line is named), or larger than a filter can be.
    """
    with path.open("rb") as file:
        data = file.read(_LARGEST + 1)
    try:
        refuse_oversize(data)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:  # also text that is not UTF-8
        raise ValueError(f"{path}: no TOML file: {error}") from error


def refuse_oversize(data: bytes) -> None:
    """Raise for a file that would take long to parse."""
    if len(data) > _LARGEST:
        raise ValueError(f"expected a filter file of at most {_LARGEST} bytes, got more")
    if _DEEP_KEY.search(data.decode("utf-8", "replace")):
        raise ValueError(f"expected keys of at most {_DEEPEST} parts, got one of more")


def _short(value: object) -> str:
    try:
        text = repr(value)
    except ValueError:  # Python prints no integer of more than some thousand digits
        text = "an integer of very many digits"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
