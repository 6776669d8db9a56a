"""The operators of ONNX that are supported, each written once, on columns of numbers, with or without a gradient, or of
CasADi expressions.

https://onnx.ai/onnx/operators gives their definitions; where a version of the operators moved an attribute to an
operand, both are read.
"""

from __future__ import annotations

from functools import partial

from . import arithmetic, moving
from . import columns as fn
from .arithmetic import of_each
from .calls import Rule
from .tensors import elementwise, greatest, total

__all__ = ["OPERATORS"]

_SELU = (1.67326319217681884765625, 1.05070102214813232421875)  # defaults of the operator

OPERATORS: dict[str, Rule] = {
    "Abs": of_each(fn.fabs),
    "Add": arithmetic.arithmetic(lambda a, b: a + b, trained=True),
    "BatchNormalization": arithmetic.batch_normalization,
    "Cast": moving.cast,
    "Celu": arithmetic.celu,
    "Clip": arithmetic.clip,
    "Concat": moving.concat,
    "ConstantOfShape": moving.constant_of_shape,
    "Cos": of_each(fn.cos),
    "Div": arithmetic.divide,
    "Dropout": moving.dropout,
    "Elu": of_each(arithmetic.exponential_below, alpha=1.0),
    "Erf": of_each(fn.erf),
    "Exp": of_each(fn.exp),
    "Expand": moving.expand,
    "Flatten": moving.flatten,
    "Gather": moving.gather,
    "Gelu": lambda call: elementwise(lambda v: arithmetic.gelu(v, call.text("approximate", "none")), call[0]),
    "Gemm": arithmetic.gemm,
    "HardSigmoid": of_each(arithmetic.hard_sigmoid, alpha=0.2, beta=0.5),
    "HardSwish": of_each(lambda v: v * arithmetic.hard_sigmoid(v, 1.0 / 6.0, 0.5)),
    "Identity": lambda call: call[0],
    "LayerNormalization": arithmetic.layer_normalization,
    "LeakyRelu": of_each(lambda v, alpha: fn.fmax(v, 0.0) + alpha * fn.fmin(v, 0.0), alpha=0.01),
    "Log": of_each(fn.log),
    "LogSoftmax": partial(arithmetic.softmax, logarithm=True),
    "MatMul": arithmetic.product,
    "Max": arithmetic.variadic(fn.fmax),
    "Mean": arithmetic.variadic(lambda a, b: a + b, mean=True),
    "Min": arithmetic.variadic(fn.fmin),
    "Mish": of_each(lambda v: v * fn.tanh(arithmetic.softplus(v))),
    "Mul": arithmetic.arithmetic(lambda a, b: a * b),
    "Neg": lambda call: elementwise(lambda v: -v, call[0]),
    "PRelu": arithmetic.prelu,
    "Pow": arithmetic.raised,
    "RMSNormalization": arithmetic.rms_normalization,
    "Reciprocal": of_each(lambda v: 1.0 / v),
    "ReduceMax": arithmetic.reduced(greatest),
    "ReduceMean": arithmetic.reduced(total, mean=True),
    "ReduceSum": arithmetic.reduced(total),
    "Relu": of_each(lambda v: fn.fmax(v, 0.0)),
    "Reshape": moving.reshape,
    "Selu": of_each(lambda v, a, g: g * arithmetic.exponential_below(v, a), alpha=_SELU[0], gamma=_SELU[1]),
    "Shape": moving.shape,
    "Sigmoid": of_each(arithmetic.sigmoid),
    "Sign": of_each(fn.sign),
    "Sin": of_each(fn.sin),
    "Slice": moving.sliced,
    "Softmax": arithmetic.softmax,
    "Softplus": of_each(arithmetic.softplus),
    "Softsign": of_each(lambda v: v / (1.0 + fn.fabs(v))),
    "Split": moving.split,
    "Sqrt": of_each(fn.sqrt),
    "Squeeze": moving.squeeze,
    "Sub": arithmetic.arithmetic(lambda a, b: a - b),
    "Sum": arithmetic.variadic(lambda a, b: a + b),
    "Swish": of_each(lambda v, alpha: v * arithmetic.sigmoid(alpha * v), alpha=1.0),
    "Tanh": of_each(fn.tanh),
    "Transpose": moving.transpose,
    "Unsqueeze": moving.unsqueeze,
    "ai.onnx.ml.Normalizer": arithmetic.normalizer,
    "ai.onnx.ml.Scaler": arithmetic.scaler,
}
