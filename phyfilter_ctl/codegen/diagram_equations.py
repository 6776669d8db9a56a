"""Which CasADi functions the C code of a flat diagram needs."""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import cast

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..blocks.functions import BlockFunctions, dependencies
from ..diagram.model import FlatModel, Task

__all__ = ["dependence", "directional_functions", "flat_functions", "law_functions", "settled_tasks"]


def flat_functions(flat: FlatModel) -> dict[str, ca.Function]:
    """Derivatives, outputs and the signals of the tasks, those with results only; arguments t, x, u, p, z."""
    found: dict[str, ca.Function] = {}
    arguments = ["t", "x", "u", "p", "z"]
    if flat.states:
        found["dynamics"] = _named(flat.dynamics, arguments, ["dx"])
    if flat.unknowns is not None:
        found["unknowns"] = _named(flat.unknowns, arguments, ["found"])
    if flat.outputs:
        found["output"] = _named(flat.output, arguments, ["y"])
    if flat.conditions is not None:
        found["conditions"] = _named(flat.conditions, arguments, ["g"])
    for i, event in enumerate(flat.events):
        if event.reset is not None:
            found[f"event_{i}"] = _named(event.reset, arguments, ["x_next"])
    for i, task in enumerate(flat.tasks):
        if task.law.inputs:
            found[f"signals_{i}"] = _named(task.signals, arguments, ["v"])
    return found


def law_functions(law: BlockFunctions, number: int) -> dict[str, ca.Function]:
    """Output and update of a law; arguments t, s, v, q."""
    found: dict[str, ca.Function] = {}
    if law.outputs:
        found[f"law_output_{number}"] = _named(law.output, ["t", "s", "v", "q"], ["z"])
    if law.states:
        found[f"law_update_{number}"] = _named(law.dynamics, ["t", "s", "v", "q"], ["s_next"])
    return found


def directional_functions(flat: FlatModel) -> dict[str, ca.Function]:
    """Products of the Jacobian of (x', y) by (x, u, p) with a vector, and of its transpose.

    Arguments t, x, u, p, z, then seed_x, seed_u, seed_p -> dx, y; or seed_dx, seed_y -> x, u, p.
    """
    sizes = [1, len(flat.states), len(flat.inputs), len(flat.parameters), len(flat.held)]
    if sum(sizes[1:4]) == 0 or not (flat.states or flat.outputs):
        return {}
    kind = _kind(flat.dynamics, flat.output)
    names = ["t", "x", "u", "p", "z"]
    t, x, u, p, z = point = [kind.sym(name, size) for name, size in zip(names, sizes, strict=True)]
    seeds = [kind.sym(f"seed_{name}", size) for name, size in zip(names[1:4], sizes[1:4], strict=True)]
    cotangents = [kind.sym("seed_dx", sizes[1]), kind.sym("seed_y", len(flat.outputs))]
    # Products are taken by one vector of variables, of which the model sees parts.
    variables = kind.sym("variables", sum(sizes[1:4]))
    arguments = [t, *_split(variables, sizes[1:4]), z]
    (dx,), (y,) = flat.dynamics.call(arguments), flat.output.call(arguments)
    result = ca.densify(ca.vertcat(dx, y))
    seed, cotangent = kind.sym("seed", variables.numel()), kind.sym("cotangent", result.numel())
    given = [t, variables, z]
    forward = ca.Function("forward", [*given, seed], [ca.jtimes(result, variables, seed)])
    reverse = ca.Function("reverse", [*given, cotangent], [ca.jtimes(result, variables, cotangent, True)])
    (along,) = forward.call([t, ca.vertcat(x, u, p), z, ca.vertcat(*seeds)])
    (back,) = reverse.call([t, ca.vertcat(x, u, p), z, ca.vertcat(*cotangents)])
    return {
        "directional": ca.Function(
            "directional",
            [*point, *seeds],
            _split(along, [sizes[1], len(flat.outputs)]),
            [*names, "seed_x", "seed_u", "seed_p"],
            ["dx", "y"],
        ),
        "adjoint": ca.Function(
            "adjoint",
            [*point, *cotangents],
            _split(back, sizes[1:4]),
            [*names, "seed_dx", "seed_y"],
            ["to_x", "to_u", "to_p"],
        ),
    }


def dependence(flat: FlatModel) -> NDArray[np.bool_]:
    """Which entry of (x', y) depends on which of (x, u), held signals standing still; (n_x + n_y, n_x + n_u)."""
    n_x, n_u, n_y = len(flat.states), len(flat.inputs), len(flat.outputs)
    found = np.zeros((n_x + n_y, n_x + n_u), dtype=bool)
    for function, rows in ((flat.dynamics, slice(0, n_x)), (flat.output, slice(n_x, n_x + n_y))):
        if rows.stop > rows.start:
            if n_x:
                found[rows, :n_x] = dependencies(function, 1)
            if n_u:
                found[rows, n_x:] = dependencies(function, 2)
    return found


def settled_tasks(tasks: tuple[Task, ...]) -> tuple[bool, ...]:
    """Whether the inputs that a task put out on are final: no task at or after it acts on them through z."""
    settled: list[bool] = []
    for i, task in enumerate(tasks):
        if not task.law.inputs or not task.signals.numel_in(4):
            settled.append(True)
            continue
        acts = dependencies(task.signals, 4)
        settled.append(not any(acts[:, later.held].any() for later in tasks[i:]))
    return tuple(settled)


def _kind(*functions: ca.Function) -> type[ca.SX]:
    """The kind of expression that all of them take; one way of typing for both kinds."""
    return ca.SX if all(function.is_a("SXFunction") for function in functions) else cast(type[ca.SX], ca.MX)


def _named(function: ca.Function, arguments: list[str], results: list[str]) -> ca.Function:
    kind = _kind(function)
    symbols = [kind.sym(name, *function.size_in(i)) for i, name in enumerate(arguments)]
    return ca.Function("named", symbols, function.call(symbols), arguments, results)


def _split(value: ca.SX, sizes: list[int]) -> list[ca.SX]:
    ends = [0, *accumulate(sizes)]
    return [value[begin:end] for begin, end in pairwise(ends)]
