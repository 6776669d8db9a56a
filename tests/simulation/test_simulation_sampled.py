"""Sampled blocks in continuous diagrams: schedules against fractions, runs against loops written by hand."""

from fractions import Fraction
from itertools import pairwise

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.simulation import simulate
from phyfilter_ctl.simulation.schedule import nodes, steps_between

# The same numbers in another order of operations, over a few hundred steps.
ROUNDING = 1e-12
MS = Fraction(1, 1000)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(1, 12), min_size=0, max_size=3),
    st.lists(st.integers(0, 90), min_size=2, max_size=30, unique=True),
    st.sampled_from([0.0, 3.0, 1e5]),
    st.integers(1, 40),
)
def test_schedule_is_that_of_exact_fractions(periods, ticks, start, window):
    """Whatever the windows, every instant and time stands once, and coinciding ones are one."""
    ticks = sorted(ticks)
    times = start + np.array([float(k * MS) for k in ticks])
    expected: dict[Fraction, tuple[set, int]] = {k * MS: (set(), row) for row, k in enumerate(ticks)}
    for task, period in enumerate(periods):
        for k in range(ticks[0], ticks[-1] + 1, period):
            due, row = expected.get(k * MS, (set(), -1))
            expected[k * MS] = (due | {task}, row)
    found = list(nodes(times, [float(p * MS) for p in periods], window=window))
    at = np.concatenate([part.times[:-1] for part in found])
    np.testing.assert_allclose(at - start, [float(t) for t in sorted(expected)], atol=1e-10)
    assert [set(np.flatnonzero(due)) for part in found for due in part.due] == [
        expected[t][0] for t in sorted(expected)
    ]
    rows = np.concatenate([part.row for part in found])
    assert rows.tolist() == [expected[t][1] for t in sorted(expected)]
    left = np.concatenate([part.left for part in found])
    assert left.tolist() == [max(i for i, k in enumerate(ticks) if k * MS <= t) for t in sorted(expected)]
    for before, after in pairwise(found):
        assert before.times[-1] == after.times[0]
    assert found[-1].times[-1] == times[-1]


def test_coincidence_survives_the_rounding_of_large_times():
    """At 1e6 s the last digit of t is 60 times the 1e-9 of a period within which instants coincide."""
    parts = list(nodes(1e6 + np.array([0.0, 20.0]), [0.002, 0.006], window=1000))
    due = np.vstack([part.due for part in parts])
    assert due[:, 0].all()
    assert np.flatnonzero(due[:, 1]).tolist() == list(range(0, 10_001, 3))


@pytest.mark.parametrize("size", [3, 1000])
def test_steps_are_equal_and_short_enough(size):
    window = next(nodes(np.array([0.0, 1.0, 1.5, 1.6]), []))
    pieces = list(steps_between(window, 0.3, size))
    begin, end, node, first = (
        np.concatenate([getattr(p, k) for p in pieces]) for k in ("times", "ends", "node", "first")
    )
    assert node.tolist() == [0, 0, 0, 0, 1, 1, 2, 3]
    assert first.tolist() == [True, False, False, False, True, False, True, True]
    np.testing.assert_allclose(end - begin, [0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.1, 0.0], atol=1e-15)
    np.testing.assert_array_equal(end[:-1], begin[1:])
    assert [p.times.size for p in pieces] == ([3, 3, 2] if size == 3 else [8])


def plant(pull):
    return ct.nlsys(
        lambda t, x, u, p: [x[1], u[0] + u[1] - 0.4 * x[1] - pull(x[0])], lambda t, x, u, p: [x[0], x[1]],
        inputs=["tau", "d"], outputs=["s", "v"], states=2, name="plant",
    )  # fmt: skip


def three_rates(pull=np.sin):
    """Attitude-like loop: an estimator every 2 ms, a controller every 3 ms, a reference generator every 5 ms."""
    slow = ct.ss([[0.9]], [[0.1]], [[1.0]], [[0.0]], 0.005, inputs="r", outputs="goal", name="slow")
    fast = ct.tf([0.4, 0.0], [1.0, -0.6], 0.002, inputs="s", outputs="s_hat", name="fast")
    steer = ct.ss([[0.5]], [[1.0, -1.0]], [[2.0]], [[6.0, -6.0]], 0.003, inputs=["goal", "s_hat"], outputs="tau",
                  name="steer")  # fmt: skip
    blocks = [sampled_block(block, name=block.name) for block in (slow, steer, fast)]
    return ct.interconnect(
        [plant(pull), *blocks], inputs=["r", "d"], outputs=["s", "v", "tau", "s_hat"], name="loop"
    )


def by_hand(times, r, d, substeps, pull=np.sin):
    """The same loop as plain Python: rates 5, 3 and 2 ms, outputs first, RK4 in between; times on a grid of 0.5 ms."""
    x, goal_state, steer_state, fast_state = np.zeros(2), 0.0, 0.0, 0.0
    # Of the tf 0.4 z / (z - 0.6): y_k = 0.6 y_{k-1} + 0.4 s_k.
    goal = tau = s_hat = 0.0
    rows = []

    def inputs(t):
        return np.interp(t, times, r), np.interp(t, times, d)

    def slope(t, x):
        return np.array([x[1], tau + inputs(t)[1] - 0.4 * x[1] - pull(x[0])])

    grid = np.round(times / 0.0005).astype(int)
    for k in range(grid[-1] + 1):
        t = k * 0.0005
        due_slow, due_steer, due_fast = k % 10 == 0, k % 6 == 0, k % 4 == 0
        if due_slow:
            goal = goal_state
        if due_fast:
            s_hat = 0.6 * fast_state + 0.4 * x[0]
        if due_steer:
            tau = 2.0 * steer_state + 6.0 * (goal - s_hat)
        if due_slow:
            goal_state = 0.9 * goal_state + 0.1 * inputs(t)[0]
        if due_steer:
            steer_state = 0.5 * steer_state + goal - s_hat
        if due_fast:
            fast_state = s_hat
        if k in grid:
            rows.append([*x, tau, s_hat])
        h = 0.0005 / substeps
        for i in range(substeps):
            now = t + i * h
            k1 = slope(now, x)
            k2 = slope(now + h / 2, x + h / 2 * k1)
            k3 = slope(now + h / 2, x + h / 2 * k2)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(now + h, x + h * k3))
    return np.array(rows).T


# Times on and off the instants; the first and last are instants of all blocks.
OFFSETS = np.unique(np.concatenate([[0.0, 0.6], 0.0005 * np.random.default_rng(0).integers(1, 1200, 80)]))


@pytest.mark.parametrize("backend", ["vm", "c"])
def test_three_rates_against_a_loop_by_hand(backend):
    """To rounding: both take RK4 steps of 0.125 ms, which the instants and times never cut."""
    rng = np.random.default_rng(1)
    r, d = rng.standard_normal((2, len(OFFSETS)))
    theirs = by_hand(OFFSETS, r, d, 4)
    ours = simulate(three_rates(), OFFSETS, [r, d], method="rk4", backend=backend, max_step=0.000125)
    assert ours.backend == backend
    # Steps are equal between stops, which lie 0.5 to 1.5 ms apart: the same 0.125 ms up to rounding.
    np.testing.assert_allclose(ours.outputs, theirs, atol=ROUNDING)


@pytest.mark.parametrize(("method", "pull"), [("exact", lambda angle: 0.9 * angle), ("adaptive", np.sin)])
def test_three_rates_by_other_methods(method, pull):
    r, d = np.random.default_rng(1).standard_normal((2, len(OFFSETS)))
    theirs = by_hand(OFFSETS, r, d, 4, pull)
    ours = simulate(
        three_rates(pull), OFFSETS, [r, d], method=method, rtol=1e-10, atol=1e-12, max_step=0.0005
    )
    np.testing.assert_allclose(ours.outputs, theirs, atol=1e-9)


def test_order_at_an_instant():
    """Two sampled blocks in a row at one rate: the second sees what the first puts out at that instant."""
    first = sampled_block(
        ct.ss([], [], [], [[2.0]], 0.1, inputs="u", outputs="a", name="first"), name="first"
    )
    second = sampled_block(
        ct.ss([], [], [], [[3.0]], 0.1, inputs="a", outputs="y", name="second"), name="second"
    )
    system = ct.interconnect([second, first], inputs="u", outputs="y", name="row")
    times = np.arange(11) * 0.05
    response = simulate(system, times, times)
    held = times[2 * (np.arange(11) // 2)]
    np.testing.assert_allclose(response.outputs, 6.0 * held, rtol=1e-14)


@pytest.mark.parametrize("rate", [("hold", "average"), ("average", "hold")])
def test_filter_in_a_loop_is_the_filter_on_the_record(rate):
    """What the filter puts out in the run is what SampledPhyFilter.run gives on the run's own signals."""
    g, f_theta = rate
    sampled = PhyFilter.from_poles([-20.0, -30.0]).sampled(0.01, g=g, f_theta=f_theta)
    mass = ct.nlsys(lambda t, x, u, p: [u[0] + u[1] - 0.1 * x[0] ** 2], None, inputs=["g", "d"], outputs="v",
                    states="v", name="mass")  # fmt: skip
    block = sampled_block(sampled, 1, name="filter")
    system = ct.interconnect(
        [mass, block], connections=[["filter.x[0]", "mass.v"]],
        inplist=[["mass.g", "filter.g[0]"], "mass.d", "filter.f_theta[0]"], inputs=["g", "d", "f_theta"],
        outlist=["mass.v", "filter.f_hat[0]"], outputs=["v", "f_hat"], name="observed",
    )  # fmt: skip
    times = 0.01 * np.arange(200)
    u = np.random.default_rng(2).standard_normal((3, 200))
    response = simulate(system, times, u, 0.5)
    alone = sampled.run(response.outputs[0][:, None], u[0][:, None], u[2][:, None])
    np.testing.assert_allclose(response.outputs[1], alone[:, 0], atol=ROUNDING)
    between = simulate(system, np.sort([*times, *(times[:-1] + 0.003)]), 0.0, 0.5)
    np.testing.assert_array_equal(between.outputs[1, 1::2], between.outputs[1, :-1:2])


def test_python_control_names_the_way():
    with pytest.raises(TypeError, match="simulate"):
        ct.input_output_response(three_rates(), [0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]])


def test_times_closer_than_an_instant_can_tell_are_refused():
    with pytest.raises(ValueError, match="timepts: two times are"):
        simulate(three_rates(), [0.0, 1e-13, 1.0], 0.0)


def test_run_is_the_same_in_any_windows():
    """A long run crosses windows of the schedule; one that records seldom, too."""
    flat = flatten(three_rates())
    times = 0.0005 * np.arange(20_001)
    dense = simulate(flat, times, [1.0, 0.2], method="rk4", max_step=1.0, backend="vm")
    sparse = simulate(flat, times[::4000], [1.0, 0.2], method="rk4", max_step=0.0005, backend="vm")
    np.testing.assert_allclose(sparse.outputs, dense.outputs[:, ::4000], atol=ROUNDING)
