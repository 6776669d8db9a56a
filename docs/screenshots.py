"""Pictures of the designer for the site, taken in a real browser: the page on windows of four widths, dark, in trouble,
and a notebook. With --site, pictures of a built site instead, and what is wider than its window.

    python docs/screenshots.py [--out FOLDER]
    python docs/screenshots.py --site build/site --out FOLDER

Needs chromium (PHYFILTER_CHROMIUM, where it has another name) and the extras dev and app.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "browser"))

from designer_hosts import (  # noqa: E402, the tests' own hosts
    CHROMIUM,
    LONG,
    Watched,
    jupyter_lab,
    open_notebook,
    recording,
    run_cell,
    serving,
    watching,
)

COLOURS = 256  # of the palette, the rare ones kept: a third of the bytes, and no difference to the eye
LARGEST = 200_000  # bytes
SAMPLES = 20_000
NOTEBOOK = """import phyfilter_ctl as pf

live = pf.designer(pf.lowpass(2, 20.0, family="butterworth"))
live"""


def design(page: Watched) -> None:
    """A pinned filter, another one beside it with limits, and a recording that it is run on."""
    page.fill("unit", "m/s²")
    page("pin").click()
    page("family").select_option("butterworth")
    page.until(lambda: "Butterworth" in page.text("status"))
    page("add-pole").click()
    page("numerator-type").click()
    page.fill("cutoff", "45")
    page.fill("pole-1-re", "-900")
    for _ in range(7):
        page("zoom-in").click()  # the fast one waits at the rim
    page("limit-error").click()
    page("limit-estimate").click()
    page.settled()
    page.drop("flight.csv", recording(SAMPLES))
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
    page.settled()


def learn(page: Watched) -> None:
    """The filter that is learned from the recording, and a part of the recording."""
    page("learn").click()
    page.until(lambda: "learned design" in page.text("status"), LONG)
    page.until(lambda: "Wiener" in page.text("rmse"))
    for _ in range(3):
        page("log-in").click()
        page.page.wait_for_timeout(200)


def take(page: Watched, path: Path) -> None:
    page.settled()
    page("designer").evaluate("element => element.scrollIntoView()")
    page.page.locator(".pf-scroll, .pf-column").evaluate_all("all => all.forEach((e) => e.scrollTo(0, 0))")
    page.page.mouse.move(0.0, 0.0)
    page.page.wait_for_timeout(500)  # the transitions of colours
    # Playwright's pictures are several times as large as they need be.
    image = Image.open(io.BytesIO(page.page.screenshot())).convert("RGB")
    few = image.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(path, optimize=True)
    size = path.stat().st_size
    print(f"{path}: {image.width} x {image.height}, {size / 1000:.0f} kB")
    assert size < LARGEST, f"{path}: expected less than {LARGEST} bytes, got {size}"


def trouble(page: Watched) -> None:
    """A loop that is not stable with its delay, and a limit that is not met."""
    page.fill("delay", "60")
    page.fill("cutoff", "180")


def pages(browser: Any, out: Path) -> None:
    """The page in windows from a telephone's to a large screen's."""
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder)) as served:
        for name, scheme, size in (
            ("designer", "light", (1440, 900)),
            ("designer_dark", "dark", (1440, 900)),
            ("designer_trouble", "light", (1440, 900)),
            ("designer_narrow", "light", (390, 1500)),
            ("designer_1920", "light", (1920, 1080)),
            ("designer_2560", "dark", (2560, 1440)),
        ):
            width, height = size
            served.reset()
            viewport = {"width": width, "height": height}
            with watching(browser, viewport=viewport, color_scheme=scheme) as page:
                page.page.goto(served.address)
                page.ready()
                design(page)
                if scheme == "dark":
                    learn(page)
                if name.endswith("trouble"):
                    trouble(page)
                take(page, out / f"{name}.png")


def notebook(browser: Any, out: Path) -> None:
    """The designer below a cell of JupyterLab."""
    with (
        tempfile.TemporaryDirectory() as folder,
        jupyter_lab(Path(folder), [NOTEBOOK]) as address,
        watching(browser, viewport={"width": 1500, "height": 1240}) as lab,
    ):
        open_notebook(lab, address)
        run_cell(lab, 0)
        lab.page.wait_for_selector('[data-test="designer"]')
        lab.ready()
        lab("pin").click()
        lab("pole-0").scroll_into_view_if_needed()
        lab.drag("pole-0", -40.0, -30.0)
        lab.settled()
        take(lab, out / "designer_notebook.png")


SITE = ("index", "tutorial", "concepts", "results", "commands", "reference/index", "reference/design")
# Elements that reach beyond the window and do not scroll inside a box of their own.
WIDE = """() => [...document.querySelectorAll("article *, header, .mobile-header")].filter((each) => {
  for (let box = each.parentElement; box; box = box.parentElement)
    if (["auto", "scroll", "hidden"].includes(getComputedStyle(box).overflowX) && box !== document.body) return false;
  return each.getBoundingClientRect().right > document.documentElement.clientWidth + 1;
}).map((each) => `${each.tagName.toLowerCase()}: ${each.textContent.trim().slice(0, 60)}`)"""


def site(browser: Any, folder: Path, out: Path) -> int:
    """Pages of the site on a telephone and on a desk: their first screens, their heights, what leaves the window."""
    wrong = 0
    for width, height in ((390, 844), (1440, 900)):
        page = browser.new_page(viewport={"width": width, "height": height})
        for name in SITE:
            page.goto((folder / "docs" / f"{name}.html").resolve().as_uri())
            page.screenshot(path=out / f"{name.replace('/', '_')}_{width}.png")
            wide = page.evaluate(WIDE)
            scrolls = page.evaluate(
                "document.documentElement.scrollWidth > document.documentElement.clientWidth"
            )
            tall = page.evaluate("document.documentElement.scrollHeight")
            wrong += bool(scrolls or wide)
            print(f"{name} at {width}: {tall} px tall{', scrolls sideways' if scrolls else ''}")
            for each in wide[:5]:
                print(f"    beyond the window: {each}")
        page.close()
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    parser.add_argument("--site", type=Path, metavar="FOLDER", help="a built site to look at instead")
    options = parser.parse_args()
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        wrong = 0
        if options.site:
            wrong = site(browser, options.site, out)
        else:
            pages(browser, out)
            notebook(browser, out)
        browser.close()
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
