"""Variables of an FMU as one vector of numbers, read and set in as few calls as there are types."""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from .inspect import FmuDescription, FmuVariable

__all__ = ["OPAQUE", "Signals", "is_numeric", "recorded"]

OPAQUE = ("String", "Binary")  # types that no number stands for

AnyArray = NDArray[Any]

_FMI2_TYPES = {
    "Float64": ("Real", ctypes.c_double),
    "Int32": ("Integer", ctypes.c_int),
    "Enumeration": ("Integer", ctypes.c_int),
    "Boolean": ("Boolean", ctypes.c_int),
}
_FMI3_TYPES: dict[str, tuple[str, type]] = {
    "Float32": ("Float32", ctypes.c_float),
    "Float64": ("Float64", ctypes.c_double),
    "Enumeration": ("Int64", ctypes.c_int64),
    "Boolean": ("Boolean", ctypes.c_bool),
} | {
    f"{s}Int{n}": (f"{s}Int{n}", getattr(ctypes, f"c_{s.lower()}int{n}"))
    for s in ("", "U")
    for n in (8, 16, 32, 64)
}


class Group(NamedTuple):
    """Variables of one type: the functions that read and set them, and where their values are."""

    get: str
    set: str
    references: ctypes.Array[ctypes.c_uint]
    counts: tuple[int, ...]
    values: ctypes.Array[Any]
    view: NDArray[Any]
    places: NDArray[np.intp]


class Callee(Protocol):
    """An instance, as far as signals need it."""

    def call_raw(self, function: str, *arguments: object) -> None:
        """Call a function of the FMU and check its status."""
        ...


def recorded(
    description: FmuDescription, patterns: Sequence[str] | None, *, numeric: bool = True
) -> list[FmuVariable]:
    """Variables to be put out: the outputs, or those of any causality whose names match.

    Parameters
    ----------
    description : FmuDescription
    patterns : sequence of str, optional
        Names, in which * stands for any characters and ? for one.
    numeric : bool
        Numbers, which alone are signals; or else String and Binary variables. A pattern may match those only.

    Returns
    -------
    list of FmuVariable
        As the description has them.

    Raises
    ------
    ValueError
        If a pattern matches none.
    """
    fmi = description.fmi
    numbers = [entry for entry in description.variables if is_numeric(entry, fmi)]
    others = [entry for entry in description.variables if entry.type in OPAQUE]
    possible = numbers if numeric else others
    if patterns is None:
        return [entry for entry in possible if entry.causality == "output"]
    if isinstance(patterns, str):
        raise ValueError(f"outputs: expected a list of names or patterns, got the text {patterns!r}")
    found: set[str] = set()
    for pattern in patterns:
        # Only * and ? are patterns: brackets are part of many a name.
        rule = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."))
        matching = {entry.name for entry in (*numbers, *others) if rule.fullmatch(entry.name)}
        if not matching:
            raise ValueError(
                f"outputs: no numeric variable of {description.path} matches {pattern!r}, nor a String or Binary one"
            )
        found |= matching
    return [entry for entry in possible if entry.name in found]


def is_numeric(variable: FmuVariable, fmi: str) -> bool:
    """Whether a variable can be a signal.

    Parameters
    ----------
    variable : FmuVariable
    fmi : str
        "2.0" or "3.0".
    """
    return variable.type in (_FMI2_TYPES if fmi == "2.0" else _FMI3_TYPES)


class Signals:
    """Some variables of an instance as one vector of numbers.

    Parameters
    ----------
    variables : sequence of FmuVariable
    fmi : str
        "2.0" or "3.0".
    """

    def __init__(self, variables: Sequence[FmuVariable], fmi: str) -> None:
        self.labels: tuple[str, ...] = tuple(label for variable in variables for label in variable.labels)
        self.units: tuple[str, ...] = tuple(variable.unit for variable in variables for _ in variable.labels)
        self.references: tuple[int, ...] = tuple(variable.reference for variable in variables)
        types = _FMI2_TYPES if fmi == "2.0" else _FMI3_TYPES
        prefix = f"fmi{fmi[0]}"
        places: dict[str, list[int]] = {}
        self._variables: tuple[FmuVariable, ...] = tuple(
            variable for variable in variables for _ in variable.labels
        )
        chosen: dict[str, list[FmuVariable]] = {}
        start = 0
        for variable in variables:
            if variable.type not in types:
                raise ValueError(f"{variable.name}: a variable of type {variable.type} cannot be a signal")
            key = types[variable.type][0]
            count = len(variable.labels)
            chosen.setdefault(key, []).append(variable)
            places.setdefault(key, []).extend(range(start, start + count))
            start += count
        self.groups: list[Group] = []
        c_types: dict[str, Any] = dict(types.values())
        for key, entries in chosen.items():
            references = (ctypes.c_uint * len(entries))(*(entry.reference for entry in entries))
            values = (c_types[key] * len(places[key]))()
            counts = (len(entries),) if fmi == "2.0" else (len(entries), len(places[key]))
            view = np.ctypeslib.as_array(values)
            self.groups.append(
                Group(
                    f"{prefix}Get{key}",
                    f"{prefix}Set{key}",
                    references,
                    counts,
                    values,
                    view,
                    np.array(places[key]),
                )
            )

    def __len__(self) -> int:
        return len(self.labels)

    def read(self, instance: Callee) -> FloatArray:
        """Values now.

        Parameters
        ----------
        instance : FmuInstance
        """
        result = np.empty(len(self.labels))
        for get, _, references, counts, values, view, places in self.groups:
            instance.call_raw(get, references, counts[0], values, *counts[1:])
            result[places] = view
        return result

    def write(self, instance: Callee, vector: FloatArray | NDArray[np.object_]) -> None:
        """Set all of them.

        Parameters
        ----------
        instance : FmuInstance
        vector : (len(self),) array
            Of objects where integers may have more digits than a double.

        Raises
        ------
        ValueError
            If a value does not fit the type of its variable: nothing is set then.
        """
        fitting = self.check(vector)
        for (_, put, references, counts, values, view, _), numbers in zip(self.groups, fitting, strict=True):
            view[:] = numbers
            instance.call_raw(put, references, counts[0], values, *counts[1:])

    def check(self, vector: FloatArray | NDArray[np.object_]) -> list[AnyArray]:
        """The values by group, as the types at the FMU's side can hold them.

        Parameters
        ----------
        vector : (len(self),) array

        Raises
        ------
        ValueError
            If a value does not fit the type of its variable.
        """
        return [self._fitting(vector[group.places], group) for group in self.groups]

    def _fitting(self, values: AnyArray, group: Group) -> AnyArray:
        """The values, if the type at the FMU's side can hold all of them."""
        if group.view.dtype == np.float64:
            return values
        for value, place in zip(values.tolist(), group.places.tolist(), strict=True):
            variable = self._variables[place]
            if problem := _misfit(variable, value, group.view.dtype):
                raise ValueError(f"{self.labels[place]} ({variable.type}): {problem}, got {value!r}")
        return values


def _misfit(variable: FmuVariable, value: float | int, kind: np.dtype[Any]) -> str:
    """What was expected of a value; "" where it fits."""
    if kind == np.float32:
        limit = float(np.finfo(np.float32).max)
        return f"expected at most {limit:g}" if math.isfinite(value) and abs(value) > limit else ""
    if variable.type == "Boolean":
        return "" if value in (0.0, 1.0) else "expected 0 or 1"
    if isinstance(value, float) and (not math.isfinite(value) or value != math.floor(value)):
        return "expected an integer"
    if variable.items:
        return (
            "" if int(value) in variable.items else f"expected one of {', '.join(map(str, variable.items))}"
        )
    limits = np.iinfo(kind)
    fits = int(limits.min) <= int(value) <= int(limits.max)
    return "" if fits else f"expected {limits.min} to {limits.max}"
