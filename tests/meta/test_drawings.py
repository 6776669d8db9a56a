"""The committed block diagrams are what the toolbox draws today, and each of them is shown."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DRAWN = ROOT / "docs" / "drawn"
DRAWINGS = runpy.run_path(str(ROOT / "docs" / "drawings.py"))["DRAWINGS"]


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_up_to_date(name):
    assert (DRAWN / f"{name}.svg").read_text(encoding="utf-8") == DRAWINGS[name]().svg, (
        "run python docs/drawings.py"
    )


def test_every_drawing_is_shown_and_none_is_left_over():
    pages = [
        ROOT / "README.md",
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("models/*/README.md"),
        *ROOT.glob("phyfilter_ctl/drawing/*.py"),
    ]
    shown = {
        name for page in pages for name in re.findall(r"drawn/(\w+)\.svg", page.read_text(encoding="utf-8"))
    }
    assert shown == set(DRAWINGS) == {path.stem for path in DRAWN.glob("*.svg")}
