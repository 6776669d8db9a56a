"""A python-control system read as parts and wires between whole vectors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .names import base_and_index, vector_starts
from .symbols import Box, Pin, Symbol, common_unit, gain_symbol, symbol_of, units_of

__all__ = ["MOST", "Edge", "Part", "Scheme", "Sketch", "read", "sketch_of"]

FloatArray = NDArray[np.float64]
MOST = 150  # blocks of one level that a picture shows
Cuts = tuple[frozenset[int], frozenset[int]]
Terms = Mapping[str, float]


class Edge(NamedTuple):
    """A wire from an output of a part to an input of another."""

    source: int
    output: int
    target: int
    input: int


@dataclass(frozen=True, eq=False)
class Sketch:
    """Boxes and wires, as an interconnected system of python-control has them."""

    name: str
    syslist: tuple[Box, ...]
    connect_map: NDArray[np.float64]
    input_map: NDArray[np.float64]
    output_map: NDArray[np.float64]
    input_labels: tuple[str, ...]
    output_labels: tuple[str, ...]

    @property
    def noutputs(self) -> int:
        return len(self.output_labels)


def sketch_of(
    name: str,
    boxes: Sequence[Box],
    wires: Mapping[str, Terms],
    inputs: Sequence[str],
    outputs: Mapping[str, Terms],
) -> Sketch:
    """A sketch of wires by name: what each input of a box, ``box.label``, and each output is the sum of.

    Parameters
    ----------
    name : str
    boxes : sequence of Box
    wires, outputs : mapping of str to mapping of str to float
        Factors of the sources, ``box.label`` or an input.
    inputs : sequence of str
    """
    sinks = [f"{box.name}.{label}" for box in boxes for label in box.input_labels]
    sources = [*(f"{box.name}.{label}" for box in boxes for label in box.output_labels), *inputs]
    row, column = ({label: k for k, label in enumerate(labels)} for labels in (sinks, sources))
    count = len(sources) - len(inputs)
    driven, shown = np.zeros((len(sinks), len(sources))), np.zeros((len(outputs), len(sources)))
    for sink, terms in wires.items():
        for source, gain in terms.items():
            driven[row[sink], column[source]] += gain
    for k, terms in enumerate(outputs.values()):
        for source, gain in terms.items():
            shown[k, column[source]] += gain
    # An output that shows an input: through an input of a box that it drives.
    full = np.hstack([shown[:, :count], np.zeros((len(outputs), len(sinks)))])
    for k, j in zip(*np.nonzero(shown[:, count:]), strict=True):
        full[k, count + int(np.argmax(driven[:, count + j]))] = 1.0
    return Sketch(
        name, tuple(boxes), driven[:, :count], driven[:, count:], full, tuple(inputs), tuple(outputs)
    )


@dataclass(frozen=True, eq=False)
class Part:
    """A terminal, a block, or a sum or gain that is on the wires alone (``name`` is then empty).

    Parameters
    ----------
    name : str
    symbol : Symbol
    inputs, outputs : tuple of Pin
    inner : Scheme, optional
        Of a diagram that is opened.
    silent : bool
        Whether a terminal at a frame's border goes unnamed, since a port at the other end of its wire has its name.
    """

    name: str
    symbol: Symbol
    inputs: tuple[Pin, ...] = ()
    outputs: tuple[Pin, ...] = ()
    inner: Scheme | None = None
    silent: bool = False

    @property
    def kind(self) -> str:
        return self.symbol.kind


@dataclass(frozen=True, eq=False)
class Scheme:
    """One level of a diagram.

    Parameters
    ----------
    parts : tuple of Part
        Inputs, blocks in the system's order, outputs, then sums and gains on wires.
    edges : tuple of Edge
    cuts : (set, set)
        Where vectors at the border of the level begin: inputs, outputs.
    """

    parts: tuple[Part, ...]
    edges: tuple[Edge, ...]
    cuts: Cuts = (frozenset(), frozenset())


def read(system: Any, depth: int = 0, path: str = "", cuts: Cuts = (frozenset(), frozenset())) -> Scheme:
    """Parts and wires of one level; diagrams inside are opened as deep as said.

    Parameters
    ----------
    system : control.InputOutputSystem or Sketch
    depth : int
        How many levels of diagrams inside are opened.
    path : str
        Of the system, with a dot behind it; "" of the outermost.
    cuts : (set, set)
        Where vectors are cut outside: inputs, outputs.

    Returns
    -------
    Scheme
    """
    import control as ct

    opened = isinstance(system, ct.InterconnectedSystem | Sketch)
    level = _level_of(system) if opened else _alone(system)
    rows, columns = level.starts(system, cuts)
    inner: dict[int, Scheme] = {}
    while True:
        before = len(rows) + len(columns)
        bundles, more_rows, more_columns = _bundles(level.matrix, sorted(rows), sorted(columns))
        rows, columns = rows | more_rows, columns | more_columns
        if depth and opened and len(rows) + len(columns) == before:
            for k, part in enumerate(level.parts):
                if isinstance(part, ct.InterconnectedSystem):  # the same ports inside and outside
                    (i0, i1), (o0, o1) = level.spans[k]
                    outside = _within(rows, i0, i1), _within(columns, o0, o1)
                    inner[k] = read(part, depth - 1, f"{path}{part.name}.", outside)
                    rows = rows | {i0 + c for c in inner[k].cuts[0]}
                    columns = columns | {o0 + c for c in inner[k].cuts[1]}
        if len(rows) + len(columns) == before:
            return _scheme(level, system, path, sorted(rows), sorted(columns), bundles, inner)


def _within(starts: set[int], low: int, high: int) -> frozenset[int]:
    return frozenset(c - low for c in starts if low <= c < high)


@dataclass(frozen=True, eq=False)
class _Level:
    """Signals of one level by number.

    Rows of the matrix are inputs of blocks, then outputs of the level; columns are outputs of blocks, then inputs.
    """

    parts: tuple[Any, ...]
    spans: tuple[tuple[tuple[int, int], tuple[int, int]], ...]  # of each part: its inputs, its outputs
    matrix: FloatArray

    @property
    def border(self) -> tuple[int, int]:
        """First row that is an output of the level, first column that is an input."""
        return (self.spans[-1][0][1], self.spans[-1][1][1]) if self.spans else (0, 0)

    def starts(self, system: Any, cuts: Cuts) -> tuple[set[int], set[int]]:
        row, column = self.border
        rows = {row + k for k in vector_starts(system.output_labels) | cuts[1]}
        columns = {column + k for k in vector_starts(system.input_labels) | cuts[0]}
        for part, ((i, _), (o, _)) in zip(self.parts, self.spans, strict=True):
            rows |= {i + k for k in vector_starts(part.input_labels)}
            columns |= {o + k for k in vector_starts(part.output_labels)}
        return rows, columns


def _level_of(diagram: Any) -> _Level:
    spans, i, o = [], 0, 0
    for part in diagram.syslist:
        spans.append(((i, i + part.ninputs), (o, o + part.noutputs)))
        i, o = i + part.ninputs, o + part.noutputs
    driven = np.hstack([np.asarray(diagram.connect_map, float), np.asarray(diagram.input_map, float)])
    shown = np.asarray(diagram.output_map, float)
    outer = np.zeros((diagram.noutputs, driven.shape[1]))
    outer[:, :o] = shown[:, :o]
    if shown.shape[1] > o:  # an output may show an input of a block: what drives that
        outer += shown[:, o : o + i] @ driven
    return _Level(tuple(diagram.syslist), tuple(spans), np.vstack([driven, outer]))


def _alone(system: Any) -> _Level:
    """One block, all its signals led out."""
    i, o = system.ninputs, system.noutputs
    matrix = np.zeros((i + o, o + i))
    matrix[:i, o:], matrix[i:, :o] = np.eye(i), np.eye(o)
    return _Level((system,), (((0, i), (0, o)),), matrix)


Bundles = dict[tuple[int, int], float]


def _bundles(
    matrix: FloatArray, rows: Sequence[int], columns: Sequence[int]
) -> tuple[Bundles, set[int], set[int]]:
    """Vectors that are joined, (first row, first column) -> gain; and where to cut those that are not joined whole."""
    sizes = _sizes(rows, matrix.shape[0]), _sizes(columns, matrix.shape[1])
    r, c = np.nonzero(matrix)
    above = np.asarray(rows, int)[np.searchsorted(rows, r, "right") - 1]
    before = np.asarray(columns, int)[np.searchsorted(columns, c, "right") - 1]
    entries: dict[tuple[int, int], list[tuple[int, int, float]]] = {}
    gains = matrix[r, c].tolist()
    for a, b, i, j, gain in zip(above.tolist(), before.tolist(), r.tolist(), c.tolist(), gains, strict=True):
        entries.setdefault((a, b), []).append((i, j, gain))
    found: Bundles = {}
    cut_rows, cut_columns = set[int](), set[int]()
    for (a, b), some in entries.items():
        diagonal = all(i - a == j - b and gain == some[0][2] for i, j, gain in some)
        if diagonal and len(some) == sizes[0][a] == sizes[1][b]:
            found[a, b] = some[0][2]
            continue
        for k, (i, j, gain) in enumerate(some):
            if k == 0 or some[k - 1] != (i - 1, j - 1, gain):
                cut_rows.add(i)
                cut_columns.add(j)
            if k + 1 == len(some) or some[k + 1] != (i + 1, j + 1, gain):
                cut_rows.add(i + 1)
                cut_columns.add(j + 1)
    return found, cut_rows & set(range(matrix.shape[0])), cut_columns & set(range(matrix.shape[1]))


def _sizes(starts: Sequence[int], end: int) -> dict[int, int]:
    return {a: b - a for a, b in zip(starts, [*starts[1:], end], strict=True)}


def _scheme(
    level: _Level,
    system: Any,
    path: str,
    rows: Sequence[int],
    columns: Sequence[int],
    bundles: Bundles,
    inner: Mapping[int, Scheme],
) -> Scheme:
    """Parts and edges, sums and gains on the wires among them."""
    row_sizes, column_sizes = _sizes(rows, level.matrix.shape[0]), _sizes(columns, level.matrix.shape[1])
    row, column = level.border
    parts: list[Part] = []
    edges: list[Edge] = []
    sources, targets = dict[int, tuple[int, int]](), dict[int, tuple[int, int]]()

    def pins(
        labels: Sequence[str],
        first: int,
        sizes: Mapping[int, int],
        full: Sequence[str],
        units: Sequence[str] = (),
    ) -> list[tuple[int, Pin]]:
        """Vectors among the signals of a part that begin at a row or column, by their first one."""
        starts = [s for s in sizes if first <= s < first + len(labels)]
        bases = [base_and_index(label)[0] for label in labels]
        found = []
        for s in starts:
            k, size = s - first, sizes[s]
            base = bases[k]
            inside = [i for i, other in enumerate(bases) if other == base]
            name = base if len(inside) == size else labels[k]
            if 1 < size < len(inside):
                name = f"{base}[{k - inside[0]}:{k - inside[0] + size}]"
            unit = common_unit(units[k : k + size])
            found.append(
                (s, Pin(name, tuple(labels[k : k + size]), tuple(full[k : k + size]), size, unit=unit))
            )
        return found

    for s, pin in pins(system.input_labels, column, column_sizes, system.input_labels):
        sources[s] = len(parts), 0
        parts.append(Part(pin.labels[0], Symbol("input"), outputs=(pin,)))
    for k, part in enumerate(level.parts):
        (i, _), (o, _) = level.spans[k]
        named = [f"{path}{part.name}.{label}" for label in part.input_labels]
        ins = pins(part.input_labels, i, row_sizes, named, units_of(part, "in"))
        drivers = _drivers(part, f"{path}{part.name}")
        outs = pins(part.output_labels, o, column_sizes, drivers, units_of(part, "out"))
        symbol = Symbol("frame") if k in inner else symbol_of(part, [p for _, p in ins], [p for _, p in outs])
        sources |= {s: (len(parts), n) for n, (s, _) in enumerate(outs)}
        targets |= {s: (len(parts), n) for n, (s, _) in enumerate(ins)}
        signs = symbol.signs or (1,) * len(ins)
        taken = tuple(pin._replace(sign=sign) for (_, pin), sign in zip(ins, signs, strict=True))
        parts.append(Part(part.name or "", symbol, taken, tuple(pin for _, pin in outs), inner.get(k)))
    for s, pin in pins(system.output_labels, row, row_sizes, system.output_labels):
        targets[s] = len(parts), 0
        parts.append(Part(pin.labels[0], Symbol("output"), inputs=(pin,)))

    made: dict[object, int] = {}

    def gain(start: int, factor: float) -> tuple[int, int]:
        if (start, factor) not in made:
            made[start, factor] = len(parts)
            size = column_sizes[start]
            parts.append(Part("", gain_symbol(factor), (Pin("u", (), (), size),), (Pin("y", (), (), size),)))
            edges.append(Edge(*sources[start], made[start, factor], 0))
        return made[start, factor], 0

    def driver(start: int, reader: Pin) -> tuple[int, int] | None:
        """What gives a row: an output, a gain of one, or the sum of several."""
        terms = sorted(
            ((s, g) for (r, s), g in bundles.items() if r == start), key=lambda t: (t[0] < column, t[0])
        )
        if not terms:
            return None
        if len(terms) == 1:
            return sources[terms[0][0]] if terms[0][1] == 1.0 else gain(*terms[0])
        key = tuple(terms)
        if key not in made:
            made[key] = len(parts)
            ins = tuple(
                Pin(str(n), (), (), reader.size, 1 if g > 0 else -1) for n, (_, g) in enumerate(terms)
            )
            parts.append(Part("", Symbol("sum"), ins, (Pin("y", (), reader.signals, reader.size),)))
            edges.extend(
                Edge(*(sources[s] if abs(g) == 1.0 else gain(s, abs(g))), made[key], n)
                for n, (s, g) in enumerate(terms)
            )
        return made[key], 0

    for s, (target, n) in targets.items():
        found = driver(s, parts[target].inputs[n])
        if found is not None:
            edges.append(Edge(*found, target, n))
    cuts = (
        _within(set(columns), column, level.matrix.shape[1]),
        _within(set(rows), row, level.matrix.shape[0]),
    )
    return Scheme(tuple(_with_units(parts, edges)), tuple(edges), cuts)


def _with_units(parts: Sequence[Part], edges: Sequence[Edge]) -> list[Part]:
    """With the units of outputs that have none: that of all that read them and know theirs."""
    readers: dict[tuple[int, int], set[str]] = {}
    for e in edges:
        readers.setdefault((e.source, e.output), set()).add(parts[e.target].inputs[e.input].unit)
    return [
        replace(
            part,
            outputs=tuple(
                pin if pin.unit else pin._replace(unit=common_unit(readers.get((k, n), set()) - {""}))
                for n, pin in enumerate(part.outputs)
            ),
        )
        for k, part in enumerate(parts)
    ]


def _drivers(part: Any, path: str) -> list[str]:
    """Full names of what drives the outputs of a part: of a diagram, the blocks inside."""
    import control as ct

    if not isinstance(part, ct.InterconnectedSystem):
        return [f"{path}.{label}" for label in part.output_labels]
    names = [name for inside in part.syslist for name in _drivers(inside, f"{path}.{inside.name}")]
    shown = np.asarray(part.output_map, float)[:, : len(names)]
    return [
        names[int(np.flatnonzero(row)[0])] if np.count_nonzero(row) == 1 else f"{path}.{label}"
        for row, label in zip(shown, part.output_labels, strict=True)
    ]
