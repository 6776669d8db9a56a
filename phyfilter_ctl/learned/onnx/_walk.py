"""From the nodes of a graph to numbers, a gradient or an expression: one operator after the other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ._calls import Call
from ._columns import Column
from ._operators import OPERATORS
from ._tensors import Tensor
from .graph import MOST_NUMBERS, OnnxGraph, OnnxNode, RefusedError

# Numbers in all results of the nodes of a graph.
_MOST_RESULTS = 1 << 24
# What numpy and CasADi raise on sizes and axes that do not fit together.
_UNFIT = (
    ValueError,
    TypeError,
    IndexError,
    KeyError,
    OverflowError,
    RuntimeError,
    NotImplementedError,
    MemoryError,
)
_WAY_ROUND = "fit a Network to its predictions, give its predict to learned_model as a function, or f_theta as a signal"


@dataclass(frozen=True, eq=False)
class Walk:
    """What a graph gives.

    Attributes
    ----------
    f : (samples n_x, N) column
        Output.
    trained : tuple of str
        Constants that a training moves: weights and biases, in the order of their first use.
    numbers : int
        Of all results on the way.
    """

    f: Column
    trained: tuple[str, ...]
    numbers: int


def walk(
    graph: OnnxGraph, z: Column, *, samples: int = 1, weights: Mapping[str, Column] | None = None
) -> Walk:
    """Evaluate a graph.

    Parameters
    ----------
    graph : OnnxGraph
    z : (samples n_z, N) column
        Features.
    samples : int
        Rows of the input in a column.
    weights : mapping of str to (size, 1) column, optional
        In place of constants, by rows.

    Raises
    ------
    RefusedError
        If an operator is not supported, or sizes do not fit together.
    """
    weights = {} if weights is None else weights
    tensors = {
        name: Tensor(weights[name], array.shape, source=name)
        if name in weights
        else Tensor.of(array, source=name)
        for name, array in graph.constants.items()
    }
    sizes = features(graph)
    tensors[graph.input] = Tensor(z, (samples, *sizes) if len(graph.shape) > 1 else sizes)
    trained: dict[str, bool] = {}
    numbers = math.prod(sizes)
    for node in graph.nodes:
        results = _evaluated(node, tensors, graph.opset, trained)
        numbers += sum(tensor.size for tensor in results)
        if numbers > _MOST_RESULTS:
            raise RefusedError(f"the nodes give more than {_MOST_RESULTS} numbers")
        tensors |= {name: tensor for name, tensor in zip(node.outputs, results, strict=False) if name}
    if graph.output not in tensors:
        raise RefusedError(f"no node gives the output {graph.output!r}")
    f = tensors[graph.output]
    if f.known or f.size == 0:
        raise RefusedError(f"the output {graph.output!r} does not depend on the input")
    return Walk(f.column, tuple(name for name, moves in trained.items() if moves), numbers)


def mixes_samples(graph: OnnxGraph) -> bool:
    """Whether the output for one row of the input depends on another row, as after a mean over the rows."""
    if len(graph.shape) < 2 or graph.shape[0] == 1:
        return False
    n_z = math.prod(features(graph))
    first, second = ca.MX.sym("z", n_z), ca.MX.sym("other", n_z)
    try:
        both = walk(graph, ca.vertcat(first, second), samples=2).f
    except RefusedError:  # written out for single rows
        return False
    return any(ca.which_depends(both[: both.shape[0] // 2], second, 1, True))


def _evaluated(
    node: OnnxNode, tensors: Mapping[str, Tensor], opset: int, trained: dict[str, bool]
) -> list[Tensor]:
    where = f"node {node.name!r} ({node.operator})"
    if node.operator not in OPERATORS:
        raise RefusedError(
            f"operator {node.operator!r} is not supported (node {node.name!r}); {_WAY_ROUND}; supported: "
            f"{', '.join(OPERATORS)}"
        )
    for name in node.inputs:
        if name and name not in tensors:
            raise RefusedError(f"{where}: no node before it gives {name!r}")
    call = Call(node, tuple(tensors[name] if name else None for name in node.inputs), opset, trained)
    try:
        with np.errstate(all="ignore"):  # what is not finite is said of the result
            results = OPERATORS[node.operator](call)
    except RefusedError as error:
        raise RefusedError(f"{where}: {error}") from error
    except _UNFIT as error:
        words = " ".join(str(error).split())[-200:]
        raise RefusedError(f"{where}: the operands do not fit together ({words})") from error
    return results if isinstance(results, list) else [results]


def features(graph: OnnxGraph) -> tuple[int, ...]:
    """Sizes of the input without that of the samples."""
    open_sizes = graph.shape[1:] if len(graph.shape) > 1 else graph.shape
    sizes = [_width(graph)] if len(open_sizes) == 1 and open_sizes[0] is None else list(open_sizes)
    known = tuple(n for n in sizes if n is not None and n > 0)
    if not known or len(known) < len(sizes):
        raise RefusedError(
            "the number of features is unknown: give the input of the model fixed dimensions but for the first"
        )
    if math.prod(known) > MOST_NUMBERS:
        raise RefusedError(f"the input has more than {MOST_NUMBERS} numbers")
    return known


def _width(graph: OnnxGraph) -> int | None:
    """Number of features from the weights that the input meets first; None if they do not tell."""
    for node in graph.nodes:
        if graph.input in node.inputs[:1] and node.operator in ("Gemm", "MatMul") and len(node.inputs) > 1:
            W = graph.constants.get(node.inputs[1])
            if W is not None and W.ndim == 2:
                return W.shape[1 if node.attributes.get("transB") else 0]
    return None
