"""A recording on its way into the designer: what the file holds, what its columns are, what it is like."""

from __future__ import annotations

import numpy as np
from designer_hosts import LONG, Watched


def tunnel(samples: int = 3000) -> str:
    """28 columns of a wind tunnel: semicolons, decimal commas, microseconds since 1970."""
    rng = np.random.default_rng(7)
    f = np.sin(0.03 * np.arange(samples))
    v = 0.01 * np.cumsum(f) + 1e-3 * rng.standard_normal(samples)
    columns = ["stamp", *(f"port_{i:02d} [Pa]" for i in range(24)), "u [mm/s]", "fx [N]", "operator"]
    lines = [";".join(columns)]
    for k in range(samples):
        cells = [f"{p:.2f}" for p in rng.standard_normal(24)] + [f"{1e3 * v[k]:.6f}", f"{f[k]:.6f}"]
        stamp = str(1_700_000_000_000_000 + 10_000 * k)
        lines.append(";".join([stamp, *(cell.replace(".", ",") for cell in cells), "mk"]))
    return "\n".join(lines) + "\n"


def test_a_wind_tunnels_table_is_looked_at_and_opened(page: Watched) -> None:
    page.drop("tunnel.csv", tunnel(), confirm=False)
    page.until(lambda: page("import").count() == 1)
    # All 28 columns are there, with their first rows as the file has them.
    assert page("import").locator("tbody tr").count() == 28
    assert page("import").locator("tbody tr").nth(1).locator("td").last.inner_text().count(",") == 1
    assert "semicolons, decimal commas" in page.text("import-notes")
    # Times: the column is asked for, and what it counts is recognised and said.
    page("import-time").select_option("stamp")
    page.until(lambda: "microseconds: 0.01 s" in page.text("import-time-said"))
    assert page("import-time-unit").input_value() == "us"
    # Nothing is opened as long as nobody says what x is; the reason is said.
    page("import-open").click()
    page.until(lambda: "columns of the measured signal" in page.text("import-problem"))
    page("import-search").fill("u [")
    page.until(lambda: page("import").locator("tbody tr:visible").count() == 1)
    page("import-role-u [mm/s]").select_option("x")
    page("import-search").fill("")
    page("import-role-fx [N]").select_option("label")
    assert page.text("import-pairs") == "x u [mm/s] with label fx [N]."
    assert not page("import-role-operator").is_enabled()
    page("import-inertia").fill("1,5 kg")
    page("import-open").click()
    page.until(lambda: "numbers for M" in page.text("import-problem"))
    page.picture("import")
    page("import-inertia").fill("1,5")
    page("import-inertia").press("Enter")
    page.until(lambda: page("import").count() == 0)
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
    assert "tunnel: 3000 samples, 10 ms" in page.text("log")
    assert "mm/s was taken as 0.001 m/s" in page.text("log-notes")


def test_an_example_is_one_click_away_and_gives_step_slope_and_noise(page: Watched) -> None:
    page("example").click()
    page.until(lambda: "Simulated flight" in page.text("log"), LONG)
    assert "not a recording" in page.text("log-notes")
    page.until(lambda: any(c.isdigit() for c in page.text("rmse")))
    before = page("noise").input_value()
    page("measured").click()
    page.until(lambda: "largest slope of the label" in page.text("log-notes"))
    assert "2800 samples, 0 s to 5.598 s" in page.text("log-notes")
    page.settled()
    assert page("noise").input_value() != before
    page("undo").click()
    page.settled()
    assert page("noise").input_value() == before


def test_escape_leaves_a_file_unopened(page: Watched) -> None:
    page.drop(
        "flight.csv", "t,vx,ax\n" + "".join(f"{0.01 * k:.2f},{k},1\n" for k in range(50)), confirm=False
    )
    page.until(lambda: page("import").count() == 1)
    assert page("import-open").evaluate("button => button === document.activeElement")
    page.page.keyboard.press("Escape")
    page.until(lambda: page("import").count() == 0)
    assert page("drop").is_visible()
