"""Single variables of an instance by name and of any type: values checked, set, and looked at again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from .inspect import FmuDescription, FmuVariable, Scalar
from .signals import OPAQUE, Callee, Signals, is_numeric

__all__ = ["Opaque", "Owner", "by_element", "numbers_among", "opaque", "refused_parameters", "set_values"]

Opaque = str | bytes
_FLOAT32 = 2.0**-23  # two roundings of a number on its way through a single


class Owner(Callee, Protocol):
    """An instance, as far as its values need it."""

    @property
    def name(self) -> str:
        """Of the instance."""
        ...

    @property
    def description(self) -> FmuDescription:
        """Of its FMU."""
        ...

    def get_opaque(self, variable: FmuVariable) -> tuple[Opaque, ...]:
        """Elements of a String or Binary variable."""
        ...

    def set_opaque(self, variable: FmuVariable, values: Sequence[Opaque]) -> None:
        """Set all elements of a String or Binary variable."""
        ...


def opaque(variables: Sequence[FmuVariable]) -> dict[str, FmuVariable]:
    """The String and Binary variables among some, by the labels of their elements.

    Parameters
    ----------
    variables : sequence of FmuVariable
    """
    return {label: entry for entry in variables if entry.type in OPAQUE for label in entry.labels}


def by_element(description: FmuDescription, values: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """Values of whole arrays as values of their elements.

    Parameters
    ----------
    description : FmuDescription
    values : dict
        By variable or by element, which goes before.
    """
    arrays = {entry.name: entry.labels for entry in description.variables if entry.shape}
    whole = {label: value for name, value in values.items() for label in arrays.get(name, ())}
    return whole | {name: value for name, value in values.items() if name not in arrays}


def numbers_among(description: FmuDescription, values: Mapping[str, Scalar]) -> dict[str, float]:
    """Those of some values that are of numeric variables, as doubles.

    Parameters
    ----------
    description : FmuDescription
    values : dict
        By element.

    Raises
    ------
    ValueError
        If a value is no number.
    """
    numeric = {
        label: entry
        for entry in description.variables
        if is_numeric(entry, description.fmi)
        for label in entry.labels
    }
    return {
        label: float(_as_number(label, numeric[label], value))
        for label, value in values.items()
        if label in numeric
    }


def set_values(owner: Owner, values: Mapping[str, Scalar], *, running: bool) -> None:
    """Set single variables.

    Parameters
    ----------
    owner : FmuInstance
    values : dict of str to number, text or bytes
        By variable (one value fills an array), or by element of an array.
    running : bool
        Whether elements that are not given have values of their own by now; else they keep their start values.

    Raises
    ------
    ValueError
        If there is no such variable, or a value does not fit its type or range. Nothing is set then.
    """
    by_label = {
        label: entry for entry in owner.description.variables for label in (entry.name, *entry.labels)
    }
    wanted: dict[str, dict[str, Scalar]] = {}
    for label, value in values.items():
        if label not in by_label:
            raise ValueError(f"FMU {owner.name!r}: there is no variable {label!r}")
        wanted.setdefault(by_label[label].name, {})[label] = value
    entries: list[FmuVariable] = []
    numbers: list[float | int] = []
    others: list[tuple[FmuVariable, list[Opaque]]] = []
    for name, given in wanted.items():
        entry = by_label[name]
        if entry.causality == "structuralParameter":
            raise ValueError(
                f"FMU {owner.name!r}: {name} is a structural parameter, which is set before there is an instance: as "
                "a parameter of import_fmu or cosimulate"
            )
        checked = {label: _checked(label, entry, value) for label, value in given.items()}
        whole = {label: checked.get(label, checked.get(name)) for label in entry.labels}
        if None in whole.values():
            whole = _present(owner, entry, running) | {k: v for k, v in whole.items() if v is not None}
        if entry.type in OPAQUE:
            others.append((entry, [value for value in whole.values() if isinstance(value, str | bytes)]))
        else:
            entries.append(entry)
            numbers += [value for value in whole.values() if isinstance(value, float | int)]
    # Objects: integers of 64 bits have more digits than a double.
    Signals(entries, owner.description.fmi).write(owner, np.array(numbers, dtype=object))
    for entry, elements in others:
        owner.set_opaque(entry, elements)


def _present(owner: Owner, entry: FmuVariable, running: bool) -> dict[str, Scalar | None]:
    """What the elements of an array are while nobody sets them."""
    if entry.type in OPAQUE:
        blank: Opaque = "" if entry.type == "String" else b""
        found: Sequence[Scalar] = owner.get_opaque(entry) if running else entry.starts
        return dict(zip(entry.labels, found or (blank,) * len(entry.labels), strict=True))
    if running:
        found = Signals([entry], owner.description.fmi).read(owner).tolist()
    elif entry.start and len(entry.starts) != len(entry.labels):
        raise ValueError(
            f"FMU {owner.name!r}: {entry.name} has another size than by default; give all its {len(entry.labels)} "
            f"elements, or one value for all as {entry.name!r}"
        )
    else:
        found = entry.starts or (0.0,) * len(entry.labels)
    return dict(zip(entry.labels, found, strict=True))


def _checked(label: str, entry: FmuVariable, value: Scalar) -> Scalar:
    """A value as the type of the variable has it."""
    if entry.type == "String":
        if not isinstance(value, str):
            raise ValueError(f"{label} (String): expected a text, got {value!r}")
        if "\0" in value:
            raise ValueError(f"{label} (String): a text in C ends at its first NUL character, got {value!r}")
        return value
    if entry.type == "Binary":
        return _as_bytes(label, value)
    number = _as_number(label, entry, value)
    if number not in entry.starts:  # a start value that breaks its own bounds is the FMU's affair
        low, high = entry.minimum, entry.maximum
        if (low is not None and number < low) or (high is not None and number > high):
            ends = f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}"
            raise ValueError(f"{label} ({entry.type}): expected {ends}, as the FMU says, got {number!r}")
    return number


def _as_bytes(label: str, value: Scalar) -> bytes:
    if isinstance(value, bytes):
        return value
    try:
        return bytes.fromhex(value if isinstance(value, str) else "?")
    except ValueError as error:
        raise ValueError(
            f"{label} (Binary): expected bytes, or a text of hexadecimal digits, got {value!r}"
        ) from error


def _as_number(label: str, entry: FmuVariable, value: Scalar) -> float | int:
    """As the FMU's side can take it, integers to the last digit."""
    words = {"true": 1.0, "false": 0.0} if entry.type == "Boolean" else {}
    whole = not entry.type.startswith("Float")
    try:
        if isinstance(value, str) and value in words:
            return words[value]
        if whole and isinstance(value, str) and value.strip().lstrip("+-").isdecimal():
            return int(value)
        if whole and isinstance(value, int):
            return int(value)
        if isinstance(value, bytes):
            raise ValueError("bytes")
        number = float(value)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{label} ({entry.type}): expected a number, got {value!r}") from error
    if isinstance(value, int) and number != value:
        raise ValueError(
            f"{label} ({entry.type}): {value} has more digits than a double carries, got it as {number:.17g}"
        )
    return number


def refused_parameters(owner: Owner, given: Mapping[str, Scalar]) -> list[str]:
    """Parameters that are others than they were set to: an FMU may refuse one with a warning, and run on.

    Parameters
    ----------
    owner : FmuInstance
    given : dict
        As they were set.
    """
    entries = [
        entry
        for entry in owner.description.of("parameter")
        if is_numeric(entry, owner.description.fmi)
        and not given.keys().isdisjoint((entry.name, *entry.labels))
    ]
    signals = Signals(entries, owner.description.fmi)
    owners = [entry for entry in entries for _ in entry.labels]
    refused = []
    for label, entry, found in zip(signals.labels, owners, signals.read(owner).tolist(), strict=True):
        key = label if label in given else entry.name
        wanted = float(_as_number(label, entry, given[key])) if key in given else found
        if not np.isclose(found, wanted, rtol=_FLOAT32, atol=0.0, equal_nan=True):
            refused.append(f"{label} is {found:g}, not {wanted:g}")
    return refused
