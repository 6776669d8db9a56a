"""Multilayer perceptrons out of ONNX graphs: a chain of supported operators becomes dense layers.

The graph must be a chain from one input to one output, every other operand a constant stored in the model. Nothing
is executed: what is not in the list of supported operators is refused by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._sections import FloatArray
from .dense import Activation, Dense

if TYPE_CHECKING:
    import onnx

# Numbers in all constants of a model (64 MB): far beyond a network that runs in a control loop.
MOST_NUMBERS = 1 << 23

Array = NDArray[np.generic]
Attributes = Mapping[str, "onnx.AttributeProto"]
_SELU = (1.67326319217681884765625, 1.05070102214813232421875)  # defaults of the ONNX operator


class RefusedError(ValueError):
    """A model that is not a multilayer perceptron of supported operators."""


class _Chain:
    """The layers so far, and the affine map that is not in a layer yet: v -> W' v + b, or scale * v + b."""

    def __init__(self, width: int | None) -> None:
        self.width = width
        self.layers: list[tuple[FloatArray, FloatArray, Activation]] = []
        self._fresh()

    def _fresh(self) -> None:
        self.W: FloatArray | None = None
        self.scale, self.b, self.touched = np.ones(1), np.zeros(1), False

    def affine(self, scale: FloatArray, shift: FloatArray) -> None:
        """Follow with scale * v + shift."""
        for values in (scale, shift):
            if values.size > 1:
                self._expect(values.size)
        self.touched = True
        self.b = self.b * scale + shift
        if self.W is None:
            self.scale = self.scale * scale
        else:
            self.W = self.W * scale

    def dense(self, W: FloatArray, b: FloatArray) -> None:
        """Follow with W' v + b."""
        if W.ndim != 2 or W.size == 0:
            raise RefusedError(f"expected a weight matrix, got shape {W.shape}")
        self._expect(W.shape[0])
        if self.W is not None:
            self.activate(Activation("identity"))
        scale, shift = np.broadcast_to(self.scale, W.shape[0]), np.broadcast_to(self.b, W.shape[0])
        self.b = shift @ W + _row(b, W.shape[1])
        self.W, self.width, self.touched = scale[:, None] * W, W.shape[1], True

    def activate(self, activation: Activation) -> None:
        """Follow with an elementwise function; this ends a layer."""
        if self.width is None:
            raise RefusedError(
                "the number of features is unknown: give the input of the model a fixed last dimension"
            )
        # Before memory is set aside: a short file may use one constant, or none, in very many layers.
        total = sum(W.size for W, _, _ in self.layers) + (self.width**2 if self.W is None else self.W.size)
        if total > MOST_NUMBERS:
            raise RefusedError(f"the layers have more than {MOST_NUMBERS} weights")
        W = np.diag(np.broadcast_to(self.scale, self.width)) if self.W is None else self.W
        self.layers.append((W, np.array(np.broadcast_to(self.b, self.width)), activation))
        self._fresh()

    def finish(self) -> Dense:
        if self.touched or not self.layers:
            self.activate(Activation("identity"))
        weights, biases, activations = zip(*self.layers, strict=True)
        return Dense(tuple(weights), tuple(biases), tuple(activations))

    def _expect(self, width: int) -> None:
        if self.width is not None and self.width != width:
            raise RefusedError(f"expected {self.width} channels, got a constant for {width}")
        self.width = width


def dense_layers(model: onnx.ModelProto) -> Dense:
    """The dense layers that the graph of ``model`` computes.

    Raises
    ------
    RefusedError
        If the graph is not a chain of supported operators on constants inside the model.
    """
    graph = model.graph
    if model.functions:
        raise RefusedError(f"the model defines its own function {model.functions[0].name!r}")
    if graph.sparse_initializer:
        raise RefusedError("sparse constants are not supported")
    constants = _constants(graph)
    inputs = [value for value in graph.input if value.name not in constants]
    if len(inputs) != 1 or len(graph.output) != 1:
        raise RefusedError(f"expected one input and one output, got {len(inputs)} and {len(graph.output)}")
    if not inputs[0].name:
        raise RefusedError("the input has no name")  # no name is how an operand that is left out is written
    chain, current = _Chain(_width(inputs[0])), inputs[0].name
    with np.errstate(all="ignore"):  # a layer refuses what is not finite
        for node in graph.node:
            current = _follow(node, chain, current, constants)
    if current != graph.output[0].name:
        raise RefusedError(
            f"expected a chain that ends in the output {graph.output[0].name!r}, got {current!r}"
        )
    return chain.finish()


def _follow(node: onnx.NodeProto, chain: _Chain, current: str, constants: dict[str, Array]) -> str:
    """Take one node into the chain, or its result into the constants; the name of the signal after it."""
    where = f"node {node.name!r} ({node.op_type})"
    if node.domain not in ("", "ai.onnx") or node.op_type not in SUPPORTED:
        name = node.op_type if node.domain in ("", "ai.onnx") else f"{node.domain}.{node.op_type}"
        names = ", ".join(SUPPORTED)
        raise RefusedError(f"operator {name!r} is not supported (node {node.name!r}); supported: {names}")
    attributes = {attribute.name: attribute for attribute in node.attribute}
    outputs = [name for name in node.output if name]
    if len(outputs) != 1:
        raise RefusedError(f"{where}: expected one output, got {len(outputs)}")
    names = list(node.input)
    while names and not names[-1]:
        names.pop()
    others = [name for name in names if name and name != current and name not in constants]
    if others or names.count(current) > 1:
        raise RefusedError(f"{where}: expected a chain, got a branch through {[*others, current][0]!r}")
    try:
        operands = [None if name in (current, "") else constants[name] for name in names]
        if current not in names:
            constants[outputs[0]] = _constant_result(node.op_type, attributes, operands)
            return current
        SUPPORTED[node.op_type](chain, attributes, operands, names.index(current))
    except RefusedError as error:
        raise RefusedError(f"{where}: {error}") from error
    return outputs[0]


Operands = list[Array | None]
Rule = Callable[[_Chain, Attributes, Operands, int], None]


def _gemm(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    if place != 0 or _integer(attributes, "transA", 0):
        raise RefusedError("expected the signal as the first operand, not transposed")
    B = _given(operands, 1)
    if B.ndim != 2:
        raise RefusedError(f"expected a weight matrix, got shape {B.shape}")
    W = (B.T if _integer(attributes, "transB", 0) else B) * _real(attributes, "alpha", 1.0)
    C = operands[2] if len(operands) > 2 else None
    b = np.zeros(1) if C is None else C.astype(float) * _real(attributes, "beta", 1.0)
    chain.dense(W, b)


def _matmul(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    if place != 0:
        raise RefusedError("expected the signal as the first operand")
    chain.dense(_given(operands, 1), np.zeros(1))


def _add(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    chain.affine(np.ones(1), _row(_given(operands, 1 - place), chain.width))


def _sub(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    sign = 1.0 if place == 0 else -1.0
    chain.affine(np.array([sign]), -sign * _row(_given(operands, 1 - place), chain.width))


def _mul(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    chain.affine(_row(_given(operands, 1 - place), chain.width), np.zeros(1))


def _div(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    if place != 0:
        raise RefusedError("division by the signal is not supported")
    divisor = _row(_given(operands, 1), chain.width)
    if not np.all(divisor):
        raise RefusedError("division by zero")
    chain.affine(1.0 / divisor, np.zeros(1))


def _neg(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    chain.affine(-np.ones(1), np.zeros(1))


def _batch_normalization(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    if place != 0 or _integer(attributes, "training_mode", 0):
        raise RefusedError("expected the form for inference")
    gain, bias, mean, variance = (_row(_given(operands, i), chain.width) for i in range(1, 5))
    denominator = variance + _real(attributes, "epsilon", 1e-5)
    if not np.all(denominator > 0.0):
        raise RefusedError("expected a variance > 0")
    scale = gain / np.sqrt(denominator)
    chain.affine(scale, bias - mean * scale)


def _cast(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    _real_type(attributes)  # the numbers stay doubles


def _identity(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    return


def _dropout(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    training = operands[2] if len(operands) > 2 else None
    if place != 0 or (training is not None and np.any(training)):
        raise RefusedError("expected the form for inference")


def _flatten(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    if _integer(attributes, "axis", 1) != 1:
        raise RefusedError("expected axis 1: one row for each sample")


def _reshape(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    shape = [int(n) for n in np.ravel(_given(operands, 1))] if place == 0 else []
    keeps_rows = len(shape) == 2 and (
        shape[0] == -1 or (shape[0] == 0 and not _integer(attributes, "allowzero", 0))
    )
    if not keeps_rows or shape[1] not in (-1, chain.width) or shape == [-1, -1]:
        raise RefusedError(
            f"expected to keep one row of {chain.width} for each sample, got the shape {shape}"
        )


def _clip(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    limits = [-np.inf, np.inf]
    for i, name in enumerate(("min", "max")):
        operand = operands[i + 1] if len(operands) > i + 1 else None
        if operand is not None and operand.size != 1:
            raise RefusedError(f"expected one number as {name}, got shape {operand.shape}")
        limits[i] = _real(attributes, name, limits[i]) if operand is None else float(operand.item())
    if place != 0 or not limits[0] <= limits[1]:
        raise RefusedError(f"expected limits (least, greatest), got {limits}")
    chain.activate(Activation("clip", *limits))


def _elementwise(name: str, first: float | None = None, second: float | None = None) -> Rule:
    """A rule for an activation, with its defaults for the attributes alpha and gamma."""

    def rule(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
        alpha = 0.0 if first is None else _real(attributes, "alpha", first)
        gamma = 0.0 if second is None else _real(attributes, "gamma", second)
        chain.activate(Activation(name, alpha, gamma))

    return rule


def _constant(chain: _Chain, attributes: Attributes, operands: Operands, place: int) -> None:
    raise RefusedError("expected no operands")


SUPPORTED: dict[str, Rule] = {
    "Add": _add,
    "BatchNormalization": _batch_normalization,
    "Cast": _cast,
    "Clip": _clip,
    "Constant": _constant,
    "Div": _div,
    "Dropout": _dropout,
    "Elu": _elementwise("elu", 1.0),
    "Flatten": _flatten,
    "Gemm": _gemm,
    "Identity": _identity,
    "LeakyRelu": _elementwise("leaky_relu", 0.01),
    "MatMul": _matmul,
    "Mul": _mul,
    "Neg": _neg,
    "Relu": _elementwise("relu"),
    "Reshape": _reshape,
    "Selu": _elementwise("selu", *_SELU),
    "Sigmoid": _elementwise("sigmoid"),
    "Softplus": _elementwise("softplus"),
    "Softsign": _elementwise("softsign"),
    "Sub": _sub,
    "Tanh": _elementwise("tanh"),
}


def _constant_result(operator: str, attributes: Attributes, operands: Operands) -> Array:
    """What a node without the signal gives: exporters keep weights behind such nodes."""
    if operator == "Constant":
        return _constant_value(attributes)
    if operator == "Identity":
        return _present(operands, 0)
    if operator == "Cast":
        _real_type(attributes)
        return _present(operands, 0)
    raise RefusedError("expected an operand that depends on the input, got constants only")


def _constant_value(attributes: Attributes) -> Array:
    for name, attribute in attributes.items():
        if name == "value":
            return _tensor(attribute.t)
        if name in ("value_float", "value_int"):
            return np.array(attribute.f if name == "value_float" else attribute.i)
        if name in ("value_floats", "value_ints"):
            return np.array(attribute.floats if name == "value_floats" else attribute.ints)
    raise RefusedError(f"constants with {sorted(attributes)} are not supported")


def _constants(graph: onnx.GraphProto) -> dict[str, Array]:
    total = sum(math.prod(tensor.dims) for tensor in graph.initializer)
    if total > MOST_NUMBERS:
        raise RefusedError(f"{total} numbers in its constants, more than {MOST_NUMBERS}")
    return {tensor.name: _tensor(tensor) for tensor in graph.initializer}


def _tensor(tensor: onnx.TensorProto) -> Array:
    from onnx import TensorProto, numpy_helper

    what = f"constant {tensor.name!r}"
    if tensor.data_location == TensorProto.EXTERNAL or tensor.external_data:
        raise RefusedError(f"{what} is in an external file; store it inside the model")
    number = (
        TensorProto.FLOAT,
        TensorProto.DOUBLE,
        TensorProto.FLOAT16,
        TensorProto.INT64,
        TensorProto.INT32,
    )
    if tensor.data_type not in (*number, TensorProto.BOOL):
        raise RefusedError(f"{what}: {TensorProto.DataType.Name(tensor.data_type)} is not supported")
    if any(n < 0 for n in tensor.dims) or math.prod(tensor.dims) > MOST_NUMBERS:
        raise RefusedError(f"{what}: the shape {list(tensor.dims)} is too large or negative")
    try:
        return numpy_helper.to_array(tensor)
    except (ValueError, TypeError) as error:
        raise RefusedError(f"{what} is damaged ({error})") from error


def _width(value: onnx.ValueInfoProto) -> int | None:
    """Number of features of the input: the product of what follows the axis of the samples, None if open."""
    from onnx import TensorProto

    tensor = value.type.tensor_type
    if tensor.elem_type not in (TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.FLOAT16):
        raise RefusedError(f"input {value.name!r}: expected a tensor of real numbers")
    dims = tensor.shape.dim
    if len(dims) == 0:
        return None
    widths = [d.dim_value if d.HasField("dim_value") else 0 for d in (dims if len(dims) == 1 else dims[1:])]
    return math.prod(widths) or None


def _row(values: FloatArray, width: int | None) -> FloatArray:
    """A constant that is the same for every sample, as a vector (width,) or (1,)."""
    if values.size != 1 and values.shape not in ((values.size,), (1, values.size)):
        raise RefusedError(f"expected one number for each channel, got shape {values.shape}")
    if values.size not in (1, width or values.size):
        raise RefusedError(f"expected {width} channels, got a constant for {values.size}")
    return values.reshape(-1)


def _present(operands: Operands, place: int) -> Array:
    operand = operands[place] if place < len(operands) else None
    if operand is None:
        raise RefusedError("an operand is missing")
    return operand


def _given(operands: Operands, place: int) -> FloatArray:
    return _present(operands, place).astype(float)


def _integer(attributes: Attributes, name: str, default: int) -> int:
    return int(attributes[name].i) if name in attributes else default


def _real(attributes: Attributes, name: str, default: float) -> float:
    return float(attributes[name].f) if name in attributes else default


def _real_type(attributes: Attributes) -> None:
    from onnx import TensorProto

    if _integer(attributes, "to", 0) not in (TensorProto.FLOAT, TensorProto.DOUBLE):
        raise RefusedError("expected a cast to single or double precision")
