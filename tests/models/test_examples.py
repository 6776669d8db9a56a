"""The files to copy run as they stand, and what they print lies within the intervals of the studies."""

from __future__ import annotations

import ast
import contextlib
import importlib
import io
import re
import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl.study import median_interval

ROOT = Path(__file__).resolve().parents[2] / "models"
# Lines of the example's table: what the file prints, and median and interval of the study, on the model's page.
ROW = re.compile(r"^\| ([^|]+) \| ([\d.]+) \| ([\d.]+) \[([\d.]+), ([\d.]+)\] \|$", re.M)
MODELS = ("drone", "aerial_manipulator")
LINES = 150


@pytest.fixture(autouse=True)
def _figures_are_closed():
    yield
    plt.close("all")


def rows_of(model: str) -> list[tuple[str, ...]]:
    return ROW.findall((ROOT / model / "README.md").read_text(encoding="utf-8"))


@pytest.mark.parametrize("model", ["drone", pytest.param("aerial_manipulator", marks=pytest.mark.slow)])
def test_what_a_file_prints_lies_within_the_study(model: str, tmp_path: Path) -> None:
    rows = rows_of(model)
    with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()) as said:
        runpy.run_path(str(ROOT / model / "example.py"), run_name="__main__")
    printed = dict(re.findall(r"^(.+?): +([\d.]+) \[", said.getvalue(), re.M))
    assert list(printed) == [name for name, *_ in rows]
    for name, shown, _, low, high in rows:
        assert float(low) <= float(printed[name]) <= float(high), name
        # The page, to the last digits of other machines.
        assert float(shown) == pytest.approx(float(printed[name]), rel=0.03)
    assert (tmp_path / "example.png").stat().st_size > 10_000


@pytest.mark.parametrize("model", MODELS)
def test_a_file_is_short_and_stands_alone(model: str) -> None:
    source = (ROOT / model / "example.py").read_text(encoding="utf-8")
    assert source.count("\n") <= LINES
    taken = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name) or "."
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert {name.split(".")[0] for name in taken} <= {"phyfilter_ctl", "numpy", "matplotlib", "control"}
    assert not any(name.startswith("phyfilter_ctl.models") for name in taken)


def flown(model: str) -> list[NDArray[np.float64]]:
    """The study's figure of each row of the page, in m, one a flight."""
    study, tuning = (
        importlib.import_module(f"phyfilter_ctl.models.{model}.{n}") for n in ("experiment", "tuning")
    )
    tuned, seeds = tuning.tuned(), range(20)
    if model == "drone":
        drawn = importlib.import_module("phyfilter_ctl.models.drone.flights").conditions(seeds, "wind")
        return [study.fly(tuned[name].method, drawn).score().total for name in ("baseline", "observer")]
    scores = [study.fly(tuned[name].method, seeds).score() for name in ("integral", "observer")]
    return [window for score in scores for window in (score.grasp, score.settle)]


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_the_intervals_of_the_page_are_the_studys(model: str) -> None:
    for (name, _, *shown), values in zip(rows_of(model), flown(model), strict=True):
        found = median_interval(values)
        assert [float(v) for v in shown] == pytest.approx(
            [100.0 * v for v in (found.value, found.low, found.high)], rel=0.01
        ), name
