"""The checker finds what is wrong, and only that."""

import json
import subprocess
import zipfile

import control as ct
import numpy as np
import pytest
from fmpy.model_description import ModelDescription, ModelVariable
from fmpy.validation import _validate_variable_names
from foreign_ball import ball
from foreign_fmus import FOLDERS, compiled, description, oscillator

from phyfilter_ctl import simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import Fmu, cosimulate, import_fmu
from phyfilter_ctl.fmi import check as check_apart
from phyfilter_ctl.fmi.names import is_structured
from phyfilter_ctl.fmi.replay import Reference

T = np.linspace(0.0, 1.0, 51)
M, K, D, C = 2.0, 8.0, 0.4, 3.0


def check(path, **chosen):
    """In this process: one for each is what test_hostile_fmus.py is about."""
    parameters = chosen.pop("parameters", {})
    return check_apart(Fmu(path, parameters=parameters, isolated=False), **chosen)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("foreign")


def held_response(u):
    """x, v, force at T on inputs held from one time to the next, by python-control."""
    A = [[0.0, 1.0], [-(K + C) / M, -D / M]]
    plant = ct.ss(A, [[0.0], [C / M]], [[1.0, 0.0], [0.0, 1.0], [-C, 0.0]], [[0.0], [0.0], [C]])
    return ct.forced_response(ct.c2d(plant, 0.02, "zoh"), T, u, [1.0, 0.0]).outputs


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("reference") / "oscillator_out.csv"
    u = np.sin(3 * T)
    x, v, force = held_response(u)
    Reference(T, {"place": u}, {"x": x, "v": v, "force": force}).write(path)
    return path


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_sound_fmu(folder, fmi):
    report = check(oscillator(folder, fmi))
    assert report.ok
    assert not report.findings
    assert "model exchange: dependencies" in report.stages
    assert "co-simulation: state" in report.stages
    assert str(report).startswith(f"{folder}/oscillator.fmu: ok\n")
    assert json.loads(report.as_json())["ok"] is True


@pytest.mark.parametrize(
    ("options", "stage", "message"),
    [
        (
            {"declared": False},
            "co-simulation: dependencies",
            "force depends on place, which its dependencies leave out",
        ),
        ({"defines": ("FAIL_AT=0.5",)}, "co-simulation: run", "spring broke at t = 0.5: too long"),
        ({"guid": "other"}, "model exchange: run", "guid is other, not oscillator"),
        ({"defines": ("NO_STATE",)}, "co-simulation: state", "fmi2GetFMUstate: error"),
        ({"unit": "yard"}, "structure and names", "yard"),
        ({"unit": "yard"}, "units", "place: unit 'yard' is not defined by base units"),
    ],
)
def test_broken_fmus(folder, options, stage, message):
    report = check(oscillator(folder, name="broken", **options))
    found = [entry.message for entry in report.errors if entry.stage == stage]
    assert any(message in text for text in found), str(report)
    assert "failed" in str(report)


def test_forgetful_state(folder):
    """An FMU that leaves something out of its state is caught by the bits of what follows."""
    report = check(oscillator(folder, name="forgetful", defines=("FORGETS",)))
    (error,) = report.errors
    assert error.stage == "co-simulation: state"
    assert "expected the same bits" in error.message


def test_files_that_are_no_fmu(tmp_path):
    path = tmp_path / "x.fmu"
    path.write_bytes(b"nothing")
    report = check(path)
    assert [entry.stage for entry in report.errors] == ["archive and schema"]
    assert not check(tmp_path / "none.fmu").ok
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description().replace('name="v"', 'name="x"'))
    assert any("not unique" in entry.message for entry in check(path).errors)


def test_another_platform_is_not_passed_silently(folder):
    report = check(oscillator(folder, name="windows", platform="win64"))
    assert report.ok
    assert [entry.level for entry in report.findings] == ["hint"]
    assert "not run: no binary for" in report.findings[0].message


def test_nothing_is_run_when_not_wanted(folder):
    report = check(oscillator(folder, name="other", guid="other"), run=False)
    assert report.ok
    assert "model exchange: run" not in report.stages


@pytest.mark.parametrize("fmi", ["2.0"])
def test_replay(folder, recorded, fmi):
    report = check(oscillator(folder, fmi), reference=recorded, rtol=0.0, atol=1e-8)
    assert report.ok, str(report)
    # RK4 steps of 1 ms against the exact response.
    assert 0.0 < report.figures["largest deviation from the reference"] < 1e-9
    wrong = check(oscillator(folder, fmi), reference=recorded, rtol=0.0, atol=1e-8, inputs_at="end")
    assert any(entry.stage == "replay" and "recorded" in entry.message for entry in wrong.errors)


def test_replay_of_another_models_record(folder, recorded, tmp_path):
    path = tmp_path / "y_out.csv"
    path.write_text("time,q\n0,0\n1,0\n")
    report = check(oscillator(folder), reference=path)
    assert any("recorded output 'q': the FMU has x, v, force" in entry.message for entry in report.errors)


def test_records_read_back(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "a_out.csv"
    Reference(T, {"u": rng.standard_normal(51)}, {"y[0]": rng.standard_normal(51)}).write(path)
    first = Reference.read(path)
    first.write(path)
    again = Reference.read(path)
    assert np.array_equal(first.outputs["y[0]"], again.outputs["y[0]"])
    assert np.array_equal(first.inputs["u"], np.random.default_rng(0).standard_normal(51))
    assert path.read_text().splitlines()[0] == '"time","y[0]"'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,y\n0,1\n", 'expected a header that starts with "time"'),
        ("time,y\n", "at least one row"),
        ("time,y\n0,x\n", "expected numbers"),
        ("time,y\n0,1\n1\n", "equally long rows"),
        ("time,y\n0,1\n0,1\n", "times that increase"),
    ],
)
def test_records_that_are_none(tmp_path, text, message):
    path = tmp_path / "a_out.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        Reference.read(path)
    with pytest.raises(ValueError, match=r"expected a file NAME_out\.csv"):
        Reference.read(tmp_path / "a.csv")
    with pytest.raises(ValueError, match='expected "start" or "end"'):
        check(path, inputs_at="middle")  # type: ignore[arg-type]  # the error is the point


def rewritten(path, *changes, name="other"):
    """The FMU with another text in its description."""
    target = path.with_name(f"{name}.fmu")
    with zipfile.ZipFile(path) as before, zipfile.ZipFile(target, "w") as after:
        for entry in before.namelist():
            data = before.read(entry)
            for old, new in changes if entry == "modelDescription.xml" else ():
                assert old in data.decode()
                data = data.decode().replace(old, new).encode()
            after.writestr(entry, data)
    return target


def test_what_the_standard_allows_is_no_error(folder):
    """Units without base units, an FMU that ends its own run, scheduled execution alone; each is a hint."""
    ends = check(oscillator(folder, name="ends", defines=("ENDS_AT=0.5",)))
    scheduled = rewritten(
        oscillator(folder, "3.0", kinds="cs"),
        ('<CoSimulation modelIdentifier="oscillator3"', '<ScheduledExecution modelIdentifier="oscillator3"'),
        (' canHandleVariableCommunicationStepSize="true"', ""),
    )
    baseless = rewritten(
        oscillator(folder, unit="yard"),
        ("<UnitDefinitions>", '<UnitDefinitions><Unit name="yard"/>'),
        name="yard",
    )
    reports = [ends, check(scheduled), check(baseless, run=False)]
    words = [
        "the FMU asks to end the run at t = 0.5",
        "scheduled execution only",
        "unit 'yard' has no base units",
    ]
    for report, text in zip(reports, words, strict=True):
        assert report.ok, str(report)
        assert any(entry.level == "hint" and text in entry.message for entry in report.findings), str(report)


@pytest.mark.slow
def test_values_that_an_fmu_takes(folder):
    """Enumerations are not set to 0; what FMI forbids outside event mode is not done: the ball answers it by Error."""
    for options in ({"numbers": True, "modes": True}, {"kinds": "me", "numbers": True, "modes": True}):
        report = check(oscillator(folder, "3.0", name="typed", **options))
        # Two names of one reference are an error of this FMU, which is there for what happens when it runs.
        assert {entry.stage for entry in report.errors} == {"structure and names"}, str(report)
    for fmi in ("2.0", "3.0"):
        report = check(ball(folder, fmi))
        assert report.ok, str(report)


def test_a_constant_parameter_is_left_alone(folder):
    constant = ('causality="parameter" variability="fixed"', 'causality="parameter" variability="constant"')
    path = rewritten(oscillator(folder), constant, name="constant")
    for options in ({"kind": "me"}, {"kind": "cs", "step": 0.1}):
        block = import_fmu(path, **options)
        assert set(block.params) == {"k", "d", "c"}


def test_an_fmu_without_outputs_is_run(folder, capsys):
    outputs = '<Outputs><Unknown index="3" dependencies=""/><Unknown index="4" dependencies=""/>'
    outputs += '<Unknown index="7" dependencies="2 3"/></Outputs>'
    path = rewritten(
        oscillator(folder), ('causality="output"', 'causality="local"'), (outputs, ""), name="silent"
    )
    for kind in ("me", "cs"):
        options = ["--kind", kind, "--stop", "0.1", "--step", "0.05", "--in-process"]
        assert main(["fmu", "run", str(path), *options]) == 0
        assert "Oscillator: 3 points, 0 to 0.1 s" in capsys.readouterr().out


@pytest.mark.slow
def test_each_run_starts_where_a_fresh_instance_does(folder):
    """Whatever Reset leaves behind."""
    block = import_fmu(oscillator(folder, name="resets", defines=("RESETS_TO_0",)), kind="me")
    for _ in range(2):
        assert simulate(block, T, np.zeros_like(T)).outputs[0, 0] == 1.0


@pytest.mark.slow
def test_the_tolerance_of_the_default_experiment(folder):
    """Of the FMU's own solver: checked, and run, with the one that its maker chose."""
    path = oscillator(folder, name="choosy", defines=("TOLERANCE=1e-6",), kinds="cs")
    assert check(path).ok
    assert cosimulate({"a": path}, T).success


@pytest.mark.slow
def test_what_this_machine_has_not(folder, tmp_path):
    """A library that the binary links, the tool that the FMU says it needs: no fault of the FMU's."""
    subprocess.run(
        ["gcc", "-shared", "-x", "c", "/dev/null", "-o", str(tmp_path / "libphantom.so")], check=True
    )
    flags = ("-Wl,--no-as-needed", f"-L{tmp_path}", "-lphantom")
    linked = compiled("oscillator2.c", tmp_path / "oscillator2.so", *flags)
    (tmp_path / "libphantom.so").unlink()
    path = tmp_path / "linked.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description(kinds="cs"))
        archive.write(linked, f"binaries/{FOLDERS['2.0']}/oscillator2.so")
    tooled = rewritten(
        oscillator(folder, kinds="cs", guid="other"),
        ('"oscillator2"', '"oscillator2" needsExecutionTool="true"'),
    )
    with pytest.warns(UserWarning, match="the tool that made it"):
        reports = [check(path), check(tooled)]
    for report, text in zip(reports, ("libphantom.so", "guid is other"), strict=True):
        assert report.ok, str(report)
        assert report.stages[-1] == "co-simulation: run"
        (found,) = [entry for entry in report.findings if entry.level == "warning"]
        assert "not run, for want of something outside the FMU" in found.message
        assert text in found.message


NAMES = [
    *("x", "_x1.y", "a[1,20].b[3]", "der(x)", "der(a.b[2],3)", "'a b'.c", r"'it\'s'", "'[]'[4]", "a.'\\n'"),
    *(
        "",
        "1x",
        "x.",
        ".x",
        "x..y",
        "x[]",
        "x[a]",
        "x[1][2]",
        "x[1,]",
        "der(x",
        "der(der(x))",
        "der()",
        "der(x,)",
    ),
    *("x y", "''", "'a", "'a'b", "x[\u0663]", "\u00e9", "der(x,y)", "xder(y)", "x\n"),
]


@pytest.mark.slow
def test_names_of_the_structured_convention():
    """As FMPy's grammar has them, which takes any letter after a backslash; FMI's takes some."""
    assert not is_structured(r"'\z'")
    for name in NAMES:
        variable = ModelVariable(name=name, valueReference=1, type="Real")
        model = ModelDescription(variableNamingConvention="structured", modelVariables=[variable])
        assert is_structured(name) == (not _validate_variable_names(model)), name


def test_a_name_against_the_convention(folder):
    structured = (
        ('guid="', 'variableNamingConvention="structured" guid="'),
        ('name="steps"', 'name="der(der(x))"'),
    )
    (error,) = check(rewritten(oscillator(folder), *structured, name="odd"), run=False).errors
    assert "'der(der(x))'" in error.message
    assert error.rule == "FMI 2.0, 2.2.9"


def test_errors_have_a_paragraph(folder):
    report = check(oscillator(folder, name="broken", unit="yard"), run=False)
    assert {entry.rule for entry in report.errors} == {"FMI 2.0, 2.2.2"}
    assert "(FMI 2.0, 2.2.2)" in str(report)
