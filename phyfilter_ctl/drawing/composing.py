"""A plan made into nodes, wires and shapes at their places in the picture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

from .bodies import FONT, NAME, NOTE, PORT, RADIUS, TITLE, is_circle, label, ports_named, titled, wire_names
from .marks import Direction, Node, Port, Shape, Side, Text, Wire
from .names import Run, runs, text_width, unit_text
from .placing import ARROW, Plan
from .reading import Part
from .symbols import Pin

__all__ = ["Composed", "arrow", "block_marks", "composed", "texts_of", "unique", "wire_texts"]

Anchor = Literal["start", "middle", "end"]
Point = tuple[float, float]
_STUB = 12.0  # px of wire in front of an input that nothing drives


class Composed(NamedTuple):
    """Nodes and wires of a level and of the frames in it."""

    nodes: tuple[Node, ...]
    wires: tuple[Wire, ...]


def texts_of(
    parts: str | Sequence[Run], x: float, y: float, anchor: Anchor, size: float = 0.0
) -> tuple[Text, ...]:
    """Runs side by side from, around or up to a point of the base line."""
    row = (Run(parts, size),) if isinstance(parts, str) else parts
    x -= text_width(row) * {"start": 0.0, "middle": 0.5, "end": 1.0}[anchor]
    found = []
    for run in row:
        found.append(Text(run.text, x, y + run.lower, run.size))
        x += text_width(run.text, run.size)
    return tuple(found)


Feeds = Mapping[str, tuple[str, tuple[str, ...]]]


def composed(
    plan: Plan,
    values: Mapping[str, str],
    *,
    dx: float = 0.0,
    dy: float = 0.0,
    path: str = "",
    frame: str | None = None,
    feeds: Feeds | None = None,
) -> Composed:
    """Everything on a level at its place.

    Parameters
    ----------
    plan : Plan
    values : mapping of str to str
        What is written on wires, by signal.
    dx, dy : float
        Where the level's upper left corner is, in px.
    path : str
        In front of the names.
    frame : str, optional
        Node of the frame that it stands in.
    feeds : mapping, optional
        Of the frame's inputs: name and entries of the wires that come in.
    """
    level = _Level(plan, dx, dy, path, frame)
    nodes = [level.node(k) for k in range(len(plan.scheme.parts))]
    wires = [level.wire(net, nodes, values, feeds or {}) for net in range(len(plan.grid.nets))]
    stubs = [stub for k in range(len(nodes)) for stub in level.undriven(k, nodes[k])]
    nodes += [node for node, _ in stubs]
    wires += [wire for _, wire in stubs]
    for k, inside in plan.inner.items():
        box = nodes[k].box
        name = nodes[k].name
        fed = {
            port: (wire.signal, wire.names) for wire in wires for node, port in wire.targets if node == name
        }
        found = composed(inside, values, dx=box[0], dy=box[1] + TITLE, path=f"{name}.", frame=name, feeds=fed)
        nodes += found.nodes
        wires += found.wires
    return Composed(tuple(nodes), tuple(wires))


class _Level:
    def __init__(self, plan: Plan, dx: float, dy: float, path: str, frame: str | None) -> None:
        self._plan, self._dx, self._dy, self._path, self._frame = plan, dx, dy, path, frame
        self._counts = dict[str, int]()
        self._names = unique(self._name(part) for part in plan.scheme.parts)

    def _name(self, part: Part) -> str:
        if part.name:
            return f"{self._path}{part.name}" + (
                f" ({part.kind})" if part.kind in ("input", "output") else ""
            )
        self._counts[part.kind] = self._counts.get(part.kind, 0) + 1
        return f"{self._path}{part.kind} {self._counts[part.kind]}"

    def _flipped(self, k: int) -> bool:
        return k in self._plan.ranks.mirrored

    def _middle(self, k: int) -> Point:
        return float(self._plan.x[k]) + self._dx, float(self._plan.y[k]) + self._dy

    def _ports(self, k: int) -> tuple[Port, ...]:
        plan, part, body = self._plan, self._plan.scheme.parts[k], self._plan.bodies[k]
        x, y = self._middle(k)
        half = body.width / 2
        found: list[Port] = []
        ends: tuple[tuple[Direction, Sequence[Pin], Sequence[float]], ...] = (
            ("in", part.inputs, body.inputs),
            ("out", part.outputs, body.outputs),
        )
        for direction, pins, heights in ends:
            names = unique(pin.name or "y" for pin in pins)
            for n, (pin, name, dy) in enumerate(zip(pins, names, heights, strict=True)):
                side: Side = plan.sides.get((k, n), "W") if direction == "in" else "E"
                if side in ("N", "S"):
                    at = x, y + (-RADIUS if side == "N" else RADIUS)
                else:
                    side = ("W" if side == "E" else "E") if self._flipped(k) else side
                    at = x + (half if side == "E" else -half), y + dy
                found.append(Port(name, pin.labels, *at, side, direction, pin.sign))
        if k in plan.grid.attached:  # a terminal above or below its sum
            turn = next(turn for turn in plan.grid.turns if turn.item == k)
            below = plan.y[k] > plan.y[turn.part]
            edge = y - body.up if below else y + body.down
            found = [Port(p.name, p.labels, x, edge, "N" if below else "S", p.direction) for p in found]
        return tuple(found)

    def node(self, k: int) -> Node:
        part, body = self._plan.scheme.parts[k], self._plan.bodies[k]
        x, y = self._middle(k)
        box = x - body.width / 2, y - body.up, x + body.width / 2, y + body.down
        ports = self._ports(k)
        if part.kind in ("input", "output"):
            texts, shapes = texts_of(label(part), x, y + 4.5, "middle"), ()
            if part.silent:  # the wire goes on to the border
                thick = "thick" if (*part.inputs, *part.outputs)[0].size > 1 else "curve"
                shapes = (Shape(((box[0], y), (box[2], y)), thick),)
        elif part.kind == "frame":
            texts = texts_of(label(part), box[0] + 6, box[1] + 14, "start")
            shapes = (_rectangle(box, "frame"),)
        elif is_circle(part, k, self._plan.sides):
            shapes = (Shape(((x, y),), "block", radius=RADIUS),)
            texts = tuple(t for p in ports if p.direction == "in" for t in _sign(p))
        else:
            texts, shapes, box = block_marks(
                part, self._flipped(k), x, y, body.up, body.down, body.width, ports
            )
        return Node(self._names[k], part.kind, box, texts, ports, self._frame, part.symbol.gain, shapes)

    def wire(self, net: int, nodes: Sequence[Node], values: Mapping[str, str], feeds: Feeds) -> Wire:
        plan = self._plan
        (source, output), edges = plan.grid.nets[net]
        part = plan.scheme.parts[source]
        pin = part.outputs[output]
        start = _port(nodes[source], "out", output)
        targets = [(nodes[e.target], _port(nodes[e.target], "in", e.input)) for e in edges]
        lines = tuple(
            ((s.x0 + self._dx, s.y0 + self._dy), (s.x1 + self._dx, s.y1 + self._dy)) for s in plan.lines[net]
        )
        dots = tuple((x + self._dx, y + self._dy) for x, y in plan.dots[net])
        forward = not self._flipped(source) and not any(
            e in plan.ranks.back or self._flipped(e.target) for e in edges
        )
        names = pin.signals if all("." in name for name in pin.signals) else ()
        entries = pin.signals or (f"{nodes[source].name}.{start.name}",)
        signal = entries[0] if len(entries) == 1 else f"{entries[0].rpartition('[')[0] or entries[0]}"
        if part.kind == "input" and start.name in feeds:
            signal, names = feeds[start.name]
        value = next((values[s] for s in (signal, *entries[:1], pin.name) if s in values), "")
        shown = wire_names(part, pin)
        size, unit = (1, "") if part.silent else (pin.size, pin.unit)
        texts, slash = wire_texts(start, pin.name if shown else "", size, unit, value)
        heads = tuple(
            arrow(port)
            for e, (_, port) in zip(edges, targets, strict=True)
            if not plan.scheme.parts[e.target].silent
        )
        return Wire(
            signal, (nodes[source].name, start.name), tuple((node.name, port.name) for node, port in targets), lines,
            pin.size, forward, dots, names, texts, heads + slash,
        )  # fmt: skip

    def undriven(self, k: int, node: Node) -> list[tuple[Node, Wire]]:
        """A small open circle in front of each input that nothing drives."""
        driven = {e.input for e in self._plan.scheme.edges if e.target == k}
        found = []
        for n, port in enumerate(p for p in node.ports if p.direction == "in"):
            if n in driven or node.kind == "output":
                continue
            away = -1.0 if port.side == "W" else 1.0
            name, x, r = f"{node.name}.{port.name} (undriven)", port.x + away * _STUB, 2.5
            circle, edge = Shape(((x, port.y),), "block", radius=r), x - away * r
            box = x - r, port.y - r, x + r, port.y + r
            end = Port("y", (), edge, port.y, "E" if away < 0 else "W", "out")
            line = tuple(sorted([(edge, port.y), (port.x, port.y)]))
            size = max(len(port.labels), 1)
            wire = Wire(
                f"{node.name}.{port.name}", (name, "y"), ((node.name, port.name),), (line,), size, away < 0
            )
            found.append((Node(name, "undriven", box, (), (end,), self._frame, None, (circle,)), wire))
        return found


def unique(names: Iterable[str]) -> list[str]:
    """Names, with a number where one comes again."""
    found: dict[str, None] = {}
    for name in names:
        n, candidate = 2, name
        while candidate in found:
            n, candidate = n + 1, f"{name} {n}"
        found[candidate] = None
    return list(found)


def _port(node: Node, direction: str, n: int) -> Port:
    return [port for port in node.ports if port.direction == direction][n]


def _rectangle(box: tuple[float, float, float, float], style: str) -> Shape:
    x0, y0, x1, y1 = box
    return Shape(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), style, closed=True)


def _sign(port: Port) -> tuple[Text, ...]:
    dx, dy = {"W": (-8.0, -5.0), "E": (8.0, -5.0), "N": (8.0, -5.0), "S": (8.0, 13.0)}[port.side]
    return texts_of("+" if port.sign > 0 else "−", port.x + dx, port.y + dy, "middle", NAME)


def arrow(port: Port) -> Shape:
    """The head of a wire's arrow at an input."""
    u, v = {"W": (1, 0), "E": (-1, 0), "N": (0, 1), "S": (0, -1)}[port.side]
    x, y = port.x, port.y
    back = x - ARROW * u, y - ARROW * v
    return Shape(
        ((x, y), (back[0] - 3.5 * v, back[1] - 3.5 * u), (back[0] + 3.5 * v, back[1] + 3.5 * u)),
        "solid",
        closed=True,
    )


def wire_texts(
    start: Port, name: str, size: int, unit: str, value: str
) -> tuple[tuple[Text, ...], tuple[Shape, ...]]:
    """What stands on a wire where it begins: its name, size, unit and value, and the stroke of a vector."""
    if start.side not in ("E", "W"):
        return (texts_of(value, start.x + 5, start.y + 12, "start", NOTE), ()) if value else ((), ())
    way = 1.0 if start.side == "E" else -1.0
    anchor: Anchor = "start" if way > 0 else "end"
    at, texts, shapes = 5.0, (), ()
    if name:
        row = runs(name, PORT)
        texts += texts_of(row, start.x + way * at, start.y - 5, anchor)
        at += text_width(row) + 5
    if size > 1:
        x, y = start.x + way * (at + 3), start.y
        shapes = (Shape(((x - 3, y + 5), (x + 3, y - 5)), "thin"),)
        texts += texts_of(str(size), x + way * 4, y - 5, anchor, NOTE)
        at += text_width(str(size), NOTE) + 12
    if unit:
        texts += texts_of(unit_text(unit), start.x + way * at, start.y - 5, anchor, NOTE)
    if value:
        texts += texts_of(value, start.x + way * 5, start.y + 12, anchor, NOTE)
    return texts, shapes


# Where a port's name stands inside its block.
_NAMED: Mapping[Side, tuple[float, float, Anchor]] = {
    "W": (5.0, 4.0, "start"), "E": (-5.0, 4.0, "end"), "N": (0.0, 12.0, "middle"), "S": (0.0, -5.0, "middle"),
}  # fmt: skip
Drawn = tuple[tuple[Text, ...], tuple[Shape, ...], tuple[float, float, float, float]]


def block_marks(
    part: Part, flip: bool, x: float, y: float, up: float, down: float, width: float, ports: Sequence[Port]
) -> Drawn:
    """Texts and shapes of a block, and the box that wires keep out of."""
    symbol, half = part.symbol, width / 2
    lower = 13.0 if symbol.note and part.kind != "sum" else 0.0
    upper = 15.0 if part.name and titled(part) else 0.0
    box = x - half, y - up + upper, x + half, y + down - lower
    texts: tuple[Text, ...] = ()
    if upper:
        texts += texts_of(label(part), x, box[1] - 4, "middle")
    if lower:
        texts += texts_of(symbol.note, x, box[3] + 10, "middle", NOTE)
    if part.kind == "gain":
        a, b = (box[2], box[0]) if flip else (box[0], box[2])
        shape = Shape(((a, box[1]), (b, y), (a, box[3])), "block", closed=True)
        return texts + texts_of(symbol.lines[0], a + (b - a) * 0.38, y + 4.5, "middle", FONT), (shape,), box
    shapes = [_rectangle(box, "block")]
    if part.kind == "sum":
        texts += texts_of("Σ", x + (-5 if flip else 5), y + 5, "middle", FONT)
        for port in ports:
            if port.direction == "in":
                at = port.x + (-8 if port.side == "E" else 8)
                texts += texts_of("+" if port.sign > 0 else "−", at, port.y + 4, "middle", PORT)
    elif ports_named(part):
        texts += texts_of(label(part), x, box[1] + 15, "middle")
        for port in ports:
            dx, dy, anchor = _NAMED[port.side]
            texts += texts_of(runs(port.name, PORT), port.x + dx, port.y + dy, anchor)
    elif symbol.curve:
        shapes += _curve(symbol.curve, x, y, flip)
    elif len(symbol.lines) == 2 and symbol.lines[1] != "1":
        wide = max(text_width(line, FONT) for line in symbol.lines) / 2 + 3
        texts += texts_of(symbol.lines[0], x, y - 7, "middle", FONT) + texts_of(
            symbol.lines[1], x, y + 16, "middle", FONT
        )
        shapes.append(Shape(((x - wide, y), (x + wide, y)), "thin"))
    elif symbol.lines:
        texts += texts_of(_raised(symbol.lines[0]), x, y + 4.5, "middle")
    else:
        texts += texts_of(label(part), x, y + 4.5, "middle")
    if part.kind == "diagram":
        x0, y0, x1, y1 = box
        shapes.append(_rectangle((x0 + 3, y0 + 3, x1 - 3, y1 - 3), "thin"))
    elif part.kind in ("filter", "learned"):
        shapes.append(_mark(part.kind, box))
    return texts, tuple(shapes), box


def _raised(line: str) -> tuple[Run, ...]:
    """``e^-Ts`` with its exponent raised."""
    base, _, exponent = line.partition("^")
    return tuple(run for run in (Run(base, FONT), Run(exponent, PORT * 0.9, -5.0)) if run.text)


def _curve(points: Sequence[Point], x: float, y: float, flip: bool) -> list[Shape]:
    reach = 16.0
    axes = [
        Shape(((x - reach - 2, y), (x + reach + 2, y)), "thin"),
        Shape(((x, y - reach - 2), (x, y + reach + 2)), "thin"),
    ]
    return [*axes, Shape(tuple((x + reach * u, y - reach * v) for u, v in points), "curve")]


def _mark(kind: str, box: tuple[float, float, float, float]) -> Shape:
    """In the corner: a low-pass for a filter, dots of data along a curve for a learned model."""
    x, y = box[2] - 14.0, box[1] + 4.0
    if kind == "filter":
        return Shape(((x, y + 2), (x + 5, y + 2), (x + 10, y + 8)), "curve")
    return Shape(
        tuple((x + 10 * t, y + 8 - 7 * (3 * t * t - 2 * t * t * t)) for t in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)),
        "curve",
    )
