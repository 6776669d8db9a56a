"""Views of the loop in the designer, in a real browser."""

from __future__ import annotations

import os
import re

import pytest
from designer_hosts import CHROMIUM, Watched

import phyfilter_ctl as pf

pytestmark = [
    pytest.mark.skipif(
        CHROMIUM is None, reason="there is no chromium: the designer is not tried in a browser"
    ),
    pytest.mark.skipif(os.name != "posix", reason="the server is stopped by POSIX signals"),
]


def test_the_loop_is_seen_in_every_view_with_its_band_and_its_locus(page: Watched) -> None:
    # Tabs by keyboard; the view of the filter comes first.
    assert page("loop-note").is_hidden()
    page("frequency-filter").focus()
    page.page.keyboard.press("ArrowRight")
    assert page("frequency-loop").get_attribute("aria-selected") == "true"
    page.until(lambda: "sampled loop" in page.text("loop-note"))
    drawn = {"loop": page.drawn("bode-magnitude")}

    # A band over what is not known for sure, on a grid and said so.
    page.fill("ratio_spread", "30")
    page.fill("delay_spread", "2")
    page.until(lambda: "10 loops on a grid" in page.text("loop-note"))
    page.frame()
    assert page.drawn("bode-magnitude") != drawn["loop"]

    for view in ("nyquist", "nichols"):
        page.page.keyboard.press("Tab")  # the tab list is one stop
        page(f"frequency-{view}").click()
        page.until(page("loop-plane").is_visible)
        assert not page("bode-phase").is_visible()
        page.frame()
        drawn[view] = page.drawn("loop-plane")
        page("loop-plane").locator("svg.pf-overlay").focus()
        page.page.keyboard.press("ArrowRight")
        page.until(lambda: re.search(r"ω [\d.]+ rad/s +L ", page.text("readout")) is not None)
        page.picture(f"views-{view}")
    assert drawn["nyquist"] != drawn["nichols"]

    # Time: the loop after a step of the command, of the residual, and after one wrong sample.
    for view, word in (
        ("command", "step of the command"),
        ("disturbance", "residual leaves"),
        ("noise", "Standard deviation of the command"),
    ):
        page(f"time-{view}").click()
        page.until(lambda word=word: word in page.text("time-note"))
        page.until(lambda: page.drawn("step") not in drawn.values())
        drawn[view] = page.drawn("step")
        page.picture(f"views-{view}")

    # Where the loop's poles go, and where it is lost: as the margins have it.
    page("locus").select_option("ratio")
    page.until(lambda: "crossed at" in page.text("locus-note"))
    limit = float(re.search(r"crossed at ([\d.]+)", page.text("locus-note"))[1])  # type: ignore[index]
    sampled = pf.PhyFilter.from_poles([-20.0, -20.0]).sampled(0.002, "exact")
    assert limit == pytest.approx(pf.margins(sampled, pf.Loop(actuator=0.02)).max_ratio, rel=2e-3)
    assert page("locus-paths").locator("rect").count() >= 2
    page("locus").select_option("bandwidth")
    page.until(lambda: "Bandwidth times" in page.text("locus-note"))

    # Poles that are not where they are wanted are counted in words.
    page("region").click()
    page.fill("region-settling", "100")
    page.until(lambda: "2 of 2 poles outside" in page.text("region"))
    page.fill("region-settling", "250")
    page.until(lambda: "all poles inside" in page.text("region"))
    page.picture("views-locus")
    page.fill("region-settling", "")
    page.until(lambda: "poles inside" not in page.text("region"))

    # A lag that the loop does not bear is said, in words.
    page.fill("ratio", "40")
    page.settled()
    page("frequency-loop").click()
    page.until(lambda: "Unstable" in page.text("loop-note"))
