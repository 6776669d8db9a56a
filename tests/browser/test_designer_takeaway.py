"""What is taken away from the designer: exports under names that tell versions apart, designs kept and compared."""

from __future__ import annotations

import re
from pathlib import Path

from designer_hosts import LONG, SHOWN, Watched


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
