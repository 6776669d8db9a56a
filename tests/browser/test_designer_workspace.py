"""The designer as a place to work in: verdict in words, panels that fill the window and move, messages, access."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from designer_hosts import CHROMIUM, LONG, Served, Watched, recording, watching

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped and continued by POSIX signals"),
]

AXE = Path(__file__).resolve().parents[2] / "build" / "web" / "node_modules" / "axe-core" / "axe.min.js"
Box = dict[str, float]

# What leaves the window or lies on another panel of the same column.
FAULTS = """() => {
  const bad = [];
  const wide = document.documentElement.scrollWidth;
  if (wide > innerWidth) bad.push(`the page is ${wide} px wide`);
  const scroll = document.querySelector('.pf-scroll');
  if (scroll.scrollWidth > scroll.clientWidth + 1) bad.push(`the inside is ${scroll.scrollWidth} px wide`);
  const cards = [...document.querySelectorAll('.pf-card')].map((card) => [card, card.getBoundingClientRect()]);
  const shown = cards.filter(([, box]) => box.width);
  for (const [card, box] of shown) {
    if (card.scrollWidth > card.clientWidth + 1) bad.push(`${card.ariaLabel} is cut`);
    if (box.left < -1 || box.right > innerWidth + 1) bad.push(`${card.ariaLabel} leaves the window`);
    for (const [other, b] of shown) {
      const column = other !== card && other.parentElement === card.parentElement;
      const across = b.left < box.right - 1 && box.left < b.right - 1;
      const down = b.top < box.bottom - 1 && box.top < b.bottom - 1;
      if (column && across && down) bad.push(`${card.ariaLabel} on ${other.ariaLabel}`);
    }
  }
  for (const button of document.querySelectorAll('[data-test=designer] :is(button, select, input)')) {
    const box = button.getBoundingClientRect();
    if (box.width && box.width < 24 && !button.closest('.pf-number, table') || box.height && box.height < 20)
      bad.push(`${button.dataset.test ?? button.ariaLabel} is ${box.width} x ${box.height}`);
  }
  return bad;
}"""


def whole(page: Watched, name: str, *, height: float) -> Box:
    """The box of a thing that is seen whole, without scrolling."""
    box = page(name).bounding_box()
    assert box is not None
    assert 0.0 <= box["y"] < box["y"] + box["height"] <= height, (name, box)
    return box


def log_open(page: Watched) -> None:
    page.drop("flight.csv", recording())
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")), LONG)
    page.settled()


def test_the_first_time_takes_five_gestures(page: Watched, tmp_path: Path) -> None:
    gestures = 0

    def gesture(act: Callable[[], object]) -> None:
        nonlocal gestures
        gestures += 1
        act()

    gesture(lambda: page("example").click())
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")), LONG)
    page.settled()
    assert page.text("verdict").startswith("Stable. Tolerates ")
    gesture(lambda: page.drag("pole-0", -30.0, 0.0))
    page.settled()
    assert "Error at most" in page.text("verdict")
    gesture(lambda: page("export").click())
    with page.page.expect_download(timeout=LONG) as waiting:
        gesture(lambda: page("export-c").click())
    waiting.value.save_as(tmp_path / "c.zip")
    assert gestures <= 5


def test_trouble_is_said_in_red_and_words_and_before_an_export(page: Watched, served: Served) -> None:
    assert page.text("verdict").startswith(
        "Stable. Tolerates 120 ms more delay, masses from 0.12 times yours."
    )
    page.until(lambda: page("verdict-spoken").text_content() == page("verdict").text_content())
    assert page("verdict-spoken").get_attribute("aria-live") == "polite"
    page("limit-error").click()
    page.until(lambda: "dB below your limit on |1−F|" in page.text("verdict"))
    page.fill("cutoff", "3")
    page.settled()
    sentence = page("verdict").locator(".pf-is-bad")
    assert "dB above your limit on |1−F|" in sentence.inner_text()
    # The chart says the same number.
    assert f"{sentence.inner_text().split()[0]} dB over" in page("limit-error-handle").get_attribute(
        "aria-valuetext"
    )
    red, green, blue = (
        int(v) for v in sentence.evaluate("e => getComputedStyle(e).color").strip("rgb()").split(",")
    )
    assert red > 1.5 * max(green, blue)
    page("limit-error").click()
    page.fill("delay", "200")
    page.fill("cutoff", "13")
    page.settled()
    assert page.text("verdict").startswith("Unstable with f̂ fed back")

    downloads: list[Any] = []
    page.page.on("download", lambda download: downloads.append(download))
    page("export").click()
    page("export-c").click()
    page("confirm").wait_for()
    assert "Unstable with f̂ fed back" in page.text("confirm")
    page.picture("confirm")
    page.page.keyboard.press("Escape")
    page.until(lambda: page("confirm").count() == 0)
    page.page.wait_for_timeout(300)
    assert downloads == []
    page("export").click()
    page("export-c").click()
    page("confirm-export").click()
    page.until(lambda: len(downloads) == 1, LONG)

    # Before Python has answered the preview says it, and the figures are marked.
    page.fill("delay", "20")
    page.settled()
    assert page.text("verdict").startswith("Stable")
    served.process.send_signal(signal.SIGSTOP)
    try:
        page.fill("cutoff", "300")
        page.until(
            lambda: page.text("verdict") == "Unstable with f̂ fed back, as far as the preview can tell."
        )
        assert "pf-waiting" in page("number-delay_margin").get_attribute("class")
        page.until(lambda: page("late").is_visible())
    finally:
        served.process.send_signal(signal.SIGCONT)
    page.settled()
    page.until(lambda: page.text("verdict").startswith("Unstable with f̂ fed back: lower the bandwidth"))
    page.until(lambda: not page("late").is_visible())


# 720 x 450 is 1440 x 900 at 200 %.
SIZES = ((2560, 1440), (1920, 1080), (1440, 900), (720, 450), (390, 844), (320, 640))


def test_the_panels_fit_the_window(page: Watched) -> None:
    log_open(page)
    for width, height in SIZES:
        page.page.set_viewport_size({"width": width, "height": height})
        page.page.wait_for_timeout(300)
        assert page.page.evaluate(FAULTS) == [], width
        clip, bar = (page.page.locator(name).bounding_box() for name in (".pf-scroll", ".pf-status-bar"))
        # The line of messages ends the window, and what scrolls ends above it: it never covers a chart.
        assert bar["y"] + bar["height"] == pytest.approx(height, abs=1.0)
        assert clip["y"] + clip["height"] <= bar["y"] + 1.0
        if width >= 1440:
            plane, log = whole(page, "plane", height=height), whole(page, "log-plot", height=height)
            bode = page("bode-magnitude").bounding_box()
            assert page.scrolled() == 0.0
            # A share of the window, whatever its size.
            assert plane["height"] > 0.24 * height
            assert log["height"] > 0.08 * height
            assert plane["width"] > 0.25 * width
            assert bode["width"] > 0.33 * width
        page.picture(f"room_{width}")


def test_panels_are_moved_hidden_kept_and_put_back(page: Watched) -> None:
    def slots() -> dict[str, list[str]]:
        return page.page.evaluate(
            "() => Object.fromEntries([...document.querySelectorAll('.pf-column')].map((column) =>"
            " [column.dataset.test.slice(5), [...column.children].filter((e) => e.checkVisibility())"
            " .map((e) => e.dataset.panel)]))"
        )

    usual = slots()
    assert usual["middle"] == ["plane", "values"]
    # By keys: the focus stays with the handle.
    page("grip-values").focus()
    page.page.keyboard.press("ArrowUp")
    assert slots()["middle"] == ["values", "plane"]
    assert page.text("status") == "Values: middle column, 1 of 2."
    page.page.keyboard.press("ArrowRight")
    assert slots()["right"][0] == "values"
    page.page.keyboard.press("Delete")
    assert "values" not in slots()["right"]
    # By dragging.
    before = page("step").bounding_box()
    x, y = (lambda b: (b["x"] + b["width"] / 2, b["y"] + b["height"] / 2))(page("grip-step").bounding_box())
    target = page("plane").bounding_box()
    mouse = page.page.mouse
    mouse.move(x, y)
    mouse.down()
    mouse.move(target["x"] + 50.0, target["y"] + 30.0, steps=5)
    mouse.up()
    page.until(lambda: slots()["middle"] == ["step", "plane"])
    assert page("step").bounding_box() != before
    # Esc leaves it where it was.
    x, y = (lambda b: (b["x"] + b["width"] / 2, b["y"] + b["height"] / 2))(page("grip-step").bounding_box())
    mouse.move(x, y)
    mouse.down()
    mouse.move(x + 600.0, y + 100.0, steps=5)
    page.page.keyboard.press("Escape")
    mouse.up()
    assert slots()["middle"] == ["step", "plane"]
    # Kept over a reload.
    arranged = slots()
    page.page.wait_for_timeout(700)
    page.page.reload()
    page.ready()
    page.until(lambda: slots() == arranged)
    # The list does the same with single clicks.
    page("panels-open").click()
    assert not page("show-values").is_checked()
    page("show-values").check()
    page("move-step-right").click()
    page("panels-usual").click()
    page.until(lambda: slots() == usual)
    log_open(page)
    height = page("log-plot").bounding_box()["height"]
    page("divider").focus()
    page.page.keyboard.press("ArrowUp")
    page.until(lambda: page("log-plot").bounding_box()["height"] > height)


def test_messages_are_dismissed_and_found_again(page: Watched) -> None:
    page.fill("pole-0-re", "35")
    page.until(lambda: "expected a real part below 0" in page.text("status"))
    page("status-dismiss").click()
    assert page.text("status") == ""
    assert not page("status-dismiss").is_visible()
    page("messages-open").click()
    assert "expected a real part below 0" in page.text("messages-list")
    page.page.keyboard.press("Escape")
    page.until(lambda: page("messages-dialog").count() == 0)
    assert page("messages-open").evaluate("e => e === document.activeElement")


FOCUSED = """() => {
  const e = document.activeElement;
  if (!e || e === document.body) return null;
  const style = getComputedStyle(e);
  const halo = e.querySelector('.pf-halo, circle:last-child');
  const hidden = e.matches('input[type=file]') ? e.parentElement : e;
  const box = hidden.getBoundingClientRect();
  return {
    name: e.dataset.test ?? e.ariaLabel ?? e.textContent.trim(),
    seen: style.outlineStyle !== 'none' && parseFloat(style.outlineWidth) >= 2
      || Boolean(halo && parseFloat(getComputedStyle(halo).strokeWidth) >= 2)
      || getComputedStyle(hidden).outlineStyle !== 'none',
    inside: box.bottom > 0 && box.top < innerHeight,
  };
}"""


def test_the_keyboard_reaches_everything_and_is_seen(page: Watched) -> None:
    page("all-figures").click()
    page("pin").focus()
    reached = []
    for _ in range(160):
        page.page.keyboard.press("Tab")
        focused = page.page.evaluate(FOCUSED)
        if focused is None or (reached and focused["name"] == reached[0]["name"]):
            break
        reached.append(focused)
    assert [each["name"] for each in reached if not each["seen"]] == []
    assert [each["name"] for each in reached if not each["inside"]] == []
    names = {each["name"] for each in reached}
    assert names >= {
        "export",
        "all-figures",
        "number-bandwidth",
        "number-phase_margin",
        "family",
        "pole-0",
    }
    assert names >= {
        "dt",
        "delay",
        "pole-0-re",
        "add-pole",
        "legend-F",
        "grip-step",
        "messages-open",
        "panels-open",
    }
    # What a figure means is read without a mouse.
    page("number-settling").focus()
    page.until(lambda: "stays within 2 %" in page.text("explain"))
    page.page.keyboard.press("Escape")
    assert not page("explain").is_visible()


def test_forced_colours_show_what_is_chosen_and_motion_is_left_out(browser: Any, served: Served) -> None:
    served.reset()
    with watching(browser, forced_colors="active", reduced_motion="reduce") as page:
        page.page.goto(served.address)
        page.ready()
        outline = "e => { const s = getComputedStyle(e); return [s.outlineStyle, s.outlineWidth]; }"
        assert page("unit-rad/s").evaluate(outline) == ["solid", "3px"]
        assert page("unit-Hz").evaluate(outline)[0] == "none"
        stroke = "e => [...e.querySelectorAll('.pf-halo')].map((halo) => getComputedStyle(halo).stroke)"
        assert set(page("plane").evaluate(stroke)) == {"none"}
        page.page.mouse.click(*page.centre("pole-0"))
        page.until(lambda: len(set(page("plane").evaluate(stroke))) == 2)
        lasting = page.page.evaluate(
            "() => [...document.querySelectorAll('[data-test=designer] *')].filter((e) => {"
            " const s = getComputedStyle(e); return s.animationName !== 'none'"
            " || s.transitionDuration.split(', ').some((t) => parseFloat(t) > 0); }).length"
        )
        assert lasting == 0
        page.picture("forced_colors")
        assert page.complaints == []


RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
# Of a page, not of a part of one: the notebook around it has headings and landmarks of its own.
RUN = """(tags) => axe.run(document, { runOnly: tags, resultTypes: ['violations'] }).then(({ violations }) =>
  violations.map(({ id, nodes }) => `${id}: ${nodes.slice(0, 4).map(({ target, any }) =>
    `${target} ${any[0]?.message ?? ''}`).join(' | ')}`))"""


@pytest.mark.slow
@pytest.mark.skipif(
    not AXE.exists(),
    reason="axe-core is not in build/web (npm install --prefix build/web axe-core): not checked by its rules",
)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(browser: Any, served: Served, scheme: str) -> None:
    found: dict[str, list[str]] = {}
    served.reset()
    with watching(browser, viewport={"width": 1440, "height": 900}, color_scheme=scheme) as page:
        page.page.goto(served.address)
        page.ready()
        page.page.evaluate(AXE.read_text(encoding="utf-8"))

        def look(state: str) -> None:
            page.page.wait_for_timeout(400)  # transitions of colours
            if violations := page.page.evaluate(RUN, RULES):
                found[state] = violations

        page("all-figures").click()
        look("empty")
        log_open(page)
        look("log open")
        page.fill("delay", "200")
        page.fill("pole-0-re", "35")
        page.settled()
        look("unstable, with an error")
        page("export").click()
        page("export-c").click()
        page("confirm").wait_for()
        look("dialog")
        page.page.keyboard.press("Escape")
        page("learn-order").select_option("8")
        page("learn").click()
        page.until(lambda: "RMSE" in page.text("learn-message"))
        look("learning")
        page("cancel").evaluate("button => button.click()")  # it may be done by now: then this does nothing
    assert found == {}
