"""Variables of every type of FMI 3.0, and arrays by a structural parameter: set, handed on, recorded."""

import csv
import json

import fmpy
import numpy as np
import pytest
from foreign_typed import NUMBERS, typed

from phyfilter_ctl import simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import Fmu, Master, System, cosimulate, describe, import_fmu
from phyfilter_ctl.fmi.instance import FmuInstance
from phyfilter_ctl.fmi.signals import Signals
from phyfilter_ctl.fmi.unpacked import UnpackedFmu

T = np.linspace(0.0, 1.0, 6)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return typed(tmp_path_factory.mktemp("typed"))


def test_the_ends_of_every_type_to_the_last_digit(path):
    """What is set is what FMPy reads, and one more is refused before anything is set."""
    instance = FmuInstance(UnpackedFmu(path), "cs", "ends")
    fmu = instance._fmu
    for kind, (place, least, most) in NUMBERS.items():
        get = getattr(fmu, f"get{'Int64' if kind == 'Enumeration' else kind}")
        for value in (least, most):
            instance.set_values({f"p_{kind}": value})
            found = get([10 * place])[0]
            assert found == (np.float32(value) if kind == "Float32" else value), kind
        if kind not in ("Float32", "Boolean"):
            with pytest.raises(ValueError, match=rf"p_{kind} \({kind}\): expected .* got {most + 1}$"):
                instance.set_values({"p_Int8": 1, f"p_{kind}": most + 1})
        with pytest.raises(ValueError, match=rf"p_{kind} \({kind}\): expected a number, got b'1'"):
            instance.set_values({f"p_{kind}": b"1"})
    assert fmu.getInt8([20]) == [127], "nothing was set beside what was refused"
    for name, value, message in (
        ("p_String", 5.0, r"p_String \(String\): expected a text, got 5.0"),
        ("p_String", "a\0b", "ends at its first NUL"),
        ("p_Binary", "xyz", r"p_Binary \(Binary\): expected bytes, or .* hexadecimal digits, got 'xyz'"),
        ("channels", 3, "set before there is an instance"),
    ):
        with pytest.raises(ValueError, match=message):
            instance.set_values({"p_Int8": 1, name: value})
    instance.set_values({"p_String": "Grüße", "p_Binary": b"\x00\xff"})
    assert fmu.getString([110]) == ["Grüße"]
    assert fmu.getBinary([120]) == [b"\x00\xff"]
    instance.close()


def test_elements_that_are_not_given_stay(path):
    block = import_fmu(Fmu(path, parameters={"gain": 5.0, "gain[1]": 7.0, "p_UInt64": 2**64 - 1}), kind="cs")
    assert (block.params["gain[0]"], block.params["gain[1]"]) == (5.0, 7.0)
    gain = Signals([entry for entry in block.description.variables if entry.name == "gain"], "3.0")
    now = [0.0, np.zeros(1), [*np.zeros(12), -1.0]]
    block.output(*now)
    assert block.instance._fmu.getUInt64([90]) == [2**64 - 1]
    block.dynamics(*now)
    block.output(0.1, [1.0], now[2], params={"gain[0]": 2.0})
    assert gain.read(block.instance).tolist() == [2.0, 7.0], "and not its start value, 2"


@pytest.mark.slow
@pytest.mark.parametrize("isolated", [False, True])
@pytest.mark.parametrize("scheme", ["jacobi", "gauss-seidel"])
def test_texts_and_bytes_go_around(path, scheme, isolated):
    """Each adds its letter in a step: by Gauss-Seidel the second sees the first's of the same step."""
    whole = System(
        dict.fromkeys("ab", Fmu(path, isolated=isolated)),
        [
            ("b.u_String", "a.y_String"),
            ("a.u_String", "b.y_String"),
            ("b.u_Binary", "a.y_Binary"),
            ("b.a", "a.x"),
        ],
        parameters={"a.p_String": "x", "b.p_String": "-", "a.p_Binary": b"\0", "a.u_Binary": "ff"},
    )
    found = cosimulate(whole, T[:4], master=Master(scheme=scheme))
    late = scheme == "jacobi"
    assert found.success
    expected = (["", "x", "x-", "x-x"], ["", "-", "-x", "-x-"])
    if not late:
        expected = (["", "x", "x-x", "x-x-x"], ["", "-x", "-x-x", "-x-x-x"])
    assert (found.texts["a.y_String"].tolist(), found.texts["b.y_String"].tolist()) == expected
    assert found.texts["a.y_Binary"].tolist() == [b"", *[b"\0\xff"] * 3]
    assert found.texts["b.y_Binary"].tolist() == [b""] * (1 + late) + [b"\0\xff"] * (3 - late)
    numbers = dict(zip(found.output_labels, found.outputs, strict=True))
    np.testing.assert_allclose(numbers["a.x[0]"], 0.5 * T[:4], rtol=1e-14)
    chosen = cosimulate({"a": path}, timepts=T, outputs=["a.y_String", "a.sum"])
    assert (list(chosen.texts), list(chosen.output_labels)) == (["a.y_String"], ["a.sum"])


@pytest.mark.slow
def test_step_control_goes_back_with_texts(path):
    wired = System({"a": path}, [("a.u_String", "a.y_String")], parameters={"a.p_String": "x"})
    found = cosimulate(wired, T, master=Master(0.1, tolerance=1e-3))
    assert found.texts["a.y_String"][-1] == "x" * min(2 * found.steps, 31), (
        "two halves of each step, no whole one"
    )


@pytest.mark.parametrize(("wire", "inputs", "message"), [
    (("b.a[0]", "a.y_String"), {}, "'a.y_String' is String and 'b.a.0.' a number, or not there: String goes to String"),
    (("b.u_String", "a.sum"), {}, "'b.u_String' is String and 'a.sum' a number"),
    (("b.u_String", "a.y_Binary"), {}, "'b.u_String' is String and 'a.y_Binary' Binary, which it cannot take"),
    (("b.u_String", "-a.y_String"), {}, "'b.u_String' is String: expected one output as it is, no sum"),
    (("b.u_Int8", "a.sum"), {}, "'b.u_Int8' is Int8 and 'a.sum' Float64, which it cannot take"),
    (("b.a[0]", "a.sum"), {"b.u_String": 1.0}, "inputs: 'b.u_String' is String, no signal of numbers"),
])  # fmt: skip
def test_wires_between_types(path, wire, inputs, message):
    with pytest.raises(ValueError, match=message):
        cosimulate(System({"a": path, "b": path}, [wire]), T, inputs=inputs)


@pytest.mark.parametrize("entry", [5, "ab", ("b.u_String",), ("b.u_String", 1.0)])
def test_what_is_no_connection(path, entry):
    with pytest.raises(ValueError, match=r"connections: expected \(.part.input., .part.output., ...\), got"):
        cosimulate(System({"b": path}, [entry]), T)


def test_whole_numbers_drive_floating_point(path):
    wired = System({"a": path, "b": path}, [("b.a[0]", "a.y_UInt8")], parameters={"a.u_UInt8": 200})
    found = cosimulate(wired, T, outputs=["b.x[0]"])
    np.testing.assert_allclose(found.outputs[0], 200.0 * T, rtol=1e-14)


@pytest.mark.slow
def test_arrays_as_long_as_a_structural_parameter(path):
    """x' = a from 0, sum = gain' x: closed forms, and FMPy on the same FMU at its own size."""
    a, gain = np.array([1.0, -2.0, 3.0, 0.5]), np.array([1.0, 2.0, 3.0, 4.0])
    with pytest.raises(
        ValueError, match=r"channels .* structural parameter: expected a whole number, 1 to 5, got 6"
    ):
        import_fmu(Fmu(path, parameters={"channels": 6}))
    model = import_fmu(Fmu(path, parameters={"channels": 4}), kind="me")
    assert (model.nstates, model.state_labels[-1]) == (4, "x[3]")
    np.testing.assert_array_equal(model.start_inputs[:4], [0.5, 1.0, 1.5, 2.0], "as the FMU has them")
    assert "gain[0]" not in model.params, "the description has values for another size"
    held = np.concatenate([a, model.start_inputs[4:]])
    exchanged = simulate(model, T, np.outer(held, np.ones(6)))
    parameters = {"fmu.channels": 4} | {f"fmu.a[{i}]": value for i, value in enumerate(a)}
    stepped = cosimulate({"fmu": Fmu(path, isolated=True)}, T, parameters=parameters)
    for labels, outputs, name in (
        (exchanged.output_labels, exchanged.outputs, ""), (stepped.output_labels, stepped.outputs, "fmu."),
    ):  # fmt: skip
        rows = dict(zip(labels, outputs, strict=True))
        for i in range(4):
            np.testing.assert_allclose(rows[f"{name}x[{i}]"], a[i] * T, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(rows[f"{name}sum"], gain @ a * T, rtol=1e-12, atol=1e-14)
    with pytest.raises(ValueError, match=r"gain has another size than by default; give all its 4 elements"):
        import_fmu(Fmu(path, parameters={"channels": 4, "gain[1]": 1.0}), kind="cs").step(np.zeros(15))
    own = cosimulate({"fmu": path}, timepts=T, outputs=["fmu.sum"])
    other = fmpy.simulate_fmu(
        str(path), stop_time=1.0, output_interval=0.2, output=["sum"], fmi_type="CoSimulation"
    )
    np.testing.assert_allclose(own.outputs[0], other["sum"], rtol=1e-13)


@pytest.mark.slow
def test_the_command_sets_and_records_all_types(path, tmp_path, capsys):
    out = tmp_path / "out.csv"
    options = ["--set", "channels=3", "--set", "p_String=5", "p_Boolean=true", "--set", "u_Binary=00ff"]
    assert main(["fmu", "run", str(path), "--stop", "0.2", *options, "--record", "x", "--record", "y_B*", "y_S*",
                 "--out", str(out)]) == 0  # fmt: skip
    rows = list(csv.reader(out.read_text().splitlines()))
    assert rows[0] == ["time", "x[0]", "x[1]", "x[2]", "y_Boolean", "y_String", "y_Binary"]
    assert rows[-1][-2:] == ["5", "00ff"]
    assert "y_Binary                 '' -> '00ff'" in capsys.readouterr().out
    with pytest.raises(ValueError, match="y_String is String, which no signal of python-control can be"):
        import_fmu(Fmu(path, outputs=["x", "y_String"]), kind="me")
    starts = {entry["name"]: entry["start"] for entry in json.loads(describe(path).as_json())["variables"]}
    assert starts["p_String"] == ["as delivered"]
