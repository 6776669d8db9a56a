"""Compiled runs: integration against closed forms, sampled blocks against a loop by hand, failures, threads."""

import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise

import casadi as ca
import control as ct
import numpy as np
import pytest
from flat_models import STRICT, by_hand, integrator, law, model, oscillator, symbols, two_rates
from hypothesis import given, settings
from hypothesis import strategies as st

import phyfilter_ctl as pf
from phyfilter_ctl import PhyFilter
from phyfilter_ctl.blocks.sampled import FilterLaw, sampled_block
from phyfilter_ctl.codegen import compile_model
from phyfilter_ctl.diagram.model import Task

pytestmark = pytest.mark.slow  # the default suite has other tests of the same code

# A few hundred steps of some ten operations each on numbers of size 10, in another order of summation.
ROUNDING = 1e-12
# Rounding of states and inputs to float, some hundred steps.
FLOAT = 1e-4


@pytest.fixture(scope="module")
def swing():
    return compile_model(oscillator(), flags=STRICT)


@pytest.fixture(scope="module")
def ramp():
    return compile_model(integrator(), flags=STRICT)


@pytest.fixture(scope="module")
def rates():
    return compile_model(two_rates(), flags=STRICT)


# -- integration ----------------------------------------------------------------------------------------------------


def test_rk4_is_of_fourth_order(swing):
    steps = np.array([0.05, 0.025, 0.0125])
    errors = [abs(swing.simulate([0.0, 5.0], max_step=h).outputs[-1, 0] - np.cos(10.0)) for h in steps]
    orders = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert np.all(np.abs(orders - 4.0) < 0.15)  # next order: h


def test_rk4_makes_equal_steps_from_stop_to_stop(swing):
    """0.25 in steps of at most 0.1 is three of 0.25 / 3, whose matrix is known."""
    h = 0.25 / 3
    A = np.array([[0.0, 1.0], [-4.0, 0.0]]) * h
    step = np.eye(2) + A + A @ A / 2 + A @ A @ A / 6 + A @ A @ A @ A / 24
    expected = np.linalg.matrix_power(step, 3) @ [1.0, 0.0]
    np.testing.assert_allclose(swing.simulate([0.0, 0.25], max_step=0.1).states[-1], expected, atol=1e-15)
    # Rounding does not make a step more of it.
    np.testing.assert_allclose(
        swing.simulate([0.0, 0.25], max_step=0.25 / 3).states[-1], expected, atol=1e-15
    )


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_adaptive_keeps_its_tolerance(swing, tolerance):
    times = np.linspace(0.0, 20.0, 41)
    run = swing.simulate(times, method="adaptive", rtol=tolerance, atol=tolerance)
    error = np.abs(run.outputs[:, 0] - np.cos(2.0 * times)).max()
    # Errors of steps add up over 40 radians; a step control that is out of order leaves this range on either side.
    assert 0.05 * tolerance < error < 60.0 * tolerance


def test_adaptive_finds_its_way_through_scales():
    """x' = -1000 (x - cos t): the transient of 1 ms, then the slow motion."""
    arguments = symbols(1, 0, 0, 0)
    t, x = arguments[:2]
    stiff = compile_model(model("stiff", arguments, -1000.0 * (x - ca.cos(t)), x + 0, starts=(0.0,)))
    times = np.array([0.0, 1e-4, 1e-3, 1e-2, 1.0])
    run = stiff.simulate(times, method="adaptive", rtol=1e-9, atol=1e-9)
    k = 1000.0
    exact = (k**2 * np.cos(times) + k * np.sin(times) - k**2 * np.exp(-k * times)) / (k**2 + 1)
    np.testing.assert_allclose(run.outputs[:, 0], exact, atol=1e-7)


@pytest.mark.parametrize("method", ["rk4", "adaptive"])
def test_any_end_time(swing, method):
    instance = swing.instance()
    rng = np.random.default_rng(2)
    ends = np.cumsum(np.concatenate([10.0 ** rng.uniform(-15, -0.5, 60), [0.0, 1e-300]]))
    t = 0.0
    for end in ends:
        status, reached = instance.advance(t, end, method=method, max_step=0.01)
        assert (status, reached) == (0, end)
        t = end
    assert instance.x[0] == pytest.approx(np.cos(2.0 * t), abs=1e-6)


def test_time_does_not_run_backwards(swing):
    instance = swing.instance()
    before = instance.memory.copy()
    for end in (-1.0, np.nan, np.inf):
        assert instance.advance(0.0, end) == (3, 0.0)
    np.testing.assert_array_equal(instance.memory, before)


def test_inputs_are_lines_or_held(ramp):
    times = np.array([0.0, 0.5, 1.5, 2.0])
    u = np.array([[1.0], [-1.0], [3.0], [3.0]])
    lines = ramp.simulate(times, u)
    np.testing.assert_allclose(lines.states[:, 0], [0.0, 0.0, 1.0, 2.5], atol=1e-15)
    held = ramp.simulate(times, u, interpolation="hold")
    np.testing.assert_allclose(held.states[:, 0], [0.0, 0.5, -0.5, 1.0], atol=1e-15)
    np.testing.assert_array_equal(held.outputs[:, 1], u[:, 0])
    np.testing.assert_array_equal(lines.outputs[:, 1], u[:, 0])


# -- sampled blocks -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("slow", "fast", "step"),
    [(0.003, 0.002, 0.001), (0.005, 0.002, 0.0013), (0.01, 0.002, 0.02), (0.002, 0.002, 0.003)],
)
def test_two_rates_are_the_loop_by_hand(slow, fast, step):
    flat = two_rates(slow, fast)
    rng = np.random.default_rng(5)
    times = step * np.arange(60)
    u = rng.normal(size=(60, 1))
    outputs, x, s = by_hand(flat, times, u)
    run = compile_model(flat).simulate(times, u, interpolation="hold")
    assert run.success
    np.testing.assert_allclose(run.outputs, outputs, atol=ROUNDING)
    np.testing.assert_allclose(run.states[-1], x, atol=ROUNDING)
    np.testing.assert_allclose(run.sampled_states[-1], s, atol=ROUNDING)


def test_float_stays_near(rates):
    times = 0.001 * np.arange(500)
    u = np.sin(5.0 * times)[:, None]
    single = compile_model(two_rates(), real="float", flags=STRICT).simulate(times, u)
    double = rates.simulate(times, u)
    np.testing.assert_allclose(single.outputs, double.outputs, atol=FLOAT * np.abs(double.outputs).max())
    assert single.sampled_states[-1].tolist()[1::2] == double.sampled_states[-1].tolist()[1::2]


def test_instants_coincide_after_many_of_them():
    """0.1 s and 0.3 s have no common multiple in binary; their counters must stay in step."""
    flat = two_rates(0.3, 0.1)
    times = 0.3 * np.arange(2000)
    run = compile_model(flat).simulate(times, np.zeros((2000, 1)), max_step=0.05)
    slow, fast = run.sampled_states[:, 1] - 0.5, run.sampled_states[:, 3] - 0.5
    np.testing.assert_array_equal(slow, np.arange(2000) + 1)
    np.testing.assert_array_equal(fast, 3 * np.arange(2000) + 1)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 9000), min_size=1, max_size=12), st.integers(-5000, 5000))
def test_ways_of_many_lengths_lead_to_the_same_end(rates, parts, start):
    """Communication steps of any length, from any start: instants happen when they are due, and once."""
    cuts = np.cumsum([0, *parts]) * 1e-6 + start * 1e-3
    whole, cut = rates.instance(), rates.instance()
    for instance in (whole, cut):
        assert instance.start(cuts[0]) == 0
    assert whole.advance(cuts[0], cuts[-1], max_step=1e-4)[0] == 0
    for begin, end in pairwise(cuts):
        assert cut.advance(begin, end, max_step=1e-4)[0] == 0
    np.testing.assert_array_equal(cut.sampled_states()[1::2], whole.sampled_states()[1::2])
    np.testing.assert_allclose(cut.x, whole.x, atol=1e-9)  # RK4 steps of 0.1 ms, divided otherwise


def test_state_is_a_copy_of_the_memory(rates):
    instance = rates.instance()
    instance.start(0.0)
    instance.advance(0.0, 0.0123)
    saved = instance.memory.copy()
    instance.advance(0.0123, 0.05)
    first = instance.memory.copy()
    instance.memory[:] = saved
    instance.advance(0.0123, 0.05)
    np.testing.assert_array_equal(instance.memory, first)


# -- filters --------------------------------------------------------------------------------------------------------


def filtered(sampled, channels, inertia=None):
    """x, g, f_theta and M given from outside; y = f_hat."""
    block = sampled_block(sampled, channels, inertia=inertia)
    assert block.law is not None
    n_v, n_f = len(block.law.inputs), len(block.law.outputs)
    arguments = symbols(0, n_v, 0, n_f)
    signals = ca.Function("v", arguments, [arguments[2]])
    task = Task(
        "wing",
        sampled.dt,
        block.law,
        signals,
        slice(0, n_f),
        slice(0, 0),
        FilterLaw(sampled, channels, inertia),
    )
    return model("wing", arguments, ca.SX(0, 1), arguments[4], tasks=(task,), held=block.law.outputs)


@pytest.mark.parametrize(
    ("options", "inertia"),
    [
        ({}, None),
        ({"g": "average", "f_theta": "hold"}, None),
        ({"delay": 0.0031}, "diagonal"),
        ({"limit": 0.8, "method": "tustin"}, "scalar"),
        ({"E": [[1.0], [2.0]]}, "full"),
        ({"nonfinite": "hold"}, None),
    ],
)
def test_filters_run_as_the_sampled_filter(options, inertia):
    rng = np.random.default_rng(8)
    sampled = PhyFilter([500.0, 45.0], [500.0, 10.0]).sampled(0.002, **options)
    flat = filtered(sampled, 2, inertia)
    times = 0.002 * np.arange(80)
    n_f = len(flat.outputs)
    u = rng.normal(size=(80, len(flat.inputs)))
    x, g, f_theta, M = np.split(u, [2, 4, 4 + n_f], axis=1)
    M += 3.0
    if "nonfinite" in options:
        x[20:23, 1] = np.nan
    if inertia == "full":
        M = M.reshape(-1, 2, 2)
    if inertia == "scalar":
        M = np.repeat(M, 2, axis=1)
    u = np.hstack([x, g, f_theta, M[:, :1] if inertia == "scalar" else M.reshape(80, -1)])
    state = sampled.start(x[0], f_theta0=f_theta[0], inertia0=M[0] if inertia else None, g0=g[0])
    limit = np.inf if sampled.sampling.limit is None else sampled.sampling.limit
    expected = [np.clip(f_theta[0], -limit, limit)]
    for k in range(1, 80):
        of_step = g[k] if sampled.sampling.g == "average" else g[k - 1]
        state, f_hat = sampled.step(state, x[k], of_step, f_theta[k], inertia=M[k] if inertia else None)
        expected.append(f_hat)
    run = compile_model(flat, flags=STRICT).simulate(times, u, interpolation="hold")
    assert run.message == "done"
    size = np.abs(x).max() * 500.0 if "nonfinite" not in options else 2e3
    np.testing.assert_allclose(run.outputs, expected, rtol=0, atol=2e-15 * size)


@pytest.fixture(scope="module")
def tunable():
    return compile_model(
        filtered(PhyFilter([500.0, 45.0]).sampled(0.002, limit=4.0, g_limit=(-0.8, 2.0)), 1),
        tunable=True,
        flags=STRICT,
    )


def test_coefficients_are_parameters(tunable):
    names = [variable.name for variable in tunable.model.parameters]
    limits = ["wing.limit[0]", "wing.g_low[0]", "wing.g_high[0]"]
    assert names == ["wing.a[0]", "wing.a[1]", "wing.b[0]", "wing.b[1]", *limits]
    assert [variable.unit for variable in tunable.model.parameters[:2]] == ["(rad/s)^2", "rad/s"]
    times = 0.002 * np.arange(60)
    u = np.random.default_rng(9).normal(size=(60, 3)) * [1e-3, 1.0, 1.0]
    other = PhyFilter([900.0, 60.0]).sampled(0.002, limit=4.0, g_limit=(-0.8, 0.5))
    changes = {"wing.a[0]": 900.0, "wing.a[1]": 60.0, "wing.g_high[0]": 0.5}
    run = tunable.simulate(times, u, params=changes, interpolation="hold")
    expected = other.run(u[:, :1], u[:, 1:2], u[:, 2:])
    np.testing.assert_allclose(run.outputs, expected, atol=1e-12)


def test_a_filter_that_is_not_stable_is_refused_and_the_old_one_stays(tunable):
    instance = tunable.instance()
    instance.start(0.0)
    before = instance.memory.copy()
    for bad in ({"wing.a[0]": -1.0}, {"wing.a[1]": 0.0}):
        with pytest.raises(ValueError, match="wing: D is not Hurwitz"):
            instance.set_parameters(bad)
    for bad in ({"wing.limit[0]": -1.0, "wing.a[0]": 900.0}, {"wing.g_low[0]": 2.0}):
        with pytest.raises(ValueError, match="out of range"):
            instance.set_parameters(bad)
    np.testing.assert_array_equal(instance.memory, before)


def test_a_low_pass_filter_stays_one_unless_b_is_set(tunable):
    instance = tunable.instance()
    instance.set_parameters({"wing.a[0]": 900.0, "wing.a[1]": 60.0})
    assert instance.p[:4].tolist() == [900.0, 60.0, 900.0, 0.0]
    instance.set_parameters({"wing.a[0]": 500.0, "wing.b[0]": 400.0})
    assert instance.p[:4].tolist() == [500.0, 60.0, 400.0, 0.0]
    instance.set_parameters({"wing.a[0]": 600.0})
    assert instance.p[:4].tolist() == [600.0, 60.0, 400.0, 0.0]


def test_a_bad_sample_is_a_status_and_changes_nothing():
    """nonfinite="raise" beside another task: what that one did at the instant is undone."""
    flat = filtered(PhyFilter([20.0]).sampled(0.002), 1)
    arguments = symbols(0, 3, 0, 2)
    beside = Task(
        "count", 0.002, law(3.0), ca.Function("v", arguments, [arguments[2][:2]]), slice(1, 2), slice(0, 0)
    )
    signals = ca.Function("v", arguments, [arguments[2]])
    wing = replace(flat.tasks[0], signals=signals)
    both = model("both", arguments, ca.SX(0, 1), arguments[4], tasks=(beside, wing), held=flat.held * 2)
    instance = compile_model(both, flags=STRICT).instance()
    instance.start(0.0)
    instance.u[:] = [np.nan, 1.0, 1.0]
    before = instance.memory.copy()
    assert instance.sample(0.002) == 1
    np.testing.assert_array_equal(instance.memory, before)


# -- failures and threads -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("method", "statuses"), [("rk4", {1}), ("adaptive", {1, 3})])
def test_a_run_that_diverges_says_where(method, statuses):
    """x' = x^2 from 1 is 1 / (1 - t)."""
    arguments = symbols(1, 0, 0, 0)
    x = arguments[1]
    compiled = compile_model(model("blow_up", arguments, x**2, x + 0, starts=(1.0,)))
    run = compiled.simulate(np.linspace(0.0, 2.0, 21), method=method, max_step=1e-3)
    assert not run.success
    assert run.status in statuses
    assert 0.99 < run.t_reached < 1.2
    assert f"t = {run.t_reached:.9g} s" in run.message
    np.testing.assert_allclose(run.outputs[:9, 0], 1.0 / (1.0 - 0.1 * np.arange(9)), rtol=1e-6)
    assert np.isfinite(run.outputs[: run.rows]).all()
    assert np.isnan(run.outputs[run.rows :]).all()


def test_threads_do_not_disturb_each_other(rates):
    times = 0.001 * np.arange(2000)
    rng = np.random.default_rng(4)
    records = [rng.normal(size=(2000, 1)) for _ in range(8)]
    alone = [rates.simulate(times, u).outputs for u in records]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda u: rates.simulate(times, u).outputs, records))
    np.testing.assert_array_equal(together, alone)


def test_progress_is_reported_and_the_run_can_be_stopped(swing):
    times = np.linspace(0.0, 100.0, 201)
    seen: list[int] = []
    run = swing.simulate(times, max_step=0.01, progress=seen.append)
    assert seen[-1] == run.rows == 201
    plain = swing.simulate(times, max_step=0.01)
    np.testing.assert_array_equal(run.outputs, plain.outputs)

    def stop(rows):
        raise KeyboardInterrupt

    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        swing.simulate(np.linspace(0.0, 1e4, 100_001), max_step=1e-5, progress=stop)
    assert time.perf_counter() - began < 10.0
    assert threading.active_count() < 20


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"timepts": [0.0, 0.0]}, "timepts: expected increasing"),
        ({"timepts": []}, r"expected shape \(N,\)"),
        ({"inputs": np.zeros((1, 2))}, r"inputs: expected shape \(2, 1\), got \(1, 2\)"),
        ({"initial_state": [1.0, 2.0]}, r"initial_state: expected shape \(1,\), got \(2,\)"),
        ({"sampled_state": [1.0]}, r"sampled_state: expected shape \(0,\)"),
        ({"method": "euler"}, "expected 'rk4' or 'adaptive', got 'euler'"),
        ({"interpolation": "cubic"}, "expected 'linear' or 'hold'"),
        ({"max_step": -1.0}, "max_step: expected a positive number"),
        ({"rtol": -1.0}, "rtol, atol"),
        ({"params": [1.0]}, r"params: expected shape \(0,\)"),
    ],
)
def test_bad_arguments_are_named(ramp, arguments, message):
    with pytest.raises(ValueError, match=message):
        ramp.simulate(**({"timepts": [0.0, 1.0]} | arguments))


@pytest.mark.slow
def test_a_day_of_four_rates_without_a_common_period_misses_no_instant():
    """Counters: after 24 h each has counted the instants before it, in rational numbers."""
    periods, day = [0.1 * math.sqrt(2.0), 0.1 * math.e, 0.1 * math.pi, 0.31], 86400.0
    names = [f"count{i}" for i in range(len(periods))]
    counters = [
        pf.sampled_block(
            ct.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], period, inputs=["u"], outputs=["n"]), name=name
        )
        for name, period in zip(names, periods, strict=True)
    ]
    clocks = ct.interconnect(
        counters, connections=False, inplist=[[f"{name}.u" for name in names]], inputs=["one"],
        outlist=[f"{name}.n" for name in names], outputs=names, name="clocks",
    )  # fmt: skip
    counted = pf.simulate(clocks, [0.0, 0.5 * day, day], 1.0, backend="c").outputs[:, -1]
    assert counted.tolist() == [Fraction(day) // Fraction(period) for period in periods]
