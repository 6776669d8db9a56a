"""Messages that nobody meant: every one is answered, none takes the session with it."""

from __future__ import annotations

import copy
import json

from designer_messages import message_of, reply_to
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl.app.handling import Reply, Session, handle

SESSION = {
    "format": "phyfilter-session",
    "version": 1,
    "design": message_of([-20.0]),
    "views": {"bode": {"unit": 1}},
}
# Seven poles are refused, and so is the trade: a search that is not meant takes seconds of CPU.
CORNERS: dict[str, object] = {
    "error": {"omega": 1.0, "level": 0.1},
    "estimate": {"omega": 100.0, "level": 0.1},
}
GOOD: list[dict] = [
    {"op": "hello"},
    {"op": "design", "design": message_of([-20.0, -15 + 8j, -15 - 8j], limits={"F": {"omega": 1.0}})},
    {"op": "design", "design": message_of([-2.0], numerator={"kind": "b", "b": [1.0]})},
    {"op": "family", "family": "bessel", "order": 3, "cutoff": 20.0, "type": 2},
    {"op": "family", "family": "bandpass", "order": 2, "cutoff": 20.0, "band": [4.0, 9.0]},
    {
        "op": "upload",
        "name": "a.csv",
        "size": 38,
        "at": 0,
        "data": "dCx2LGxhYmVsX3YKMCwxLDIKMC4xLDIsMwowLjIsMSwzCg==",
    },
    {"op": "preview", "time": "t", "time_unit": "ms"},
    {
        "op": "import",
        "time": "t",
        "x": ["v"],
        "label": ["label_v"],
        "inertia": [1.5],
        "unit_x": "mm/s",
        "step": 0.1,
    },
    {"op": "measured", "channel": 0},
    {"op": "estimate", "design": message_of([-20.0]), "channel": 0},
    {"op": "loop", "design": message_of([-20.0], lag_spread=0.01, ratio_spread=0.5)},
    {"op": "locus", "design": message_of([-20.0]), "over": "ratio"},
    {"op": "responses", "design": message_of([-20.0], delay_spread=0.01)},
    {"op": "learn", "order": 0, "form": "general"},
    {"op": "job", "job": 1},
    {"op": "cancel", "job": 1},
    {"op": "python", "design": message_of([-20.0, -2.0], numerator={"kind": "type", "type": 2})},
    {"op": "save", "design": message_of([-20.0]), "name": "a"},
    {"op": "open", "name": "a.toml", "text": 'format = "phyfilter"\nversion = 1\na = [20.0]\n'},
    {"op": "exports", "design": message_of([-20.0]), "channels": 3},
    {"op": "compare", "designs": [message_of([-20.0]), message_of([-3.0, -4.0], method="euler")]},
    {
        "op": "meet",
        "design": message_of([-20.0] * 7, limits=CORNERS),
        "trade": "money",
        "ratios": [0.5, 2.0],
    },
    {"op": "front", "job": 1},
    {"op": "report", "design": message_of([-20.0]), "format": "docx", "name": "a"},
    {"op": "unmeet", "job": 1},
    {"op": "export", "design": message_of([-20.0]), "kind": "dll", "channels": 2, "name": "a"},
    {"op": "session", "text": json.dumps(SESSION)},
]

DEEP: object = 0
for _ in range(100):
    DEEP = [DEEP]

NASTY: list[object] = [
    None, True, False, 0, -1, 1, 2**63, -(10**400), 1e308, -1e308, 5e-324, float("nan"), float("inf"), "", "x",
    "x" * 1000, "../../etc/passwd", "__import__('os')", "\x00", "\ud800", "{{}}", "hello", "design", [], [[]], {}, DEEP,
    [1] * 300, [[-1.0, 0.0]] * 9, [[-1.0, 1.0]], [[0.0, 0.0]], {"kind": "zeros"}, {"kind": "b", "b": [1e300]},
    {"__proto__": 1}, 1.5, -20.0, ["a", "b"], "t,v\n0,1\n0,nan\n", 'a = ["' + "[" * 200, object(), b"bytes", (1.0, 2.0),
]  # fmt: skip


def places(value: object, path: tuple = ()) -> list[tuple]:
    """Paths of everything inside."""
    found = [path]
    if isinstance(value, dict):
        for key, entry in value.items():
            found += places(entry, (*path, key))
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            found += places(entry, (*path, i))
    return found


@st.composite
def messages(draw: st.DrawFn) -> object:
    """A good message with up to three entries replaced, taken out or added."""
    message: dict = copy.deepcopy(draw(st.sampled_from(GOOD))) | {"id": draw(st.integers(0, 1000))}
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(places(message)))
        value = copy.deepcopy(draw(st.sampled_from(NASTY)))
        if not path:
            return value
        holder: object = message
        for key in path[:-1]:
            holder = holder[key]  # type: ignore[index]  # the path leads through dicts and lists
        assert isinstance(holder, dict | list)
        what = draw(st.sampled_from(["replace", "remove", "add"]))
        if what == "remove":
            del holder[path[-1]]
        elif what == "add" and isinstance(holder, dict):
            holder[str(draw(st.integers(0, 99)))] = value
        else:
            holder[path[-1]] = value
    return message


@given(st.lists(messages(), max_size=20))
def test_fuzzed_messages_are_answered(fuzzed):
    session = Session()
    try:
        for message in fuzzed:
            check(handle(session, message))  # type: ignore[arg-type]  # that is the point
        assert reply_to(session, "hello")["ok"]
    finally:
        session.close()


def check(reply: Reply) -> None:
    """An answer, or a refusal that was foreseen."""
    assert set(reply) >= {"id", "op", "ok"}
    json.dumps(reply, allow_nan=False).encode()
    if not reply["ok"]:
        error = reply["error"]
        assert isinstance(error, str)
        assert 0 < len(error) < 700
        assert "/tmp" not in error
        assert "computation failed" not in error, error
