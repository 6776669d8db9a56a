"""What all commands have in common: --json, --quiet, and where they say what they wrote."""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
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


# Asks in one process for the help of every command, makes typing errors in each, and says what any of them imported.
_ASKED = """
import contextlib, io, json, sys
from phyfilter_ctl.cli import describe_commands, main
HEAVY = ("numpy", "scipy", "control", "casadi", "matplotlib")
names = [name.split()[1:] for name in describe_commands()]
asked = [[*name, "--help"] for name in names]
asked += [[*name, "--no-such-option"] for name in names]
asked += [[], ["no_such_command"], ["design"], ["design", "--family", "bessel"], ["export", "filter.toml"], ["learn"]]
asked += [["analyze", "x.toml", "--picture", "x.txt"], ["fmu", "run"], ["log", "label"], ["run", "no_such_model"]]
seen = {}
for arguments in asked:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            status = main(arguments)
        except SystemExit as ended:
            status = ended.code
    seen[" ".join(arguments)] = [status, [name for name in HEAVY if name in sys.modules]]
print(json.dumps(seen))
"""


def test_help_and_typing_errors_import_no_library() -> None:
    """What takes seconds is imported where work begins."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    told = subprocess.run([sys.executable, "-c", _ASKED], env=environment, stdout=subprocess.PIPE, check=True)
    seen = json.loads(told.stdout)
    assert len(seen) > 40
    for arguments, (status, imported) in seen.items():
        assert imported == [], arguments
        assert status == (0 if arguments.endswith("--help") or not arguments else 2), arguments


@pytest.mark.parametrize("words", ["", "fmu", "run", "log"])
def test_a_bare_command_prints_its_help(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for arguments in (words.split(), [*words.split(), "--help"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert not ended.value.code
        shown.append(capsys.readouterr())
    assert shown[0] == shown[1]
    assert shown[0].out.startswith(f"usage: phyfilter-ctl {words}".strip())


# What the library says of its arguments, and what the command line makes of it.
SAID = {
    "design --poles -20 --dt -1": "--dt: expected a finite number > 0 s",
    "design --poles -20 --at -1": "--at: expected finite frequencies",
    "design --poles -20 --type 3": "--type: a filter of order 1",
    "design --poles -20000 --dt 0.01 --method euler": "; use --method exact",
    "design --family bessel --order 99 --cutoff 3": "--order: the poles",
    "design --slope -1 --noise 1": "--slope: expected a positive bound",
    "analyze FILTER --slope 3 --inertia-error 0.1": "--inertia-error: what it does grows",
    "analyze FILTER --inertia-ratio 2 1": "--inertia-ratio: expected 0 < low <= high",
    "analyze FILTER --lag -1": "--lag: expected a finite number >= 0",
    "analyze FILTER --slope -3": "--slope: expected a bound >= 0, got -3",
    "analyze FILTER --log LOG --x v --time clock": "no column 'clock'",
    "analyze FILTER --log LOG --x w": "name the columns by the options --time, --x, ... or",
    "learn LOG --x v --order 1 --form lowpass --type 2": "--type is a choice of the general form",
    "learn LOG --x v --order 1 --form lowpass --dc-gain 2": "--dc-gain is a choice of the general form",
    "analyze SAMPLED --slope 3 --implementation x.1=1": "|x'| is --rate",
    "estimate LOG": "name the columns by the options --time, --x, ... or",
    "estimate LOG --x v --order 0": "--order: expected at least 1",
    "estimate LOG --x v --noise -1": "--noise: expected finite numbers > 0",
    "estimate TICKS --x v": "give them their unit, --time-unit ms, us, ns or s",
    "learn LOG --x v --order 1 --form general --type 0": "with --dc-gain 1, got --type 0 with --dc-gain 1.0",
    "learn LOG --x v --order 1 --margin 0.5 --loop-delay -1": "--loop-delay: expected a finite number",
    "learn LOG --x v --order 1 --delay -1": "--delay: expected a finite number",
    "learn LOG --x v --order 1 --margin 2": "--margin: expected a number in [0, 1)",
    "log TICKS": "give --time-unit, one of s, ms, us, ns",
    "log resample LOG --x v --dt -1 --out even.csv": "--dt: expected a finite number",
    "log label LOG --x v --noise -1 --out labelled.csv": "--noise: expected a finite number",
    "export SAMPLED --fmu a.fmu --clocks": "own (of a filter: --rate fixed)",
    "export SAMPLED --c firmware --real q31": "such as --ranges x=10.0 g=20.0 f_theta=20.0",
    "export SAMPLED --fmu a.fmu --platform vax": "--platform: expected 'all', 'native' or",
    "fmu check absent.fmu --call-limit 0": "--call-limit",
    # Of what nothing asked for would use.
    "analyze FILTER --slope 3 --x v": "--x: nothing here would use it: it needs --log",
    "analyze FILTER --slope 3 --time t": "--time: nothing here would use it: it needs --log",
    "analyze FILTER --slope 3 --f-theta v": "--f-theta: nothing here would use it: it needs --log",
    "analyze FILTER --implementation x=1": "--implementation: nothing here would use it: it needs a bound",
    "analyze FILTER --slope 3 --residual 1=4": "--slope is --residual 1=D: expected one of them, got 3 and 4",
    "analyze FILTER --slope 3 --hz": "--hz: nothing here would use it: it needs --picture",
    "design --poles -20 --db": "--db: nothing here would use it: it needs --picture",
    "estimate LOG --x v --hz": "--hz: nothing here would use it: it needs --picture",
    "learn LOG --x v --order 1 --picture none --hz": "--hz: nothing here would use it: it needs --picture",
    "learn LOG --x v --order 1 --compare-axes --per-channel": "leave --per-channel out",
    "export SAMPLED --c firmware --clocks": "--clocks: nothing here would use it: it needs --fmu",
    "export SAMPLED --c firmware --platform all": "--platform: nothing here would use it: it needs --fmu or --ssp",
    "export SAMPLED --c firmware --rate fixed": "--rate: nothing here would use it: it needs --fmu",
    "export SAMPLED --fmu a.fmu --real float": "--real: nothing here would use it: it needs --c or --target",
    "export SAMPLED --fmu a.fmu --split a=b": "--split: nothing here would use it: it needs --ssp",
    "export drone --ssp a.ssp --record plant.*": "--record: nothing here would use it: it needs --fmu",
}


def test_errors_name_options(files: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    """And not the arguments of Python that the options give."""
    assert main(["design", "--poles", "-20", "--out", "filter.toml", "--quiet"]) == 0
    assert main(["design", "--poles", "-20", "--dt", "0.01", "--out", "sampled.toml", "--quiet"]) == 0
    Path("ticks.csv").write_text("t,v\n" + "".join(f"{10_000 * k},{k}.5\n" for k in range(20)))
    files |= {"SAMPLED": "sampled.toml", "TICKS": "ticks.csv"}
    before = sorted(Path().iterdir())
    capsys.readouterr()
    for command, expected in SAID.items():
        assert main([files.get(word, word) for word in command.split()]) == 2, command
        said = capsys.readouterr().err
        assert expected in said, command
        assert said.count("\n") == 1, command
    assert sorted(Path().iterdir()) == before


def test_the_designer_names_options_too(files: dict[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("anyio")
    assert main(["app", "--log", files["LOG"], "--x", "w", "--no-browser"]) == 2
    assert "--x: there is no column 'w'" in capsys.readouterr().err


def test_infinite_and_absent_differ() -> None:
    found = plain({"margin": np.inf, "low": -np.inf, "model": None, "undefined": np.nan}, infinite=True)
    assert found == {"margin": "Infinity", "low": "-Infinity", "model": None, "undefined": None}
    assert math.isinf(float(found["margin"]))
    assert json.loads(json.dumps(found, allow_nan=False)) == found
