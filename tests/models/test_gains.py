"""Tuned gains as a file, and the jitter of commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.models.gains import command_jitter, gains_text, read_gains


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "tuned.toml"
    path.write_text(
        gains_text(["by hand"], {"a": {"w": 1.25, "mae": "0.0120"}, "b": {"w": 2.0, "mae": "0.1"}})
    )
    found = read_gains(path, ("b", "a"), command="make gains")
    assert found == {"b": {"w": 2.0, "mae": 0.1}, "a": {"w": 1.25, "mae": 0.012}}
    assert list(found) == ["b", "a"]


def test_a_missing_method_is_named(tmp_path: Path) -> None:
    path = tmp_path / "tuned.toml"
    path.write_text(gains_text([], {"a": {"w": 1.0}}))
    with pytest.raises(ValueError, match=r"tuned.toml: no entry for c; make gains makes them"):
        read_gains(path, ("a", "c"), command="make gains")


def test_jitter_leaves_slow_motion_out() -> None:
    t = np.linspace(0.0, 1.0, 20_001)[None, :, None]
    noise = np.random.default_rng(0).normal(0.0, 0.3, t.shape)
    assert command_jitter(np.sin(t), 1.0) < 1e-4
    assert command_jitter(10.0 * np.sin(t) + noise, 2.0) == pytest.approx(0.15, rel=0.02)
