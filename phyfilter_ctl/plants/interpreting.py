"""Equations of a plant that stay a Python function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .._sections import FloatArray
from ..blocks.functions import BlockFunctions
from ..blocks.interpreted import Interpreted, acting
from .declaration import Columns, Group

__all__ = ["as_python", "on_numbers"]

_REASON = "it is declared so (interpreted=True)"


def on_numbers(
    equations: Callable[..., Any],
    groups: Sequence[Sequence[Group]],
    t: float,
    *vectors: FloatArray,
) -> Any:
    """The equations on numbers: (derivatives, outputs), or what else they return.

    Parameters
    ----------
    equations : callable
    groups : sequence of (states, inputs, parameters)
    t : float
    vectors : arrays
        States, inputs and parameters.
    """
    views = []
    for kind, group, vector in zip(("state", "input", "parameter"), groups, vectors, strict=True):
        ends = np.cumsum([len(part.variables) for part in group])[:-1]
        parts = np.split(vector, ends) if group else []
        values = {
            each.name: part.reshape(each.shape) if each.shape else float(part[0])
            for each, part in zip(group, parts, strict=True)
        }
        views.append(Columns(kind, values))  # pyright: ignore[reportArgumentType]
    return equations(t, *views)


def as_python(
    functions: BlockFunctions,
    equations: Callable[..., Any],
    groups: Sequence[Sequence[Group]],
    outputs: Sequence[Group],
    name: str,
    *,
    has_outputs: bool,
) -> BlockFunctions:
    """The same block with the equations called back.

    Parameters
    ----------
    functions : BlockFunctions
        Of the right sizes; an output function that only puts out states is kept.
    equations : callable
    groups : sequence of (states, inputs, parameters)
    outputs : sequence of Group
    name : str
        Of the block.
    has_outputs : bool
        Whether the equations return outputs too.
    """

    def part(which: int, wanted: Sequence[Group]) -> Callable[..., FloatArray]:
        def evaluate(t: float, x: FloatArray, u: FloatArray, p: FloatArray) -> FloatArray:
            result = on_numbers(equations, groups, t, x, u, p)
            found: Mapping[str, Any] = result[which] if isinstance(result, tuple) else result
            # An output may be a state or an input that the equations do not repeat.
            known = {
                g.name: v
                for vector, group in ((x, groups[0]), (u, groups[1]))
                for g, v in _split(vector, group)
            }
            return np.concatenate(
                [np.zeros(0), *(np.ravel(found.get(g.name, known.get(g.name))) for g in wanted)]
            )

        return evaluate

    sizes = [len(functions.states), len(functions.inputs), len(functions.parameters)]
    update = Interpreted("dynamics", part(0, groups[0]), (*sizes, sizes[0]), name, _REASON)
    if not has_outputs:
        return replace(functions, dynamics=update, callbacks=(update,))
    evaluate = part(1, outputs)
    starts = [
        np.array([v.start for v in vs]) for vs in (functions.states, functions.inputs, functions.parameters)
    ]
    depends = acting(lambda u: evaluate(0.0, starts[0], u, starts[2]), [starts[1], starts[1] + 0.3])
    output = Interpreted("output", evaluate, (*sizes, len(functions.outputs)), name, _REASON, depends)
    return replace(functions, dynamics=update, output=output, callbacks=(update, output))


def _split(vector: FloatArray, group: Sequence[Group]) -> list[tuple[Group, FloatArray]]:
    ends = np.cumsum([len(part.variables) for part in group])[:-1]
    return list(zip(group, np.split(vector, ends) if group else [], strict=True))
