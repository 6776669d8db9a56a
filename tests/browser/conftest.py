"""A browser for the designer, and its page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from designer_hosts import CHROMIUM, Served, Watched, serving, watching


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: the designer is not tried in a browser"
    )
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    pytest.importorskip(
        "uvicorn", reason="uvicorn is not installed: the designer's page is not tried in a browser"
    )
    with serving(tmp_path_factory.mktemp("out")) as running:
        yield running


@pytest.fixture
def page(browser: Any, served: Served) -> Iterator[Watched]:
    served.reset()
    with watching(browser) as watched:
        watched.page.goto(served.address)
        watched.ready()
        yield watched
        assert watched.complaints == []
