"""Go1's shipped policies: complete, trained alike, and walking; what the page says of payloads."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from phyfilter_ctl import models

ROOM = f"{models.__name__}.quadruped"
evaluation = importlib.import_module(f"{ROOM}.evaluation")
policy = importlib.import_module(f"{ROOM}.policy")
robustness = importlib.import_module(f"{ROOM}.robustness")

SEEDS = (0, 1, 2, 3, 4)


def test_shipped_policies_are_a_whole_set():
    found = robustness.policies("go1")
    assert {family: tuple(p.record["seed"] for p in each) for family, each in found.items()} == {
        "base": SEEDS,
        "filter": SEEDS,
        "basefull": SEEDS,
    }
    for family, each in found.items():
        for one in each:
            assert one.record["steps"] == 1_536_000 * (2 if family == "basefull" else 1)
            assert (one.record["filter"] is not None) == (family == "filter")
            assert one.record["full_randomisation"] == (family == "basefull")


@pytest.mark.slow
def test_what_the_page_says_of_payloads_walks_again():
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")
    rows = [row for row in robustness.conditions("go1") if row.label in ("payload 0 %", "payload 60 %")]
    arms = {name: robustness.ARMS[name] for name in ("base", "filter", "tuned", "full")}
    judged = robustness.judge(robustness.policies("go1"), rows, arms=arms, starts=1, threads=1)
    error = {(label, arm): value["error"] for (label, arm), value in judged.values.items()}
    # m/s; with twice the room that the page's policies leave.
    assert np.all(error["payload 0 %", "base"] < 0.3), "they walk"
    assert np.all(error["payload 0 %", "filter"] < 0.4)
    assert np.all(error["payload 0 %", "full"] < 0.5), "they walk"
    assert np.median(error["payload 60 %", "full"]) < 0.2, "the rival keeps it, after twice the training"
    assert np.median(error["payload 60 %", "filter"]) > 0.2, "the paper's bound is not kept"
    assert not judged.values["payload 60 %", "filter"]["fallen"].any()
    assert np.median(error["payload 60 %", "tuned"]) < np.median(error["payload 60 %", "filter"])
