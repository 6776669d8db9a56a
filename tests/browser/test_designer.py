"""The page of ``phyfilter-ctl app`` in a real browser."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from designer_hosts import CHROMIUM, LONG, SHOWN, Served, Watched, bandwidth, recording, watching

import phyfilter_ctl as pf
from phyfilter_ctl.fmi.check import check

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: the designer is not tried in a browser"
)
pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped and continued by POSIX signals"),
]

# Poles that went through typed values and products of them.
SAME = 1e-12


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
    page.fill("pole-0-re", "-35")
    page.fill("pole-1-re", "-35")
    page.settled()
    assert page.poles() == [-35.0, -35.0]
    assert page.number("bandwidth") == pytest.approx(bandwidth([-35.0, -35.0]), rel=SHOWN)
    assert page.number("euler_dt") == pytest.approx(1e3 * 2.0 / 35.0, rel=SHOWN)
    page.fill("pole-0-re", "35")
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


def test_a_log_is_dropped_learned_from_and_learning_cancelled(page: Watched) -> None:
    text = recording()
    page.drop("flight.csv", text)
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
    page("cancel").evaluate("button => button.click()")  # at once: a fast machine is done in seconds
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
    page.drop("broken.csv", "t,vx\n0,1\n0.1,two\n")
    page.until(lambda: "Line 3, column 'vx': 'two'" in page.text("import-problem"))
    page("import-cancel").click()
    page.until(lambda: page("import").count() == 0)
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
    page("export").click()
    page("channels").fill("2")
    page("channels").press("Enter")
    page.until(lambda: page("export-name").get_attribute("placeholder") == "filter_2")
    button = f"export-fmu{version}"
    if page(button).get_attribute("aria-disabled") == "true":
        pytest.skip("no C compiler: no FMU is exported")
    path = download(page, button, tmp_path)
    assert re.fullmatch(rf"filter_2-[0-9a-f]{{8}}-fmi{version}\.fmu", path.name)
    report = check(path)
    assert report.ok, str(report)
    kept = served.out / f"filter_fmi{version}-{path.name.split('-')[1]}.fmu"
    assert kept.read_bytes() == path.read_bytes()


def test_what_is_saved_is_what_was_designed(page: Watched, tmp_path: Path) -> None:
    page.fill("pole-0-re", "-12.5")
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
    page.ready()


def test_the_design_outlives_a_reload(page: Watched) -> None:
    page.fill("pole-0-re", "-33")
    page.settled()
    page.page.reload()
    page.ready()
    assert sorted(p.real for p in page.poles()) == [-33.0, -20.0]


def test_what_is_designed_while_python_starts_is_kept(browser: Any, served: Served) -> None:
    served.reset()
    held: list[Any] = []
    with watching(browser) as page:
        page.page.route("**/message", lambda route: held.append(route))
        page.page.goto(served.address)
        page.until(lambda: page("busy").is_visible())
        page.drag("pole-0", -60.0, 0.0)
        drawn = page.poles()
        assert min(p.real for p in drawn) < -21.0
        page.page.unroute("**/message")
        page.page.wait_for_timeout(50)
        for route in held:
            with contextlib.suppress(playwright.Error):  # the end of routing may have let it through
                route.continue_()
        page.ready()
        assert page.poles() == drawn
        assert page.number("bandwidth") == pytest.approx(bandwidth(drawn), rel=SHOWN)
        assert page.complaints == []


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
    if (!box.width || !e.textContent.trim() || e.matches('.pf-unseen')) continue;
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
    served.reset()
    with watching(browser, viewport=size, color_scheme=scheme) as page:
        page.page.goto(served.address)
        page.until(lambda: page.text("status").startswith("Ready"))
        page.page.wait_for_timeout(400)  # transitions of colours
        page.picture(f"page_{scheme}_{width}")
        assert page.page.evaluate(CONTRAST) == []
        assert page.page.evaluate(CLIPPED) == []
        assert page.complaints == []
