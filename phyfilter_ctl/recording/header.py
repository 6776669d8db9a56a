"""Names of columns as people write them: with a unit in brackets, in another case, times under their usual names."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

__all__ = ["TICKS", "TIMES", "Columns", "stem", "unit_in", "unit_of_time"]

# Seconds by unit of time, and how else units are spelt.
TICKS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_SPELT = {"sec": "s", "second": "s", "seconds": "s", "µs": "us", "μs": "us"}
TIMES = ("t", "time", "times", "timestamp", "timestamps", "stamp", "timepts", "datetime")
_BRACKETED = re.compile(r"^(.*?)[ _]*[\[(]([^\])]*)[\])]$")
_SUFFIXED = re.compile(r"^(.+)_(s|sec|seconds|ms|us|ns)$")


def unit_in(name: str) -> str:
    """Unit in brackets at the end of a name, ``vx [m/s]``; an index, ``v[0]``, is none."""
    match = _BRACKETED.match(name.strip())
    unit = match[2].strip() if match and match[1] else ""
    return "" if unit.isdigit() or re.fullmatch(r"\d+,\d+", unit) else unit


def unit_of_time(name: str) -> str:
    """That in a name of times, ``t [ms]`` or ``time_us``; empty where there is none."""
    unit = unit_in(name)
    if not unit and (match := _SUFFIXED.match(name.strip())):
        unit = match[2]
    unit = _SPELT.get(unit, unit)
    return unit if unit in TICKS else ""


@dataclass(frozen=True)
class Columns:
    """The columns of a file by their bare names; what :func:`~.columns.wanted_columns` calls a header.

    Parameters
    ----------
    path : Path
    names : tuple of str
        As they stand in the file.
    """

    path: Path
    names: tuple[str, ...]

    @property
    def header(self) -> tuple[str, ...]:
        """Bare names."""
        return tuple(self._bare)

    @cached_property
    def _bare(self) -> Mapping[str, str]:
        """Names in the file by their bare ones; two that are alike keep what tells them apart."""
        bare = [_without_unit(name) for name in self.names]
        return {
            (short if bare.count(short) == 1 and short not in self.names else name): name
            for short, name in zip(bare, self.names, strict=True)
        }

    def found(self, names: str | Sequence[str]) -> str | list[str]:
        """Bare names of what is asked for: so written, with its unit, or in another case; else as it is."""
        if isinstance(names, str):
            return self._found(names)
        if not isinstance(names, Iterable):
            return names  # which is refused by name
        return [self._found(name) if isinstance(name, str) else name for name in names]

    def _found(self, name: str) -> str:
        if name in self._bare:
            return name
        alike = [bare for bare, own in self._bare.items() if own == name]
        alike = alike or [bare for bare in self._bare if bare.lower() == name.lower()]
        return alike[0] if len(alike) == 1 else name

    def own(self, name: str) -> str:
        """The name in the file."""
        return self._bare[name]

    def times(self) -> str | None:
        """Bare name of the only column that is called as times are."""
        alike = [bare for bare, own in self._bare.items() if stem(own) in TIMES]
        return alike[0] if len(alike) == 1 else None

    def unit(self, names: Sequence[str]) -> str:
        """The one unit that all of these columns have in their names; empty where they have none.

        Raises
        ------
        ValueError
            For several.
        """
        units = {unit_in(self._bare[name]) for name in names}
        if len(units) > 1:
            told = ", ".join(repr(self._bare[name]) for name in names)
            raise ValueError(f"{self.path}: expected one unit for all columns of x, got {told}")
        return units.pop() if units else ""


def _without_unit(name: str) -> str:
    match = _BRACKETED.match(name.strip())
    return match[1].strip() if match and match[1] and unit_in(name) else name.strip()


def stem(name: str) -> str:
    """A name without its unit, also one of time behind an underscore, in lower case."""
    bare = _without_unit(name)
    match = _SUFFIXED.match(bare)
    return (match[1] if match else bare).lower()
