"""What a network computes, as nodes on named tensors: what is read from an ONNX file, walked and saved."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..._sections import FloatArray
from .. import _arrays

# Numbers in all constants of a network (64 MB): far beyond one that runs in a control loop.
MOST_NUMBERS = 1 << 23
MOST_NODES = 10_000

Attribute = int | float | str | tuple[int, ...] | tuple[float, ...]
Array = NDArray[np.float64] | NDArray[np.int64]


class RefusedError(ValueError):
    """A network with something that cannot be evaluated here."""


@dataclass(frozen=True)
class OnnxNode:
    """One operator: named tensors in, named tensors out.

    Parameters
    ----------
    operator : str
        Name in the ONNX specification, with its domain if that is not "ai.onnx": "Gemm", "ai.onnx.ml.Scaler".
    inputs, outputs : tuple of str
        Names of tensors; "" stands for an operand that is left out.
    attributes : mapping of str to int, float, str or a tuple of them
        By name; those left out have ONNX's defaults.
    name : str
        For messages.
    """

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    _: KW_ONLY
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    name: str = ""


@dataclass(frozen=True, eq=False)
class OnnxGraph:
    """Nodes in the order of evaluation, and the constants that they take.

    Parameters
    ----------
    nodes : tuple of OnnxNode
        Each takes the input, constants and results of those before it.
    constants : mapping of str to array
        float64 or int64, by name.
    shape : tuple of int or None
        Of the input: (samples, features ...), None where a size is open, or (features,) without an axis of samples.
    input, output : str
        Names of the tensors that come in and go out.
    opset : int
        Version of the operators.

    Raises
    ------
    ValueError
        If constants or nodes are too many, or a constant is not a number.
    """

    nodes: tuple[OnnxNode, ...]
    constants: Mapping[str, Array]
    shape: tuple[int | None, ...]
    _: KW_ONLY
    input: str = "z"
    output: str = "f"
    opset: int = 20

    def __post_init__(self) -> None:
        object.__setattr__(self, "nodes", tuple(self.nodes))
        object.__setattr__(self, "shape", tuple(self.shape))
        constants = {name: _owned(name, array) for name, array in self.constants.items()}
        object.__setattr__(self, "constants", MappingProxyType(constants))
        if len(self.nodes) > MOST_NODES:
            raise RefusedError(f"{len(self.nodes)} nodes, more than {MOST_NODES}")
        if (total := sum(array.size for array in constants.values())) > MOST_NUMBERS:
            raise RefusedError(f"{total} numbers in its constants, more than {MOST_NUMBERS}")
        if not self.input:
            raise RefusedError(
                "the input has no name"
            )  # no name is how an operand that is left out is written


def values_of(graph: OnnxGraph, names: tuple[str, ...]) -> FloatArray:
    """Constants in one vector, each by rows."""
    parts = [graph.constants[name].astype(float).ravel() for name in names]
    return np.concatenate(parts) if parts else np.zeros(0)


def with_values(graph: OnnxGraph, names: tuple[str, ...], vector: FloatArray) -> OnnxGraph:
    """The same graph with other values of these constants, in the order of :func:`values_of`."""
    constants, first = dict(graph.constants), 0
    for name in names:
        shape = constants[name].shape
        last = first + math.prod(shape)
        constants[name] = vector[first:last].reshape(shape)
        first = last
    return replace(graph, constants=constants)


def entries_of(graph: OnnxGraph) -> dict[str, NDArray[np.generic]]:
    """As entries of a file: a text, and the constants beside it."""
    nodes = [[n.operator, n.name, n.inputs, n.outputs, dict(n.attributes)] for n in graph.nodes]
    text = {"nodes": nodes, "constants": list(graph.constants), "shape": graph.shape}
    text |= {"input": graph.input, "output": graph.output, "opset": graph.opset}
    arrays = {f"constant_{i}": array for i, array in enumerate(graph.constants.values())}
    return {"graph": np.array(json.dumps(text)), **arrays}


def graph_of(path: object, arrays: Mapping[str, NDArray[np.generic]]) -> OnnxGraph:
    """The graph of :func:`entries_of`; ValueError, TypeError, KeyError or RecursionError where there is none."""
    text = json.loads(str(arrays["graph"].item()))
    names = [str(name) for name in text["constants"]]
    _arrays.expect_entries(path, arrays, ("graph", *(f"constant_{i}" for i in range(len(names)))))
    nodes = tuple(
        OnnxNode(
            str(operator),
            tuple(map(str, inputs)),
            tuple(map(str, outputs)),
            attributes={
                key: tuple(value) if isinstance(value, list) else value for key, value in of_node.items()
            },
            name=str(name),
        )
        for operator, name, inputs, outputs, of_node in text["nodes"]
    )
    constants = {name: _owned(name, arrays[f"constant_{i}"]) for i, name in enumerate(names)}
    shape = tuple(None if size is None else int(size) for size in text["shape"])
    return OnnxGraph(
        nodes,
        constants,
        shape,
        input=str(text["input"]),
        output=str(text["output"]),
        opset=int(text["opset"]),
    )


def _owned(name: str, values: NDArray[np.generic]) -> Array:
    """A read-only copy, real or whole numbers; a single number may be a limit, and that infinite."""
    raw = np.asarray(values)
    if raw.dtype.kind not in "fiub":
        raise RefusedError(f"constant {name!r}: expected numbers, got {raw.dtype}")
    array = raw.astype(float) if raw.dtype.kind == "f" else raw.astype(np.int64)
    if np.any(np.isnan(array)) or (array.ndim and not np.all(np.isfinite(array))):
        raise RefusedError(f"constant {name!r}: every number must be finite")
    array.flags.writeable = False
    return array
