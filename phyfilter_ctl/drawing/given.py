"""A package of FMUs drawn where its own description says that its components, connectors and connections stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

from .bodies import FONT, body_of
from .composing import Composed, arrow, block_marks, texts_of, unique, wire_texts
from .marks import Node, Point, Port, Side, Wire
from .names import base_and_index, runs, text_width
from .placing import Segment, branches, merged
from .reading import Part
from .sketches import Package
from .symbols import Pin, Symbol, common_unit

if TYPE_CHECKING:
    from ..fmi.ssp_geometry import End, Extent, SspGeometry

__all__ = ["Given", "as_given"]

_SCALE = 96.0 / 25.4  # px of a mm, at least
_WIDEST = 6000.0  # px of a picture
_MARGIN = 8.0
_CLOSE = 14.0  # px from a connector's name to the next
_LEVEL = 0.05  # px: what rounding leaves of a level or upright piece


class Given(NamedTuple):
    """Nodes and wires, and the size of their picture in px."""

    level: Composed
    width: float
    height: float


class _Bundle(NamedTuple):
    """Connectors of an element that stand at one point: entries of a vector."""

    element: str
    kind: str
    at: Point
    labels: tuple[str, ...]

    @property
    def name(self) -> str:
        first, *others = self.labels
        bases = {base_and_index(label)[0] for label in self.labels}
        return bases.pop() if others and len(bases) == 1 else first


def as_given(package: Package, geometry: SspGeometry, values: Mapping[str, str]) -> Given:
    """Everything at its place, as large as its names need.

    Parameters
    ----------
    package : Package
    geometry : SspGeometry
    values : mapping of str to str
        What is written on wires, by signal.

    Returns
    -------
    Given
    """
    units = {(box.name, label): unit for box in package.syslist for label, unit in box.units.items()}
    bundles = _bundles(geometry)
    parts = {
        name: _part(name, "diagram" if name in geometry.systems else "block", bundles, units)
        for name in geometry.places
    }
    scale, (x0, y0, x1, y1) = _scale(geometry, bundles, parts), _around(geometry)
    middle = (x0 + x1) / 2
    whole = [bundle for bundle in bundles if not bundle.element]
    room = [
        max((_wide(bundle) for bundle in whole if (bundle.at[0] > middle) == right), default=0.0) + _MARGIN
        for right in (False, True)
    ]

    def px(at: Point) -> Point:
        return round((at[0] - x0) * scale + room[0], 2), round((y1 - at[1]) * scale + _MARGIN, 2)

    nodes: list[Node] = []
    ends: dict[End, tuple[Node, Port]] = {}
    named = unique([*parts, *(f"{bundle.name} ({bundle.kind})" for bundle in whole)])
    for bundle, called in zip(whole, named[len(parts) :], strict=True):
        x, y = px(bundle.at)
        way: Side = "W" if bundle.at[0] > middle else "E"
        box = (x - _wide(bundle), y - 8, x, y + 10) if way == "E" else (x, y - 8, x + _wide(bundle), y + 10)
        port = Port(bundle.name, bundle.labels, x, y, way, "out" if bundle.kind == "input" else "in")
        texts = texts_of(runs(bundle.name, FONT), (box[0] + box[2]) / 2, y + 4.5, "middle")
        nodes.append(Node(called, bundle.kind, box, texts, (port,)))
        ends |= {("", label): (nodes[-1], port) for label in bundle.labels}
    for name, part in parts.items():
        low, high = geometry.places[name][:2], geometry.places[name][2:]
        (left, bottom), (right, top) = px(low), px(high)
        own = sorted(
            (b for b in bundles if b.element == name), key=lambda b: b.kind
        )  # inputs first, as ports are
        ports = _ports(own, px, (left, top, right, bottom))
        up = (bottom - top) / 2
        texts, shapes, box = block_marks(
            part, False, (left + right) / 2, (top + bottom) / 2, up, up, right - left, ports
        )
        nodes.append(Node(name, part.kind, box, texts, ports, None, None, shapes))
        for bundle, port in zip(own, ports, strict=True):
            ends |= {(name, label): (nodes[-1], port) for label in bundle.labels}
    wires = _wires(geometry, ends, units, px, values)
    return Given(
        Composed(tuple(nodes), wires), (x1 - x0) * scale + sum(room), (y1 - y0) * scale + 2 * _MARGIN
    )


def _bundles(geometry: SspGeometry) -> list[_Bundle]:
    found: dict[tuple[str, str, Point], list[str]] = {}
    for (element, label), (kind, at) in geometry.ends.items():
        found.setdefault((element, kind, (round(at[0], 2), round(at[1], 2))), []).append(label)
    return [
        _Bundle(element, kind, geometry.ends[element, labels[0]][1], tuple(labels))
        for (element, kind, _), labels in found.items()
    ]


def _part(name: str, kind: str, bundles: Sequence[_Bundle], units: Mapping[End, str]) -> Part:
    pins: dict[str, list[Pin]] = {"input": [], "output": []}
    for bundle in bundles:
        if bundle.element == name:
            unit = common_unit(units.get((name, label), "") for label in bundle.labels)
            pins[bundle.kind].append(Pin(bundle.name, bundle.labels, (), len(bundle.labels), unit=unit))
    return Part(name, Symbol(kind), tuple(pins["input"]), tuple(pins["output"]))


def _wide(bundle: _Bundle) -> float:
    return text_width(runs(bundle.name, FONT)) + 8


def _around(geometry: SspGeometry) -> Extent:
    """Of all that is drawn, in mm."""
    points = [corner for box in (geometry.canvas, *geometry.places.values()) for corner in (box[:2], box[2:])]
    points += [at for _, at in geometry.ends.values()]
    points += [at for line in geometry.lines.values() for at in line]
    xs, ys = zip(*points, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def _scale(geometry: SspGeometry, bundles: Sequence[_Bundle], parts: Mapping[str, Part]) -> float:
    """px of a mm: names fit into their boxes and stand clear of each other, as far as the picture stays a picture."""
    found = _SCALE
    for name, part in parts.items():
        x0, y0, x1, y1 = geometry.places[name]
        body = body_of(part, 0, {})
        found = max(found, body.width / (x1 - x0), (body.up + body.down) / (y1 - y0))
        for kind in ("input", "output"):
            heights = sorted(b.at[1] for b in bundles if (b.element, b.kind) == (name, kind))
            found = max([found, *(_CLOSE / (b - a) for a, b in pairwise(heights) if b - a > 1e-3)])
    x0, y0, x1, y1 = _around(geometry)
    return min(found, _WIDEST / max(x1 - x0, y1 - y0))


def _ports(
    bundles: Sequence[_Bundle], px: Callable[[Point], Point], box: tuple[float, float, float, float]
) -> tuple[Port, ...]:
    found = []
    for kind in ("input", "output"):
        own = [bundle for bundle in bundles if bundle.kind == kind]
        for bundle, name in zip(own, unique(b.name for b in own), strict=True):
            x, y = px(bundle.at)
            away: dict[Side, float] = {"W": x - box[0], "E": box[2] - x, "N": y - box[1], "S": box[3] - y}
            side = min(away, key=lambda side: away[side])
            found.append(Port(name, bundle.labels, x, y, side, "in" if kind == "input" else "out"))
    return tuple(found)


def _wires(
    geometry: SspGeometry,
    ends: Mapping[End, tuple[Node, Port]],
    units: Mapping[End, str],
    px: Callable[[Point], Point],
    values: Mapping[str, str],
) -> tuple[Wire, ...]:
    """Connections from one connector as one wire; those of a vector's entries lie on each other."""
    nets: dict[tuple[str, str], dict[tuple[str, str], list[Point]]] = {}
    elements: dict[tuple[str, str], str] = {}
    entries: dict[tuple[str, str], list[str]] = {}  # their units
    for (source, sink), line in geometry.lines.items():
        (a, start), (b, end) = ends[source], ends[sink]
        key = a.name, start.name
        elements[key] = source[0]
        nets.setdefault(key, {})[b.name, end.name] = [px(at) for at in line]
        entries.setdefault(key, []).append(units.get(source, "") or units.get(sink, ""))
    known = {(node.name, port.name): port for node, port in ends.values()}
    found = []
    for source, targets in nets.items():
        start, flat, slanted = known[source], list[Segment](), list[tuple[Point, Point]]()
        for (ax, ay), (bx, by) in (piece for line in targets.values() for piece in pairwise(line)):
            if abs(ay - by) < _LEVEL:
                flat.append(Segment(min(ax, bx), ay, max(ax, bx), ay))
            elif abs(ax - bx) < _LEVEL:
                flat.append(Segment(ax, min(ay, by), ax, max(ay, by)))
            else:
                slanted.append(((ax, ay), (bx, by)))
        joined = merged(flat)
        owner = elements[source]
        names = tuple(f"{owner}.{label}" if owner else label for label in start.labels)
        signal = names[0] if len(names) == 1 else f"{owner}.{start.name}".removeprefix(".")
        value = next((values[name] for name in (signal, *names) if name in values), "")
        texts, slash = wire_texts(start, "", len(names), common_unit(entries[source]), value)
        found.append(
            Wire(
                signal,
                source,
                tuple(targets),
                (*(((s.x0, s.y0), (s.x1, s.y1)) for s in joined), *slanted),
                len(names),
                all(known[target].x > start.x for target in targets),
                branches(joined),
                names if owner else (),
                texts,
                (*(arrow(known[target]) for target in targets), *slash),
            )
        )
    return tuple(found)
