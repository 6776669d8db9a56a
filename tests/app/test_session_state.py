"""What the designer keeps of a session: all of it comes back, and what is no session changes nothing; run by node."""

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

GESTURES: list[list[Any]] = [["add", "pair"], ["add", "zero"], ["toggleLimit", "error"], ["setGain", 0.5]]
DESIGN = {
    "poles": [[-20, 0]],
    "numerator": {"kind": "lowpass"},
    "sampling": {"dt": 0.002, "method": "matched"},
}
GOOD = {"format": "phyfilter-session", "version": 1, "design": DESIGN, "family": "binomial"}
# A session that is wrong, and a word of the sentence.
WRONG: list[tuple[object, str]] = [
    (None, "no session"),
    ({}, "no session"),
    ({**GOOD, "version": 2}, "format 2, and this designer reads up to 1"),
    ({**GOOD, "version": "x"}, "update it"),
    ({**GOOD, "design": {**DESIGN, "poles": "x"}}, "no design"),
    ({**GOOD, "design": {**DESIGN, "poles": [[None, 0]]}}, "no design"),
    ({**GOOD, "design": {**DESIGN, "sampling": None}}, "no design"),
]


def test_all_of_a_session_comes_back_and_nothing_else_is_taken():
    assert NODE is not None
    command = [NODE, str(Path(__file__).with_name("session.mjs")), str(WEB)]
    given = json.dumps({"gestures": GESTURES, "kept": [kept for kept, _ in WRONG]})
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["said"], found["again"]) == ("", found["text"])
    kept = json.loads(found["text"])
    assert len(kept["history"]["past"]) == len(GESTURES)
    assert found["undone"] == kept["history"]["past"][-1]
    assert kept["pins"][0] == {"name": "before", "design": kept["design"]}
    assert found["view"] == {"scale": "linear"}
    assert kept["views"]["later"] == {"shown": True}  # of a part that this version does not have
    assert kept["recording"]["sha256"] == "00"
    # A step of the history is one line for who reads the file.
    assert found["text"].count("\n") < 35 + len(GESTURES)
    for said, (_, words) in zip(found["refused"], WRONG, strict=True):
        assert words in said
    assert found["untouched"]["poles"] == [[-20, 0], [-20, 0]]
