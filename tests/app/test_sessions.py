"""Sessions on disk and tabs in the server: what comes back is what was saved, what is wrong is said by its field."""

from __future__ import annotations

import copy
import hashlib
import json

import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.sessions import FORMAT, VERSION, load_session, recording_beside
from phyfilter_ctl.app.tabs import LONGEST_IDLE, MOST_TABS, Tabs


def whole(message: dict[str, object]) -> dict[str, object]:
    """A design with all that it assumes."""
    return read_design(Fields({"design": message})).as_json()


DESIGN: dict = whole(
    message_of([-20.0, -15 + 8j, -15 - 8j], numerator={"kind": "type", "type": 2}, method="tustin")
)
KEPT: dict = {
    "format": FORMAT,
    "version": VERSION,
    "design": DESIGN,
    "family": "bessel",
    "pins": [{"name": "before", "design": whole(message_of([-2.0]))}],
    "recording": {"name": "flight.csv", "size": 81234, "sha256": "0f" * 32, "columns": {"x": ["vx"]}},
    "views": {"bode": {"unit": "Hz", "shown": [1, 2.5, None, True]}},
    "history": {"past": [whole(message_of([-20.0])), whole(message_of([-21.0]))], "future": []},
}
# A place in it, what stands there, and words of the sentence.
WRONG: list[tuple[tuple[str | int, ...], object, str]] = [
    (("format",), "phyfilter", "no session of the designer"),
    (("version",), VERSION + 1, "saved by a newer designer, in version 2"),
    (("version",), "1", "expected an integer"),
    (("design", "poles"), [[20.0, 0.0]], "session.design.poles[0]: expected a real part below 0"),
    (("history", "past", 1, "sampling", "dt"), -1, "session.history.past[1].design.sampling.dt"),
    (("history", "past"), [DESIGN] * 201, "at most 200 entries"),
    (("pins", 0, "name"), 7, "session.pins[0].name: expected text"),
    (("family",), "cauer", "session.family: expected one of custom"),
    (("recording", "sha256"), "../etc/passwd", "64 hexadecimal digits"),
    (("recording", "path"), "/etc/passwd", "unknown field 'path'"),
    (("views",), [1], "session.views: expected an object"),
    (("views", "bode"), [[[[[[[[[[1]]]]]]]]]], "in 8 levels"),
    (("views", "bode"), [0] * 6000, "at most 5000 entries"),
    (("view",), {}, "unknown field 'view'"),
]


def changed(path: tuple[str | int, ...], value: object) -> str:
    kept = copy.deepcopy(KEPT)
    holder = kept
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    return json.dumps(kept)


def test_a_session_comes_back_whole_and_is_what_a_server_starts_from(tmp_path):
    assert answered(Session(), "session", text=json.dumps(KEPT))["session"] == KEPT
    path = tmp_path / "wing.json"
    path.write_text(json.dumps(KEPT))
    session = Session(kept=load_session(path))
    hello = answered(session, "hello")
    assert (hello["session"], hello["design"]) == (KEPT, DESIGN)
    least = {key: KEPT[key] for key in ("format", "version", "design")}
    found = answered(session, "session", text=json.dumps(least))["session"]
    assert (found["family"], found["pins"], found["history"]) == ("custom", [], {"past": [], "future": []})


@pytest.mark.parametrize(("path", "value", "words"), WRONG, ids=[words for *_, words in WRONG])
def test_what_is_wrong_is_said(path, value, words):
    assert words in refused(Session(), "session", text=changed(path, value))["error"]


def test_what_is_no_json_is_said(tmp_path):
    path = tmp_path / "wing.json"
    for text in ("", "{", "[" * 100_000, '{"format": NaN}', "[]"):
        assert "expected" in refused(Session(), "session", text=text)["error"]
        path.write_text(text)
        with pytest.raises(ValueError, match=r"wing\.json: session"):
            load_session(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="JSON"):
        load_session(path)


def test_the_recording_of_a_session_is_found_beside_it_by_its_digest(tmp_path):
    data = b"t,vx,vy\n" + b"".join(b"%.2f,%d,%d\n" % (0.01 * k, k, -k) for k in range(30))
    (tmp_path / "flight.csv").write_bytes(data)
    reference = {"name": "../flight.csv", "size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    reference["columns"] = {"time": "t", "x": ["vy"]}
    kept = {**KEPT, "recording": reference}
    found, messages = recording_beside(kept, tmp_path)
    assert found is not None
    assert (found.x[:, 0].tolist(), messages) == ([-float(k) for k in range(30)], [])
    for changed in ({"sha256": "0" * 64}, {"size": 7}, {"name": "other.csv"}, {"columns": None}):
        assert recording_beside({**kept, "recording": {**reference, **changed}}, tmp_path) == (None, [])
    found, messages = recording_beside(
        {**kept, "recording": {**reference, "columns": {"x": ["vz"]}}}, tmp_path
    )
    assert found is None
    assert "vz" in messages[0]


def test_tabs_share_nothing_and_the_longest_idle_give_way():
    time = [0.0]
    tabs = Tabs(Session(kept=KEPT), now=lambda: time[0])
    names = [f"{i:016d}" for i in range(MOST_TABS + 1)]
    one, other = tabs.of(names[0]), tabs.of(names[1])
    answered(one, "design", design=message_of([-7.0]))
    assert other.design.as_json() == tabs.of(None).design.as_json() == DESIGN
    assert tabs.of(names[0]) is one
    for name in names[2:]:
        time[0] += 1.0
        tabs.of(name)
    assert tabs.of(names[0]) is one
    assert tabs.of(names[1]) is not other
    time[0] += LONGEST_IDLE + 1.0
    tabs.of(names[2])
    assert tabs.of(names[0]) is not one
