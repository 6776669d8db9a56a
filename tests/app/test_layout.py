"""Where the designer's panels are: moved a step, hidden, kept and restored, run by node."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from phyfilter_ctl.app.modules import WEB

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

PANELS = {"a": "left", "b": "left", "s": "middle", "v": "middle", "f": "right", "log": "below"}
NOTHING: Any = object()


def layouts(*steps: list[Any], kept: Any = NOTHING) -> list[dict[str, Any]]:
    assert NODE is not None
    question = {"panels": PANELS, "steps": steps} | ({} if kept is NOTHING else {"kept": kept})
    command = [NODE, str(Path(__file__).with_name("layout.mjs")), str(WEB)]
    done = subprocess.run(
        command, input=json.dumps(question), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_panel_moves_a_step_at_a_time_past_hidden_ones_and_over_the_edges():
    found = layouts(
        ["moved", "b", "up"],  # b, a
        ["moved", "b", "up"],  # the top: stays
        ["moved", "a", "right"],  # to the place it had in the column before
        ["withShown", "v", False],
        ["moved", "s", "down"],  # past a
        ["moved", "s", "down"],  # nothing shown is left below it there: into the row below
        ["moved", "s", "down"],  # past the recording
        ["moved", "s", "up"],
        ["moved", "s", "up"],  # over the edge, to the end of the middle column
        ["moved", "log", "right"],
    )
    slots = [each["slots"] for each in found]
    assert slots[1]["left"] == slots[2]["left"] == ["b", "a"]
    assert slots[3] == {"left": ["b"], "middle": ["s", "a", "v"], "right": ["f"], "below": ["log"]}
    assert found[4]["hidden"] == ["v"]
    assert slots[5]["middle"] == ["a", "s", "v"]
    assert slots[6] == {"left": ["b"], "middle": ["a", "v"], "right": ["f"], "below": ["s", "log"]}
    assert slots[7] == slots[6] | {"below": ["log", "s"]}
    assert slots[8] == slots[6]
    assert slots[9] == {"left": ["b"], "middle": ["a", "v", "s"], "right": ["f"], "below": ["log"]}
    assert slots[10] == {"left": ["b"], "middle": ["a", "v", "s"], "right": ["log", "f"], "below": []}


@pytest.mark.slow
def test_every_panel_is_in_one_place_whatever_was_kept():
    usual = layouts()[0]
    for kept in (None, 3, "x", {}, {"slots": 4}, {"slots": []}, {"slots": None}):
        assert layouts(kept=kept)[0] == usual, kept
    found = layouts(
        kept={
            "slots": {"left": ["f", "gone", "f", 7], "below": ["f", "a"], "middle": "s", "elsewhere": ["b"]},
            "hidden": ["a", "gone", None],
            "share": 1e9,
        }
    )[0]
    assert found["slots"] == {"left": ["f", "b"], "middle": ["s", "v"], "right": [], "below": ["a", "log"]}
    assert found["hidden"] == ["a"]
    assert found["share"] == 70
    assert layouts(kept=found)[0] == found


def test_the_row_below_keeps_to_its_limits():
    shares = [each["share"] for each in layouts(["withShare", -5], ["withShare", 41.4], ["withShare", 99])]
    assert shares == [38, 15, 41, 70]
