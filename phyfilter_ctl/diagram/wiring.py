"""A tree of python-control diagrams as one graph of scalar signals."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal, NamedTuple

import control as ct
import numpy as np

from ..blocks.continuous import forward_difference
from ..blocks.functions import BlockFunctions, Variable
from ..blocks.sampled import FilterLaw, SampledBlock
from .copies import copy_key
from .leaves import block_functions, linear_functions, with_values

__all__ = ["Block", "Rules", "Wiring", "input_variables", "output_variables", "wire"]

Unconnected = Literal["error", "zero"]
# Share of letters in common from which two names may be one misspelt.
_ALIKE = 0.75


@dataclass(frozen=True, eq=False)
class Block:
    """A block of the flat diagram and its signals, by number.

    Parameters
    ----------
    path : str
        Name below the outermost diagram, parts joined by ".".
    functions : BlockFunctions
        Its equations; the law of a sampled block.
    inputs, outputs : range
        Its signals.
    period : float
        0 for a block of the diagram's own time base, else seconds between the instants of a sampled block.
    filter : FilterLaw, optional
        What the law of a sampled block is made from.
    continuous : BlockFunctions, optional
        Continuous equivalent of a sampled block.
    """

    path: str
    functions: BlockFunctions
    inputs: range
    outputs: range
    period: float = 0.0
    filter: FilterLaw | None = None
    continuous: BlockFunctions | None = None


@dataclass(eq=False)
class Wiring:
    """Scalar signals: sums of others, outputs of blocks, or the diagram's inputs.

    Parameters
    ----------
    names : list of str
        Of all signals, ``block.signal``.
    sums : dict
        Of a signal that is a sum: (signal, gain) of its terms.
    producers : dict
        Of a signal that is a block's output: (block, output).
    blocks : list of Block
    inputs, outputs : list of int
        Signals at the border of the diagram.
    traced : dict
        Functions of blocks by :func:`copy_key`.
    starts : dict
        Values of signals that nothing drives and that are not 0 for that.
    undriven : list of str
        Inputs of blocks that nothing drives, those of diagrams in sampled blocks among them.
    """

    names: list[str] = field(default_factory=list)
    sums: dict[int, list[tuple[int, float]]] = field(default_factory=dict)
    producers: dict[int, tuple[int, int]] = field(default_factory=dict)
    blocks: list[Block] = field(default_factory=list)
    inputs: Sequence[int] = ()
    outputs: Sequence[int] = ()
    traced: dict[tuple[object, ...], BlockFunctions] = field(default_factory=dict)
    starts: dict[int, float] = field(default_factory=dict)
    undriven: list[str] = field(default_factory=list)

    def dependencies(self) -> list[list[int]]:
        """Signals that each signal needs at the same moment."""
        needs: list[list[int]] = [[] for _ in self.names]
        for signal, terms in self.sums.items():
            needs[signal] = [term for term, _ in terms]
        for block in self.blocks:
            if block.period:
                continue
            for row, signal in zip(block.functions.feedthrough, block.outputs, strict=True):
                needs[signal] = [block.inputs[j] for j in np.flatnonzero(row)]
        return needs


class Rules(NamedTuple):
    """What holds for all diagrams of a tree.

    Attributes
    ----------
    unconnected : {"error", "zero"}
        What an input that nothing drives is.
    discrete : callable, optional
        (diagram, path, parameter values, these rules) -> law of the sampled block around that diagram, and the inputs
        in it that nothing drives.
    missing : mapping
        Values of parameters that blocks read and that have none.
    """

    unconnected: Unconnected
    discrete: (
        Callable[
            [ct.InputOutputSystem, str, Mapping[str, object], Rules], tuple[BlockFunctions, Sequence[str]]
        ]
        | None
    ) = None
    missing: Mapping[str, object] = MappingProxyType({})


def wire(system: ct.InputOutputSystem, given: Mapping[str, object], rules: Rules) -> Wiring:
    """All blocks of a diagram and the sums between them.

    Parameters
    ----------
    system : control.InputOutputSystem
        A diagram, or one block.
    given : mapping
        Parameter values from outside.
    rules : Rules

    Returns
    -------
    Wiring

    Raises
    ------
    TypeError, ValueError
        For blocks that cannot be taken, inputs that nothing drives or two outputs of one name do, and names that
        clash.

    Examples
    --------
    >>> wiring = wire(ct.tf([2.0], [1.0], name="gain"), {}, Rules("error"))
    >>> wiring.names, [block.path for block in wiring.blocks]
    (['gain.u[0]', 'gain.y[0]'], ['gain'])
    """
    wiring = Wiring()
    root = system.name or "system"
    if isinstance(system, ct.InterconnectedSystem):
        wiring.inputs = _new(wiring, [f"input {label}" for label in system.input_labels])
        wiring.outputs = _add_diagram(wiring, system, "", given, wiring.inputs, rules)
    else:
        block = _add_block(wiring, system, root, given, rules)
        wiring.inputs, wiring.outputs = block.inputs, block.outputs
        for signal in block.inputs:
            del wiring.sums[signal]
    _check_names([block.path for block in wiring.blocks], "blocks")
    slips = _keep_starts(wiring)
    if slips and rules.unconnected == "error":
        raise ValueError(slips)
    missing = _undriven(wiring)
    if missing and rules.unconnected == "error":
        raise ValueError(_what_to_type(wiring, missing))
    wiring.undriven += [wiring.names[signal] for signal in missing]
    return wiring


def _add_diagram(
    wiring: Wiring,
    diagram: ct.InterconnectedSystem,
    path: str,
    given: Mapping[str, object],
    inputs: Sequence[int],
    rules: Rules,
) -> list[int]:
    """Adds all blocks of a diagram whose inputs are the given signals; returns its output signals."""
    given = {**_explicit(diagram), **given}
    names = {index: name for name, index in diagram.syslist_index.items()}
    if len(names) < len(diagram.syslist):
        _check_names([part.name for part in diagram.syslist], f"blocks of diagram {path or diagram.name}")
    _check_single_drivers(diagram, path)
    block_inputs: list[int] = []
    block_outputs: list[int] = []
    for i, part in enumerate(diagram.syslist):
        place = f"{path}.{names[i]}" if path else names[i]
        if isinstance(part, ct.InterconnectedSystem):
            borders = _new(wiring, [f"{place}.{label}" for label in part.input_labels])
            for signal in borders:
                wiring.sums[signal] = []
            block_inputs += borders
            block_outputs += _add_diagram(wiring, part, place, given, borders, rules)
        else:
            block = _add_block(wiring, part, place, given, rules)
            block_inputs += block.inputs
            block_outputs += block.outputs
    for rows, columns, values, sources in (
        (*_entries(diagram.connect_map), block_outputs),
        (*_entries(diagram.input_map), inputs),
    ):
        for i, j, gain in zip(rows, columns, values, strict=True):
            wiring.sums[block_inputs[i]].append((sources[j], gain))
    outputs = _new(
        wiring, [f"{path}.{label}" if path else f"output {label}" for label in diagram.output_labels]
    )
    for signal in outputs:
        wiring.sums[signal] = []
    for i, j, gain in zip(*_entries(diagram.output_map), strict=True):
        wiring.sums[outputs[i]].append(((block_outputs + block_inputs)[j], gain))
    return list(outputs)


def _add_block(
    wiring: Wiring,
    system: object,
    path: str,
    given: Mapping[str, object],
    rules: Rules,
) -> Block:
    if isinstance(system, SampledBlock):
        period, filter_law = system.period, system.filter
        functions, undriven = _law(system, path, given, rules)
        wiring.undriven += [f"{path}.{name}" for name in undriven]
        continuous = _continuous(system, functions, path)
    else:
        period, filter_law, continuous = 0.0, None, None
        key = copy_key(system, given)
        functions = wiring.traced.get(key) if key is not None else None
        if functions is None:
            functions = block_functions(system, path, given, rules.missing)
            if key is not None and not functions.callbacks:
                wiring.traced[key] = functions
    inputs = _new(wiring, [f"{path}.{variable.name}" for variable in functions.inputs])
    outputs = _new(wiring, [f"{path}.{variable.name}" for variable in functions.outputs])
    for signal in inputs:
        wiring.sums[signal] = []
    for i, signal in enumerate(outputs):
        wiring.producers[signal] = (len(wiring.blocks), i)
    wiring.blocks.append(Block(path, functions, inputs, outputs, period, filter_law, continuous))
    return wiring.blocks[-1]


def _law(
    sampled: SampledBlock, path: str, given: Mapping[str, object], rules: Rules
) -> tuple[BlockFunctions, Sequence[str]]:
    if sampled.law is not None:
        return with_values(sampled.law, given), ()
    system = sampled.system
    if isinstance(system, ct.InterconnectedSystem):
        if rules.discrete is None:
            raise ValueError(f"block {path}: a diagram in a sampled block has to be flattened first")
        return rules.discrete(system, path, given, rules)
    return block_functions(system, path, given, rules.missing), ()


def _continuous(sampled: SampledBlock, law: BlockFunctions, path: str) -> BlockFunctions:
    try:
        continuous = sampled.continuous
    except ValueError:  # no continuous system has this law as its Tustin discretisation
        continuous = None
    if continuous is None:
        return forward_difference(law, sampled.period)
    return linear_functions(continuous, path) if isinstance(continuous, ct.StateSpace) else continuous


def _new(wiring: Wiring, names: Sequence[str]) -> range:
    first = len(wiring.names)
    wiring.names += names
    return range(first, len(wiring.names))


def _entries(matrix: object) -> tuple[list[int], list[int], list[float]]:
    array = np.asarray(matrix, dtype=float)
    rows, columns = np.nonzero(array)
    return rows.tolist(), columns.tolist(), array[rows, columns].tolist()


def _explicit(diagram: ct.InterconnectedSystem) -> dict[str, object]:
    """What the user set on the diagram; python-control fills in the last of its blocks' values where nothing was."""
    merged: dict[str, object] = {}
    for part in diagram.syslist:
        merged |= part.params
    own = dict(diagram.params)
    same = merged.keys() == own.keys() and all(_equal(merged[key], own[key]) for key in own)
    return {} if same else own


def _equal(first: object, second: object) -> bool:
    if first is second:
        return True
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return np.array_equal(np.asarray(first), np.asarray(second))
    return bool(first == second)


def _check_names(names: Sequence[str], what: str) -> None:
    twice = (
        sorted({name for name in names if list(names).count(name) > 1})
        if len(set(names)) < len(names)
        else []
    )
    if twice:
        raise ValueError(f"{what}: the names {', '.join(twice)} stand twice; give each block its own name=")


def _check_single_drivers(diagram: ct.InterconnectedSystem, path: str) -> None:
    """python-control adds up outputs of one name where it wires by name; that is nearly always a slip."""
    if diagram.connection_type != "implicit":
        return
    inputs = [(part.name, label) for part in diagram.syslist for label in part.input_labels]
    outputs = [(part.name, label) for part in diagram.syslist for label in part.output_labels]
    where = f" in diagram {path}" if path else ""
    way_out = (
        "rename one, give every block its own name=, or write the sum out with connections=, a list in inplist or "
        "outlist, or a summing junction"
    )
    for i, (block, label) in enumerate(inputs):
        internal = [outputs[j] for j in np.flatnonzero(diagram.connect_map[i])]
        external = [
            diagram.input_labels[j]
            for j in np.flatnonzero(diagram.input_map[i])
            if diagram.input_labels[j] == label
        ]
        doubled = any(abs(gain) > 1 for gain in diagram.connect_map[i])
        if len(internal) + len(external) > 1 or doubled:
            sources = [f"{name}.{signal}" for name, signal in internal] + [f"the input {e}" for e in external]
            twice = " (twice)" if doubled else ""
            raise ValueError(
                f"{block}.{label}{where} is driven by {' and by '.join(sources)}{twice}, all called "
                f"{label!r}; {way_out}"
            )
    for i, label in enumerate(diagram.output_labels):
        sources = [
            f"{outputs[j][0]}.{label}"
            for j in np.flatnonzero(diagram.output_map[i])
            if j < len(outputs) and outputs[j][1] == label
        ]
        if len(sources) > 1:
            raise ValueError(f"output {label}{where} is driven by {' and by '.join(sources)}; {way_out}")


def _keep_starts(wiring: Wiring) -> str:
    """Inputs that nothing drives have their start values, where their block has it so; what looks like a slip there."""
    left: list[tuple[str, str]] = []
    undriven = set(_undriven(wiring))
    for block in wiring.blocks if undriven else ():
        entries = zip(block.inputs, block.functions.inputs, strict=True)
        open_ones = [(signal, variable) for signal, variable in entries if signal in undriven]
        if not open_ones:
            continue
        count = Counter(_base(variable.name) for variable in block.functions.inputs)
        open_count = Counter(_base(variable.name) for _, variable in open_ones)
        for signal, variable in open_ones:
            base = _base(variable.name)
            whole = variable.optional and open_count[base] == count[base]  # half a vector is a slip
            if whole or block.functions.keeps_starts:
                wiring.sums[signal], wiring.starts[signal] = [], variable.start
            if whole and (block.path, base) not in left:
                left.append((block.path, base))
    return _slip(wiring, left) if left else ""


def _slip(wiring: Wiring, left: Sequence[tuple[str, str]]) -> str:
    """An optional input that is left open while an output of another block, called nearly so, drives nothing."""
    used = set(wiring.outputs) | {signal for block in wiring.blocks for signal in block.inputs}
    pending = list(used)
    while pending:
        for term, _ in wiring.sums.get(pending.pop(), ()):
            if term not in used:
                used.add(term)
                pending.append(term)
    unused = [
        (block.path, _base(variable.name))
        for block in wiring.blocks
        for signal, variable in zip(block.outputs, block.functions.outputs, strict=True)
        if signal not in used
    ]
    for path, base in left:
        for other, output in unused:
            if other != path and _alike(base, output):
                return (
                    f"nothing drives {path}.{base}, which would stay at its default, and {other}.{output} drives "
                    f"nothing: wire the one to the other, or, where this is meant, make {other}.{output} an output of "
                    'the diagram, or take flatten(diagram, unconnected="zero")'
                )
    return ""


def _alike(first: str, second: str) -> bool:
    a, b = first.lower(), second.lower()
    return a == b or difflib.SequenceMatcher(None, a, b).ratio() >= _ALIKE


def _base(label: str) -> str:
    return re.sub(r"\[[\d,]+\]$", "", label)


def _undriven(wiring: Wiring) -> list[int]:
    """Inputs of blocks that nothing drives."""
    followers: dict[int, list[int]] = {}
    for signal, terms in wiring.sums.items():
        for term, _ in terms:
            followers.setdefault(term, []).append(signal)
    reached = set(wiring.producers) | set(wiring.inputs) | set(wiring.starts)
    pending = list(reached)
    while pending:
        for signal in followers.get(pending.pop(), ()):
            if signal not in reached:
                reached.add(signal)
                pending.append(signal)
    return [s for block in wiring.blocks for s in block.inputs if s not in reached]


def _what_to_type(wiring: Wiring, missing: Sequence[int]) -> str:
    """Which inputs nothing drives, how to drive them and how to leave them."""
    undriven, label = set(missing), ""
    for block in wiring.blocks:
        open_inputs = [
            v.name for s, v in zip(block.inputs, block.functions.inputs, strict=True) if s in undriven
        ]
        label = label or (open_inputs[0] if open_inputs else "")
    names = [wiring.names[s] for s in missing]
    return (
        f"nothing drives {', '.join(names)}{_near(wiring, missing[0])}. To drive it, give interconnect "
        f'connections=[["{names[0]}", "block.output"]], or an output of a block or an input of the diagram called '
        f'"{label}" where it wires by name. To leave it 0, take flatten(diagram, unconnected="zero") for simulate and '
        'the exports, and export_ssp(diagram, path, unconnected="zero")'
    )


def _near(wiring: Wiring, signal: int) -> str:
    """Outputs of other blocks that are called like an input that nothing drives."""
    path, _, label = wiring.names[signal].rpartition(".")
    outputs = {
        f"{block.path}.{v.name}": v.name
        for block in wiring.blocks
        if block.path != path
        for v in block.functions.outputs
    }
    close = difflib.get_close_matches(label, outputs.values(), 3, _ALIKE)
    found = [name for name, output in outputs.items() if output in close]
    return f" (called alike: {', '.join(found[:3])})" if found else ""


def input_variables(wiring: Wiring, labels: Sequence[str]) -> tuple[Variable, ...]:
    """Inputs of the diagram, each with the unit of the one block input that it goes to, and its start if alone there.

    Parameters
    ----------
    wiring : Wiring
    labels : sequence of str

    Returns
    -------
    tuple of Variable

    Examples
    --------
    >>> [v.name for v in input_variables(wire(ct.tf([2.0], [1.0]), {}, Rules("error")), ["u"])]
    ['u']
    """
    followers: dict[int, list[tuple[int, float]]] = {}
    for signal, terms in wiring.sums.items():
        for term, gain in terms:
            followers.setdefault(term, []).append((signal, gain))
    targets = {s: v for b in wiring.blocks for s, v in zip(b.inputs, b.functions.inputs, strict=True)}
    variables = []
    for signal, label in zip(wiring.inputs, labels, strict=True):
        alone, reached = True, signal
        while reached not in targets and followers.get(reached, [(0, 0.0)])[0][1] == 1.0:
            uses = followers[reached]
            if len(uses) != 1:
                break
            reached = uses[0][0]
            alone = alone and len(wiring.sums[reached]) == 1
        found = targets.get(reached, Variable(label))
        found = found if alone else Variable(label, 0.0, found.unit, found.description)
        variables.append(replace(found, name=label))
    return tuple(variables)


def output_variables(wiring: Wiring, labels: Sequence[str]) -> tuple[Variable, ...]:
    """Outputs of the diagram, each with the unit of the one block output that it is.

    Parameters
    ----------
    wiring : Wiring
    labels : sequence of str

    Returns
    -------
    tuple of Variable

    Examples
    --------
    >>> [v.name for v in output_variables(wire(ct.tf([2.0], [1.0]), {}, Rules("error")), ["y"])]
    ['y']
    """
    variables = []
    for signal, label in zip(wiring.outputs, labels, strict=True):
        while len(wiring.sums.get(signal, ())) == 1 and wiring.sums[signal][0][1] == 1.0:
            signal = wiring.sums[signal][0][0]
        block, i = wiring.producers.get(signal, (-1, 0))
        found = wiring.blocks[block].functions.outputs[i] if block >= 0 else Variable(label)
        variables.append(replace(found, name=label, start=0.0))
    return tuple(variables)
