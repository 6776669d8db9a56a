"""Rules of the operators that only move numbers about."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ._calls import Call
from ._tensors import Tensor, axis_of, joined
from .graph import MOST_NUMBERS, RefusedError

# TensorProto's numbers of float, double and half; of int32 and int64.
_REAL, _WHOLE = (1, 11, 10), (6, 7)


def cast(call: Call) -> Tensor:
    kind, v = call.integer("to", 0), call[0]
    if kind in _REAL:
        return replace(v, whole=False)  # the numbers stay doubles
    if kind in _WHOLE and v.known:
        return Tensor.of(np.trunc(v.numbers("the operand")).astype(np.int64))
    raise RefusedError("expected a cast to single or double precision")


def concat(call: Call) -> Tensor:
    tensors = [call[place] for place in range(max(1, len(call.operands)))]
    return joined(tensors, axis_of(call.integer("axis", 0), len(tensors[0].shape)))


def constant_of_shape(call: Call) -> Tensor:
    shape = call[0].whole_numbers("the shape")
    if any(n < 0 for n in shape) or math.prod(shape) > MOST_NUMBERS:
        raise RefusedError(f"expected a shape of up to {MOST_NUMBERS} numbers, got {shape}")
    value = call.node.attributes.get("value", 0.0)
    if not isinstance(value, int | float):
        raise RefusedError(f"expected one number as value, got {value!r}")
    return Tensor.of(np.full(shape, value))


def dropout(call: Call) -> Tensor:
    training = call.get(2)
    if training is not None and np.any(training.numbers("training_mode")):
        raise RefusedError("expected the form for inference")
    return call[0]


def expand(call: Call) -> Tensor:
    shape = np.broadcast_shapes(call[0].shape, tuple(call[1].whole_numbers("the shape")))
    return call[0].moved_to(shape)


def flatten(call: Call) -> Tensor:
    v, rank = call[0], len(call[0].shape)
    axis = call.integer("axis", 1)
    axis = axis if axis == rank else axis_of(axis, rank) if rank else 0
    return v.reshaped((math.prod(v.shape[:axis]), math.prod(v.shape[axis:])))


def gather(call: Call) -> Tensor:
    v = call[0]
    axis = axis_of(call.integer("axis", 0), len(v.shape))
    if not call[1].whole:
        raise RefusedError("expected whole numbers as indices")
    indices = call[1].numbers("the indices")
    if indices.size * (v.size // max(v.shape[axis], 1)) > MOST_NUMBERS:
        raise RefusedError(f"the result has more than {MOST_NUMBERS} numbers")
    return v.moved(np.take(v.places, indices.astype(np.intp), axis=axis))


def features(call: Call) -> Tensor:
    """Entries along the last axis."""
    v = call[0].reshaped((1, *call[0].shape)) if len(call[0].shape) == 1 else call[0]
    chosen = np.array(call[1].whole_numbers("the indices"), dtype=np.intp)
    return v.moved(np.take(v.places, chosen, axis=-1))


def reshape(call: Call) -> Tensor:
    v, shape = call[0], list(call.listed("shape", 1) or [])
    if not call.integer("allowzero", 0):
        shape = [v.shape[i] if n == 0 and i < len(v.shape) else n for i, n in enumerate(shape)]
    if shape.count(-1) > 1 or any(n < -1 for n in shape):
        raise RefusedError(f"expected at most one open size, got the shape {shape}")
    if -1 in shape:
        rest = math.prod(n for n in shape if n != -1)
        shape[shape.index(-1)] = v.size // rest if rest else 0
    return v.reshaped(shape)


def shape(call: Call) -> Tensor:
    sizes = call[0].shape[call.integer("start", 0) : call.integer("end", len(call[0].shape))]
    return Tensor.of(np.array(sizes, dtype=np.int64))


def sliced(call: Call) -> Tensor:
    v = call[0]
    starts, ends = call.listed("starts", 1), call.listed("ends", 2)
    if starts is None or ends is None:
        raise RefusedError("an operand is missing")
    axes, steps = call.listed("axes", 3) or list(range(len(starts))), call.listed("steps", 4)
    steps = [1] * len(starts) if steps is None else steps
    if 0 in steps:
        raise RefusedError("expected steps other than 0")
    cut = [slice(None)] * len(v.shape)
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        # Backwards, an end before the first entry is no count from the back.
        beyond = step < 0 and end < -v.shape[axis_of(axis, len(v.shape))]
        cut[axis_of(axis, len(v.shape))] = slice(start, None if beyond else end, step)
    return v.moved(v.places[tuple(cut)])


def split(call: Call) -> list[Tensor]:
    v = call[0]
    axis, parts = axis_of(call.integer("axis", 0), len(v.shape)), len(call.node.outputs)
    sizes = call.listed("split", 1)
    if sizes is None:
        each = -(-v.shape[axis] // max(parts, 1))
        sizes = [min(each, v.shape[axis] - each * i) for i in range(parts)]
    if len(sizes) != parts or sum(sizes) != v.shape[axis] or any(n < 0 for n in sizes):
        raise RefusedError(f"expected {parts} parts of {v.shape[axis]} together, got {sizes}")
    edges = np.cumsum(sizes)[:-1].tolist()
    return [v.moved(places) for places in np.split(v.places, edges, axis=axis)]


def squeeze(call: Call) -> Tensor:
    v, rank = call[0], len(call[0].shape)
    given = call.listed("axes", 1)
    axes = (
        [i for i, n in enumerate(v.shape) if n == 1] if given is None else [axis_of(a, rank) for a in given]
    )
    return v.reshaped([n for i, n in enumerate(v.shape) if i not in axes])


def transpose(call: Call) -> Tensor:
    v = call[0]
    order = call.listed("perm")
    return v.moved(v.places.transpose(order))


def unsqueeze(call: Call) -> Tensor:
    v = call[0]
    axes = call.listed("axes", 1)
    if not axes:
        raise RefusedError("expected axes")
    places = np.expand_dims(v.places, tuple(axes))
    return v.reshaped(places.shape)
