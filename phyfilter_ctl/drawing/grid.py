"""Parts and lanes of wires in columns, and their order from top to bottom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .bodies import Body, Sides
from .ranking import Ranks
from .reading import Edge, Scheme

__all__ = ["Grid", "Item", "Joint", "Link", "Turn", "grid_of"]

_LANE = 3.0  # px: half of a lane
_SWEEPS = 6
# Weights of wires that are made straight one after the other.
_MAIN, _LONG, _LANES, _FORWARD, _BELOW = 100, 40, 12, 10, 6


class Item(NamedTuple):
    """What takes room in a column: a part; a lane, on which a wire passes it; a turn, from where one meets a sum."""

    kind: str  # "part", "lane", "turn"
    part: int  # -1 of a lane
    net: int  # -1 of a part
    column: int
    up: float
    down: float
    low: int  # 0, or 1 for what stays below the forward path
    terminal: bool = False


class Joint(NamedTuple):
    """Where a wire comes out of an item into a channel: the item stands left (-1) or right (1) of the channel."""

    net: int
    item: int
    bank: int
    dy: float


class Link(NamedTuple):
    """Two joints of a wire that are to be level."""

    weight: int
    channel: int
    one: Joint
    other: Joint


class Turn(NamedTuple):
    """An upright piece of a wire to the top or bottom of a sum."""

    net: int
    item: int  # a turn, or the terminal of an input
    part: int
    input: int


@dataclass(frozen=True, eq=False)
class Grid:
    """Items in columns.

    Parameters
    ----------
    items : tuple of Item
        Those of the parts first, in their order.
    columns : tuple of tuples of int
        Numbers of the items from top to bottom.
    channels : tuple of tuples of Joint
        Channel c is left of column c.
    links : tuple of Link
    turns : tuple of Turn
    nets : tuple of ((part, output), edges)
    attached : frozenset of int
        Items of terminals that stand right above or below a sum.
    """

    items: tuple[Item, ...]
    columns: tuple[tuple[int, ...], ...]
    channels: tuple[tuple[Joint, ...], ...]
    links: tuple[Link, ...]
    turns: tuple[Turn, ...]
    nets: tuple[tuple[tuple[int, int], tuple[Edge, ...]], ...]
    attached: frozenset[int]


def grid_of(scheme: Scheme, ranks: Ranks, sides: Sides, bodies: Sequence[Body], *, near: bool) -> Grid:
    """Items, lanes included, ordered so that few wires cross.

    Parameters
    ----------
    scheme : Scheme
    ranks : Ranks
    sides : mapping
        As of :func:`phyfilter_ctl.drawing.bodies.sides_of`.
    bodies : sequence of Body
    near : bool
        Whether inputs may stand right above or below a sum.

    Returns
    -------
    Grid
    """
    parts, mirrored = scheme.parts, ranks.mirrored
    nets: dict[tuple[int, int], list[Edge]] = {}
    for e in sorted(scheme.edges):
        nets.setdefault((e.source, e.output), []).append(e)
    items = [
        Item(
            "part",
            k,
            -1,
            ranks.columns[k],
            body.up,
            body.down,
            int(k in mirrored),
            parts[k].kind in ("input", "output"),
        )
        for k, body in enumerate(bodies)
    ]
    units: dict[int, list[int]] = {
        k: [k] for k in range(len(parts))
    }  # what stays together, by its part or lane
    count = 1 + max(ranks.columns, default=0)
    channels: list[list[Joint]] = [[] for _ in range(count + 1)]
    links: list[Link] = []
    turns: list[Turn] = []
    attached: set[int] = set()

    def lane(kind: str, part: int, net: int, column: int, low: int) -> int:
        items.append(Item(kind, part, net, column, _LANE, _LANE, low))
        return len(items) - 1

    for net, ((source, output), edges) in enumerate(nets.items()):
        first = edges[0]
        side = sides.get((first.target, first.input), "W")
        if (
            near and parts[source].kind == "input" and len(edges) == 1 and side in "NS"
        ):  # straight above a sum
            sum_item = items[first.target]
            items[source] = items[source]._replace(column=sum_item.column, low=sum_item.low)
            units.pop(source)
            units[first.target].insert(0 if side == "N" else len(units[first.target]), source)
            attached.add(source)
            turns.append(Turn(net, source, first.target, first.input))
            continue
        leftward = source in mirrored
        begin = ranks.columns[source] + (0 if leftward else 1)
        start = Joint(net, source, 1 if leftward else -1, bodies[source].outputs[output])
        channels[begin].append(start)
        lanes: dict[tuple[int, int], int] = {}
        for e in edges:
            t, column = e.target, ranks.columns[e.target]
            side = sides.get((t, e.input), "W")
            low = int(t in mirrored)
            if side in "NS":
                turn = lane("turn", t, net, column, low)
                units[t].insert(0 if side == "N" else len(units[t]), turn)
                turns.append(Turn(net, turn, t, e.input))
                end_channel = column if begin <= column else column + 1
                end = Joint(net, turn, 1 if begin <= column else -1, 0.0)
            else:
                end_channel = column + 1 if t in mirrored else column
                end = Joint(net, t, -1 if t in mirrored else 1, bodies[t].inputs[e.input])
            joint, way = start, 1 if end_channel > begin else -1
            for c in range(begin, end_channel) if way > 0 else range(begin - 1, end_channel - 1, -1):
                here = c if way > 0 else c + 1
                if (c, way) not in lanes:
                    at = lanes[c, way] = lane("lane", -1, net, c, int(way < 0 or low or source in mirrored))
                    units[at] = [at]
                    channels[here].append(Joint(net, at, way, 0.0))
                    channels[here + way].append(Joint(net, at, -way, 0.0))
                    weight = _LONG if items[joint.item].kind == "lane" else _LANES
                    links.append(Link(weight, here, joint, Joint(net, at, way, 0.0)))
                joint = Joint(net, lanes[c, way], -way, 0.0)
            channels[end_channel].append(end)
            straight = source in ranks.main and t in ranks.main and e not in ranks.back
            links.append(Link(_MAIN if straight else _BELOW if low else _FORWARD, end_channel, joint, end))
    table: list[list[list[int]]] = [[] for _ in range(count)]
    for at, unit in units.items():
        table[items[at].column].append(unit)
    ordered = _ordered(table, items, channels, ranks)
    columns = tuple(tuple(item for unit in column for item in unit) for column in ordered)
    every = tuple(((s, o), tuple(e)) for (s, o), e in nets.items())
    return Grid(
        tuple(items), columns, tuple(map(tuple, channels)), tuple(links), tuple(turns), every,
        frozenset(attached),
    )  # fmt: skip


class _Chords(NamedTuple):
    """Wires of a channel as chords of a circle, down its left bank and up its right one: ends by item."""

    items: NDArray[np.int64]  # (chords, 2)
    right: NDArray[np.bool_]
    dy: NDArray[np.float64]
    other: NDArray[np.bool_]  # (chords, chords): of different nets


def _chords(joints: Sequence[Joint]) -> _Chords:
    first: dict[int, Joint] = {}
    pairs = []
    for joint in joints:
        if joint.net in first:
            pairs.append((first[joint.net], joint))
        first.setdefault(joint.net, joint)
    table = np.array([[(j.item, j.bank > 0, j.dy) for j in pair] for pair in pairs], dtype=float).reshape(
        -1, 2, 3
    )
    net = np.array([pair[0].net for pair in pairs], dtype=int)
    return _Chords(
        table[:, :, 0].astype(int), table[:, :, 1] > 0, table[:, :, 2] / 1e4, net[:, None] != net[None, :]
    )


def _crossings(chords: _Chords, place: NDArray[np.float64]) -> int:
    if len(chords.items) < 2:
        return 0
    ring = place[chords.items] + chords.dy
    ring = np.where(chords.right, 1e6 - ring, ring)
    a, b = ring.min(axis=1), ring.max(axis=1)
    return int(np.count_nonzero((a[:, None] < a) & (a < b[:, None]) & (b[:, None] < b) & chords.other))


def _ordered(
    table: list[list[list[int]]], items: Sequence[Item], channels: Sequence[Sequence[Joint]], ranks: Ranks
) -> list[list[list[int]]]:
    """Units of the columns by barycentres of their wires, neighbours exchanged where that saves crossings."""
    chords = [_chords(joints) for joints in channels]
    place = np.zeros(len(items))
    low = {at: max(items[i].low for i in unit) for column in table for unit in column for at in unit[:1]}

    def number(column: list[list[int]]) -> None:
        for spot, item in enumerate(i for unit in column for i in unit):
            place[item] = spot

    def near(c: int) -> int:
        return _crossings(chords[c], place) + _crossings(chords[c + 1], place)

    for column in table:
        column.sort(key=lambda unit: (low[unit[0]], not any(items[i].part in ranks.main for i in unit)))
        number(column)
    best, least = [list(column) for column in table], sum(_crossings(c, place) for c in chords)
    for sweep in range(_SWEEPS):
        if least == 0:
            break
        onward = sweep % 2 == 0
        for c in range(len(table)) if onward else range(len(table) - 1, -1, -1):
            pulls = _pulls(channels[c if onward else c + 1], items, place, table)
            size = max(len(table[c]), 1)

            def middle(unit: list[int], pulls=pulls, size=size) -> tuple[int, float]:
                found = [pull for i in unit for pull in pulls.get(i, ())]
                return low[unit[0]], float(np.mean(found)) if found else place[unit[0]] / size

            table[c].sort(key=middle)
            number(table[c])
        for c, column in enumerate(table):
            for i in range(len(column) - 1):
                if low[column[i][0]] != low[column[i + 1][0]]:
                    continue
                before = near(c)
                if not before:
                    break
                column[i], column[i + 1] = column[i + 1], column[i]
                number(column)
                if near(c) >= before:
                    column[i], column[i + 1] = column[i + 1], column[i]
                    number(column)
        total = sum(_crossings(c, place) for c in chords)
        if total < least:
            best, least = [list(column) for column in table], total
    return best


def _pulls(
    joints: Sequence[Joint],
    items: Sequence[Item],
    place: NDArray[np.float64],
    table: Sequence[Sequence[object]],
) -> dict[int, list[float]]:
    """Where, from 0 to 1, the other ends of each item's wires are in a channel."""
    first: dict[int, Joint] = {}
    found: dict[int, list[float]] = {}
    for joint in joints:
        other = first.setdefault(joint.net, joint)
        if other.bank != joint.bank:
            for a, b in ((joint, other), (other, joint)):
                size = max(len(table[items[b.item].column]), 1)
                found.setdefault(a.item, []).append((place[b.item] + b.dy / 2000) / size)
    return found
