"""How large each part is, where its wires meet it, and from which side they come to a sum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from .marks import Side
from .names import Run, caption, runs, text_width
from .ranking import Ranks
from .reading import Edge, Part, Scheme
from .symbols import Pin

__all__ = [
    "FONT",
    "NAME",
    "NOTE",
    "PORT",
    "RADIUS",
    "TITLE",
    "Body",
    "Sides",
    "body_of",
    "is_circle",
    "label",
    "ports_named",
    "sides_of",
    "titled",
    "wire_names",
]

FONT, NAME, PORT, NOTE = (
    13.0,
    12.0,
    11.0,
    10.0,
)  # px: formulas and terminals, names of blocks, of ports, notes
RADIUS = 11.0
TITLE = 22.0  # height of a frame's name
ROW = 20.0  # from port to port
_CURVE_BOX, _FRACTION, _LINE = 44.0, 44.0, 32.0
_MARKED = ("filter", "learned")  # kinds with a mark in their corner
_STUB = 3.0  # px of wire in front of a frame's border, where a terminal goes unnamed
_MOST_TERMS = 3  # of a sum that is a circle

Sides = Mapping[tuple[int, int], Side]


class Body(NamedTuple):
    """Extents of a part about its middle and heights of its ports against it, in px, y down."""

    width: float
    up: float
    down: float
    inputs: tuple[float, ...]
    outputs: tuple[float, ...]


def label(part: Part) -> tuple[Run, ...]:
    """A terminal's name, or a block's."""
    if part.silent:
        return ()
    pin = (*part.inputs, *part.outputs)[0] if part.kind in ("input", "output") else None
    return runs(pin.name, FONT) if pin else caption(part.name, NAME)


def ports_named(part: Part) -> bool:
    """Whether names of ports are written in the block."""
    return (
        part.kind in ("block", "diagram", "filter", "learned", "curve", "delay")
        and max(len(part.inputs), len(part.outputs)) > 1
    )


def titled(part: Part) -> bool:
    """Whether a block's name stands above it."""
    if part.kind == "sum" or ports_named(part):
        return False
    return part.kind == "gain" or bool(part.symbol.lines or part.symbol.curve)


def is_circle(part: Part, k: int, sides: Sides) -> bool:
    """Whether part ``k`` is a sum each of whose inputs has a side of its own."""
    return part.kind == "sum" and all((k, n) in sides for n in range(len(part.inputs)))


def body_of(part: Part, k: int, sides: Sides) -> Body:
    """Extents of any part but a frame.

    Parameters
    ----------
    part : Part
    k : int
        Its number.
    sides : mapping
        As of :func:`sides_of`.
    """
    if part.kind in ("input", "output"):
        zero = (0.0,)
        return Body(
            text_width(label(part)) + (_STUB if part.silent else 8),
            8,
            10,
            zero if part.inputs else (),
            zero if part.outputs else (),
        )
    if is_circle(part, k, sides):
        return Body(2 * RADIUS, RADIUS, RADIUS, (0.0,) * len(part.inputs), (0.0,))
    above = 15.0 if part.name else 0.0
    below = 13.0 if part.symbol.note else 0.0
    named = text_width(label(part))
    noted = text_width(part.symbol.note, NOTE)
    if part.kind == "gain":
        return Body(
            max(34 + text_width(part.symbol.lines[0], FONT) * 1.25, noted),
            22 + above,
            22 + below,
            (0.0,),
            (0.0,),
        )
    rows = max(len(part.inputs), len(part.outputs), 1)
    shift, title = 0.0, 0.0
    if part.kind == "sum":
        width, height = 34.0, rows * ROW + 6
        above = below = 0.0
    elif part.symbol.lines and not ports_named(part):
        width = max(text_width(line, FONT) for line in part.symbol.lines) + 22
        height = _FRACTION if _is_fraction(part) else _LINE
    elif part.symbol.curve:
        width = height = _CURVE_BOX
    elif ports_named(part):
        wide = (
            max((text_width(runs(pin.name, PORT)) for pin in side), default=0.0)
            for side in (part.inputs, part.outputs)
        )
        width, height = max(sum(wide) + 28, named + (44 if part.kind in _MARKED else 20)), rows * ROW + 24
        shift, title, above = 9.0, 0.0, 0.0
    else:
        width, height, above = max(named + (44 if part.kind in _MARKED else 22), 50.0), 40.0, 0.0
    width = max(width, noted + 4)
    dys = [
        tuple((i - (len(side) - 1) / 2) * ROW + shift + title for i in range(len(side)))
        for side in (part.inputs, part.outputs)
    ]
    return Body(width, height / 2 + above, height / 2 + below, *dys)


def _is_fraction(part: Part) -> bool:
    return len(part.symbol.lines) == 2 and part.symbol.lines[1] != "1"


def sides_of(scheme: Scheme, ranks: Ranks) -> dict[tuple[int, int], Side]:
    """From where wires come to the sums: the forward path from behind (W), feedback from below, others from above.

    Parameters
    ----------
    scheme : Scheme
    ranks : Ranks

    Returns
    -------
    dict
        (part, input) -> "W", "N" or "S", W standing for the back; without sums that are drawn as boxes.
    """
    found: dict[tuple[int, int], Side] = {}
    for k, part in enumerate(scheme.parts):
        wires = [e for e in scheme.edges if e.target == k]
        if part.kind != "sum" or not 2 <= len(part.inputs) <= _MOST_TERMS or len(wires) < len(part.inputs):
            continue
        if len({(e.source, e.output) for e in wires}) < len(wires):
            continue
        mirrored = k in ranks.mirrored

        def terminal(e: Edge) -> bool:
            return scheme.parts[e.source].kind == "input"

        fed = [e for e in wires if e in ranks.back or ((e.source in ranks.mirrored) != mirrored)]
        if (
            mirrored
        ):  # the nearest in the row along it, others of the row from below, what is ahead from above

            def place(e: Edge) -> tuple[bool, bool, int, int]:
                column, inside = ranks.columns[e.source], e.source in ranks.mirrored
                return terminal(e), not inside, column if inside else -column, e.input

            line = sorted(wires, key=place)
            if terminal(line[0]):
                continue
            taken: list[Side] = ["W"]
            for e in line[1:]:
                below = terminal(e) or e.source in ranks.mirrored
                order: list[Side] = ["S", "N"] if below else ["N", "S"]
                for side in order:
                    if side not in taken:
                        taken.append(side)
                        break
            if len(taken) == len(line):
                found |= {(k, e.input): side for e, side in zip(line, taken, strict=True)}
            continue
        ahead = sorted(
            (e for e in wires if e not in fed),
            key=lambda e: (
                e.source not in ranks.main,
                terminal(e) and ranks.columns[e.source] > 0,
                -ranks.columns[e.source],
                e.input,
            ),
        )
        if not ahead or len(fed) > 1:
            continue
        back: Side = "N" if fed and (fed[0].source, fed[0].output) in ranks.above else "S"
        free: list[Side] = ["W", "S" if back == "N" else "N"] if fed else ["W", "N", "S"]
        found.update({(k, e.input): back for e in fed})
        found.update({(k, e.input): side for e, side in zip(ahead, free, strict=False)})
    return found


def wire_names(part: Part, pin: Pin) -> bool:
    """Whether the name of an output is written on its wire: not where a port or a terminal shows it."""
    own = part.kind in ("input", "frame") or ports_named(part)
    return not own and pin.name not in ("", "y")
