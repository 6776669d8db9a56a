"""What a drawing is made of: nodes with their ports and texts, wires, and the shapes that are painted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

__all__ = ["Node", "Point", "Port", "Shape", "Text", "Wire"]

Point = tuple[float, float]
Side = Literal["W", "E", "N", "S"]
Direction = Literal["in", "out"]


@dataclass(frozen=True)
class Text:
    """A text of a drawing.

    Parameters
    ----------
    text : str
    x, y : float
        Where its line begins, ends or has its middle, in px.
    size : float
        Of the font, in px.
    anchor : {"start", "middle", "end"}
    bold, italic : bool
    """

    text: str
    x: float
    y: float
    size: float
    anchor: Literal["start", "middle", "end"] = "start"
    bold: bool = False
    italic: bool = False


@dataclass(frozen=True)
class Shape:
    """A line, a polygon or a circle.

    Parameters
    ----------
    points : tuple of (x, y)
        One of a circle.
    style : {"block", "frame", "thin", "curve", "thick", "solid"}
    closed : bool
    radius : float
        Of a circle in px.
    """

    points: tuple[Point, ...]
    style: str
    closed: bool = False
    radius: float = 0.0


@dataclass(frozen=True)
class Port:
    """Where wires meet a node.

    Parameters
    ----------
    name : str
        Unique among the inputs, and among the outputs, of its node.
    labels : tuple of str
        The system's signals that it stands for; none at what the drawing adds: implicit sums and gains.
    x, y : float
        In px.
    side : {"W", "E", "N", "S"}
    direction : {"in", "out"}
    sign : {1, -1}
        With which a sum takes it.
    """

    name: str
    labels: tuple[str, ...]
    x: float
    y: float
    side: Side
    direction: Direction
    sign: int = 1


@dataclass(frozen=True)
class Node:
    """A block, a sum, a gain, a terminal or a frame.

    Parameters
    ----------
    name : str
        Unique in the drawing; of a block its path.
    kind : str
        "block", "gain", "sum", "fraction", "integrator", "delay", "curve", "filter", "learned", "diagram", "input",
        "output", "frame" or "undriven".
    box : (x0, y0, x1, y1)
        In px, y down.
    texts : tuple of Text
    ports : tuple of Port
    frame : str or None
        Node of the frame that it stands in.
    gain : float or None
        Of a gain, with all its digits.
    shapes : tuple of Shape
    """

    name: str
    kind: str
    box: tuple[float, float, float, float]
    texts: tuple[Text, ...] = ()
    ports: tuple[Port, ...] = ()
    frame: str | None = None
    gain: float | None = None
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Wire:
    """What one source gives to all its readers.

    Parameters
    ----------
    signal : str
        Name of the signal; of a vector without its indices.
    source : (node, port)
        Names.
    targets : tuple of (node, port)
    lines : tuple of polylines
        Each a tuple of points (x, y), upright or level from one to the next.
    size : int
        Entries of the vector.
    forward : bool
        Whether all its targets lie ahead of the source, to its right.
    dots : tuple of (x, y)
        Where it branches.
    names : tuple of str
        Its entries as ``at`` of :func:`phyfilter_ctl.margins` takes them.
    texts : tuple of Text
        Its name, size and value, where they are drawn.
    shapes : tuple of Shape
        Heads of its arrows.
    """

    signal: str
    source: tuple[str, str]
    targets: tuple[tuple[str, str], ...]
    lines: tuple[tuple[Point, ...], ...]
    size: int = 1
    forward: bool = True
    dots: tuple[Point, ...] = ()
    names: tuple[str, ...] = ()
    texts: tuple[Text, ...] = ()
    shapes: tuple[Shape, ...] = ()
