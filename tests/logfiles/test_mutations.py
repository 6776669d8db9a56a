"""Damaged logs are read or refused, whatever their library makes of them; more in ``mutations.py`` and tests.fuzz."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.logfiles import mutations


@cache
def sound(kind: str) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return mutations.sound(kind, Path(folder))


@pytest.mark.parametrize("kind", mutations.PACKAGES)
@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1))
def test_damaged_logs_are_read_or_refused(kind: str, seed: int) -> None:
    pytest.importorskip(mutations.PACKAGES[kind])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"log.{kind}"
        path.write_bytes(mutations.mutated(sound(kind), np.random.default_rng(seed)))
        mutations.outcome(path)


@pytest.mark.parametrize("kind", mutations.PACKAGES)
def test_the_sound_log_is_read(kind: str, tmp_path: Path) -> None:
    pytest.importorskip(mutations.PACKAGES[kind])
    path = tmp_path / f"log.{kind}"
    path.write_bytes(sound(kind))
    assert mutations.outcome(path) == "read"
