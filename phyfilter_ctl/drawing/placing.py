"""A level of a diagram with all its places: layout in columns, then as narrow as its order allows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .bodies import (
    NOTE,
    PORT,
    RADIUS,
    TITLE,
    Body,
    Sides,
    body_of,
    is_circle,
    label,
    ports_named,
    sides_of,
    titled,
    wire_names,
)
from .grid import Grid, grid_of
from .heights import heights_of
from .marks import Side
from .names import runs, text_width, unit_text
from .ordering import ordered
from .ranking import Ranks, ranks_of
from .reading import Part, Scheme
from .tracks import Channel, channel_of

__all__ = ["ARROW", "Plan", "Segment", "Wishes", "branches", "merged", "place"]

FloatArray = NDArray[np.float64]
ARROW = 9.0
_MARGIN = 8.0  # px around the picture
_FOOT = 10.0  # px below what is in a frame
_NEAR, _NEAR_ENDS = 18.0, 60.0  # px: parts, and terminals, of a column that are nearer than that line up
_SMALL = 24  # parts: up to so many, ways round are tried out for crossings


class Wishes(NamedTuple):
    """What a user may ask for: outputs beside what they show, blocks below or ahead, numbers on wires."""

    near_outputs: bool | None = None
    below: frozenset[str] = frozenset()
    ahead: frozenset[str] = frozenset()
    values: Mapping[str, str] = {}


class Segment(NamedTuple):
    """A level or upright piece of a wire, x0 <= x1 and y0 <= y1."""

    x0: float
    y0: float
    x1: float
    y1: float


@dataclass(frozen=True, eq=False)
class Plan:
    """A level with all its places, in px from its upper left corner.

    Parameters
    ----------
    scheme : Scheme
    ranks : Ranks
    sides : mapping
    bodies : tuple of Body
    grid : Grid
    x, y : arrays
        Middles of the items; parts first.
    lines, dots : tuples
        Of each net: its segments, where it branches.
    width, height : float
    inner : dict
        Part -> plan of what is inside.
    """

    scheme: Scheme
    ranks: Ranks
    sides: Sides
    bodies: tuple[Body, ...]
    grid: Grid
    x: FloatArray
    y: FloatArray
    lines: tuple[tuple[Segment, ...], ...]
    dots: tuple[tuple[tuple[float, float], ...], ...]
    width: float
    height: float
    inner: Mapping[int, Plan]

    @cached_property
    def crossings(self) -> int:
        """How often wires cross on this level."""
        flat = [(net, *s) for net, some in enumerate(self.lines) for s in some]
        if not flat:
            return 0
        net, x0, y0, x1, y1 = np.array(flat).T
        h, v = np.flatnonzero(y1 - y0 < x1 - x0), np.flatnonzero(y1 - y0 >= x1 - x0)
        across = (x0[h, None] < x0[v]) & (x0[v] < x1[h, None]) & (y0[v] < y0[h, None]) & (y0[h, None] < y1[v])
        return int(np.count_nonzero(across & (net[h, None] != net[v])))

    def mirrored(self) -> Plan:
        """As seen in a mirror: signals go left."""
        w = self.width
        ranks = replace(self.ranks, mirrored=frozenset(range(len(self.bodies))) - self.ranks.mirrored)
        lines = tuple(tuple(Segment(w - s.x1, s.y0, w - s.x0, s.y1) for s in some) for some in self.lines)
        dots = tuple(tuple((w - x, y) for x, y in some) for some in self.dots)
        inner = {k: plan.mirrored() for k, plan in self.inner.items()}
        return replace(self, ranks=ranks, x=w - self.x, lines=lines, dots=dots, inner=inner)


def place(scheme: Scheme, wishes: Wishes, *, framed: bool = False) -> Plan:
    """Places of everything on a level.

    Parameters
    ----------
    scheme : Scheme
    wishes : Wishes
    framed : bool
        Whether it stands in a frame, its terminals at the border.

    Returns
    -------
    Plan
    """
    taps = wishes.near_outputs
    if taps is None:
        taps = sum(part.kind == "output" for part in scheme.parts) > 8
    ranks = ranks_of(
        scheme, near=not framed, taps=taps and not framed, below=wishes.below, ahead=wishes.ahead
    )
    inner = {
        k: (plan.mirrored() if k in ranks.mirrored else plan)
        for k, plan in (
            (k, place(_named_once(p.inner), wishes, framed=True))
            for k, p in enumerate(scheme.parts)
            if p.inner
        )
    }
    try_out = _Trial(scheme, inner, wishes, framed)
    best = try_out(ranks, {})
    if best.crossings and len(scheme.parts) <= _SMALL:
        flipped: Sides = {}
        for turn in best.grid.turns:
            key = turn.part, turn.input
            if best.grid.items[turn.item].kind == "part" and best.crossings and best.sides.get(key) == "N":
                turned: Sides = {**flipped, key: "S"}
                other = try_out(ranks, turned)
                if other.crossings < best.crossings:
                    best, flipped = other, turned
        for loops in _feedback(scheme, ranks) if best.crossings else ():
            other = try_out(replace(best.ranks, above=best.ranks.above | loops), flipped)
            best = other if other.crossings < best.crossings else best
    return best


def _named_once(scheme: Scheme) -> Scheme:
    """Of a frame: terminals whose wire ends, or ends everywhere, at ports of their name stay without one."""
    parts = list(scheme.parts)
    for k, part in enumerate(parts):
        if part.kind == "input":
            ends = [(parts[e.target], parts[e.target].inputs[e.input]) for e in scheme.edges if e.source == k]
        elif part.kind == "output":
            ends = [
                (parts[e.source], parts[e.source].outputs[e.output]) for e in scheme.edges if e.target == k
            ]
        else:
            continue
        name = (*part.inputs, *part.outputs)[0].name
        if ends and all(ports_named(other) and pin.name == name for other, pin in ends):
            parts[k] = replace(part, silent=True)
    return replace(scheme, parts=tuple(parts))


def _feedback(scheme: Scheme, ranks: Ranks) -> list[frozenset[tuple[int, int]]]:
    """Wires that lead back past the forward path alone: all of them, then each."""
    nets = dict.fromkeys(
        (e.source, e.output)
        for e in sorted(ranks.back)
        if e.source not in ranks.mirrored and e.target not in ranks.mirrored
    )
    return [frozenset(nets), *(frozenset([net]) for net in nets)] if len(nets) > 1 else [frozenset(nets)]


@dataclass(frozen=True, eq=False)
class _Trial:
    """A level with some wires above, and some terminals at other sides of their sums."""

    scheme: Scheme
    inner: Mapping[int, Plan]
    wishes: Wishes
    framed: bool

    def __call__(self, ranks: Ranks, sides: Sides) -> Plan:
        wanted = sides_of(self.scheme, ranks)
        taken = {(k, side) for (k, _), side in wanted.items()}
        wanted.update({key: side for key, side in sides.items() if (key[0], side) not in taken})
        plan = _placed(self.scheme, ranks, wanted, self.inner, self.wishes, self.framed)
        better = _entered_from_below(plan, wanted)
        return (
            plan
            if better == wanted
            else _placed(self.scheme, ranks, better, self.inner, self.wishes, self.framed)
        )


def _entered_from_below(plan: Plan, sides: Sides) -> dict[tuple[int, int], Side]:
    """Sides of sums once it is known what stands below them."""
    found = dict(sides)
    for e in plan.scheme.edges:
        t = e.target
        if e in plan.ranks.back or found.get((t, e.input)) != "N" or t in plan.ranks.mirrored:
            continue
        if (t, "S") not in {(k, side) for (k, _), side in found.items()} and plan.y[e.source] > plan.y[t] + 5:
            found[t, e.input] = "S"
    return found


def _placed(
    scheme: Scheme, ranks: Ranks, sides: Sides, inner: Mapping[int, Plan], wishes: Wishes, framed: bool
) -> Plan:
    bodies = tuple(
        _frame_body(inner[k]) if k in inner else body_of(part, k, sides)
        for k, part in enumerate(scheme.parts)
    )
    loose = {k for k, part in enumerate(scheme.parts) if k not in inner and ports_named(part)}
    grid = ordered(grid_of(scheme, ranks, sides, bodies, near=not framed), ranks.main, loose)
    bodies = tuple(_reordered(body, k, grid) if k in loose else body for k, body in enumerate(bodies))
    y = heights_of(grid)
    channels = [channel_of(joints, y) for joints in grid.channels]
    across = _Across(scheme, ranks, sides, bodies, grid, y, channels, wishes, framed)
    x, trunks, width = across.solved()
    lines = _lines(scheme, ranks, sides, bodies, grid, x, y, channels, trunks)
    top = 0.0 if framed else _MARGIN
    height = max((y[i] + item.down for i, item in enumerate(grid.items)), default=0.0) + 2 * top
    moved = tuple(tuple(Segment(s.x0, s.y0 + top, s.x1, s.y1 + top) for s in some) for some in lines)
    return Plan(
        scheme,
        ranks,
        sides,
        bodies,
        grid,
        x,
        y + top,
        moved,
        tuple(map(branches, moved)),
        width,
        float(height),
        inner,
    )


def _reordered(body: Body, k: int, grid: Grid) -> Body:
    """With its ports where the grid has them; those without wires take what is free."""
    dys = []
    for kind, old in (("in", body.inputs), ("out", body.outputs)):
        moved = {
            joint.port[1]: joint.dy
            for joints in grid.channels
            for joint in joints
            if joint.item == k and joint.port is not None and joint.port[0] == kind
        }
        free = [dy for dy in old if dy not in moved.values()]
        dys.append(tuple(moved[n] if n in moved else free.pop(0) for n in range(len(old))))
    return body._replace(inputs=dys[0], outputs=dys[1])


def _frame_body(plan: Plan) -> Body:
    """Of a frame around a plan; ports where the terminals inside are."""
    middle = plan.height / 2
    ends = {
        kind: tuple(
            float(plan.y[k]) - middle for k, part in enumerate(plan.scheme.parts) if part.kind == kind
        )
        for kind in ("input", "output")
    }
    return Body(plan.width, middle + TITLE, middle + _FOOT, ends["input"], ends["output"])


class _Box(NamedTuple):
    """What keeps others away: of a group of things that move together, against the group's x."""

    group: int
    y0: float
    y1: float
    x0: float
    x1: float
    pad: float  # px that others keep away, theirs added
    tall: float  # px by which it is higher for that


class _Across:
    """x of all things: from the left as near as possible, from the right likewise, then half-way."""

    def __init__(
        self, scheme: Scheme, ranks: Ranks, sides: Sides, bodies: Sequence[Body], grid: Grid, y: FloatArray,
        channels: Sequence[Channel], wishes: Wishes, framed: bool,
    ) -> None:  # fmt: skip
        self._scheme, self._ranks, self._sides, self._bodies = scheme, ranks, sides, bodies
        self._grid, self._y, self._framed, self._wishes = grid, y, framed, wishes
        self._boxes: list[_Box] = []
        self._rank: list[float] = []
        self._of_item: dict[int, int] = {}
        self._shift = np.zeros(len(grid.items))  # of an item's middle against its group
        self._trunks: dict[tuple[int, tuple[int, int]], int] = {}
        self._left, self._right = self._group(1.0), self._group(2.0 * len(grid.columns))
        for k, part in enumerate(scheme.parts):
            self._part(k, part)
        for turn in grid.turns:
            self._turn(turn.item, turn.part, turn.net)
        for c, channel in enumerate(channels):
            for t, key in enumerate(channel.order):
                group = self._group(2 * c + (t + 1) / (len(channel.order) + 1))
                self._trunks[c, key] = group
                heights = [end.y for end in channel.ends[key]]
                self._boxes.append(_Box(group, min(heights), max(heights), 0.0, 0.0, 5.5, 4.0))

    def _group(self, rank: float) -> int:
        self._rank.append(rank)
        return len(self._rank) - 1

    def _part(self, k: int, part: Part) -> None:
        grid, body, y = self._grid, self._bodies[k], float(self._y[k])
        column, half = self._ranks.columns[k], body.width / 2
        at_border = k not in self._ranks.mirrored and k not in grid.attached
        if part.kind == "input" and at_border and grid.items[k].column == 0:
            group, self._shift[k] = self._left, half if self._framed else -half
        elif part.kind == "output" and at_border and grid.items[k].column == len(grid.columns) - 1:
            group, self._shift[k] = self._right, -half if self._framed else half
        elif k in grid.attached:
            turn = next(turn for turn in grid.turns if turn.item == k)
            group = self._of_item[turn.part] = self._of_item.get(turn.part, -1)
            if group < 0:
                group = self._of_item[turn.part] = self._group(2 * grid.items[turn.part].column + 1.0)
        else:
            group = self._of_item.get(k, -1)
            group = self._group(2 * column + 1.0) if group < 0 else group
            if part.kind in ("input", "output"):  # they line up at the edge where their wires are
                self._shift[k] = half if (part.kind == "output") != (k in self._ranks.mirrored) else -half
        self._of_item[k] = group
        x0, x1 = self._shift[k] - half, self._shift[k] + half
        add = self._boxes.append
        add(
            _Box(
                group,
                y - body.up,
                y + body.down,
                x0,
                x1,
                9.0 if part.kind not in ("input", "output") else 4.0,
                8.0,
            )
        )
        if titled(part):  # a name may be wider than its block
            named = text_width(label(part)) / 2
            add(
                _Box(
                    group,
                    y - body.up,
                    y - body.up + 15,
                    self._shift[k] - named,
                    self._shift[k] + named,
                    3.0,
                    2.0,
                )
            )
        flip = k in self._ranks.mirrored
        for n, dy in enumerate(body.inputs):
            if self._sides.get((k, n), "W") == "W" and part.kind != "input":
                room = 10.0 if is_circle(part, k, self._sides) else 6.0
                add(_Box(group, y + dy - 5, y + dy + 5, *_beside(x0, x1, ARROW + room, not flip), 1.0, 2.0))
        for n, dy in enumerate(body.outputs):
            wide = label_room(part, n, self._wishes.values)
            if wide and k not in grid.attached:
                add(_Box(group, y + dy - 14, y + dy + 1, *_beside(x0, x1, wide, flip), 2.0, 1.0))

    def _turn(self, item: int, part: int, net: int) -> None:
        group = self._of_item[part]
        self._of_item[item] = group
        heights = sorted((float(self._y[item]), float(self._y[part])))
        self._boxes.append(_Box(group, heights[0], heights[1], 0.0, 12.0, 4.0, 4.0))

    def solved(self) -> tuple[FloatArray, dict[tuple[int, tuple[int, int]], float], float]:
        """x of the items' middles, of the upright pieces, and the width of all."""
        count, boxes = len(self._rank), self._boxes
        table = np.array([box[1:] for box in boxes], dtype=float).reshape(-1, 6)
        group = np.array([box.group for box in boxes], dtype=int)
        rank = np.array(self._rank)
        y0, y1, x0, x1, pad, tall = table.T
        meet = (y0[:, None] - tall[:, None] < y1 + tall) & (y0 - tall < y1[:, None] + tall[:, None])
        meet &= rank[group][:, None] < rank[group]
        far = np.full((count, count), -np.inf)  # least x[b] - x[a]
        p, q = np.nonzero(meet)
        np.maximum.at(far, (group[p], group[q]), x1[p] - x0[q] + pad[p] + pad[q])
        low, high = np.zeros(count), np.zeros(count)  # extents of the groups
        np.minimum.at(low, group, x0)
        np.maximum.at(high, group, x1)
        order = np.argsort(rank, kind="stable")
        margin = np.full(count, _MARGIN)
        if self._framed:
            margin[[self._left, self._right]] = 0.0
        first = margin - low
        left = _pushed(first, far, order)
        width = float(max(left + high + margin))
        last = width - high - margin
        last[self._left] = left[self._left]
        right = -_pushed(-last, far.T, order[::-1])
        first[self._right] = right[self._right]
        middle = (_pushed(first, far, order) + right) / 2
        self._align(middle, far, first, last)
        x = np.array([middle[self._of_item.get(i, 0)] for i in range(len(self._grid.items))]) + self._shift
        return x, {key: float(middle[g]) for key, g in self._trunks.items()}, width

    def _align(self, x: FloatArray, far: FloatArray, first: FloatArray, last: FloatArray) -> None:
        """Parts of one column that stand nearly below each other stand right below each other, where that can be."""
        columns: dict[tuple[int, str], set[int]] = {}
        for k, part in enumerate(self._scheme.parts):
            group = self._of_item[k]
            if k not in self._grid.attached and group not in (self._left, self._right):
                kind = part.kind if part.kind in ("input", "output") else ""
                columns.setdefault((self._grid.items[k].column, kind), set()).add(group)
        for (_, kind), groups in columns.items():
            line = sorted(groups, key=lambda g: (float(x[g]), g))
            while line:
                near = [g for g in line if x[g] - x[line[0]] < (_NEAR_ENDS if kind else _NEAR)]
                line = line[len(near) :]
                low = max(max(first[g], float(np.max(x + far[:, g]))) for g in near)
                high = min(min(last[g], float(np.min(x - far[g]))) for g in near)
                if len(near) > 1 and low <= high:
                    x[near] = min(max(float(np.mean(x[near])), low), high)


def _pushed(first: FloatArray, far: FloatArray, order: NDArray[np.int64]) -> FloatArray:
    """Least places, each thing as far from those before it as it has to be."""
    x = first.copy()
    for g in order:
        x[g] = max(x[g], float(np.max(x + far[:, g])))
    return x


def _beside(x0: float, x1: float, room: float, left: bool) -> tuple[float, float]:
    return (x0 - room, x0) if left else (x1, x1 + room)


def label_room(part: Part, n: int, values: Mapping[str, str]) -> float:
    """Width in px of what stands on the wire at an output."""
    pin = part.outputs[n]
    room = text_width(runs(pin.name, PORT)) + 9 if wire_names(part, pin) else 0.0
    if pin.size > 1:
        room += text_width(str(pin.size), NOTE) + 14
    if pin.unit and not part.silent:
        room += text_width(unit_text(pin.unit), NOTE) + 9
    value = next((values[s] for s in (*pin.signals[:1], pin.name) if s in values), "")
    return max(room, text_width(value, NOTE) + 9 if value else 0.0)


def _lines(
    scheme: Scheme, ranks: Ranks, sides: Sides, bodies: Sequence[Body], grid: Grid, x: FloatArray, y: FloatArray,
    channels: Sequence[Channel], trunks: Mapping[tuple[int, tuple[int, int]], float],
) -> list[list[Segment]]:  # fmt: skip
    """Segments of each net."""
    found: list[list[Segment]] = [[] for _ in grid.nets]
    levels = _Levels()

    def edge(item: int, bank: int) -> float:
        """Where a wire meets a part from a channel."""
        half = bodies[item].width / 2
        return float(x[item]) + (half if bank < 0 else -half)

    for c, channel in enumerate(channels):
        for key, ends in channel.ends.items():
            net = key[0]
            trunk = trunks.get((c, key))
            if trunk is not None:
                heights = [end.y for end in ends]
                found[net].append(Segment(trunk, min(heights), trunk, max(heights)))
            for n, end in enumerate(ends):
                token = ("end", net, c, key[1], n if trunk is not None else -1)
                levels.at(token, net, end.y, trunk)
                if end.joint is None:
                    levels.join(token, ("jog", net, c))
                elif grid.items[end.joint.item].kind == "lane":
                    levels.join(token, ("lane", end.joint.item))
                elif grid.items[end.joint.item].kind == "turn":
                    levels.at(token, net, end.y, float(x[end.joint.item]))
                else:
                    levels.at(token, net, end.y, edge(end.joint.item, end.joint.bank))
    for net, height, xs in levels.all():
        if max(xs) - min(xs) > 1e-6:
            found[net].append(Segment(min(xs), height, max(xs), height))
    for turn in grid.turns:
        item = grid.items[turn.item]
        below = y[turn.item] > y[turn.part]
        begin = float(y[turn.item])
        if item.kind == "part":
            begin += -item.up if below else item.down
        end = float(y[turn.part]) + (RADIUS if below else -RADIUS)
        found[turn.net].append(
            Segment(float(x[turn.part]), min(begin, end), float(x[turn.part]), max(begin, end))
        )
    return [merged(some) for some in found]


class _Levels:
    """Level pieces of wires: which ends are one piece, and from where to where it goes."""

    def __init__(self) -> None:
        self._root: dict[tuple[object, ...], tuple[object, ...]] = {}
        self._known: dict[tuple[object, ...], tuple[int, float, list[float]]] = {}

    def _find(self, token: tuple[object, ...]) -> tuple[object, ...]:
        while (above := self._root.setdefault(token, token)) != token:
            token = above
        return token

    def at(self, token: tuple[object, ...], net: int, height: float, x: float | None) -> None:
        entry = self._known.setdefault(self._find(token), (net, height, []))
        entry[2].extend([] if x is None else [x])

    def join(self, token: tuple[object, ...], other: tuple[object, ...]) -> None:
        a, b = self._find(token), self._find(other)
        if a == b:
            return
        self._root[b] = a
        if b in self._known:
            net, height, xs = self._known.pop(b)
            self._known.setdefault(a, (net, height, []))[2].extend(xs)

    def all(self) -> list[tuple[int, float, list[float]]]:
        return [entry for entry in self._known.values() if entry[2]]


def merged(segments: Sequence[Segment]) -> list[Segment]:
    """Pieces of one line as one."""
    lines: dict[tuple[bool, float], list[tuple[float, float]]] = {}
    for s in segments:
        if s.x1 - s.x0 + s.y1 - s.y0 > 1e-6:
            flat = s.y1 - s.y0 < 1e-6
            lines.setdefault((flat, round(s.y0 if flat else s.x0, 3)), []).append(
                (s.x0, s.x1) if flat else (s.y0, s.y1)
            )
    found = []
    for (flat, z), parts in lines.items():
        joined: list[list[float]] = []
        for low, high in sorted(parts):
            if joined and low <= joined[-1][1] + 0.01:
                joined[-1][1] = max(joined[-1][1], high)
            else:
                joined.append([low, high])
        found += [Segment(low, z, high, z) if flat else Segment(z, low, z, high) for low, high in joined]
    return found


def branches(segments: Collection[Segment]) -> tuple[tuple[float, float], ...]:
    """Where three pieces or more of one wire meet."""
    found = []
    upright = [s for s in segments if s.x1 - s.x0 < 1e-6]
    level = [s for s in segments if s.x1 - s.x0 >= 1e-6]
    for v in upright:
        for h in level:
            if h.x0 - 0.01 <= v.x0 <= h.x1 + 0.01 and v.y0 - 0.01 <= h.y0 <= v.y1 + 0.01:
                arms = (h.x0 < v.x0 - 0.5) + (h.x1 > v.x0 + 0.5) + (v.y0 < h.y0 - 0.5) + (v.y1 > h.y0 + 0.5)
                if arms > 2:
                    found.append((v.x0, h.y0))
    return tuple(dict.fromkeys(found))
