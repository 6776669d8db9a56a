"""Who drives whom in a co-simulation."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Literal

import numpy as np
from scipy.linalg import block_diag

from .._sections import FloatArray
from .cosimulation_part import Part
from .units import FmuUnit

__all__ = ["Connection", "Wire", "Wiring", "block_feedthrough", "wire_up"]

Connection = Sequence[str]


@dataclass(frozen=True)
class Wire:
    """One output that drives one input: input += gain * output + offset.

    Parameters
    ----------
    sink, source : str
        ``part.signal``.
    gain, offset : float
    convert : bool
        False where units are not to be compared (SSP's suppressUnitConversion).
    """

    sink: str
    source: str
    gain: float = 1.0
    offset: float = 0.0
    convert: bool = True


@dataclass(frozen=True, eq=False)
class Wiring:
    """Wires of a co-simulation as matrices over all inputs u and all outputs y, part after part.

    Parameters
    ----------
    sinks, sources : tuple of str
    weights : (n_u, n_y) array
    offset : (n_u,) array
    driven : (n_u,) bool array
    through : (n_y, n_u) bool array
        Which input acts on which output without delay.
    input_slices, output_slices : tuple of slice
        Of each part.
    passes : int
        How often signals are handed on at one instant until direct feedthrough has reached the last output.
    """

    sinks: tuple[str, ...]
    sources: tuple[str, ...]
    weights: FloatArray
    offset: FloatArray
    driven: np.ndarray
    through: np.ndarray
    input_slices: tuple[slice, ...]
    output_slices: tuple[slice, ...]
    passes: int

    def sink(self, label: str) -> int:
        """Place of an input in u.

        Parameters
        ----------
        label : str
        """
        return _place(label, self.sinks, "input")

    def source(self, label: str) -> int:
        """Place of an output in y.

        Parameters
        ----------
        label : str
        """
        return _place(label, self.sources, "output")


def wire_up(
    parts: Sequence[Part],
    connections: Sequence[Connection | Wire],
    *,
    units: Literal["raise", "warn", "ignore"] = "raise",
) -> Wiring:
    """Resolve and check connections.

    Parameters
    ----------
    parts : sequence of Part
    connections : sequence
        ``(input, output, output, ...)`` as in python-control (outputs are summed, "-part.y" is subtracted), or
        :class:`Wire`.
    units : {"raise", "warn", "ignore"}
        Where the units at the ends of a wire differ.

    Raises
    ------
    ValueError
        If a name is unknown, an input is driven twice, or units differ.
    """
    sinks = tuple(f"{part.name}.{label}" for part in parts for label in part.inputs)
    sources = tuple(f"{part.name}.{label}" for part in parts for label in part.outputs)
    weights, offset = np.zeros((len(sinks), len(sources))), np.zeros(len(sinks))
    wires = [wire for entry in connections for wire in _wires(entry, sinks, sources)]
    _refuse_double(connections, sinks)
    for wire in wires:
        i, j = _place(wire.sink, sinks, "input"), _place(wire.source, sources, "output")
        weights[i, j] += wire.gain
        offset[i] += wire.offset
        if units != "ignore" and wire.convert:
            _compare_units(parts, wire, strict=units == "raise")
    driven = np.zeros(len(sinks), dtype=bool)
    driven[[_place(wire.sink, sinks, "input") for wire in wires]] = True
    through = block_feedthrough([part.feedthrough for part in parts])
    return Wiring(
        sinks,
        sources,
        weights,
        offset,
        driven,
        through,
        _slices([len(part.inputs) for part in parts]),
        _slices([len(part.outputs) for part in parts]),
        _passes(through, weights),
    )


def _slices(lengths: Sequence[int]) -> tuple[slice, ...]:
    ends = list(accumulate(lengths, initial=0))
    return tuple(slice(a, b) for a, b in pairwise(ends))


def _wires(entry: Connection | Wire, sinks: tuple[str, ...], sources: tuple[str, ...]) -> list[Wire]:
    if isinstance(entry, Wire):
        return [entry]
    if isinstance(entry, str) or len(entry) < 2 or not all(isinstance(word, str) for word in entry):
        raise ValueError(f'connections: expected ("part.input", "part.output", ...), got {entry!r}')
    targets = _expanded(entry[0], sinks, "input")
    result = []
    for word in entry[1:]:
        gain, label = (-1.0, word[1:]) if word.startswith("-") else (1.0, word)
        origins = _expanded(label, sources, "output")
        if len(origins) != len(targets):
            raise ValueError(
                f"connections: {entry[0]!r} has {len(targets)} signals, {word!r} has {len(origins)}; expected as many"
            )
        result += [Wire(sink, source, gain) for sink, source in zip(targets, origins, strict=True)]
    return result


def _expanded(label: str, known: tuple[str, ...], kind: str) -> list[str]:
    """A signal, or all elements of a vector by its base name."""
    if label in known:
        return [label]
    elements = [name for name in known if name.startswith(f"{label}[")]
    return elements or [known[_place(label, known, kind)]]


def _place(label: str, known: tuple[str, ...], kind: str) -> int:
    try:
        return known.index(label)
    except ValueError:
        close = difflib.get_close_matches(label, known, n=3) or known
        raise ValueError(
            f"{label!r} is not an {kind} of a part; expected part.{kind}, such as {', '.join(close[:3]) or 'none'}"
        ) from None


def _refuse_double(connections: Sequence[Connection | Wire], sinks: tuple[str, ...]) -> None:
    seen: set[str] = set()
    for entry in connections:
        targets = [entry.sink] if isinstance(entry, Wire) else _expanded(entry[0], sinks, "input")
        twice = seen.intersection(targets)
        if twice:
            raise ValueError(
                f"connections: {sorted(twice)[0]!r} is driven twice; list all its sources in one connection to sum them"
            )
        seen.update(targets)


def _compare_units(parts: Sequence[Part], wire: Wire, *, strict: bool) -> None:
    a, b = _unit_of(parts, wire.sink), _unit_of(parts, wire.source)
    problem = _difference(a, b)
    if not problem:
        return
    message = (
        f"{wire.sink!r} is in {a[0]} and {wire.source!r} in {b[0]}: {problem}. Put a gain between them, or pass "
        'units="ignore"'
    )
    if strict:
        raise ValueError(message)
    warnings.warn(message, stacklevel=4)


def _unit_of(parts: Sequence[Part], label: str) -> tuple[str, FmuUnit | None]:
    for part in parts:
        signal = label.removeprefix(f"{part.name}.")
        if signal != label and signal in (*part.inputs, *part.outputs):
            return part.unit(signal)
    return "", None


def _difference(a: tuple[str, FmuUnit | None], b: tuple[str, FmuUnit | None]) -> str:
    """What differs between two units; "" where nothing does or one of them is not known."""
    if a[0] == b[0] or a[1] is None or b[1] is None:
        return ""
    # An angle is a number: rad/s may drive 1/s.
    first, second = ({key: n for key, n in unit.exponents.items() if key != "rad"} for unit in (a[1], b[1]))
    if first != second:
        return "they measure different things"
    if a[1].factor != b[1].factor or a[1].offset != b[1].offset:
        return f"they differ by a factor of {b[1].factor / a[1].factor:g}"
    return ""


def block_feedthrough(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Feedthrough of all parts together.

    Parameters
    ----------
    blocks : sequence of (outputs, inputs) bool array
        Of each part.
    """
    shape = tuple(sum(block.shape[axis] for block in blocks) for axis in (0, 1))
    return np.asarray(block_diag(*blocks), dtype=bool).reshape(shape)


def _passes(through: np.ndarray, weights: FloatArray) -> int:
    """Length of the longest chain of direct feedthrough between outputs, plus one; loops apart, see Loop."""
    n_y = len(through)
    after = (
        through @ (weights != 0.0).astype(int)
    ) > 0  # after[b, a]: output b sees output a at the same instant
    waiting, longest = set(range(n_y)), 1
    ready = {b for b in waiting if not after[b].any()}
    while ready:
        waiting -= ready
        ready = {b for b in waiting if not waiting.intersection(np.flatnonzero(after[b]))}
        longest += bool(ready)
    return longest + bool(waiting)


def parameters_by_part(
    names: Sequence[str], values: Mapping[str, float | int | bool | str]
) -> dict[str, dict[str, float | int | bool | str]]:
    """Split ``part.parameter`` keys; where names nest, the longest part name wins.

    Parameters
    ----------
    names : sequence of str
        Of the parts.
    values : dict

    Raises
    ------
    ValueError
        If a key starts with no part's name.
    """
    result: dict[str, dict[str, float | int | bool | str]] = {name: {} for name in names}
    for key, value in values.items():
        owners = [name for name in names if key.startswith(f"{name}.")]
        if not owners:
            raise ValueError(
                f"parameters: {key!r} names no part; expected part.parameter with one of {list(names)}"
            )
        owner = max(owners, key=len)
        result[owner][key.removeprefix(f"{owner}.")] = value
    return result
