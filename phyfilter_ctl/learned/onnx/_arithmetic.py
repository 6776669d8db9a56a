"""Rules of the operators that compute: functions of each number, arithmetic, products, normalisation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce

import numpy as np

from . import _columns as fn
from ._calls import Call, Rule
from ._columns import Column
from ._tensors import Tensor, axis_of, count_over, elementwise, greatest, matmul, total
from .graph import RefusedError

# ----------------------------------------------------------------------------------------- functions of one number


def sigmoid(v: Column) -> Column:
    # Finite, and of the right slope, for all v: at 0 too, where fabs has the slope 0.
    return fn.exp(0.5 * (v - fn.fabs(v))) / (1.0 + fn.exp(-fn.fabs(v)))


def softplus(v: Column) -> Column:
    return 0.5 * (v + fn.fabs(v)) + fn.log1p(fn.exp(-fn.fabs(v)))


def exponential_below(v: Column, alpha: float, steepness: float = 1.0) -> Column:
    return fn.fmax(v, 0.0) + alpha * fn.expm1(steepness * fn.fmin(v, 0.0))


def hard_sigmoid(v: Column, alpha: float, beta: float) -> Column:
    return fn.fmax(0.0, fn.fmin(1.0, alpha * v + beta))


def gelu(v: Column, approximate: str) -> Column:
    if approximate not in ("none", "tanh"):
        raise RefusedError(f"approximate: expected 'none' or 'tanh', got {approximate!r}")
    if approximate == "tanh":
        return 0.5 * v * (1.0 + fn.tanh(math.sqrt(2.0 / math.pi) * (v + 0.044715 * (v * v * v))))
    return 0.5 * v * (1.0 + fn.erf(v / math.sqrt(2.0)))


def of_each(function: Callable[..., Column], **defaults: float) -> Rule:
    """A rule for a function of each number, with its attributes."""

    def rule(call: Call) -> Tensor:
        attributes = [call.real(name, default) for name, default in defaults.items()]
        return replace(elementwise(lambda v: function(v, *attributes), call[0]), whole=False)

    return rule


def celu(call: Call) -> Tensor:
    alpha = call.real("alpha", 1.0)
    if alpha <= 0.0:
        raise RefusedError(f"expected alpha > 0, got {alpha}")
    return elementwise(lambda v: exponential_below(v, alpha, 1.0 / alpha), call[0])


def clip(call: Call) -> Tensor:
    limits = []
    for place, (name, default) in enumerate((("min", -math.inf), ("max", math.inf)), start=1):
        tensor = call.get(place)
        if tensor is not None and tensor.size != 1:
            raise RefusedError(f"expected one number as {name}, got shape {tensor.shape}")
        given = call.node.attributes.get(name, default) if tensor is None else tensor.numbers(name).item()
        limits.append(float(given))  # type: ignore[arg-type]  # what is no number is refused by float
    if not limits[0] <= limits[1]:
        raise RefusedError(f"expected limits (least, greatest), got {limits}")
    low, high = limits
    v = call[0]
    v = elementwise(lambda v: fn.fmax(v, low), v) if low > -math.inf else v
    return elementwise(lambda v: fn.fmin(v, high), v) if high < math.inf else v


# --------------------------------------------------------------------------------------------- arithmetic of tensors


def arithmetic(function: Callable[[Column, Column], Column], *, trained: bool = False) -> Rule:
    def rule(call: Call) -> Tensor:
        if len(call.operands) != 2:
            raise RefusedError(f"expected two operands, got {len(call.operands)}; an operand is missing")
        take = call.weight if trained else call.__getitem__
        return elementwise(function, take(0), take(1))

    return rule


def divide(call: Call) -> Tensor:
    if call[0].whole and call[1].whole:
        raise RefusedError("division of whole numbers is not supported")
    if call[1].known and not np.all(call[1].numbers("the divisor")):
        raise RefusedError("division by zero")
    return elementwise(lambda a, b: a / b, call[0], call[1])


def compared(function: Callable[[Column, Column], Column]) -> Rule:
    def rule(call: Call) -> Tensor:
        return replace(elementwise(function, call[0], call[1]), whole=False)

    return rule


def where(call: Call) -> Tensor:
    condition, a, b = call[0], call[1], call[2]
    return replace(elementwise(fn.where, condition, a, b), whole=a.whole and b.whole)


def raised(call: Call) -> Tensor:
    power = elementwise(fn.power, call[0], call[1])
    return replace(power, whole=False)


def variadic(function: Callable[[Column, Column], Column], *, mean: bool = False) -> Rule:
    def rule(call: Call) -> Tensor:
        tensors = [call[place] for place in range(max(1, len(call.operands)))]
        result = reduce(partial(elementwise, function), tensors)
        return elementwise(lambda v: v / len(tensors), result) if mean else result

    return rule


def gemm(call: Call) -> Tensor:
    A, B = call.weight(0), call.weight(1)
    for name, tensor in (("first", A), ("second", B)):
        if len(tensor.shape) != 2:
            raise RefusedError(f"expected a matrix as the {name} operand, got shape {tensor.shape}")
    A = A.moved(A.places.T) if call.integer("transA", 0) else A
    B = B.moved(B.places.T) if call.integer("transB", 0) else B
    alpha, beta = call.real("alpha", 1.0), call.real("beta", 1.0)
    product = matmul(A, B)
    if alpha != 1.0:
        product = elementwise(lambda v: alpha * v, product)
    if call.get(2) is None:
        return product
    C = call.weight(2)
    if np.broadcast_shapes(product.shape, C.shape) != product.shape:
        raise RefusedError(f"expected a third operand for {product.shape}, got shape {C.shape}")
    return elementwise(lambda v, c: v + (c if beta == 1.0 else beta * c), product, C)


def product(call: Call) -> Tensor:
    return matmul(call.weight(0), call.weight(1))


def prelu(call: Call) -> Tensor:
    return elementwise(lambda v, a: fn.fmax(v, 0.0) + a * fn.fmin(v, 0.0), call[0], call.weight(1))


# ----------------------------------------------------------------------------- normalisation, sums along axes


def _axes(call: Call) -> list[int]:
    """Axes of a reduction: all where none are given."""
    rank = len(call[0].shape)
    given = call.listed("axes", 1)
    if not given:
        return [] if call.integer("noop_with_empty_axes", 0) else list(range(rank))
    return [axis_of(axis, rank) for axis in given]


def reduced(function: Callable[..., Tensor], *, mean: bool = False) -> Callable[[Call], Tensor]:
    def rule(call: Call) -> Tensor:
        axes = _axes(call)
        if not axes:
            return call[0]
        result = function(call[0], axes, keep=bool(call.integer("keepdims", 1)))
        count = count_over(call[0], axes)
        return replace(elementwise(lambda v: v / count, result), whole=False) if mean else result

    return rule


def norm(call: Call) -> Tensor:
    """Root of the sum of squares along axes."""
    result = reduced(total_of(lambda v: v * v))(call)
    return replace(elementwise(fn.sqrt, result), whole=False)


def total_of(function: Callable[[Column], Column]) -> Callable[..., Tensor]:
    """The sum along axes of a function of each number."""
    return lambda v, axes, *, keep=True: total(elementwise(function, v), axes, keep=keep)


def distances(call: Call) -> Tensor:
    """From each row of one matrix to each of another: kernels of Gaussian processes are made of them."""
    a, b, metric = call[0], call[1], call.text("metric", "sqeuclidean")
    if metric not in ("sqeuclidean", "euclidean") or len(a.shape) != 2 or len(b.shape) != 2:
        raise RefusedError(
            f"expected Euclidean distances of rows of matrices, got {metric!r} of {a.shape}, {b.shape}"
        )
    apart = elementwise(
        lambda a, b: a - b, a.reshaped((a.shape[0], 1, a.shape[1])), b.reshaped((1, *b.shape))
    )
    squares = total(elementwise(lambda v: v * v, apart), [2], keep=False)
    return squares if metric == "sqeuclidean" else elementwise(fn.sqrt, squares)


def linear_regressor(call: Call) -> Tensor:
    given = call.node.attributes
    C, b = (np.array(given.get(name, ()), dtype=float) for name in ("coefficients", "intercepts"))
    targets = call.integer("targets", 1)
    if call.text("post_transform", "NONE") != "NONE":
        raise RefusedError(f"the post_transform {call.text('post_transform', '')!r} is not supported")
    if targets < 1 or C.size % targets or b.size not in (0, targets):
        raise RefusedError(f"{C.size} coefficients and {b.size} intercepts do not fit {targets} targets")
    product = matmul(call[0], Tensor.of(C.reshape(targets, -1).T))
    return elementwise(lambda v, b: v + b, product, Tensor.of(b)) if b.size else product


def _centred(v: Tensor, axes: list[int]) -> tuple[Tensor, Tensor]:
    """Deviations from the mean over axes, and their mean square."""
    count = count_over(v, axes)
    centred = elementwise(lambda v, s: v - s / count, v, total(v, axes))
    square = total(elementwise(lambda c: c * c, centred), axes)
    return centred, elementwise(lambda s: s / count, square)


def layer_normalization(call: Call) -> Tensor:
    v, rank = call[0], len(call[0].shape)
    axes = list(range(axis_of(call.integer("axis", -1), rank), rank))
    epsilon = call.real("epsilon", 1e-5)
    centred, square = _centred(v, axes)
    scaled = elementwise(lambda c, s, w: w * c / fn.sqrt(s + epsilon), centred, square, call.weight(1))
    shifted = scaled if call.get(2) is None else elementwise(lambda a, b: a + b, scaled, call.weight(2))
    return _like(shifted, v)


def rms_normalization(call: Call) -> Tensor:
    v, rank = call[0], len(call[0].shape)
    axes = list(range(axis_of(call.integer("axis", -1), rank), rank))
    epsilon, count = call.real("epsilon", 1e-5), count_over(v, axes)
    square = total(elementwise(lambda v: v * v, v), axes)
    scaled = elementwise(lambda v, s, w: w * v / fn.sqrt(s / count + epsilon), v, square, call.weight(1))
    return _like(scaled, v)


def batch_normalization(call: Call) -> Tensor:
    v = call[0]
    if call.integer("training_mode", 0) or len([name for name in call.node.outputs if name]) > 1:
        raise RefusedError("expected the form for inference")
    if len(v.shape) < 2:
        raise RefusedError(f"expected samples and channels, got shape {v.shape}")
    epsilon, channels = call.real("epsilon", 1e-5), [v.shape[1], *(1 for _ in v.shape[2:])]
    gain, bias = (call.weight(place).reshaped(channels) for place in (1, 2))
    mean, variance = (call.statistic(place).reshaped(channels) for place in (3, 4))
    if not np.all(variance.numbers("the variance") + epsilon > 0.0):
        raise RefusedError("expected a variance > 0")
    return _like(
        elementwise(
            lambda v, m, s, w, b: (v - m) * (w / fn.sqrt(s + epsilon)) + b, v, mean, variance, gain, bias
        ),
        v,
    )


def softmax(call: Call, *, logarithm: bool = False) -> Tensor:
    v = call[0]
    if call.opset < 13:  # all axes from this one on count as one
        axes = list(range(axis_of(call.integer("axis", 1), len(v.shape)), len(v.shape)))
    else:
        axes = [axis_of(call.integer("axis", -1), len(v.shape))]
    below = elementwise(lambda v, m: v - m, v, greatest(v, axes))  # no exponential overflows
    powers = elementwise(fn.exp, below)
    sums = total(powers, axes)
    if logarithm:
        return elementwise(lambda v, s: v - fn.log(s), below, sums)
    return elementwise(lambda e, s: e / s, powers, sums)


def scaler(call: Call) -> Tensor:
    offset, scale = (np.array(call.node.attributes.get(name, (0.0,))) for name in ("offset", "scale"))
    if scale.dtype.kind not in "fi" or not np.all(np.isfinite(scale)) or not np.all(np.isfinite(offset)):
        raise RefusedError("expected finite numbers as offset and scale")
    v = call[0]
    return _like(elementwise(lambda v, m, s: (v - m) * s, v, Tensor.of(offset), Tensor.of(scale)), v)


def normalizer(call: Call) -> Tensor:
    v, norm = call[0], call.text("norm", "MAX")
    last = [len(v.shape) - 1]
    if norm == "L2":
        size = elementwise(fn.sqrt, total(elementwise(lambda v: v * v, v), last))
    elif norm in ("MAX", "L1"):
        along = greatest if norm == "MAX" else total
        size = along(v if norm == "MAX" else elementwise(fn.fabs, v), last)
    else:
        raise RefusedError(f"expected the norm MAX, L1 or L2, got {norm!r}")
    return elementwise(lambda v, s: v / (s + (1.0 - fn.fabs(fn.sign(s)))), v, size)


def _like(result: Tensor, v: Tensor) -> Tensor:
    """A result that must have the shape of its first operand."""
    if result.shape != v.shape:
        raise RefusedError(f"the operands do not fit the first one: {result.shape} out of {v.shape}")
    return result
