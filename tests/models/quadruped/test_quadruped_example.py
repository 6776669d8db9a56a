"""The quadruped's file to copy walks as the study's policies do."""

import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="mujoco is not installed: the quadruped's example does not walk")

PAGE = (Path(__file__).resolve().parents[3] / "models" / "quadruped" / "README.md").read_text(
    encoding="utf-8"
)


def test_its_figures_are_those_of_the_studys_table(example):
    names, said = example("quadruped")
    # 0 %, 30 % and 60 % payload; of the policies trained with the filter.
    for row, label in enumerate(("the same, filter off", "trained with the filter")):
        table = PAGE[PAGE.index("| | 0 % | 30 % | 60 % payload | 1.5 m/s | 2 m/s | 2.83 m/s |") :]
        [line] = re.findall(rf"^\| {re.escape(label)} \|.*$", table.split("\n\n")[0], re.M)
        mean, low, high = (float(each) for each in re.findall(r"\.\d+", line.split("|")[4]))
        errors = names["errors"][row]
        assert [errors.mean(), errors.min(), errors.max()] == pytest.approx([mean, low, high], abs=0.005)
        assert f"{errors.mean():.2f} m/s of 1 m/s missing" in said
    assert np.all(names["errors"][1] < names["errors"][0])
