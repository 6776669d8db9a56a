"""The checker itself: drawings without a fault pass, and each of many faults put in on purpose is found."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import control as ct
import pytest

import phyfilter_ctl as pf
from tests.drawing.checker import BOXES, Line, faults, merged, sorted_ends
from tests.drawing.diagrams import random_diagram
from tests.drawing.gallery import CASES, cascade, disturbed, phyfilter_loop, vector_loop
from tests.drawing.reading import read, width

# px
MOVED = 3.0
# Every so many of the places that a fault can be put in at: all in the deep run.
SOME = 5

BUILD: dict[str, Callable[[], ct.InterconnectedSystem]] = {
    "cascade": cascade,
    "disturbed": disturbed,
    "phyfilter loop": phyfilter_loop,
    "vector loop": vector_loop,
    "random": lambda: random_diagram(3, 6, size=3),
}
Faulty = Iterator[tuple[str, Any]]


def with_node(drawing: Any, k: int, **changes: Any) -> Any:
    """The drawing with another node in one's place."""
    new = replace(drawing.nodes[k], **changes)
    return replace(drawing, nodes=(*drawing.nodes[:k], new, *drawing.nodes[k + 1 :]))


def with_wire(drawing: Any, k: int, **changes: Any) -> Any:
    wires = (*drawing.wires[:k], replace(drawing.wires[k], **changes), *drawing.wires[k + 1 :])
    return replace(drawing, wires=wires)


def covered(lines: Any) -> list[tuple[float, ...]]:
    """What strokes cover, however they are cut."""
    return sorted(merged([Line(0, *sorted_ends(a, b)) for stroke in lines for a, b in pairwise(stroke)]))


def cut_out(wire: Any, stroke: int, k: int, *instead: Any) -> tuple[Any, ...]:
    """The strokes of a wire with one piece cut out, and perhaps another instead."""
    points = wire.lines[stroke]
    rest = [part for part in (points[: k + 1], points[k + 1 :]) if len(part) > 1]
    return (*wire.lines[:stroke], *rest, *instead, *wire.lines[stroke + 1 :])


def segments_dropped(drawing: Any) -> Faulty:
    for k, wire in enumerate(drawing.wires):
        for stroke, points in enumerate(wire.lines):
            for piece in range(len(points) - 1):
                lines = cut_out(wire, stroke, piece)
                if covered(lines) != covered(wire.lines):
                    yield f"{wire.signal}, piece {stroke}.{piece}", with_wire(drawing, k, lines=lines)


def segments_moved(drawing: Any) -> Faulty:
    for k, wire in enumerate(drawing.wires):
        for stroke, points in enumerate(wire.lines):
            for piece, ((x0, y0), (x1, y1)) in enumerate(pairwise(points)):
                dx, dy = (0.0, MOVED) if y0 == y1 else (MOVED, 0.0)
                moved = ((x0 + dx, y0 + dy), (x1 + dx, y1 + dy))
                lines = cut_out(wire, stroke, piece, moved)
                if (x0, y0) != (x1, y1):
                    yield f"{wire.signal}, piece {stroke}.{piece}", with_wire(drawing, k, lines=lines)


def blocks_moved(drawing: Any) -> Faulty:
    for k, node in enumerate(drawing.nodes):
        for dx, dy in ((MOVED, 0.0), (0.0, MOVED), (-40.0, 25.0)):
            x0, y0, x1, y1 = node.box
            yield (
                f"{node.name} by {dx}, {dy}",
                with_node(
                    drawing,
                    k,
                    box=(x0 + dx, y0 + dy, x1 + dx, y1 + dy),
                    texts=tuple(replace(text, x=text.x + dx, y=text.y + dy) for text in node.texts),
                    ports=tuple(replace(port, x=port.x + dx, y=port.y + dy) for port in node.ports),
                ),
            )


def boxes_shrunk(drawing: Any) -> Faulty:
    for k, node in enumerate(drawing.nodes):
        x0, y0, x1, y1 = node.box
        if node.ports:
            yield node.name, with_node(drawing, k, box=(x0 + 4, y0 + 4, x1 - 4, y1 - 4))


def boxes_grown_over_neighbours(drawing: Any) -> Faulty:
    for k, node in enumerate(drawing.nodes):
        x0, y0, x1, y1 = node.box
        if node.kind in BOXES:
            yield node.name, with_node(drawing, k, box=(x0 - 60, y0 - 60, x1 + 60, y1 + 60))


def texts_enlarged(drawing: Any) -> Faulty:
    for k, node in enumerate(drawing.nodes):
        for i, text in enumerate(node.texts):
            inside = node.box[1] < text.y < node.box[3]
            if node.kind in BOXES and inside and width(text.text, 3 * text.size) > node.box[2] - node.box[0]:
                texts = (*node.texts[:i], replace(text, size=3 * text.size), *node.texts[i + 1 :])
                yield f"{node.name}: {text.text}", with_node(drawing, k, texts=texts)


def texts_struck(drawing: Any) -> Faulty:
    """A text on the middle of the first wire, where there is room for half of it on either side."""
    (x0, y), (x1, _) = next(
        (a, b) for wire in drawing.wires for stroke in wire.lines for a, b in pairwise(stroke) if a[1] == b[1]
    )
    for k, node in enumerate(drawing.nodes):
        for i, text in enumerate(node.texts):
            moved = replace(text, x=(x0 + x1) / 2, y=y + 0.3 * text.size, anchor="middle")
            texts = (*node.texts[:i], moved, *node.texts[i + 1 :])
            yield f"{node.name}: {text.text}", with_node(drawing, k, texts=texts)


def signs_turned(drawing: Any) -> Faulty:
    for k, node in enumerate(drawing.nodes):
        for i, port in enumerate(node.ports):
            if node.kind == "sum" and port.direction == "in":
                ports = (*node.ports[:i], replace(port, sign=-port.sign), *node.ports[i + 1 :])
                yield f"{node.name}: {port.labels}", with_node(drawing, k, ports=ports)


def dots_lost(drawing: Any) -> Faulty:
    for k, wire in enumerate(drawing.wires):
        for i in range(len(wire.dots)):
            yield wire.signal, with_wire(drawing, k, dots=(*wire.dots[:i], *wire.dots[i + 1 :]))


def ends_lost(drawing: Any) -> Faulty:
    """A net that is drawn to a port and does not know of it."""
    for k, wire in enumerate(drawing.wires):
        for i in range(len(wire.targets)):
            yield wire.signal, with_wire(drawing, k, targets=(*wire.targets[:i], *wire.targets[i + 1 :]))


def ends_exchanged(drawing: Any) -> Faulty:
    for k in range(len(drawing.wires) - 1):
        a, b = drawing.wires[k : k + 2]
        new = with_wire(drawing, k, targets=b.targets)
        yield f"{a.signal}, {b.signal}", with_wire(new, k + 1, targets=a.targets)


PUT_IN = {
    kind.__name__: kind
    for kind in (
        segments_dropped, segments_moved, blocks_moved, boxes_shrunk, boxes_grown_over_neighbours, texts_enlarged,
        texts_struck,
        signs_turned, dots_lost, ends_lost, ends_exchanged,
    )
}  # fmt: skip


def missed(system: ct.InterconnectedSystem, kind: str, every: int) -> tuple[list[str], int]:
    """Faults of a kind that are not found by geometry alone, and how many were put in."""
    drawing = pf.draw(system)
    assert not faults(drawing, system), "what is put in would not be told from what is there"
    cases = list(PUT_IN[kind](drawing))[::every]
    unseen = [
        what for what, faulty in cases if all(fault.kind == "as drawn" for fault in faults(faulty, system))
    ]
    return unseen, len(cases)


@pytest.mark.parametrize("kind", PUT_IN)
def test_faults_of_the_geometry_are_found(kind: str):
    put_in = 0
    for build in BUILD.values():
        unseen, count = missed(build(), kind, SOME)
        assert not unseen
        put_in += count
    assert put_in > 0, "nothing was put in: the test says nothing"


@pytest.mark.slow
def test_every_fault_of_the_geometry_is_found():
    put_in = 0
    for build in (*BUILD.values(), *(CASES[name].build for name in ("decoupled", "observer", "cruise"))):
        system = build()
        assert isinstance(system, ct.InterconnectedSystem)
        for kind in PUT_IN:
            unseen, count = missed(system, kind, 1)
            assert not unseen
            put_in += count
    assert put_in > 480
    print(f"{put_in} of {put_in} faults found")


def elements(svg: str) -> Iterator[tuple[str, str]]:
    """(what, SVG with it changed) for lines, dots, boxes and texts, one at a time."""
    for found in re.finditer(r"<(path|polyline|line|circle|rect|polygon|text)\b[^>]*?(/>|>[^<]*</\1>)", svg):
        yield f"dropped {found[0][:60]}", svg[: found.start()] + svg[found.end() :]
    for found in re.finditer(r'<text [^>]*\bx="([-\d.]+)"', svg):
        moved = found[0].replace(f'x="{found[1]}"', f'x="{float(found[1]) + MOVED}"')
        yield f"moved {found[0][:60]}", svg[: found.start()] + moved + svg[found.end() :]


@pytest.mark.parametrize("name", ["phyfilter loop", "vector loop"])
def test_what_is_drawn_otherwise_is_found(name: str):
    """A line, dot, box or text that the SVG leaves out, or has elsewhere, though the geometry is right."""
    system = BUILD[name]()
    drawing = pf.draw(system)
    whole = read(drawing.svg)
    changed = 0
    for what, svg in list(elements(drawing.svg))[::2]:
        if read(svg) == whole:
            continue  # an arrow's head, a curve in a block: no part of what is read
        changed += 1
        assert faults(replace(drawing, svg=svg), system), what
    assert changed > len(drawing.nodes)


def test_a_lost_sign_is_found():
    drawing = pf.draw(cascade())
    signs = list(re.finditer(r"<text[^>]*>[-−]</text>", drawing.svg))
    assert len(signs) == 3
    for found in signs:
        svg = drawing.svg[: found.start()] + drawing.svg[found.end() :]
        assert "sign" in {fault.kind for fault in faults(replace(drawing, svg=svg))}


def test_widths_are_those_of_the_font():
    """DejaVu Sans: an n has 1298 of 2048 units, a space 651; a hat adds nothing."""
    assert width("n n", 2048.0) == 2 * 1298 + 651
    assert width("f\N{COMBINING CIRCUMFLEX ACCENT}", 12.0) == width("f", 12.0)
    assert width("W", 12.0, bold=True) > width("W", 12.0)
