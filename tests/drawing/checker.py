"""Faults of a drawing: what a test can hold against it, by a route that shares no code with the layout.

Reads the geometry of a Drawing and the text of its SVG, and compares both with each other and with the system's maps.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import control as ct
import numpy as np

from tests.drawing.reading import Box, Drawn, letters_box, read

# px: of the geometry; of the SVG, which has tenths; half a line's width.
SAME, WRITTEN, TOUCHING = 0.02, 0.051, 0.7
# px: a sign stands beside its port.
NEAR = 16.0
# Kinds whose texts stand inside their box, or wholly outside; signs and names of others stand beside it.
BOXES = {"block", "fraction", "integrator", "delay", "curve", "filter", "learned", "diagram"}
# Kinds that are drawn as a closed shape of the size of their box.
SHAPES = BOXES | {"gain", "sum", "frame", "undriven"}
# Of a gain, as printed: half a digit of the third.
PRINTED = 6e-3
SIGNS = ("−", "-", "+")
RAISED = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")


class Fault(NamedTuple):
    kind: str
    what: str


class Line(NamedTuple):
    """A straight line of a net, its ends in order."""

    net: int
    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def flat(self) -> bool:
        return abs(self.y1 - self.y0) <= SAME

    @property
    def box(self) -> Box:
        return Box(self.x0, self.y0, self.x1, self.y1)


@dataclass(frozen=True)
class Sheet:
    """A drawing with its lines in order and the ends of its wires looked up."""

    drawing: Any

    @cached_property
    def drawn(self) -> Drawn:
        return read(self.drawing.svg)

    @cached_property
    def nodes(self) -> list[Any]:
        return list(self.drawing.nodes)

    @cached_property
    def lines(self) -> list[Line]:
        return [
            Line(net, *sorted_ends(a, b))
            for net, wire in enumerate(self.drawing.wires)
            for stroke in wire.lines
            for a, b in pairwise(stroke)
            if abs(a[0] - b[0]) + abs(a[1] - b[1]) > SAME
        ]

    def end(self, reference: tuple[Any, Any]) -> tuple[Any, Any]:
        """Node and port of a wire's end, which names them."""
        return self._ends[(*reference, "in")]

    def ends(self, wire: Any) -> list[tuple[Any, Any]]:
        return [self.start(wire), *(self.end(target) for target in wire.targets)]

    def start(self, wire: Any) -> tuple[Any, Any]:
        return self._ends[(*wire.source, "out")]

    @cached_property
    def _ends(self) -> dict[tuple[str, str, str], tuple[Any, Any]]:
        return {
            (node.name, port.name, port.direction): (node, port) for node in self.nodes for port in node.ports
        }

    @cached_property
    def frames(self) -> dict[str, Any]:
        return {node.name: node for node in self.nodes if node.kind == "frame"}

    def around(self, node: Any) -> set[str]:
        """Names of the frames that a node stands in."""
        names: set[str] = set()
        name = node.frame
        while name is not None and name in self.frames and name not in names:
            names.add(name)
            name = self.frames[name].frame
        return names


def sorted_ends(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float, float, float]:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1])


def faults(drawing: Any, system: ct.InterconnectedSystem | None = None) -> list[Fault]:
    """All faults of a drawing; with the system, its maps too (of a drawing that is not opened)."""
    sheet = Sheet(drawing)
    found = [
        *_overlaps(sheet), *_through(sheet), *_joints(sheet), *_connected(sheet), *_leftward(sheet), *_texts(sheet),
        *_signs(sheet), *_as_drawn(sheet),
    ]  # fmt: skip
    if system is not None:
        found += _maps(sheet, system)
    return found


def crossings(drawing: Any) -> int:
    """Places where lines of two nets cross."""
    return sum(kind == "crossing" for _, _, kind in _meetings(Sheet(drawing).lines))


def _overlaps(sheet: Sheet) -> Iterator[Fault]:
    for a, b in combinations(sheet.nodes, 2):
        p, q = Box(*a.box), Box(*b.box)
        for inner, outer in ((a, b), (b, a)):
            if outer.kind == "frame" and outer.name in sheet.around(inner):
                if not Box(*outer.box).grown(SAME).holds(Box(*inner.box)):
                    yield Fault("overlap", f"{inner.name} leaves the frame {outer.name}")
                break
        else:
            if p.grown(-TOUCHING).overlaps(q):
                yield Fault("overlap", f"{a.kind} {a.name} and {b.kind} {b.name}")
    everything = Box(0.0, 0.0, sheet.drawing.width, sheet.drawing.height)
    for node in sheet.nodes:
        if not everything.grown(SAME).holds(Box(*node.box)):
            yield Fault("overlap", f"{node.name} leaves the picture")


def _through(sheet: Sheet) -> Iterator[Fault]:
    """Lines inside a block; inside a frame, those of nets that have no end in it."""
    inside: dict[int, set[str]] = {
        net: set().union(*(sheet.around(node) for node, _ in sheet.ends(wire)))
        for net, wire in enumerate(sheet.drawing.wires)
    }
    for node in sheet.nodes:
        box = Box(*node.box).grown(-TOUCHING)
        for line in sheet.lines:
            if node.kind == "frame" and node.name in inside[line.net]:
                continue
            if line.box.grown(SAME).overlaps(box):
                wire = sheet.drawing.wires[line.net]
                yield Fault("through", f"{wire.signal} through {node.kind} {node.name}")


def _meetings(lines: list[Line]) -> Iterator[tuple[Line, Line, str]]:
    """Pairs of lines of different nets that meet: crossing, or a joint that is none."""
    for a, b in combinations(sorted(lines, key=lambda line: line.x0), 2):
        if b.x0 > a.x1 + SAME or a.net == b.net or b.y0 > a.y1 + SAME or a.y0 > b.y1 + SAME:
            continue
        if a.flat == b.flat:
            yield a, b, "along"
            continue
        flat, tall = (a, b) if a.flat else (b, a)
        x, y = tall.x0, flat.y0
        clear = min(x - flat.x0, flat.x1 - x, y - tall.y0, tall.y1 - y)
        yield a, b, "crossing" if clear >= TOUCHING else "joint"


def _joints(sheet: Sheet) -> Iterator[Fault]:
    for line in sheet.lines:
        if min(line.x1 - line.x0, line.y1 - line.y0) > SAME:
            yield Fault("slanted", sheet.drawing.wires[line.net].signal)
    for a, b, kind in _meetings(sheet.lines):
        if kind != "crossing":
            names = [sheet.drawing.wires[line.net].signal for line in (a, b)]
            yield Fault("false joint", f"{names[0]} {kind} {names[1]} near {a.x0:.0f}, {a.y0:.0f}")
    yield from _dots(sheet)


def _dots(sheet: Sheet) -> Iterator[Fault]:
    """A dot at each place where three lines of a net meet, and nowhere else."""
    for net, wire in enumerate(sheet.drawing.wires):
        mine = [line for line in sheet.lines if line.net == net]
        places = {(x, y) for line in mine for x, y in ((line.x0, line.y0), (line.x1, line.y1))}
        branches = [place for place in places if _ways(mine, *place) > 2]
        for x, y in branches:
            if not any(abs(x - u) <= SAME and abs(y - v) <= SAME for u, v in wire.dots):
                yield Fault("dot", f"{wire.signal} branches at {x:.0f}, {y:.0f} without a dot")
        for x, y in wire.dots:
            if _ways(mine, x, y) < 3:
                yield Fault("dot", f"{wire.signal} has a dot at {x:.0f}, {y:.0f} and no branch")


def _ways(lines: list[Line], x: float, y: float) -> int:
    """Directions that lines leave a place in."""
    ways: set[str] = set()
    for line in lines:
        if line.flat and abs(line.y0 - y) <= SAME and line.x0 - SAME <= x <= line.x1 + SAME:
            ways |= {"W"} if line.x0 < x - SAME else set()
            ways |= {"E"} if line.x1 > x + SAME else set()
        if not line.flat and abs(line.x0 - x) <= SAME and line.y0 - SAME <= y <= line.y1 + SAME:
            ways |= {"N"} if line.y0 < y - SAME else set()
            ways |= {"S"} if line.y1 > y + SAME else set()
    return len(ways)


def _connected(sheet: Sheet) -> Iterator[Fault]:
    """Each net in one piece that reaches all its ports; each port with a net, on the border of its node."""
    reached: set[int] = set()
    for net, wire in enumerate(sheet.drawing.wires):
        left = [line.box.grown(SAME) for line in sheet.lines if line.net == net]
        ends = sheet.ends(wire)
        reached |= {id(port) for _, port in ends}
        piece = [left.pop()] if left else []
        todo = list(piece)
        while todo:
            box = todo.pop()
            near = [other for other in left if other.overlaps(box)]
            left = [other for other in left if other not in near]
            todo += near
            piece += near
        if left:
            yield Fault("disconnected", f"{wire.signal} is in two pieces")
        for node, port in ends:
            if not any(box.holds(Box(port.x, port.y, port.x, port.y)) for box in piece):
                yield Fault("disconnected", f"{wire.signal} does not reach {node.name}")
    for node in sheet.nodes:
        box = Box(*node.box)
        for port in node.ports:
            if id(port) not in reached and port.direction == "in":
                yield Fault("unwired", f"{port.labels} of {node.kind} {node.name}")
            away = {"W": port.x - box.x0, "E": port.x - box.x1, "N": port.y - box.y0, "S": port.y - box.y1}
            along = box.y0 <= port.y <= box.y1 if port.side in "WE" else box.x0 <= port.x <= box.x1
            if abs(away[port.side]) > TOUCHING or not along:
                yield Fault("disconnected", f"{port.labels} is not on the {port.side} border of {node.name}")


def _leftward(sheet: Sheet) -> Iterator[Fault]:
    for wire in sheet.drawing.wires:
        if wire.forward:
            (node, source), *targets = sheet.ends(wire)
            for other, target in targets:
                if source.x > target.x + 1.0:
                    yield Fault("leftward", f"{wire.signal} from {node.name} to {other.name}")


def _texts(sheet: Sheet) -> Iterator[Fault]:
    placed = [(node, text, _text_box(text)) for node in sheet.nodes for text in node.texts]
    everything = Box(0.0, 0.0, sheet.drawing.width, sheet.drawing.height)
    for node, text, box in placed:
        own = Box(*node.box)
        if node.kind in BOXES and own.overlaps(box) and not own.grown(SAME).holds(box):
            yield Fault("text outside", f"{text.text!r} of {node.kind} {node.name}")
        if not everything.grown(SAME).holds(box):
            yield Fault("text outside", f"{text.text!r} leaves the picture")
    for letters in sheet.drawn.texts:
        if not everything.grown(SAME).holds(letters.box):
            yield Fault("text outside", f"{letters.text!r} leaves the picture")
    for node, text, box in placed:
        yield from _struck(sheet, f"{text.text!r} of {node.name}", text, box)
    for wire in sheet.drawing.wires:
        for text in wire.texts:
            yield from _struck(sheet, f"{text.text!r} on {wire.signal}", text, _text_box(text))
    for a, b in combinations(sorted(sheet.drawn.texts, key=lambda letters: letters.box.x0), 2):
        if b.box.x0 < a.box.x1 and a.box.grown(-TOUCHING).overlaps(b.box.grown(-TOUCHING)):
            yield Fault("text on text", f"{a.text!r} on {b.text!r}")


def _struck(sheet: Sheet, what: str, text: Any, box: Box) -> Iterator[Fault]:
    """Lines through a text; the ink of a sign is in the middle of its box."""
    if text.text.strip() in SIGNS:
        box = box._replace(y0=text.y - 0.55 * text.size, y1=text.y - 0.1 * text.size)
    box = box.grown(-TOUCHING)
    if any(line.box.grown(SAME).overlaps(box) for line in sheet.lines):
        yield Fault("text struck", what)


def _text_box(text: Any) -> Box:
    return letters_box(text.text, text.x, text.y, text.size, text.anchor, text.bold, text.italic)


def _signs(sheet: Sheet) -> Iterator[Fault]:
    """A minus beside each port that subtracts, none beside the others of its sum."""
    minuses = [letters.box for letters in sheet.drawn.texts if letters.text.strip() in SIGNS[:2]]
    middles = [((box.x0 + box.x1) / 2, (box.y0 + box.y1) / 2) for box in minuses]
    for node in sheet.nodes:
        ports = [port for port in node.ports if port.direction == "in"]
        if node.kind != "sum":
            continue
        signed: dict[int, int] = defaultdict(int)
        for x, y in middles:
            away = [np.hypot(port.x - x, port.y - y) for port in ports]
            nearest = int(np.argmin(away))
            if away[nearest] <= NEAR and _home(sheet, node, x, y):
                signed[nearest] += 1
        for k, port in enumerate(ports):
            if signed[k] != (port.sign < 0):
                yield Fault("sign", f"{node.name}: {signed[k]} minus at a port with sign {port.sign}")


def _home(sheet: Sheet, node: Any, x: float, y: float) -> bool:
    """Whether a sign is this sum's: none other has a port nearer to it."""
    sums = [other for other in sheet.nodes if other.kind == "sum"]
    nearest = min(
        sums,
        key=lambda other: min(
            np.hypot(port.x - x, port.y - y) for port in other.ports if port.direction == "in"
        ),
    )
    return nearest is node


def _as_drawn(sheet: Sheet) -> Iterator[Fault]:
    """The SVG draws what the geometry says: no more and no less."""
    drawn = sheet.drawn
    for signal in drawn.crooked:
        yield Fault("as drawn", f"{signal} is drawn with a curve")
    told: dict[str, list[Line]] = defaultdict(list)
    for line in sheet.lines:
        wire = sheet.drawing.wires[line.net]
        told[";".join(wire.names) or wire.signal].append(line)
    seen: dict[str, list[Line]] = defaultdict(list)
    for signal, x0, y0, x1, y1 in drawn.lines:
        seen[signal].append(Line(0, *sorted_ends((x0, y0), (x1, y1))))
    for signal in told.keys() | seen.keys():
        if not _alike(merged(told[signal]), merged(seen[signal])):
            yield Fault("as drawn", f"lines of {signal}")
    dots = [dot for wire in sheet.drawing.wires for dot in wire.dots]
    if not _alike(dots, drawn.dots):
        yield Fault("as drawn", f"{len(dots)} dots, {len(drawn.dots)} drawn, or elsewhere")
    for node in sheet.nodes:
        if node.kind in SHAPES and not any(_near(node.box, shape) for shape in drawn.shapes):
            yield Fault("as drawn", f"no shape for the box of {node.kind} {node.name}")
    there: dict[tuple[Any, ...], list[tuple[float, ...]]] = defaultdict(list)
    for letters in drawn.texts:
        there[_look(letters)].append((letters.x, letters.y, letters.size))
    texts = [text for thing in (*sheet.nodes, *sheet.drawing.wires) for text in thing.texts]
    for text in texts:
        if not any(_near((text.x, text.y, text.size), place) for place in there[_look(text)]):
            yield Fault("as drawn", f"text {text.text!r}")


def _look(text: Any) -> tuple[Any, ...]:
    return text.text, text.anchor, text.bold, text.italic


def merged(lines: list[Line]) -> list[tuple[float, ...]]:
    """Lines with those that continue or cover each other made one."""
    found: list[tuple[float, ...]] = []
    for flat in (True, False):
        rows: dict[float, list[tuple[float, float]]] = defaultdict(list)
        for line in lines:
            if line.flat == flat:
                row, a, b = (line.y0, line.x0, line.x1) if flat else (line.x0, line.y0, line.y1)
                key = next((key for key in rows if abs(key - row) <= WRITTEN), row)
                rows[key].append((a, b))
        for row, spans in rows.items():
            spans.sort()
            start, stop = spans[0]
            for a, b in spans[1:]:
                if a > stop + WRITTEN:
                    found.append((flat, row, start, stop))
                    start, stop = a, b
                stop = max(stop, b)
            found.append((flat, row, start, stop))
    return found


def _alike(a: Sequence[Sequence[float]], b: Sequence[Sequence[float]]) -> bool:
    """Whether both have the same places, in whatever order."""
    return len(a) == len(b) and all(any(_near(p, q) for q in b) for p in a)


def _near(a: Sequence[float], b: Sequence[float]) -> bool:
    """Equal as far as the SVG has them."""
    return all(abs(p - q) <= WRITTEN for p, q in zip(a, b, strict=True))


def _maps(sheet: Sheet, system: ct.InterconnectedSystem) -> Iterator[Fault]:
    connect, entering, leaving = (
        np.asarray(part, dtype=float) for part in (system.connect_map, system.input_map, system.output_map)
    )
    # Outputs may read inputs of blocks: what those are is in the other two maps.
    n_u, n_y = connect.shape
    into = np.hstack([connect, entering])
    out = np.hstack([leaving[:, :n_y], np.zeros((len(leaving), entering.shape[1]))])
    out += leaving[:, n_y:] @ into if leaving.shape[1] == n_y + n_u else 0.0
    try:
        told, got = sheet.drawing.maps, read_back(sheet, system)
    except (KeyError, ValueError, RecursionError) as error:
        yield Fault("maps", f"cannot be read back: {type(error).__name__} {str(error)[:80]}")
        return
    for name, map, given in zip(("connect", "input", "output"), (connect, entering, out), told, strict=True):
        if np.shape(given) != map.shape or not np.allclose(given, map, rtol=0.0, atol=1e-12):
            yield Fault("maps", f"Drawing.maps differs from {name}_map")
    for name, map, back in zip(("connections and inputs", "outputs"), (into, out), got, strict=True):
        if not np.allclose(back, map, rtol=PRINTED, atol=1e-12):
            yield Fault("maps", f"{name}: off at {np.argwhere(np.abs(back - map) > PRINTED).tolist()[:4]}")


def read_back(sheet: Sheet, system: ct.InterconnectedSystem) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of blocks, outputs of the system: over (outputs of blocks, inputs of the system), from wires and names."""
    columns, rows = {}, {}
    for part in system.syslist:
        columns |= {(part.name, label): len(columns) + k for k, label in enumerate(part.output_labels)}
        rows |= {(part.name, label): len(rows) + k for k, label in enumerate(part.input_labels)}
    n_y = len(columns)
    outer = {label: n_y + k for k, label in enumerate(system.input_labels)}
    sources = {}
    for wire in sheet.drawing.wires:
        for target in wire.targets:
            _, port = sheet.end(target)
            if id(port) in sources:
                raise ValueError(f"two wires end at {port.labels}")
            sources[id(port)] = sheet.start(wire)

    def value(node: Any, port: Any) -> np.ndarray:
        """What leaves a node by a port, as rows over all sources."""
        if node.kind == "undriven":
            return np.zeros((1, n_y + len(outer)))
        if port.labels:
            places = [
                outer[label] if node.kind == "input" else columns[node.name, label] for label in port.labels
            ]
            return _unit(places, n_y + len(outer))
        ports = [each for each in node.ports if each.direction == "in"]
        terms = [each.sign * value(*sources[id(each)]) for each in ports]
        return factor(node) * sum(terms[1:], start=terms[0])

    u = np.zeros((len(rows), n_y + len(outer)))
    y = np.zeros((system.noutputs, n_y + len(outer)))
    for node in sheet.nodes:
        for port in node.ports:
            if port.direction == "in" and id(port) in sources:
                if node.kind == "output":
                    y[[system.output_labels.index(label) for label in port.labels]] = value(
                        *sources[id(port)]
                    )
                elif port.labels:
                    u[[rows[node.name, label] for label in port.labels]] = value(*sources[id(port)])
    return u, y


def _unit(columns: list[int], width: int) -> np.ndarray:
    found = np.zeros((len(columns), width))
    found[np.arange(len(columns)), columns] = 1.0
    return found


def factor(node: Any) -> float:
    """Of a gain, read from its text; 1 of a sum."""
    if node.kind != "gain":
        return 1.0
    text = "".join(text.text for text in node.texts).replace("−", "-").translate(RAISED)
    found = re.fullmatch(r"(-?[\d.]+)(?:·10(-?\d+))?", text.strip())
    if found is None:
        raise ValueError(f"gain {node.name}: no number in {text}")
    return float(found[1]) * 10.0 ** int(found[2] or 0)
