"""Shared by the tests of the models."""

from __future__ import annotations

from collections.abc import Iterator

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
