"""ONNX networks against the reference evaluator of onnx, CasADi and differences; what is refused, and how."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.learned import LearnedModel, OnnxNetwork
from phyfilter_ctl.learned.dense import SLOPE, VALUE, Activation, Dense

onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
TensorProto, helper, numpy_helper = onnx.TensorProto, onnx.helper, onnx.numpy_helper
ReferenceEvaluator = importlib.import_module("onnx.reference").ReferenceEvaluator

# The same sums in another order, in double precision.
SAME_FORMULA = 1e-12
# Gradient by algorithmic differentiation or a complex step, relative to its largest entry.
GRADIENT = 1e-9
# A model in single precision, evaluated in single there and in double here: some 20 terms of eps 1.2e-7.
SINGLE = 1e-5

RNG = np.random.default_rng(0)


@pytest.fixture(autouse=True)
def same_numbers_in_any_order() -> None:
    """Each test draws from the start of the sequence, whichever worker runs it after whatever else."""
    RNG.bit_generator.state = np.random.default_rng(0).bit_generator.state


def constant(name: str, *shape: int, dtype: type = np.float64) -> onnx.TensorProto:
    return numpy_helper.from_array(RNG.standard_normal(shape).astype(dtype), name)


def model(
    nodes: list[onnx.NodeProto],
    constants: list[onnx.TensorProto],
    *,
    shape: tuple[int | str, ...] = ("N", 3),
    n_x: int = 2,
    kind: int = TensorProto.DOUBLE,
    opset: int = 20,
) -> onnx.ModelProto:
    graph = helper.make_graph(
        nodes,
        "perceptron",
        [helper.make_tensor_value_info("z", kind, shape)],
        [helper.make_tensor_value_info("f", kind, ("N", n_x))],
        constants,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)


def read(proto: onnx.ModelProto) -> OnnxNetwork:
    return OnnxNetwork.read(proto.SerializeToString())


def reference(proto: onnx.ModelProto, z: np.ndarray) -> np.ndarray:
    (f,) = ReferenceEvaluator(proto).run(None, {"z": z})
    return np.asarray(f)


def gemm_chain(activation: str = "Tanh", dtype: type = np.float64, **attributes: float) -> onnx.ModelProto:
    """As PyTorch exports: Gemm with transposed weights."""
    return model(
        [
            helper.make_node("Gemm", ["z", "W1", "b1"], ["v1"], transB=1),
            helper.make_node(activation, ["v1"], ["h1"], **attributes),
            helper.make_node("Gemm", ["h1", "W2", "b2"], ["f"], transB=1, alpha=0.5, beta=2.0),
        ],
        [
            constant(n, *s, dtype=dtype)
            for n, s in (("W1", (5, 3)), ("b1", (5,)), ("W2", (2, 5)), ("b2", (1, 2)))
        ],
        kind=TensorProto.DOUBLE if dtype is np.float64 else TensorProto.FLOAT,
    )


def scaled_chain() -> onnx.ModelProto:
    """As scikit-learn and Keras export: scaling before, MatMul and Add, scaling after, harmless nodes between."""
    weights = helper.make_node("Constant", [], ["W1"], value=constant("", 3, 4))
    return model(
        [
            weights,
            helper.make_node("Identity", ["W1"], ["W1_same"]),
            helper.make_node("Sub", ["z", "mean"], ["c"]),
            helper.make_node("Div", ["c", "scale"], ["s"]),
            helper.make_node("Cast", ["s"], ["s64"], to=TensorProto.DOUBLE),
            helper.make_node("MatMul", ["s64", "W1_same"], ["v"]),
            helper.make_node("Add", ["b1", "v"], ["w"]),
            helper.make_node("Relu", ["w"], ["h"]),
            helper.make_node("Identity", ["h"], ["h_same"]),
            helper.make_node("Dropout", ["h_same"], ["h_kept"]),
            helper.make_node("MatMul", ["h_kept", "W2"], ["o"]),
            helper.make_node("MatMul", ["o", "W3"], ["p"]),
            helper.make_node("Reshape", ["p", "shape"], ["q"]),
            helper.make_node("Mul", ["two", "q"], ["r"]),
            helper.make_node("Sub", ["b3", "r"], ["t"]),
            helper.make_node("Neg", ["t"], ["y"]),
            helper.make_node("Sigmoid", ["y"], ["x"]),
            helper.make_node("Clip", ["x", "low", ""], ["k"]),
            helper.make_node("Add", ["k", "b3"], ["f"]),
        ],
        [
            constant("mean", 1, 3),
            numpy_helper.from_array(np.array([0.5, 2.0, 3.0]), "scale"),
            constant("b1", 4),
            constant("W2", 4, 3),
            constant("W3", 3, 2),
            constant("b3", 2),
            numpy_helper.from_array(np.array(2.0), "two"),
            numpy_helper.from_array(np.array(0.3), "low"),
            numpy_helper.from_array(np.array([-1, 2]), "shape"),
        ],
    )


def flattened() -> onnx.ModelProto:
    """Three axes, flattened; batch normalisation; the width only from the shape of the input."""
    normal = [
        numpy_helper.from_array(RNG.uniform(0.5, 2.0, 6), n) for n in ("gain", "bias", "mean", "variance")
    ]
    return model(
        [
            helper.make_node("Flatten", ["z"], ["v"]),
            helper.make_node(
                "BatchNormalization", ["v", "gain", "bias", "mean", "variance"], ["w"], epsilon=0.01
            ),
            helper.make_node("Softplus", ["w"], ["h"]),
            helper.make_node("Gemm", ["h", "W"], ["f"]),
        ],
        [*normal, constant("W", 6, 2)],
        shape=("N", 2, 3),
    )


CHAINS: dict[str, Callable[[], onnx.ModelProto]] = {
    "gemm": gemm_chain,
    "scaled": scaled_chain,
    "elu": lambda: gemm_chain("Elu", alpha=0.75),
    "leaky": lambda: gemm_chain("LeakyRelu", alpha=0.25),
    "selu": lambda: gemm_chain("Selu"),
    "softplus": lambda: gemm_chain("Softplus"),
    "softsign": lambda: gemm_chain("Softsign"),
    "sigmoid": lambda: gemm_chain("Sigmoid"),
    "relu": lambda: gemm_chain("Relu"),
}


@pytest.mark.parametrize("name", CHAINS)
def test_predict_is_the_reference_evaluator(name: str) -> None:
    proto = CHAINS[name]()
    onnx.checker.check_model(proto)
    z = 2.0 * RNG.standard_normal((50, 3))
    np.testing.assert_allclose(read(proto).predict(z), reference(proto, z), rtol=0.0, atol=SAME_FORMULA * 10)


def test_flatten_and_batch_normalisation() -> None:
    proto = flattened()
    z = RNG.standard_normal((20, 2, 3))
    network = read(proto)
    assert network.layers.sizes == (6, 6, 2)
    # epsilon is stored in single precision
    np.testing.assert_allclose(network.predict(z.reshape(20, 6)), reference(proto, z), rtol=0.0, atol=1e-8)


def test_single_precision_weights() -> None:
    proto = gemm_chain("Tanh", np.float32)
    z = RNG.standard_normal((50, 3)).astype(np.float32)
    np.testing.assert_allclose(read(proto).predict(z), reference(proto, z), rtol=0.0, atol=SINGLE)


def test_affine_nodes_are_folded_into_the_layers() -> None:
    network = read(scaled_chain())
    names = [a.name for a in network.layers.activations]
    assert names == ["relu", "identity", "sigmoid", "clip", "identity"]
    assert network.layers.sizes == (3, 4, 3, 2, 2, 2)
    assert repr(read(gemm_chain())) == "OnnxNetwork(3 -> 5 -> 2; tanh, identity; 32 parameters)"
    assert isinstance(network, LearnedModel)


@pytest.mark.parametrize("name", CHAINS)
def test_casadi_is_predict(name: str) -> None:
    network = read(CHAINS[name]())
    z = 3.0 * RNG.standard_normal((30, 3))
    expected = network.casadi().map(30)(z.T).full().T
    np.testing.assert_allclose(network.predict(z), expected, rtol=SAME_FORMULA, atol=SAME_FORMULA)
    assert network.casadi().size_out(0) == (2, 1)


def complex_predict(layers: Dense, parameters: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The formula of the class in complex arithmetic; kinks by the real part."""
    functions: dict[str, Callable[[np.ndarray, float, float], np.ndarray]] = {
        "identity": lambda v, a, b: v,
        "relu": lambda v, a, b: np.where(v.real > 0.0, v, 0.0),
        "leaky_relu": lambda v, a, b: np.where(v.real < 0.0, a * v, v),
        "elu": lambda v, a, b: np.where(v.real < 0.0, a * (np.exp(v) - 1.0), v),
        "selu": lambda v, a, b: b * np.where(v.real < 0.0, a * (np.exp(v) - 1.0), v),
        "tanh": lambda v, a, b: np.tanh(v),
        "sigmoid": lambda v, a, b: 1.0 / (1.0 + np.exp(-v)),
        "softplus": lambda v, a, b: np.log(1.0 + np.exp(v)),
        "softsign": lambda v, a, b: v / (1.0 + np.where(v.real < 0.0, -v, v)),
        "clip": lambda v, a, b: np.where(v.real < a, a, np.where(v.real > b, b, v)),
    }
    h, first = z.astype(complex), 0
    for before, after, act in zip(layers.sizes[:-1], layers.sizes[1:], layers.activations, strict=True):
        W = parameters[first : first + before * after].reshape(before, after)
        first += before * after
        h = functions[act.name](h @ W + parameters[first : first + after], act.first, act.second)
        first += after
    return h


@pytest.mark.parametrize("name", CHAINS)
def test_vjp_is_the_complex_step(name: str) -> None:
    network = read(CHAINS[name]())
    z, cotangent, p = RNG.standard_normal((15, 3)), RNG.standard_normal((15, 2)), network.parameters
    steps = 1e-30j * np.eye(len(p))
    expected = [np.sum(cotangent * complex_predict(network.layers, p + s, z).imag) / 1e-30 for s in steps]
    np.testing.assert_allclose(
        network.vjp(z, cotangent), expected, rtol=0.0, atol=GRADIENT * np.abs(expected).max()
    )


def test_slopes_of_every_activation() -> None:
    v = RNG.standard_normal(200) * 2.0
    v = v[np.minimum(np.abs(v), np.abs(v - 0.5)) > 1e-3]  # away from the kinks
    for name in VALUE:
        a, b = (-1e9, 0.5) if name == "clip" else (0.3, 1.7)
        slope = (VALUE[name](v + 1e-6, a, b) - VALUE[name](v - 1e-6, a, b)) / 2e-6
        np.testing.assert_allclose(SLOPE[name](v, a, b), slope, atol=1e-8)


def test_activations_of_large_values_stay_finite() -> None:
    v = np.array([[-1e4, -800.0, 0.0, 800.0, 1e4]])
    for name in VALUE:
        layers = Dense((np.eye(5),), (np.zeros(5),), (Activation(name, 0.5, 2.0),))
        network = OnnxNetwork(layers)
        values = network.predict(v)
        assert np.all(np.isfinite(values))
        assert np.all(np.isfinite(network.vjp(v, np.ones((1, 5)))))
        np.testing.assert_allclose(
            network.casadi()(v[0]).full()[:, 0], values[0], rtol=SAME_FORMULA, atol=1e-300
        )


def test_fit_goes_on_from_the_weights_read() -> None:
    network = read(gemm_chain())
    z = RNG.standard_normal((200, 3))
    f = network.predict(z) + 0.05 * np.sin(z[:, :2])
    start = float(np.sqrt(np.mean((network.predict(z) - f) ** 2)))
    result = network.fit(z, f)
    assert result.status in ("converged", "iteration_limit")
    assert result.rmse < 0.3 * start
    held = OnnxNetwork(network.layers, l2=1e6).fit(z, f).model
    assert np.max(np.abs(held.parameters - network.parameters)) < 1e-6


def test_save_and_load_without_onnx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = OnnxNetwork(read(scaled_chain()).layers, l2=0.1, max_iterations=7, tolerance=1e-3)
    network.save(tmp_path / "model.npz")
    monkeypatch.setitem(sys.modules, "onnx", None)
    loaded = OnnxNetwork.load(tmp_path / "model.npz")
    z = RNG.standard_normal((9, 3))
    assert loaded.predict(z).tobytes() == network.predict(z).tobytes()
    assert (loaded.l2, loaded.max_iterations, loaded.tolerance) == (0.1, 7, 1e-3)
    assert loaded.layers.activations == network.layers.activations
    with pytest.raises(ModuleNotFoundError, match=r"pip install 'phyfilter-ctl\[onnx\]'"):
        OnnxNetwork.read(b"")


def test_read_from_a_path(tmp_path: Path) -> None:
    proto = gemm_chain()
    onnx.save(proto, tmp_path / "model.onnx")
    assert np.array_equal(OnnxNetwork.read(tmp_path / "model.onnx").parameters, read(proto).parameters)
    with pytest.raises(FileNotFoundError):
        OnnxNetwork.read(tmp_path / "none.onnx")


# ------------------------------------------------------------------------------------------------------------ refusals


def one(operator: str, *others: str, domain: str = "", **attributes: object) -> onnx.ModelProto:
    node = helper.make_node(operator, ["z", *others], ["f"], name="odd", domain=domain, **attributes)
    return model([node], [constant("W", 3, 2), constant("b", 3), constant("wide", 4)])


def with_external_data() -> onnx.ModelProto:
    proto = gemm_chain()
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    return proto


def with_huge_shape() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.graph.initializer[0].dims[:] = [1_000_000, 1_000_000]
    return proto


def with_wrong_shape() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.graph.initializer[0].dims[:] = [5, 4]
    return proto


def with_nan() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.graph.initializer[1].CopyFrom(numpy_helper.from_array(np.full(5, np.nan), "b1"))
    return proto


def with_function() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.functions.append(
        helper.make_function("own", "Twice", ["x"], ["y"], [helper.make_node("Add", ["x", "x"], ["y"])], [])
    )
    return proto


def with_sparse() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.graph.sparse_initializer.add()
    return proto


def with_two_inputs() -> onnx.ModelProto:
    proto = gemm_chain()
    proto.graph.input.append(helper.make_tensor_value_info("u", TensorProto.DOUBLE, ("N", 3)))
    return proto


def skipping() -> onnx.ModelProto:
    return model(
        [helper.make_node("Tanh", ["z"], ["h"]), helper.make_node("Add", ["h", "z"], ["f"])], [], n_x=3
    )


def ending_elsewhere() -> onnx.ModelProto:
    nodes = [helper.make_node("Tanh", ["z"], ["f"]), helper.make_node("Relu", ["f"], ["g"])]
    return model(nodes, [], n_x=3)


def leaving_out_operands(operator: str) -> onnx.ModelProto:
    """A node on constants alone, which leaves one out: ONNX writes that as an operand without a name."""
    nodes = [
        helper.make_node(operator, ["", "W"], ["V"], name="odd", to=TensorProto.DOUBLE),
        helper.make_node("MatMul", ["z", "V"], ["f"]),
    ]
    return model(nodes, [constant("W", 3, 2)])


def without_a_name() -> onnx.ModelProto:
    proto = one("MatMul", "W")
    proto.graph.input[0].name = proto.graph.node[0].input[0] = ""
    return proto


def with_an_infinite_factor() -> onnx.ModelProto:
    return one("Gemm", "W", alpha=float("inf"))


def many_layers() -> onnx.ModelProto:
    """A short file that asks for gigabytes: layer after layer on the same wide signal."""
    names = ["z", *(f"v{i}" for i in range(50)), "f"]
    nodes = [helper.make_node("Relu", [a], [b]) for a, b in pairwise(names)]
    return model(nodes, [], shape=("N", 2000), n_x=2000)


REFUSED: list[tuple[Callable[[], onnx.ModelProto], str]] = [
    (lambda: one("Conv", "W"), r"operator 'Conv' is not supported \(node 'odd'\); supported: Add, .*Tanh"),
    (lambda: one("Softmax"), "operator 'Softmax' is not supported"),
    (lambda: one("Tanh", domain="com.acme"), "operator 'com.acme.Tanh' is not supported"),
    (lambda: one("Gemm", "W", transA=1), "'odd' .*not transposed"),
    (lambda: one("Gemm"), "an operand is missing"),
    (lambda: one("Add", "wide"), "expected 3 channels, got a constant for 4"),
    (lambda: one("Add", "W"), r"one number for each channel, got shape \(3, 2\)"),
    (lambda: one("Add", "z"), "expected a chain, got a branch through 'z'"),
    (lambda: one("MatMul", "b"), "expected a weight matrix"),
    (lambda: one("MatMul", "elsewhere"), "got a branch through 'elsewhere'"),
    (lambda: one("Cast", to=TensorProto.INT64), "expected a cast to single or double"),
    (lambda: one("Flatten", axis=0), "expected axis 1"),
    (lambda: one("Clip", "b"), "expected one number as min"),
    (with_external_data, "constant 'W1' is in an external file; store it inside the model"),
    (with_huge_shape, "numbers in its constants, more than 8388608"),
    (with_wrong_shape, "constant 'W1' is damaged"),
    (with_nan, "expected finite numbers"),
    (with_function, "defines its own function 'Twice'"),
    (with_sparse, "sparse constants"),
    (with_two_inputs, "expected one input and one output, got 2 and 1"),
    (skipping, "got a branch through 'z'"),
    (ending_elsewhere, "expected a chain that ends in the output 'f', got 'g'"),
    (many_layers, "more than 8388608 weights"),
    (lambda: leaving_out_operands("Identity"), "'odd' .*an operand is missing"),
    (lambda: leaving_out_operands("Cast"), "'odd' .*an operand is missing"),
    (lambda: one("Sub"), "'odd' .*an operand is missing"),
    (without_a_name, "the input has no name"),
    (with_an_infinite_factor, "expected finite numbers"),
]


@pytest.mark.parametrize(("proto", "words"), REFUSED)
def test_what_is_no_perceptron_is_refused(proto: Callable[[], onnx.ModelProto], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        read(proto())


def test_division_by_the_signal_and_by_zero() -> None:
    node = helper.make_node("Div", ["one", "z"], ["f"])
    with pytest.raises(ValueError, match="division by the signal"):
        read(model([node], [numpy_helper.from_array(np.ones(3), "one")], n_x=3))
    node = helper.make_node("Div", ["z", "zero"], ["f"])
    with pytest.raises(ValueError, match="division by zero"):
        read(model([node], [numpy_helper.from_array(np.zeros(3), "zero")], n_x=3))


def test_cut_off_files_are_refused() -> None:
    whole = gemm_chain().SerializeToString()
    for size in range(0, len(whole), 37):
        with pytest.raises(ValueError, match="model"):
            OnnxNetwork.read(whole[:size])


def test_files_beyond_any_size_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "large.onnx"
    with open(path, "wb") as file:
        file.truncate((1 << 26) + 1)
    with pytest.raises(ValueError, match=r"large\.onnx: expected at most 67108864 bytes"):
        OnnxNetwork.read(path)


@pytest.mark.parametrize(
    ("act", "error", "words"),
    [
        (lambda n: n.predict(np.zeros((2, 4))), ValueError, r"z: expected shape \(N, 3\)"),
        (lambda n: n.vjp(np.zeros((2, 3)), np.zeros((2, 3))), ValueError, "cotangent: expected shape"),
        (
            lambda n: n.vjp(np.zeros((2, 3)), np.zeros((1, 2))),
            ValueError,
            r"cotangent: expected shape \(2, 2\) to go with z",
        ),
        (lambda n: n.fit(np.zeros((2, 3)), np.zeros((2, 1))), ValueError, "f: expected shape"),
        (lambda n: n.with_parameters([1.0]), ValueError, r"parameters: expected shape \(32,\)"),
        (
            lambda n: n.with_parameters(np.full(32, np.inf)),
            ValueError,
            r"parameters: expected finite numbers.*entry 0",
        ),
        (lambda n: OnnxNetwork(n.layers, l2=-1.0), ValueError, "l2: expected a finite number >= 0"),
        (lambda n: Activation("gelu"), ValueError, "activation: expected one of"),
        (lambda n: Dense((np.eye(2),), (), ()), ValueError, "as many biases and activations"),
        (lambda n: Dense((np.eye(2),), (np.zeros(3),), (Activation("relu"),)), ValueError, "layer 0"),
    ],
)
def test_bad_input(act: Callable[[OnnxNetwork], object], error: type[Exception], words: str) -> None:
    network = read(gemm_chain())
    with pytest.raises(error, match=words):
        act(network)
