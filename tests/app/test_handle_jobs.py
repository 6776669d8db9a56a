"""Learning in the background: what is learned, the live curve, one at a time, and a cancel that stops it."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl import PhyFilter, Recording, learn
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.jobs import LearningJob

TRUTH = PhyFilter([300.0, 25.0])
DT = 0.01
# The label is made by the filter itself: what the descent leaves.
EXACT = 1e-6
CANCELLED_WITHIN = 0.5  # s, on a busy machine
PATIENCE = 60.0  # s


def flight(n: int = 1500, *, noise: float = 0.0, channels: int = 1) -> Recording:
    rng = np.random.default_rng(8)
    x = DT * np.cumsum(rng.standard_normal((n, channels)), axis=0)
    label = TRUTH.sampled(DT).run(x) + noise * rng.standard_normal((n, channels))
    return Recording.from_arrays(x=x, dt=DT, label=label)


def ended(session: Session, job: int) -> dict:
    assert session.job is not None
    assert session.job.wait(PATIENCE)
    return answered(session, "job", job=job)


def test_a_known_filter_is_learned_back():
    session = Session(log=flight())
    answered(session, "design", design=message_of([-3.0], slope=4.0))
    job = answered(session, "learn", order=2, form="lowpass")["job"]
    reply = ended(session, job)
    assert reply["state"] == "done"
    assert "RMSE" in reply["message"]
    design = reply["design"]
    assert design["sampling"] == {"dt": DT, "method": "exact"}
    assert design["assume"]["slope"] == 4.0
    found = answered(session, "design", design=design)["filter"]
    np.testing.assert_allclose(found["a"], TRUTH.a, rtol=EXACT)


def test_message_names_the_order_once():
    session = Session(log=flight(noise=0.5))
    reply = ended(session, answered(session, "learn", order=1)["job"])
    assert reply["message"].count("order 1") == 1


@pytest.mark.slow
def test_curve_falls_and_ends_at_the_rmse():
    session = Session(log=flight(noise=0.5, channels=2))
    job = answered(session, "learn", order=2)["job"]
    reply = ended(session, job)
    steps, rmse = np.array(reply["curve"]).T
    assert 3 < len(steps) <= 402
    assert np.all(np.diff(steps) >= 0)
    assert np.all(np.diff(rmse[:-1]) < 0.0)
    expected = learn(flight(noise=0.5, channels=2), 2)
    assert rmse[-1] == pytest.approx(expected.rmse)


@pytest.mark.slow
def test_wiener_filter_stands_beside_the_estimate_once_learned():
    log = flight(noise=0.5, channels=2)
    session = Session(log=log)
    assert answered(session, "estimate", design=message_of([-20.0], dt=DT))["wiener"] is None
    ended(session, answered(session, "learn", order=1)["job"])
    for channel in (0, 1):
        reply = answered(session, "estimate", design=message_of([-20.0], dt=DT), channel=channel)
        floor = learn(log, 1, channels=[channel]).wiener
        assert floor is not None
        assert reply["wiener"] == pytest.approx(floor.rmse)
        assert reply["wiener"] < reply["rmse"]
    answered(session, "forget")
    assert session.log is None


def test_general_form_is_offered():
    session = Session(log=flight(noise=0.1))
    reply = ended(session, answered(session, "learn", order=2, form="general")["job"])
    assert reply["design"]["numerator"]["kind"] == "b"


def long_session() -> tuple[Session, int]:
    """A search that would take many seconds, once it is under way."""
    rng = np.random.default_rng(9)
    x = np.cumsum(rng.standard_normal((60_000, 3)), axis=0)
    log = Recording.from_arrays(x=DT * x, dt=DT, label=rng.standard_normal((60_000, 3)))
    session = Session(log=log)
    job = answered(session, "learn", order=8, form="general")["job"]
    until = time.perf_counter() + PATIENCE
    while not answered(session, "job", job=job)["curve"]:
        assert time.perf_counter() < until
        time.sleep(0.01)
    return session, job


def test_cancel_stops_the_search_and_frees_the_processor():
    session, job = long_session()
    assert answered(session, "job", job=job)["state"] == "running"
    assert "still learns" in refused(session, "learn", order=1)["error"]
    before = time.perf_counter()
    reply = answered(session, "cancel", job=job)
    assert time.perf_counter() - before < CANCELLED_WITHIN + 0.2
    assert session.job is not None
    assert session.job.wait(CANCELLED_WITHIN)
    assert reply["state"] in ("cancelled", "running")
    assert answered(session, "job", job=job)["state"] == "cancelled"
    assert not any(thread.name.startswith("phyfilter-learn") for thread in threading.enumerate())
    # And the next one may begin.
    again = answered(session, "learn", order=1)["job"]
    assert again == job + 1
    assert "there is no job" in refused(session, "job", job=job)["error"]
    session.close()


@pytest.mark.parametrize("how", ["forget", "close", "another log"])
def test_what_else_ends_a_job(how):
    session, _ = long_session()
    job = session.job
    assert job is not None
    if how == "forget":
        answered(session, "forget")
    elif how == "close":
        session.close()
    else:
        answered(session, "example")
    assert job.wait(CANCELLED_WITHIN + 0.5)
    assert job.snapshot()["state"] == "cancelled"


@pytest.mark.slow
def test_sessions_learn_side_by_side():
    one, other = Session(log=flight()), Session(log=flight())
    first, second = (answered(session, "learn", order=1)["job"] for session in (one, other))
    assert first == second == 1
    assert one.job is not other.job
    assert ended(one, 1)["state"] == ended(other, 1)["state"] == "done"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"order": 0}, "order"),
        ({"order": 9}, "order"),
        ({"order": "2"}, "order"),
        ({"order": 2, "form": "elliptic"}, "form"),
        ({"order": 2}, "no log is open"),
    ],
)
def test_refusals(fields, said):
    assert said in refused(Session(), "learn", **fields)["error"]


def test_a_log_without_a_label_cannot_teach():
    session = Session(log=Recording.from_arrays(x=np.zeros((10, 1)), dt=DT))
    assert "label" in refused(session, "learn", order=1)["error"]


def test_a_log_that_teaches_nothing_fails_with_the_reason():
    log = Recording.from_arrays(x=np.zeros((50, 1)), dt=DT, label=np.zeros((50, 1)))
    session = Session(log=log)
    reply = ended(session, answered(session, "learn", order=1)["job"])
    assert reply["state"] == "failed"
    assert len(reply["message"]) > 10
    assert "design" not in reply


def test_an_unforeseen_failure_is_a_state_too(monkeypatch):
    from phyfilter_ctl.app import jobs

    def broken(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    monkeypatch.setattr(jobs, "learn", broken)
    session = Session(log=flight())
    reply = ended(session, answered(session, "learn", order=1)["job"])
    assert reply["state"] == "failed"
    assert "LinAlgError" in reply["message"]


def test_a_long_log_of_unequal_steps_is_resampled(monkeypatch):
    from phyfilter_ctl.app import jobs

    monkeypatch.setattr(jobs, "_MOST_UNEQUAL", 500)
    rng = np.random.default_rng(4)
    times = np.cumsum(DT * rng.uniform(0.8, 1.2, 900))
    x = DT * np.cumsum(rng.standard_normal((900, 1)), axis=0)
    label = TRUTH.sampled(DT).run(x, times=times)
    session = Session(log=Recording.from_arrays(x=x, times=times, label=label))
    reply = ended(session, answered(session, "learn", order=2)["job"])
    assert reply["state"] == "done"
    assert "resampled" in reply["message"]


def test_a_cancel_before_the_start_is_harmless():
    job = LearningJob(1, flight(), 1, form="lowpass", like=Session().design)
    job.cancel(0.1)
    job.start()
    assert job.wait(PATIENCE)
    assert job.snapshot()["state"] == "cancelled"
