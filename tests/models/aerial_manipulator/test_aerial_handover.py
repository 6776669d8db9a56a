"""The aerial manipulator's parts as FMUs, each replayed on a mission."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from phyfilter_ctl import models

ROOM = f"{models.__name__}.aerial_manipulator"
handover = importlib.import_module(f"{ROOM}.handover")
methods = importlib.import_module(f"{ROOM}.methods")

# m, rad, N, N m and their rates: the same operations in the same order; SEER-I's sums may be taken in another.
SAME = 1e-11
SAMPLES = 500


@pytest.mark.release
def test_parts_repeat_a_mission(tmp_path: Path) -> None:
    """FMI 3.0; the recipes in ``fmus`` check the same parts in 2.0 as well."""
    version = "3.0"
    method = methods.Method("observer", 2.0, 4.0, 6.0)
    found = handover.hand_over(method, None, tmp_path / "fmus", samples=SAMPLES, versions=[version])
    assert sorted(found) == sorted(handover.PARTS)
    for part, handed in found.items():
        assert handed.samples == SAMPLES
        assert handed.exports[f"FMI {version}"].is_file()
        assert handed.worst <= SAME, (part, handed.differences)
    outputs = {part: set(handed.differences[f"FMI {version}"]) for part, handed in found.items()}
    assert {"r_e[0]", "f_wind[2]"} <= outputs["vehicle"]
    assert {"thrust[3]", "joint_ref[4]"} <= outputs["controller"]
    assert {"f_hat[0]", "tau_hat[2]"} <= outputs["filter"]


@pytest.mark.slow
def test_nothing_to_hand_over_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a method with filters"):
        handover.hand_over(methods.Method("baseline", 2.0), None, tmp_path / "fmus")
    with pytest.raises(FileNotFoundError, match="no folder"):
        handover.hand_over(methods.Method("observer", 2.0, 4.0, 6.0), None, tmp_path / "a" / "b")
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError, match="expected a folder"):
        handover.hand_over(methods.Method("observer", 2.0, 4.0, 6.0), None, tmp_path / "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
