"""estimate: the command says what the library says, in text, JSON, table, filter and picture."""

from __future__ import annotations

import json
from pathlib import Path

import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main


@pytest.fixture
def flight(tmp_path: Path) -> str:
    t = 0.01 * np.arange(2500)[:, None]
    v = 2.0 * (1.0 - np.cos(t)) + 0.005 * np.random.default_rng(0).standard_normal(t.shape)
    log = pf.Recording(t[:, 0], v, g=np.zeros_like(v), channels=["v"])
    log.to_csv(tmp_path / "flight.csv")
    return str(tmp_path / "flight.csv")


def test_everything_at_once(flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, json_, toml, png = (str(tmp_path / name) for name in ("f.csv", "f.json", "f.toml", "f.png"))
    arguments = ["--out", out, "--json", json_, "--save-filter", toml, "--picture", png, "--lag", "0.05"]
    assert main(["estimate", flight, "--x", "v", *arguments]) == 0
    text = capsys.readouterr().out
    found = pf.estimate(pf.Recording.from_csv(flight, x=["v"]))
    assert json.loads(Path(json_).read_text())["estimate"] == found.to_dict()
    assert pf.load(toml) == found.filter
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert table.dtype.names == ("t", "f_hat_v", "deviation_v")
    np.testing.assert_array_equal(table["f_hat_v"], found.f_hat[0][:, 0])
    assert Path(png).stat().st_size > 10_000
    assert "f_hat helps" in text
    margin = pf.prior_margin(found.filter, actuator=ct.tf([1.0], [0.05, 1.0]))
    assert f"{margin.min_ratio:.3g} to {margin.max_ratio:.3g} times the true one" in text
    command = next(line for line in text.splitlines() if "--c firmware" in line)
    assert main(command.replace("firmware", str(tmp_path / "firmware")).split()[1:]) == 0


def test_a_filter_is_judged_and_others_compared(
    flight: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = tmp_path / "slow.toml"
    pf.save(slow, pf.PhyFilter([0.5]))
    assert main(["estimate", flight, "--x", "v", "--filter", str(slow), "--compare"]) == 0
    text = capsys.readouterr().out
    assert "is expected to err" in text
    assert "a momentum observer is the filter of order 1 without f_theta" in text
    assert "better than the filter: " in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--x", "w"], "w"),
        (["--x", "v", "--out", "f.xlsx"], "expected a file that ends in .csv, .json, .parquet"),
        (["--x", "v", "--order", "0"], "orders"),
        (["--x", "v", "--horizon", "1e3"], "horizon: expected less than the recordings last"),
    ],
)
def test_what_is_wrong_is_said(
    flight: str, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["estimate", flight, *arguments]) == 2
    assert words in capsys.readouterr().err
