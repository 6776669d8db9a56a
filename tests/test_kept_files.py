"""Files that version 0.2 wrote, in ``tests/kept``: they open, and mean what they meant."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import phyfilter_ctl as pf
from phyfilter_ctl.app.handling import Session, handle
from phyfilter_ctl.app.sessions import load_session

KEPT = Path(__file__).parent / "kept"
SAMPLED = pf.lowpass(2, 20.0).sampled(
    0.002, channels=["vx", "vy"], inertia=[1.2, 1.3], units={"x": "m/s"}, limit=5.0
)


def test_a_live_filter_goes_on():
    live = SAMPLED.live(2)
    live.restore(KEPT / "live_0_2.json")
    np.testing.assert_allclose(live.f_hat, [0.15474377, 0.09213167], rtol=1e-7)  # digits that 0.2 printed
    f_hat = live.step(0.01, np.array([0.07, 0.02]), np.array([0.1, 0.2]), np.array([0.0, 0.1]))
    np.testing.assert_allclose(f_hat, [0.25444004, 0.08819313], rtol=1e-7)
    assert live.health.accepted == 6


def test_a_session_of_the_designer_opens():
    kept = load_session(KEPT / "session_0_2.json")
    session = Session(kept=kept)
    design = session.design
    sampled = pf.PhyFilter.from_poles([-9.0 + 4.0j, -9.0 - 4.0j, -12.0]).sampled(
        0.004, channels=["vx", "vy"], inertia=[1.2, 1.3], units={"x": "m/s", "f": "N"}
    )
    assert design.filter == sampled.filter
    assert (design.dt, design.assume.slope, design.assume.ratio) == (0.004, 2.5, 1.1)
    reply = handle(session, {"id": 1, "op": "save", "design": design.as_json()})
    assert reply["ok"], reply
    text = json.dumps(reply)
    for word in ("vx", "vy", "1.3", "m/s"):
        assert word in text


def test_a_continuous_filter_with_notes_opens_and_is_sampled_with_them():
    F = pf.lowpass(2, 20.0)
    known = {"channels": ["vx", "vy"], "inertia": [1.2, 1.3], "units": {"x": "m/s", "f": "N"}}
    assert pf.load(KEPT / "noted_0_2.toml") == F
    assert pf.load(KEPT / "noted_0_2.toml", dt=0.002) == F.sampled(0.002, **known)
