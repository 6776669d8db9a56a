"""What a drawing is made of: nodes with their ports and texts, wires, and the shapes that are painted."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .._output import replacing, write_figure

__all__ = ["Drawing", "Node", "Port", "Shape", "Text", "Wire"]

Point = tuple[float, float]
_FORMATS = (".svg", ".png", ".pdf")


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
    side: Literal["W", "E", "N", "S"]
    direction: Literal["in", "out"]
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
        Its entries as :func:`phyfilter_ctl.signal_margin` takes them.
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


@dataclass(frozen=True)
class Drawing:
    """A block diagram, drawn; made by :func:`phyfilter_ctl.draw`.

    Parameters
    ----------
    svg : str
        The picture, with texts that can be selected, for light and dark pages.
    nodes : tuple of Node
        Blocks of the outermost level in the order of the system.
    wires : tuple of Wire
    width, height : float
        In px.
    signals : tuple of str
        Names of its wires as :func:`phyfilter_ctl.signal_margin` takes them, entry by entry.
    texts : tuple of Text
        Beside the diagram: the rates, where there are several.

    Examples
    --------
    >>> import control as ct
    >>> import phyfilter_ctl as pf
    >>> P = ct.tf([4.0], [1.0, 2.0], name="plant", inputs="u", outputs="y")
    >>> picture = pf.draw(P)
    >>> [node.kind for node in picture.nodes], picture.signals
    (['input', 'fraction', 'output'], ('plant.y',))
    """

    svg: str = field(repr=False)
    nodes: tuple[Node, ...]
    wires: tuple[Wire, ...]
    width: float
    height: float
    signals: tuple[str, ...]
    texts: tuple[Text, ...] = ()

    def _repr_svg_(self) -> str:
        return self.svg

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the picture.

        Parameters
        ----------
        path : str or path-like
            Ends in .svg, .png or .pdf.

        Raises
        ------
        ValueError
            For another ending.
        """
        place = Path(path)
        if place.suffix.lower() not in _FORMATS:
            raise ValueError(f"path: expected a name that ends in {', '.join(_FORMATS)}, got {place.name!r}")
        if place.suffix.lower() == ".svg":
            with replacing(str(place)) as file:
                file.write(self.svg.encode())
            return
        from .painting import figure_of

        write_figure(str(place), figure_of(self))

    @property
    def maps(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """What is drawn at the outermost level as matrices, read back from nodes, signs and wires.

        Returns
        -------
        connect : (block inputs, block outputs) array
            As ``connect_map`` of the system.
        input : (block inputs, inputs) array
            As ``input_map``.
        output : (outputs, block outputs + inputs) array
            What the outputs show; an input of a block that is shown stands as what drives it.
        """
        top = [node for node in self.nodes if node.frame is None]
        blocks = [
            node for node in top if node.kind not in ("input", "output") and any(p.labels for p in node.ports)
        ]
        ends = {kind: [node for node in top if node.kind == kind] for kind in ("input", "output")}
        sources = _places([*blocks, *ends["input"]], "out")
        inputs, outputs = _places(blocks, "in"), _places(ends["output"], "in")
        fed = {target: wire.source for wire in self.wires for target in wire.targets}
        known = {node.name: node for node in top}
        count = sum(len(places) for places in sources.values())

        def value(source: tuple[str, str], size: int) -> NDArray[np.float64]:
            if source in sources:
                return np.eye(count)[sources[source]]
            node, total = known[source[0]], np.zeros((size, count))
            for port in node.ports:
                if port.direction == "in" and (node.name, port.name) in fed:
                    total += port.sign * value(fed[node.name, port.name], size)
            return total * (1.0 if node.gain is None else node.gain)

        def matrix(places: dict[tuple[str, str], list[int]]) -> NDArray[np.float64]:
            found = np.zeros((sum(map(len, places.values())), count))
            for target, rows in places.items():
                if target in fed:
                    found[rows] = value(fed[target], len(rows))
            return found

        wired, split = (
            matrix(inputs),
            count - sum(len(p.labels) for node in ends["input"] for p in node.ports),
        )
        return wired[:, :split], wired[:, split:], matrix(outputs)


def _places(nodes: list[Node], direction: str) -> dict[tuple[str, str], list[int]]:
    """Rows of ports that stand for signals of the system."""
    found, count = {}, 0
    for node in nodes:
        for port in node.ports:
            if port.direction == direction and port.labels:
                found[node.name, port.name] = list(range(count, count + len(port.labels)))
                count += len(port.labels)
    return found
