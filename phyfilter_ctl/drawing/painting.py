"""Nodes and wires as SVG text, and as a figure of matplotlib for other formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from .marks import Node, Shape, Text, Wire
from .names import LEAST

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["figure_of", "svg_of"]

_THIN, _THICK = 1.3, 2.3  # px: wires, and wires of vectors
_STYLE = """
.pf-diagram{--ink:#141414;--paper:#fff;--pane:#f3f5f9;--edge:#6b7280;background:var(--paper)}
@media(prefers-color-scheme:dark){.pf-diagram{--ink:#e8e8e8;--paper:#181a1e;--pane:#22262d;--edge:#8b94a3}}
.pf-diagram path,.pf-diagram circle{stroke:var(--ink);fill:none;stroke-width:1.3}
.pf-diagram .wire{stroke-linecap:square}.pf-diagram .block{fill:var(--paper)}
.pf-diagram .frame{fill:var(--pane);stroke:var(--edge);stroke-width:1;stroke-dasharray:5 3}
.pf-diagram .thin{stroke-width:.8}.pf-diagram .thick{stroke-width:2.3}.pf-diagram .solid{fill:var(--ink);stroke:none}
.pf-diagram text{font-family:Helvetica,Arial,"Liberation Sans",sans-serif;fill:var(--ink)}
""".strip().replace("\n", "")
# As in the style sheet: face, line, width.
_LOOK = {
    "block": ("white", "#141414", 1.3), "frame": ("#f3f5f9", "#6b7280", 1.0), "thin": ("none", "#141414", 0.8),
    "curve": ("none", "#141414", 1.3), "thick": ("none", "#141414", 2.3), "solid": ("#141414", "none", 0.0),
}  # fmt: skip


def svg_of(
    nodes: Sequence[Node],
    wires: Sequence[Wire],
    texts: Sequence[Text],
    width: float,
    height: float,
    title: str,
) -> str:
    """The picture as SVG.

    Parameters
    ----------
    nodes, wires, texts : sequences
    width, height : float
        In px.
    title : str
        For screen readers, beside a description of blocks and terminals.
    """
    smallest = min((text.size for text in _texts(nodes, wires, texts)), default=LEAST)
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="pf-diagram" role="img" width="{np.ceil(width):.0f}" '
        f'height="{np.ceil(height):.0f}" viewBox="0 0 {width:.1f} {height:.1f}" '
        f'style="min-width:{np.ceil(width * LEAST / smallest):.0f}px">'
        f"<title>{_safe(title)}</title><desc>{_safe(_description(nodes))}</desc><style>{_STYLE}</style>"
        f'<rect width="100%" height="100%" style="fill:var(--paper)"/>'
    )
    frames = [_node(node) for node in nodes if node.kind == "frame"]
    others = [_node(node) for node in nodes if node.kind != "frame"]
    return "\n".join([head, *frames, *map(_wire, wires), *others, *map(_text, texts), "</svg>"])


def _texts(nodes: Sequence[Node], wires: Sequence[Wire], texts: Sequence[Text]) -> list[Text]:
    return [*(text for thing in (*nodes, *wires) for text in thing.texts), *texts]


def _description(nodes: Iterable[Node]) -> str:
    top = [node for node in nodes if node.frame is None]
    drawn = [
        node for node in top if node.kind not in ("input", "output") and any(p.labels for p in node.ports)
    ]
    groups = {"Inputs": [], "Blocks": [node.name for node in drawn], "Outputs": []}
    for node in top:
        if node.kind in ("input", "output"):
            groups[f"{node.kind.capitalize()}s"] += [port.name for port in node.ports]
    return ". ".join(f"{kind}: {', '.join(names)}" for kind, names in groups.items() if names)


def _safe(text: str) -> str:
    """Escaped, without the characters that XML has no place for."""
    return escape("".join(c if c.isprintable() or c in " \n" else "\ufffd" for c in text), quote=True)


def _node(node: Node) -> str:
    inside = "".join(map(_shape, node.shapes)) + "".join(map(_text, node.texts))
    return f'<g class="{node.kind}-node" data-node="{_safe(node.name)}"><title>{_safe(node.name)}</title>{inside}</g>'


def _wire(wire: Wire) -> str:
    path = "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in line) for line in wire.lines)
    dots = "".join(f'<circle class="solid" cx="{x:.1f}" cy="{y:.1f}" r="3"/>' for x, y in wire.dots)
    thick = f' style="stroke-width:{_THICK}"' if wire.size > 1 else ""
    names = _safe(" ".join(wire.names) if len(wire.names) == 1 else ";".join(wire.names) or wire.signal)
    inside = dots + "".join(map(_shape, wire.shapes)) + "".join(map(_text, wire.texts))
    return (
        f'<g class="net" data-signal="{names}"><title>{_safe(wire.signal)}</title>'
        f'<path class="wire"{thick} d="{path}"/>{inside}</g>'
    )


def _shape(shape: Shape) -> str:
    if shape.radius:
        (x, y), *_ = shape.points
        return f'<circle class="{shape.style}" cx="{x:.1f}" cy="{y:.1f}" r="{shape.radius:g}"/>'
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in shape.points) + ("Z" if shape.closed else "")
    return f'<path class="{shape.style}" d="{path}"/>'


def _text(text: Text) -> str:
    extra = ("" if text.anchor == "start" else f' text-anchor="{text.anchor}"') + (
        ' font-weight="bold"' if text.bold else "") + (' font-style="italic"' if text.italic else "")  # fmt: skip
    return f'<text x="{text.x:.1f}" y="{text.y:.1f}" font-size="{text.size:.4g}"{extra}>{_safe(text.text)}</text>'


def figure_of(
    nodes: Sequence[Node], wires: Sequence[Wire], texts: Sequence[Text], width: float, height: float
) -> Figure:
    """The picture as a figure of matplotlib, in light colours.

    Parameters
    ----------
    nodes, wires, texts : sequences
    width, height : float
        In px.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle, Polygon

    dots = 96.0
    figure = Figure(figsize=(width / dots, height / dots))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0.0, width), ylim=(height, 0.0))
    axes.set_axis_off()
    points = 72.0 / dots

    def shape(entry: Shape, z: float) -> None:
        face, line, thick = _LOOK[entry.style]
        look = {"facecolor": face, "edgecolor": line, "linewidth": thick * points, "zorder": z}
        if entry.radius:
            axes.add_patch(Circle(entry.points[0], entry.radius, **look))
        elif entry.closed:
            patch = axes.add_patch(Polygon(entry.points, closed=True, **look))
            patch.set_linestyle((0, (5, 3)) if entry.style == "frame" else "solid")
        else:
            axes.plot(*zip(*entry.points, strict=True), color=line, linewidth=thick * points, zorder=z)

    for node in nodes:
        for entry in node.shapes:
            shape(entry, 1.0 if node.kind == "frame" else 3.0)
    for wire in wires:
        line_width = (_THICK if wire.size > 1 else _THIN) * points
        for line in wire.lines:
            axes.plot(
                *zip(*line, strict=True),
                color=_LOOK["block"][1],
                linewidth=line_width,
                zorder=2,
                solid_capstyle="projecting",
            )
        for entry in wire.shapes:
            shape(entry, 2.5)
        for dot in wire.dots:
            axes.add_patch(Circle(dot, 3.0, facecolor=_LOOK["block"][1], zorder=2.5))
    for text in _texts(nodes, wires, texts):
        shown = text.text.replace("$", r"\$")
        axes.text(text.x, text.y, shown, fontsize=text.size * points, color=_LOOK["block"][1], zorder=4.0)
    return figure
