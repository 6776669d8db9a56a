"""Wiring by vectors: one line a vector where ``control.interconnect`` wants one an entry."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence

import control as ct

__all__ = ["signal_names", "wired"]


def wired(
    systems: Sequence[ct.InputOutputSystem],
    wires: Mapping[str, str],
    *,
    inputs: Mapping[str, str | Sequence[str]] | None = None,
    outputs: Mapping[str, str] | None = None,
    name: str | None = None,
) -> ct.InterconnectedSystem:
    """A python-control diagram from wires between whole signals.

    Parameters
    ----------
    systems : sequence of control.InputOutputSystem
        With different names.
    wires : mapping
        "block.input" -> "block.output" that drives it; ``a.v`` stands for all of v[0], v[1], ... or for one signal v.
        An input that is left out is driven by nothing: python-control takes 0 for it, :func:`phyfilter_ctl.flatten`
        names it and refuses.
    inputs : mapping, optional
        Inputs of the diagram: name -> block input, or several that it drives.
    outputs : mapping, optional
        Outputs of the diagram: name -> block output.
    name : str, optional
        Name of the diagram.

    Returns
    -------
    control.InterconnectedSystem
        Made by ``control.interconnect``; inputs and outputs called name, or name[0], name[1], ...

    Raises
    ------
    ValueError
        For blocks and signals that do not exist, vectors of different lengths, or an input that is driven twice.

    Examples
    --------
    >>> from phyfilter_ctl.plants import mass
    >>> lead, follower = mass(2, name="lead"), mass(2, name="follower")
    >>> pair = wired([lead, follower], {"follower.force": "lead.v"}, inputs={"push": "lead.force"},
    ...              outputs={"place": "follower.r"})
    >>> pair.input_labels, pair.output_labels
    (['push[0]', 'push[1]'], ['place[0]', 'place[1]'])
    """
    blocks = {system.name: system for system in systems}
    if len(blocks) != len(systems):
        raise ValueError(f"systems: expected different names, got {[system.name for system in systems]}")
    driven: dict[str, str] = {}
    connections = []
    for sink, source in wires.items():
        sinks, sources = _signals(blocks, sink, "input"), _signals(blocks, source, "output")
        if len(sinks) != len(sources):
            raise ValueError(f"{sink} has {len(sinks)} entries, but {source} has {len(sources)}")
        _drive(driven, sinks, source)
        connections += [list(pair) for pair in zip(sinks, sources, strict=True)]
    in_list, in_names = [], []
    for label, targets in (inputs or {}).items():
        groups = [_signals(blocks, t, "input") for t in ([targets] if isinstance(targets, str) else targets)]
        if len({len(group) for group in groups}) != 1:
            raise ValueError(f"input {label!r}: expected targets of one length, got {[*map(len, groups)]}")
        for group in groups:
            _drive(driven, group, f"input {label!r}")
        in_list += [list(entry) for entry in zip(*groups, strict=True)]
        in_names += _names(label, len(groups[0]))
    out_list, out_names = [], []
    for label, source in (outputs or {}).items():
        sources = _signals(blocks, source, "output")
        out_list += sources
        out_names += _names(label, len(sources))
    return ct.interconnect(
        list(systems),
        connections=connections or False,  # it takes an empty list for a broken one
        inplist=in_list,
        inputs=in_names,
        outlist=out_list,
        outputs=out_names,
        name=name,
        check_unused=False,
    )


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
    return f"; did you mean {close[0]!r}?" if close else f"; there are {', '.join(names)}"


def _drive(driven: dict[str, str], sinks: Sequence[str], source: str) -> None:
    for sink in sinks:
        if sink in driven:
            raise ValueError(
                f"{sink} is driven twice: by {driven[sink]} and by {source}; add the two in a block"
            )
        driven[sink] = source


def _names(label: str, count: int) -> list[str]:
    return [label] if count == 1 else [f"{label}[{i}]" for i in range(count)]
