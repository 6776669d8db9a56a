"""The humanoid's file to copy holds a force that the study says is held with the filter alone."""

import re
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: the humanoid's example does not stand")

PAGE = (Path(__file__).resolve().parents[3] / "models" / "humanoid" / "README.md").read_text(encoding="utf-8")


def test_it_stands_and_falls_as_the_studys_table_says(example):
    names, said = example("humanoid")
    [row] = re.findall(r"^\| wide \| .*$", PAGE, re.M)
    alone, filtered = (
        float(re.findall(r"[\d.]+", cell)[0]) for cell in row.split("|")[5:7]
    )  # slow, to the left
    assert alone < names["force"] <= filtered
    without, held = said.splitlines()[:2]
    assert re.fullmatch(r"without: falls after \d\.\d s", without)
    assert held == "with PhyFilter: stands for 60 s"
    # The page: an estimate of 20 N is off by 1.0 to 1.7 N, one of 90 N by 2.2 and 2.3 N where it is held.
    found, true = (float(each) for each in re.findall(r"([\d.]+) N", said.splitlines()[2]))
    assert abs(found - true) <= 2.3
