"""Clocks of one FMU that tick with those of another."""

from __future__ import annotations

from collections.abc import Sequence

from .cosimulation_part import Part
from .cosimulation_wiring import Connection, Wire

__all__ = ["ClockWires"]


class ClockWires:
    """Triggered clocks, and the output clocks of other parts that they tick with.

    Parameters
    ----------
    parts : sequence of Part
    connections : sequence
        As of ``wire_up``, wires of clocks among them.

    Attributes
    ----------
    others : list
        Connections that are none of clocks.

    Raises
    ------
    ValueError
        If a wire has a clock at one end only, or a clock has several to tick with.
    """

    def __init__(self, parts: Sequence[Part], connections: Sequence[Connection | Wire]) -> None:
        sinks = {f"{part.name}.{clock}": (part, clock) for part in parts for clock in part.clocks[0]}
        sources = {f"{part.name}.{clock}": (part, clock) for part in parts for clock in part.clocks[1]}
        self._wires: dict[str, tuple[Part, str]] = {}
        self._sinks = sinks
        self.others: list[Connection | Wire] = []
        for entry in connections:
            sink, *given = (entry.sink, entry.source) if isinstance(entry, Wire) else entry
            if sink not in sinks and not any(source in sources for source in given):
                self.others.append(entry)
                continue
            if sink not in sinks or len(given) != 1 or given[0] not in sources:
                raise ValueError(
                    f"connections: {sink!r} from {', '.join(map(repr, given))}: expected a triggered input clock, of "
                    f"{', '.join(sinks) or 'none'}, and one output clock, of {', '.join(sources) or 'none'}"
                )
            if sink in self._wires:
                raise ValueError(f"connections: {sink!r} is driven twice")
            self._wires[sink] = sources[given[0]]
        self._heard: dict[str, int] = {}

    def ring(self, t: float) -> bool:
        """Trigger, at t, what ticks with clocks that have ticked since this was asked last; whether there is any.

        Parameters
        ----------
        t : float
            Seconds.
        """
        any_rung = False
        for sink, (source, clock) in self._wires.items():
            ticks = source.ticks[self._heard.get(sink, 0) :]
            self._heard[sink] = len(source.ticks)
            if any(name == clock for _, name in ticks):
                part, name = self._sinks[sink]
                part.trigger(name, t)
                any_rung = True
        return any_rung

    def forget(self) -> None:
        """All ticks up to now have been heard: parts were put back, or a run begins."""
        self._heard = {sink: len(source.ticks) for sink, (source, _) in self._wires.items()}
