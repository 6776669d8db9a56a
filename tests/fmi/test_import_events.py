"""Imported model-exchange FMUs with events, run in diagrams: against closed forms, and against FMPy."""

import control as ct
import fmpy
import numpy as np
import pytest
from foreign_ball import ball

import phyfilter_ctl as pf
from phyfilter_ctl.fmi import Fmu, Master, cosimulate, import_fmu
from phyfilter_ctl.fmi.cosimulation_parts import make_part

G, E = 9.81, 0.7
# Parabolas are integrated exactly, and their zeros found to the rounding of time; a bounce divides by its speed.
EXACT = 1e-11


def bounced(t, start=1.0, push=0.0):
    """Height and speed of the ball in closed form."""
    g = G - push
    at, v = np.sqrt(2 * start / g), np.sqrt(2 * start * g) * E
    h = np.where(t < at, start - g * t**2 / 2, np.nan)
    rate = np.where(t < at, -g * t, np.nan)
    while at < t[-1]:
        inside = (t >= at) & (t < at + 2 * v / g)
        h[inside], rate[inside] = (v * (t - at) - g * (t - at) ** 2 / 2)[inside], (v - g * (t - at))[inside]
        at, v = at + 2 * v / g, E * v
    return h, rate


@pytest.fixture(scope="module", params=["2.0", pytest.param("3.0", marks=pytest.mark.slow)])
def path(request, tmp_path_factory):
    return ball(tmp_path_factory.mktemp("ball"), request.param)


def test_every_kind_of_event(path):
    """The FMU itself refuses times beyond an announced event and calls in the wrong mode."""
    block = import_fmu(path, name="ball")
    assert not block.dt
    times = np.linspace(0.0, 2.0, 41)
    response = pf.simulate(block, times)
    assert response.success, response.message
    h, v, ticks, noticed = response.outputs
    for found, expected in zip((h, v), bounced(times), strict=True):
        assert np.max(np.abs(found - expected)) < EXACT
    # At a time event what holds after it.
    assert ticks.tolist() == np.floor(times / 0.25).tolist()
    assert set(noticed[times > 1.0]) == {1.0}
    first = [time for time, name in response.events if name == "event"]
    assert min(abs(np.array(first) - np.sqrt(2 / G))) < EXACT
    # Every run starts anew, and from states of the user's too.
    assert np.array_equal(pf.simulate(block, times).outputs, response.outputs)
    higher = pf.simulate(block, times, initial_state=[1.5, 0.0])
    assert np.max(np.abs(higher.outputs[0] - bounced(times, 1.5)[0])) < EXACT
    softer = pf.simulate(block, times, params={"g": 5.0})
    assert softer.outputs[0, 10] == pytest.approx(1.0 - 2.5 * times[10] ** 2, abs=EXACT)


@pytest.mark.slow
def test_in_a_diagram(path):
    """A push by another block, and what follows the ball, as without the FMU."""
    block = import_fmu(path, name="ball")
    push = ct.ss([], [], [], [[2.0]], inputs="r", outputs="push", name="push")
    follower = ct.ss([[-4.0]], [[4.0]], [[1.0]], [[0.0]], inputs="h", outputs="y", name="follower")
    diagram = ct.interconnect(
        [push, block, follower],
        connections=[["ball.push", "push.push"], ["follower.h", "ball.h"]],
        inplist=["push.r"], inputs="r", outlist=["ball.h", "follower.y", "ball.ticks"],
        outputs=["h", "y", "ticks"], check_unused=False,
    )  # fmt: skip
    times = np.linspace(0.0, 2.0, 41)
    response = pf.simulate(diagram, times, 1.5)
    assert response.success, response.message
    expected = bounced(times, push=3.0)[0]
    assert np.max(np.abs(response.outputs[0] - expected)) < EXACT
    fine = np.linspace(0.0, 2.0, 40001)
    lag = ct.forced_response(follower, fine, bounced(fine, push=3.0)[0]).outputs
    # Straight lines between 50 us in the comparison: h^2 g / 8, and its kinks.
    assert np.max(np.abs(response.outputs[1] - lag[::1000])) < 1e-7
    with pytest.raises(ValueError, match=r"block ball runs as Python.*imported FMU.*cut_diagram, write_ssp"):
        pf.export_c(pf.flatten(diagram), path.parent / "c")
    with pytest.raises(ValueError, match=r"has 1 event indicators.*phyfilter_ctl\.simulate"):
        ct.input_output_response(diagram, times, 1.5)


@pytest.mark.slow
def test_the_fmu_ends_the_run(path):
    response = pf.simulate(
        import_fmu(Fmu(path, parameters={"last": 3}), name="ball"), np.linspace(0.0, 1.0, 11)
    )
    assert not response.success
    assert response.failed_at == 0.75
    assert "block ball: the FMU asked to end the run at t = 0.75 s" in response.message
    assert np.isfinite(response.outputs[:, :8]).all()
    assert np.isnan(response.outputs[:, 8:]).all()


@pytest.mark.slow
def test_as_another_importer(path):
    """FMPy's CVODE at 1e-7 finds roots to about that; each bounce adds to it.

    It evaluates beyond time events that the FMU announces, which this one refuses: there are none here.
    """
    times = np.linspace(0.0, 2.0, 41)
    found = fmpy.simulate_fmu(
        str(path), stop_time=2.0, output_interval=0.05, relative_tolerance=1e-7, output=["h", "v"],
        start_values={"push": 2.0, "tick": 100.0},
    )  # fmt: skip
    ours = pf.simulate(import_fmu(path, name="ball"), times, 2.0)
    rows = [np.flatnonzero(np.abs(found["time"] - time) < 1e-9)[-1] for time in times]
    for i, name in enumerate(("h", "v")):
        np.testing.assert_allclose(ours.outputs[i], found[name][rows], rtol=0.0, atol=1e-5, err_msg=name)


@pytest.mark.slow
def test_in_a_process_of_its_own(path):
    times = np.linspace(0.0, 1.0, 11)
    here, there = (
        pf.simulate(import_fmu(Fmu(path, isolated=isolated), name="b"), times) for isolated in (False, True)
    )
    assert np.array_equal(here.outputs, there.outputs)
    assert here.events == there.events


@pytest.mark.slow
def test_in_a_co_simulation(path):
    """On held inputs, with its events between communication points, and its end."""
    times = np.linspace(0.0, 2.0, 41)
    response = cosimulate({"ball": path}, times, inputs={"ball.push": 2.0})
    expected = pf.simulate(import_fmu(path), times, 2.0).outputs
    assert response.success
    # Integrated anew from each point to the next: parabolas all the same, but completed steps of other lengths.
    assert np.max(np.abs(np.asarray(response.outputs - expected)[:3])) < EXACT
    ended = cosimulate({"ball": path}, times, parameters={"ball.last": 3})
    assert "asked to end the run at t = 0.75 s" in ended.message
    assert np.isfinite(ended.outputs[:, :16]).all(), "with the point at which it ended"
    assert np.isnan(ended.outputs[:, 16:]).all()
    with pytest.raises(ValueError, match="ball cannot put back a state"):
        cosimulate({"ball": path}, times, master=Master(tolerance=1e-3))


@pytest.mark.slow
@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_events_are_taken_back(tmp_path, fmi):
    """The same steps after going back, to the bit, with state, time and step events in them."""
    part = make_part("ball", ball(tmp_path, fmi, state=True), {})
    part.initialise(0.0, 2.0)
    part.begin()
    for k in range(20):
        begin = part.save()
        part.put(np.array([0.1 * k]))
        part.advance(0.1 * k, 0.1, final=False)
        expected = part.get()
        part.advance(0.1 * (k + 1), 0.15, final=False)
        part.restore(begin)
        part.put(np.array([0.1 * k]))
        part.advance(0.1 * k, 0.1, final=True)
        assert np.array_equal(part.get(), expected)
        part.forget(begin)
    assert expected[2] == 8.0
    assert expected[3] == 1.0
    part.close()


@pytest.mark.slow
def test_steps_by_the_error_over_events(tmp_path):
    """Pushed harder and harder: wrong steps are taken back, and the ball bounces where it does without steps."""
    path, times = ball(tmp_path, state=True), np.linspace(0.0, 1.0, 11)
    response = cosimulate(
        {"ball": path}, times, inputs={"ball.push": lambda t: 8.0 * t}, master=Master(tolerance=1e-4)
    )
    assert response.success, response.message
    assert response.rejected > 0
    expected = pf.simulate(import_fmu(path), times, 8.0 * times).outputs
    # Of first order: the error of two halves is their difference to the whole, which each step may make anew.
    allowed = 1e-4 * (1.0 + np.max(np.abs(expected[:2]))) * response.steps
    assert np.max(np.abs(np.asarray(response.outputs - expected)[:2])) < allowed < 0.1
    assert np.array_equal(response.outputs[2], expected[2])
