"""Types and values at the border to an FMU: what does not fit is refused before anything is set."""

import tracemalloc

import numpy as np
import pytest
from foreign_fmus import description

from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import FmuError, Master, System, check, cosimulate, describe, import_fmu
from phyfilter_ctl.fmi.archive_write import write_archive
from phyfilter_ctl.fmi.cosimulation_run import Run
from phyfilter_ctl.fmi.inspect import FmuVariable
from phyfilter_ctl.fmi.instance import FmuInstance
from phyfilter_ctl.fmi.signals import Signals
from phyfilter_ctl.fmi.unpacked import UnpackedFmu

T = np.linspace(0.0, 1.0, 11)


@pytest.fixture(scope="module")
def build(build):
    """FMI 3.0, which has all types, unless another version is asked for."""
    return lambda fmi="3.0", **options: build(fmi, **options)


REFUSED = {
    "tiny": [
        (300.0, "expected -128 to 127, got 300"),
        (2.9, "expected an integer, got 2.9"),
        (np.nan, "an integer"),
    ],
    "positive": [(-1.0, "expected 0 to 255, got -1"), (np.inf, "expected an integer, got inf")],
    "mode": [(1.0, "expected one of -1, 2, got 1")],
    "flag": [(2.0, "expected 0 or 1, got 2"), (0.5, "expected 0 or 1")],
    "started": [
        (2.9, "expected an integer"),
        (2.0**31, "expected -2147483648 to 2147483647"),
        ("fast", "a number"),
    ],
}


def test_values_that_do_not_fit_change_nothing(build):
    instance = FmuInstance(UnpackedFmu(build(numbers=True, modes=True)), "cs", "typed")
    fits = {"tiny": -128, "positive": 255, "mode": 2, "flag": "true", "started": 7, "place[1]": 0.5}
    instance.set_values(fits)
    there = Signals([entry for entry in instance.description.variables if entry.name in REFUSED], "3.0")
    expected = [-128.0, 255.0, 2.0, 1.0, 7.0]
    assert sorted(there.read(instance)) == sorted(expected)
    for name, cases in REFUSED.items():
        for value, message in cases:
            with pytest.raises(ValueError, match=message):
                instance.set_values({"place": 9.0, "tiny": 1, "flag": 0} | {name: value})
    assert sorted(there.read(instance)) == sorted(expected)
    assert instance.signals("input").read(instance)[:2].tolist() == [0.0, 0.5]
    with pytest.raises(ValueError, match="more digits than a double carries"):
        instance.set_values({"place[0]": 2**53 + 1})
    with pytest.raises(ValueError, match=f"expected one of -1, 2, got {2**53 + 1}$"):
        instance.set_values({"mode": 2**53 + 1})  # integers keep all digits
    instance.close()


class Recorder:
    """Takes what Signals sends, with nothing behind it."""

    def __init__(self):
        self.calls = []

    def call_raw(self, function, *arguments):
        self.calls.append((function, list(arguments[2])))


@pytest.mark.parametrize(
    ("fmi", "kind", "value", "message"),
    [
        ("2.0", "Int32", 2.9, "expected an integer"),
        ("2.0", "Int32", np.nan, "expected an integer"),
        ("2.0", "Boolean", 2.0, "expected 0 or 1"),
        ("3.0", "Float32", 1e39, r"expected at most 3.40282e\+38"),
        ("3.0", "Int64", 2.0**63, "expected -9223372036854775808 to 9223372036854775807"),
        ("3.0", "UInt64", 2.0**64, "expected 0 to 18446744073709551615"),
        ("3.0", "UInt16", -1.0, "expected 0 to 65535"),
    ],
)
def test_edges_of_types(fmi, kind, value, message):
    variable = FmuVariable("n", 0, kind, "input", "discrete")
    taken = Recorder()
    with pytest.raises(ValueError, match=rf"n \({kind}\): {message}"):
        Signals([FmuVariable("first", 1, "Float64", "input", "continuous"), variable], fmi).write(
            taken, np.array([1.0, value])
        )
    assert not taken.calls
    Signals([variable], fmi).write(taken, np.array([1.0]))
    assert taken.calls[0][1] == [1]


@pytest.mark.slow
@pytest.mark.parametrize("modes", [False, True])
def test_integers_on_the_way_through_a_run(build, modes):
    """A signal that does not fit ends the run by name, with the results so far; in the loop in C and in Python."""
    path = build(numbers=True, modes=modes)
    with pytest.raises(
        FmuError, match=r"'a': set inputs: refused: tiny \(Int8\): .* integer, got 0.5, at t = 0"
    ) as caught:
        cosimulate({"a": path}, timepts=T, inputs={"a.tiny": np.where(T > 0.45, 0.5, 0.0)})
    assert caught.value.results is not None
    assert np.flatnonzero(np.isnan(caught.value.results.outputs[0]))[0] == 5
    block = import_fmu(path, kind="cs")
    with pytest.raises(ValueError, match=r"positive \(UInt8\): expected 0 to 255, got -1"):
        block.step([0.0, 0.0, 0.0, -1.0, 0.0, *[-1.0] * modes])


@pytest.mark.slow
@pytest.mark.parametrize("in_c", [True, False])
@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_an_output_that_is_no_number_is_no_success(build, tolerance, in_c, monkeypatch):
    monkeypatch.setattr(Run, "in_c", in_c)
    path = build("2.0", defines=("MISCHIEF_AT=0.35", "MISCHIEF=NOT_A_NUMBER"))
    found = cosimulate(
        System({"a": path, "b": build("2.0")}, [("b.place", "a.x")]),
        T,
        master=Master(0.05, tolerance=tolerance),
    )
    assert not found.success
    assert found.message.startswith("a.x is nan, a.v is nan, a.force is nan and 1 more at t = 0.35: look at")
    assert np.all(np.isfinite(found.outputs[:, :4]))
    assert np.all(np.isnan(found.outputs[:, 5:]))
    alone = cosimulate({"a": path, "b": build("2.0")}, T, outputs=["b.x"])
    assert alone.success, "nobody looks at what is no number there"


@pytest.mark.slow
def test_the_command_fails_on_what_is_no_number(build, capsys):
    path = build("2.0", defines=("MISCHIEF_AT=0.35", "MISCHIEF=NOT_A_NUMBER"))
    assert main(["fmu", "run", str(path), "--stop", "1", "--step", "0.1", "--in-process"]) == 1
    assert "fmu.x is nan" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("in_c", [True, False])
def test_the_flag_that_says_whether_there_is_a_way_back(build, in_c, monkeypatch):
    """Equal steps: none. Step control: back to where the pair of half steps began, so from the second half only."""
    monkeypatch.setattr(Run, "in_c", in_c)
    path = build(defines=("TELLS",))
    equal = cosimulate({"a": path}, timepts=T)
    assert set(equal.messages["a"]) == {"[ok] step: no way back"}
    controlled = cosimulate({"a": path}, T[:3], master=Master(tolerance=1e-2))
    coarse, first, second = controlled.messages["a"][:3]
    assert (coarse, first, second) == ("[ok] step: no way back",) * 2 + ("[ok] step: may go back",)
    block = import_fmu(path, kind="cs")
    block.step(np.zeros(2))
    assert block.messages[-1] == "[ok] step: no way back"
    block.dynamics(0.01, [1.0], np.zeros(2))
    block.output(0.02, [2.0], np.zeros(2))
    assert block.messages[-1] == "[ok] step: may go back", "python-control may ask for the step before"


def test_dimensions_that_would_fill_memory(tmp_path):
    """4 kB that say 1e9, or 1e5 times 1e5 by a structural parameter."""
    for size, text in (("1000000000", ""), ("100000", '<Dimension valueReference="1"/>')):
        document = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Wide" instantiationToken="x">
  <CoSimulation modelIdentifier="wide"/>
  <ModelVariables>
    <UInt64 name="n" valueReference="1" causality="structuralParameter" variability="fixed" start="100000"/>
    <Float64 name="wide" valueReference="2" causality="output"><Dimension start="{size}"/>{text}</Float64>
  </ModelVariables>
  <ModelStructure><Output valueReference="2"/></ModelStructure>
</fmiModelDescription>"""
        path = tmp_path / "wide.fmu"
        write_archive(path, {"modelDescription.xml": document.encode()})
        tracemalloc.start()
        with pytest.raises(ValueError, match=r"wide: dimensions .* at most 1000000 scalars"):
            describe(path)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 50e6
        assert "at most 1000000 scalars" in str(check(path, run=False))
        path.unlink()
    named = description("3.0").replace('name="m"', f'name="{"m" * 2001}"')
    write_archive(path, {"modelDescription.xml": named.encode()})
    with pytest.raises(ValueError, match="name has 2001 characters"):
        describe(path)
