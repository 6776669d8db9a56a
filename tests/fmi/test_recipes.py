"""Recipes of FMUs: what is recorded is the library's own result, and the FMUs reproduce it."""

import csv
import shutil
from pathlib import Path

import control as ct
import numpy as np
import pytest

from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.codegen.compiler import CompilerError
from phyfilter_ctl.fmi.recipes import check_all, check_recipe, read_recipe, rebuild, record
from tests.cpu_budget import slow_but

ROOT = Path(__file__).resolve().parents[2] / "fmus"
RECIPES = sorted(path.parent.name for path in ROOT.glob("*/recipe.toml"))
# The record is rewritten by the same code on another machine's mathematics library.
SAME = 1e-12

try:
    find_compiler()
    COMPILER = True
except CompilerError:
    COMPILER = False
needs_compiler = pytest.mark.skipif(not COMPILER, reason="no C compiler: FMUs cannot be built")


def table(path):
    with path.open(newline="") as file:
        header, *rows = list(csv.reader(file))
    return header, np.array(rows, dtype=float)


# CI builds and checks every one with `phyfilter-ctl fmu recipes fmus`.
@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", ["phyfilter_sampled"])
def test_fmus_reproduce_the_record(name):
    reports = check_recipe(ROOT / name)
    assert reports
    for report in reports:
        assert report.ok, str(report)
        assert "replay" in report.stages


@pytest.mark.parametrize("name", slow_but(RECIPES[:1], RECIPES))
def test_record_is_up_to_date(name, tmp_path):
    copy = tmp_path / name
    shutil.copytree(ROOT / name, copy, ignore=shutil.ignore_patterns("*.fmu", "*_out.csv"))
    header, fresh = table(record(copy))
    kept_header, kept = table(ROOT / name / f"{name}_out.csv")
    assert header == kept_header
    assert np.max(np.abs(fresh - kept)) < SAME


def motor():
    """A system for a recipe: J w' = u - d w."""
    return ct.ss([[-0.5]], [[2.0]], [[1.0]], [[0.0]], inputs=["u"], outputs=["w"], states=["w"], name="motor")


def write(folder, **changes):
    text = {
        "filter": f'system = "{__name__}:motor"',
        "fmi": '["3.0"]',
        "step": "0.01",
        "inputs_at": '"start"',
        "more": "",
    } | changes
    folder.mkdir(exist_ok=True)
    (folder / "recipe.toml").write_text(
        f"""format = "phyfilter-fmu"
version = 1
{text["filter"]}
[export]
fmi = {text["fmi"]}
{text["more"]}
[reference]
step = {text["step"]}
stop = 0.5
inputs_at = {text["inputs_at"]}
rtol = 0.0
atol = 1e-9
"""
    )
    return folder


@pytest.mark.slow
@needs_compiler
def test_recipe_of_a_system(tmp_path):
    """Recorded by simulation of the diagram, held against the closed form and the FMU."""
    folder = write(tmp_path / "motor")
    header, values = table(record(folder))
    assert header == ["time", "w"]
    names, inputs = table(folder / "motor_in.csv")
    assert names == ["time", "u"]
    exact = [0.0]
    decay = np.exp(-0.005)
    for u in inputs[:-1, 1]:
        exact.append(decay * exact[-1] + 4.0 * (1.0 - decay) * u)
    assert np.max(np.abs(values[:, 1] - exact)) < SAME
    assert all(report.ok for reports in check_all(tmp_path).values() for report in reports)
    assert rebuild(folder).name == "motor.fmu"


@needs_compiler
def test_a_wrong_record_is_found(tmp_path):
    folder = write(tmp_path / "motor")
    path = record(folder)
    lines = path.read_text().splitlines()
    lines[20] = f"{lines[20].split(',')[0]},7.0"
    path.write_text("\n".join(lines))
    (report,) = check_recipe(folder)
    (error,) = report.errors
    assert "w: " in error.message
    assert "recorded 7" in error.message


def test_own_inputs_are_kept(tmp_path):
    folder = write(tmp_path / "motor")
    (folder / "motor_in.csv").write_text("time,u\n0,1\n0.5,1\n")
    _, values = table(record(folder))
    assert np.max(np.abs(values[:, 1] - 4.0 * (1.0 - np.exp(-0.5 * values[:, 0])))) < SAME


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filter": ""}, "expected either filter"),
        ({"filter": 'system = "math:sin"'}, "expected module:function"),
        ({"filter": 'system = "builtins:dict"'}, "expected a function that returns a python-control system"),
        ({"filter": f'system = "{__name__}:engine"'}, "expected module:function"),
        ({"fmi": '["1.0"]'}, "expected one of 2.0, 3.0, got '1.0'"),
        ({"step": "0.0"}, "expected 0 < step <= stop"),
        ({"inputs_at": '"middle"'}, "expected one of start, end"),
        ({"more": "chanels = 3"}, "did you mean 'channels'"),
    ],
)
def test_wrong_recipes(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        read_recipe(write(tmp_path / "motor", **changes))


def test_missing_files(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_recipe(tmp_path)
    with pytest.raises(FileNotFoundError, match="nothing is recorded"):
        check_recipe(write(tmp_path / "motor"))
    with pytest.raises(ValueError, match="no recipes"):
        check_all(tmp_path / "motor")
