"""Order of items from top to bottom, and of the ports of blocks, so that few wires cross."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .grid import Grid, Joint

__all__ = ["ordered"]

_SWEEPS = 6
_PX = 1e-4  # of an item's place: a px of a port's height
_FEW = 8  # crossings: with so many at most a second start may find a better order

Units = list[tuple[int, ...]]


class _Chords(NamedTuple):
    """Wires of a channel as chords of a circle, down its left bank and up its right one."""

    joints: NDArray[np.int64]  # (chords, 2): among all joints
    items: NDArray[np.int64]
    right: NDArray[np.bool_]
    other: NDArray[np.bool_]  # (chords, chords): of different nets


def _chords(joints: Sequence[Joint], start: int) -> _Chords:
    first: dict[int, int] = {}
    pairs = [(first.setdefault(joint.net, j), j) for j, joint in enumerate(joints)]
    at = np.array([pair for pair in pairs if pair[0] != pair[1]], dtype=int).reshape(-1, 2)
    items, right, net = (
        (np.array(column) for column in zip(*((j.item, j.bank > 0, j.net) for j in joints), strict=True))
        if joints
        else (np.zeros(0, int), np.zeros(0, bool), np.zeros(0, int))
    )
    return _Chords(at + start, items[at], right[at], net[at[:, 0], None] != net[at[:, 0]])


def ordered(grid: Grid, main: Collection[int], loose: Collection[int]) -> Grid:
    """A grid with few crossings: by barycentres, then by exchanges that save some.

    Parameters
    ----------
    grid : Grid
    main : collection of int
        Parts of the forward path.
    loose : collection of int
        Parts whose ports may change places.

    Returns
    -------
    Grid
    """
    found = _searched(_Search(grid, main, loose, main_first=True))
    if 0 < found.crossings <= _FEW:
        other = _searched(_Search(grid, main, loose, main_first=False))
        found = other if other.crossings < found.crossings else found
    return grid.ordered(found.table, found.heights)


class _Found(NamedTuple):
    table: list[Units]
    heights: dict[tuple[int, str, int], float]
    crossings: int


def _searched(search: _Search) -> _Found:
    best, least = search.state(), search.total()
    for sweep in range(_SWEEPS):
        if not least:
            break
        search.sweep(onward=sweep % 2 == 0)
        search.exchange_units()
        search.exchange_ports()
        if sweep % 2:
            search.move_wires()
        if (total := search.total()) < least:
            best, least = search.state(), total
    return _Found(*best, least)


class _Search:
    """Columns and heights of ports while they change."""

    def __init__(
        self, grid: Grid, main: Collection[int], loose: Collection[int], *, main_first: bool
    ) -> None:
        self._items, self._loose = grid.items, loose
        self.joints = [joint for joints in grid.channels for joint in joints]
        self._dy = np.array([joint.dy for joint in self.joints]) * _PX
        starts = np.cumsum([0, *map(len, grid.channels)])
        self._chords = [
            _chords(joints, int(start)) for joints, start in zip(grid.channels, starts[:-1], strict=True)
        ]
        self._channel = [c for c, joints in enumerate(grid.channels) for _ in joints]
        self._place = np.zeros(len(grid.items))
        self._low = {
            unit: max((grid.items[i].low for i in unit), key=abs)
            for column in grid.columns
            for unit in column
        }
        self._unit = {i: unit for unit in self._low for i in unit}
        self._table: list[Units] = []
        for column in grid.columns:
            ahead = {unit: any(grid.items[i].part in main for i in unit) == main_first for unit in column}
            self._table.append(
                sorted(column, key=lambda unit, ahead=ahead: (self._low[unit], not ahead[unit]))
            )
            self._number(self._table[-1])
        ports: dict[tuple[int, str], dict[int, list[int]]] = {}  # joints of each port of loose parts
        for j, joint in enumerate(self.joints):
            if joint.port is not None and joint.item in loose:
                ports.setdefault((joint.item, joint.port[0]), {}).setdefault(joint.port[1], []).append(j)
        self._ports = [list(side.values()) for side in ports.values() if len(side) > 1]
        self._wires = self._movable()

    def _movable(self) -> list[list[tuple[int, ...]]]:
        """Of each wire that passes other parts on its way forward: its lanes, and the outputs that end it."""
        found: dict[int, list[tuple[int, ...]]] = {}
        for joint in self.joints:
            item = self._items[joint.item]
            if not item.low and (item.kind == "lane" or item.terminal) and joint.item in self._unit:
                found.setdefault(joint.net, []).append(self._unit[joint.item])
        return [list(dict.fromkeys(units)) for units in found.values()]

    def state(self) -> tuple[list[Units], dict[tuple[int, str, int], float]]:
        """The columns, and the heights of ports of loose parts."""
        heights = {
            (joint.item, *joint.port): round(float(self._dy[j]) / _PX, 6)
            for j, joint in enumerate(self.joints)
            if joint.port is not None and joint.item in self._loose
        }
        return [list(column) for column in self._table], heights

    def total(self) -> int:
        return self._crossings(range(len(self._chords)))

    def _number(self, column: Units) -> None:
        for spot, item in enumerate(i for unit in column for i in unit):
            self._place[item] = spot

    def _crossings(self, channels: Iterable[int]) -> int:
        count = 0
        for c in channels:
            chords = self._chords[c]
            if len(chords.items) > 1:
                ring = self._place[chords.items] + self._dy[chords.joints]
                ring = np.where(chords.right, 1e6 - ring, ring)
                a, b = ring.min(axis=1), ring.max(axis=1)
                inside = (a[:, None] < a) & (a < b[:, None]) & (b[:, None] < b) & chords.other
                count += int(np.count_nonzero(inside))
        return count

    def sweep(self, *, onward: bool) -> None:
        """Columns by the middle of what they are wired to on one side."""
        for c in range(len(self._table)) if onward else range(len(self._table) - 1, -1, -1):
            column, size = self._table[c], max(len(self._table[c]), 1)
            pulls = self._pulls(c if onward else c + 1)
            middle = {
                unit: float(
                    np.mean(
                        [pull for i in unit for pull in pulls.get(i, ())] or [self._place[unit[0]] / size]
                    )
                )
                for unit in column
            }
            column.sort(key=lambda unit, middle=middle: (self._low[unit], middle[unit]))
            self._number(column)

    def _pulls(self, channel: int) -> dict[int, list[float]]:
        """Where, from 0 to 1, the other ends of each item's wires are in a channel."""
        found: dict[int, list[float]] = {}
        chords = self._chords[channel]
        for (a, b), right in zip(chords.joints.tolist(), chords.right.tolist(), strict=True):
            if right[0] != right[1]:
                for one, other in ((a, b), (b, a)):
                    item = self.joints[other].item
                    size = max(len(self._table[self._items[item].column]), 1)
                    place = (self._place[item] + 20 * self._dy[other]) / size
                    found.setdefault(self.joints[one].item, []).append(float(place))
        return found

    def exchange_units(self) -> None:
        """Neighbours change places where that saves crossings."""
        for c, column in enumerate(self._table):
            before = self._crossings((c, c + 1))
            for i in range(len(column) - 1):
                if not before:
                    break
                if self._low[column[i]] != self._low[column[i + 1]]:
                    continue
                column[i], column[i + 1] = column[i + 1], column[i]
                self._number(column)
                if (after := self._crossings((c, c + 1))) < before:
                    before = after
                else:
                    column[i], column[i + 1] = column[i + 1], column[i]
                    self._number(column)

    def exchange_ports(self) -> None:
        """Neighbouring ports of a block change places where that saves crossings."""
        for ports in self._ports:
            channels = sorted({self._channel[j] for port in ports for j in port})
            before = self._crossings(channels)
            for _ in ports if before else ():
                line, changed = sorted(ports, key=lambda port: self._dy[port[0]]), False
                for i in range(len(line) - 1):
                    self._swap(line[i], line[i + 1])
                    if (after := self._crossings(channels)) < before:
                        before, changed = after, True
                        line[i], line[i + 1] = line[i + 1], line[i]
                    else:
                        self._swap(line[i], line[i + 1])
                if not changed:
                    break

    def _swap(self, one: Sequence[int], other: Sequence[int]) -> None:
        a, b = self._dy[one[0]], self._dy[other[0]]
        self._dy[list(one)], self._dy[list(other)] = b, a

    def move_wires(self) -> None:
        """A wire passes above or below all others on its way where that saves crossings."""
        for units in self._wires:
            columns = sorted({self._items[unit[0]].column for unit in units})
            channels = sorted({c + side for c in columns for side in (0, 1)})
            before = self._crossings(channels)
            for top in (True, False) if before else ():
                kept = {c: list(self._table[c]) for c in columns}
                for c in columns:
                    mine = [unit for unit in self._table[c] if unit in units]
                    rest = [unit for unit in self._table[c] if unit not in units]
                    split = sum(self._low[unit] < (0 if top else 1) for unit in rest)
                    self._table[c][:] = [*rest[:split], *mine, *rest[split:]]
                    self._number(self._table[c])
                if (after := self._crossings(channels)) < before:
                    before = after
                    continue
                for c, column in kept.items():
                    self._table[c][:] = column
                    self._number(column)
