"""The acceleration's cells in README, results and on its page, found again on the generated flights."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from phyfilter_ctl import models
from tests.result_cells import row_of

experiment = importlib.import_module(f"{models.__name__}.acceleration.experiment")
PAGE = "models/acceleration/README.md"
ROWS = {
    "network": "network",
    "phyfilter_1": "PhyFilter behind it, n = 1",
    "phyfilter_2": "n = 2",
    "phyfilter_3": "n = 3",
    "difference": "difference",
    "tracking_differentiator": "tracking differentiator",
    "robust_differentiator": "robust differentiator",
    "kalman": "Kalman",
    "lowpass": "low-pass",
    "learned": "learned filter, shared (order 4)",
    "learned_axes": "learned filter, one for each axis",
    "fir": "FIR, shared (128 taps)",
    "fir_axes": "FIR, one for each axis (128 taps)",
    "network_after": "network behind the learned filter",
}
# Half a digit of a cell; and how far the kernels of processors move what is behind a network, and the networks, as the
# pages say.
HALF, BEHIND, NETWORK = 0.0005 + 1e-6, 0.001, 0.004
ALLOWED = {
    "network": NETWORK,
    "network_after": NETWORK,
    **dict.fromkeys(("phyfilter_1", "phyfilter_2", "phyfilter_3"), BEHIND),
}
SLOW = {"tracking_differentiator", "robust_differentiator"}


def of_page(name: str) -> tuple[float, float]:
    """Training and test, m/s^2."""
    row = row_of("## What comes out", ROWS[name], PAGE)
    return float(row["training"]), float(row["test"])


def over_seeds(name: str) -> float:
    """Test, over ten seeds, m/s^2."""
    label = re.sub(r" \((order|128).*\)", "", ROWS[name])
    return float(row_of("RMSE over all of them", label, PAGE)["RMSE, ten seeds"])


def test_cells_are_alike():
    row = row_of("**Acceleration from velocity**", "generated, ten seeds")
    cells = [float(text) for cell in row.values() for text in re.findall(r"\d\.\d+", cell)]
    assert cells == [over_seeds(name) for name in ROWS if name != "network_after"]
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    line = next(line for line in readme.splitlines() if line.startswith("| [acceleration]"))
    generated = [float(text) for text in re.findall(r"(\d\.\d+) /", line)]
    assert generated == [over_seeds(name) for name in ("network", "phyfilter_3", "fir", "learned")]


@pytest.mark.slow
def test_generated_flights_give_the_cells(monkeypatch):
    """But those of the two differentiators whose search takes longer than all the rest."""
    quick = {name: kind for name, kind in experiment.BASELINES.items() if name not in SLOW}
    monkeypatch.setattr(experiment, "BASELINES", quick)
    found = experiment.compare_generated(0)
    for name in ROWS.keys() - SLOW:
        allowed = HALF + ALLOWED.get(name, 0.0)
        training, test = of_page(name)
        assert found.train_rmse[name] == pytest.approx(training, abs=allowed), name
        assert found.test_rmse[name] == pytest.approx(test, abs=allowed), name
