"""A python-control diagram as one flat model."""

from __future__ import annotations

import dataclasses
import re
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import accumulate, pairwise
from typing import cast

import casadi as ca
import control as ct
import numpy as np

from ..blocks.functions import BlockFunctions, Variable, dependencies
from .discrete import law_of
from .equations import AlgebraicLoop, FlatEvent, late
from .evaluation import Evaluation, Symbols, call_block, evaluate
from .leaves import linear_function, state_space
from .loops import Expression, newton_function
from .model import FlatModel, Task
from .ordering import components, cycle
from .wiring import Block, Rules, Unconnected, Wiring, input_variables, output_variables, wire

__all__ = ["discrete_functions", "flatten"]

_ARGUMENTS = ("t", "x", "u", "p", "z")


def flatten(
    sys: ct.InputOutputSystem,
    *,
    name: str | None = None,
    unconnected: Unconnected = "error",
    params: Mapping[str, object] | None = None,
    record: Sequence[str] = (),
) -> FlatModel:
    """One model of a python-control system, of any depth.

    Parameters
    ----------
    sys : control.InputOutputSystem
        StateSpace, TransferFunction, NonlinearIOSystem, a block of this package, or a diagram of such made by
        ``control.interconnect``, ``*``, ``+``, ``feedback`` ..., in which diagrams may stand as blocks.
    name : str, optional
        Name of the model; None takes the system's.
    unconnected : {"error", "zero"}
        Inputs of blocks that nothing drives: refused, or 0 as in python-control, whatever the block has as their
        start; ``undriven`` of the model names them. Those of an imported FMU keep their starts.
    params : mapping, optional
        Values of parameters that blocks read and that have none of their own: ``params["umax"]`` of a block made
        without ``params=``; and of those that are no numbers, such as ``params["correct"]`` of python-control's
        estimators. Numbers that a block has are given to :func:`simulate`.
    record : sequence of str
        Inputs and outputs of blocks, ``block.signal``, that become outputs of the model behind the system's own;
        ``*`` stands for any text and ``?`` for a character.

    Returns
    -------
    FlatModel
        A ``RuntimeWarning`` tells of algebraic loops with several solutions at the start values.
        States, parameters and held outputs are called ``block.name``, with the blocks of diagrams inside as
        ``diagram.block.name``; those of a single block have their bare names.

    Raises
    ------
    TypeError
        For a block that is no python-control system, or frequency response data.
    ValueError
        For a block whose functions fail wherever they are called or keep something from call to call, an algebraic loop
        that is singular or has no solution at the start values, a loop among sampled blocks, an input that nothing
        drives or two outputs of one name do, and names that clash; the message names the block.

    Notes
    -----
    Parameters. Two blocks with a parameter ``k`` keep each its own, as ``a.k`` and ``b.k``; python-control gives both
    the value of the last. A value set on the diagram (``interconnect(..., params={"k": 2.0})``) goes to all its
    blocks that read ``k``.

    Algebraic loops. Those affine in their signals are solved here, exactly; python-control raises for them. Others are
    solved at each evaluation, beginning with the solution at the last instant: by Newton's method; where that fails, by
    closing a bracket (one unknown), or by damped steps and Newton's homotopy. Where no solution is found, the results
    are not-a-number. Whether a signal depends on another is seen from the structure, so neither a path that
    crosses one block twice counts as a loop, nor does a loop hide that is at rest at zero input.
    ``control.interconnect`` itself refuses a loop of linear blocks only: make the diagram with
    ``control.InterconnectedSystem``, or write one of its blocks with ``control.nlsys``.

    Wiring by name (``connections=None``). An input driven by two outputs of its name is refused; python-control adds
    them up.

    Examples
    --------
    >>> plant = ct.nlsys(lambda t, x, u, params: [(u[0] - params["drag"] * x[0] * np.sqrt(x[0] ** 2)) / params["m"]],
    ...                  None, inputs="f", outputs="v", states="v", params={"m": 2.0, "drag": 0.5}, name="plant")
    >>> control = ct.tf([3.0, 1.0], [1.0, 0.0], inputs="e", outputs="f", name="pi")
    >>> error = ct.summing_junction(["r", "-v"], "e", name="error")
    >>> loop = ct.interconnect([plant, control, error], inputs="r", outputs="v", name="loop")
    >>> flat = flatten(loop)
    >>> [s.name for s in flat.states], [p.name for p in flat.parameters], flat.order
    (['plant.v', 'pi.x[0]'], ['plant.m', 'plant.drag'], ('plant', 'error', 'pi'))
    >>> flat.dynamics(0.0, [1.0, 0.0], [2.0], [2.0, 0.5], []).full().ravel().tolist()
    [1.25, 1.0]
    """
    if not isinstance(sys, ct.InputOutputSystem) and not isinstance(sys, ct.FrequencyResponseData):
        raise TypeError(
            f"expected a python-control system, got {type(sys).__name__}; a filter becomes one by phyfilter_block"
        )
    if unconnected not in ("error", "zero"):
        raise ValueError(f'unconnected: expected "error" or "zero", got {unconnected!r}')
    rules = Rules(unconnected, discrete_functions, params or {})
    if isinstance(record, str):
        raise TypeError(f"record: expected a sequence of names and patterns, got the text {record!r}")
    return _assemble(sys, name or sys.name or "system", {}, rules, record)


def discrete_functions(
    system: ct.InputOutputSystem,
    path: str,
    given: Mapping[str, object],
    rules: Rules,
) -> tuple[BlockFunctions, tuple[str, ...]]:
    """A discrete diagram as the law of one sampled block.

    Parameters
    ----------
    system : control.InputOutputSystem
    path : str
        Name of the block in messages.
    given : mapping
        Parameter values from outside.
    rules : Rules

    Returns
    -------
    BlockFunctions
    tuple of str
        Inputs in the diagram that nothing drives.

    Raises
    ------
    ValueError
        If the diagram is not discrete.

    Examples
    --------
    >>> law, _ = discrete_functions(ct.tf([1.0], [1.0, -0.5], 0.1), "lag", {}, Rules("error"))
    >>> law.dynamics(0, 2.0, 1.0, []).full().item()
    2.0
    """
    flat = _assemble(system, path, given, rules)
    if flat.dt == 0.0:
        raise ValueError(f"block {path}: expected a discrete system with dt > 0, got a continuous one")
    return law_of(flat), flat.undriven


def _assemble(
    system: ct.InputOutputSystem,
    name: str,
    given: Mapping[str, object],
    rules: Rules,
    record: Sequence[str] = (),
) -> FlatModel:
    dt = _time_base(system, name)
    linear = isinstance(system, ct.StateSpace | ct.TransferFunction)
    if linear and not isinstance(system, ct.InterconnectedSystem) and not record:
        return _linear(system, name, dt)
    wiring = wire(system, given, rules)
    labels = [*_labels(system, len(wiring.outputs)), *_recorded(wiring, record)]
    _refuse_shared(wiring.blocks)
    scalar, wiring.blocks = _expanded(wiring.blocks)
    prefix = isinstance(system, ct.InterconnectedSystem)
    states = [() if b.period else _named(b, b.functions.states, prefix) for b in wiring.blocks]
    parameters = [_named(b, b.functions.parameters, prefix) for b in wiring.blocks]
    held = [_named(b, b.functions.outputs, prefix) if b.period else () for b in wiring.blocks]
    if dt > 0.0 and any(b.period for b in wiring.blocks):
        sampled = next(b.path for b in wiring.blocks if b.period)
        raise ValueError(
            f"block {sampled} is a sampled block in a discrete diagram (dt = {dt:g} s); wrap the discrete blocks as "
            "sampled blocks too, which makes the diagram a continuous one of several rates"
        )
    inputs = input_variables(wiring, system.input_labels)
    outputs = output_variables(wiring, labels)
    flat_states, flat_parameters, flat_held = _joined(states), _joined(parameters), _joined(held)
    for what, variables in zip(
        ("states", "inputs", "outputs", "parameters", "held outputs"),
        (flat_states, inputs, outputs, flat_parameters, flat_held),
        strict=True,
    ):
        _check_unique(what, variables, name)
    kind = ca.SX if scalar else cast(type[ca.SX], ca.MX)
    symbols = Symbols(
        kind.sym("t"),
        *(
            kind.sym(letter, len(variables))
            for letter, variables in zip(
                "xupz", (flat_states, inputs, flat_parameters, flat_held), strict=True
            )
        ),
        start=(np.zeros(1), *(_starts(v) for v in (flat_states, inputs, flat_parameters, flat_held))),
        states=_parts(states),
        parameters=_parts(parameters),
        held=_parts(held),
    )
    evaluation = evaluate(wiring, symbols)
    loops, unknowns = _loops(evaluation, len(flat_held))
    flat_held += unknowns
    build = _Builder(symbols, evaluation, len(wiring.blocks) > 1)
    derivatives = [
        call_block(wiring, symbols, i, "dynamics", evaluation.values)
        for i, block in enumerate(wiring.blocks)
        if not block.period and block.functions.states
    ]
    tasks, turns = _tasks(wiring, symbols, evaluation, build)
    events, conditions = _events(wiring, symbols, evaluation, build, prefix)
    return FlatModel(
        name=name,
        states=flat_states,
        inputs=inputs,
        outputs=outputs,
        parameters=flat_parameters,
        held=flat_held,
        dynamics=build.function("dynamics", derivatives),
        output=build.function("output", [evaluation.values[s] for s in wiring.outputs]),
        tasks=tasks,
        loops=loops,
        unknowns=build.function("unknowns", [loop.tau for loop in evaluation.loops]) if loops else None,
        dt=dt,
        order=_order(wiring, evaluation, tasks),
        callbacks=tuple(callback for block in wiring.blocks for callback in block.functions.callbacks),
        events=events,
        conditions=conditions,
        turns=turns,
        undriven=tuple(wiring.undriven),
        constants=tuple(
            (f"{block.path}.{name}" if prefix else name, value)
            for block in wiring.blocks
            for name, value in block.functions.constants
        ),
    )


def _refuse_shared(blocks: Sequence[Block]) -> None:
    """A block that keeps something from call to call stands in a diagram once."""
    owners: dict[object, str] = {}
    for block in blocks:
        for running in {callback.running for callback in block.functions.callbacks} - {None}:
            if (other := owners.setdefault(running, block.path)) != block.path:
                reason = block.functions.callbacks[0].reason
                raise ValueError(
                    f"blocks {other} and {block.path} are one and the same, with a state of its own ({reason}): "
                    "import it twice, or give the diagram a copy (copy.deepcopy)"
                )


def _linear(system: ct.StateSpace | ct.TransferFunction, name: str, dt: float) -> FlatModel:
    """One linear system: its functions are made where they are asked for, since a run needs the matrices alone."""
    path = system.name or "system"
    space = state_space(system, path)
    A, B, C, D = (np.asarray(M, dtype=float) for M in (space.A, space.B, space.C, space.D))
    states, inputs, outputs = (
        tuple(Variable(label) for label in labels)
        for labels in (space.state_labels, system.input_labels, _labels(system, space.noutputs))
    )
    for what, variables in (("states", states), ("inputs", inputs), ("outputs", outputs)):
        _check_unique(what, variables, name)
    return FlatModel(
        name=name,
        states=states,
        inputs=inputs,
        outputs=outputs,
        parameters=(),
        held=(),
        dynamics=late(partial(linear_function, "dynamics", _ARGUMENTS, A, B)),
        output=late(partial(linear_function, "output", _ARGUMENTS, C, D)),
        dt=dt,
        order=(path,),
        matrices=None if dt > 0.0 else (A, B, C, D),
    )


def _recorded(wiring: Wiring, patterns: Sequence[str]) -> list[str]:
    """Makes outputs of the signals of blocks that match; their names. An output goes before an input of its name."""
    signals = {wiring.names[s]: s for block in wiring.blocks for s in (*block.inputs, *block.outputs)}
    chosen: dict[str, int] = {}
    for pattern in patterns:
        found = {name: s for name, s in signals.items() if name == pattern or _matches(name, pattern)}
        if not found:
            block = pattern.rpartition(".")[0]
            near = [name for name in signals if name.rpartition(".")[0] == block]
            known = ", ".join(near or [f"{part.path}.*" for part in wiring.blocks])
            raise ValueError(f"record: no signal of a block matches {pattern!r}; there are {known}")
        chosen |= found
    wiring.outputs = [*wiring.outputs, *chosen.values()]
    return list(chosen)


def _matches(name: str, pattern: str) -> bool:
    """Without the character sets of shells: brackets belong to names."""
    expression = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(expression, name) is not None


def _time_base(system: ct.InputOutputSystem, name: str) -> float:
    if system.dt is None or system.dt == 0:
        return 0.0
    if system.dt is True:
        raise ValueError(
            f"{name}: it is discrete with an unknown sampling interval; give its blocks dt= in seconds"
        )
    return float(system.dt)


def _expanded(blocks: Sequence[Block]) -> tuple[bool, list[Block]]:
    """Functions as scalar (SX) expressions where all of them can be."""
    result, scalar = [], True
    for block in blocks:
        functions = {}
        for which in ("dynamics", "output"):
            function: ca.Function = getattr(block.functions, which)
            if not function.is_a("SXFunction"):
                try:
                    function = function.expand()
                except RuntimeError:
                    # A sampled block stands apart from the others; its law need not be of their kind.
                    scalar = scalar and bool(block.period)
            functions[which] = function
        result.append(dataclasses.replace(block, functions=dataclasses.replace(block.functions, **functions)))
    return scalar, result


def _loops(evaluation: Evaluation, held: int) -> tuple[tuple[AlgebraicLoop, ...], tuple[Variable, ...]]:
    """Nonlinear loops, and their unknowns, which stand in z behind what is held."""
    loops, unknowns = [], []
    for loop in evaluation.loops:
        first = held + len(unknowns)
        start = loop.solutions[0].tolist()
        unknowns += [
            Variable(name, value, "", "of an algebraic loop")
            for name, value in zip(loop.names, start, strict=True)
        ]
        loops.append(AlgebraicLoop(loop.path, slice(first, first + len(start)), loop.solutions))
        if len(loop.solutions) > 1:
            others = "; ".join(", ".join(f"{v:.6g}" for v in other) for other in loop.solutions[1:5])
            warnings.warn(
                f"algebraic loop {loop.path} has several solutions at the start values: a run starts from "
                f"{', '.join(loop.names)} = {', '.join(f'{v:.6g}' for v in start)}; also found: {others}",
                RuntimeWarning,
                stacklevel=4,
            )
    return tuple(loops), tuple(unknowns)


class _Builder:
    """Makes functions of (t, x, u, p, z), with the nonlinear loops solved inside."""

    def __init__(self, symbols: Symbols, evaluation: Evaluation, shared: bool) -> None:
        self._symbols = symbols
        self._shared = shared  # blocks may be called more than once
        self._loops = evaluation.loops
        self._unknowns = newton_function(evaluation.loops, symbols.all) if evaluation.loops else None
        held = symbols.z.shape[0]
        self._borders = [0, *accumulate((loop.tau.shape[0] for loop in self._loops), initial=held)]

    def function(self, name: str, parts: Sequence[Expression]) -> ca.Function:
        arguments = self._symbols.all
        kind = type(self._symbols.t)
        result = ca.densify(ca.vertcat(*parts)) if parts else kind(0, 1)
        if kind is ca.SX and self._shared:
            result = ca.cse(result)
        needed = [loop.tau for loop in self._loops if ca.depends_on(result, loop.tau)] if parts else []
        if self._unknowns is None:
            return ca.Function(name, arguments, [result], list(_ARGUMENTS), ["value"])
        inner = ca.Function(f"{name}_inner", [*arguments, *(loop.tau for loop in self._loops)], [result])
        if needed:
            kind = cast(type[ca.SX], ca.MX)
        outer = [kind.sym(letter, a.shape[0]) for letter, a in zip(_ARGUMENTS[:4], arguments, strict=False)]
        z = kind.sym(_ARGUMENTS[4], self._borders[-1])
        held, *starts = ca.vertsplit(z, self._borders)
        borders = [border - self._borders[1] for border in self._borders[1:]]
        taus = ca.vertsplit(self._unknowns(*outer, held, *starts), borders) if needed else starts
        value = inner(*outer, held, *taus)
        if needed:  # a comparison takes a not-a-number for a side, and would go on
            for i, tau in enumerate(taus, start=len(arguments)):
                rows = np.unique(inner.jac_sparsity(0, i).row()).astype(int)
                missing = np.zeros(value.numel())
                missing[rows] = np.nan
                value += ca.if_else(ca.sum1(ca.fabs(tau)) < np.inf, np.zeros(value.numel()), missing)
        return ca.Function(name, [*outer, z], [value], list(_ARGUMENTS), ["value"])


def _tasks(
    wiring: Wiring, symbols: Symbols, evaluation: Evaluation, build: _Builder
) -> tuple[tuple[Task, ...], tuple[int, ...]]:
    """The tasks in their order, and their turns where each once will not do."""
    tasks, blocks = [], []
    for i, block in enumerate(wiring.blocks):
        if not block.period:
            continue
        blocks.append(block)
        tasks.append(
            Task(
                name=block.path,
                period=block.period,
                law=block.functions,
                signals=build.function("signals", [evaluation.values[s] for s in block.inputs]),
                held=symbols.held[i],
                parameters=symbols.parameters[i],
                filter=block.filter,
                continuous=block.continuous,
            )
        )
    owner = [i for i, task in enumerate(tasks) for _ in range(task.held.start, task.held.stop)]
    edges: dict[int, dict[int, tuple[int, int]]] = {}
    for i, (task, block) in enumerate(zip(tasks, blocks, strict=True)):
        used = np.flatnonzero(block.functions.feedthrough.any(axis=0))
        reads = dependencies(task.signals, 4)[used] if len(used) else np.zeros((0, 0), dtype=bool)
        edges[i] = {}
        for row, column in zip(*np.nonzero(reads), strict=True):
            edges[i].setdefault(owner[column], (int(column), int(used[row])))

    def needs(i: int) -> list[int]:
        return list(edges[i])

    parts = components(range(len(tasks)), needs)
    for part in parts:
        if len(part) > 1 or part[0] in edges[part[0]]:
            turns = _turns(tasks) if any(block.functions.callbacks for block in wiring.blocks) else ()
            if turns:
                return tuple(tasks), turns
            way = cycle(part, needs)
            hops = [
                f"{blocks[a].path}.{blocks[a].functions.outputs[edges[b][a][0] - tasks[a].held.start].name} -> "
                f"{blocks[b].path}.{blocks[b].functions.inputs[edges[b][a][1]].name}"
                for a, b in pairwise(way)
            ]
            raise ValueError(
                f"sampled blocks wait for each other at an instant: {', '.join(hops)}; let one of them use what it got "
                'at its instant before (a unit delay; g="hold" for g of a filter), or, if its outputs have nothing to '
                "do with each other, make one block of each"
            )
    return tuple(tasks[part[0]] for part in parts), ()


def _turns(tasks: Sequence[Task]) -> tuple[int, ...]:
    """Tasks one after the other, each as often as outputs of it wait for others; empty where outputs wait in a ring."""
    waiting: dict[int, set[int]] = {}
    for task in tasks:
        reads = dependencies(task.signals, 4).astype(int)
        needed = task.law.feedthrough.astype(int) @ reads
        waiting |= {task.held.start + row: set(np.flatnonzero(needed[row])) for row in range(len(needed))}
    turns: list[int] = []
    while waiting:
        before = len(waiting)
        for i, task in enumerate(tasks):
            own = [k for k in range(task.held.start, task.held.stop) if k in waiting]
            ready = [k for k in own if not waiting[k] & waiting.keys()]
            if ready:
                turns.append(i)
                for k in ready:
                    del waiting[k]
        if len(waiting) == before:
            return ()
    return tuple(turns)


def _events(
    wiring: Wiring, symbols: Symbols, evaluation: Evaluation, build: _Builder, prefix: bool
) -> tuple[tuple[FlatEvent, ...], ca.Function | None]:
    events, conditions = [], []
    for i, block in enumerate(wiring.blocks):
        for event in block.functions.events:
            reset = None
            if event.reset is not None:
                own = symbols.states[i]
                after = call_block(wiring, symbols, i, event.reset, evaluation.values)
                count = own.stop - own.start
                rows = [symbols.x[: own.start], after[:count], symbols.x[own.stop :], after[count:]]
                reset = build.function("reset", [row for row in rows if row.numel()])
            completed, changed = (
                asked and build.function(name, [call_block(wiring, symbols, i, asked, evaluation.values)])
                for name, asked in (("completed", event.completed), ("changed", event.changed))
            )
            name = f"{block.path}.{event.name}" if prefix else event.name
            size = event.condition.size1_out(0)
            events.append(FlatEvent(name, event.direction, reset, size, event.memory, completed, changed))
            conditions.append(call_block(wiring, symbols, i, event.condition, evaluation.values))
    return tuple(events), build.function("conditions", conditions) if events else None


def _order(wiring: Wiring, evaluation: Evaluation, tasks: Sequence[Task]) -> tuple[str, ...]:
    known = [task.name for task in tasks] + [wiring.blocks[i].path for i in evaluation.order]
    return tuple(dict.fromkeys([*known, *(block.path for block in wiring.blocks)]))


def _named(block: Block, variables: Sequence[Variable], prefix: bool) -> tuple[Variable, ...]:
    if not prefix:
        return tuple(variables)
    return tuple(dataclasses.replace(v, name=f"{block.path}.{v.name}") for v in variables)


def _joined(groups: Sequence[Sequence[Variable]]) -> tuple[Variable, ...]:
    return tuple(variable for group in groups for variable in group)


def _parts(groups: Sequence[Sequence[Variable]]) -> list[slice]:
    ends = [0, *accumulate(len(group) for group in groups)]
    return [slice(a, b) for a, b in pairwise(ends)]


def _starts(variables: Sequence[Variable]) -> np.ndarray:
    return np.array([variable.start for variable in variables])


def _labels(system: ct.InputOutputSystem, count: int) -> list[str]:
    labels = list(system.output_labels)
    return labels if len(labels) == count else [f"y[{i}]" for i in range(count)]


def _check_unique(what: str, variables: Sequence[Variable], name: str) -> None:
    names = [variable.name for variable in variables]
    if len(set(names)) < len(names):
        twice = sorted({n for n in names if names.count(n) > 1})
        raise ValueError(f"{name}: the {what} {', '.join(twice)} stand twice; rename a block or a signal")
