"""Tuned gains as a file, the fastest loop that is allowed, and the jitter of commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl.study import (
    TunedMethod,
    command_jitter,
    fastest,
    least_error,
    read_tuned,
    tuned_text,
)


@dataclass(frozen=True)
class Gains:
    name: str
    w: float


FOUND = {
    "a": TunedMethod(Gains("a", 1.25), 0.51, 0.012, 0.02),
    "b": TunedMethod(Gains("b", 2.0), 0.5, 0.1, 0.0, interior=False),
}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    path = tmp_path / "tuned.toml"
    path.write_text(tuned_text(["by hand"], FOUND, ["w"]))
    found = read_tuned(path, ("b", "a"), Gains, ["w"], command="make gains")
    assert found == FOUND
    assert list(found) == ["b", "a"]


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "tuned.toml"
    path.write_text(tuned_text([], FOUND, ["w"]))
    with pytest.raises(ValueError, match=r"tuned.toml: no entry for c; make gains makes them"):
        read_tuned(path, ("a", "c"), Gains, ["w"], command="make gains")
    with pytest.raises(ValueError, match=r"no entry for v of a, v of b; make gains"):
        read_tuned(path, ("a", "b"), Gains, ["v"], command="make gains")


@given(limit=st.floats(0.0, 12.0), count=st.integers(1, 12))
def test_fastest_is_the_last_that_is_allowed(limit: float, count: int) -> None:
    speeds = np.arange(1.0, count + 1.0)
    below = speeds[speeds <= limit]
    found = fastest(speeds, lambda speed: speed if speed <= limit else None)
    assert found == (below[-1] if len(below) else None)


def test_jitter_leaves_slow_motion_out() -> None:
    t = np.linspace(0.0, 1.0, 20_001)[None, :, None]
    noise = np.random.default_rng(0).normal(0.0, 0.3, t.shape)
    assert command_jitter(np.sin(t), 1.0) < 1e-4
    assert command_jitter(10.0 * np.sin(t) + noise, 2.0) == pytest.approx(0.15, rel=0.02)


def test_least_error_is_that_of_the_candidates_that_have_the_margin() -> None:
    said: list[str] = []
    errors = {1.0: 0.3, 2.0: 0.2, 3.0: None}

    def tuned(gains: Gains) -> TunedMethod[Gains] | None:
        error = errors[gains.w]
        return None if error is None else TunedMethod(gains, 0.5, error, 0.0)

    candidates = [(f"a: {w}", Gains("a", w)) for w in errors]
    assert least_error("a", candidates, tuned, report=said.append).method.w == 2.0
    assert said == ["a: 1.0", "a: 2.0", "a: 3.0"]
    # At 3.0 there is no margin: that bounds the search as a larger error would.
    assert least_error("a", candidates, tuned).interior
    assert not least_error("a", candidates[:2], tuned).interior
    assert not least_error("a", candidates[1:], tuned).interior
    assert least_error("a", candidates[1:2], tuned).interior  # nothing was searched
    with pytest.raises(ValueError, match=r"a: no gains have a margin of 0\.5"):
        least_error("a", candidates[2:], tuned, wanted="a margin of 0.5")
