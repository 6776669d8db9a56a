"""What is taken away from the designer: exports under names that tell versions apart, designs kept and compared."""

from __future__ import annotations

import csv
import io
import math
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from designer_hosts import LONG, SHOWN, Watched

import phyfilter_ctl as pf


def fetched(page: Watched, name: str, folder: Path) -> Path:
    with page.page.expect_download(timeout=LONG) as waiting:
        page(name).click()
    path = folder / waiting.value.suggested_filename
    waiting.value.save_as(path)
    return path


def test_what_a_target_refuses_is_told_and_versions_have_names_of_their_own(
    page: Watched, tmp_path: Path
) -> None:
    page("export").focus()
    page.page.keyboard.press("Enter")
    page.until(lambda: "3 channels" in page.text("export-refusals"))
    assert page("export-px4").get_attribute("aria-disabled") == "true"
    assert page("export-arduino").get_attribute("aria-disabled") == "false"
    page.picture("export-menu")
    page("channels").fill("3")
    page("channels").press("Tab")
    page.until(lambda: page.text("export-refusals") == "")
    page("export-name").fill("left wing")
    first = fetched(page, "export-px4", tmp_path)
    page.until(lambda: not page("export-menu").is_visible())
    page.fill("pole-0-re", "-21")
    page.settled()
    page("export").click()
    second = fetched(page, "export-px4", tmp_path)
    pattern = re.compile(r"left_wing-[0-9a-f]{8}-px4\.zip")
    assert pattern.fullmatch(first.name)
    assert pattern.fullmatch(second.name)
    assert first.name != second.name
    page("export").click()
    page.page.keyboard.press("Escape")
    assert not page("export-menu").is_visible()
    assert page("export").evaluate("button => button === document.activeElement")


def test_nine_designs_are_kept_apart_and_compared(page: Watched) -> None:
    for k in range(9):
        page.fill("cutoff", str(10 + 5 * k))
        page.settled()
        page("pin").click()
    styles = (
        page("pins")
        .locator(".pf-pin .pf-swatch line")
        .evaluate_all(
            "lines => lines.map(line => getComputedStyle(line).stroke + line.getAttribute('stroke-dasharray'))"
        )
    )
    assert len(set(styles)) == 9
    page("pin").click()
    assert "kept already" in page.text("status")
    assert page("plane").locator(".pf-ghosts path").count() == 18
    page.fill("pin-0-name", "slow one")
    page.fill("cutoff", "20")
    page.settled()
    page.until(lambda: "…" not in page.text("compare"))
    head, bandwidths = page.text("compare").splitlines()[0], page("compare").locator("tbody tr").first
    assert "slow one" in head
    cells = bandwidths.locator("td").all_inner_texts()
    assert [float(cell.split()[0]) for cell in cells] == [20.0, *range(10, 55, 5)]
    assert "−50 %" in cells[1]
    assert "=" in cells[3]
    assert abs(float(re.search(r"\+([\d.]+) %", cells[4])[1]) - 25.0) < 100.0 * SHOWN  # type: ignore[index]
    page.picture("kept")
    page("pin-8-unpin").click()
    assert page("pins").locator(".pf-pin").count() == 8
    page("pin-0-use").click()
    page.settled()
    assert page.number("bandwidth") == 10.0


def test_a_chart_leaves_as_svg_png_and_csv(page: Watched, tmp_path: Path) -> None:
    """Its menu by keyboard; the table has what the designer shows, the pictures what the table has."""
    page("pin").click()
    page.fill("pin-0-name", "two poles")
    page.fill("cutoff", "50")
    page.settled()
    page("bode-magnitude-take").focus()
    files = {}
    for format in ("svg", "png", "csv"):
        if not page("bode-magnitude-take-menu").is_visible():
            page.page.keyboard.press("Enter")
        page.page.keyboard.press("Tab")
        if format == "svg":
            page.picture("chart-menu")
        files[format] = fetched(page, f"bode-magnitude-{format}", tmp_path)
        assert re.fullmatch(rf"magnitude-[0-9a-f]{{8}}\.{format}", files[format].name)
        assert page("bode-magnitude-take").evaluate("button => button === document.activeElement")
    rows = list(csv.reader(io.StringIO(files["csv"].read_text(encoding="utf-8"))))
    assert rows[0][0] == "ω [rad/s]"
    assert {"F [dB]", "1 − F [dB]", "F sampled [dB]", "F of two poles [dB]"} <= set(rows[0])
    F = rows[0].index("F [dB]")
    over = max(k for k in range(F) if rows[0][k] == "ω [rad/s]")
    filter = pf.lowpass(2, 50.0)
    for row in rows[1::40]:
        assert float(row[F]) == pytest.approx(20.0 * math.log10(abs(filter(1j * float(row[over])))), abs=1e-6)
    root = ET.fromstring(files["svg"].read_text(encoding="utf-8"))
    words = {element.text for element in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"Magnitude", "magnitude [dB]", "F", "F of two poles"} <= words
    assert not list(root.iter("{http://www.w3.org/2000/svg}image"))
    data = files["png"].read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", data[16:24]) == (2 * int(root.get("width")), 2 * int(root.get("height")))  # type: ignore[arg-type]


def test_limits_are_met_by_a_filter_of_the_front(page: Watched) -> None:
    """A limit is drawn, a margin asked for, a filter picked; undo brings back the design before."""
    page("limit-error").click()
    page.fill("meet-delay_margin", "0.02")
    page("meet").click()
    page.until(lambda: "filters of order 2" in page.text("meet-message"), LONG)
    assert page("meet-progress").is_hidden()
    margins = page("meet-card").locator(".pf-front button").all_inner_texts()
    assert len(margins) > 3
    page.picture("front")
    before = page.poles()
    page("front-1").focus()
    page.page.keyboard.press("Enter")
    page.settled()
    assert page.poles() != before
    assert page("front-1").get_attribute("aria-pressed") == "true"
    assert not page("limit-error").evaluate("button => button.classList.contains('pf-violated')")
    page("undo").click()
    page.settled()
    assert page.poles() == before
