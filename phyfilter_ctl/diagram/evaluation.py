"""Values of all signals of a wired diagram as CasADi expressions, algebraic loops solved."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca
import numpy as np

from .loops import Expression, NewtonLoop, affine_solution, start_solutions
from .ordering import components, cycle, levels, tear
from .structure import is_affine
from .wiring import Wiring

__all__ = ["Evaluation", "Symbols", "call_block", "evaluate"]


@dataclass(frozen=True, eq=False)
class Symbols:
    """What the signals are expressions of, and the numbers at which loops are tried.

    Parameters
    ----------
    t, x, u, p, z : casadi symbols
        Time, states, inputs, parameters and held outputs of sampled blocks; all SX, or all MX.
    start : tuple of arrays
        Values of the same at the start.
    states, parameters, held : list of slice
        Parts of x, p and z that belong to each block.
    """

    t: Expression
    x: Expression
    u: Expression
    p: Expression
    z: Expression
    start: tuple[np.ndarray, ...]
    states: Sequence[slice]
    parameters: Sequence[slice]
    held: Sequence[slice]

    @property
    def all(self) -> list[Expression]:
        """(t, x, u, p, z)."""
        return [self.t, self.x, self.u, self.p, self.z]

    def new(self, name: str, size: int = 1) -> Expression:
        """A symbol of the same kind.

        Parameters
        ----------
        name : str
        size : int

        Returns
        -------
        casadi symbol
        """
        return type(self.t).sym(name, size)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Outcome of :func:`evaluate`.

    Parameters
    ----------
    values : dict
        Expression of every signal.
    loops : list of NewtonLoop
        Nonlinear algebraic loops in the order in which they are solved; their unknowns stand in ``values`` as symbols.
    order : list of int
        Blocks in the order in which their outputs are known.
    """

    values: dict[int, Expression]
    loops: list[NewtonLoop]
    order: list[int]


def evaluate(wiring: Wiring, symbols: Symbols) -> Evaluation:
    """Evaluates each block as often as a legal path crosses it, usually once.

    Parameters
    ----------
    wiring : Wiring
    symbols : Symbols

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        For an algebraic loop without a solution, or with many, with its path.

    Notes
    -----
    A strongly connected component of the signal graph is a loop. It is cut at a few signals tau, which leaves
    tau = F(tau): solved here where F is affine in tau, left to Newton's method otherwise.
    """
    needs = wiring.dependencies()
    values: dict[int, Expression] = dict(zip(wiring.inputs, _split(symbols.u), strict=True))
    for block, part in zip(wiring.blocks, symbols.held, strict=True):
        if block.period:
            values |= dict(zip(block.outputs, _split(symbols.z[part]), strict=True))
    loops: list[NewtonLoop] = []
    evaluator = _Evaluator(wiring, symbols, needs.__getitem__, loops)
    order = evaluator.run([n for n in range(len(wiring.names)) if n not in values], values)
    return Evaluation(values, loops, order)


def call_block(
    wiring: Wiring,
    symbols: Symbols,
    index: int,
    which: Literal["dynamics", "output"] | ca.Function,
    values: dict[int, Expression],
) -> Expression:
    """One function of one block on the values of its inputs; an input without a value counts as 0.

    Parameters
    ----------
    wiring : Wiring
    symbols : Symbols
    index : int
        Of the block.
    which : {"dynamics", "output"} or casadi.Function
    values : dict
        Expressions of signals.

    Returns
    -------
    casadi expression
    """
    block = wiring.blocks[index]
    zero = type(symbols.t)(0.0)
    inputs = [values.get(signal, zero) for signal in block.inputs]
    u = ca.vertcat(*inputs) if inputs else type(symbols.t)(0, 1)
    function: ca.Function = getattr(block.functions, which) if isinstance(which, str) else which
    return function(symbols.t, symbols.x[symbols.states[index]], u, symbols.p[symbols.parameters[index]])


class _Evaluator:
    def __init__(
        self,
        wiring: Wiring,
        symbols: Symbols,
        needs: Callable[[int], Sequence[int]],
        loops: list[NewtonLoop],
    ) -> None:
        self.wiring = wiring
        self.symbols = symbols
        self.needs = needs
        self.loops = loops
        self.block_inputs = {signal for block in wiring.blocks for signal in block.inputs}

    def run(self, nodes: Iterable[int], values: dict[int, Expression]) -> list[int]:
        """Fills in the values of the nodes; returns the blocks in the order in which they were completed."""
        producers = self.wiring.producers
        ordered = levels(components(nodes, self.needs), self.needs, producers.__contains__)
        together: dict[tuple[int, int], list[int]] = {}
        for level, part in ordered:
            if len(part) == 1 and part[0] in producers:
                together.setdefault((level, producers[part[0]][0]), []).append(part[0])
        order: dict[int, None] = {}
        for level, part in ordered:
            node = part[0]
            if len(part) > 1 or node in self.needs(node):
                order |= dict.fromkeys(self._loop(part, values))
            elif node not in producers:
                values[node] = self._sum(node, values)
            elif node not in values:
                block = producers[node][0]
                outputs = self._outputs(block, values)
                for signal in together[level, block]:
                    values[signal] = outputs[producers[signal][1]]
                order.pop(block, None)
                order[block] = None
        return list(order)

    def _sum(self, node: int, values: dict[int, Expression]) -> Expression:
        total: Expression | None = None
        for term, gain in self.wiring.sums[node]:
            part = values[term] if gain == 1.0 else gain * values[term]
            total = part if total is None else total + part
        return type(self.symbols.t)(self.wiring.starts.get(node, 0.0)) if total is None else total

    def _outputs(self, block: int, values: dict[int, Expression]) -> list[Expression]:
        """All outputs; those whose inputs are not known yet are not to be used."""
        return _split(call_block(self.wiring, self.symbols, block, "output", values))

    def _once(self, node: int, values: dict[int, Expression]) -> Expression:
        if node not in self.wiring.producers:
            return self._sum(node, values)
        block, i = self.wiring.producers[node]
        return self._outputs(block, values)[i]

    def _loop(self, part: Sequence[int], values: dict[int, Expression]) -> list[int]:
        cut = tear(part, self.needs, self.block_inputs)
        rest = [node for node in part if node not in cut]
        outside = sorted({n for node in part for n in self.needs(node)} - set(part))

        def around(known: dict[int, Expression]) -> Expression:
            self.run(rest, known)
            return ca.vertcat(*(self._once(node, known) for node in cut))

        # On symbols for all that enters, so that the derivatives see the loop alone and not what stands before it.
        symbols = self.symbols
        tau = symbols.new(f"tau{len(self.loops)}", len(cut))
        entering = symbols.new("entering", len(outside))
        unknown = dict(zip(cut, _split(tau), strict=True))
        local = {**dict(zip(outside, _split(entering), strict=True)), **unknown}
        result = around(local)
        at = [entering, symbols.t, symbols.x, symbols.p]
        entered = ca.vertcat(*(values[n] for n in outside)) if outside else type(symbols.t)(0, 1)
        path = self._path(part)
        around_once = ca.Function("around", [tau, *at], [result])
        if is_affine(around_once, [0]):
            matrix = ca.Function("matrix", at, [ca.jacobian(result, tau)])
            try_out = self._numbers(entered)
            solution = affine_solution(matrix, around_once, entered, symbols.all, try_out, path)
        else:
            residual = ca.Function("residual", [tau, *at], [result - tau])
            found = start_solutions(residual, self._numbers(entered), path)
            start = symbols.new(f"start{len(self.loops)}", len(cut))
            names = tuple(self.wiring.names[node] for node in cut)
            self.loops.append(NewtonLoop(tau, start, entered, residual, found, names, path))
            solution = tau
        values |= dict(zip(cut, _split(solution), strict=True))
        return self.run(rest, values)

    def _numbers(self, entered: Expression) -> list[list[np.ndarray]]:
        """(entering, t, x, p) at the start and near it."""
        symbols = self.symbols
        function = ca.Function("entered", [*symbols.all, *(loop.tau for loop in self.loops)], [entered])
        rng = np.random.default_rng(7)
        places = []
        for scale in (0.0, 0.1, 1.0, 1.0):
            t, x, u, p, z = symbols.start
            x, u, z = (a + scale * rng.normal(size=a.shape) for a in (x, u, z))
            value = function(t, x, u, p, z, *(loop.solutions[0] for loop in self.loops))
            places.append([np.asarray(value, dtype=float).reshape(-1), t, x, p])
        return places

    def _path(self, part: Sequence[int]) -> str:
        way = cycle(part, self.needs)
        ports = [n for n in way if n in self.wiring.producers or n in self.block_inputs] or way
        ports = ports if ports[0] == ports[-1] and len(ports) > 1 else [*ports, ports[0]]
        return " -> ".join(self.wiring.names[n] for n in ports)


def _split(column: Expression) -> list[Expression]:
    return ca.vertsplit(column) if column.shape[0] else []
