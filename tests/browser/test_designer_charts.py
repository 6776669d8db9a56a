"""Zoom, pan and cursors of the designer's charts, in a real browser."""

from __future__ import annotations

import os
import re
from math import exp

import pytest
from designer_hosts import CHROMIUM, Watched

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped by POSIX signals"),
]


def test_every_chart_zooms_pans_and_reads_out_by_mouse_and_keys(page: Watched) -> None:
    for name in ("bode-magnitude", "bode-phase", "step"):
        chart, mouse, keys = page(name), page.page.mouse, page.page.keyboard
        chart.scroll_into_view_if_needed()
        box = chart.bounding_box()
        x, y = box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"]
        reset, overlay = page(f"{name}-reset"), chart.locator("svg.pf-overlay")
        whole = drawn(page, name)
        assert not reset.is_visible()

        # The wheel belongs to the page until the chart is clicked; with Ctrl it zooms at once.
        mouse.move(x, y)
        mouse.wheel(0.0, -120.0)
        page.frame()
        assert not reset.is_visible()
        keys.down("Control")
        mouse.wheel(0.0, -120.0)
        keys.up("Control")
        page.until(reset.is_visible)
        near = drawn(page, name)
        assert near != whole

        # A drag pans, and Escape takes back one that is under way.
        mouse.move(x, y)
        mouse.down()
        mouse.move(x - 60.0, y, steps=4)
        page.until(lambda near=near, name=name: drawn(page, name) != near)
        keys.press("Escape")
        page.until(lambda near=near, name=name: drawn(page, name) == near)
        mouse.up()
        mouse.move(x, y)
        mouse.down()
        mouse.move(x - 60.0, y, steps=4)
        mouse.up()
        page.until(lambda near=near, name=name: drawn(page, name) != near)
        reset.click()
        page.until(lambda whole=whole, name=name: drawn(page, name) == whole)
        assert overlay.evaluate("e => e === document.activeElement"), "the focus is lost with the button"

        # By keys alone: in, along, all of it.
        for key in ("+", "Shift+ArrowRight", "Alt+ArrowUp"):
            before = drawn(page, name)
            keys.press(key)
            page.until(lambda before=before, name=name: drawn(page, name) != before)
        keys.press("0")
        page.until(lambda whole=whole, name=name: drawn(page, name) == whole)

        # The cursor: said to a screen reader, and measured from a marked point.
        keys.press("Home")
        keys.press("Enter")
        keys.press("ArrowRight")
        page.until(lambda chart=chart: "Δ" in spoken(chart))
        assert chart.locator(".pf-from").get_attribute("visibility") == "visible"
        keys.press("Escape")
        page.until(lambda chart=chart: chart.locator(".pf-from").get_attribute("visibility") == "hidden")
        assert page.page.evaluate("document.activeElement.getAttribute('aria-label')").count("Arrow keys")


def test_a_step_s_cursor_reads_the_curve_and_a_click_measures_from_there(page: Watched) -> None:
    box = page("step").bounding_box()
    middle = box["y"] + 0.5 * box["height"]
    page.page.mouse.click(box["x"] + 0.3 * box["width"], middle)
    page.page.mouse.move(box["x"] + 0.7 * box["width"], middle)
    readout = page("step-readout")
    page.until(lambda: "Δ" in readout.inner_text())
    found = dict(re.findall(r"(\S+) ([−\d.]+)", readout.inner_text()))
    t, change = (float(found[key].replace("−", "-")) / 1e3 for key in ("t", "Δt"))
    estimate, rise = (float(found[key].replace("−", "-")) for key in ("estimate", "Δestimate"))

    def step(at: float) -> float:  # of two poles at -20 rad/s
        return 1.0 - (1.0 + 20.0 * at) * exp(-20.0 * at)

    assert estimate == pytest.approx(step(t), abs=2e-3)
    assert rise == pytest.approx(step(t) - step(t - change), abs=3e-3)


def drawn(page: Watched, name: str) -> str:
    page.frame()
    return page.drawn(name)


def spoken(chart: object) -> str:
    return chart.locator("[data-test=chart-spoken]").text_content() or ""  # type: ignore[attr-defined]
