"""The designer in a real browser, in both of its hosts: the page of ``phyfilter-ctl app``, and JupyterLab.

The environment variable PHYFILTER_SCREENSHOTS names a folder for pictures; PHYFILTER_CHROMIUM the browser, where it is
not called chromium.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.fmi.check import check

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: the designer is not tried in a browser"
)
pytest.importorskip(
    "uvicorn", reason="uvicorn is not installed: the designer's page is not tried in a browser"
)

CHROMIUM = os.environ.get("PHYFILTER_CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped and continued by POSIX signals"),
]

SOON = 20_000.0  # ms; a loaded machine
LONG = 60_000.0  # ms; JupyterLab starts, a compiler runs
# Figures are shown with four digits.
SHOWN = 6e-4
# Poles that went through typed values and products of them.
SAME = 1e-12

ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(pf.__file__).parents[1])}


@dataclass
class Served:
    process: subprocess.Popen[str]
    address: str
    out: Path


@dataclass
class Watched:
    """A page, and what must not happen on it."""

    page: Any
    requested: set[str] = field(default_factory=set)
    complaints: list[str] = field(default_factory=list)

    def __call__(self, name: str) -> Any:
        return self.page.locator(f'[data-test="{name}"]')

    def text(self, name: str) -> str:
        return self(name).inner_text()

    def number(self, key: str) -> float:
        """A figure of the panel as it is shown, in the unit that is shown."""
        found = re.search(
            r"(−?[\d.]+(?:e−?\d+)?)\s*([^\d\s]*)\s*$", self.text(f"number-{key}").replace("\n", " ")
        )
        assert found, self.text(f"number-{key}")
        return float(found[1].replace("−", "-"))

    def centre(self, name: str) -> tuple[float, float]:
        """Where a pole or zero is on the screen; its box would count its label."""
        x, y = self(name).evaluate("e => { const m = e.getScreenCTM(); return [m.e, m.f]; }")
        return x, y

    def drag(self, name: str, dx: float, dy: float) -> None:
        x, y = self.centre(name)
        mouse = self.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + dx, y + dy, steps=6)
        mouse.up()

    def drawn(self, name: str) -> str:
        return self(name).locator("canvas").first.evaluate("canvas => canvas.toDataURL()")

    def colourful(self, name: str) -> bool:
        """Whether a plot has colours: a style sheet that came too late leaves it grey."""
        return (
            self(name)
            .locator("canvas")
            .first.evaluate(
                "canvas => { const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);"
                " for (let i = 0; i < data.length; i += 4) if (Math.abs(data[i] - data[i + 2]) > 80) return true;"
                " return false; }"
            )
        )

    def poles(self) -> list[complex]:
        """As the table of values has them, read at one time."""
        rows = self("values").evaluate(
            "table => { const rows = [];"
            " const at = (i, part) => table.querySelector(`[data-test=pole-${i}-${part}]`);"
            " for (let i = 0; at(i, 're'); i++) rows.push([Number(at(i, 're').value), Number(at(i, 'im').value)]);"
            " return rows; }"
        )
        return [complex(re, s * im) for re, im in rows for s in ((1, -1) if im else (0,))]

    def settled(self) -> None:
        """Python has answered for the design on the screen."""
        # The page's policy forbids what Playwright's own wait_for_function does.
        self.until(lambda: "pf-stale" not in (self("designer").get_attribute("class") or ""))

    def until(self, holds: Callable[[], bool], limit: float = SOON) -> None:
        before = time.monotonic()
        while not holds():
            assert time.monotonic() - before < limit / 1e3
            self.page.wait_for_timeout(30)

    def picture(self, name: str) -> None:
        folder = os.environ.get("PHYFILTER_SCREENSHOTS")
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=str(Path(folder, f"{name}.png")))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        running = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    out = tmp_path_factory.mktemp("out")
    process = subprocess.Popen(
        [sys.executable, "-m", "phyfilter_ctl", "app", "--no-browser", "--out", str(out)],
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    assert process.stdout is not None
    found = re.search(r"http://\S+", process.stdout.readline())
    assert found
    try:
        yield Served(process, found[0], out)
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@contextlib.contextmanager
def watching(browser: Any, **settings: Any) -> Iterator[Watched]:
    context = browser.new_context(**{"viewport": {"width": 1400, "height": 1000}, **settings})
    try:
        watched = Watched(context.new_page())
        watched.page.set_default_timeout(SOON)
        context.on("request", lambda request: watched.requested.add(request.url))
        watched.page.on("websocket", lambda socket: watched.requested.add(socket.url))
        watched.page.on("pageerror", lambda error: watched.complaints.append(str(error)))
        watched.page.on(
            "console",
            lambda said: watched.complaints.append(said.text) if said.type in ("error", "warning") else None,
        )
        yield watched
        places = {urlsplit(url).hostname for url in watched.requested if url.startswith(("http", "ws"))}
        assert places <= {"127.0.0.1"}, places
    finally:
        context.close()


@pytest.fixture
def page(browser: Any, served: Served) -> Iterator[Watched]:
    with watching(browser) as watched:
        watched.page.goto(served.address)
        watched.until(lambda: watched.text("status").startswith("Ready"))
        start(watched)
        yield watched
        assert watched.complaints == []


TWO_POLES = b"""format = "phyfilter"
version = 1
a = [400.0, 40.0]
poles = [[-20.0, 0.0], [-20.0, 0.0]]
"""


def start(page: Watched) -> None:
    """The server keeps the design across pages: two poles at -20 again."""
    file = {"name": "start.toml", "mimeType": "text/plain", "buffer": TWO_POLES}
    page("open-file").set_input_files(file)
    page.until(lambda: "Opened start.toml" in page.text("status"))
    page.settled()
    assert page.poles() == [-20.0, -20.0]


def type_in(page: Watched, name: str, value: str) -> None:
    page(name).fill(value)
    page(name).press("Enter")


def bandwidth(poles: list[complex]) -> float:
    return pf.frequency_response(pf.PhyFilter.from_poles(poles)).band_edges[1]


# -- the page -------------------------------------------------------------------------------------------------------


def test_dragging_a_pole_changes_plot_and_figures(page: Watched) -> None:
    before = page.drawn("bode-magnitude"), page.drawn("step"), page.number("bandwidth")
    assert page.colourful("bode-magnitude")
    page.drag("pole-0", -60.0, 0.0)
    assert page.drawn("bode-magnitude") != before[0]
    assert page.drawn("step") != before[1]
    page.settled()
    slow, fast = sorted(abs(p) for p in page.poles())
    assert slow == 20.0
    assert fast > 22.0
    assert page.number("bandwidth") > before[2]
    assert page.number("bandwidth") == pytest.approx(bandwidth(page.poles()), rel=SHOWN)


def test_a_pair_meets_the_axis_and_splits_and_real_poles_leave_it_together(page: Watched) -> None:
    page("family").select_option("butterworth")
    page.until(lambda: len(set(page.poles())) == 2 and page.poles()[0].imag != 0.0)
    assert page("pole-0-conjugate").count() == 1
    _, y = page.centre("pole-0")
    _, axis = page.centre("pole-0-conjugate")
    page.drag("pole-0", 0.0, 0.5 * (axis - y))
    page.settled()
    assert all(p.imag == 0.0 for p in page.poles())
    assert len(page.poles()) == 2
    assert page("pole-0-conjugate").count() == 0
    # One of them moves alone now ...
    page.drag("pole-0", -50.0, 0.0)
    page.settled()
    one, other = page.poles()
    assert one != other
    # ... and dragged onto the other and up, they leave as a pair.
    here, there = page.centre("pole-0"), page.centre("pole-1")
    page.drag("pole-0", there[0] - here[0], 0.0)
    page.drag("pole-0", 0.0, -70.0)
    page.settled()
    assert page.poles()[0] == page.poles()[1].conjugate()
    assert page.poles()[0].imag > 0.0


def test_typed_values_are_the_design(page: Watched) -> None:
    type_in(page, "pole-0-re", "-35")
    type_in(page, "pole-1-re", "-35")
    page.settled()
    assert page.poles() == [-35.0, -35.0]
    assert page.number("bandwidth") == pytest.approx(bandwidth([-35.0, -35.0]), rel=SHOWN)
    assert page.number("euler_dt") == pytest.approx(1e3 * 2.0 / 35.0, rel=SHOWN)
    type_in(page, "pole-0-re", "35")
    page.until(lambda: "expected a real part below 0" in page.text("designer"))
    assert page.number("bandwidth") == pytest.approx(bandwidth([-35.0, -35.0]), rel=SHOWN)


def test_keyboard_moves_and_deletes(page: Watched) -> None:
    page("pole-0").focus()
    page.page.keyboard.press("Shift+ArrowLeft")
    page.settled()
    assert sorted(p.real for p in page.poles()) == pytest.approx([-22.0, -20.0], rel=1e-6)
    page("pole-0").focus()
    page.page.keyboard.press("Delete")
    page.settled()
    assert len(page.poles()) == 1


def test_undo_and_redo(page: Watched) -> None:
    start = page.poles()
    page.drag("pole-0", -40.0, 0.0)
    page.settled()
    dragged = page.poles()
    assert dragged != start
    page("undo").click()
    page.settled()
    assert page.poles() == start
    page("redo").click()
    page.settled()
    assert page.poles() == dragged
    page("plane").click(position={"x": 5, "y": 5})
    page.page.keyboard.press("Control+z")
    page.settled()
    assert page.poles() == start
    page.page.keyboard.press("Control+Shift+z")
    page.settled()
    assert page.poles() == dragged


def recording() -> str:
    rng = np.random.default_rng(3)
    N, dt = 6000, 0.002
    t = dt * np.arange(N)
    f = np.sin(2.0 * t) + 0.3 * np.sin(17.0 * t) + np.cumsum(rng.standard_normal(N)) * 0.02
    x = np.cumsum(dt * f) + 2e-3 * rng.standard_normal(N)
    return "t,vx,ax\n" + "".join(f"{a:.4f},{b:.9g},{c:.9g}\n" for a, b, c in zip(t, x, f, strict=True))


def drop(page: Watched, name: str, text: str) -> None:
    """A file out of the file manager, let go over the page."""
    held = page.page.evaluate_handle(
        "([name, text]) => { const data = new DataTransfer();"
        " data.items.add(new File([text], name, { type: 'text/csv' })); return data; }",
        [name, text],
    )
    for event in ("dragenter", "dragover", "drop"):
        page("drop").dispatch_event(event, {"dataTransfer": held})


def test_a_log_is_dropped_learned_from_and_learning_cancelled(page: Watched) -> None:
    text = recording()
    drop(page, "flight.csv", text)
    page.until(lambda: "6000" in page.text("log").replace(",", "").replace("\u2009", ""))
    page.until(lambda: page("rmse").count() == 1 and any(c.isdigit() for c in page.text("rmse")))
    page.settled()
    assert page("log-plot").is_visible()
    before, empty = page.poles(), page.drawn("cost-plot") if page("cost-plot").is_visible() else ""
    page("learn-order").select_option("8")
    page("learn-form").select_option("general")
    page("learn").click()
    page.until(lambda: "RMSE" in page.text("learn-message"))
    pressed = time.monotonic()
    page("cancel").click()  # at once: a fast machine is done in seconds
    page.until(lambda: page.drawn("cost-plot") != empty)
    page.picture("learning")
    page.until(lambda: "cancelled" in page.text("learn-message"))
    assert time.monotonic() - pressed < 5.0
    assert page.poles() == before
    page("learn-order").select_option("2")
    page("learn-form").select_option("lowpass")
    page("learn").click()
    page.until(lambda: "learned design" in page.text("status"), LONG)
    page.settled()
    learned = page.poles()
    assert learned != before
    page.page.wait_for_timeout(300)
    page.picture("learned")
    page("undo").click()
    page.settled()
    assert page.poles() == before
    page("forget").click()
    page.until(lambda: page("drop").is_visible())


def test_a_broken_log_is_said_and_nothing_is_lost(page: Watched) -> None:
    drop(page, "broken.csv", "t,vx\n0,1\n0.1,two\n")
    page.until(lambda: "two" in page.text("status"))
    page.drag("pole-0", -30.0, 0.0)
    page.settled()


def download(page: Watched, name: str, folder: Path) -> Path:
    with page.page.expect_download(timeout=LONG) as waiting:
        page(name).click()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


@pytest.mark.parametrize("version", ["2", "3"])
def test_an_exported_fmu_passes_its_check(
    page: Watched, served: Served, tmp_path: Path, version: str
) -> None:
    button = f"export-fmu{version}"
    if not page(button).is_enabled():
        pytest.skip("no C compiler: no FMU is exported")
    page("channels").fill("2")
    path = download(page, button, tmp_path)
    assert path.suffix == ".fmu"
    report = check(path)
    assert report.ok, str(report)
    assert (served.out / f"filter_fmi{version}.fmu").read_bytes() == path.read_bytes()


def test_what_is_saved_is_what_was_designed(page: Watched, tmp_path: Path) -> None:
    type_in(page, "pole-0-re", "-12.5")
    page.settled()
    path = download(page, "save", tmp_path)
    saved = pf.load(path)
    assert isinstance(saved, pf.SampledPhyFilter)
    assert sorted(saved.filter.poles.real) == pytest.approx([-20.0, -12.5], rel=SAME)
    page("undo").click()
    page.settled()
    page("open-file").set_input_files(str(path))
    page.until(lambda: sorted(p.real for p in page.poles()) == [-20.0, -12.5])
    page("python").click()
    page.until(lambda: "from_poles" in page.text("python-text"))
    made: dict[str, Any] = {}
    exec(page.text("python-text"), made)
    assert made["filter"] == saved.filter


def test_the_page_lives_while_python_is_held_up(page: Watched, served: Served) -> None:
    before = page.drawn("bode-magnitude"), page.number("bandwidth")
    served.process.send_signal(signal.SIGSTOP)
    try:
        page.drag("pole-0", -50.0, 0.0)
        assert page.drawn("bode-magnitude") != before[0]
        page.until(lambda: page("busy").is_visible())
        page.picture("busy")
        page.drag("pole-1", -20.0, 0.0)
    finally:
        served.process.send_signal(signal.SIGCONT)
    page.settled()
    page.until(lambda: not page("busy").is_visible())
    assert page.number("bandwidth") == pytest.approx(bandwidth(page.poles()), rel=SHOWN)


def test_a_pinned_design_stays_behind(page: Watched) -> None:
    page("pin").click()
    page.drag("pole-0", -60.0, 0.0)
    page.settled()
    assert page("pin-0").count() == 1
    page.picture("pinned")
    page("pin-0-use").click()
    page.settled()
    assert page.poles() == [-20.0, -20.0]


def test_without_the_token_the_page_says_what_it_needs(browser: Any, served: Served) -> None:
    with watching(browser) as page:
        page.page.goto(served.address.split("#")[0])
        page.until(lambda: "token" in page.page.inner_text("main"))
        page.page.goto(served.address.split("=")[0] + "=" + "x" * 43)
        page.page.reload()
        page.until(lambda: page("status").count() == 1 and "token" in page.text("status"))


def test_the_token_leaves_the_address_and_outlives_a_reload(page: Watched) -> None:
    assert "token" not in page.page.url
    assert page.page.context.cookies() == []
    page.page.reload()
    page.until(lambda: page.text("status").startswith("Ready"))


# WCAG asks 4.5 for text; large and bold text may have 3.
CONTRAST = """() => {
  const channel = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const parse = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
  const light = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const ground = (e) => {
    for (; e; e = e.parentElement) {
      const c = parse(getComputedStyle(e).backgroundColor);
      if (c.length === 3 || c[3] === 1) return c;
    }
    return [255, 255, 255];
  };
  const bad = [];
  for (const e of document.querySelectorAll('[data-test=designer] *')) {
    const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim());
    const box = e.getBoundingClientRect();
    if (!own || e.closest('svg') || e.matches(':disabled') || !box.width || !box.height) continue;
    const style = getComputedStyle(e);
    if (style.visibility === 'hidden' || Number(style.opacity) < 1) continue;
    const [a, b] = [light(parse(style.color)), light(ground(e))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < 4.5) bad.push(`${e.textContent.trim().slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return bad;
}"""
# Words cut off, or wider than the window.
CLIPPED = """() => {
  const bad = [];
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) bad.push(`the page is ${wide} px wide`);
  for (const e of document.querySelectorAll('[data-test=designer] :is(button, h2, label, span, p, td, th, small)')) {
    const box = e.getBoundingClientRect();
    if (!box.width || !e.textContent.trim()) continue;
    if (box.right > innerWidth + 1 || box.left < -1) bad.push(`${e.textContent.trim().slice(0, 30)} leaves the window`);
    const hidden = getComputedStyle(e).overflowX === 'hidden' && e.scrollWidth > e.clientWidth + 1;
    if (hidden) bad.push(`${e.textContent.trim().slice(0, 30)} is cut`);
  }
  return bad;
}"""


@pytest.mark.parametrize(
    ("scheme", "width"), [("light", 1400), ("dark", 1400), ("light", 1024), ("light", 390)]
)
def test_it_can_be_read(browser: Any, served: Served, scheme: str, width: int) -> None:
    size = {"width": width, "height": 1000}
    with watching(browser, viewport=size, color_scheme=scheme) as page:
        page.page.goto(served.address)
        page.until(lambda: page.text("status").startswith("Ready"))
        start(page)
        page.page.wait_for_timeout(400)  # transitions of colours
        page.picture(f"page_{scheme}_{width}")
        assert page.page.evaluate(CONTRAST) == []
        assert page.page.evaluate(CLIPPED) == []
        assert page.complaints == []


# -- the notebook ---------------------------------------------------------------------------------------------------

CELLS = [
    "import phyfilter_ctl as pf\nlive = pf.designer(pf.PhyFilter.from_poles([-20.0, -20.0]))\nlive",
    "import json, os\nprint('kernel', os.getpid(), json.dumps(sorted(live.filter.poles.real)), 'end')",
]


@pytest.fixture(scope="module")
def jupyter(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """JupyterLab with one notebook, its settings and data in a folder of its own."""
    if importlib.util.find_spec("jupyterlab") is None:
        pytest.skip("jupyterlab is not installed: the designer is not tried in a notebook")
    nbformat = importlib.import_module("nbformat")
    folder = tmp_path_factory.mktemp("jupyter")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in CELLS])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    (folder / "root").mkdir()
    nbformat.write(notebook, folder / "root" / "design.ipynb")
    overrides = folder / "share" / "settings"
    overrides.mkdir(parents=True)
    quiet = {"@jupyterlab/apputils-extension:notification": {"fetchNews": "false", "checkForUpdates": False}}
    (overrides / "overrides.json").write_text(json.dumps(quiet))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    places = {
        name: str(folder / name)
        for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR")
    }
    process = subprocess.Popen(
        [
            *(
                sys.executable,
                "-m",
                "jupyterlab",
                "--no-browser",
                "--allow-root",
                "--ip=127.0.0.1",
                f"--port={port}",
            ),
            *("--IdentityProvider.token=browser-test", f"--ServerApp.root_dir={folder / 'root'}"),
            *(f"--LabApp.app_settings_dir={overrides}", "--LabApp.extension_manager=readonly"),
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**ENVIRONMENT, **places},
    )
    try:
        before = time.monotonic()
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
                break
            assert process.poll() is None
            assert time.monotonic() - before < LONG / 1e3
            time.sleep(0.1)
        yield f"http://127.0.0.1:{port}/lab/tree/design.ipynb?token=browser-test"
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def run_cell(lab: Watched, index: int) -> None:
    """Run a cell; JupyterLab drops what comes before its kernel is connected."""
    cell = lab.page.locator(".jp-Notebook .jp-CodeCell").nth(index)
    prompt = cell.locator(".jp-InputPrompt")
    before = prompt.inner_text()
    for _ in range(20):
        cell.locator(".cm-content").click()
        lab.page.keyboard.press("Control+Enter")
        lab.page.wait_for_timeout(700)
        if prompt.inner_text() != before:
            return
    raise AssertionError("the cell did not run")


def test_in_a_notebook_the_filter_follows_the_drag(browser: Any, jupyter: str) -> None:
    with watching(browser, viewport={"width": 1500, "height": 1400}) as lab:
        lab.page.set_default_timeout(LONG)
        lab.page.goto(jupyter)
        lab.page.wait_for_selector(".jp-Notebook .jp-CodeCell")
        lab.page.wait_for_function(
            "document.querySelector('.jp-StatusBar-Widget')?.textContent.includes('Idle')"
        )
        run_cell(lab, 0)
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.until(lambda: lab.text("status").startswith("Ready"))
        lab.settled()
        assert lab.poles() == [-20.0, -20.0]
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
        assert found
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
