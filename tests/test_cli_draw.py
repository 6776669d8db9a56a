"""``phyfilter-ctl draw``: filters, models, FMUs, packages and functions by name, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from phyfilter_ctl.cli import main

SERVO = """
import control as ct


def build():
    plant = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="plant")
    law = ct.tf([2.0, 1.0], [1.0, 0.0], inputs="e", outputs="u", name="PI")
    error = ct.summing_junction(["r", "-y"], "e", name="error")
    return ct.interconnect([plant, law, error], inputs="r", outputs="y", name="servo")


class Shop:
    @staticmethod
    def build():
        return build()


def scaled(gain):
    return gain


loop = build()
number = 3
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "servo_of_test", raising=False)
    (tmp_path / "servo_of_test.py").write_text(SERVO)
    return tmp_path


@pytest.mark.parametrize("name", ["build", "Shop.build", "loop"])
def test_a_function_of_a_module_here(name: str, folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["draw", f"servo_of_test:{name}", "-o", "servo.svg", "--json", "servo.json"]) == 0
    picture = Path("servo.svg").read_text()
    assert picture.startswith("<svg") or picture.startswith("<?xml")
    assert 'data-signal="PI.u"' in picture
    told = json.loads(Path("servo.json").read_text())
    assert told["picture"] == "servo.svg"
    assert {"PI.u", "error.e", "plant.y"} <= set(told["signals"])
    shown = capsys.readouterr()
    assert "PI.u" in shown.out
    assert "wrote servo.svg, servo.json" in shown.err


def test_standard_output_is_the_picture_alone(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["draw", "servo_of_test:build", "-o", "-"]) == 0
    shown = capsys.readouterr()
    assert shown.out.rstrip().endswith("</svg>")
    assert shown.out.count("<svg") == 1
    assert not shown.err


def test_a_filter_file(folder: Path):
    assert main(["design", "--poles", "-20,-20", "--out", "filter.toml", "--quiet"]) == 0
    assert main(["draw", "filter.toml", "-o", "filter.svg", "--quiet"]) == 0
    assert "data-signal" in Path("filter.svg").read_text()


def test_depth_opens_what_is_inside(folder: Path, capsys: pytest.CaptureFixture[str]):
    inside: dict[int, set[str]] = {}
    for depth in (0, 1):
        assert main(["draw", "drone", "--depth", str(depth), "--json", "-"]) == 0
        inside[depth] = set(json.loads(capsys.readouterr().out)["signals"])
    assert len(inside[1]) > len(inside[0])


@pytest.mark.slow
@pytest.mark.xfail(reason="pf.draw takes no paths of FMUs and packages yet", strict=True)
def test_fmus_and_packages(folder: Path):
    assert main(["design", "--poles", "-20", "--dt", "0.01", "--out", "filter.toml", "--quiet"]) == 0
    assert main(["export", "filter.toml", "--fmu", "filter.fmu", "--channels", "2", "--quiet"]) == 0
    assert main(["draw", "filter.fmu", "-o", "fmu.svg", "--quiet"]) == 0
    assert (
        "f_hat" in Path("fmu.svg").read_text()
        or "f\N{COMBINING CIRCUMFLEX ACCENT}" in Path("fmu.svg").read_text()
    )
    assert main(["export", "acceleration", "--ssp", "package.ssp", "--quiet"]) == 0
    assert main(["draw", "package.ssp", "-o", "ssp.svg", "--quiet"]) == 0
    assert "data-signal" in Path("ssp.svg").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["servo_of_test:build"], "expected -o FILE for the picture"),
        (["absent.toml", "-o", "a.svg"], "absent.toml: neither a file, nor MODULE:FUNCTION"),
        (["absent:build", "-o", "a.svg"], "absent: cannot be imported: No module named 'absent'"),
        (["servo_of_test:absent", "-o", "a.svg"], "there is no such function"),
        (["servo_of_test:scaled", "-o", "a.svg"], "expected a function that needs no arguments"),
        (["servo_of_test:number", "-o", "a.svg"], "int"),
        (["servo_of_test:build", "-o", "a.gif"], "expected a file that ends in .svg, .png, .pdf"),
        (["servo_of_test:build", "-o", "absent/a.svg"], "there is no folder absent"),
        (["servo_of_test:build", "-o", "a.svg", "--depth", "-1"], "--depth: expected 0 or more"),
        (["servo_of_test:build", "-o", "-", "--json", "-"], "one of them can have standard output"),
    ],
)
def test_what_it_refuses(
    arguments: list[str], message: str, folder: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["draw", *arguments]) == 2
    shown = capsys.readouterr()
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert not list(folder.glob("*.svg"))
