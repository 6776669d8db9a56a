"""The designer's two hosts, started for a browser: the page of ``phyfilter-ctl app``, and JupyterLab.

A page is watched: it asks nothing of other machines and complains of nothing.
The environment variable PHYFILTER_SCREENSHOTS names a folder for pictures; PHYFILTER_CHROMIUM the browser, where it is
not called chromium.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

import phyfilter_ctl as pf

CHROMIUM = os.environ.get("PHYFILTER_CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
SOON = 20_000.0  # ms; a loaded machine
LONG = 60_000.0  # ms; JupyterLab starts, a compiler runs
RESTS = 500.0  # ms without a question: the page has asked all it wanted to
# Figures are shown with four digits.
SHOWN = 6e-4

START = {
    "poles": [[-20.0, 0.0], [-20.0, 0.0]],
    "numerator": {"kind": "lowpass"},
    "sampling": {"dt": 0.002, "method": "exact"},
    "assume": {"slope": 1.0, "noise": 0.001, "ratio": 1.0, "lag": 0.02, "delay": 0.0, "unit": ""},
    "limits": None,
}
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(pf.__file__).parents[1])}


@dataclass
class Served:
    """A running ``phyfilter-ctl app``."""

    process: subprocess.Popen[str]
    address: str
    out: Path

    def reset(self) -> None:
        """The server keeps design and log across pages: back to two poles at -20, every 2 ms, and no log."""
        place, token = self.address.split("#token=")
        origin = place.rstrip("/")
        for fields in ({"op": "design", "design": START}, {"op": "forget"}):
            headers = {"content-type": "application/json", "x-phyfilter-token": token, "origin": origin}
            body = json.dumps({"id": 0, **fields}).encode()
            request = urllib.request.Request(f"{origin}/message", body, headers)
            with urllib.request.urlopen(request, timeout=SOON / 1e3) as reply:
                assert json.load(reply)["ok"]


@dataclass
class Watched:
    """A page, and what must not happen on it."""

    page: Any
    requested: set[str] = field(default_factory=set)
    complaints: list[str] = field(default_factory=list)
    under_way: set[Any] = field(default_factory=set)
    """Requests that have no answer yet."""

    def __post_init__(self) -> None:
        self.page.on("request", lambda request: self.under_way.add(request))
        for end in ("requestfinished", "requestfailed"):
            self.page.on(end, lambda request: self.under_way.discard(request))

    def __call__(self, name: str) -> Any:
        return self.page.locator(f'[data-test="{name}"]')

    def text(self, name: str) -> str:
        return self(name).inner_text()

    def number(self, key: str) -> float:
        """A figure of the panel as it is shown, in the unit that is shown."""
        return float(self(f"number-{key}").locator(".pf-value").inner_text().replace("−", "-"))

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

    def frame(self) -> None:
        """What is due is drawn, however long a frame takes."""
        self.page.evaluate(
            "() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(() => drawn())))"
        )

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

    def scrolled(self) -> float:
        """How far the designer is scrolled in its window, in px."""
        return self.page.locator(".pf-scroll").evaluate("element => element.scrollTop")

    def settled(self) -> None:
        """Python has answered for the design on the screen."""
        # The page's policy forbids what Playwright's own wait_for_function does.
        self.until(lambda: "pf-stale" not in (self("designer").get_attribute("class") or ""))

    def idle(self) -> None:
        """Python has answered, and the page has asked nothing since: an end of the server cuts nothing off."""
        self.settled()
        since = time.monotonic()

        def rests() -> bool:
            nonlocal since
            if self.under_way:
                since = time.monotonic()
            return time.monotonic() - since > RESTS / 1e3

        self.until(rests)

    def until(self, holds: Callable[[], bool], limit: float = SOON) -> None:
        before = time.monotonic()
        while not holds():
            assert time.monotonic() - before < limit / 1e3
            self.page.wait_for_timeout(30)

    def ready(self) -> None:
        """Python has answered once."""
        self.until(lambda: self.text("status").startswith("Ready"))
        self.settled()

    def fill(self, name: str, value: str) -> None:
        """Type a value and confirm it."""
        self(name).fill(value)
        self(name).press("Enter")

    def drop(self, name: str, text: str, *, confirm: bool = True) -> None:
        """A file out of the file manager, let go over the page; what is suggested of its columns is confirmed."""
        held = self.page.evaluate_handle(
            "([name, text]) => { const data = new DataTransfer();"
            " data.items.add(new File([text], name, { type: 'text/csv' })); return data; }",
            [name, text],
        )
        for event in ("dragenter", "dragover", "drop"):
            self("drop").dispatch_event(event, {"dataTransfer": held})
        if confirm:
            self("import-open").click()

    def picture(self, name: str) -> None:
        folder = os.environ.get("PHYFILTER_SCREENSHOTS")
        if folder:
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=str(Path(folder, f"{name}.png")))


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@contextlib.contextmanager
def serving(out: Path, *options: str) -> Iterator[Served]:
    """``phyfilter-ctl app`` on a port of its own.

    Parameters
    ----------
    out : Path
        Where exports are written as well.
    options : str
        Further ones of the command.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "phyfilter_ctl", "app", "--no-browser", "--out", str(out), *options],
        stdout=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT,
    )
    try:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found, "the server did not start"
        yield Served(process, found[0], out)
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@contextlib.contextmanager
def watching(browser: Any, **settings: Any) -> Iterator[Watched]:
    """A page in a context of its own that asks nothing of other machines; ``settings`` are the browser context's."""
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


def bandwidth(poles: list[complex]) -> float:
    return pf.frequency_response(pf.PhyFilter.from_poles(poles)).band_edges[1]


def recording(samples: int = 6000, *, start: float = 0.0) -> str:
    """A flight as CSV text: a velocity with noise, and its acceleration as the label."""
    rng = np.random.default_rng(3)
    N, dt = samples, 0.002
    t = dt * np.arange(N)
    f = np.sin(2.0 * t) + 0.3 * np.sin(17.0 * t) + np.cumsum(rng.standard_normal(N)) * 0.02
    x = np.cumsum(dt * f) + 2e-3 * rng.standard_normal(N)
    return "t,vx,ax\n" + "".join(
        f"{a:.4f},{b:.9g},{c:.9g}\n" for a, b, c in zip(start + t, x, f, strict=True)
    )


@contextlib.contextmanager
def jupyter_lab(folder: Path, cells: Sequence[str], *, theme: str = "JupyterLab Light") -> Iterator[str]:
    """JupyterLab with one notebook, its settings and data in a folder of its own: the notebook's address.

    Parameters
    ----------
    folder : Path
    cells : sequence of str
        Code of the notebook.
    theme : str
    """
    import nbformat

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in cells])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    (folder / "root").mkdir()
    nbformat.write(notebook, folder / "root" / "design.ipynb")
    overrides = folder / "share" / "settings"
    overrides.mkdir(parents=True)
    quiet = {
        "@jupyterlab/apputils-extension:notification": {"fetchNews": "false", "checkForUpdates": False},
        "@jupyterlab/apputils-extension:themes": {"theme": theme},
    }
    (overrides / "overrides.json").write_text(json.dumps(quiet))
    port = free_port()
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


def open_notebook(lab: Watched, address: str) -> None:
    """Open the notebook and wait for its kernel."""
    lab.page.set_default_timeout(LONG)
    lab.page.goto(address)
    lab.page.wait_for_selector(".jp-Notebook .jp-CodeCell")
    lab.page.wait_for_function("document.querySelector('.jp-StatusBar-Widget')?.textContent.includes('Idle')")


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
