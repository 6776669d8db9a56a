"""Shared by the tests of the models."""

from __future__ import annotations

import contextlib
import io
import runpy
from collections.abc import Callable, Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure

from phyfilter_ctl.study import outputs
from tests.figures import faults


@pytest.fixture
def flawless(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The pictures that the command draws are legible."""
    drawn: list[Figure] = []
    write = outputs.write_figure

    def keep(path: str, figure: Figure) -> None:
        drawn.append(figure)
        write(path, figure)

    monkeypatch.setattr(outputs, "write_figure", keep)
    yield
    assert drawn
    assert not [fault for figure in drawn for fault in faults(figure)]


@pytest.fixture
def example(tmp_path: Path) -> Callable[[str], tuple[dict[str, object], str]]:
    """Runs a model's file to copy as it stands, in an empty folder; returns its names and what it printed."""

    def run(model: str) -> tuple[dict[str, object], str]:
        path = Path(__file__).resolve().parents[2] / "models" / model / "example.py"
        with contextlib.chdir(tmp_path), contextlib.redirect_stdout(io.StringIO()) as said:
            try:
                names = runpy.run_path(str(path), run_name="__main__")
            finally:
                plt.close("all")
        assert (tmp_path / "example.png").stat().st_size > 10_000
        return names, said.getvalue()

    return run
