"""Strings and bytes in a co-simulation: what no number stands for is handed on and recorded as it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from .cosimulation_part import Part, StuckError
from .cosimulation_wiring import Connection, Wire
from .values import Opaque

__all__ = ["TextExchange", "text_wires"]


def text_wires(
    parts: Sequence[Part], connections: Sequence[Connection | Wire]
) -> tuple[dict[str, str], list[Connection | Wire]]:
    """Take the wires of String and Binary variables out of the others.

    Parameters
    ----------
    parts : sequence of Part
    connections : sequence
        As of ``wire_up``.

    Returns
    -------
    wires : dict of str to str
        Output by the input it drives, ``part.signal`` both.
    others : list
        Connections of numbers.

    Raises
    ------
    ValueError
        If a wire's ends have different types, an input is driven twice, or several outputs or a factor drive one.
    """
    inputs = {f"{part.name}.{label}": kind for part in parts for label, kind in part.text_inputs.items()}
    outputs = {f"{part.name}.{label}": kind for part in parts for label, kind in part.text_outputs.items()}
    wires: dict[str, str] = {}
    others: list[Connection | Wire] = []
    for entry in connections:
        sink, *sources = (entry.sink, entry.source) if isinstance(entry, Wire) else entry
        ends = [_among(sink, inputs), *(_among(source.removeprefix("-"), outputs) for source in sources)]
        if not any(ends):
            others.append(entry)
            continue
        if not all(ends):
            place = next(i for i, end in enumerate(ends) if end)
            label, kind = (sink, *sources)[place], (inputs if place == 0 else outputs)[ends[place][0]]
            numbers = ", ".join(
                repr(word) for word, end in zip((sink, *sources), ends, strict=True) if not end
            )
            raise ValueError(
                f"connections: {label!r} is {kind} and {numbers} a number, or not there: {kind} goes to {kind} only"
            )
        scaled = isinstance(entry, Wire) and (entry.gain != 1.0 or entry.offset != 0.0)
        if len(sources) != 1 or sources[0].startswith("-") or scaled:
            raise ValueError(
                f"connections: {sink!r} is {inputs[ends[0][0]]}: expected one output as it is, no sum"
            )
        if len(ends[0]) != len(ends[1]):
            raise ValueError(
                f"connections: {sink!r} has {len(ends[0])} signals, {sources[0]!r} has {len(ends[1])}; expected as many"
            )
        for one, other in zip(*ends, strict=True):
            if inputs[one] != outputs[other]:
                raise ValueError(
                    f"{one!r} is {inputs[one]} and {other!r} {outputs[other]}, which it cannot take"
                )
            if one in wires:
                raise ValueError(f"connections: {one!r} is driven twice")
            wires[one] = other
    return wires, others


def _among(label: str, known: dict[str, str]) -> list[str]:
    """A signal, or all elements of an array by its name."""
    return [label] if label in known else [name for name in known if name.startswith(f"{label}[")]


class TextExchange:
    """Strings and bytes of a run.

    Parameters
    ----------
    parts : sequence of Part
    wires : dict of str to str
        From :func:`text_wires`.
    wanted : dict of str to str
        Outputs to be recorded, by the names that they get; others than String and Binary are left to the numbers.
    """

    def __init__(self, parts: Sequence[Part], wires: dict[str, str], wanted: Mapping[str, str]) -> None:
        owners = {f"{part.name}.{label}": (part, label) for part in parts for label in part.text_outputs}
        sinks = {f"{part.name}.{label}": (part, label) for part in parts for label in part.text_inputs}
        self._wires = [(*sinks[sink], *owners[source]) for sink, source in wires.items()]
        self._wanted = {name: owners[label] for name, label in wanted.items() if label in owners}
        self._last: list[Opaque | None] = [None] * len(self._wires)
        self._rows: dict[str, list[Opaque]] = {name: [] for name in self._wanted}

    @property
    def there(self) -> bool:
        """Whether there is anything to do."""
        return bool(self._wires or self._wanted)

    def hand_on(self, to: Part | None = None) -> bool:
        """Give inputs what drives them, of one part or of all; whether one has changed.

        Parameters
        ----------
        to : Part, optional
        """
        changed = False
        for i, (sink, label, source, output) in enumerate(self._wires):
            if to is not None and sink is not to:
                continue
            value = source.get_text(output)
            if value != self._last[i]:
                sink.put_text(label, value)
                self._last[i], changed = value, True
        return changed

    def until_rest(self, t: float) -> Iterator[None]:
        """Hand on at one instant, as often as numbers that are settled in between change texts.

        Parameters
        ----------
        t : float
            Seconds.

        Raises
        ------
        StuckError
            If that does not end.
        """
        self.hand_on()
        for _ in range(len(self._wires) + 1):
            yield
            if not self.hand_on():
                return
        names = ", ".join(f"{sink.name}.{label}" for sink, label, _, _ in self._wires)
        raise StuckError(f"texts do not come to rest at t = {t:g}: {names} depend on themselves")

    def forget(self) -> None:
        """Parts have gone back: their inputs are no longer what they were last set to."""
        self._last = [None] * len(self._wires)

    def record(self) -> None:
        """Note the outputs that are wanted."""
        for name, (part, label) in self._wanted.items():
            self._rows[name].append(part.get_text(label))

    @property
    def rows(self) -> dict[str, NDArray[np.object_]]:
        """What was noted, by output."""
        found: dict[str, NDArray[np.object_]] = {}
        for name, values in self._rows.items():
            found[name] = np.empty(len(values), dtype=object)
            found[name][:] = values
        return found
