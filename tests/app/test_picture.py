"""Charts as files: the SVG has the curves as lines and all that names them, the CSV their numbers; run by node."""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from phyfilter_ctl.app.modules import WEB

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

WIDTH, HEIGHT = 600.0, 300.0
SVG = "{http://www.w3.org/2000/svg}"
OMEGA = [1.0, 10.0, 100.0]
PEN: dict[str, Any] = {"at": None, "width": 2, "dash": []}
BODE = {
    "title": "Magnitude",
    "x": {"name": "ω", "unit": "rad/s", "log": True, "range": [1.0, 100.0]},
    "y": {"name": "magnitude", "unit": "dB", "log": False, "range": [-40.0, 0.0]},
    "parameter": None,
    "series": [
        {"name": 'F of "a<b", x', "x": OMEGA, "y": [0.0, -3.0, -40.0], "colour": "#112233"} | PEN,
        {"name": "F sampled", "x": OMEGA[:2], "y": [0.0, None], "colour": "#445566"} | PEN | {"dash": [5, 4]},
    ],
    "bands": [{"x": OMEGA, "low": [-1.0, -4.0, -40.0], "high": [0.0, -2.0, -38.0], "colour": "#778899"}],
    "marks": [{"x": 50.0, "text": "Nyquist"}],
}
NYQUIST = BODE | {
    "x": {"name": "Re L", "unit": "", "log": False, "range": [-2.0, 2.0]},
    "y": {"name": "Im L", "unit": "", "log": False, "range": [-1.0, 1.0]},
    "parameter": {"name": "ω", "unit": "rad/s"},
    "series": [
        {"name": "L", "x": [-1.0, 0.5], "y": [0.25, 0.125], "colour": "#112233"} | PEN | {"at": [3.0, 4.0]}
    ],
    "bands": [],
    "marks": [],
}


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    assert NODE is not None
    command = [NODE, str(Path(__file__).with_name("picture.mjs")), str(WEB)]
    data = json.dumps([BODE, NYQUIST])
    done = subprocess.run(command, input=data, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_picture_is_drawn_in_lines_with_title_axes_units_and_legend(made):
    root = ET.fromstring(made["pictures"][0]["svg"])
    assert not list(root.iter(f"{SVG}image"))  # no bitmap
    words = [element.text for element in root.iter(f"{SVG}text")]
    for word in ("Magnitude", "ω [rad/s]", "magnitude [dB]", 'F of "a<b", x', "F sampled", "Nyquist", "100"):
        assert word in words, word
    curve = next(p for p in root.iter(f"{SVG}path") if p.get("stroke") == "#112233")
    points = [tuple(map(float, point.split())) for point in re.findall(r"[ML]([^ML]+)", str(curve.get("d")))]
    frame = next(root.iter(f"{SVG}clipPath"))[0]
    left, top = float(str(frame.get("x"))), float(str(frame.get("y")))
    for (x, y), omega, level in zip(points, OMEGA, [0.0, -3.0, -40.0], strict=True):
        assert x == pytest.approx(
            left + WIDTH * math.log10(omega) / 2.0, abs=0.006
        )  # two decimals of a pixel
        assert y == pytest.approx(top - HEIGHT * level / 40.0, abs=0.006)
    dashed = [p for p in root.iter(f"{SVG}path") if p.get("stroke") == "#445566"]
    assert {p.get("stroke-dasharray") for p in dashed} == {"5 4"}  # in the plot and in the legend
    band = next(p for p in root.iter(f"{SVG}path") if p.get("fill") == "#778899")
    assert len(re.findall(r"[ML]", str(band.get("d")))) == 6


def test_the_table_has_units_in_its_head_and_every_number(made):
    rows = list(csv.reader(io.StringIO(made["pictures"][0]["csv"])))
    assert rows[0] == [
        "ω [rad/s]", 'F of "a<b", x [dB]', "ω [rad/s]", "F sampled [dB]", "ω [rad/s]", "band 1, least [dB]",
        "band 1, largest [dB]",
    ]  # fmt: skip
    assert rows[1] == ["1", "0", "1", "0", "1", "-1", "0"]
    assert rows[2] == ["10", "-3", "10", "", "10", "-4", "-2"]
    assert rows[3] == ["100", "-40", "", "", "100", "-40", "-38"]
    plane = list(csv.reader(io.StringIO(made["pictures"][1]["csv"])))
    assert plane == [["ω [rad/s]", "L, Re L", "L, Im L"], ["3", "-1", "0.25"], ["4", "0.5", "0.125"]]


def test_forty_kept_designs_look_different_and_neighbours_in_both_ways(made):
    styles = [(style["colour"], tuple(style["dash"])) for style in made["styles"]]
    assert len(set(styles)) == 40
    for (colour, dash), (next_colour, next_dash) in itertools.pairwise(styles):
        assert colour != next_colour
        assert dash != next_dash
