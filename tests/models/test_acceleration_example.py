"""The acceleration's file to copy gives what the study finds over seeds."""

import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).resolve().parents[2] / "models" / "acceleration" / "README.md").read_text(
    encoding="utf-8"
)


def interval(before, after=""):
    """The interval in per cent that the study's page has between two texts."""
    [found] = re.findall(
        re.escape(before) + r" [+-][\d.]+ % \[([+-][\d.]+), ([+-][\d.]+)\]" + re.escape(after), PAGE
    )
    return tuple(float(each) for each in found)


@pytest.mark.slow
def test_its_figures_lie_within_the_studys_intervals(example):
    names, said = example("acceleration")
    rmse = names["rmse"]
    for name, value in rmse.items():
        assert f"{name:22} {value:.3f} m/s^2" in said

    def over(name, other):
        return 100.0 * (rmse[name] / rmse[other] - 1.0)

    low, high = interval("(n = 3:")
    assert low <= over("PhyFilter behind it", "network") <= high
    low, high = interval("over the robust one,", " over Kalman")
    assert low <= over("PhyFilter behind it", "Kalman") <= high
    # Over the robust differentiator, which in the study is as good as Kalman to the last digit shown.
    low, high = interval("| learned filter, shared | 0.103 |", " |")
    assert low <= over("learned filter alone", "Kalman") <= high
