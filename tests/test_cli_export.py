"""export and fmu: what a user types, with a real compiler where one is there."""

import json
import os
import shutil
import subprocess
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main

COMPILER = shutil.which("gcc") or shutil.which("cc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


def save_wing(path):
    pf.save(path, pf.lowpass(2, 20.0).sampled(0.002, channels=["vx", "vy"], units={"x": "m/s"}))


@pytest.fixture
def filter_file(tmp_path):
    path = tmp_path / "wing.toml"
    save_wing(path)
    return str(path)


@pytest.fixture(scope="module")
def wing(tmp_path_factory):
    """The same filter as FMU."""
    folder = tmp_path_factory.mktemp("wing")
    source, target = str(folder / "wing.toml"), str(folder / "wing.fmu")
    save_wing(source)
    with redirect_stdout(StringIO()) as shown:
        assert main(["export", source, "--fmu", target, "--fmi", "2.0"]) == 0
    assert target in shown.getvalue()
    return target


@needs_compiler
def test_a_filter_as_fmu_and_back(wing, capsys):
    assert main(["fmu", "describe", wing, "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["fmi"] == "2.0"
    assert {"x[0]", "f_hat[1]"} <= {variable["name"] for variable in found["variables"]}
    assert main(["fmu", "check", wing, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["ok"]


@pytest.mark.skipif(os.name == "nt", reason="the compiler that fails here is a script of a shell")
def test_a_compiler_that_fails_is_an_error_with_its_words(filter_file, tmp_path, monkeypatch, capsys):
    failing = tmp_path / "cc"
    failing.write_text("#!/bin/sh\necho no licence left >&2\nexit 3\n")
    failing.chmod(0o755)
    monkeypatch.setenv("CC", str(failing))
    before = sorted(tmp_path.iterdir())
    assert main(["export", filter_file, "--fmu", str(tmp_path / "wing.fmu")]) == 2
    said = capsys.readouterr().err
    assert said.startswith("phyfilter-ctl: error: C compiler")
    assert "no licence left" in said
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.slow
@needs_compiler
def test_an_fmu_runs_on_inputs(wing, tmp_path):
    inputs, out = tmp_path / "in.csv", tmp_path / "out.csv"
    inputs.write_text("time,x[0]\n0,0\n1,3\n")
    picture = tmp_path / "run.png"
    arguments = [
        "--stop",
        "1",
        "--step",
        "0.002",
        "--input",
        str(inputs),
        "--out",
        str(out),
        "--picture",
        str(picture),
    ]
    assert main(["fmu", "run", wing, *arguments]) == 0
    rows = out.read_text().splitlines()
    assert rows[0] == "time,f_hat[0],f_hat[1]"
    # x grows by 3 a second with g = f_theta = 0, so f = 3.
    assert float(rows[-1].split(",")[1]) == pytest.approx(3.0, abs=1e-3)
    assert float(rows[-1].split(",")[2]) == 0.0
    assert picture.stat().st_size > 1000


@needs_compiler
def test_a_refused_start_value_ends_the_run(wing, tmp_path, capsys):
    """No Hurwitz filter has a[0] = 0: the FMU only warns and would go on with the coefficients it was made with."""
    out = tmp_path / "out.csv"
    run = ["fmu", "run", wing, "--stop", "0.01", "--out"]
    assert main([*run, str(out), "--set", "a[0]=-1"]) == 2  # below its minimum: the FMU is not asked
    assert "a[0] (Float64): expected 0 to inf" in capsys.readouterr().err
    assert main([*run, str(out), "--set", "a[0]=0"]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "refused: a[0] is 965.685, not 0" in shown.err
    assert "not Hurwitz" in shown.err
    assert not out.exists()
    assert main([*run, "-", "--set", "a[0]=300"]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("time,")
    assert "warning" not in shown.err


@needs_compiler
def test_a_filter_as_c_checks_itself(filter_file, tmp_path, capsys):
    folder = tmp_path / "firmware"
    assert main(["export", filter_file, "--c", str(folder), "--real", "float", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["c"] == str(folder)
    program = tmp_path / "check"
    sources = sorted(map(str, folder.glob("*.c")))
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run([str(COMPILER), *flags, *sources, "-o", str(program)], check=True)
    assert subprocess.run([str(program)], check=False, capture_output=True).returncode == 0


@pytest.mark.slow
@needs_compiler
def test_recipes_are_built_and_checked(tmp_path, capsys):
    """Two of the repository's; the rest take minutes, their own systems have tests of their own."""
    for name in ("phyfilter_sampled", "drone_filter"):
        shutil.copytree(Path(__file__).parents[1] / "fmus" / name, tmp_path / name)
    assert main(["fmu", "recipes", str(tmp_path)]) == 0
    assert capsys.readouterr().out.count(": ok") == 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "acceleration"], "--fmu FILE, --ssp FILE, --c DIR and --target NAME DIR"),
        (["export", "nothing.toml", "--fmu", "a.fmu"], "neither a filter file nor a model"),
        (["export", "acceleration", "--fmu", "a.zip"], "ends in .fmu"),
        (["export", "acceleration", "--fmu", "a.fmu", "--channels", "3"], "is a model"),
        (["fmu", "describe", "nothing.fmu"], "nothing.fmu"),
        (["fmu", "run", "nothing.fmu", "--set", "a"], "nothing.fmu"),
    ],
)
def test_wrong_commands_say_what_is_wrong(arguments, message, capsys):
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_filter_options_that_do_not_fit(filter_file, tmp_path, capsys):
    assert main(["export", filter_file, "--ssp", str(tmp_path / "a.ssp")]) == 2
    assert "diagram of several blocks" in capsys.readouterr().err
    assert main(["export", filter_file, "--c", str(tmp_path / "c"), "--dt", "0.1"]) == 2
    assert "sampled every 0.002 s already" in capsys.readouterr().err
    continuous = tmp_path / "continuous.toml"
    pf.save(continuous, pf.lowpass(2, 20.0))
    assert main(["export", str(continuous), "--c", str(tmp_path / "c")]) == 2
    assert "--dt" in capsys.readouterr().err
