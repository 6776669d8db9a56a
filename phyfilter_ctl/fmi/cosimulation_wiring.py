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
from .inspect import Scalar
from .units import AS_IS, FmuUnit, Linear, conversion

__all__ = ["Connection", "Wire", "Wiring", "as_wires", "block_feedthrough", "refuse_ill_formed", "wire_up"]

Connection = Sequence[str]
# A signal drives what has its rank or a higher one; ranges of integers are checked in the run.
_RANKS = {"Boolean": 0, "Enumeration": 1, "Int64": 2, "Float32": 3, "Float64": 3}


@dataclass(frozen=True)
class Wire:
    """One output that drives one input: input += gain * output + offset, in the input's unit.

    Parameters
    ----------
    sink, source : str
        ``part.signal``.
    gain, offset : float
    convert : bool
        False where units are neither compared nor converted (SSP's suppressUnitConversion).
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
    units: Literal["raise", "convert", "warn", "ignore"] = "raise",
) -> Wiring:
    """Resolve and check connections.

    Parameters
    ----------
    parts : sequence of Part
    connections : sequence
        ``(input, output, output, ...)`` as in python-control (outputs are summed, "-part.y" is subtracted), or
        :class:`Wire`.
    units : {"raise", "convert", "warn", "ignore"}
        Where the units at the ends of a wire differ.

    Raises
    ------
    ValueError
        If a name is unknown, an input is driven twice, units differ, or an input cannot take what the output may be.
    """
    sinks = tuple(f"{part.name}.{label}" for part in parts for label in part.inputs)
    sources = tuple(f"{part.name}.{label}" for part in parts for label in part.outputs)
    weights, offset = np.zeros((len(sinks), len(sources))), np.zeros(len(sinks))
    wires = as_wires(connections, sinks, sources)
    _refuse_double(connections, sinks)
    signals = {
        f"{part.name}.{label}": (part, label) for part in parts for label in (*part.inputs, *part.outputs)
    }
    for wire in wires:
        i, j = _place(wire.sink, sinks, "input"), _place(wire.source, sources, "output")
        ends = signals[wire.sink], signals[wire.source]
        _refuse_type(wire, *(part.type(label) for part, label in ends))
        change = AS_IS
        if units != "ignore" and wire.convert:
            sink, source = (part.unit(label) for part, label in ends)
            change = _converted(wire, sink, source, units)
        total = Linear(wire.gain, wire.offset).after(change)
        weights[i, j] += total.gain
        offset[i] += total.offset
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


def as_wires(
    connections: Sequence[Connection | Wire], sinks: tuple[str, ...], sources: tuple[str, ...]
) -> list[Wire]:
    """Connections one by one.

    Parameters
    ----------
    connections : sequence
    sinks, sources : tuple of str
        All inputs and outputs there are, ``part.signal``.

    Raises
    ------
    ValueError
        For a name that is none of them, and vectors of different lengths.
    """
    return [wire for entry in connections for wire in _wires(entry, sinks, sources)]


def _slices(lengths: Sequence[int]) -> tuple[slice, ...]:
    ends = list(accumulate(lengths, initial=0))
    return tuple(slice(a, b) for a, b in pairwise(ends))


def _wires(entry: Connection | Wire, sinks: tuple[str, ...], sources: tuple[str, ...]) -> list[Wire]:
    if isinstance(entry, Wire):
        return [entry]
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


def refuse_ill_formed(connections: Sequence[object]) -> None:
    """Refuse what is no connection: neither a wire nor two names or more.

    Parameters
    ----------
    connections : sequence

    Raises
    ------
    ValueError
        If there is one.
    """
    for entry in connections:
        words: Sequence[object] = entry if isinstance(entry, Sequence) and not isinstance(entry, str) else ()
        if not isinstance(entry, Wire) and (
            len(words) < 2 or not all(isinstance(word, str) for word in words)
        ):
            raise ValueError(f'connections: expected ("part.input", "part.output", ...), got {entry!r}')


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


def _converted(
    wire: Wire,
    sink: tuple[str, FmuUnit | None],
    source: tuple[str, FmuUnit | None],
    units: Literal["raise", "convert", "warn"],
) -> Linear:
    """From the source's unit to the sink's; where they may only be compared, as it is."""
    change = conversion(source[1], sink[1]) if sink[0] != source[0] else AS_IS
    if change == AS_IS or (change is not None and units == "convert"):
        return change or AS_IS
    problem = "they measure different things"
    remedy = 'pass units="ignore"'
    if change is not None:
        problem = f"they differ by a factor of {change.gain:g}" + f" and by {change.offset:g}" * bool(
            change.offset
        )
        remedy = 'pass units="convert"'
    message = (
        f"{wire.sink!r} is in {sink[0]} and {wire.source!r} in {source[0]}: {problem}. Put a gain between them, or "
        f"{remedy}"
    )
    if units != "warn":
        raise ValueError(message)
    warnings.warn(message, stacklevel=4)
    return AS_IS


def _refuse_type(wire: Wire, sink: str, source: str) -> None:
    """As in SSP: what may be any number drives numbers alone; integers and truth values drive what holds them all."""
    ranks = [_RANKS.get(kind, _RANKS["Int64"]) for kind in (sink, source)]
    if sink and source and (ranks[0] < ranks[1] or (sink == "Enumeration" and source != sink)):
        raise ValueError(
            f"{wire.sink!r} is {sink} and {wire.source!r} {source}, which it cannot take; put a block between them "
            "that says how the one becomes the other"
        )


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


def parameters_by_part(names: Sequence[str], values: Mapping[str, Scalar]) -> dict[str, dict[str, Scalar]]:
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
    result: dict[str, dict[str, Scalar]] = {name: {} for name in names}
    for key, value in values.items():
        owners = [name for name in names if key.startswith(f"{name}.")]
        if not owners:
            raise ValueError(
                f"parameters: {key!r} names no part; expected part.parameter with one of {list(names)}"
            )
        owner = max(owners, key=len)
        result[owner][key.removeprefix(f"{owner}.")] = value
    return result
