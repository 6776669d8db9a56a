"""One step of a run as a CasADi function: the sampled blocks that are due, the record, then integration.

A step maps (state, data, p) to (next state, record). The state holds x, the states s of all sampled blocks and the
outputs z that they hold; the record x and y at the beginning of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias, cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from ..blocks.functions import dependencies
from ..diagram import FlatModel
from .arguments import Run

__all__ = [
    "Layout",
    "advance_rk4",
    "at_node",
    "compose",
    "cut",
    "discrete_step",
    "full_step",
    "has_common_parts",
    "kinds_of",
    "outputs_at",
    "renewed",
    "split_step",
    "start_state",
]

# Checked as if all were SX: MX has the same operations.
Results: TypeAlias = Sequence[ca.SX]
SYMBOLS: tuple[type[ca.SX], ...] = (ca.SX, cast(type[ca.SX], ca.MX))
# Functions of as many flat models are kept ready for the next run.
KEPT = 64


@lru_cache(maxsize=KEPT)
def has_common_parts(flat: FlatModel) -> bool:
    """Whether evaluations at different states may have parts in common: of time, parameters or held outputs alone."""
    return bool(flat.parameters or flat.held or dependencies(flat.dynamics, 0).any())


@dataclass(frozen=True, eq=False)
class Layout:
    """Where things stand in the state and in the data column of a step."""

    flat: FlatModel

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Lengths of x, s and z."""
        flat = self.flat
        return len(flat.states), sum(len(task.law.states) for task in flat.tasks), len(flat.held)

    @property
    def state(self) -> int:
        return sum(self.sizes)

    @property
    def record(self) -> int:
        return len(self.flat.states) + len(self.flat.outputs)

    @property
    def inputs(self) -> int:
        return len(self.flat.inputs)

    @property
    def due(self) -> slice:
        start = 2 + 3 * self.inputs
        return slice(start, start + len(self.flat.tasks))

    @property
    def node(self) -> int:
        """1 at a node, 0 at a step that only integrates."""
        return self.due.stop

    @property
    def table(self) -> int:
        """Which column of a table the step uses."""
        return self.due.stop + 1

    @property
    def data(self) -> int:
        return self.due.stop + 2

    def input(self, stage: int) -> slice:
        """Inputs at the beginning (0), in the middle (1) and at the end (2) of the step."""
        return slice(2 + stage * self.inputs, 2 + (stage + 1) * self.inputs)


def start_state(flat: FlatModel, x: FloatArray) -> FloatArray:
    """State before the first instant."""
    sampled = [variable.start for task in flat.tasks for variable in task.law.states]
    return np.concatenate([x, sampled, [variable.start for variable in flat.held]])


def compose(
    name: str,
    sizes: Sequence[int],
    body: Callable[..., Results],
    kinds: Sequence[type[ca.SX]] = SYMBOLS,
    share: bool = True,
) -> ca.Function:
    """A function with dense arguments and results, in SX where everything inside allows it: that runs fastest.

    ``share``: evaluations of a diagram inside share what they have in common, which takes a while to find.
    """
    failure: Exception | None = None
    for kind in kinds:
        arguments = [kind.sym(f"i{i}", size) for i, size in enumerate(sizes)]
        try:
            results = [ca.densify(kind(result)) for result in body(*arguments)]
        except (RuntimeError, NotImplementedError) as error:
            failure = error
            continue
        if kind is ca.SX and share:
            results = ca.cse(results)
        return ca.Function(name, arguments, results)
    raise RuntimeError(f"{name}: neither SX nor MX can express the diagram: {failure}")


def kinds_of(flat: FlatModel) -> Sequence[type[ca.SX]]:
    """Symbols for what brings z up to date: MX alone computes no more of the switches' ranges than it has to."""
    return SYMBOLS if flat.loops or flat.unknowns is None else SYMBOLS[1:]


def cut(vector: ca.SX, part: slice) -> ca.SX:
    """Entries of a column, as a column also where there are none: CasADi makes a row of those of a scalar."""
    start, stop, _ = part.indices(vector.numel())
    return vector[start:stop] if stop > start else type(vector)(0, 1)


def _sizes(flat: FlatModel) -> tuple[int, int, int]:
    layout = Layout(flat)
    return layout.state, layout.data, len(flat.parameters)


def _split(flat: FlatModel, state: ca.SX) -> tuple[ca.SX, list[ca.SX], ca.SX]:
    n_x, n_s, n_z = Layout(flat).sizes
    x, s, z = ca.vertsplit(state, [0, n_x, n_x + n_s, n_x + n_s + n_z])
    borders = np.cumsum([0, *(len(task.law.states) for task in flat.tasks)]).tolist()
    return x, ca.vertsplit(s, borders) if flat.tasks else [], z


def renewed(flat: FlatModel, t: ca.SX, x: ca.SX, u: ca.SX, p: ca.SX, z: ca.SX) -> ca.SX:
    """z with what follows from x as it is now: unknowns of algebraic loops, ranges of switches."""
    if flat.unknowns is None:
        return z
    found = flat.unknowns(t, x, u, p, z)
    first = len(flat.held) - found.numel()
    known = ca.sum1(ca.fabs(found)) < np.inf
    return ca.vertcat(cut(z, slice(first)), ca.if_else(known, found, cut(z, slice(first, None))))


@lru_cache(maxsize=KEPT)
def at_node(flat: FlatModel) -> ca.Function:
    """Run the sampled blocks that are due and record (semantics: Notes of FlatModel)."""
    layout = Layout(flat)

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        x, s, z = _split(flat, state)
        t, u = data[0], cut(data, layout.input(0))
        due = cut(data, layout.due)
        for i in flat.turns or range(len(flat.tasks)):
            task = flat.tasks[i]
            v = task.signals(t, x, u, p, z)
            out = ca.if_else(due[i], task.law.output(t, s[i], v, cut(p, task.parameters)), cut(z, task.held))
            z = ca.vertcat(cut(z, slice(task.held.start)), out, cut(z, slice(task.held.stop, None)))
        after = []
        for i, task in enumerate(flat.tasks):
            v = task.signals(t, x, u, p, z)
            after.append(ca.if_else(due[i], task.law.dynamics(t, s[i], v, cut(p, task.parameters)), s[i]))
        z = renewed(flat, t, x, u, p, z)
        y = flat.output(t, x, u, p, z)
        return ca.vertcat(x, *after, z), ca.vertcat(x, y)

    return compose("pf_node", _sizes(flat), body, kinds_of(flat))


@lru_cache(maxsize=KEPT)
def advance_rk4(flat: FlatModel) -> ca.Function:
    """One step of the classical Runge-Kutta method."""
    layout = Layout(flat)

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        n_x, _, n_z = layout.sizes
        x, s = cut(state, slice(n_x)), cut(state, slice(n_x, layout.state - n_z))
        z = cut(state, slice(layout.state - n_z, None))
        t, h = data[0], data[1]
        u = [cut(data, layout.input(stage)) for stage in range(3)]
        k1 = flat.dynamics(t, x, u[0], p, z)
        k2 = flat.dynamics(t + h / 2, x + h / 2 * k1, u[1], p, z)
        k3 = flat.dynamics(t + h / 2, x + h / 2 * k2, u[1], p, z)
        k4 = flat.dynamics(t + h, x + h * k3, u[2], p, z)
        after = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return (ca.vertcat(after, s, renewed(flat, t + h, after, u[2], p, z)),)

    return compose("pf_rk4", _sizes(flat), body)


@lru_cache(maxsize=KEPT)
def discrete_step(flat: FlatModel) -> ca.Function:
    """One step of a discrete diagram."""
    layout = Layout(flat)

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        x, _, z = _split(flat, state)
        t, u = data[0], cut(data, layout.input(0))
        z = renewed(flat, t, x, u, p, z)
        return ca.vertcat(flat.dynamics(t, x, u, p, z), z), ca.vertcat(x, flat.output(t, x, u, p, z))

    return compose("pf_discrete", _sizes(flat), body)


@lru_cache(maxsize=KEPT)
def full_step(node: ca.Function, advance: ca.Function) -> ca.Function:
    """A step that begins at a node."""

    def body(state: ca.SX, data: ca.SX, p: ca.SX) -> Results:
        state, record = node(state, data, cut(p, slice(node.size1_in(2))))
        (after,) = advance.call([state, data, p], not advance.is_a("SXFunction"), False)
        return after, record

    # Matrix products of a flow stay whole in MX; SX would make one instruction of each entry.
    kinds = SYMBOLS if advance.is_a("SXFunction") else SYMBOLS[1:]
    return compose("pf_step", [advance.size1_in(i) for i in range(3)], body, kinds)


@lru_cache(maxsize=KEPT)
def split_step(node: ca.Function, advance: ca.Function, flag: int) -> ca.Function:
    """A step that begins at a node where data[flag] is set, and else only integrates, at the cost of that alone."""
    sizes = [node.size1_in(i) for i in range(3)]
    MX = SYMBOLS[1]
    state, data, p = (MX.sym(f"i{i}", size) for i, size in enumerate(sizes))
    passing = ca.Function("pf_pass", [state, data, p], [state, MX.zeros(node.size1_out(1), 1)])
    chosen = ca.Function.if_else("pf_choice", node, passing)
    state, data, p = (MX.sym(f"i{i}", advance.size1_in(i)) for i in range(3))
    after, record = chosen(data[flag] > 0.5, state, data, cut(p, slice(sizes[2])))
    return ca.Function("pf_split_step", [state, data, p], [advance(after, data, p), record])


def outputs_at(
    flat: FlatModel, run: Run, x: FloatArray, z: FloatArray, good: NDArray[np.bool_]
) -> FloatArray:
    """Outputs at all times at once; the sampled blocks have run."""
    y = np.full((len(x), len(flat.outputs)), np.nan)
    states = _plain_states(flat)
    if states is not None:
        y[good] = x[good][:, states]
        return y
    size = 256
    mapped = _mapped(flat, size)
    for start in range(0, len(x), size):
        rows = slice(start, start + size)
        parts = [run.times[rows, None], x[rows], run.inputs[rows], None, z[rows]]
        count = len(run.times[rows])
        filled = [
            run.parameters
            if part is None
            else np.vstack([part, np.repeat(part[-1:], size - count, axis=0)]).T
            for part in parts
        ]
        filled[3] = np.repeat(run.parameters[:, None], size, axis=1)
        y[rows] = np.asarray(mapped(*filled), dtype=float).T[:count]
    y[~good] = np.nan
    return y


@lru_cache(maxsize=KEPT)
def _plain_states(flat: FlatModel) -> list[int] | None:
    """Which states the outputs are; None where they are anything else."""
    function, count = flat.output, len(flat.outputs)
    if not function.is_a("SXFunction") or function.n_instructions() > 2 * count:
        return None
    held: dict[int, int] = {}
    found = [-1] * count
    for k in range(function.n_instructions()):
        kind = function.instruction_id(k)
        given, result = function.instruction_input(k), function.instruction_output(k)
        if kind == ca.OP_INPUT and given[0] == 1:
            held[result[0]] = given[1]
        elif kind == ca.OP_OUTPUT and given[0] in held:
            found[result[1]] = held[given[0]]
        else:
            return None
    return found if min(found, default=-1) >= 0 else None


@lru_cache(maxsize=KEPT)
def _mapped(flat: FlatModel, size: int) -> ca.Function:
    return flat.output.map(size)
