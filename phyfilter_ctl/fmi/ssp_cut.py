"""A python-control diagram cut into parts along the boundaries of its blocks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import control as ct
import numpy as np

from .cosimulation_wiring import Wire
from .system import System

__all__ = ["cut_diagram"]


@dataclass
class _Piece:
    """One part while it is being cut out."""

    name: str
    blocks: list[int]
    rows: list[int]
    columns: list[int]
    inputs: dict[tuple[str, int], str] = field(default_factory=dict)  # kind and place of the source -> label
    input_weights: dict[str, dict[int, float]] = field(default_factory=dict)  # label -> row -> weight
    outputs: dict[int | str, str] = field(
        default_factory=dict
    )  # column, or output of the diagram -> its label
    output_weights: dict[str, np.ndarray] = field(default_factory=dict)

    def unique(self, label: str) -> str:
        taken = {*self.input_weights, *self.output_weights}
        candidates = [label, *(f"{label}_{k}" for k in range(2, len(taken) + 3))]
        return next(name for name in candidates if name not in taken)


def cut_diagram(system: ct.InterconnectedSystem, split: Mapping[str, Sequence[str]] | None = None) -> System:
    """Cut a diagram into parts; :func:`cosimulate` runs them as they are.

    Parameters
    ----------
    system : control.InterconnectedSystem
    split : dict of str to sequence of str, optional
        Blocks of each part, by name; every block of the diagram in one of them. Each block a part by default.

    Returns
    -------
    System
        Parts of the kind ``control.InterconnectedSystem``, wires of gain one from one output to one input (sums and
        gains of the diagram are inside the parts), and the diagram's inputs and outputs by their names.

    Raises
    ------
    TypeError
        If the system is no interconnection.
    ValueError
        If a block is missing, unknown or named twice; if an output of the diagram sums signals of several parts.
    """
    if not isinstance(system, ct.InterconnectedSystem):
        raise TypeError(
            f"system: expected an interconnected system (ct.interconnect), got {type(system).__name__}"
        )
    cutter = _Cutter(system, split)
    wires, inputs = cutter.inputs()
    outputs = cutter.outputs()
    parts = {piece.name: cutter.built(piece) for piece in cutter.pieces}
    return System(parts, tuple(wires), inputs=inputs, outputs=outputs)


class _Cutter:
    def __init__(self, system: ct.InterconnectedSystem, split: Mapping[str, Sequence[str]] | None) -> None:
        self.system = system
        self.blocks = list(system.syslist)
        self.names = {index: name for name, index in system.syslist_index.items()}
        # ct.TransferFunction and others have become StateSpace by now; offsets are python-control's own.
        self.rows = [
            list(range(o, o + b.ninputs)) for o, b in zip(system.input_offset, self.blocks, strict=True)
        ]
        self.columns = [
            list(range(o, o + b.noutputs)) for o, b in zip(system.output_offset, self.blocks, strict=True)
        ]
        self.pieces = self._pieces(split)
        self.piece_of_row = {row: piece for piece in self.pieces for row in piece.rows}
        self.piece_of_column = {column: piece for piece in self.pieces for column in piece.columns}

    def _pieces(self, split: Mapping[str, Sequence[str]] | None) -> list[_Piece]:
        index = {name: k for k, name in self.names.items()}
        chosen = split if split is not None else {name: [name] for name in index}
        seen: dict[str, str] = {}
        for part, members in chosen.items():
            if isinstance(members, str) or not members:
                raise ValueError(f"split: {part!r}: expected a list of block names, got {members!r}")
            for block in members:
                if block not in index:
                    raise ValueError(
                        f"split: {part!r} names {block!r}; the diagram has the blocks {sorted(index)}"
                    )
                if block in seen:
                    raise ValueError(
                        f"split: {block!r} is in {seen[block]!r} and in {part!r}; expected one part"
                    )
                seen[block] = part
        missing = sorted(set(index) - set(seen))
        if missing:
            raise ValueError(f"split: no part holds {', '.join(missing)}; expected every block in one part")
        return [
            _Piece(
                part,
                places := [index[block] for block in members],
                [row for place in places for row in self.rows[place]],
                [column for place in places for column in self.columns[place]],
            )
            for part, members in chosen.items()
        ]

    def _label(self, piece: _Piece, place: int, signal: str) -> str:
        """A block alone keeps its signal names; among others they get its name in front (no dot: python-control)."""
        return signal if len(piece.blocks) == 1 else f"{self.names[place]}_{signal}"

    def _row_label(self, row: int) -> tuple[int, str]:
        place = next(k for k, rows in enumerate(self.rows) if row in rows)
        return place, self.blocks[place].input_labels[row - self.rows[place][0]]

    def _column_label(self, column: int) -> tuple[int, str]:
        place = next(k for k, columns in enumerate(self.columns) if column in columns)
        return place, self.blocks[place].output_labels[column - self.columns[place][0]]

    def inputs(self) -> tuple[list[Wire], dict[str, tuple[str, ...]]]:
        """Give every part its inputs, and the outputs that other parts need."""
        for piece in self.pieces:
            feeds = {row: self._outside(piece, row) for row in piece.rows}
            uses = Counter(source for sources in feeds.values() for source in sources)
            for row, sources in feeds.items():
                alone = len(sources) == 1 and not np.any(self.system.connect_map[row, piece.columns])
                for source, weight in sources.items():
                    self._feed(
                        piece, row, source, weight, plain=alone and weight == 1.0 and uses[source] == 1
                    )
        wires: list[Wire] = []
        system = self.system
        inputs: dict[str, list[str]] = {label: [] for label in system.input_labels}
        for piece in self.pieces:
            for (kind, place), label in piece.inputs.items():
                sink = f"{piece.name}.{label}"
                if kind == "system":
                    inputs[system.input_labels[place]].append(sink)
                else:
                    wires.append(Wire(sink, self._source(place)))
        return wires, {label: tuple(sinks) for label, sinks in inputs.items()}

    def _outside(self, piece: _Piece, row: int) -> dict[tuple[str, int], float]:
        """What drives an input from outside its part: (kind, place) of the source and its weight."""
        blocks = self.system.connect_map[row].copy()
        blocks[piece.columns] = 0.0
        own = self.system.input_map[row]
        return {("block", int(j)): float(blocks[j]) for j in np.flatnonzero(blocks)} | {
            ("system", int(k)): float(own[k]) for k in np.flatnonzero(own)
        }

    def _feed(self, piece: _Piece, row: int, source: tuple[str, int], weight: float, *, plain: bool) -> None:
        """One connector per signal from outside; its weight stays inside the part.

        An input with one plain source is named as the block names it, any other connector as its source.
        """
        kind, place = source
        if source not in piece.inputs:
            if plain:
                label = self._label(piece, *self._row_label(row))
            elif kind == "system":
                label = self.system.input_labels[place]
            else:
                owner, signal = self._column_label(place)
                label = f"{self.names[owner]}_{signal}"
            piece.inputs[source] = piece.unique(label)
            piece.input_weights[piece.inputs[source]] = {}
        piece.input_weights[piece.inputs[source]][row] = weight

    def _source(self, column: int) -> str:
        piece = self.piece_of_column[column]
        if column not in piece.outputs:
            weights = np.zeros(len(piece.columns) + len(piece.rows))
            weights[piece.columns.index(column)] = 1.0
            label = piece.unique(self._label(piece, *self._column_label(column)))
            piece.outputs[column], piece.output_weights[label] = label, weights
        return f"{piece.name}.{piece.outputs[column]}"

    def outputs(self) -> dict[str, str]:
        """Outputs of the diagram, from the part that has their signals."""
        system = self.system
        total = system.connect_map.shape[1]
        result: dict[str, str] = {}
        for k, name in enumerate(system.output_labels):
            weights = {int(j): float(system.output_map[k, j]) for j in np.flatnonzero(system.output_map[k])}
            if len(weights) == 1 and next(iter(weights)) < total and next(iter(weights.values())) == 1.0:
                result[name] = self._source(next(iter(weights)))
                continue
            owners = [
                self.piece_of_column[j] if j < total else self.piece_of_row[j - total] for j in weights
            ] or self.pieces[:1]
            if any(owner is not owners[0] for owner in owners):
                raise ValueError(
                    f"output {name!r} sums signals of the parts {sorted({owner.name for owner in owners})}; expected "
                    "one: add a summing block to the diagram and name it in the split"
                )
            piece = owners[0]
            row = np.zeros(len(piece.columns) + len(piece.rows))
            for j, weight in weights.items():
                at = piece.columns.index(j) if j < total else len(piece.columns) + piece.rows.index(j - total)
                row[at] = weight
            label = piece.unique(name)
            piece.outputs[name], piece.output_weights[label] = label, row
            result[name] = f"{piece.name}.{label}"
        return result

    def built(self, piece: _Piece) -> ct.InterconnectedSystem:
        if not piece.output_weights:  # nobody needs it: show what it has
            for column in piece.columns:
                self._source(column)
        blocks = [self.blocks[k] for k in piece.blocks]
        known = {key for block in blocks for key in getattr(block, "params", {})}
        part = ct.InterconnectedSystem(
            blocks,
            inputs=list(piece.input_weights),
            outputs=list(piece.output_weights),
            name=piece.name,
            params={key: value for key, value in self.system.params.items() if key in known},
            warn_duplicate=False,
        )
        part.set_connect_map(self.system.connect_map[np.ix_(piece.rows, piece.columns)])
        feed = np.zeros((len(piece.rows), len(piece.input_weights)))
        for j, weights in enumerate(piece.input_weights.values()):
            for row, weight in weights.items():
                feed[piece.rows.index(row), j] = weight
        part.set_input_map(feed)
        part.set_output_map(np.array(list(piece.output_weights.values())))
        return part
