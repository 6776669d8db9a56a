"""``phyfilter-ctl run humanoid``: what it prints and writes, and what it refuses."""

from __future__ import annotations

import importlib
import json

import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

pytest.importorskip("mujoco", reason="needs the extra mujoco")
pytest.importorskip("dm_control", reason="needs the extra mujoco")

robot = importlib.import_module(f"{models.__name__}.humanoid.robot")


@pytest.mark.usefixtures("flawless")
def test_command_line(tmp_path, capsys):
    figures, drawn = tmp_path / "f.json", tmp_path / "p.png"
    arguments = [
        "run",
        "humanoid",
        "--quick",
        "--workers",
        "1",
        "--forces",
        "20",
        "--json",
        str(figures),
        "--picture",
        str(drawn),
        "--quiet",
    ]
    assert main(arguments) == 0
    printed, found = capsys.readouterr().out, json.loads(figures.read_text())
    assert "largest force held" in printed
    assert "trials of 8 s, elliptic friction cones, velocity noise 0.003" in printed
    assert (found["duration_s"], found["friction"]) == (8.0, "elliptic")
    assert drawn.stat().st_size > 10_000
    held = {
        (each["profile"], each["mode"]): each["force"]
        for each in found["largest_held_n"]
        if each["direction"] == "y"
    }
    assert held["slow", "filter"] > found["tipping_n"]["normal"]["y"] > held["slow", "alone"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--stances", "crouched"], "expected one of normal, wide, wider, got 'crouched'"),
        (["--forces", "nan"], "--forces: expected finite forces"),
        (["--gears", "0"], "gears: expected a positive factor"),
        (["--a0", "-1"], "--a0: expected a positive number"),
        (["--duration", "3"], "--duration: expected more than 3 s"),
        (["--order", "0"], "--order: expected 1 or more"),
        (["--picture", "p.gif"], "ends in .png"),
        (["--animation", "a.mp4"], "ends in .gif"),
    ],
)
def test_wrong_options_say_so(arguments, words, capsys):
    assert main(["run", "humanoid", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("missing", ["mujoco", "dm_control"])
def test_missing_extra_is_named(missing, monkeypatch, capsys):
    if missing == "mujoco":

        def absent(name):
            raise ImportError(name)

        monkeypatch.setattr("phyfilter_ctl.plants.legged.simulator.import_module", absent)
    else:
        monkeypatch.setattr(robot, "find_spec", lambda name: None)
    assert main(["run", "humanoid"]) == 2
    assert "pip install 'phyfilter-ctl[mujoco]'" in capsys.readouterr().err
