"""ONNX files as graphs. Nothing in a file is executed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._operators import OPERATORS
from .graph import MOST_NODES, MOST_NUMBERS, Array, Attribute, OnnxGraph, OnnxNode, RefusedError

if TYPE_CHECKING:
    import onnx

MOST_BYTES = 1 << 26
_INLINE = "inline it with onnx.inliner.inline_local_functions before"


def read_graph(source: str | os.PathLike[str] | bytes) -> OnnxGraph:
    """Read a graph from a file, or from the bytes of one.

    Raises
    ------
    ValueError
        If the file is damaged or too large, or holds what is no graph of numbers; the message names it.
    ModuleNotFoundError
        If the package ``onnx`` is not installed.
    """
    try:
        import onnx  # an extra
        from google.protobuf.message import DecodeError
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "reading ONNX files needs the package onnx: pip install 'phyfilter-ctl[onnx]'"
        ) from error
    what = "model" if isinstance(source, bytes) else os.fspath(source)
    size = len(source) if isinstance(source, bytes) else Path(source).stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"{what}: expected at most {MOST_BYTES} bytes, got {size}")
    data = source if isinstance(source, bytes) else Path(source).read_bytes()
    try:
        model = onnx.load_model_from_string(data)
        return _graph(model, None if isinstance(source, bytes) else Path(source).parent)
    except DecodeError as error:
        raise ValueError(f"{what}: not an ONNX model, or damaged; export it again") from error
    except RefusedError as error:
        raise ValueError(f"{what}: {error}") from error
    # Malformed fields that nothing above foresaw.
    except (ValueError, TypeError, OverflowError, IndexError) as error:
        raise ValueError(f"{what}: damaged ({error}); export it again") from error


def _graph(model: onnx.ModelProto, folder: Path | None) -> OnnxGraph:
    graph = model.graph
    if model.functions:
        raise RefusedError(f"the model defines its own function {model.functions[0].name!r}; {_INLINE}")
    if graph.sparse_initializer:
        raise RefusedError("sparse constants are not supported")
    if len(graph.node) > MOST_NODES:
        raise RefusedError(f"{len(graph.node)} nodes, more than {MOST_NODES}")
    total = sum(math.prod(tensor.dims) for tensor in graph.initializer)
    if total > MOST_NUMBERS:
        raise RefusedError(f"{total} numbers in its constants, more than {MOST_NUMBERS}")
    constants = {tensor.name: _tensor(tensor, folder) for tensor in graph.initializer}
    inputs = [value for value in graph.input if value.name not in constants]
    if len(inputs) != 1 or len(graph.output) != 1:
        raise RefusedError(
            f"expected one input and one output, got {len(inputs)} and {len(graph.output)}; join them inside the model"
        )
    nodes = []
    for node in graph.node:
        read = _node(node, folder)
        if read.operator == "Constant":
            (value,) = read.attributes.values() if len(read.attributes) == 1 else (None,)
            if not isinstance(value, np.ndarray) or len(read.outputs) != 1:
                raise RefusedError(f"node {node.name!r} (Constant): expected one value of numbers")
            constants[read.outputs[0]] = value
        else:
            nodes.append(read)
    opset = max(
        (entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")), default=20
    )
    return OnnxGraph(
        tuple(nodes),
        constants,
        _shape(inputs[0]),
        input=inputs[0].name,
        output=graph.output[0].name,
        opset=opset,
    )


def _node(node: onnx.NodeProto, folder: Path | None) -> OnnxNode:
    operator = node.op_type if node.domain in ("", "ai.onnx") else f"{node.domain}.{node.op_type}"
    read = operator in OPERATORS or operator == "Constant"  # others are refused by name, whatever they hold
    attributes = {a.name: _attribute(a, operator, folder) for a in node.attribute} if read else {}
    inputs = list(node.input)
    while inputs and not inputs[-1]:
        inputs.pop()
    return OnnxNode(operator, tuple(inputs), tuple(node.output), attributes=attributes, name=node.name)


def _attribute(attribute: onnx.AttributeProto, operator: str, folder: Path | None) -> Attribute:
    from onnx import AttributeProto

    if operator == "Constant":  # an array, which becomes a constant of the graph: no attribute for long
        return _constant(attribute, folder)  # type: ignore[return-value]  # an array, see above
    match attribute.type:
        case AttributeProto.INT:
            return int(attribute.i)
        case AttributeProto.FLOAT:
            return float(attribute.f)
        case AttributeProto.STRING:
            return attribute.s.decode(errors="replace")
        case AttributeProto.INTS:
            return tuple(int(n) for n in attribute.ints)
        case AttributeProto.FLOATS:
            return tuple(float(n) for n in attribute.floats)
        case AttributeProto.TENSOR:
            array = _tensor(attribute.t, folder)
            if array.size == 1:
                return array.reshape(-1).tolist()[0]
    raise RefusedError(f"operator {operator!r}: the attribute {attribute.name!r} is no number and no text")


def _constant(attribute: onnx.AttributeProto, folder: Path | None) -> Array:
    match attribute.name:
        case "value":
            return _tensor(attribute.t, folder)
        case "value_float":
            return np.array(attribute.f)
        case "value_int":
            return np.array(attribute.i)
        case "value_floats":
            return np.array(attribute.floats, dtype=float)
        case "value_ints":
            return np.array(attribute.ints, dtype=np.int64)
    raise RefusedError(f"constants with {attribute.name!r} are not supported")


def _tensor(tensor: onnx.TensorProto, folder: Path | None) -> Array:
    from onnx import TensorProto, external_data_helper, numpy_helper

    what = f"constant {tensor.name!r}"
    known = (
        TensorProto.FLOAT,
        TensorProto.DOUBLE,
        TensorProto.FLOAT16,
        TensorProto.INT64,
        TensorProto.INT32,
        TensorProto.BOOL,
    )
    if tensor.data_type not in known:
        raise RefusedError(f"{what}: {TensorProto.DataType.Name(tensor.data_type)} is not supported")
    if any(n < 0 for n in tensor.dims) or math.prod(tensor.dims) > MOST_NUMBERS:
        raise RefusedError(f"{what}: the shape {list(tensor.dims)} is too large or negative")
    try:
        if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
            _check_place(what, tensor.external_data, folder)
            external_data_helper.load_external_data_for_tensor(tensor, str(folder))
        array: NDArray[np.generic] = numpy_helper.to_array(tensor)
    except RefusedError:
        raise
    except (ValueError, TypeError, OSError, RuntimeError) as error:
        raise RefusedError(f"{what} is damaged ({error})") from error
    return array.astype(float) if array.dtype.kind == "f" else array.astype(np.int64)


def _check_place(what: str, entries: Iterable[onnx.StringStringEntryProto], folder: Path | None) -> None:
    """Only files beside the model are read, and none that is larger than a model may be."""
    if folder is None:
        raise RefusedError(f"{what} is in an external file: give the path of the model instead of its bytes")
    place = {entry.key: entry.value for entry in entries}.get("location", "")
    path = (folder / place).resolve()
    if not place or not path.is_relative_to(folder.resolve()) or not path.is_file():
        raise RefusedError(f"{what}: expected its external file beside the model, got {place!r}")
    if path.stat().st_size > MOST_BYTES:
        raise RefusedError(f"{what}: expected at most {MOST_BYTES} bytes in {place!r}")


def _shape(value: onnx.ValueInfoProto) -> tuple[int | None, ...]:
    """Sizes of the input, None where one is open."""
    from onnx import TensorProto

    tensor = value.type.tensor_type
    if tensor.elem_type not in (TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.FLOAT16):
        raise RefusedError(f"input {value.name!r}: expected a tensor of real numbers")
    sizes = tuple(d.dim_value if d.HasField("dim_value") else None for d in tensor.shape.dim)
    if not sizes:
        return (None, None)
    return sizes
