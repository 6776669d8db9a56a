"""The designer's state as gestures leave it, run by node without a page."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from phyfilter_ctl.app.modules import WEB

NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")

SAME = 1e-12


def each(*stories: Sequence[list[Any]]) -> list[dict[str, Any]]:
    """The states after stories of gestures, each from two poles at -20."""
    assert NODE is not None
    command = [NODE, str(Path(__file__).with_name("design.mjs")), str(WEB)]
    done = subprocess.run(
        command, input=json.dumps(stories), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def after(*gestures: list[Any]) -> dict[str, Any]:
    """The state after gestures, from two poles at -20."""
    return each(gestures)[0]


def pole(at: int) -> dict[str, Any]:
    return {"root": "pole", "at": at}


def test_a_step_is_undone_and_done_again():
    once = after(["add", "pole"], ["add", "pair"])
    assert len(once["data"]["poles"]) == 5
    assert len(after(["add", "pole"], ["add", "pair"], ["undo"])["data"]["poles"]) == 3
    back = after(["add", "pole"], ["add", "pair"], ["undo"], ["undo"], ["undo"], ["redo"], ["redo"])
    assert back["data"] == once["data"]
    assert [len(json.loads(text)["poles"]) for text in once["committed"]] == [3, 5]


def test_every_gesture_is_a_step_and_a_burst_of_keys_is_one():
    def pulls(*name: str) -> list[list[Any]]:
        return [
            ["begin"],
            ["setCutoff", 30.0],
            ["commit", *name],
            ["begin"],
            ["setCutoff", 40.0],
            ["commit", *name],
        ]

    clicks, burst, both, one = each(
        [["add", "pole"], ["add", "pole"], ["setGain", 0.5], ["setGain", 0.6]],
        [*pulls("speed"), ["undo"]],
        [*pulls(), ["undo"]],
        pulls()[:3],
    )
    assert len(clicks["committed"]) == 4
    assert burst["data"]["poles"] == [[-20, 0], [-20, 0]]
    assert both["data"] == one["data"] != burst["data"]


def test_a_gesture_that_is_given_up_leaves_nothing():
    start = [["add", "zero"], ["setGain", 0.5]]
    moved = ["change", "pole", [{"id": 9, "re": -1, "im": 5}]]
    gestures = [["setCutoff", 55.0], ["freeZeros"], moved]
    given_up = [[*start, ["begin"], gesture, ["cancel"], ["commit"], ["cancel"]] for gesture in gestures]
    # Undo in a gesture gives it up too.
    undone = [*start, ["begin"], ["setCutoff", 55.0], ["undo"]]
    zero, first, *states, last = each(start[:1], start, *given_up, undone)
    for state in states:
        assert (state["data"], state["committed"]) == (first["data"], first["committed"])
    assert last["data"] == zero["data"]


def test_a_pole_is_not_added_on_a_zero_and_one_that_is_put_there_is_said():
    state = after(["add", "zero"], ["add", "pole"], ["add", "pair"])
    (zero,), poles = state["data"]["numerator"]["zeros"], state["data"]["poles"]
    assert min(abs(complex(*p) - complex(*zero)) for p in poles) > 0.05 * abs(complex(*zero))
    assert state["warned"] == []
    state = after(["add", "zero"], ["type", "pole", pole(0), "re", zero[0]], ["add", "pole"])
    assert len(state["warned"]) == 1
    assert "cancel: move one of them" in state["warned"][0]


def test_what_is_undone_is_forgotten_by_another_step():
    state = after(["add", "pole"], ["undo"], ["setGain", 0.5], ["redo"])
    assert len(state["data"]["poles"]) == 2
    assert state["data"]["numerator"]["kind"] == "zeros"


def test_a_design_that_was_handed_out_stays_as_it_was():
    """Of a type 3 design, kept as a pinned one is, a pole is deleted: only the current one becomes type 2."""
    state = after(["add", "pole"], ["setNumerator", "type", 3], ["data"], ["changeOrder", 2])
    assert state["data"]["numerator"] == {"kind": "type", "type": 2}
    assert state["returned"][2]["numerator"] == {"kind": "type", "type": 3}


def test_f_stays_strictly_proper():
    state = after(["add", "zero"], ["add", "zero"])
    assert len(state["data"]["numerator"]["zeros"]) == 1
    assert "at most 1 zero: add a pole first" in state["warned"][0]
    assert after(["add", "zero"], ["changeOrder", 1])["data"]["numerator"]["zeros"] == []


def test_the_gain_of_f_is_kept_where_roots_come_and_go():
    state = after(["setGain", 0.5], ["add", "pole"], ["add", "zero"], ["setCutoff", 7.0])
    poles, numerator = state["data"]["poles"], state["data"]["numerator"]
    dc = numerator["gain"]
    for re, _ in numerator["zeros"]:
        dc *= -re
    for re, _ in poles:
        dc /= -re
    assert dc == pytest.approx(0.5, rel=SAME)


@pytest.mark.parametrize(
    ("what", "value", "wrong"),
    [
        ("re", 3.0, "below 0"),
        ("re", -1e9, "rad/s, got"),
        ("wn", -1.0, "natural frequency above 0"),
        ("zeta", 0.5, "a real root has the damping ratio 1"),
        ("re", None, "expected a number"),
    ],
)
def test_a_typed_root_that_cannot_be_is_refused(what, value, wrong):
    state = after(["type", "pole", pole(0), what, value])
    assert wrong in state["returned"][0]
    assert state["data"]["poles"] == [[-20, 0], [-20, 0]]
    assert state["committed"] == []


def test_a_pair_typed_overdamped_splits():
    state = after(["type", "pole", pole(0), "im", 5.0], ["type", "pole", pole(0), "zeta", 1.25])
    assert state["returned"] == ["", ""]
    size = (20.0**2 + 5.0**2) ** 0.5
    assert [re for re, _ in state["data"]["poles"]] == pytest.approx([-0.5 * size, -2.0 * size], rel=SAME)
    assert state["family"] == "custom"


def test_a_filter_keeps_a_pole_and_has_at_most_eight():
    assert after(["changeOrder", 1], ["changeOrder", 0])["warned"] == ["A filter has at least one pole."]
    state = after(*[["add", "pair"]] * 4)
    assert len(state["data"]["poles"]) == 8
    assert "The highest order is 8" in state["warned"][0]
