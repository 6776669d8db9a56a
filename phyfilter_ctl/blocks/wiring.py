"""Wiring by vectors: one line a vector where ``control.interconnect`` wants one an entry."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NoReturn

import control as ct

__all__ = ["signal_names", "wired"]


def wired(
    systems: Sequence[ct.InputOutputSystem],
    wires: Mapping[str, str],
    *,
    inputs: Mapping[str, str | Sequence[str]] | Sequence[str] = (),
    outputs: Mapping[str, str] | Sequence[str] = (),
    name: str | None = None,
) -> ct.InterconnectedSystem:
    """A python-control diagram from one dictionary of signals and of wires between whole vectors.

    Parameters
    ----------
    systems : sequence of control.InputOutputSystem
        With different names.
    wires : mapping
        A signal: "name" -> "block.output". It drives every input of another block that has this name and no wire of
        its own. Or a wire: "block.input" -> the name of a signal, or "block.output". ``a.v`` stands for all of v[0],
        v[1], ... or for one signal v. An input that is left out is driven by nothing: it takes its default where it is
        optional; else python-control takes 0 for it, and :func:`phyfilter_ctl.flatten` names it and refuses.
    inputs : mapping or sequence of str
        Inputs of the diagram: name -> block input, or several that it drives; or names alone, each of which drives all
        inputs of blocks that have its name and no wire.
    outputs : mapping or sequence of str
        Outputs of the diagram: name -> signal or block output; or names of signals alone.
    name : str, optional
        Name of the diagram.

    Returns
    -------
    control.InterconnectedSystem
        Made by ``control.interconnect``; inputs and outputs called name, or name[0], name[1], ...

    Raises
    ------
    ValueError
        For blocks and signals that do not exist, vectors of different lengths, an input that is driven twice, or a
        signal that drives nothing and is no output; the message has names close to it.

    Examples
    --------
    >>> from phyfilter_ctl.plants import mass
    >>> lead, follower = mass(2, name="lead"), mass(2, name="follower")
    >>> pair = wired([lead, follower], {"follower.force": "lead.v"}, inputs={"push": "lead.force"},
    ...              outputs={"place": "follower.r"})
    >>> pair.input_labels, pair.output_labels
    (['push[0]', 'push[1]'], ['place[0]', 'place[1]'])

    The same force on both, and their velocities as signals:

    >>> both = wired([lead, follower], {"v": "lead.v", "w": "follower.v"}, inputs=["force"], outputs=["v", "w"])
    >>> both.input_labels, both.output_labels
    (['force[0]', 'force[1]'], ['v[0]', 'v[1]', 'w[0]', 'w[1]'])
    """
    blocks = {system.name: system for system in systems}
    if len(blocks) != len(systems):
        raise ValueError(f"systems: expected different names, got {[system.name for system in systems]}")
    for what, given in (("inputs", inputs), ("outputs", outputs)):
        if isinstance(given, str):
            raise TypeError(f"{what}: expected a mapping or a sequence of names, got the text {given!r}")
    diagram = _Diagram(blocks, {key: source for key, source in wires.items() if "." not in key})
    for sink, source in wires.items():
        if "." in sink:
            diagram.wire(sink, diagram.source(source, sink))
    named = {} if isinstance(inputs, Mapping) else dict.fromkeys(inputs)
    for label, targets in (inputs if isinstance(inputs, Mapping) else {}).items():
        diagram.enter(label, [targets] if isinstance(targets, str) else targets)
    for label in named:
        if label in diagram.signals:
            raise ValueError(f"{label!r} is a signal and an input of the diagram: rename one of them")
        diagram.enter(label, diagram.takers(label) or [diagram.unknown_input(label)])
    shown = outputs if isinstance(outputs, Mapping) else {label: label for label in outputs}
    sources = {label: diagram.source(source, f"output {label!r}") for label, source in shown.items()}
    diagram.connect_by_name()
    out_list, out_names = [], []
    for label, source in sources.items():
        entries = _signals(blocks, source, "output")
        out_list += entries
        out_names += _names(label, len(entries))
    return ct.interconnect(
        list(systems),
        connections=diagram.connections or False,  # it takes an empty list for a broken one
        inplist=diagram.in_list,
        inputs=diagram.in_names,
        outlist=out_list,
        outputs=out_names,
        name=name,
        check_unused=False,
    )


class _Diagram:
    """Wires and inputs of a diagram while they are put together."""

    def __init__(self, blocks: Mapping[str, ct.InputOutputSystem], signals: Mapping[str, str]) -> None:
        self.blocks = blocks
        self.signals = signals
        self.connections: list[list[str]] = []
        self.in_list: list[list[str]] = []
        self.in_names: list[str] = []
        self._driven: dict[str, str] = {}
        self._used: set[str] = set()
        for label, source in signals.items():
            if "." not in source:
                raise ValueError(
                    f"signal {label!r}: expected 'block.output' for where it comes from, got {source!r}"
                )

    def source(self, name: str, where: str) -> str:
        """The output of a block that a signal is."""
        if "." in name:
            return name
        if name not in self.signals:
            raise ValueError(f"{where}: no signal {name!r}{_near(name, list(self.signals))}")
        self._used.add(name)
        return self.signals[name]

    def wire(self, sink: str, source: str) -> None:
        sinks, sources = _signals(self.blocks, sink, "input"), _signals(self.blocks, source, "output")
        if len(sinks) != len(sources):
            raise ValueError(f"{sink} has {len(sinks)} entries, but {source} has {len(sources)}")
        self._drive(sinks, source)
        self.connections += [list(pair) for pair in zip(sinks, sources, strict=True)]

    def enter(self, label: str, targets: Sequence[str]) -> None:
        groups = [_signals(self.blocks, target, "input") for target in targets]
        if len({len(group) for group in groups}) != 1:
            raise ValueError(f"input {label!r}: expected targets of one length, got {[*map(len, groups)]}")
        for group in groups:
            self._drive(group, f"input {label!r}")
        self.in_list += [list(entry) for entry in zip(*groups, strict=True)]
        self.in_names += _names(label, len(groups[0]))

    def takers(self, label: str, without: str = "") -> list[str]:
        """Inputs of blocks of that name which have no wire."""
        return [sink for sink in self._open(without) if sink.partition(".")[2] == label]

    def connect_by_name(self) -> None:
        for label, source in self.signals.items():
            takers = self.takers(label, source.partition(".")[0])
            for sink in takers:
                self.wire(sink, source)
            if not takers and label not in self._used:
                _signals(self.blocks, source, "output")
                raise ValueError(
                    f"signal {label!r} ({source}) drives nothing and is no output: no input of another block without a "
                    f"wire has this name{self._near_input(label)}"
                )

    def unknown_input(self, label: str) -> NoReturn:
        raise ValueError(
            f"input {label!r}: no input of a block without a wire has this name{self._near_input(label)}"
        )

    def _near_input(self, label: str) -> str:
        return _near(
            label, signal_names(entry for block in self.blocks.values() for entry in block.input_labels)
        )

    def _open(self, without: str = "") -> list[str]:
        return [
            f"{block}.{base}"
            for block, system in self.blocks.items()
            if block != without
            for base in signal_names(system.input_labels)
            if any(entry not in self._driven for entry in _signals(self.blocks, f"{block}.{base}", "input"))
        ]

    def _drive(self, sinks: Sequence[str], source: str) -> None:
        for sink in sinks:
            if sink in self._driven:
                raise ValueError(
                    f"{sink} is driven twice: by {self._driven[sink]} and by {source}; add the two in a block"
                )
            self._driven[sink] = source


def signal_names(labels: Iterable[str]) -> list[str]:
    """Signals that entries belong to, in their order: ``v[0]``, ``v[1]`` and ``J[0,1]`` are of v and J.

    Parameters
    ----------
    labels : iterable of str

    Examples
    --------
    >>> signal_names(["r[0]", "r[1]", "taken", "J[0,1]"])
    ['r', 'taken', 'J']
    """
    return list(dict.fromkeys(re.sub(r"\[[\d,]+\]$", "", label) for label in labels))


def _signals(blocks: Mapping[str, ct.InputOutputSystem], signal: str, kind: str) -> list[str]:
    """Full names of the entries of a signal."""
    block, _, base = signal.partition(".")
    if block not in blocks:
        raise ValueError(f"{signal}: no block {block!r}{_near(block, list(blocks))}")
    system = blocks[block]
    labels = system.input_labels if kind == "input" else system.output_labels
    found = [label for label in labels if label == base or re.sub(r"\[[\d,]+\]$", "", label) == base]
    if not found:
        raise ValueError(
            f"{signal}: block {block!r} has no {kind} {base!r}{_near(base, signal_names(labels))}"
        )
    return [f"{block}.{label}" for label in found]


def _near(name: str, names: Sequence[str]) -> str:
    close = difflib.get_close_matches(name, names, 1)
    return f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(names) or 'none'}"


def _names(label: str, count: int) -> list[str]:
    return [label] if count == 1 else [f"{label}[{i}]" for i in range(count)]
