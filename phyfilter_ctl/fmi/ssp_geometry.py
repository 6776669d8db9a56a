"""Places of components, connectors and connections in a package's diagram (SSP's geometry), laid out, written, read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import lxml.etree as etree

from ..drawing.composing import composed
from ..drawing.marks import Point
from ..drawing.placing import Wishes, place
from ..drawing.reading import MOST, Part, read, sketch_of
from ..drawing.symbols import Box, Symbol
from .ssp_values import NAMESPACES, transformation
from .units import AS_IS

__all__ = ["FMU_TYPES", "SIGNALS", "SspGeometry", "add_geometry", "laid_out", "read_geometry"]

# Annotation of a system: names for components' inputs and outputs, where it has no connectors of its own.
SIGNALS = "urn:phyfilter-ctl:signals"
FMU_TYPES = (None, "application/x-fmu-sharedlibrary")

_SSD = f"{{{NAMESPACES['ssd']}}}"
_MM = 25.4 / 96.0  # a px of the layout
_SAME = 0.02  # px: what rounding in the layout leaves
_FARTHEST = 1e7  # mm

Extent = tuple[float, float, float, float]
End = tuple[str, str]  # element ("" for the whole), connector
Line = tuple[Point, ...]


@dataclass(frozen=True, eq=False)
class SspGeometry:
    """Where everything in a system's diagram stands, in mm, x to the right and y up.

    Parameters
    ----------
    canvas : (x0, y0, x1, y1)
        The whole, its lower left and upper right corner.
    places : dict of str to (x0, y0, x1, y1)
        Of each element.
    systems : frozenset of str
        Elements that are systems themselves.
    ends : dict of (element, connector) to (kind, (x, y))
        Connectors; kind is "input" or "output", the element "" for those of the whole.
    lines : dict of (source, sink) to points
        Connections from end to end.
    """

    canvas: Extent
    places: Mapping[str, Extent]
    systems: frozenset[str]
    ends: Mapping[End, tuple[str, Point]]
    lines: Mapping[tuple[End, End], Line]


def laid_out(
    ports: Mapping[str, tuple[Sequence[str], Sequence[str]]],
    wires: Iterable[tuple[End, End]],
    inputs: Sequence[str],
    outputs: Sequence[str],
    units: Mapping[str, Mapping[str, str]],
) -> SspGeometry | None:
    """The layout of block diagrams for components and their connections.

    Parameters
    ----------
    ports : dict of str to (inputs, outputs)
        Connectors by component.
    wires : iterable of (source, sink)
    inputs, outputs : sequence of str
        Connectors of the whole.
    units : dict of str to dict of str to str
        Of connectors by component, for which there is room on the wires.

    Returns
    -------
    SspGeometry or None
        None for more components than a picture shows. Entries of a vector that go one way stand at one point.
    """
    if not 0 < len(ports) <= MOST:
        return None
    wires = list(wires)
    boxes = [
        Box(name, tuple(ins), tuple(outs), Symbol("block"), units.get(name, {}))
        for name, (ins, outs) in ports.items()
    ]
    driven: dict[str, dict[str, float]] = {}
    shown: dict[str, dict[str, float]] = {label: {} for label in outputs}
    for (element, label), (owner, sink) in wires:
        source = {f"{element}.{label}" if element else label: 1.0}
        if owner:
            driven[f"{owner}.{sink}"] = source
        else:
            shown[sink] = source
    scheme = read(sketch_of("system", boxes, driven, inputs, shown))
    parts = [_unnamed(part) if part.kind in ("input", "output") else part for part in scheme.parts]
    plan = place(replace(scheme, parts=tuple(parts)), Wishes(near_outputs=False), framed=True)
    nodes, nets = composed(plan, {})

    def point(x: float, y: float) -> Point:
        return round(x * _MM, 3), round((plan.height - y) * _MM, 3)

    places: dict[str, Extent] = {}
    ends: dict[End, tuple[str, Point]] = {}
    entries: dict[tuple[str, str], list[End]] = {}  # of a vector's port
    corners: dict[tuple[str, str], tuple[Point, Point]] = {}  # its end, and where the layout's wire begins
    for node in nodes:
        own = node.kind in ("input", "output")
        if own or any(port.labels for port in node.ports):
            if not own:
                (x0, y1), (x1, y0) = point(*node.box[:2]), point(*node.box[2:])
                places[node.name] = x0, y0, x1, y1
            for port in node.ports:
                x = (node.box[0] if port.side == "E" else node.box[2]) if own else port.x
                key = node.name, port.name
                corners[key] = (x, port.y), (port.x, port.y)
                entries[key] = [("" if own else node.name, label) for label in port.labels]
                kind = node.kind if own else f"{port.direction}put"
                ends |= {end: (kind, point(x, port.y)) for end in entries[key]}
    lines: dict[tuple[End, End], Line] = {}
    for net in nets:
        if net.source in corners:  # not a mark at an input that nothing drives
            pieces = [*net.lines, *(corners[key] for key in (net.source, *net.targets))]
            for target in net.targets:
                path = [point(*at) for at in _path(pieces, corners[net.source][0], corners[target][0])]
                lines |= {
                    pair: tuple(path) for pair in zip(entries[net.source], entries[target], strict=True)
                }
    return SspGeometry((0.0, 0.0, *point(plan.width, 0.0)), places, frozenset(), ends, lines)


def _unnamed(part: Part) -> Part:
    """A terminal without a name: others write it outside of the canvas, or not at all."""
    inputs, outputs = (tuple(pin._replace(name="") for pin in side) for side in (part.inputs, part.outputs))
    return replace(part, inputs=inputs, outputs=outputs)


def _path(pieces: Sequence[Line], start: Point, end: Point) -> list[Point]:
    """Corners of the way from end to end along level and upright pieces that meet."""
    found = {(start, end) for start, end in pieces if math.dist(start, end) > _SAME}
    meeting = {point for piece in found for point in piece} | {start, end}
    for (ax, ay), (bx, by) in found:
        meeting |= {
            (ax, cy)
            for (cx, cy), (dx, dy) in found
            if abs(ax - bx) < _SAME and abs(cy - dy) < _SAME and _within(ax, cx, dx) and _within(cy, ay, by)
        }
    before: dict[Point, Point] = {start: start}
    front = [start]
    while front and end not in before:
        at = front.pop(0)
        for a, b in found:
            if _on(at, a, b):
                near = [p for p in meeting if p not in before and _on(p, a, b)]
                before |= dict.fromkeys(near, at)
                front += sorted(near, key=lambda p: math.dist(p, at))
    way = [end]
    while way[-1] != start:
        way.append(before[way[-1]])
    bends = [
        p
        for a, p, b in zip(way, way[1:], way[2:], strict=False)
        if math.dist(a, p) > _SAME < math.dist(p, b) and not _on(p, a, b)
    ]
    return [start, *reversed(bends), end]


def _within(z: float, a: float, b: float) -> bool:
    return min(a, b) - _SAME <= z <= max(a, b) + _SAME


def _on(p: Point, a: Point, b: Point) -> bool:
    """Whether a point is on a level or upright piece."""
    flat = min(abs(a[0] - b[0]), abs(a[1] - b[1])) < _SAME
    return flat and _within(p[0], a[0], b[0]) and _within(p[1], a[1], b[1])


def add_geometry(system: etree._Element, geometry: SspGeometry) -> None:
    """Write the places into a system's description, each element where the schema has it.

    Parameters
    ----------
    system : lxml element
        With its connectors, elements and connections; its annotations are still to come.
    geometry : SspGeometry
    """

    def connectors(element: etree._Element, name: str, extent: Extent) -> None:
        for connector in element.iterfind("ssd:Connectors/ssd:Connector", NAMESPACES):
            found = geometry.ends.get((name, connector.get("name", "")))
            if found is not None:
                (x, y), (x0, y0, x1, y1) = found[1], extent
                at = {"x": (x - x0) / (x1 - x0), "y": (y - y0) / (y1 - y0)}
                etree.SubElement(connector, f"{_SSD}ConnectorGeometry", _numbers(at))

    def extent(values: Extent) -> dict[str, str]:
        return _numbers(dict(zip(("x1", "y1", "x2", "y2"), values, strict=True)))

    connectors(system, "", geometry.canvas)
    for element in system.iterfind("ssd:Elements/*", NAMESPACES):
        name = element.get("name", "")
        connectors(element, name, geometry.places[name])
        mark = etree.Element(f"{_SSD}ElementGeometry", extent(geometry.places[name]))
        element.insert(1 if element.find("ssd:Connectors", NAMESPACES) is not None else 0, mark)
    for connection in system.iterfind("ssd:Connections/ssd:Connection", NAMESPACES):
        line = geometry.lines.get(_connected(connection), ())
        xs, ys = (" ".join(f"{at[axis]:.10g}" for at in line[1:-1]) for axis in (0, 1))
        etree.SubElement(connection, f"{_SSD}ConnectionGeometry", pointsX=xs, pointsY=ys)
    etree.SubElement(system, f"{_SSD}SystemGeometry", extent(geometry.canvas))


def _numbers(values: Mapping[str, float]) -> dict[str, str]:
    return {key: f"{value:.10g}" for key, value in values.items()}


def _connected(connection: etree._Element) -> tuple[End, End]:
    start, end = (
        (connection.get(f"{side}Element", ""), connection.get(f"{side}Connector", ""))
        for side in ("start", "end")
    )
    return start, end


def read_geometry(system: etree._Element) -> SspGeometry | None:
    """Places that a system's description gives.

    Parameters
    ----------
    system : lxml element

    Returns
    -------
    SspGeometry or None
        None where an element has no place, a number is no finite one, connections change their signal or lead through
        signal dictionaries, or names of the whole's signals stand in an annotation alone.
    """
    try:
        return _read(system)
    except _UnplacedError:
        return None


class _UnplacedError(Exception):
    """The diagram cannot be drawn by what its description says."""


def _read(system: etree._Element) -> SspGeometry:
    places: dict[str, Extent] = {}
    ends: dict[End, tuple[str, Point]] = {}
    systems: set[str] = set()
    elements = system.findall("ssd:Elements/*", NAMESPACES)
    if (
        not elements
        or system.find(f"ssd:Annotations/ssc:Annotation[@type='{SIGNALS}']", NAMESPACES) is not None
    ):
        raise _UnplacedError
    for element in elements:
        tag, name = etree.QName(element).localname, element.get("name", "")
        mark = element.find("ssd:ElementGeometry", NAMESPACES)
        if mark is None or tag not in ("Component", "System"):
            raise _UnplacedError
        if tag == "System" or element.get("type") not in FMU_TYPES:
            systems.add(name)
        corners, turn = _extent(mark), _number(mark.get("rotation", "0"))
        turned = [_turned(x, y, corners, turn) for x in corners[::2] for y in corners[1::2]]
        xs, ys = zip(*turned, strict=True)
        places[name] = min(xs), min(ys), max(xs), max(ys)
        ends |= _ends(element, name, corners, turn)
    canvas = system.find("ssd:SystemGeometry", NAMESPACES)
    around = [*zip(*places.values(), strict=True)]
    lower, upper = map(min, around[:2]), map(max, around[2:])
    whole = _extent(canvas) if canvas is not None else (*lower, *upper)
    if whole[0] > whole[2] or whole[1] > whole[3]:
        raise _UnplacedError
    ends |= _ends(system, "", whole, 0.0)
    lines: dict[tuple[End, End], Line] = {}
    for connection in system.findall("ssd:Connections/ssd:Connection", NAMESPACES):
        pair = _connected(connection)
        if pair[0] not in ends or pair[1] not in ends or transformation(connection, "") != AS_IS:
            raise _UnplacedError
        sides = [
            (ends[end][0] == "input") != (end[0] != "") for end in pair
        ]  # whether it gives, seen from inside
        if sides[0] == sides[1]:
            raise _UnplacedError
        mark = connection.find("ssd:ConnectionGeometry", NAMESPACES)
        between: Line = () if mark is None else _points(mark)
        a, b = ends[pair[0]][1], ends[pair[1]][1]
        if (
            mark is None and min(abs(a[0] - b[0]), abs(a[1] - b[1])) > _SAME
        ):  # nothing said: level, upright, level
            half = (a[0] + b[0]) / 2
            between = (half, a[1]), (half, b[1])
        line = (a, *between, b)
        start, end = pair if sides[0] else pair[::-1]
        lines[start, end] = line if sides[0] else line[::-1]
    return SspGeometry(whole, places, frozenset(systems), ends, lines)


def _ends(element: etree._Element, name: str, corners: Extent, turn: float) -> dict[End, tuple[str, Point]]:
    """Connectors that carry signals; those without a place spread over the left side, or the right."""
    found: dict[End, tuple[str, Point]] = {}
    x0, y0, x1, y1 = corners
    every = element.findall("ssd:Connectors/ssd:Connector", NAMESPACES)
    for kind, side in (("input", 0.0), ("output", 1.0)):
        some = [connector for connector in every if connector.get("kind") == kind]
        for k, connector in enumerate(some):
            mark = connector.find("ssd:ConnectorGeometry", NAMESPACES)
            u, v = side, 1.0 - (k + 1) / (len(some) + 1)
            if mark is not None:
                u, v = (_number(mark.get(key, "")) for key in ("x", "y"))
            at = _turned(x0 + u * (x1 - x0), y0 + v * (y1 - y0), corners, turn)
            found[name, connector.get("name", "")] = kind, at
    return found


def _turned(x: float, y: float, corners: Extent, degrees: float) -> Point:
    """A point turned about the middle of an element, left round."""
    cx, cy = (corners[0] + corners[2]) / 2, (corners[1] + corners[3]) / 2
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return cx + c * (x - cx) - s * (y - cy), cy + s * (x - cx) + c * (y - cy)


def _extent(mark: etree._Element) -> Extent:
    x0, y0, x1, y1 = (_number(mark.get(key, "")) for key in ("x1", "y1", "x2", "y2"))
    if x0 == x1 or y0 == y1:
        raise _UnplacedError
    return x0, y0, x1, y1


def _points(mark: etree._Element) -> Line:
    xs, ys = ([_number(text) for text in mark.get(key, "").split()] for key in ("pointsX", "pointsY"))
    if len(xs) != len(ys):
        raise _UnplacedError
    return tuple(zip(xs, ys, strict=True))


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError as error:
        raise _UnplacedError from error
    if not abs(value) <= _FARTHEST:  # the schema lets infinities and what is not a number pass
        raise _UnplacedError
    return value
