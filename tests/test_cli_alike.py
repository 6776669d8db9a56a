"""What all commands have in common: --json, --quiet, and where they say what they wrote."""

from __future__ import annotations

import argparse
import json
import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.cli import _parser, main
from phyfilter_ctl.results import plain
from tests.cpu_budget import slow_but

FMUS = Path(__file__).resolve().parents[1] / "fmus"

# They give no figures: a server, and lines for a shell. Models share `study.Outputs`, which has tests of its own.
WITHOUT = {"app", "completion"}

# Every command with the least that it needs; FILTER, LOG and FMU stand for files.
COMMANDS: dict[str, list[str]] = {
    "design": ["--poles", "-20", "--picture", "none"],
    "analyze": ["FILTER"],
    "export": ["FILTER", "--c", "firmware"],
    "estimate": ["LOG", "--x", "v"],
    "learn": ["LOG", "--x", "v", "--order", "1"],
    "log": ["LOG", "--time-unit", "s"],
    "log resample": ["LOG", "--x", "v", "--dt", "0.02", "--out", "even.csv"],
    "log label": ["LOG", "--x", "v", "--out", "labelled.csv"],
    "fmu describe": ["FMU"],
    "fmu check": ["FMU", "--no-run"],
    "fmu run": ["FMU", "--stop", "0.1"],
    "fmu recipes": ["recipes"],
    "draw": ["acceleration", "--out", "loop.svg"],
}
CHEAP = {"design", "analyze", "log", "log resample"}


def leaves(parser: argparse.ArgumentParser, name: str = "") -> Iterator[tuple[str, set[str]]]:
    """Every command, every job and every model with its options."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in below:
        for word, job in action.choices.items():
            yield from leaves(job, f"{name} {word}".strip())
    if not below:
        yield name, set(parser._option_string_actions)


@pytest.mark.slow
def test_every_command_has_json_and_quiet() -> None:
    every = dict(leaves(_parser(None)))
    for words in ("log resample", "log label"):
        every |= {
            words: set(_parser([words])._subparsers._group_actions[0].choices[words]._option_string_actions)
        }  # pyright: ignore
    assert {name.split()[0] for name in every} == {name.split()[0] for name in COMMANDS} | WITHOUT | {"run"}
    for name, options in every.items():
        assert "--quiet" in options, name
        assert ("--json" in options) == (name not in WITHOUT), name


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(FMUS / "phyfilter_sampled", "recipes/phyfilter_sampled")
    t = 0.01 * np.arange(400)
    rows = (
        f"{a:.3f},{b!r},{c!r}\n"
        for a, b, c in zip(t, (1.0 - np.cos(3.0 * t)).tolist(), (3.0 * np.sin(3.0 * t)).tolist(), strict=True)
    )
    Path("log.csv").write_text("t,v,label_v\n" + "".join(rows))
    return {"LOG": "log.csv", "FILTER": "filter.toml", "FMU": "filter.fmu"}


def refuse(word: str) -> float:
    raise AssertionError(f"{word} is no JSON")


@pytest.mark.parametrize(
    "name",
    [
        *slow_but(CHEAP, sorted(COMMANDS.keys() - {"fmu recipes"})),
        pytest.param("fmu recipes", marks=pytest.mark.release),  # builds FMUs
    ],
)
def test_json_and_quiet_are_alike(
    name: str, files: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """`--json -` is JSON and nothing else; `--json FILE` is the same beside the text; `--quiet` says no more."""
    used = {word for word in COMMANDS[name] if word in files}
    if used & {"FILTER", "FMU"}:
        assert main(["design", "--poles", "-20", "--dt", "0.01", "--out", "filter.toml", "--quiet"]) == 0
    if "FMU" in used:
        assert main(["export", "filter.toml", "--fmu", "filter.fmu", "--quiet"]) == 0
    capsys.readouterr()
    arguments = [*name.split(), *(files.get(word, word) for word in COMMANDS[name])]
    assert main([*arguments, "--json", "-", "--quiet"]) == 0
    shown = capsys.readouterr()
    figures = json.loads(shown.out, parse_constant=refuse)
    assert shown.err == ""
    assert main([*arguments, "--json", "figures.json", "--quiet"]) == 0
    beside = capsys.readouterr()
    assert beside.out.strip()
    assert beside.err == ""
    assert "\x1b" not in beside.out
    again = json.loads(Path("figures.json").read_text(), parse_constant=refuse)
    assert shape(again) == shape(figures)
    if name in CHEAP and name != "export":
        assert main([*arguments, "--json", "figures.json"]) == 0
        assert "figures.json" in capsys.readouterr().err
    assert main([*arguments, "--json", "absent/figures.json"]) == 2
    assert "there is no folder absent" in capsys.readouterr().err


def shape(value: object) -> object:
    """What remains alike where times differ from run to run."""
    if isinstance(value, dict):
        return {key: shape(entry) for key, entry in value.items()}
    return [shape(entry) for entry in value] if isinstance(value, list) else type(value).__name__


def test_infinite_and_absent_differ() -> None:
    found = plain({"margin": np.inf, "low": -np.inf, "model": None, "undefined": np.nan}, infinite=True)
    assert found == {"margin": "Infinity", "low": "-Infinity", "model": None, "undefined": None}
    assert math.isinf(float(found["margin"]))
    assert json.loads(json.dumps(found, allow_nan=False)) == found
