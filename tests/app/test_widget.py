"""The designer in a notebook, without a browser: what the front end would send goes in, what it would get comes out."""

from __future__ import annotations

import importlib
import json
import time

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.app.handling import Session, handle

pytest.importorskip("anywidget", reason="anywidget is not installed: the notebook's designer is not tested")
comm = importlib.import_module("comm")
base_comm = importlib.import_module("comm.base_comm")
widget = importlib.import_module("phyfilter_ctl.app.widget")

# A filter that went through JSON comes back to the bit; its coefficients are multiplied out of the poles again.
SAME = 1e-12
SOON = 20.0

DESIGN = {
    "poles": [[-3, 4], [-3, -4]],
    "numerator": {"kind": "lowpass"},
    "sampling": {"dt": 0.01, "method": "exact"},
}


class Wire(base_comm.BaseComm):
    """A comm whose far end is this test."""

    def publish_msg(self, msg_type, data=None, metadata=None, buffers=None, **keys):
        self.__dict__.setdefault("sent", []).append((msg_type, data or {}))

    def send_in_state(self, state: dict) -> None:
        """What the front end sends with ``model.save_changes``."""
        data = json.loads(json.dumps({"method": "update", "state": state, "buffer_paths": []}))
        self.handle_msg({"content": {"data": data}, "buffers": [], "header": {}, "parent_header": {}})

    def send_in(self, content: object) -> dict | None:
        """What the front end sends with ``model.send``; the reply that it gets."""
        before = len(self.__dict__["sent"])
        data = json.loads(json.dumps({"method": "custom", "content": content}))
        self.handle_msg({"content": {"data": data}, "buffers": [], "header": {}, "parent_header": {}})
        replies = [d["content"] for _, d in self.__dict__["sent"][before:] if d.get("method") == "custom"]
        assert len(replies) <= 1
        return json.loads(json.dumps(replies[0], allow_nan=False)) if replies else None


@pytest.fixture(autouse=True)
def wire(monkeypatch):
    monkeypatch.setattr(comm, "create_comm", Wire)


def test_the_front_end_gets_module_and_style():
    live = pf.designer()
    opened = live.comm.__dict__["sent"][0]
    assert opened[0] == "comm_open"
    state = opened[1]["state"]
    assert "export default" in state["_esm"]
    assert state["_css"]
    assert state["_view_module"] == "anywidget"
    # The design goes in messages; a synchronised trait would be a second truth.
    assert "design" not in state


def test_a_message_is_answered_as_on_the_page():
    live, page = pf.designer(), Session()
    for message in (
        {"id": 1, "op": "hello"},
        {"id": 2, "op": "design", "design": DESIGN},
        {"id": 3, "op": "family", "family": "butterworth", "order": 3, "cutoff": 20.0},
        {"id": 4, "op": "nothing"},
        {},
    ):
        assert live.comm.send_in(message) == json.loads(json.dumps(handle(page, message)))


def test_the_filter_is_the_one_on_the_screen():
    live = pf.designer(pf.PhyFilter.from_poles([-7.0]))
    seen = []
    live.observe(lambda change: seen.append(change["new"]), "design")
    assert live.filter == pf.PhyFilter.from_poles([-7.0])
    assert live.comm.send_in({"id": 1, "op": "hello"})["design"]["poles"] == [[-7.0, 0.0]]
    assert live.comm.send_in({"id": 2, "op": "design", "design": DESIGN})["ok"]
    np.testing.assert_allclose(live.filter.a, [25.0, 6.0], rtol=SAME)
    assert live.sampled.dt == 0.01
    assert live.design["poles"] == [[-3.0, 4.0], [-3.0, -4.0]]
    assert [design["sampling"]["dt"] for design in seen] == [0.01]
    # A design that is refused changes nothing.
    reply = live.comm.send_in({"id": 3, "op": "design", "design": {**DESIGN, "poles": [[3, 0]]}})
    assert not reply["ok"]
    np.testing.assert_allclose(live.filter.a, [25.0, 6.0], rtol=SAME)


def test_the_session_is_a_trait_that_is_saved_with_the_notebook(tmp_path):
    kept = {
        "format": "phyfilter-session",
        "version": 1,
        "design": {**DESIGN, "limits": None},
        "views": {"a": {"b": 1}},
    }
    kept["design"]["assume"] = pf.designer().design["assume"]
    live = pf.designer()
    assert live.comm.__dict__["sent"][0][1]["state"]["session"] == {}
    live.comm.send_in_state({"session": kept})
    state = json.loads(json.dumps(live.get_state()["session"]))
    assert (state["design"], state["views"]) == (kept["design"], kept["views"])
    # What is no session is kept nowhere.
    with pytest.raises(ValueError, match=r"session\.version"):
        live.session = {**kept, "version": 7}
    assert live.get_state()["session"] == state
    path = tmp_path / "wing.json"
    path.write_text(json.dumps(state))
    again = pf.designer(session=path)
    assert again.get_state()["session"] == state
    assert again.filter == pf.PhyFilter.from_poles([-3 + 4j, -3 - 4j])
    other = pf.designer()
    other.set_state({"session": state})
    assert other.get_state()["session"] == state
    with pytest.raises(TypeError, match="got both"):
        pf.designer(pf.PhyFilter.from_poles([-7.0]), session=path)


def test_a_sampled_filter_brings_its_sampling():
    live = pf.designer(pf.PhyFilter.from_poles([-7.0, -8.0]).sampled(0.004, "tustin"))
    assert live.design["sampling"] == {"dt": 0.004, "method": "tustin"}
    assert live.sampled.sampling.method == "tustin"


def log() -> pf.Recording:
    rng = np.random.default_rng(0)
    f = np.sin(0.05 * np.arange(2000))[:, None]
    x = np.cumsum(0.01 * f, axis=0) + 1e-3 * rng.standard_normal((2000, 1))
    return pf.Recording.from_arrays(x=x, dt=0.01, label=f)


@pytest.mark.parametrize("kind", ["log", "path", "text"])
def test_a_recording_comes_along(kind, tmp_path):
    path = tmp_path / "flight.csv"
    path.write_text("t,vx,vy,vz\n" + "".join(f"{0.01 * k},{k},0,1\n" for k in range(30)))
    live = pf.designer(log={"log": log(), "path": path, "text": str(path)}[kind])
    summary = live.comm.send_in({"id": 1, "op": "hello"})["log"]
    assert summary["samples"] == (2000 if kind == "log" else 30)


def test_learning_runs_beside_the_kernel_and_ends_with_the_widget():
    live = pf.designer(log=log())
    job = live.comm.send_in({"id": 1, "op": "learn", "order": 1, "form": "lowpass"})["job"]
    before = time.monotonic()
    while (reply := live.comm.send_in({"id": 2, "op": "job", "job": job}))["state"] == "running":
        assert time.monotonic() - before < SOON
        time.sleep(0.05)
    assert reply["state"] == "done", reply["message"]
    again = live.comm.send_in({"id": 3, "op": "learn", "order": 8, "form": "general"})
    assert again["ok"]
    live.close()
    assert live._session.job.wait(SOON)
    assert live._session.job.snapshot()["state"] in ("cancelled", "done")


def test_two_designers_share_nothing():
    one, other = pf.designer(), pf.designer()
    one.comm.send_in({"id": 1, "op": "design", "design": DESIGN})
    assert other.filter != one.filter


def test_what_is_not_a_message_is_answered_or_ignored():
    live = pf.designer()
    for nonsense in (None, 1, "x", [1], {"id": None}, {"id": 1, "op": ["design"]}):
        reply = live.comm.send_in(nonsense)
        assert reply is None or not reply["ok"]
    assert live.comm.send_in({"id": 1, "op": "hello"})["ok"]


def test_bad_arguments_are_refused(tmp_path):
    with pytest.raises(TypeError, match="expected a PhyFilter"):
        pf.designer([400.0, 40.0])
    with pytest.raises(ValueError, match="1 to 8 poles"):
        pf.designer(pf.PhyFilter.from_poles([-1.0] * 9))
    with pytest.raises(OSError, match="none"):
        pf.designer(log=tmp_path / "none.csv")
