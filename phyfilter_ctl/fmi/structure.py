"""Structural parameters of FMI 3: what they make of an FMU's arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import inf, prod
from pathlib import Path

from .archive import ArchiveLimits, refuse_sizes
from .inspect import FmuDescription, FmuVariable, Scalar

__all__ = ["resized", "structure_among"]


def structure_among(description: FmuDescription, values: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """Those of some values that are structural parameters.

    Parameters
    ----------
    description : FmuDescription
    values : dict
    """
    names = {entry.name for entry in description.of("structuralParameter")}
    return {name: value for name, value in values.items() if name in names}


def resized(
    description: FmuDescription, structure: Mapping[str, Scalar], *, limits: ArchiveLimits | None = None
) -> FmuDescription:
    """An FMU with other structural parameters: its arrays have the lengths that follow.

    Parameters
    ----------
    description : FmuDescription
    structure : dict of str to int
        By name.
    limits : ArchiveLimits, optional
        How many scalars there may be.

    Returns
    -------
    FmuDescription
        Start values of arrays stay as they are given, also where their number is another now.

    Raises
    ------
    ValueError
        If a value is no whole number, or out of the parameter's bounds; or arrays become too large.
    """
    sizes = {
        entry.name: _size(
            description, entry, structure.get(entry.name, entry.starts[0] if entry.starts else 0)
        )
        for entry in description.of("structuralParameter")
    }
    variables = tuple(
        replace(
            entry,
            shape=tuple(sizes.get(axis, n) for axis, n in zip(entry.dimensions, entry.shape, strict=True)),
            start=(sizes[entry.name],) if entry.name in sizes else entry.start,
        )
        for entry in description.variables
    )
    refuse_sizes(Path(description.path), [(entry.name, entry.shape) for entry in variables], limits)
    counts = {entry.name: prod(entry.shape) for entry in variables}
    rates = {entry.name for entry in variables if entry.derivative_of}
    return replace(
        description,
        variables=variables,
        states=sum(counts[name] for name in description.dependencies if name in rates),
        event_indicators=sum(counts[name] for name in description.indicators),
    )


def _size(description: FmuDescription, entry: FmuVariable, value: Scalar) -> int:
    low, high = max(entry.minimum or 0.0, 0.0), inf if entry.maximum is None else entry.maximum
    number = value
    if isinstance(value, str) and value.strip().isdecimal():
        number = int(value)
    whole = isinstance(number, float | int) and not isinstance(number, bool) and number in range(1 << 63)
    if not whole or not low <= float(number) <= high:
        raise ValueError(
            f"{description.path}: {entry.name} ({entry.type}) is a structural parameter: expected a whole number, "
            f"{low:g} to {high:g}, got {value!r}"
        )
    return int(number)
