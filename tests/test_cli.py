"""The command: what it prints, what it writes, and how it says what is wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import numpy as np
import pytest

import phyfilter_ctl
from phyfilter_ctl import PhyFilter, filterfile, models
from phyfilter_ctl._output import write_figure, write_text
from phyfilter_ctl.cli import main

# The figures come from a root finder and a maximiser.
FOUND = 1e-6


def figures_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main(["design", *arguments, "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def run(
    *arguments: str, cwd: Path, stdout: IO[str] | int = subprocess.PIPE
) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(phyfilter_ctl.__file__).parents[1])}
    environment.pop("PYTHONUNBUFFERED", None)  # what is left to the end of the process is tested too
    return subprocess.run(
        [sys.executable, "-m", "phyfilter_ctl", *arguments],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=environment,
    )


def test_design_from_what_is_bounded(capsys):
    """Order 1: the best pole is sqrt(slope / (2 noise)), its error sqrt(2) times the floor 2 sqrt(slope noise)."""
    arguments = ("--slope", "8", "--noise", "0.01", "--order", "1")
    found = figures_of(capsys, *arguments)
    assert found["a"] == pytest.approx([20.0], rel=FOUND)
    assert found["least_bound"]["bound"] == pytest.approx(0.8, rel=FOUND)
    assert found["least_bound"]["ratio"] == pytest.approx(np.sqrt(2.0), rel=FOUND)
    assert main(["design", *arguments]) == 0
    assert "worst error 0.8, 1.414 times the floor 0.5657" in capsys.readouterr().out
    assert main(["design", "--slope", "8"]) == 2
    assert main(["design", "--poles", "-3", "--form", "general"]) == 2


# -- as a command -------------------------------------------------------------------------------------------------


def test_module_runs_as_the_command(tmp_path):
    refused = run("design", "--poles", "20", cwd=tmp_path)
    assert refused.returncode == 2
    assert refused.stderr.startswith("phyfilter-ctl: error: D is not Hurwitz")
    assert refused.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert not ended.value.code
    assert capsys.readouterr().out == f"phyfilter-ctl {phyfilter_ctl.__version__}\n"


def closed_pipe() -> IO[str]:
    """Standard output as `phyfilter-ctl ... | head` leaves it."""
    reader, writer = os.pipe()
    os.close(reader)
    return os.fdopen(writer, "w")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="a reader that leaves is another error on Windows")
def test_a_reader_that_leaves_ends_the_process_quietly(tmp_path):
    with closed_pipe() as left:
        ended = run("design", "--poles", "-20,-20", cwd=tmp_path, stdout=left)
    assert (ended.returncode, ended.stderr) == (128 + signal.SIGPIPE, "")


@pytest.mark.skipif(os.name != "posix", reason="a reader that leaves is another error on Windows")
@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["run", "acceleration", "--help"],
        ["design", "--poles", "-20", "--json", "-"],
        ["fmu", "check", "nothing.fmu", "--json", "-"],
    ],
)
def test_a_reader_that_leaves_every_command(arguments, monkeypatch, capfd):
    """What is left in the buffer is written in time: Python's own flush at the end would print a traceback."""
    with closed_pipe() as left, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", left)
        assert main(arguments) == 141
    assert capfd.readouterr().err == ""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_full_disk_behind_standard_output_is_one_line(monkeypatch, capfd):
    with Path("/dev/full").open("w") as full, monkeypatch.context() as patch:
        patch.setattr("sys.stdout", full)
        assert main(["design", "--poles", "-20,-20"]) == 2
    assert capfd.readouterr().err == "phyfilter-ctl: error: standard output: No space left on device\n"
    assert main(["design", "--poles", "-20", "--json", "/dev/full", "--quiet"]) == 2
    assert capfd.readouterr().err == "phyfilter-ctl: error: /dev/full: No space left on device\n"


@pytest.mark.parametrize(
    "command", [[], ["run"], ["design"], *(["run", name] for name in models.available())]
)
def test_help_teaches_by_examples(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*command, "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    assert "examples:" in shown
    assert "phyfilter-ctl " in shown.split("examples:")[1]


def test_every_example_of_design_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["design", "--help"])
    examples = [
        line.split("  ", 3)[1].split()
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("  phyf")
    ]
    assert len(examples) == 8
    for words in examples:
        assert main(words[1:]) == 0, words
    capsys.readouterr()
    assert (tmp_path / "band.png").read_bytes().startswith(b"\x89PNG")


# -- design -------------------------------------------------------------------------------------------------------


def test_figures_of_a_double_pole_are_the_closed_forms(capsys):
    """F = 400/(s+20)^2: |F| = 400/(w^2+400), lag 2 atan(w/20)."""
    figures = figures_of(capsys, "--poles", "-20,-20", "--at", "20,5")
    assert figures["a"] == [400.0, 40.0]
    assert figures["bandwidth"] == pytest.approx(20.0 * np.sqrt(np.sqrt(2.0) - 1.0), rel=FOUND)
    assert figures["peak"] == {"value": 1.0, "omega": 0.0}
    # |1-F|^2 = (w^4 + 1600 w^2)/(w^2+400)^2, greatest at w^2 = 800 where it is 4/3.
    assert figures["error_peak"]["value"] == pytest.approx(np.sqrt(4.0 / 3.0), rel=FOUND)
    assert figures["error_peak"]["omega"] == pytest.approx(np.sqrt(800.0), rel=1e-4)
    assert [row["omega"] for row in figures["at"]] == [5.0, 20.0]
    assert figures["at"][1]["F"] == pytest.approx(0.5, rel=FOUND)
    assert figures["at"][1]["phase_lag"] == pytest.approx(np.pi / 2.0, rel=FOUND)
    # Integral of |s F|^2 over omega/2 pi for w^2/(s+w)^2 is w^3/4.
    assert figures["noise_gain"] == pytest.approx(np.sqrt(20.0**3 / 4.0), rel=FOUND)


def test_infinite_figures_are_words(capsys):
    """White noise of unit density leaves an infinite variance behind a first-order filter."""
    figures = figures_of(capsys, "--poles", "-20")
    assert figures["noise_gain"] == "Infinity"
    assert figures["error_peak"]["omega"] == "Infinity"


def test_families_bands_and_shapes(capsys):
    low = figures_of(capsys, "--family", "butterworth", "--order", "3", "--cutoff", "20")
    assert low["bandwidth"] == pytest.approx(20.0, rel=FOUND)
    band = figures_of(capsys, "--bandpass", "4,9")
    np.testing.assert_allclose(band["band_edges"], [4.0, 9.0], rtol=FOUND)
    assert band["dc_gain"] == 0.0
    second = figures_of(capsys, "--poles", "-20+10j,-20-10j", "--type", "2")
    assert (second["type"], second["order"]) == (2, 2)
    quiet = figures_of(capsys, "--poles", "-20,-20,-20", "--zeros-at", "6", "--at", "6")
    assert quiet["at"][0]["error"] < 1e-12


def test_a_filter_goes_to_disk_and_comes_back(tmp_path, capsys):
    path = tmp_path / "filter.toml"
    assert (
        main(["design", "--poles", "-20,-20", "--dt", "0.002", "--method", "tustin", "--out", str(path)]) == 0
    )
    assert filterfile.load(path) == PhyFilter([400.0, 40.0]).sampled(0.002, "tustin")
    shown = capsys.readouterr().out
    assert main(["design", str(path)]) == 0
    assert capsys.readouterr().out == shown
    assert "every 0.002 s, tustin" in shown
    again = figures_of(capsys, str(path), "--dt", "0.01")
    assert again["sampled"] == {"dt": 0.01, "method": "exact"}


@pytest.mark.parametrize(
    "words",
    [
        "--poles -2+1j,-2-1j,-3 --zeros-at 2 --at 1,2",
        "--family bessel --order 3 --cutoff 3.2",
        "--bandpass 4,9",
    ],
)
def test_options_in_hertz(words, capsys):
    """The same words with -hz are the same filter 2 pi times faster; what is printed says both."""
    turn = 2.0 * np.pi
    slow = figures_of(capsys, *words.split())
    hertz = [
        f"{w}-hz" if w in ("--poles", "--zeros-at", "--at", "--cutoff", "--bandpass") else w
        for w in words.split()
    ]
    fast = figures_of(capsys, *hertz)
    assert np.ravel(fast["poles"]) == pytest.approx(turn * np.ravel(slow["poles"]))
    assert fast["bandwidth"] == pytest.approx(turn * slow["bandwidth"], rel=FOUND)
    for mine, theirs in zip(fast["at"], slow["at"], strict=True):
        assert mine["omega"] == pytest.approx(turn * theirs["omega"])
        assert mine["error"] == pytest.approx(theirs["error"], abs=1e-9)
    assert main(["design", *hertz]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("bandwidth"))
    assert line.endswith(" Hz)")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "expected one of FILTER.toml, --poles"),
        (["--poles", "-20", "--bandpass", "4,9"], "--poles and --bandpass"),
        (["--poles", "-20,x"], "--poles: expected numbers"),
        (["--poles", "-20+3j"], "conjugate"),
        (["--poles", "5"], "not Hurwitz: pole 5"),
        (["--poles", "-20", "--cutoff", "3"], "--cutoff does not go with --poles"),
        (["--poles", "-20", "--method", "euler"], "--method needs --dt"),
        (["--poles", "-20,-20", "--dt", "0.2", "--method", "euler"], "diverges"),
        (["--poles", "-20", "--type", "2"], "type"),
        (["--poles", "-20", "--dt", "0"], "dt"),
        (["--poles", "-20", "--at", "-1"], "frequenc"),
        (["--family", "butterworth", "--order", "2"], "needs --cutoff"),
        (["--family", "cauer", "--order", "2", "--cutoff", "3"], "--family"),
        (["--bandpass", "4"], "--bandpass: expected LOW,HIGH"),
        (["--bandpass", "9,4"], "low < high"),
        (["absent.toml"], "absent.toml: No such file"),
        (["--poles", "-20", "--out", "filter.txt"], "ends in .toml"),
        (["--poles", "-20", "--json", "absent/f.json"], "no folder"),
        (["--poles", "-20", "--picture", "f.gif"], "ends in"),
        (["--order", "two"], "--order"),
        (["--cutoff", "3", "--cutoff-hz", "3"], "--cutoff-hz: not allowed with argument --cutoff"),
        (["--poles-hz", "-3,x"], "--poles-hz: expected numbers"),
        (["--family", "bessel", "--order", "2", "--cutoff", "3,4"], "--cutoff: expected one frequency"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(["design", *arguments])
    except SystemExit as stop:  # found by argparse itself
        status = stop.code
    shown = capsys.readouterr()
    assert status == 2
    assert message in shown.err
    assert shown.err.count("\n") == 1
    assert shown.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["walk"], ["run", "nothing"], ["design", "--polse", "1"]])
def test_unknown_words_are_one_line_and_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    shown = capsys.readouterr().err
    assert shown.count("\n") == 1
    assert "--help" in shown


# -- files --------------------------------------------------------------------------------------------------------


def test_a_failed_write_leaves_the_old_file(tmp_path):
    class Broken:
        def savefig(self, file, **_):
            file.write(b"half")
            raise ValueError("broken")

    path = tmp_path / "picture.png"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match="broken"):
        write_figure(str(path), Broken())
    assert path.read_bytes() == b"old"
    write_text(str(path), "new")
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["picture.png"]


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["desgin"], "design"),
        (["run", "dron"], "drone"),
        (["design", "--family", "buterworth"], "butterworth"),
        (["design", "--picutre", "none"], "--picture"),
    ],
)
def test_what_was_meant_is_said(capsys, arguments, meant):
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    said = capsys.readouterr().err
    assert f"did you mean {meant}?" in said
    assert said.count("\n") == 1


def test_nothing_is_meant_by_noise(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["xqzw"])
    assert "did you mean" not in capsys.readouterr().err


def test_it_says_what_it_wrote(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        main(["design", "--poles", "-20,-20", "--picture", "none", "--out", "filter.toml", "--json", "-"])
        == 0
    )
    shown = capsys.readouterr()
    assert shown.err == "wrote filter.toml\n"
    json.loads(shown.out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["filter.toml"]


def test_every_model_says_what_it_is(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["run", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    for name in models.available():
        assert models.summary(name) in shown
    with pytest.raises(ValueError, match="no model named 'dron'"):
        models.summary("dron")


@pytest.mark.slow
def test_bash_completes_models_and_options(capsys, tmp_path):
    pytest.importorskip("shtab", reason="shtab is not installed: nothing completes the command")
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "completion.bash"
    script.write_text(capsys.readouterr().out)
    ask = 'source "$1"; COMP_WORDS=($2); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); _shtab_phyfilter_ctl; '
    ask += 'echo "${COMPREPLY[@]}"'
    for words, answer in (("phyfilter-ctl run dr", "drone"), ("phyfilter-ctl design --fam", "--family")):
        said = subprocess.run(["bash", "-c", ask, "bash", str(script), words], capture_output=True, text=True)
        assert said.stdout.split() == [answer]
