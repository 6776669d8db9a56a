"""What one does in the designer, gesture by gesture, in a real browser."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import pytest
from designer_hosts import CHROMIUM, SHOWN, Served, Watched, bandwidth, recording, watching

import phyfilter_ctl as pf

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped by POSIX signals"),
]


def test_in_the_first_minute_a_pole_is_placed_and_the_filter_exported(page: Watched, tmp_path: Path) -> None:
    assert page.text("plane-readout") == "Drag a pole ×; double-click adds one"
    for name in ("plane", "export", "add-pole"):
        box = page(name).bounding_box()
        assert box is not None
        assert box["y"] + box["height"] < 1000.0, f"{name} is below the first screen"
    box = page("plane").bounding_box()
    page.page.mouse.dblclick(box["x"] + 60.0, box["y"] + 0.5 * box["height"])
    page.settled()
    assert len(page.poles()) == 3
    page("export").click()
    with page.page.expect_download() as waiting:
        page("export-c").click()
    path = tmp_path / waiting.value.suggested_filename
    waiting.value.save_as(path)
    with zipfile.ZipFile(path) as archive:
        assert any(name.endswith(".c") for name in archive.namelist())
    page.until(lambda: "with your downloads" in page.text("status"))


def test_a_pair_is_led_by_the_keyboard_to_the_axis_and_off_it(page: Watched) -> None:
    page("family").select_option("butterworth")
    page.until(lambda: page.poles()[0].imag != 0.0)
    page("pole-0").focus()
    for _ in range(30):
        page.page.keyboard.press("Shift+ArrowDown")
        page.page.wait_for_timeout(20)
        if page("pole-0-conjugate").count() == 0:
            break
    page.settled()
    one, other = page.poles()
    assert one.imag == other.imag == 0.0
    page("pole-0").focus()
    page.page.keyboard.press("ArrowUp")
    page.settled()
    one, other = page.poles()
    assert one == other.conjugate()
    assert one != other
    assert page.number("bandwidth") == pytest.approx(bandwidth([one, other]), rel=SHOWN)


def test_poles_and_zeros_are_added_and_deleted(page: Watched) -> None:
    page("add-pair").click()
    page.settled()
    assert sum(p.imag != 0.0 for p in page.poles()) == 2
    page("add-zero").click()
    page.settled()
    assert page("zero-0").count() == 1
    page("zero-0-delete").click()
    page.settled()
    assert page("zero-0").count() == 0
    page("pole-0").focus()
    page("delete").click()
    page.settled()
    assert len(page.poles()) == 3
    for _ in range(6):
        page("add-pole").click()
    page.until(lambda: "highest order is 8" in page.text("status"))
    page.settled()
    assert len(page.poles()) == 8


def test_a_pole_off_the_plot_waits_at_the_rim(page: Watched) -> None:
    page.fill("pole-0-re", "-3000")
    page.settled()
    for _ in range(6):
        page("zoom-in").click()
    page.until(lambda: "3000" in (page("pole-0").text_content() or ""))
    box = page("plane").bounding_box()
    x, y = page.centre("pole-0")
    assert box["x"] < x < box["x"] + 40.0
    assert box["y"] < y < box["y"] + box["height"]
    assert page("pole-0").locator(".pf-rim").get_attribute("visibility") == "visible"
    page.drag("pole-0", 100.0, 0.0)
    page.settled()
    assert page("pole-0").locator(".pf-rim").get_attribute("visibility") == "hidden"
    assert -3000.0 < page.poles()[0].real < -20.0


def test_limits_are_drawn_dragged_moved_by_keys_and_deleted(page: Watched) -> None:
    page("limit-error").click()
    handle = page("limit-error-handle")
    said = handle.get_attribute("aria-valuetext")
    assert "to spare" in said
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2.0, box["y"] + box["height"] / 2.0
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 80.0, y + 60.0, steps=5)
    page.page.mouse.up()
    page.until(lambda: "over" in handle.get_attribute("aria-valuetext"))
    assert "pf-violated" in page("limit-error").get_attribute("class")
    dragged = handle.get_attribute("aria-valuetext")
    handle.focus()
    page.page.keyboard.press("Shift+ArrowLeft")
    page.until(lambda: handle.get_attribute("aria-valuetext") != dragged)
    page.page.keyboard.press("Delete")
    page.until(lambda: handle.count() == 0)
    page("undo").click()
    page.until(lambda: handle.count() == 1)


def test_the_limit_of_forward_euler_is_seen_and_crossed(page: Watched) -> None:
    assert "Euler is stable below 100 ms" in page.text("euler")
    assert page("sampling").locator(".pf-euler-mark").is_visible()
    page("method-euler").click()
    page.fill("dt", "101")
    page.settled()
    assert "Unstable" in page.text("euler")
    assert "unstable" in page.text("messages")
    assert page.text("number-noise_gain").endswith("–")
    assert page("plane").locator(".pf-euler").count() == 1
    page.fill("dt", "99")
    page.settled()
    assert page.text("messages") == ""
    found = pf.frequency_response(pf.PhyFilter.from_poles([-20.0, -20.0]).sampled(0.099, "euler"), [1.0])
    assert page.number("noise_gain") == pytest.approx(found.noise_gain, rel=SHOWN)


def test_sampling_is_matched_until_told_otherwise(page: Watched) -> None:
    assert "hold at the samples" not in page.text("euler")  # of type 1 there is nothing to keep
    page("numerator-type").click()
    page.fill("dt", "50")
    page.settled()
    filter = pf.place_poles([-20.0, -20.0], type=2)
    for method, words in (("matched", "1 − F hold at the samples"), ("exact", "for constants only")):
        page(f"method-{method}").click()
        page.settled()
        assert words in page.text("euler")
        found = pf.frequency_response(filter.sampled(0.05, method), [1.0])
        assert page.number("noise_gain") == pytest.approx(found.noise_gain, rel=SHOWN)
    assert found.noise_gain != pytest.approx(
        pf.frequency_response(filter.sampled(0.05), [1.0]).noise_gain, rel=100.0 * SHOWN
    )


def test_the_coarse_knobs_are_the_library_s(page: Watched) -> None:
    page("family").select_option("bessel")
    page.until(lambda: "Bessel" in page.text("status"))
    page("order-more").click()
    page.until(lambda: page.text("order") == "3")
    page.fill("cutoff", "40")
    page.settled()
    expected = pf.lowpass(3, 40.0, family="bessel").poles
    # The table shows five digits.
    assert sorted(page.poles(), key=lambda p: p.imag) == pytest.approx(
        sorted(expected, key=lambda p: p.imag), rel=1e-4
    )
    page("numerator-type").click()
    page("type").select_option("3")
    page.settled()
    assert "type 3" in page.text("summary")
    page("family").select_option("bandpass")
    page.until(lambda: page("band-low").is_visible() and "Band-pass" in page.text("status"))
    page.fill("band-low", "10")
    page.settled()
    page.fill("band-high", "30")
    page.until(lambda: abs(page.number("bandwidth") - 20.0) < 20.0 * SHOWN)
    page.until(
        lambda: "certified" not in page.text("number-bound") and page.text("number-bound").endswith("–")
    )


def test_the_frequency_axes_count_in_hertz_when_asked(page: Watched) -> None:
    before, bandwidth = page.drawn("bode-phase"), page.number("bandwidth")
    page("unit-Hz").click()
    page.until(lambda: page.drawn("bode-phase") != before)
    assert page("unit-Hz").get_attribute("aria-pressed") == "true"
    assert page.number("bandwidth") == bandwidth
    page("unit-rad/s").click()
    page.until(lambda: page.drawn("bode-phase") == before)


def test_a_pinned_design_is_compared(page: Watched) -> None:
    page("pin").click()
    page.fill("cutoff", "50")
    page.settled()
    table = page("compare").inner_text()
    row = next(line for line in table.splitlines() if line.startswith("Bandwidth"))
    assert "50 rad/s" in row
    assert "12.87 rad/s" in row
    assert "[f]" in next(line for line in table.splitlines() if line.startswith("Error bound"))


def test_figures_in_the_unit_of_f_name_it(page: Watched) -> None:
    assert page.text("number-bound").endswith("[f]")
    page.fill("unit", "N")
    page.settled()
    for key in ("bound", "bound_sampled", "noise"):
        assert page.text(f"number-{key}").endswith("N")
    page("number-bound_sampled").hover()
    page.until(lambda: "ertified" in page.text("explain"))


def test_a_part_of_the_log_is_drawn(page: Watched) -> None:
    page.drop("flight.csv", recording())
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
    page.settled()
    assert not page("log-whole").is_enabled()
    before, rmse = page.drawn("log-plot"), page.text("rmse")
    page("log-plot").scroll_into_view_if_needed()
    box = page("log-plot").bounding_box()
    mouse = page.page.mouse
    mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 90.0)
    mouse.down()
    mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 100.0, steps=4)
    mouse.up()
    page.until(lambda: page("log-whole").is_enabled() and page.drawn("log-plot") != before)
    assert page.text("rmse") == rmse
    part = page.drawn("log-plot")
    page("log-later").click()
    page.until(lambda: page.drawn("log-plot") != part)
    page("log-whole").click()
    page.until(lambda: not page("log-whole").is_enabled())
    page("forget").click()
    page.until(lambda: page("drop").is_visible())


def test_the_wheel_scrolls_the_page_and_zooms_with_ctrl(page: Watched) -> None:
    page.page.set_viewport_size({"width": 1000, "height": 700})  # not all of it fits
    page.settled()
    tick = page("plane").locator(".pf-tick").first
    before = page.centre("pole-0"), tick.text_content()
    x, y = before[0]
    page.page.mouse.move(x + 50.0, y + 50.0)
    page.page.mouse.wheel(0.0, 200.0)
    page.until(lambda: page.scrolled() > 0.0)
    assert tick.text_content() == before[1]

    def back() -> bool:
        # The browser may still glide towards where the wheel sent it, past a single call.
        page.page.locator(".pf-scroll").evaluate("element => element.scrollTo(0, 0)")
        page.page.wait_for_timeout(100)
        return page.scrolled() == 0.0 and page.centre("pole-0") == before[0]

    page.until(back)
    page.page.keyboard.down("Control")
    page.page.mouse.wheel(0.0, -200.0)
    page.page.keyboard.up("Control")
    page.until(lambda: page.centre("pole-0") != before[0])
    assert page.scrolled() == 0.0


def test_a_finger_drags_a_pole_and_scrolls_beside_it(browser: Any, served: Served) -> None:
    served.reset()
    with watching(browser, viewport={"width": 390, "height": 800}, has_touch=True) as page:
        page.page.goto(served.address)
        page.ready()
        touch = page.page.context.new_cdp_session(page.page)

        def stroke(x: float, y: float, dx: float, dy: float) -> None:
            touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
            for k in range(1, 9):
                point = {"x": x + dx * k / 8.0, "y": y + dy * k / 8.0}
                touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [point]})
                page.page.wait_for_timeout(16)
            touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

        page("plane").scroll_into_view_if_needed()
        at = page.scrolled()
        stroke(*page.centre("pole-0"), -40.0, 30.0)
        page.settled()
        assert page.scrolled() == at
        assert max(abs(p) for p in page.poles()) > 22.0
        box = page("plane").bounding_box()
        stroke(box["x"] + 30.0, box["y"] + box["height"] - 60.0, 0.0, -150.0)
        page.until(lambda: page.scrolled() > at)
        assert len(page.poles()) == 2
        assert page.complaints == []
