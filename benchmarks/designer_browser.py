"""The designer in a real browser while a pole is dragged: time to the frame with the preview, and to Python's answer.

    python benchmarks/designer_browser.py [--quick] [--json FILE]

Promises, medians over a drag at 60 Hz, orders 2, 5 and 8, the server on the same machine: from the pointer's event to
the frame that shows the preview below 20 ms; from it to Python's figures on the screen below 100 ms. Needs chromium
(PHYFILTER_CHROMIUM, where it has another name), playwright and the extra app; skipped where one is missing.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import phyfilter_ctl

if TYPE_CHECKING:
    from playwright.sync_api import Page

FRAME_LIMIT = 20.0  # ms
ANSWER_LIMIT = 100.0  # ms
ORDERS = (2, 5, 8)
INTERVAL = 1.0 / 60.0  # s, between moves of the pointer
WARM_UP = 15  # moves

SERVE = """
import argparse
from phyfilter_ctl.cli import app
parser = argparse.ArgumentParser()
app.add_arguments(parser)
app.main(parser.parse_args())
"""
# Both frame callbacks belong to the same frame; the message comes after it was painted. An answer's time is the
# designer's own measure: from the move that it answers, waiting included, to the figures set.
WATCH = """() => {
  window.frames_seen = [];
  document.querySelector('[data-test=plane]').addEventListener('pointermove', (event) => {
    if (!event.buttons) return;
    requestAnimationFrame(() => {
      const { port1, port2 } = new MessageChannel();
      port1.onmessage = () => window.frames_seen.push(performance.now() - event.timeStamp);
      port2.postMessage(0);
    });
  }, true);
}"""
FORGET = "() => { window.frames_seen = []; performance.clearMeasures(); }"
CLASS = "element => element.className"
READ = """() => ({
  frame: window.frames_seen,
  answer: performance.getEntriesByName('drag-to-answer', 'measure').map((entry) => entry.duration),
})"""


def missing() -> str:
    """What is not there that this needs; "" if all is."""
    for name in ("playwright", "starlette", "uvicorn"):
        if find_spec(name) is None:
            return f"{name} is not installed"
    return "" if chromium() else "there is no chromium"


def chromium() -> str | None:
    named = os.environ.get("PHYFILTER_CHROMIUM")
    return named or next(
        filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
    )


def choose(page: Page, order: int) -> None:
    """A Butterworth filter of the order."""
    page.locator("[data-test=family]").select_option("butterworth")
    shown = page.locator("[data-test=order]")
    while (now := int(shown.inner_text())) != order:
        page.locator(f"[data-test={'order-less' if now > order else 'order-more'}]").click()
        while int(shown.inner_text()) == now:
            page.wait_for_timeout(20)


def drag(page: Page, moves: int) -> dict[str, list[float]]:
    """Move the first pole on a small circle, 60 times a second; times in ms."""
    handle = page.locator("[data-test=pole-0]")
    x, y = handle.evaluate("e => { const m = e.getScreenCTM(); return [m.e, m.f]; }")
    page.mouse.move(x, y)
    page.mouse.down()
    due = time.perf_counter()
    for k in range(moves + WARM_UP):
        if k == WARM_UP:
            page.evaluate(FORGET)
        angle = 2.0 * math.pi * k / 60.0
        page.mouse.move(x - 25.0 + 25.0 * math.cos(angle), y - 25.0 * math.sin(angle))
        due += INTERVAL
        page.wait_for_timeout(max(0.0, 1e3 * (due - time.perf_counter())))
    while not page.evaluate(READ)["answer"] or "pf-stale" in page.locator("[data-test=designer]").evaluate(
        CLASS
    ):
        page.wait_for_timeout(20)
    page.mouse.up()
    return page.evaluate(READ)


def measure(address: str, moves: int) -> dict[str, dict[str, list[float]]]:
    from playwright.sync_api import sync_playwright

    found: dict[str, dict[str, list[float]]] = {}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 1000})
        page.goto(address)
        status = page.locator("[data-test=status]")
        while not status.inner_text().startswith("Ready"):
            page.wait_for_timeout(50)
        page.evaluate(WATCH)
        for order in ORDERS:
            choose(page, order)
            found[f"order {order}"] = drag(page, moves)
        browser.close()
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="short drags and no verdict, to see that it runs"
    )
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if reason := missing():
        print(f"skipped: {reason}")
        return 0
    server = subprocess.Popen(
        [sys.executable, "-c", SERVE, "--no-browser"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(phyfilter_ctl.__file__).parents[1])},
    )
    try:
        assert server.stdout is not None
        address = re.search(r"http://\S+", server.stdout.readline())
        assert address, "the server did not start"
        found = measure(address[0], 30 if options.quick else 240)
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(10.0)
    print(
        f"{'ms':>10}{'to preview: median':>20}{'90 %':>8}{'n':>6}{'to answer: median':>20}{'90 %':>8}{'n':>6}"
    )
    medians: dict[str, list[float]] = {"frame": [], "answer": []}
    for name, times in found.items():
        row = f"{name:>10}"
        for kind in medians:
            median, high = np.percentile(times[kind], [50.0, 90.0])
            medians[kind].append(float(median))
            row += f"{median:20.1f}{high:8.1f}{len(times[kind]):6}"
        print(row)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1))
    holds = True
    for kind, text, limit in (
        ("frame", "drag to preview frame", FRAME_LIMIT),
        ("answer", "drag to Python's answer", ANSWER_LIMIT),
    ):
        worst = max(medians[kind])
        holds = holds and worst < limit
        verdict = (
            "not judged in a short run" if options.quick else "holds" if worst < limit else "DOES NOT HOLD"
        )
        print(f"{text}: median {worst:.1f} ms at worst, below {limit:g} ms: {verdict}")
    return 0 if options.quick or holds else 1


if __name__ == "__main__":
    sys.exit(main())
