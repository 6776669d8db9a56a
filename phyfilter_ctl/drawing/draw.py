"""pf.draw: any system as a block diagram."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from typing import Any, Literal

import numpy as np

from .bodies import NOTE
from .composing import Composed, composed, texts_of
from .given import as_given
from .marks import Text
from .names import number, text_width
from .painting import svg_of
from .picture import Drawing
from .placing import Plan, Wishes, place
from .reading import MOST, Scheme, Sketch, read
from .sketches import Package, sketched

__all__ = ["draw"]

_OUTPUTS = {None: None, "near": True, "border": False}


def draw(
    system: Any,
    depth: int = 0,
    *,
    outputs: Literal["border", "near"] | None = None,
    below: Collection[str] = (),
    ahead: Collection[str] = (),
    values: Mapping[str, float] | None = None,
) -> Drawing:
    """A system as a block diagram, as control textbooks draw it.

    Inputs stand left, outputs right, the forward path is one straight line; what lies only in the feedback path stands
    below it, mirrored.

    Parameters
    ----------
    system : control.InputOutputSystem or other
        A diagram of ``control.interconnect``, ``control.feedback`` or ``control.series``, or a single block. Also a
        PhyFilter, FilterBank or SampledPhyFilter: in the loop of its equation; a FlatModel or FmuDescription: its
        inputs and outputs; the path of an FMU, of a package of FMUs (.ssp), or of a filter's file (.toml).
    depth : int
        How many levels of diagrams inside are opened; the others are boxes with a double border.
    outputs : {"border", "near"}, optional
        Whether outputs stand at the right border or beside what they show; None: near where there are more than 8.
    below, ahead : collection of str
        Names of blocks that stand in the feedback path, or in the forward path, where the drawing finds otherwise.
    values : mapping of str to float, optional
        Numbers written on wires by their signals, such as an operating point.

    Returns
    -------
    Drawing
        Shown by notebooks; ``save`` writes SVG, PNG or PDF.

    Raises
    ------
    TypeError
        For something that cannot be drawn.
    ValueError
        For a depth below 0, blocks or signals that are not there, more parts on a level than can be read, or a path
        with another ending; and what reading the file raises.

    Notes
    -----
    ``control.feedback`` and ``control.series`` of transfer functions or state-space systems compute one system and keep
    nothing of its parts: that is drawn as the one block it is. Of ``control.interconnect`` all is kept.

    A package of FMUs whose description says where all its components stand (SSP 1.0, ElementGeometry) and whose
    connections change nothing is drawn so, at a scale at which its names fit; inner systems stay closed. ``outputs``,
    ``below`` or ``ahead`` ask for this layout instead. Units stand on wires where the block that drives a wire, or all
    that read it, know them.

    Examples
    --------
    >>> import control as ct
    >>> C = ct.tf([2.0, 1.0], [1.0, 0.0], inputs="e", outputs="u", name="PI")
    >>> P = ct.tf([4.0], [1.0, 2.0], inputs="u", outputs="y", name="plant")
    >>> error = ct.summing_junction(["r", "-y"], "e", name="error")
    >>> picture = draw(ct.interconnect([error, C, P], inputs="r", outputs="y"))
    >>> picture.signals
    ('error.e', 'PI.u', 'plant.y')

    .. image:: /docs/drawn/pi_loop.svg
       :alt: the loop of this example
    """
    import control as ct

    system = sketched(system) or system
    if not isinstance(system, ct.InputOutputSystem | Sketch):
        raise TypeError(
            "system: expected a python-control system, a filter, a FlatModel, an FMU's description or the path of an "
            f"FMU, a package or a filter's file, got {type(system).__name__}"
        )
    if isinstance(depth, bool) or not isinstance(depth, int | np.integer) or depth < 0:
        raise ValueError(f"depth: expected a whole number, 0 or more, got {depth!r}")
    if outputs not in _OUTPUTS:
        raise ValueError(f"outputs: expected 'border', 'near' or None, got {outputs!r}")
    _check_size(system, int(depth))
    numbers = {name: number(float(value), 4) for name, value in (values or {}).items()}
    if isinstance(system, Package) and system.geometry and not (outputs or below or ahead):
        found, width, height = as_given(system, system.geometry, numbers)
        return _checked(_painted(found, width, height, _title(system.name)), numbers)
    scheme = read(system, int(depth))
    names = _names(scheme)
    for option, given in (("below", below), ("ahead", ahead)):
        if unknown := sorted(set(given) - names):
            raise ValueError(
                f"{option}: no block is called {unknown[0]!r}; there are {', '.join(sorted(names))}"
            )
    wishes = Wishes(_OUTPUTS[outputs], frozenset(below), frozenset(ahead), numbers)
    return _checked(_drawing(place(scheme, wishes), numbers, _title(system.name)), numbers)


def _checked(drawing: Drawing, numbers: Mapping[str, str]) -> Drawing:
    known = {name for wire in drawing.wires for name in (wire.signal, *wire.names)}
    if unknown := sorted(set(numbers) - known):
        raise ValueError(f"values: no wire is called {unknown[0]!r}; there are {', '.join(sorted(known))}")
    return drawing


def _title(name: str) -> str:
    """None of the names that python-control counts up, so that one diagram is always drawn alike."""
    return "block diagram" if re.fullmatch(r"(sys\[\d+\])?", name or "") else name


def _names(scheme: Scheme) -> set[str]:
    """Of all blocks that are drawn."""
    blocks = [part for part in scheme.parts if part.name and part.kind not in ("input", "output")]
    return {part.name for part in blocks}.union(*(_names(part.inner) for part in blocks if part.inner))


def _drawing(plan: Plan, values: Mapping[str, str], title: str) -> Drawing:
    found = composed(plan, values)
    legend = _rates(plan)
    height = plan.height + (18 if legend else 0)
    width = max(plan.width, text_width(legend, NOTE) + 16)
    texts = texts_of(legend, 8, height - 8, "start", NOTE) if legend else ()
    return _painted(found, width, height, title, texts)


def _painted(
    found: Composed, width: float, height: float, title: str, texts: tuple[Text, ...] = ()
) -> Drawing:
    signals = tuple(dict.fromkeys(name for wire in found.wires for name in wire.names))
    svg = svg_of(found.nodes, found.wires, texts, width, height, title)
    return Drawing(svg, found.nodes, found.wires, width, height, signals, texts)


def _check_size(system: Any, depth: int) -> None:
    blocks = getattr(system, "syslist", ())
    if len(blocks) > MOST:
        raise ValueError(
            f"system: expected at most {MOST} blocks on a level, got {len(blocks)} in {system.name!r}: put groups of "
            "them into diagrams of their own, which depth=0 draws as one block each, or draw parts of it"
        )
    for block in blocks if depth else ():
        _check_size(block, depth - 1)


def _rates(plan: Plan) -> str:
    """Of several rates: which blocks run at which."""
    found: dict[float, list[str]] = {}

    def gather(plan: Plan) -> None:
        for k, part in enumerate(plan.scheme.parts):
            if part.symbol.period:
                found.setdefault(part.symbol.period, []).append(part.name)
            if k in plan.inner:
                gather(plan.inner[k])

    gather(plan)
    if len(found) < 2:
        return ""
    return "   ".join(
        f"{number(period * 1e3, 4)} ms: {', '.join(names)}" for period, names in sorted(found.items())
    )
