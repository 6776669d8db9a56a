"""Which format a file has: by its first bytes, then by its name."""

from __future__ import annotations

import string
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from .contents import Contents

Reader = Callable[[Path, str | None, str | None], Contents]


@dataclass(frozen=True)
class Format:
    """Module that reads it, package it needs, and whether it is a table with a column of times."""

    module: str
    package: str = ""
    table: bool = False

    def reader(self) -> Reader:
        """Its function ``read(path, time_unit, time)``."""
        return import_module(f".{self.module}", __package__).read


FORMATS = {
    "csv": Format("tables", table=True),
}

_HEAD = 1024
_MAGIC: tuple[tuple[bytes, str], ...] = ()
_NAMES: dict[str, str] = {}
_TEXT = set(string.printable.encode()) | set(range(128, 256))


def format_of(path: Path) -> str:
    """Format of a file.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is empty or of no known format.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        raise ValueError(f"{path}: the file is empty")
    for magic, name in _MAGIC:
        if head.startswith(magic):
            return name
    suffix = path.suffix.lower()
    if suffix in _NAMES:
        return _NAMES[suffix]
    if set(head) <= _TEXT:
        return "csv"
    raise ValueError(f"{path}: begins as no format that is known here: {', '.join(FORMATS)}")
