"""A recording too long to be run over for every look: peaks by levels, parts with what is before, the whole later."""

from __future__ import annotations

import time

import numpy as np
import pytest
from designer_messages import answered, message_of

from phyfilter_ctl import Recording
from phyfilter_ctl.app import views
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.views import Peaks

N, DT = 6000, 0.002
# What the filter's start leaves after forty of its slowest time constants.
FADED = 1e-9
PATIENCE = 30.0  # s


def flight(*, inertia: bool = False) -> Recording:
    rng = np.random.default_rng(1)
    label = np.sin(0.01 * np.arange(N))[:, None] + 0.1 * rng.standard_normal((N, 1))
    x = DT * np.cumsum(label, axis=0)
    mass = 1.0 + 0.1 * np.sin(0.001 * np.arange(N))[:, None]
    return Recording.from_arrays(
        x=x, dt=DT, label=label, g=0.1 * label, f_theta=0.5 * label, inertia=mass if inertia else None
    )


def test_no_peak_is_lost_on_any_level():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(400_003)
    peaks = Peaks.of(values)
    assert len(peaks.levels) >= 2
    for first, last in ((0, len(values)), (17, 399_990), (100_000, 260_001), (5000, 5400)):
        kept = peaks.drawn(first, last, 500)
        assert len(kept) <= 500
        assert first <= kept[0]
        assert kept[-1] < last
        assert np.all(np.diff(kept) > 0)
        inner = values[first + 5000 : last - 5000] if last - first > 20_000 else values[first:last]
        assert values[kept].max() >= inner.max()
        assert values[kept].min() <= inner.min()


@pytest.mark.parametrize("inertia", [False, True])
def test_a_part_of_a_long_log_is_as_of_the_whole(monkeypatch, inertia):
    log, design = flight(inertia=inertia), message_of([-20.0, -30.0])
    whole = answered(Session(log=log), "estimate", design=design, window=[8.0, 8.4])
    monkeypatch.setattr(views, "_AT_ONCE", 1000)
    part = answered(Session(log=log), "estimate", design=design, window=[8.0, 8.4])
    assert not part["pending"]
    np.testing.assert_allclose(part["t"], whole["t"])
    np.testing.assert_allclose(part["f_hat"], whole["f_hat"], atol=FADED)
    # The errors say what they are over.
    assert "over the whole log, 5\u202f999 samples" in whole["over"]
    assert "over the part drawn, 201 samples after 7.998 s, up to 8.4 s" in part["over"]
    rows = slice(4000, 4201)
    assert log.label is not None
    error = log.label[rows, 0] - np.array(part["f_hat"])[1:]
    assert part["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)))


def test_the_whole_of_a_long_log_follows(monkeypatch):
    log, design = flight(), message_of([-20.0])
    expected = answered(Session(log=log), "estimate", design=design)
    monkeypatch.setattr(views, "_AT_ONCE", 1000)
    session = Session(log=log)
    first = answered(session, "estimate", design=design)
    assert first["pending"]
    assert first["f_hat"] is None
    assert first["rmse"] is None
    assert max(first["label"]) == max(expected["label"])
    until = time.monotonic() + PATIENCE
    while (found := answered(session, "estimate", design=design))["pending"]:
        assert time.monotonic() < until
        time.sleep(0.01)
    assert found["rmse"] == pytest.approx(expected["rmse"], rel=FADED)
    assert max(found["f_hat"]) == pytest.approx(max(expected["f_hat"]), rel=FADED)
    assert "the whole log" in found["over"]
    # A part of it is not run again, and has the errors of the whole.
    assert answered(session, "estimate", design=design, window=[1.0, 1.2])["rmse"] == found["rmse"]
    # Another design is another estimate.
    assert answered(session, "estimate", design=message_of([-25.0]))["pending"]
