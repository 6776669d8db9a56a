"""Ten thousand messages that nobody meant: every one is answered, none takes the session with it."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from designer_messages import message_of, reply_to

from phyfilter_ctl.app import Session, handle

CHUNKS, PER_CHUNK = 4, 2500

GOOD: list[dict] = [
    {"op": "hello"},
    {"op": "design", "design": message_of([-20.0, -15 + 8j, -15 - 8j], limits={"F": {"omega": 1.0}})},
    {"op": "design", "design": message_of([-2.0], numerator={"kind": "b", "b": [1.0]})},
    {"op": "family", "family": "bessel", "order": 3, "cutoff": 20.0, "type": 2},
    {"op": "family", "family": "bandpass", "order": 2, "cutoff": 20.0, "band": [4.0, 9.0]},
    {"op": "log", "name": "a.csv", "text": "t,v,label_v\n0,1,2\n0.1,2,3\n0.2,1,3\n0.3,2,1\n"},
    {"op": "estimate", "design": message_of([-20.0]), "channel": 0},
    {"op": "learn", "order": 0, "form": "general"},
    {"op": "job", "job": 1},
    {"op": "cancel", "job": 1},
    {"op": "python", "design": message_of([-20.0, -2.0], numerator={"kind": "type", "type": 2})},
    {"op": "save", "design": message_of([-20.0]), "name": "a"},
    {"op": "open", "name": "a.toml", "text": 'format = "phyfilter"\nversion = 1\na = [20.0]\n'},
    {"op": "export", "design": message_of([-20.0]), "kind": "dll", "channels": 2},
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


def fuzzed(rng: np.random.Generator) -> object:
    """A good message with up to three entries replaced, taken out or added."""
    message: dict = copy.deepcopy(GOOD[rng.integers(len(GOOD))]) | {"id": int(rng.integers(1000))}
    for _ in range(1 + rng.integers(3)):
        paths = places(message)
        path = paths[rng.integers(len(paths))]
        value = copy.deepcopy(NASTY[rng.integers(len(NASTY))])
        if not path:
            return value
        holder: object = message
        for key in path[:-1]:
            holder = holder[key]  # type: ignore[index]  # the path leads through dicts and lists
        assert isinstance(holder, dict | list)
        what = rng.integers(4)
        if what == 0:
            del holder[path[-1]]
        elif what == 1 and isinstance(holder, dict):
            holder[str(rng.integers(100))] = value
        else:
            holder[path[-1]] = value
    return message


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_fuzzed_messages_are_answered(chunk):
    rng = np.random.default_rng(100 + chunk)
    session = Session()
    refusals = 0
    for _ in range(PER_CHUNK):
        message = fuzzed(rng)
        reply = handle(session, message)  # type: ignore[arg-type]  # that is the point
        assert set(reply) >= {"id", "op", "ok"}
        if reply["ok"]:
            json.dumps(reply, allow_nan=False).encode()
        else:
            refusals += 1
            error = reply["error"]
            assert isinstance(error, str)
            assert 0 < len(error) < 700
            assert "/tmp" not in error
            assert "computation failed" not in error, error  # every refusal was foreseen
            json.dumps(reply, allow_nan=False)
    assert 0.5 * PER_CHUNK < refusals < PER_CHUNK
    assert reply_to(session, "hello")["ok"]
    session.close()
