"""Work is not lost: reloads, two tabs, a server that is killed in a drag and started again."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from designer_hosts import (
    CHROMIUM,
    SHOWN,
    Served,
    Watched,
    bandwidth,
    free_port,
    recording,
    serving,
    watching,
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is killed by a POSIX signal"),
]

# What a browser says of a server that has gone.
GONE = ("ERR_CONNECTION_REFUSED", "401 (Unauthorized)", "ERR_EMPTY_RESPONSE", "ERR_CONNECTION_RESET")

# A busy page: its timers are late.
LATE = """() => {
  const own = window.setTimeout;
  window.setTimeout = (work, wait = 0) => own(work, wait + 150);
}"""


def kept(page: Watched) -> dict[str, Any]:
    """What the browser keeps of this tab."""
    text = page.page.evaluate(
        "localStorage.getItem('phyfilter-session ' + sessionStorage.getItem('phyfilter-tab'))"
    )
    return json.loads(text)["data"] if text else {}


def opened(watched: Watched, address: str) -> Watched:
    watched.page.goto(address)
    watched.ready()
    return watched


def work(page: Watched) -> None:
    """A family, a limit, an assumption, a pinned design and a step more."""
    page("family").select_option("bessel")
    page.until(lambda: "Bessel" in page.text("status"))
    page("limit-error").click()
    page.fill("unit", "N")
    page("pin").click()
    page("pin-0-name").fill("before")
    page("pin-0-name").press("Tab")
    page.fill("cutoff", "40")
    page.settled()


def shown(page: Watched) -> tuple[Any, ...]:
    """What of the work can be seen."""
    return (
        page.poles(),
        page("limit-error-handle").count(),
        page("unit").input_value(),
        page("pin-0-name").input_value(),
        page("family").input_value(),
    )


def test_a_reload_loses_nothing_and_two_tabs_do_not_disturb_each_other(
    browser: Any, served: Served, tmp_path: Path
) -> None:
    with watching(browser) as page:
        work(opened(page, served.address))
        before = shown(page)
        assert before[1:] == (1, "N", "before", "bessel")
        other = Watched(page.page.context.new_page())
        opened(other, served.address)
        assert other.poles() == [-20.0, -20.0]
        other.fill("pole-0-re", "-7")
        other.settled()
        for each in (page, other):
            each.page.reload()
            each.ready()
        assert shown(page) == before
        assert sorted(p.real for p in other.poles()) == [-20.0, -7.0]
        # The pinned design has its figures again, and undo goes back behind the reload.
        page.until(lambda: "…" not in page.text("compare"))
        page("undo").click()
        page.until(lambda: page.poles() != before[0])
        page("redo").click()
        page.until(lambda: page.poles() == before[0])
        # What a tab leaves behind can be opened in another.
        other.page.close()
        page("kept-others").click()
        page.until(lambda: page("kept-0").count() == 1)
        page("kept-0").click()
        page.until(lambda: sorted(p.real for p in page.poles()) == [-20.0, -7.0])
        assert page.complaints == []


def test_a_server_killed_in_a_drag_and_started_again_loses_nothing(browser: Any, tmp_path: Path) -> None:
    port = str(free_port())
    with watching(browser) as page:
        with serving(tmp_path, "--port", port) as first:
            work(opened(page, first.address))
            page.drop("flight.csv", recording())
            page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
            x, y = page.centre("pole-0")
            page.page.mouse.move(x, y)
            page.page.mouse.down()
            page.page.mouse.move(x - 20.0, y - 10.0, steps=3)
            first.process.kill()
            first.process.wait()
            page.page.mouse.move(x - 40.0, y - 20.0, steps=3)
            page.page.mouse.up()
        page.until(lambda: page("away").is_visible())
        assert "kept in this browser, not in Python" in page.text("away-text")
        page.fill("slope", "3")
        dragged = shown(page)
        # Saved without the server.
        with page.page.expect_download() as waiting:
            page("save-session").click()
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        saved = json.loads(path.read_text())
        assert saved["design"]["assume"]["slope"] == 3.0
        assert saved["recording"]["name"] == "flight.csv"
        page.until(lambda: kept(page) == saved)
        with serving(tmp_path, "--port", port) as second:
            page.until(lambda: "another address" in page.text("away-text"))
            page.fill("address", second.address)
            page.until(lambda: not page("away").is_visible())
            page.settled()
            assert shown(page) == dragged
            assert page.number("bandwidth") == pytest.approx(bandwidth(page.poles()), rel=SHOWN)
            page.until(lambda: "6000" in page.text("log"))  # it was given again
            page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
            # The session in a tab of its own, from the file.
            other = opened(Watched(page.page.context.new_page()), second.address)
            other("open-file").set_input_files(str(path))
            other.until(lambda: "Opened session.json" in other.text("status"))
            assert "drop that here" in other.text("status")
            assert shown(other) == dragged
            for text, words in (
                ('{"format": "phyfilter-session", "version": 9}', "newer designer"),
                ("{", "JSON"),
            ):
                path.write_text(text)
                other("open-file").set_input_files(str(path))
                other.until(lambda words=words: words in other.text("status"))
                assert shown(other) == dragged
            other.idle()
            second.process.kill()
            second.process.wait()
            other.until(lambda: not other("away").is_visible())
            other.fill("slope", "4")
            other.until(lambda: other("away").is_visible())
            page.fill("slope", "5")
            page.until(lambda: page("away").is_visible())
        # Opened in this browser, the new address is told to the tabs that look for it.
        with serving(tmp_path, "--port", port) as third:
            opened(Watched(page.page.context.new_page()), third.address)
            for each, slope in ((page, 5.0), (other, 4.0)):
                each.until(lambda each=each: not each("away").is_visible())
                each.settled()
                each.until(lambda each=each, slope=slope: kept(each)["design"]["assume"]["slope"] == slope)
        left = [text for text in page.complaints if not any(words in text for words in GONE)]
        assert left == []


def test_esc_takes_back_what_is_being_done(browser: Any, served: Served) -> None:
    with watching(browser) as page:
        opened(page, served.address)
        mouse, keys = page.page.mouse, page.page.keyboard
        start = page.poles()

        # A drag: the readout shows the pole as it is now; Esc puts it back, though the button is still down.
        x, y = page.centre("pole-0")
        mouse.move(x, y)
        mouse.down()
        assert "ωₙ 20 rad/s" in page.text("plane-readout")
        mouse.move(x - 60.0, y, steps=4)
        page.until(lambda: page.poles() != start)

        def told() -> float:
            return float(page.text("plane-readout").split("ωₙ ")[1].split(" rad/s")[0])

        page.until(lambda: told() == pytest.approx(max(map(abs, page.poles())), rel=SHOWN))
        assert told() > 21.0
        keys.press("Escape")
        page.until(lambda: page.poles() == start)
        mouse.move(x - 90.0, y, steps=2)
        mouse.up()
        assert page.poles() == start
        assert page("undo").is_disabled()

        # A slider that is pulled.
        box = page("cutoff-slider").bounding_box()
        cutoff = page("cutoff").input_value()
        mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"])
        mouse.down()
        mouse.move(box["x"] + 0.8 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
        page.until(lambda: page("cutoff").input_value() != cutoff)
        keys.press("Escape")
        page.until(lambda: page("cutoff").input_value() == cutoff)
        mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"], steps=2)
        page.page.evaluate(LATE)
        mouse.up()
        page.frame()
        assert page("cutoff").input_value() == cutoff
        assert page("undo").is_disabled()
        # Two pulls, however quick, are two steps. A figure above that wraps pushes the slider down by a line: until the
        # answer to Esc is there, and perhaps between the pulls, so they keep to its lower edge.
        page.until(lambda: page("cutoff-slider").bounding_box() == box)
        low = box["y"] + 0.85 * box["height"]
        for share in (0.6, 0.7):
            mouse.move(box["x"] + share * box["width"], low)
            mouse.down()
            mouse.move(box["x"] + (share + 0.05) * box["width"], low)
            mouse.up()
        page("undo").click()
        page.until(lambda: page("cutoff").input_value() != cutoff)
        page("undo").click()
        page.until(lambda: page("cutoff").input_value() == cutoff)
        assert page("undo").is_disabled()

        # A value that is typed, and one that was refused.
        for text, confirm in (("-33", False), ("35", True)):
            page("pole-0-re").fill(text)
            if confirm:
                page("pole-0-re").press("Enter")
                page.until(lambda: page("pole-0-re").get_attribute("aria-invalid") == "true")
            page("pole-0-re").press("Escape")
            assert page("pole-0-re").input_value() == "-20"
            assert page("pole-0-re").get_attribute("aria-invalid") != "true"
            page("pole-0-re").press("Tab")
        assert page.poles() == start

        # What was unfolded.
        page("python").click()
        page.until(lambda: page("python-text").is_visible())
        keys.press("Escape")
        assert not page("python-text").is_visible()
        page("kept-others").click()
        assert page("kept-sessions").is_visible()
        keys.press("Escape")
        assert not page("kept-sessions").is_visible()
        assert page.complaints == []
