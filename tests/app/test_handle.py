"""The designer's messages: curves and figures against the library called directly, families, logs, estimates."""

from __future__ import annotations

import base64

import control as ct
import numpy as np
import pytest
from designer_messages import answered, message_of, refused, reply_to
from scipy import signal

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter, Recording
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.app.steps import settling_time

# The same functions on the same filter, another frequency grid: rounding.
SAME = 1e-12
# Found by a root search to 1e-15 in both, from another bracket.
FOUND = 1e-9
# Margins are read off cubic splines between 150 points a decade.
READ_OFF = 1e-5
# scipy's step response integrates by a matrix exponential of a companion form.
SCIPY = 1e-6
# A straight line of the logarithm between points of the settling search.
SETTLING = 2e-3

DESIGNS = {
    "one pole": message_of([-20.0]),
    "two equal": message_of([-20.0, -20.0]),
    "type 2": message_of([-20.0, -15 + 8j, -15 - 8j], numerator={"kind": "type", "type": 2}),
    "order 8, equal": message_of([-30.0] * 8),
    "zeros": message_of(
        [-20.0, -15 + 8j, -15 - 8j],
        numerator={"kind": "zeros", "zeros": [[-5.0, 3.0], [-5.0, -3.0]], "gain": 170.0},
    ),
    "b": message_of([-20.0, -30.0], numerator={"kind": "b", "b": [600.0, 12.0]}),
    "tustin": message_of([-20.0, -15 + 30j, -15 - 30j], method="tustin", dt=0.01),
    "euler": message_of([-20.0, -25.0], method="euler", dt=0.01),
}


def built(message: dict) -> PhyFilter:
    """The filter of a message, by another way than the designer's."""
    poles = [complex(*p) for p in message["poles"]]
    numerator = message["numerator"]
    if numerator["kind"] == "lowpass":
        return pf.PhyFilter.from_poles(poles)
    if numerator["kind"] == "type":
        return pf.place_poles(poles, type=numerator["type"])
    if numerator["kind"] == "b":
        return pf.PhyFilter.from_poles(poles, numerator["b"])
    zeros = [complex(*z) for z in numerator["zeros"]]
    b = numerator["gain"] * np.real(np.poly(zeros))[::-1]
    return pf.PhyFilter.from_poles(poles, np.pad(b, (0, len(poles) - len(b))))


def numbers(reply: dict) -> dict:
    return {entry["key"]: entry["value"] for entry in reply["numbers"]}


@pytest.fixture(params=DESIGNS, scope="module")
def case(request) -> tuple[dict, dict, PhyFilter]:
    message = DESIGNS[request.param]
    return message, answered(Session(), "design", design=message), built(message)


def test_filter(case):
    _, reply, filter = case
    answer = reply["filter"]
    np.testing.assert_allclose(answer["a"], filter.a, rtol=SAME)
    np.testing.assert_allclose(answer["b"], filter.b, rtol=SAME, atol=SAME * np.abs(filter.b).max())
    assert [complex(*p) for p in answer["poles"]] == filter.poles.tolist()
    assert answer["type"] == filter.type
    assert answer["dc_gain"] == pytest.approx(filter.dc_gain, rel=SAME)
    assert len(answer["zeros"]) == len(filter.zeros)


def test_frequency_curves(case):
    message, reply, filter = case
    curves = reply["frequency"]
    omega = np.array(curves["omega"])
    assert len(omega) <= 400
    assert np.all(np.diff(omega) > 0.0)
    sizes = np.abs(filter.poles)
    assert omega[0] < 0.1 * sizes.min()
    assert omega[-1] > 10.0 * sizes.max()
    for key, values in (("F", filter(1j * omega)), ("E", filter.error(1j * omega))):
        magnitude, phase = np.array(curves[key])
        np.testing.assert_allclose(magnitude, np.abs(values), rtol=FOUND)
        np.testing.assert_allclose(np.exp(1j * np.deg2rad(phase)), values / np.abs(values), atol=FOUND)
        assert np.all(np.abs(np.diff(phase)) < 180.0)
    nyquist = np.pi / message["sampling"]["dt"]
    below = omega <= nyquist
    assert below.any()
    assert not below.all()
    sampled = filter.sampled(message["sampling"]["dt"], message["sampling"]["method"])
    magnitude, phase = curves["S"]
    expected = pf.frequency_response(sampled, omega[below]).F
    np.testing.assert_allclose(np.array(magnitude, dtype=float)[below], np.abs(expected), rtol=FOUND)
    assert all(value is None for value, known in zip(magnitude, below, strict=True) if not known)
    assert all(value is None for value, known in zip(phase, below, strict=True) if not known)


def test_step_response(case):
    _, reply, filter = case
    t = np.array(reply["step"]["t"])
    assert len(t) <= 1500
    system = signal.TransferFunction(np.trim_zeros(filter.b[::-1], "f"), [1.0, *filter.a[::-1]])
    _, expected = signal.step(system, T=t)
    np.testing.assert_allclose(reply["step"]["F"], expected, atol=SCIPY)
    np.testing.assert_allclose(reply["step"]["E"], 1.0 - expected, atol=SCIPY)


def test_figures(case):
    message, reply, filter = case
    found = numbers(reply)
    sampled = filter.sampled(message["sampling"]["dt"], message["sampling"]["method"])
    response = pf.frequency_response(sampled)
    assert reply["stable_sampled"]
    assert found["bandwidth"] == pytest.approx(pf.frequency_response(filter).bandwidth, rel=FOUND)
    assert found["noise_gain"] == pytest.approx(response.noise_gain, rel=SAME)
    assert found["noise"] == pytest.approx(1e-3 * response.noise_gain, rel=SAME)
    assert found["settling"] == pytest.approx(settled_by_sight(filter), rel=SETTLING)
    filter.sampled(0.999 * found["euler_dt"], "euler")
    with pytest.raises(ValueError, match="diverges"):
        filter.sampled(1.001 * found["euler_dt"], "euler")


def test_bounds(case):
    message, reply, filter = case
    found = numbers(reply)
    sampled = filter.sampled(message["sampling"]["dt"], message["sampling"]["method"])
    assert found["bound"] == pytest.approx(pf.error_bound(filter, {1: 1.0}).bound, rel=SAME)
    assert found["bound_sampled"] == pytest.approx(pf.error_bound(sampled, {1: 1.0}).bound, rel=SAME)


def test_margins(case):
    message, reply, filter = case
    found = numbers(reply)
    dt = message["sampling"]["dt"]
    sampled = filter.sampled(dt, message["sampling"]["method"])
    margin = pf.margins(sampled, pf.Loop(actuator=0.02, delay=0.005))
    pairs = (("ratio_low", margin.min_ratio), ("ratio_high", margin.max_ratio))
    for key, expected in pairs:
        if np.isfinite(expected):
            assert found[key] == pytest.approx(expected, rel=READ_OFF)
        else:
            assert found[key] is None
    assert found["phase_margin"] == pytest.approx(np.rad2deg(margin.phase_margin), rel=READ_OFF)
    # Parts of a step are taken as phase.
    assert found["delay_margin"] == pytest.approx(margin.delay_margin, abs=0.5 * dt)


def settled_by_sight(filter: PhyFilter) -> float:
    """Settling from a dense step response of the transfer function."""
    end = 30.0 / float(np.min(-filter.poles.real))
    t = np.linspace(0.0, end, 20001)
    values = np.asarray(ct.step_response(filter.transfer_function, t).outputs)
    outside = np.flatnonzero(np.abs(values - filter.dc_gain) > 0.02 * abs(filter.dc_gain))
    return float(t[outside[-1] + 1])


@pytest.mark.parametrize("damping", [0.003, 0.05])
def test_settling_of_a_light_pair_and_a_fast_pole(damping):
    pair = 5.0 * complex(-damping, np.sqrt(1.0 - damping**2))
    filter = PhyFilter.from_poles([pair, pair.conjugate(), -400.0])
    # The envelope passes 2 %; the last swing beyond it may end half a period before.
    envelope = np.log(50.0) / (5.0 * damping)
    assert envelope - 0.7 < settling_time(filter) < envelope + 0.05


def test_settling_of_a_band_pass_is_of_its_peak():
    band = pf.bandpass(2, 4.0, 9.0)
    t = np.linspace(0.0, 6.0, 60001)
    values = np.abs(np.asarray(ct.step_response(band.transfer_function, t).outputs))
    expected = t[np.flatnonzero(values > 0.02 * values.max())[-1] + 1]
    assert settling_time(band) == pytest.approx(expected, rel=SETTLING)


@pytest.mark.parametrize("cutoff", [1e-3, 1e5])
def test_families_at_the_edge_are_answered(cutoff):
    design = answered(Session(), "family", family="butterworth", order=8, cutoff=cutoff)["design"]
    assert answered(Session(), "design", design=design)["filter"]["type"] == 1


def test_settling_of_next_to_nothing():
    assert settling_time(PhyFilter([1.0], [0.0])) == 0.0
    assert np.isnan(settling_time(PhyFilter([1.0], [5e-324])))


# -- corners ----------------------------------------------------------------------------------------------------


def test_forward_euler_that_diverges_is_said_and_not_fatal():
    reply = answered(Session(), "design", design=message_of([-2000.0, -20.0], method="euler"))
    assert not reply["stable_sampled"]
    assert "unstable" in reply["messages"][0]
    assert "below 1 ms" in reply["messages"][0]
    assert set(reply["frequency"]["S"][0]) == {None}
    assert numbers(reply)["noise_gain"] is None
    assert numbers(reply)["bandwidth"] > 0.0


def test_no_bound_for_a_filter_that_leaves_a_constant():
    reply = answered(Session(), "design", design=message_of([-20.0], numerator={"kind": "b", "b": [10.0]}))
    entry = next(entry for entry in reply["numbers"] if entry["key"] == "bound")
    assert entry["value"] is None
    assert "F(0) is not 1" in entry["note"]


def test_bounds_of_poles_far_apart_and_of_ringing_ones_are_certified_and_quick():
    far, ringing = [-0.01, -900.0], [-0.01 + 9j, -0.01 - 9j]
    exact = pf.error_bound(PhyFilter.from_poles(far), {1: 1.0})
    assert numbers(answered(Session(), "design", design=message_of(far)))["bound"] == pytest.approx(
        exact.bound
    )
    above = pf.error_bound(PhyFilter.from_poles(ringing), {1: 1.0}, method="ellipsoid")
    found = numbers(answered(Session(), "design", design=message_of(ringing)))
    assert found["bound"] == pytest.approx(above.bound)


def test_the_sampled_bound_says_all_it_rests_on():
    reply = answered(Session(), "design", design=message_of([-20.0] * 2))
    entry = next(entry for entry in reply["numbers"] if entry["key"] == "bound_sampled")
    sampled = PhyFilter.from_poles([-20.0] * 2).sampled(0.01)
    said = pf.error_bound(sampled, {1: 1.0}).assumptions
    assert len(said) > 4
    assert all(text in entry["note"] for text in said if "samples come" not in text)


def test_long_delay_falls_back_on_the_continuous_loop():
    reply = answered(Session(), "design", design=message_of([-20.0] * 2, dt=1e-4, delay=0.05))
    entry = next(entry for entry in reply["numbers"] if entry["key"] == "ratio_high")
    margin = pf.margins(PhyFilter.from_poles([-20.0] * 2), pf.Loop(actuator=0.02, delay=0.0501))
    assert entry["value"] == pytest.approx(margin.max_ratio, rel=SAME)
    assert "continuous" in entry["note"]


def test_assumed_ratio_that_is_unstable_has_no_margin_and_says_so():
    reply = answered(Session(), "design", design=message_of([-20.0] * 3, ratio=50.0))
    entry = next(entry for entry in reply["numbers"] if entry["key"] == "phase_margin")
    assert entry["value"] == 0.0
    assert "unstable at M_hat/M = 50" in entry["note"]


def test_drawn_limits_widen_the_grid_and_come_back():
    session = Session()
    limits = {"F": [{"omega": 5e4, "value": 0.01}], "shown": True}
    reply = answered(session, "design", design=message_of([-20.0], dt=0.05, limits=limits))
    assert reply["frequency"]["omega"][-1] > 5e4
    assert session.design.as_json()["limits"] == limits


def test_a_filter_that_passes_nothing():
    message = message_of([-20.0, -5.0], numerator={"kind": "b", "b": [0.0, 0.0]})
    reply = answered(Session(), "design", design=message)
    assert set(reply["step"]["F"]) == {0.0}


def test_one_blas_thread_while_it_computes_and_as_many_as_before_after():
    from threadpoolctl import threadpool_info, threadpool_limits

    def counts() -> dict[str, int]:
        return {e["filepath"]: e["num_threads"] for e in threadpool_info() if e["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        before = counts()  # a library built for one thread, as solvers bring theirs, stays at 1
        answered(Session(), "design", design=message_of([-20.0]))
        after = counts()
    assert 2 in before.values()
    assert before.items() <= after.items()


# -- hello, families --------------------------------------------------------------------------------------------


def test_hello():
    reply = answered(Session(PhyFilter.from_poles([-7.0]).sampled(0.01, "tustin")), "hello")
    assert reply["version"] == pf.__version__
    assert reply["design"]["poles"] == [[-7.0, 0.0]]
    assert reply["design"]["sampling"] == {"dt": 0.01, "method": "tustin"}
    assert reply["log"] is None
    assert set(reply["can"]) == {"fmu", "c", "why"}
    for family in reply["families"]:
        fields = {"family": family, "order": 2, "cutoff": 20.0, "band": [4.0, 9.0]}
        if family != "bandpass":
            fields["band"] = None
        answered(Session(), "family", **fields)


@pytest.mark.parametrize("family", ["binomial", "butterworth", "bessel", "itae"])
@pytest.mark.parametrize("kind", [1, 2])
def test_family(family, kind):
    reply = answered(Session(), "family", family=family, order=3, cutoff=20.0, type=kind)
    expected = pf.lowpass(3, 20.0, family=family, type=kind)
    assert [complex(*p) for p in reply["design"]["poles"]] == expected.poles.tolist()
    found = answered(Session(), "design", design=reply["design"])
    np.testing.assert_array_equal(found["filter"]["b"], expected.b)
    assert abs(expected(20j)) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize("order", range(1, 9))
def test_damped_family_has_its_damping_and_cutoff(order):
    reply = answered(Session(), "family", family="damped", order=order, cutoff=30.0, damping=0.4)
    poles = np.array([complex(*p) for p in reply["design"]["poles"]])
    pairs = poles[poles.imag != 0.0]
    assert len(poles) == order
    np.testing.assert_allclose(-pairs.real / np.abs(pairs), 0.4, rtol=FOUND)
    assert abs(PhyFilter.from_poles(poles)(30j)) == pytest.approx(np.sqrt(0.5), rel=FOUND)


@pytest.mark.parametrize(("family", "prototype"), [("bandpass", "butterworth"), ("bessel", "bessel")])
def test_band(family, prototype):
    session = Session()
    reply = answered(session, "family", family=family, order=4, band=[4.0, 9.0])
    assert reply["design"]["numerator"] == {
        "kind": "zeros",
        "zeros": [[0.0, 0.0]] * 2,
        "gain": pytest.approx(pf.bandpass(4, 4.0, 9.0, family=prototype).b[2]),
    }
    found = answered(session, "design", design=reply["design"])
    entry = next(entry for entry in found["numbers"] if entry["key"] == "bandwidth")
    assert entry["value"] == pytest.approx(5.0, rel=FOUND)
    assert entry["note"] == "from 4 to 9 rad/s"


def test_family_keeps_sampling_and_assumptions():
    session = Session()
    answered(session, "design", design=message_of([-3.0], dt=0.01, method="tustin", slope=4.0))
    design = answered(session, "family", family="bessel", order=2, cutoff=9.0)["design"]
    assert design["sampling"] == {"dt": 0.01, "method": "tustin"}
    assert design["assume"]["slope"] == 4.0


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"family": "cauer", "order": 2, "cutoff": 1.0}, "family"),
        ({"family": "bessel", "order": 1000, "cutoff": 1.0}, "order"),
        ({"family": "bessel", "order": 2}, "cutoff"),
        ({"family": "bessel", "order": 2, "cutoff": -1.0}, "cutoff"),
        ({"family": "bessel", "order": 2, "cutoff": 1.0, "type": 3}, "type"),
        ({"family": "bandpass", "order": 2}, "band"),
        ({"family": "damped", "order": 2, "cutoff": 1.0, "damping": 0.0}, "damping"),
        ({"family": "damped", "order": 2, "band": [1.0, 2.0]}, "family"),
        ({"family": "bessel", "order": 2, "cutoff": 1.0, "cutof": 2.0}, "message"),
    ],
)
def test_family_refusals_name_the_field(fields, where):
    assert refused(Session(), "family", **fields)["where"] == where


def test_families_that_do_not_fit_say_why():
    assert "even order" in refused(Session(), "family", family="bandpass", order=3, band=[1.0, 2.0])["error"]
    # Eight equal poles lie at three times their cutoff, beyond what is shown.
    reply = refused(Session(), "family", family="binomial", order=8, cutoff=1e5)
    assert "poles: expected" in reply["error"]


# -- logs and estimates -----------------------------------------------------------------------------------------


def csv_of(log: Recording, tmp_path) -> str:
    path = tmp_path / "log.csv"
    log.to_csv(path)
    return path.read_text()


def flight(n: int = 400, *, dt: float = 0.002, inertia: float | None = None) -> Recording:
    rng = np.random.default_rng(5)
    x = dt * np.cumsum(rng.standard_normal((n, 2)), axis=0)
    g, f_theta, label = rng.standard_normal((3, n, 2))
    return Recording.from_arrays(
        x=x, dt=dt, g=g, f_theta=f_theta, label=label, inertia=inertia, channels=["px", "py"]
    )


def test_a_recording_is_shown_and_forgotten():
    session = Session(log=flight())
    reply = answered(session, "hello")["log"]
    assert (reply["samples"], reply["channels"]) == (400, ["px", "py"])
    assert reply["dt"] == pytest.approx(0.002)
    assert reply["has_label"]
    assert reply["has_f_theta"]
    assert answered(session, "forget")["log"] is None
    assert "no log" in refused(session, "estimate", design=DESIGNS["one pole"])["error"]


@pytest.mark.parametrize("inertia", [None, 1.5])
@pytest.mark.parametrize("channel", [0, 1])
def test_estimate_is_that_of_the_library(inertia, channel):
    log = flight(inertia=inertia)
    session = Session(log=log)
    reply = answered(session, "estimate", design=DESIGNS["type 2"], channel=channel)
    f_hat = built(DESIGNS["type 2"]).sampled(0.002).run(log.x, log.g, log.f_theta, log.inertia)[:, channel]
    np.testing.assert_allclose(reply["f_hat"], f_hat, atol=FOUND * np.abs(f_hat).max())
    np.testing.assert_allclose(reply["t"], log.times)
    assert log.label is not None
    assert log.f_theta is not None
    label, f_theta = log.label[:, channel], log.f_theta[:, channel]
    np.testing.assert_array_equal(reply["label"], label)
    np.testing.assert_array_equal(reply["f_theta"], f_theta)
    assert reply["rmse"] == pytest.approx(np.sqrt(np.mean((label - f_hat)[1:] ** 2)))
    assert reply["rmse_model"] == pytest.approx(np.sqrt(np.mean((label - f_theta)[1:] ** 2)))
    assert reply["wiener"] is None
    assert reply["messages"] == []


def test_estimate_runs_at_the_step_of_the_log_and_says_so():
    log = flight(dt=0.01)
    session = Session(log=log)
    reply = answered(session, "estimate", design=DESIGNS["one pole"])
    f_hat = PhyFilter([20.0]).sampled(0.01).run(log.x, log.g, log.f_theta)[:, 0]
    np.testing.assert_allclose(reply["f_hat"], f_hat, atol=FOUND)
    assert "0.01 s" in reply["messages"][0]


def test_estimate_takes_unequal_steps(tmp_path):
    rng = np.random.default_rng(6)
    times = np.cumsum(0.002 * rng.uniform(0.5, 1.5, 300))
    log = Recording.from_arrays(x=np.cumsum(rng.standard_normal((300, 1)), axis=0), times=times)
    session = Session(log=log)
    reply = answered(session, "estimate", design=DESIGNS["one pole"])
    f_hat = PhyFilter([20.0]).sampled(log.dt).run(log.x, times=times)[:, 0]
    np.testing.assert_allclose(reply["f_hat"], f_hat, rtol=FOUND)
    assert (reply["label"], reply["f_theta"], reply["rmse"]) == (None, None, None)


def test_long_estimate_is_thinned_without_losing_a_peak():
    n = 50_000
    label = np.sin(np.arange(n) / 3000.0)
    label[31_234], label[77] = 9.0, -8.0
    log = Recording.from_arrays(x=np.zeros((n, 1)), dt=0.001, label=label[:, None])
    reply = answered(Session(log=log), "estimate", design=DESIGNS["one pole"])
    assert 500 < len(reply["t"]) <= 1500
    assert len(reply["label"]) == len(reply["f_hat"]) == len(reply["t"])
    assert max(reply["label"]) == 9.0
    assert min(reply["label"]) == -8.0
    assert reply["t"][reply["label"].index(9.0)] == pytest.approx(31.234)
    assert reply["rmse"] == pytest.approx(np.sqrt(np.mean(label[1:] ** 2)))


def test_a_window_of_a_long_estimate_is_drawn_in_full():
    n, dt = 50_000, 0.001
    label = np.sin(np.arange(n) / 300.0)[:, None]
    session = Session(log=Recording.from_arrays(x=np.zeros((n, 1)), dt=dt, label=label))
    whole = answered(session, "estimate", design=DESIGNS["one pole"])
    part = answered(session, "estimate", design=DESIGNS["one pole"], window=[20.0005, 20.5005])
    np.testing.assert_allclose(part["t"], dt * np.arange(20_000, 20_502))
    np.testing.assert_array_equal(part["label"], label[20_000:20_502, 0])
    assert part["rmse"] == whole["rmse"]
    assert len(answered(session, "estimate", design=DESIGNS["one pole"], window=[1e6, 2e6])["t"]) == 2
    assert len(answered(session, "estimate", design=DESIGNS["one pole"], window=[-9.0, -8.0])["t"]) == 2
    for wrong in ([2.0, 1.0], [1.0], "all", [None, 1.0]):
        reply = refused(session, "estimate", design=DESIGNS["one pole"], window=wrong)
        assert reply["where"].startswith("window")


def test_a_refused_recording_leaves_the_old_one():
    session = Session(log=flight())
    text = base64.b64encode(b"t,v\n0,1\n0.1,two\n").decode()
    answered(session, "upload", name="b.csv", size=16, at=0, data=text)
    assert "line 3" in refused(session, "import", time="t", time_unit="s", x=["v"])["error"]
    assert session.log is not None
    assert session.log.channels == ("px", "py")


def test_sessions_share_nothing():
    one, other = Session(), Session()
    answered(one, "design", design=message_of([-3.0]))
    answered(one, "example")
    assert other.filter.order == 2
    assert other.log is None
    assert one.filter.order == 1
    assert answered(other, "hello")["log"] is None


def test_a_refused_design_leaves_the_current_one():
    session = Session()
    answered(session, "design", design=message_of([-3.0]))
    refused(session, "design", design=message_of([3.0]))
    assert session.filter.a.tolist() == [3.0]


def test_reply_without_a_readable_id_or_op():
    assert reply_to(Session(), "nothing")["op"] is None


def test_lines_break_where_the_clock_jumps():
    """A point without a value lies in the gap, for every curve; what is said names the jump."""
    log = flight(2000)
    times = log.times.copy()
    times[1200:] += 3600.0
    times[300:] += 0.5
    session = Session(log=Recording.from_arrays(x=log.x, times=times, label=log.label))
    reply = answered(session, "estimate", design=DESIGNS["one pole"])
    found = [k for k, value in enumerate(reply["f_hat"]) if value is None]
    assert [k for k, value in enumerate(reply["label"]) if value is None] == found
    inside = [reply["t"][k] for k in found]
    assert [times[299] < inside[0] < times[300], times[1199] < inside[1] < times[1200], len(found)] == [
        True,
        True,
        2,
    ]
    assert any("jumps ahead by 3600" in message for message in reply["messages"])
