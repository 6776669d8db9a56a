"""estimate: the command says what the library says, in text, JSON, table, filter and picture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main


def motion() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, velocity with noise of 5 mm/s, force: Gauss-Markov with 0.5 s."""
    rng, t = np.random.default_rng(0), 0.01 * np.arange(2500)
    f = np.asarray(lfilter([0.4], [1.0, -0.98], rng.standard_normal(2500)))
    x = np.concatenate([[0.0], np.cumsum(0.005 * (f[1:] + f[:-1]))])
    return t, x + 0.005 * rng.standard_normal(2500), f


@pytest.fixture
def flight(tmp_path: Path) -> str:
    t, v, _ = motion()
    pf.Recording(t, v, g=np.zeros_like(v), channels=["v"]).to_csv(tmp_path / "flight.csv")
    return str(tmp_path / "flight.csv")


@pytest.mark.slow
def test_everything_at_once(flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, json_, toml, png = (str(tmp_path / name) for name in ("f.csv", "f.json", "f.toml", "f.png"))
    arguments = ["--out", out, "--json", json_, "--save-filter", toml, "--picture", png, "--lag", "0.05"]
    assert main(["estimate", flight, "--x", "v", *arguments]) == 0
    text = capsys.readouterr().out
    found = pf.estimate(pf.Recording.from_csv(flight, x=["v"]))
    assert json.loads(Path(json_).read_text())["estimate"] == found.to_dict()
    # The file names the channel that the recording has.
    assert pf.load(toml) == found.filter.filter.sampled(replace(found.filter.sampling, channels=("v",)))
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table.dtype.names == ("t", "f_hat_v", "deviation_v")
    np.testing.assert_array_equal(table["f_hat_v"], found.f_hat[0][:, 0])
    assert Path(png).stat().st_size > 10_000
    assert "f_hat helps" in text
    margin = pf.margins(found.filter, pf.Loop(actuator=0.05))
    assert f"{margin.min_ratio:.3g} to {margin.max_ratio:.3g} times the true one" in text
    command = next(line for line in text.splitlines() if "--c firmware" in line)
    assert main(command.replace("firmware", str(tmp_path / "firmware")).split()[1:]) == 0


@pytest.mark.slow
def test_a_filter_is_judged_and_others_compared(
    flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = tmp_path / "slow.toml"
    pf.save(slow, pf.PhyFilter([0.5]))
    assert main(["estimate", flight, "--x", "v", "--filter", str(slow), "--compare"]) == 0
    text = capsys.readouterr().out
    assert "is expected to err" in text
    command = next(line for line in text.splitlines() if "--c firmware" in line)
    assert main(command.replace("firmware", str(tmp_path / "firmware")).split()[1:]) == 0
    assert "a momentum observer is the filter of order 1 without f_theta" in text
    assert "better than the filter: " in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--x", "w"], "w"),
        (["--x", "v", "--out", "f.xlsx"], "expected a file that ends in .csv, .json, .parquet"),
        (["--x", "v", "--order", "0"], "--order"),
        (["--x", "v", "--horizon", "1e3"], "horizon: expected less than the recordings last"),
    ],
)
def test_what_is_wrong_is_said(
    flight: str, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["estimate", flight, *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_log_is_resampled_and_labelled(
    flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    even, labelled, toml = (str(tmp_path / name) for name in ("even.csv", "labelled.csv", "filter.toml"))
    log = pf.Recording.from_csv(flight, x=["v"])
    uneven = pf.Recording(np.delete(log.times, [7, 90]), np.delete(log.x, [7, 90], axis=0), channels=["v"])
    uneven.to_csv(tmp_path / "uneven.csv")
    pf.save(toml, pf.PhyFilter([5.0]).sampled(0.01))
    analyze = ["analyze", toml, "--x", "v", "--log"]
    assert main([*analyze, str(tmp_path / "uneven.csv")]) == 2
    advice = capsys.readouterr().err.split("phyfilter-ctl ")[-1].split()
    made = {"FILE": str(tmp_path / "uneven.csv"), "S": "0.01"}
    words = [made.get(word, word) for word in advice]
    assert main([*words[:-1], even, "--x", "v"]) == 0  # the advice as it stands, and what x is
    assert main([*analyze, even]) == 0
    assert main(["log", "label", even, "--x", "v", "--out", labelled]) == 0
    found = pf.Recording.from_csv(labelled, x=["v"])
    assert found.label is not None
    assert np.sqrt(np.mean((found.label[:, 0] - motion()[2]) ** 2)) < 0.5 * np.std(motion()[2])
    assert "deviation_v" in Path(labelled).read_text().splitlines()[0]


def test_a_robot_file_says_what_the_signals_are(
    flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(
        """format = "phyfilter-robot"
version = 1
time_unit = "s"
constants = { mass = 2.0 }
signals.v = { field = "v", unit = "m/s" }
model = { x = "v", M = "mass", unit = "m/s" }
"""
    )
    assert main(["estimate", flight, "--robot", str(robot), "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)["estimate"]
    alone = pf.estimate(pf.Recording.from_csv(flight, x=["v"], inertia=2.0))
    assert figures["missed"] == pytest.approx(alone.missed.tolist(), rel=1e-6)
    assert main(["estimate", flight, "--robot", str(robot), "--x", "v"]) == 2
    assert "--robot and --x: expected one of them" in capsys.readouterr().err
