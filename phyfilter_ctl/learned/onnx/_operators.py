"""The operators of ONNX that are supported, each written once, on columns of numbers, with or without a gradient, or of
CasADi expressions.

https://onnx.ai/onnx/operators gives their definitions; where a version of the operators moved an attribute to an
operand, both are read.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from . import _arithmetic, _moving
from . import _columns as fn
from ._arithmetic import of_each
from ._calls import Rule
from ._tensors import elementwise, folded, greatest, total

__all__ = ["OPERATORS"]

_SELU = (1.67326319217681884765625, 1.05070102214813232421875)  # defaults of the operator

OPERATORS: dict[str, Rule] = {
    "Abs": of_each(fn.fabs),
    "Add": _arithmetic.arithmetic(lambda a, b: a + b, trained=True),
    "And": _arithmetic.compared(lambda a, b: a * b),
    "Atan": of_each(fn.atan),
    "BatchNormalization": _arithmetic.batch_normalization,
    "Cast": _moving.cast,
    "Celu": _arithmetic.celu,
    "Clip": _arithmetic.clip,
    "Concat": _moving.concat,
    "ConstantOfShape": _moving.constant_of_shape,
    "Cos": of_each(fn.cos),
    "Div": _arithmetic.divide,
    "Dropout": _moving.dropout,
    "Elu": of_each(_arithmetic.exponential_below, alpha=1.0),
    "Equal": _arithmetic.compared(fn.compared("eq", np.equal)),
    "Erf": of_each(fn.erf),
    "Exp": of_each(fn.exp),
    "Expand": _moving.expand,
    "Flatten": _moving.flatten,
    "Gather": _moving.gather,
    "Gelu": lambda call: elementwise(
        lambda v: _arithmetic.gelu(v, call.text("approximate", "none")), call[0]
    ),
    "Gemm": _arithmetic.gemm,
    "Greater": _arithmetic.compared(fn.compared("gt", np.greater)),
    "GreaterOrEqual": _arithmetic.compared(fn.compared("ge", np.greater_equal)),
    "HardSigmoid": of_each(_arithmetic.hard_sigmoid, alpha=0.2, beta=0.5),
    "HardSwish": of_each(lambda v: v * _arithmetic.hard_sigmoid(v, 1.0 / 6.0, 0.5)),
    "Identity": lambda call: call[0],
    "IsNaN": of_each(lambda v: fn.compared("ne", np.not_equal)(v, v)),
    "LayerNormalization": _arithmetic.layer_normalization,
    "LeakyRelu": of_each(lambda v, alpha: fn.fmax(v, 0.0) + alpha * fn.fmin(v, 0.0), alpha=0.01),
    "Less": _arithmetic.compared(fn.compared("lt", np.less)),
    "LessOrEqual": _arithmetic.compared(fn.compared("le", np.less_equal)),
    "Log": of_each(fn.log),
    "LogSoftmax": partial(_arithmetic.softmax, logarithm=True),
    "MatMul": _arithmetic.product,
    "Max": _arithmetic.variadic(fn.fmax),
    "Mean": _arithmetic.variadic(lambda a, b: a + b, mean=True),
    "Min": _arithmetic.variadic(fn.fmin),
    "Mish": of_each(lambda v: v * fn.tanh(_arithmetic.softplus(v))),
    "Mul": _arithmetic.arithmetic(lambda a, b: a * b),
    "Neg": lambda call: elementwise(lambda v: -v, call[0]),
    "Not": of_each(lambda v: 1.0 - v),
    "Or": _arithmetic.compared(fn.fmax),
    "PRelu": _arithmetic.prelu,
    "Pow": _arithmetic.raised,
    "RMSNormalization": _arithmetic.rms_normalization,
    "Reciprocal": of_each(lambda v: 1.0 / v),
    "ReduceL1": _arithmetic.reduced(_arithmetic.total_of(fn.fabs)),
    "ReduceL2": _arithmetic.norm,
    "ReduceMax": _arithmetic.reduced(greatest),
    "ReduceMean": _arithmetic.reduced(total, mean=True),
    "ReduceMin": _arithmetic.reduced(partial(folded, fn.fmin)),
    "ReduceProd": _arithmetic.reduced(partial(folded, lambda a, b: a * b)),
    "ReduceSum": _arithmetic.reduced(total),
    "ReduceSumSquare": _arithmetic.reduced(_arithmetic.total_of(lambda v: v * v)),
    "Relu": of_each(lambda v: fn.fmax(v, 0.0)),
    "Reshape": _moving.reshape,
    "Selu": of_each(lambda v, a, g: g * _arithmetic.exponential_below(v, a), alpha=_SELU[0], gamma=_SELU[1]),
    "Shape": _moving.shape,
    "Sigmoid": of_each(_arithmetic.sigmoid),
    "Sign": of_each(fn.sign),
    "Sin": of_each(fn.sin),
    "Slice": _moving.sliced,
    "Softmax": _arithmetic.softmax,
    "Softplus": of_each(_arithmetic.softplus),
    "Softsign": of_each(lambda v: v / (1.0 + fn.fabs(v))),
    "Split": _moving.split,
    "Sqrt": of_each(fn.sqrt),
    "Squeeze": _moving.squeeze,
    "Sub": _arithmetic.arithmetic(lambda a, b: a - b),
    "Sum": _arithmetic.variadic(lambda a, b: a + b),
    "Swish": of_each(lambda v, alpha: v * _arithmetic.sigmoid(alpha * v), alpha=1.0),
    "Tanh": of_each(fn.tanh),
    "Transpose": _moving.transpose,
    "Unsqueeze": _moving.unsqueeze,
    "Where": _arithmetic.where,
    "ai.onnx.ml.ArrayFeatureExtractor": _moving.features,
    "ai.onnx.ml.LinearRegressor": _arithmetic.linear_regressor,
    "ai.onnx.ml.Normalizer": _arithmetic.normalizer,
    "ai.onnx.ml.Scaler": _arithmetic.scaler,
    "com.microsoft.CDist": _arithmetic.distances,
}
