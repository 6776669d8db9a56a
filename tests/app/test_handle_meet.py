"""Filters that meet drawn limits, by message: asked for, followed, picked from, ended."""

from __future__ import annotations

import time

import numpy as np
import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.app.handling import Session

LIMITS: dict[str, object] = {
    "error": {"omega": 1.0, "level": 0.1},
    "estimate": {"omega": 100.0, "level": 0.5},
}


def ended(session: Session, job: int) -> dict:
    before = time.monotonic()
    while (reply := answered(session, "front", job=job))["state"] == "running":
        assert time.monotonic() - before < 60.0
        time.sleep(0.01)
    return reply


@pytest.mark.slow
def test_a_front_is_found_and_each_of_its_filters_keeps_the_limits():
    """One pole at w: |1 - F| <= 0.1 up to 1 rad/s and |F| <= 0.5 from 100 rad/s on leave sqrt(99) to 100/sqrt(3)."""
    session = Session()
    design = message_of([-20.0], limits=LIMITS, dt=0.001, slope=3.0, noise=0.01, lag=0.0, delay=0.0)
    reply = ended(session, answered(session, "meet", design=design)["job"])
    assert (reply["state"], reply["done"]) == ("done", 1.0)
    speeds = [-point["design"]["poles"][0][0] for point in reply["front"]]
    assert len(speeds) == 9
    assert speeds == sorted(speeds)
    assert speeds[0] == pytest.approx(np.sqrt(99.0), rel=2e-3)
    assert speeds[-1] == pytest.approx(100.0 / np.sqrt(3.0), rel=2e-3)
    for point, w in zip(reply["front"], speeds, strict=True):
        assert point["bound"] == pytest.approx(3.0 / w, rel=1e-6)  # slope over speed
        assert point["design"]["limits"] == LIMITS
        read_design(Fields({"design": point["design"]}))


def test_what_cannot_be_is_said_for_certain():
    session = Session()
    limits: dict[str, object] = {
        "error": {"omega": 20.0, "level": 0.3},
        "estimate": {"omega": 10.0, "level": 0.3},
    }
    job = answered(session, "meet", design=message_of([-20.0, -20.0], limits=limits))["job"]
    reply = ended(session, job)
    assert reply["certain"] is True
    assert reply["front"] == []
    assert "No filter of any order" in reply["message"]


@pytest.mark.slow
def test_a_search_is_ended_and_another_begun():
    session = Session()
    design = message_of([-20.0] * 5, limits=LIMITS)
    job = answered(session, "meet", design=design, form="general", delay_margin=0.01, ratios=[0.5, 2.0])[
        "job"
    ]
    assert "still runs" in refused(session, "meet", design=design)["error"]
    answered(session, "unmeet", job=job)
    assert ended(session, job)["state"] == "cancelled"
    assert answered(session, "meet", design=message_of([-20.0], limits=LIMITS))["job"] == job + 1
    session.close()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({}, "draw a limit"),
        ({"ratios": [2.0, 3.0]}, "around 1"),
        ({"delay_margin": -1.0}, "delay_margin"),
        ({"trade": "money"}, "trade"),
        ({"design": message_of([-20.0] * 7, limits=LIMITS)}, "at most 6 poles"),
        ({"design": message_of([-20.0], limits={"error": {"omega": 1.0}})}, "level: missing"),
        ({"design": message_of([-20.0], limits={"error": 3.0})}, "expected an object"),
    ],
)
def test_refusals(fields, said):
    asked = {"design": message_of([-20.0])} | fields
    assert said in refused(Session(), "meet", **asked)["error"]
    assert "no search 4" in refused(Session(), "front", job=4)["error"]
