"""Parts, and lanes of the wires that pass them, in columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from .bodies import Body, Sides
from .ranking import Ranks
from .reading import Edge, Scheme

__all__ = ["Grid", "Item", "Joint", "Link", "Turn", "grid_of"]

_LANE = 3.0  # px: half of a lane
# Weights of wires that are made straight one after the other.
_MAIN, _FROM_INPUT, _LONG, _LANES, _FORWARD, _BELOW = 100, 90, 40, 12, 10, 6


class Item(NamedTuple):
    """What takes room in a column: a part; a lane, on which a wire passes it; a turn, from where one meets a sum."""

    kind: str  # "part", "lane", "turn"
    part: int  # -1 of a lane
    net: int  # -1 of a part
    column: int
    up: float
    down: float
    low: int  # 0, or 1 for what stays below the forward path, -1 for what stays above
    terminal: bool = False


class Joint(NamedTuple):
    """Where a wire comes out of an item into a channel: the item stands left (-1) or right (1) of the channel."""

    net: int
    item: int
    bank: int
    dy: float
    port: tuple[str, int] | None = None  # of a part: "in" or "out", and its number


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
    columns : tuple of tuples of tuples of int
        From top to bottom: numbers of items that stay together.
    channels : tuple of tuples of Joint
        Channel c is left of column c.
    links : tuple of Link
    turns : tuple of Turn
    nets : tuple of ((part, output), edges)
    attached : frozenset of int
        Items of terminals that stand right above or below a sum.
    """

    items: tuple[Item, ...]
    columns: tuple[tuple[tuple[int, ...], ...], ...]
    channels: tuple[tuple[Joint, ...], ...]
    links: tuple[Link, ...]
    turns: tuple[Turn, ...]
    nets: tuple[tuple[tuple[int, int], tuple[Edge, ...]], ...]
    attached: frozenset[int]

    def ordered(
        self, columns: Sequence[Sequence[Sequence[int]]], heights: Mapping[tuple[int, str, int], float]
    ) -> Grid:
        """With other orders of the columns, and ports at other heights: (part, "in" or "out", number) -> dy."""

        def moved(joint: Joint) -> Joint:
            dy = joint.dy if joint.port is None else heights.get((joint.item, *joint.port), joint.dy)
            return joint._replace(dy=dy)

        return replace(
            self,
            columns=tuple(tuple(map(tuple, column)) for column in columns),
            channels=tuple(tuple(map(moved, joints)) for joints in self.channels),
            links=tuple(link._replace(one=moved(link.one), other=moved(link.other)) for link in self.links),
        )


def grid_of(scheme: Scheme, ranks: Ranks, sides: Sides, bodies: Sequence[Body], *, near: bool) -> Grid:
    """Items, lanes included, in their columns.

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
        leftward, above = source in mirrored, (source, output) in ranks.above
        begin = ranks.columns[source] + (0 if leftward else 1)
        start = Joint(net, source, 1 if leftward else -1, bodies[source].outputs[output], ("out", output))
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
                end = Joint(net, t, -1 if t in mirrored else 1, bodies[t].inputs[e.input], ("in", e.input))
            joint, way = start, 1 if end_channel > begin else -1
            for c in range(begin, end_channel) if way > 0 else range(begin - 1, end_channel - 1, -1):
                here = c if way > 0 else c + 1
                if (c, way) not in lanes:
                    at = lanes[c, way] = lane(
                        "lane",
                        -1,
                        net,
                        c,
                        -1 if way < 0 and above else int(way < 0 or low or source in mirrored),
                    )
                    units[at] = [at]
                    channels[here].append(Joint(net, at, way, 0.0))
                    channels[here + way].append(Joint(net, at, -way, 0.0))
                    weight = _LONG if items[joint.item].kind == "lane" else _LANES
                    links.append(Link(weight, here, joint, Joint(net, at, way, 0.0)))
                joint = Joint(net, lanes[c, way], -way, 0.0)
            channels[end_channel].append(end)
            straight = source in ranks.main and t in ranks.main and e not in ranks.back
            weight = _FROM_INPUT if parts[source].kind == "input" else _MAIN
            weight = weight if straight else _BELOW if low else _FORWARD
            links.append(Link(weight, end_channel, joint, end))
    table: list[list[list[int]]] = [[] for _ in range(count)]
    for at, unit in units.items():
        table[items[at].column].append(unit)
    return Grid(
        tuple(items),
        tuple(tuple(map(tuple, column)) for column in table),
        tuple(map(tuple, channels)),
        tuple(links),
        tuple(turns),
        tuple((source, tuple(edges)) for source, edges in nets.items()),
        frozenset(attached),
    )
