"""ONNX networks against the reference evaluator of onnx, CasADi and differences; what is refused, and how."""

from __future__ import annotations

import importlib
import io
import json
import sys
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, Recording, learned_block, simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.learned import LearnedModel
from phyfilter_ctl.learned.onnx import OnnxGraph, OnnxNetwork, OnnxNode

onnx = pytest.importorskip("onnx", reason="the package onnx is not installed (extra: onnx)")
TensorProto, helper, numpy_helper = onnx.TensorProto, onnx.helper, onnx.numpy_helper
ReferenceEvaluator = importlib.import_module("onnx.reference").ReferenceEvaluator

# The same sums in another order, in double precision.
SAME_FORMULA = 1e-12
# Central differences, relative to the largest entry of the gradient.
DIFFERENCES = 1e-7
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
    # epsilon is stored in single precision
    np.testing.assert_allclose(network.predict(z.reshape(20, 6)), reference(proto, z), rtol=0.0, atol=1e-8)


def test_single_precision_weights() -> None:
    proto = gemm_chain("Tanh", np.float32)
    z = RNG.standard_normal((50, 3)).astype(np.float32)
    np.testing.assert_allclose(read(proto).predict(z), reference(proto, z), rtol=0.0, atol=SINGLE)


def test_what_counts_as_parameters() -> None:
    assert repr(read(gemm_chain())) == "OnnxNetwork(3 -> 2; Gemm, Tanh, Gemm; 32 parameters)"
    # Weights and biases, also behind an Identity; no scaling and no single number.
    network = read(scaled_chain())
    assert len(network.parameters) == 3 * 4 + 4 + 4 * 3 + 3 * 2 + 2
    assert isinstance(network, LearnedModel)


def test_a_constant_that_is_a_statistic_too_is_no_parameter() -> None:
    # Exporters write two constants of the same numbers once.
    proto = flattened()
    for place in (1, 4):
        proto.graph.node[1].input[place] = "gain"
    assert len(read(proto).parameters) == 6 + 12


@pytest.mark.parametrize("shape", [("N", 3), (None, 3), (1, 3), (3,)])
def test_with_and_without_an_axis_of_samples(shape: tuple[int | str | None, ...]) -> None:
    nodes = [helper.make_node("MatMul", ["z", "W"], ["v"]), helper.make_node("Softmax", ["v"], ["f"])]
    proto = model(nodes, [constant("W", 3, 2)], shape=shape)  # type: ignore[arg-type]  # None is an open size
    z = RNG.standard_normal((4, 3))
    expected = [reference(proto, row if len(shape) == 1 else row[None]).reshape(2) for row in z]
    np.testing.assert_allclose(read(proto).predict(z), expected, rtol=0.0, atol=SAME_FORMULA)


def test_a_network_that_looks_at_other_samples_is_refused() -> None:
    node = helper.make_node("Softmax", ["z"], ["f"], axis=0)
    with pytest.raises(ValueError, match="for one sample depends on the others"):
        read(model([node], []))


def test_external_constants(tmp_path: Path) -> None:
    proto = gemm_chain()
    expected = read(proto).parameters
    onnx.save(
        proto, tmp_path / "model.onnx", save_as_external_data=True, location="weights.bin", size_threshold=0
    )
    assert np.array_equal(OnnxNetwork.read(tmp_path / "model.onnx").parameters, expected)
    (tmp_path / "weights.bin").write_bytes(b"short")
    with pytest.raises(ValueError, match="constant 'W1' is damaged"):
        OnnxNetwork.read(tmp_path / "model.onnx")
    (tmp_path / "weights.bin").unlink()
    with pytest.raises(ValueError, match=r"external file beside the model, got 'weights\.bin'"):
        OnnxNetwork.read(tmp_path / "model.onnx")
    with_external_data_at("/etc/passwd", tmp_path / "outside.onnx")
    with pytest.raises(ValueError, match="external file beside the model, got '/etc/passwd'"):
        OnnxNetwork.read(tmp_path / "outside.onnx")


def test_the_command_line_takes_one_with_constants_beside_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nodes = [helper.make_node("MatMul", ["z", "W"], ["f"])]
    path, log = tmp_path / "model.onnx", tmp_path / "log.csv"
    onnx.save(
        model(nodes, [constant("W", 3, 2)]), path, save_as_external_data=True, location="w", size_threshold=0
    )
    x, z, truth = RNG.standard_normal((400, 2)), RNG.standard_normal((400, 3)), PhyFilter([20.0])
    label = truth.sampled(0.01).run(x, f_theta=OnnxNetwork.read(path).predict(z))
    Recording.from_arrays(x=x, dt=0.01, label=label, features=z, channels=["p", "q"]).to_csv(log)
    options = ["--x", "p,q", "--order", "1", "--form", "lowpass", "--json", "-"]
    assert main(["learn", str(log), *options, "--model", str(path)]) == 0
    assert json.loads(capsys.readouterr().out)["filters"][0]["a"] == pytest.approx([20.0], rel=1e-6)
    for wrong, words in (
        (["--model", str(path), "--features", "p,q"], "z: expected shape (N, 3)"),
        (["--model", str(path), "--f-theta", "none"], "--model and --f-theta: expected one of them"),
        (["--features", "p,q"], "--features: expected --model beside it"),
    ):
        assert main(["learn", str(log), *options, *wrong]) != 0
        assert words in capsys.readouterr().err


def test_networks_of_pytorch() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed (extra: torch)")
    torch.manual_seed(0)
    nn = torch.nn
    linear, last = nn.Linear(6, 16), nn.Linear(16, 3)

    class Residual(nn.Module):  # type: ignore[misc,name-defined]  # PyTorch's own metaclass
        def __init__(self) -> None:
            super().__init__()
            self.first, self.norm, self.second, self.last = linear, nn.LayerNorm(16), nn.Linear(16, 16), last

        def forward(self, z: object) -> object:
            h = nn.functional.gelu(self.first(z))
            return self.last(h + nn.functional.mish(self.second(self.norm(h))))

    middles = (nn.Tanh(), nn.SiLU(), nn.GELU(), nn.LayerNorm(16), nn.Mish(), nn.Softmax(-1), nn.Hardswish())
    networks = [nn.Sequential(linear, middle, last) for middle in middles]
    z = np.random.default_rng(0).standard_normal((20, 6)).astype(np.float32)
    for network in (*networks, Residual()):
        file = io.BytesIO()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about a newer exporter, which needs another package
            torch.onnx.export(network.eval(), (torch.zeros(1, 6),), file, dynamo=False)
        expected = network(torch.from_numpy(z)).detach().numpy()
        read_again = OnnxNetwork.read(file.getvalue())
        np.testing.assert_allclose(read_again.predict(z), expected, rtol=0.0, atol=SINGLE)
        assert len(read_again.parameters) == sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize("name", CHAINS)
def test_casadi_is_predict(name: str) -> None:
    network = read(CHAINS[name]())
    z = 3.0 * RNG.standard_normal((30, 3))
    expected = network.casadi().map(30)(z.T).full().T
    np.testing.assert_allclose(network.predict(z), expected, rtol=SAME_FORMULA, atol=SAME_FORMULA)
    assert network.casadi().size_out(0) == (2, 1)


@pytest.mark.parametrize("name", CHAINS)
def test_vjp_is_the_slope_of_differences(name: str) -> None:
    network = read(CHAINS[name]())
    z, cotangent, p = RNG.standard_normal((15, 3)), RNG.standard_normal((15, 2)), network.parameters
    h = 1e-6
    moved = [[network.with_parameters(p + s * e).predict(z) for s in (h, -h)] for e in np.eye(len(p))]
    expected = [np.sum(cotangent * (above - below)) / (2.0 * h) for above, below in moved]
    np.testing.assert_allclose(
        network.vjp(z, cotangent), expected, rtol=0.0, atol=DIFFERENCES * np.abs(expected).max()
    )


def test_activations_of_large_values_stay_finite() -> None:
    v = np.array([[-1e4, -800.0, 0.0, 800.0, 1e4]])
    for name in ("Relu", "Elu", "Selu", "Tanh", "Sigmoid", "Softplus", "Softsign", "Mish", "Softmax", "Gelu"):
        nodes = OnnxNode("Add", ("z", "b"), ("v",)), OnnxNode(name, ("v",), ("f",))
        network = OnnxNetwork(OnnxGraph(nodes, {"b": np.zeros(5)}, (None, 5)))
        values = network.predict(v)
        assert np.all(np.isfinite(values))
        assert np.all(np.isfinite(network.vjp(v, np.ones((1, 5)))))
        np.testing.assert_allclose(
            network.casadi()(v[0]).full()[:, 0], values[0], rtol=SAME_FORMULA, atol=1e-300
        )


@pytest.mark.parametrize("backend", ["vm", "c"])
def test_in_a_diagram_and_in_c(backend: Literal["vm", "c"]) -> None:
    nodes = [
        OnnxNode("Gemm", ("z", "W", "b"), ("v",)),
        OnnxNode("LayerNormalization", ("v", "gain"), ("n",)),
        OnnxNode("Gelu", ("n",), ("h",)),
        OnnxNode("Mish", ("h",), ("m",)),
        OnnxNode("Add", ("m", "v"), ("r",)),
        OnnxNode("Softmax", ("r",), ("s",)),
        OnnxNode("MatMul", ("s", "U"), ("f",)),
    ]
    sizes = {"W": (3, 8), "b": (8,), "gain": (8,), "U": (8, 2)}
    constants = {name: RNG.standard_normal(size) for name, size in sizes.items()}
    network, inputs = OnnxNetwork(OnnxGraph(tuple(nodes), constants, (None, 3))), RNG.standard_normal((11, 3))
    response = simulate(learned_block(network), 0.1 * np.arange(11), inputs.T, backend=backend)
    np.testing.assert_allclose(response.outputs.T, network.predict(inputs), rtol=0.0, atol=1e-13)


def test_fit_goes_on_from_the_weights_read() -> None:
    network = read(gemm_chain())
    z = RNG.standard_normal((200, 3))
    f = network.predict(z) + 0.05 * np.sin(z[:, :2])
    start = float(np.sqrt(np.mean((network.predict(z) - f) ** 2)))
    result = network.fit(z, f)
    assert result.status in ("converged", "iteration_limit")
    assert result.rmse < 0.5 * start
    held = OnnxNetwork(network.graph, l2=1e6).fit(z, f).model
    assert np.max(np.abs(held.parameters - network.parameters)) < 1e-6


def test_save_and_load_without_onnx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = OnnxNetwork(read(scaled_chain()).graph, l2=0.1, max_iterations=7, tolerance=1e-3)
    network.save(tmp_path / "model.npz")
    monkeypatch.setitem(sys.modules, "onnx", None)
    loaded = OnnxNetwork.load(tmp_path / "model.npz")
    z = RNG.standard_normal((9, 3))
    assert loaded.predict(z).tobytes() == network.predict(z).tobytes()
    assert (loaded.l2, loaded.max_iterations, loaded.tolerance) == (0.1, 7, 1e-3)
    assert loaded.graph.nodes == network.graph.nodes
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


def with_external_data(place: str = "/etc/passwd") -> onnx.ModelProto:
    proto = gemm_chain()
    tensor = proto.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", place
    return proto


def with_external_data_at(place: str, path: Path) -> None:
    path.write_bytes(with_external_data(place).SerializeToString())


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


def doubling() -> onnx.ModelProto:
    """A short file that asks for gigabytes."""
    names = ["z", *(f"v{i}" for i in range(40)), "f"]
    nodes = [helper.make_node("Concat", [a, a], [b], axis=1) for a, b in pairwise(names)]
    return model(nodes, [])


def many_layers() -> onnx.ModelProto:
    names = ["z", *(f"v{i}" for i in range(9000)), "f"]
    nodes = [helper.make_node("Relu", [a], [b]) for a, b in pairwise(names)]
    return model(nodes, [], shape=("N", 2000), n_x=2000)


REFUSED: list[tuple[Callable[[], onnx.ModelProto], str]] = [
    (
        lambda: one("Conv", "W"),
        r"operator 'Conv' is not supported \(node 'odd'\); fit a Network to .*; supported: Abs, .*Tanh",
    ),
    (lambda: one("Tanh", domain="com.acme"), "operator 'com.acme.Tanh' is not supported"),
    (lambda: one("Gemm"), "an operand is missing"),
    (lambda: one("Add", "wide"), r"node 'odd' \(Add\): the operands do not fit together"),
    (lambda: one("Gemm", "b"), r"expected a matrix as the second operand, got shape \(3,\)"),
    (lambda: one("MatMul", "wide"), r"expected 3 rows in the second operand, got its shape \(4,\)"),
    (lambda: one("MatMul", "elsewhere"), "no node before it gives 'elsewhere'"),
    (lambda: one("Cast", to=TensorProto.INT64), "expected a cast to single or double"),
    (lambda: one("Clip", "b"), "expected one number as min"),
    (lambda: one("Reshape", "b"), "expected whole numbers as shape"),
    (lambda: one("Reshape", "z"), "expected whole numbers as shape"),
    (lambda: one("Softmax", axis=5), "expected an axis of 2, got 5"),
    (with_external_data, "constant 'W1' is in an external file: give the path of the model"),
    (with_huge_shape, "numbers in its constants, more than 8388608"),
    (with_wrong_shape, "constant 'W1' is damaged"),
    (with_nan, "every number must be finite"),
    (with_function, "defines its own function 'Twice'; inline it"),
    (with_sparse, "sparse constants"),
    (with_two_inputs, "expected one input and one output, got 2 and 1; join them"),
    (doubling, "more than (8388608|16777216)"),
    (many_layers, "the nodes give more than 16777216 numbers"),
    (lambda: leaving_out_operands("Identity"), "'odd' .*an operand is missing"),
    (lambda: leaving_out_operands("Cast"), "'odd' .*an operand is missing"),
    (lambda: one("Sub"), "'odd' .*an operand is missing"),
    (without_a_name, "the input has no name"),
    (with_an_infinite_factor, "expected a finite alpha, got inf"),
]


@pytest.mark.parametrize(("proto", "words"), REFUSED)
def test_what_is_not_supported_is_refused(proto: Callable[[], onnx.ModelProto], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        read(proto())


def test_division_by_zero() -> None:
    node = helper.make_node("Div", ["z", "zero"], ["f"])
    with pytest.raises(ValueError, match="division by zero"):
        read(model([node], [numpy_helper.from_array(np.zeros(3), "zero")], n_x=3))


def test_outputs_that_are_no_function_of_the_input() -> None:
    node = helper.make_node("Identity", ["W"], ["f"])
    with pytest.raises(ValueError, match="the output 'f' does not depend on the input"):
        read(model([node], [constant("W", 1, 2)]))
    node = helper.make_node("Relu", ["z"], ["g"])
    with pytest.raises(ValueError, match="no node gives the output 'f'"):
        read(model([node], []))


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
        (lambda n: OnnxNetwork(n.graph, l2=-1.0), ValueError, "l2: expected a finite number >= 0"),
        (lambda n: OnnxGraph((), {"W": np.array(["a"])}, (None, 3)), ValueError, "expected numbers"),
    ],
)
def test_bad_input(act: Callable[[OnnxNetwork], object], error: type[Exception], words: str) -> None:
    network = read(gemm_chain())
    with pytest.raises(error, match=words):
        act(network)
