"""The designer in JupyterLab, in a real browser."""

from __future__ import annotations

import importlib.util
import json
import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from designer_hosts import (
    CHROMIUM,
    LONG,
    SHOWN,
    bandwidth,
    jupyter_lab,
    open_notebook,
    recording,
    run_cell,
    watching,
)

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a notebook"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the kernel is stopped and continued by POSIX signals"),
    pytest.mark.skipif(
        importlib.util.find_spec("jupyterlab") is None,
        reason="jupyterlab is not installed: the designer is not tried in a notebook",
    ),
]

CELLS = [
    "import phyfilter_ctl as pf\nlive = pf.designer(pf.PhyFilter.from_poles([-25.0, -25.0]))\nlive",
    "import json, os\nprint('kernel', os.getpid(), json.dumps(sorted(live.filter.poles.real)), 'end')",
    "import json\nprint('kept', json.dumps(live.session), 'end')",
]


@pytest.fixture(scope="module")
def jupyter(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with jupyter_lab(tmp_path_factory.mktemp("jupyter"), CELLS) as address:
        yield address


def test_in_a_notebook_the_filter_follows_the_drag(browser: Any, jupyter: str) -> None:
    with watching(browser, viewport={"width": 1500, "height": 1400}) as lab:
        open_notebook(lab, jupyter)
        run_cell(lab, 0)
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.until(lambda: lab.text("status").startswith("Ready"))
        lab.settled()
        assert lab.poles() == [-25.0, -25.0]  # the filter it was given, not the page's own start
        assert lab.colourful("bode-magnitude")
        before = lab.drawn("bode-magnitude")
        lab("pole-0").scroll_into_view_if_needed()
        lab.drag("pole-0", -60.0, 0.0)
        assert lab.drawn("bode-magnitude") != before
        lab.settled()
        assert lab.number("bandwidth") == pytest.approx(bandwidth(lab.poles()), rel=SHOWN)
        lab("pole-0").scroll_into_view_if_needed()
        lab.picture("notebook")

        # The object in the kernel is the design on the screen.
        run_cell(lab, 1)
        output = lab.page.locator(".jp-Notebook .jp-CodeCell").nth(1).locator(".jp-OutputArea-output")
        output.wait_for()
        found = re.search(r"kernel (\d+) (\[.*?\]) end", output.inner_text())
        assert found, output.inner_text()
        shown = sorted(p.real for p in lab.poles())
        assert json.loads(found[2]) == pytest.approx(shown, rel=SHOWN)

        # A kernel that does not answer: the preview goes on, the answer follows.
        lab("pole-0").scroll_into_view_if_needed()
        before = lab.drawn("bode-magnitude")
        os.kill(int(found[1]), signal.SIGSTOP)
        try:
            lab.drag("pole-0", -40.0, 0.0)
            assert lab.drawn("bode-magnitude") != before
            lab.until(lambda: lab("busy").is_visible())
            lab.picture("notebook_busy")
        finally:
            os.kill(int(found[1]), signal.SIGCONT)
        lab.settled()
        assert lab.number("bandwidth") == pytest.approx(bandwidth(lab.poles()), rel=SHOWN)
        ours = [text for text in lab.complaints if "designer" in text.lower() or "phyfilter" in text.lower()]
        assert ours == []


@pytest.mark.slow
def test_a_notebook_keeps_the_session_over_a_reload_of_the_page(browser: Any, jupyter: str) -> None:
    with watching(browser, viewport={"width": 1500, "height": 1400}) as lab:
        open_notebook(lab, jupyter)
        run_cell(lab, 0)
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.until(lambda: lab.text("status").startswith("Ready"))
        assert "with the notebook" in lab.text("kept")
        lab("pin").click()
        lab.fill("unit", "N")
        lab("pole-0").scroll_into_view_if_needed()
        lab.drag("pole-0", -60.0, 0.0)
        lab.settled()
        dragged = lab.poles()
        lab.page.wait_for_timeout(1500)  # it is kept some tenths of a second after the last change

        # The trait has it.
        run_cell(lab, 2)
        output = lab.page.locator(".jp-Notebook .jp-CodeCell").nth(2).locator(".jp-OutputArea-output")
        output.wait_for()
        found = re.search(r"kept (\{.*\}) end", output.inner_text().replace("\n", ""))
        assert found, output.inner_text()
        kept = json.loads(found[1])
        assert kept["design"]["assume"]["unit"] == "N"
        assert [pin["design"]["poles"] for pin in kept["pins"]] == [[[-25, 0], [-25, 0]]]
        assert len(kept["history"]["past"]) == 2

        # The page is loaded anew from the notebook that was saved; the kernel goes on.
        lab.page.locator(".jp-Notebook .jp-CodeCell .cm-content").nth(2).click()
        lab.page.keyboard.press("Control+s")
        lab.page.wait_for_timeout(1500)
        lab.page.reload()
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.until(lambda: lab.text("status").startswith("Ready"), 60_000.0)
        lab.settled()
        assert lab.poles() == dragged
        assert lab("unit").input_value() == "N"
        assert lab("pin-0").count() == 1
        lab("undo").click()
        lab.until(lambda: lab.poles() == [-25.0, -25.0])


@pytest.mark.slow
def test_a_notebook_imports_shows_the_loop_and_reports(browser: Any, jupyter: str) -> None:
    with watching(browser, viewport={"width": 1500, "height": 1400}) as lab:
        open_notebook(lab, jupyter)
        run_cell(lab, 0)
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.until(lambda: lab.text("status").startswith("Ready"))
        # A file out of the file manager, looked at before it is opened; JupyterLab does not take it for its own.
        lab.drop("flight.csv", recording(), confirm=False)
        lab.until(lambda: lab("import").count() == 1, LONG)
        assert lab.text("import-pairs") == "x vx with label ax."
        lab("import-open").click()
        lab.until(lambda: any(c.isdigit() for c in lab.text("rmse")), LONG)
        assert "flight: 6000 samples, 2 ms" in lab.text("log")
        # The loop, by Python's own answer.
        lab("frequency-nyquist").click()
        lab.until(lambda: "sampled loop" in lab.text("loop-note"), LONG)
        assert lab.colourful("loop-plane")
        lab.settled()
        lab.picture("notebook_nyquist")
        lab("export").click()
        with lab.page.expect_download(timeout=LONG) as waiting:
            lab("export-html").click()
        page = Path(waiting.value.path()).read_text(encoding="utf-8")
        assert lab.text("verdict").split(".")[0] in page
        assert "<svg" in page
        ours = [text for text in lab.complaints if "designer" in text.lower() or "phyfilter" in text.lower()]
        assert ours == []
