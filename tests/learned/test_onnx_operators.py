"""Every supported operator against the reference evaluator of onnx: value, expression, gradient."""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from phyfilter_ctl.learned.onnx import OnnxNetwork
from phyfilter_ctl.learned.onnx._operators import OPERATORS

onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
TensorProto, helper, numpy_helper = onnx.TensorProto, onnx.helper, onnx.numpy_helper
ReferenceEvaluator = importlib.import_module("onnx.reference").ReferenceEvaluator

# The same formulas in another order, in double precision, on numbers of size 10; attributes come in single.
SAME_FORMULA = 1e-12
SINGLE_ATTRIBUTE = 1e-6
# Central differences: their second order of this step, and rounding of sums of size 100 over it.
STEP, DIFFERENCES = 1e-6, 3e-8
ROWS = 6


@dataclass(frozen=True)
class Case:
    """A network of one operator, or of a few, on z (N, 3) or of another shape."""

    nodes: list[tuple]
    constants: dict[str, object]
    shape: tuple = ("N", 3)
    opset: int = 20
    positive: bool = False
    rounding: float = SAME_FORMULA


def one(operator: str, *operands: object, **options: object) -> Case:
    """z first, constants after; what Case knows of goes there, the rest are attributes."""
    own = {name: options.pop(name) for name in ("shape", "opset", "positive", "rounding") if name in options}
    names = [f"c{i}" for i in range(len(operands))]
    node = (operator, ["z", *names], ["f"], options)
    return Case([node], dict(zip(names, operands, strict=True)), **own)


RNG = np.random.default_rng(3)
W, SQUARE, ROW = RNG.standard_normal((3, 4)), RNG.standard_normal((3, 3)), np.array([0.5, -2.0, 3.0])
CUBE = ("N", 2, 3)
SHAPES = [
    ("Shape", ["z"], ["s"], {}),
    ("Gather", ["s", "first"], ["n"], {}),
    ("ConstantOfShape", ["one"], ["zero"], {"value": helper.make_tensor("", TensorProto.INT64, [1], [0])}),
    ("Sub", ["zero", "one"], ["rest"], {}),
    ("Concat", ["n", "rest"], ["both"], {"axis": 0}),
    ("Reshape", ["z", "both"], ["v"], {}),
    ("MatMul", ["v", "W"], ["f"], {}),
]
CASES: dict[str, Case] = {
    **{
        name.lower(): one(name)
        for name in (
            *("Abs", "Atan", "Cos", "Elu", "Exp", "Identity", "Mish", "Neg"),
            *("Reciprocal", "Relu", "Selu", "Sigmoid", "Sign", "Sin", "Softplus", "Softsign", "Tanh"),
        )
    },
    # Constants that the reference keeps in single precision, or a function that it rounds to it.
    **{
        name.lower(): one(name, rounding=SINGLE_ATTRIBUTE)
        for name in ("Erf", "Gelu", "HardSigmoid", "HardSwish", "LeakyRelu")
    },
    "sqrt": one("Sqrt", positive=True),
    "log": one("Log", positive=True),
    "elu, alpha": one("Elu", alpha=0.75),
    "celu": one("Celu", alpha=0.5, rounding=SINGLE_ATTRIBUTE),
    "hard sigmoid, attributes": one("HardSigmoid", alpha=0.25, beta=0.75),
    "leaky, alpha": one("LeakyRelu", alpha=0.25),
    "gelu, tanh": one("Gelu", approximate="tanh", rounding=SINGLE_ATTRIBUTE),
    "swish": one("Swish", alpha=0.5, opset=24),
    "clip": one("Clip", np.array(-0.5), np.array(0.75)),
    "clip, attributes": one("Clip", min=-0.5, max=0.75, opset=6),
    "add": one("Add", ROW),
    "add, single": one("Add", np.array(2.0)),
    "add, itself": Case([("Add", ["z", "z"], ["f"], {})], {}),
    "sub": one("Sub", ROW[None]),
    "mul": one("Mul", ROW),
    "div": one("Div", ROW),
    "div by z": Case([("Div", ["c", "z"], ["f"], {})], {"c": ROW}, positive=True),
    "pow": one("Pow", np.array(2.0)),
    "pow of z": Case([("Pow", ["c", "z"], ["f"], {})], {"c": np.array(1.5)}),
    "prelu": one("PRelu", ROW),
    "max": one("Max", ROW, np.array(0.1)),
    "min": one("Min", ROW),
    "sum": one("Sum", ROW, np.array(1.0)),
    "mean": one("Mean", ROW),
    "gemm": one("Gemm", W, np.arange(4.0)),
    "gemm, options": one("Gemm", W.T.copy(), np.ones((1, 4)), transB=1, alpha=0.5, beta=2.0),
    "matmul": one("MatMul", W),
    "matmul, stacked": one("MatMul", RNG.standard_normal((3, 5)), shape=CUBE),
    "matmul, vector": Case(
        [("MatMul", ["z", "w"], ["v"], {}), ("Unsqueeze", ["v", "axis"], ["f"], {})],
        {"w": ROW, "axis": np.array([1])},
    ),
    "attention": Case(
        [
            ("MatMul", ["z", "W"], ["q"], {}),
            ("Transpose", ["q"], ["k"], {"perm": [0, 2, 1]}),
            ("MatMul", ["q", "k"], ["s"], {}),
            ("Softmax", ["s"], ["w"], {"axis": -1}),
            ("MatMul", ["w", "z"], ["f"], {}),
        ],
        {"W": SQUARE},
        shape=CUBE,
    ),
    "layer normalisation": one("LayerNormalization", ROW, 2.0 * ROW, epsilon=0.125),
    "layer normalisation, two axes": one("LayerNormalization", SQUARE[:2], shape=CUBE, axis=1, epsilon=0.125),
    "rms normalisation": one("RMSNormalization", ROW, opset=23, epsilon=0.125),
    "batch normalisation": one("BatchNormalization", ROW, -ROW, 2.0 * ROW, ROW**2, epsilon=0.125),
    "batch normalisation, channels": one(
        "BatchNormalization", *(ROW[:2] ** k for k in (1, 2, 3, 4)), shape=CUBE, epsilon=0.125
    ),
    "softmax": one("Softmax"),
    "softmax, axis": one("Softmax", axis=1, shape=CUBE),
    "softmax, old": one("Softmax", axis=2, shape=CUBE, opset=11),
    "log softmax": one("LogSoftmax"),
    "reduce mean": one("ReduceMean", np.array([1]), keepdims=1),
    "reduce mean, old": one("ReduceMean", axes=[1, 2], keepdims=0, shape=("N", 2, 3, 2), opset=13),
    "reduce sum": one("ReduceSum", np.array([-1]), keepdims=0, shape=CUBE),
    "reduce max": one("ReduceMax", np.array([1]), shape=CUBE),
    "concat": Case(
        [("Tanh", ["z"], ["h"], {}), ("Concat", ["h", "z", "h"], ["f"], {"axis": 1})],
        {},
    ),
    "split": Case(
        [("Split", ["z", "sizes"], ["a", "b"], {"axis": 1}), ("Mul", ["a", "b"], ["f"], {})],
        {"sizes": np.array([1, 2])},
    ),
    "split, even": Case(
        [("Split", ["z"], ["a", "b"], {"axis": 1, "num_outputs": 2}), ("Mul", ["a", "b"], ["f"], {})], {}
    ),
    "slice": one("Slice", np.array([2]), np.array([-9]), np.array([1]), np.array([-1])),
    "slice, old": one("Slice", starts=[0, 1], ends=[1, 9], axes=[1, 2], shape=CUBE, opset=9),
    "gather": one("Gather", np.array([2, 0, 2]), axis=1),
    "gather, one": one("Gather", np.array(1), axis=1, shape=CUBE),
    "expand": one("Expand", np.array([1, 3]), shape=("N", 1)),
    "flatten": one("Flatten", shape=CUBE),
    "reshape": one("Reshape", np.array([0, 3, -1]), shape=CUBE),
    "squeeze": one("Squeeze", np.array([1]), shape=("N", 1, 3)),
    "squeeze, old": one("Squeeze", axes=[1], shape=("N", 1, 3), opset=11),
    "unsqueeze": one("Unsqueeze", np.array([1])),
    "transpose": one("Transpose", perm=[0, 2, 1], shape=CUBE),
    "cast": one("Cast", to=TensorProto.DOUBLE),
    "dropout": one("Dropout"),
    "shapes": Case(SHAPES, {"first": np.array([0]), "one": np.array([1]), "W": W[:, :2]}, shape=("N", 3, 1)),
    "branches": Case(
        [
            ("Greater", ["z", "c"], ["above"], {}),
            ("LessOrEqual", ["z", "d"], ["below"], {}),
            ("And", ["above", "below"], ["between"], {}),
            ("Mul", ["z", "z"], ["square"], {}),
            ("Where", ["between", "square", "c"], ["f"], {}),
        ],
        {"c": 0.1 * ROW, "d": np.array(2.0)},
    ),
    "other branches": Case(
        [
            ("Less", ["z", "c"], ["below"], {}),
            ("GreaterOrEqual", ["z", "d"], ["above"], {}),
            ("Or", ["above", "below"], ["outside"], {}),
            ("Not", ["outside"], ["between"], {}),
            ("Where", ["between", "z", "d"], ["v"], {}),
            ("Equal", ["z", "z"], ["same"], {}),
            ("IsNaN", ["z"], ["not a number"], {}),
            ("Or", ["not a number", "same"], ["always"], {}),
            ("Where", ["always", "v", "c"], ["f"], {}),
        ],
        {"c": 0.1 * ROW, "d": np.array(2.0)},
    ),
    "reduce min": one("ReduceMin", np.array([1]), shape=CUBE),
    "reduce prod": one("ReduceProd", np.array([1])),
    "reduce norms": Case(
        [
            ("ReduceL1", ["z", "axis"], ["a"], {}),
            ("ReduceL2", ["z", "axis"], ["b"], {}),
            ("ReduceSumSquare", ["z", "axis"], ["c"], {}),
            ("Concat", ["a", "b", "c"], ["f"], {"axis": 1}),
        ],
        {"axis": np.array([1])},
    ),
    "array feature extractor": one("ai.onnx.ml.ArrayFeatureExtractor", np.array([2, 0])),
    "linear regressor": one(
        "ai.onnx.ml.LinearRegressor",
        coefficients=[0.5, 1.0, 2.0, -1.0, 0.25, 3.0],
        intercepts=[1.0, -2.0],
        targets=2,
    ),
    "distances": one("com.microsoft.CDist", W.T.copy(), metric="euclidean"),
    "squared distances": one("com.microsoft.CDist", W.T.copy(), metric="sqeuclidean"),
    "scaler": one("ai.onnx.ml.Scaler", offset=[0.5, 1.0, 2.0], scale=[2.0, 0.25, -1.0]),
    **{
        f"normalizer, {norm}": one(
            "ai.onnx.ml.Normalizer", norm=norm, positive=norm == "MAX", rounding=SINGLE_ATTRIBUTE
        )
        for norm in ("L1", "L2", "MAX")
    },
}


def model_of(case: Case) -> onnx.ModelProto:
    nodes = []
    for number, (operator, inputs, outputs, attributes) in enumerate(case.nodes):
        domain, _, name = operator.rpartition(".")
        nodes.append(
            helper.make_node(name, inputs, outputs, name=f"node {number}", domain=domain, **attributes)
        )
    graph = helper.make_graph(
        nodes,
        "case",
        [helper.make_tensor_value_info("z", TensorProto.DOUBLE, case.shape)],
        [helper.make_tensor_value_info("f", TensorProto.DOUBLE, None)],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in case.constants.items()],
    )
    others = (("ai.onnx.ml", 3), ("com.microsoft", 1))
    versions = [helper.make_opsetid("", case.opset), *(helper.make_opsetid(*other) for other in others)]
    return helper.make_model(graph, opset_imports=versions, ir_version=9)


class CDist(importlib.import_module("onnx.reference.op_run").OpRun):  # type: ignore[misc]  # of a module named at run time
    """ONNX Runtime's own, which the reference does not know."""

    op_domain = "com.microsoft"

    def _run(self, a: np.ndarray, b: np.ndarray, metric: str = "") -> tuple[np.ndarray]:
        return (cdist(a, b, metric),)


def rows_of(case: Case) -> np.ndarray:
    z = np.random.default_rng(7).uniform(-3.0, 3.0, (ROWS, *case.shape[1:]))
    return 0.5 + np.abs(z) if case.positive else z


def network_of(case: Case) -> OnnxNetwork:
    return OnnxNetwork.read(model_of(case).SerializeToString())


@pytest.mark.parametrize("name", CASES)
def test_value_is_that_of_the_reference(name: str) -> None:
    case = CASES[name]
    if case.opset > onnx.defs.onnx_opset_version():
        pytest.skip(f"this onnx knows operators up to version {onnx.defs.onnx_opset_version()}")
    z = rows_of(case)
    (expected,) = ReferenceEvaluator(model_of(case), new_ops=[CDist]).run(None, {"z": z})
    f = network_of(case).predict(z.reshape(ROWS, -1))
    np.testing.assert_allclose(f, np.asarray(expected).reshape(ROWS, -1), rtol=0.0, atol=case.rounding * 30.0)


@pytest.mark.parametrize("name", CASES)
def test_expression_is_the_value(name: str) -> None:
    case = CASES[name]
    z, network = rows_of(case).reshape(ROWS, -1), network_of(case)
    expected = network.casadi().map(ROWS)(z.T).full().T
    np.testing.assert_allclose(network.predict(z), expected, rtol=0.0, atol=SAME_FORMULA * 30.0)


def wrapped(case: Case) -> Case:
    """The case between two layers whose weights a gradient reaches through it."""
    n = int(np.prod(case.shape[1:]))
    nodes = [
        ("MatMul", ["z0", "before"], ["z1"], {}),
        ("Reshape", ["z1", "unflattened"], ["z"], {}),
        *case.nodes,
        ("Flatten", ["f"], ["f1"], {}),
        ("PRelu", ["f1", "slopes"], ["f2"], {}),
    ]
    rng = np.random.default_rng(11)
    wide = network_of(case).predict(rows_of(case).reshape(ROWS, -1)).shape[1]
    more = {
        "before": np.eye(n) + 0.1 * rng.uniform(0.0, 1.0, (n, n)),
        "unflattened": np.array([0, *case.shape[1:]]),
        "slopes": rng.standard_normal(wide),
    }
    return Case(nodes, {**case.constants, **more}, ("N", n), case.opset, case.positive)


def wrapped_network(case: Case) -> OnnxNetwork:
    proto = model_of(wrapped(case))
    proto.graph.input[0].name, proto.graph.output[0].name = "z0", "f2"
    return OnnxNetwork.read(proto.SerializeToString())


@pytest.mark.parametrize("name", [name for name in CASES if CASES[name].opset >= 13])
def test_gradient_is_the_slope_of_differences(name: str) -> None:
    """In weights before the operator, in it and after it."""
    case = CASES[name]
    network, z = wrapped_network(case), rows_of(case).reshape(ROWS, -1)
    p = network.parameters
    cotangent = np.random.default_rng(5).standard_normal(network.predict(z).shape)

    def cost(k: int, step: float) -> float:
        moved = p.copy()
        moved[k] += step
        return float(np.sum(cotangent * network.with_parameters(moved).predict(z)))

    chosen = np.random.default_rng(1).choice(len(p), min(len(p), 8), replace=False)
    slopes = [(cost(k, STEP) - cost(k, -STEP)) / (2.0 * STEP) for k in chosen]
    found = network.vjp(z, cotangent)
    np.testing.assert_allclose(
        found[chosen], slopes, rtol=0.0, atol=DIFFERENCES * max(1.0, np.abs(found).max())
    )


def test_softmax_of_old_versions_counts_the_axes_from_its_own_as_one() -> None:
    # As the specification says; the reference does so for the last axis only.
    case = one("Softmax", axis=1, shape=CUBE, opset=11)
    z = rows_of(case).reshape(ROWS, 6)
    np.testing.assert_allclose(
        network_of(case).predict(z), network_of(one("Softmax", shape=("N", 6))).predict(z), atol=SAME_FORMULA
    )


@pytest.mark.parametrize(
    ("operator", "slope"),
    [("Relu", 0.5), ("LeakyRelu", 0.625), ("Elu", 1.0), ("Abs", 0.0), ("Softplus", 0.5)],
)
def test_slope_at_a_kink_is_the_mean_of_those_beside_it(operator: str, slope: float) -> None:
    attributes = {"alpha": 0.25} if operator == "LeakyRelu" else {}
    nodes = [("Add", ["z", "b"], ["v"], {}), (operator, ["v"], ["f"], attributes)]
    network = network_of(Case(nodes, {"b": np.zeros(3)}))
    assert network.vjp(np.zeros((1, 3)), np.ones((1, 3))).tolist() == [slope] * 3


def test_every_operator_has_a_case_and_stands_in_the_docstring() -> None:
    met = {operator for case in CASES.values() for operator, *_ in case.nodes}
    assert met == set(OPERATORS)
    (text,) = re.findall(r"Supported\s+operators: (.*?)\.\n\n", OnnxNetwork.read.__doc__ or "", re.DOTALL)
    assert set(re.split(r",\s+", text)) == {*OPERATORS, "Constant"}
