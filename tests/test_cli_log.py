"""``phyfilter-ctl log``: what it says of a log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.cli import main
from tests.logfiles.ulog_writer import write_ulog


def flight(path: Path) -> Path:
    times = 1_000_000 + 20_000 * np.arange(100)
    times[50:] += 500_000
    topics = {
        "vehicle_local_position": {
            "timestamp": ("uint64_t", times),
            **{name: ("float", np.zeros(100)) for name in ("vx", "vy", "vz", "ax", "ay", "az")},
        },
        "vehicle_attitude": {"timestamp": ("uint64_t", times), "q": ("float", np.zeros((100, 4)))},
        "actuator_motors": {"timestamp": ("uint64_t", times), "control": ("float", np.zeros((100, 4)))},
    }
    return write_ulog(path, topics, start=1_000_000, dropouts=[(2_500_000, 480)])


def test_text_names_topics_rates_gaps_and_what_they_may_serve_as(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyulog")
    assert main(["log", str(flight(tmp_path / "a.ulg"))]) == 0
    text = capsys.readouterr().out
    assert "ulog, topics: 3, 2.48 s" in text
    assert "! dropouts: 1, 0.48 s in all" in text
    row = next(line for line in text.splitlines() if line.startswith("vehicle_local_position"))
    assert row.split()[1:5] == ["100", "50", "0", "2.48"]
    assert "vx (m/s), vy (m/s), vz (m/s), ax (m/s^2)" in row
    assert text.count("! 1 gap, the longest 0.52 s") == 3
    served = text.split("may serve as")[1]
    assert "x      vehicle_local_position: vx, vy, vz: velocity, PX4's estimate, NED" in served
    assert "g      actuator_motors: control: commands of the motors" in served
    assert "label  vehicle_local_position: ax, ay, az" in served


def test_json_holds_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.csv"
    path.write_text("stamp,vx [m/s],vy,vz\n0,1,2,3\n4000,1,2,3\n")
    assert main(["log", str(path)]) == 2
    assert "give --time-unit, one of s, ms, us, ns" in capsys.readouterr().err
    assert main(["log", str(path), "--time-unit", "us", "--json", "-"]) == 0
    figures = json.loads(capsys.readouterr().out)
    (topic,) = figures["topics"]
    assert (topic["name"], topic["count"], topic["clock"]["dt"]) == ("table", 2, 0.004)
    assert topic["fields"][0] == {"name": "vx [m/s]", "unit": "m/s", "dtype": "float64", "shape": []}
    assert main(["log", str(path), "--time-unit", "s"]) == 0
    assert "dt 4e+03 s is above 1 s: a slow topic, or a wrong unit of time?" in capsys.readouterr().out


def test_a_first_robot_file_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.csv"
    path.write_text("t,v,u\n0,0.0,1.0\n1,0.1,1.0\n2,0.2,1.0\n")
    assert main(["log", str(path), "--time-unit", "s", "--describe"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("# Robot of short.csv")
    assert 'format = "phyfilter-robot"' in shown
    assert "#     v, u" in shown
