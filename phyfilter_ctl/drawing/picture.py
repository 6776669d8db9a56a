"""A drawing: nodes and wires, written as files and read back as matrices."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._output import replacing, write_figure
from .marks import Node, Text, Wire
from .painting import figure_of

__all__ = ["Drawing"]

_FORMATS = (".svg", ".png", ".pdf")


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
        Names of its wires as ``at`` of :func:`phyfilter_ctl.margins` takes them, entry by entry.
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
        figure = figure_of(self.nodes, self.wires, self.texts, self.width, self.height)
        write_figure(str(place), figure)

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
