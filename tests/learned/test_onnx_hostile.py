"""ONNX files that nobody meant: each is read, or refused in words that name it; never another exception."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
from google.protobuf.descriptor import FieldDescriptor  # noqa: E402  # comes with onnx
from google.protobuf.message import Message  # noqa: E402
from test_onnx import CHAINS, flattened  # noqa: E402
from test_onnx_operators import CASES, model_of  # noqa: E402

from phyfilter_ctl.learned.onnx import OnnxNetwork  # noqa: E402

WHOLE = {name: make().SerializeToString() for name, make in {**CHAINS, "flattened": flattened}.items()}
WHOLE |= {name: model_of(case).SerializeToString() for name, case in CASES.items()}
NUMBERS = [0, 1, -1, 2, 3, 7, 16, 255, 2**31 - 1, -(2**31), 2**32, 2**62, 2**63 - 1, -(2**63)]
REALS = [0.0, -1.0, 1e-300, 3.4e38, float("nan"), float("inf"), float("-inf")]
OPERATORS = [
    "Add",
    "BatchNormalization",
    "Clip",
    "Constant",
    "Gemm",
    "MatMul",
    "Reshape",
    "Relu",
    "Identity",
    "Cast",
    "Concat",
    "Expand",
    "Gather",
    "LayerNormalization",
    "ReduceSum",
    "Slice",
    "Softmax",
    "Split",
    "Transpose",
]


def inside(message: Message) -> Iterator[Message]:
    """The message and all messages in it."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for entry in value if repeated(field) else [value]:
                yield from inside(entry)


def repeated(field: FieldDescriptor) -> bool:
    return hasattr(field.default_value, "__len__") and not isinstance(field.default_value, str | bytes)


@st.composite
def values(draw: st.DrawFn, field: FieldDescriptor, whole: Message) -> object:
    """A value of the field's type that a hostile or broken program may write."""
    if field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        names = {name for message in inside(whole) for name in texts(message)}
        text = draw(st.sampled_from(["", *sorted(names), *OPERATORS]) | st.text(max_size=3))
        return text.encode() if field.type == FieldDescriptor.TYPE_BYTES else text
    if field.cpp_type in (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT):
        return draw(st.sampled_from(REALS))
    if field.cpp_type == FieldDescriptor.CPPTYPE_ENUM:
        return draw(st.sampled_from([value.number for value in field.enum_type.values]))
    return draw(st.sampled_from(NUMBERS))


def texts(message: Message) -> Iterator[str]:
    for field, value in message.ListFields():
        if field.type == FieldDescriptor.TYPE_STRING:
            yield from value if repeated(field) else [value]


@st.composite
def mutated(draw: st.DrawFn) -> bytes:
    """A sound model with some of its fields changed, then some of its bytes."""
    model = onnx.ModelProto.FromString(draw(st.sampled_from(list(WHOLE.values()))))
    for _ in range(draw(st.integers(0, 4))):
        message = draw(st.sampled_from(list(inside(model))))
        field = draw(st.sampled_from(list(message.DESCRIPTOR.fields)))
        old = getattr(message, field.name)
        what = draw(st.sampled_from(["clear", "change", "add"]))
        if what == "clear" and not (repeated(field) and len(old)):
            message.ClearField(field.name)
        elif what == "clear":
            del old[draw(st.integers(0, len(old) - 1))]
        elif field.message_type is not None:
            # As bytes: a message copied into a part of itself crashes the library.
            same = [m.SerializeToString() for m in inside(model) if m.DESCRIPTOR is field.message_type]
            (old.add() if repeated(field) else old).MergeFromString(draw(st.sampled_from(same or [b""])))
        else:
            try:
                value = draw(values(field, model))
                if not repeated(field):
                    setattr(message, field.name, value)
                elif what == "change" and len(old):
                    old[draw(st.integers(0, len(old) - 1))] = value
                else:
                    old.append(value)
            except ValueError:  # out of the field's range
                message.ClearField(field.name)
    data = bytearray(model.SerializeToString())
    for _ in range(draw(st.integers(0, 3))):
        if data:
            at = draw(st.integers(0, len(data) - 1))
            if draw(st.booleans()):
                data[at] = draw(st.integers(0, 255))
            else:
                del data[at : at + draw(st.integers(1, 40))]
    return bytes(data)


def opened(data: bytes) -> OnnxNetwork | str:
    """The network, or why there is none."""
    try:
        return OnnxNetwork.read(data)
    except ValueError as error:
        return str(error)


@pytest.mark.slow
@given(mutated())
def test_mutated_files_are_read_or_refused(data: bytes) -> None:
    found = opened(data)
    if isinstance(found, str):
        assert found.startswith("model: ")
    else:
        n_z, n_x = found.casadi().numel_in(0), found.casadi().numel_out(0)
        assert found.predict(np.zeros((2, n_z))).shape == (2, n_x)
