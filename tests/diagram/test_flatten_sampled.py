"""Sampled blocks in continuous diagrams, and discrete diagrams as one sampled block."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, phyfilter_block
from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.discrete import as_sampled

ROUNDING = 1e-12  # the same formulas in another order
DT = 0.01


def at(function, *arguments):
    return np.asarray(function(*arguments), dtype=float).reshape(-1)


def run(flat, steps, h, u):
    """The instants of FlatModel's notes, by hand: forward Euler in between."""
    x, p = flat.start_state(), flat.start_parameters()
    z = np.zeros(len(flat.held))
    states = {task.name: np.array([v.start for v in task.law.states]) for task in flat.tasks}
    outputs = []
    for k in range(steps):
        t = k * h
        due = [task for task in flat.tasks if abs(t / task.period - round(t / task.period)) < 1e-9]
        for task in due:
            v = at(task.signals, t, x, u(t), p, z)
            z[task.held] = at(task.law.output, t, states[task.name], v, p[task.parameters])
        for task in due:
            v = at(task.signals, t, x, u(t), p, z)
            states[task.name] = at(task.law.dynamics, t, states[task.name], v, p[task.parameters])
        outputs.append(at(flat.output, t, x, u(t), p, z))
        x = x + h * at(flat.dynamics, t, x, u(t), p, z)
    return np.array(outputs)


def plant(mass=2.0):
    return ct.nlsys(lambda t, x, u, params: (u - 0.3 * x * np.abs(x)) / params["m"], None, inputs=["f"],
                    outputs=["x[0]"], states=["v"], params={"m": mass}, name="plant")  # fmt: skip


def compensated(g="hold", period=DT, controller_period=2 * DT):
    """A mass with unknown drag: P control at half the rate of the filter, whose estimate is fed forward."""
    filt = sampled_block(PhyFilter([80.0, 14.0]).sampled(period, g=g), 1, inertia=2.0, name="filter")
    law = ct.nlsys(None, lambda t, x, u, params: params["k"] * (u[0] - u[1]) - u[2], inputs=["r", "v", "fhat"],
                   outputs=["g"], params={"k": 6.0}, dt=controller_period, name="law")  # fmt: skip
    control = sampled_block(law)
    return ct.interconnect(
        [plant(), control, filt],
        connections=[["plant.f", "law.g"], ["filter.x[0]", "plant.x[0]"], ["filter.g[0]", "law.g"],
                     ["law.v", "plant.x[0]"], ["law.fhat", "filter.f_hat[0]"]],
        inplist=["law.r", "filter.f_theta[0]"], inputs=["r", "f_theta"],
        outlist=["plant.x[0]", "filter.f_hat[0]", "law.g"], outputs=["v", "f_hat", "g"], name="compensated",
    )  # fmt: skip


def test_structure():
    flat = flatten(compensated())
    assert [(task.name, task.period) for task in flat.tasks] == [("filter", DT), ("law", 2 * DT)]
    assert flat.order[:2] == ("filter", "law")
    assert [v.name for v in flat.held] == ["law.g", "filter.f_hat[0]"]
    assert [v.name for v in flat.parameters] == ["plant.m", "law.k"]
    assert [v.name for v in flat.states] == ["plant.v"]
    by_name = {task.name: task for task in flat.tasks}
    assert by_name["filter"].held == slice(1, 2)
    assert by_name["law"].parameters == slice(1, 2)
    assert by_name["filter"].filter.channels == 1
    assert by_name["law"].filter is None
    assert flat.dt == 0.0
    # The held outputs, not the laws, are what the continuous part and the other tasks see.
    assert at(flat.dynamics, 0, [0.0], [5.0, 0.0], [2.0, 6.0], [3.0, 9.0]).tolist() == [1.5]
    assert at(by_name["law"].signals, 0, [7.0], [5.0, 0.0], [2.0, 6.0], [3.0, 9.0]).tolist() == [
        5.0,
        7.0,
        9.0,
    ]


def test_two_rates_against_a_loop_by_hand():
    sampled = PhyFilter([80.0, 14.0]).sampled(DT, g="hold")
    h, steps = DT / 2, 400
    v, k, m = 0.0, 6.0, 2.0
    g = f_hat = 0.0
    expected = []
    state = None
    for i in range(steps):
        t = i * h
        r, f_theta = np.sin(t), 0.1 * t
        if i % 2 == 0 and state is None:
            state, f_hat = sampled.start([v], f_theta0=[f_theta], inertia0=m), f_theta
        elif i % 2 == 0:  # with g="hold" the g of the instant before, which still stands here
            state, estimate = sampled.step(state, [v], [g], [f_theta])
            f_hat = float(estimate[0])
        if i % 4 == 0:
            g = k * (r - v) - f_hat
        expected.append([v, f_hat, g])
        v = v + h * (g - 0.3 * v * abs(v)) / m
    ours = run(flatten(compensated()), steps, h, lambda t: [np.sin(t), 0.1 * t])
    np.testing.assert_allclose(ours, expected, rtol=1e-9, atol=ROUNDING)


def test_traced_and_linear_and_diagram_laws():
    """The same discrete PI law wrapped as a state space, as Python functions and as a diagram."""
    linear = ct.ss([[1.0]], [[0.2]], [[0.5]], [[3.0]], 0.1, inputs="e", outputs="f", name="pi")
    functions = ct.nlsys(lambda t, x, u, params: x + params["b"] * u, lambda t, x, u, params: 0.5 * x + 3.0 * u,
                         inputs="e", outputs="f", states=1, params={"b": 0.2}, dt=0.1, name="pi")  # fmt: skip
    i_part = ct.ss([[1.0]], [[0.2]], [[0.5]], [[0.0]], 0.1, inputs="e", outputs="i", name="i")
    p_part = ct.ss([], [], [], [[3.0]], 0.1, inputs="e", outputs="p", name="p")
    total = ct.summing_junction(["i", "p"], "f", name="sum")
    parts = ct.interconnect([i_part, p_part, total], inputs="e", outputs="f", name="pi")
    results = []
    for system in (linear, functions, parts):
        mass = ct.ss([[-0.2]], [[1.0]], [[1.0]], [[0.0]], inputs="f", outputs="y", name="mass")
        sys = ct.interconnect(
            [mass, sampled_block(system), ct.summing_junction(["r", "-y"], "e", name="error")],
            inputs="r", outputs="y", name="loop",
        )  # fmt: skip
        flat = flatten(sys)
        assert len(flat.tasks[0].law.states) == 1
        results.append(run(flat, 100, 0.02, lambda t: [1.0]))
    np.testing.assert_allclose(results[1], results[0], rtol=ROUNDING, atol=ROUNDING)
    np.testing.assert_allclose(results[2], results[0], rtol=ROUNDING, atol=ROUNDING)
    assert np.ptp(results[0]) > 0.5


def test_loop_among_sampled_blocks_is_refused_with_its_path():
    """With g="average" the filter waits for the command and the command for the filter."""
    with pytest.raises(ValueError, match="wait for each other") as caught:
        flatten(compensated(g="average"))
    text = str(caught.value)
    assert "law.g -> filter.g[0]" in text
    assert "filter.f_hat[0] -> law.fhat" in text
    assert 'g="hold"' in text


def test_sampled_block_in_a_discrete_diagram_is_refused():
    block = sampled_block(ct.tf([1.0], [1.0, -0.5], 0.1, inputs="u", outputs="y", name="block"))
    block.dt = None
    plain = ct.tf([1.0], [1.0, -0.2], 0.1, inputs="y", outputs="z", name="plain")
    sys = ct.interconnect([block, plain], inputs="u", outputs="z", name="mixed")
    with pytest.raises(ValueError, match="block block is a sampled block in a discrete diagram"):
        flatten(sys)


def test_one_sampled_block_alone():
    flat = flatten(sampled_block(PhyFilter([20.0]).sampled(DT), 1, name="alone"))
    assert [v.name for v in flat.held] == ["f_hat[0]"]
    assert flat.tasks[0].name == "alone"
    assert [v.name for v in flat.inputs] == ["x[0]", "g[0]", "f_theta[0]"]


def test_discrete_diagram_as_one_task():
    law = ct.nlsys(lambda t, x, u, params: 0.9 * x + params["b"] * u, lambda t, x, u, params: np.sin(x) + u, inputs="u",
                   outputs="y", states=1, params={"b": 0.2}, dt=0.1, name="law")  # fmt: skip
    sys = ct.interconnect([law, ct.tf([1.0], [1.0, -0.4], 0.1, inputs="y", outputs="w", name="lag")], inputs="u",
                          outputs=["y", "w"], name="disc")  # fmt: skip
    flat = as_sampled(flatten(sys))
    assert (flat.dt, flat.states, [v.name for v in flat.held]) == (0.0, (), ["y", "w"])
    time = 0.1 * np.arange(30)
    theirs = ct.input_output_response(sys, time, np.cos(time))
    ours = run(flat, 30, 0.1, lambda t: [np.cos(t)])
    np.testing.assert_allclose(ours.T, theirs.outputs, rtol=ROUNDING, atol=ROUNDING)
    continuous = flatten(plant())
    assert as_sampled(continuous) is continuous


def test_linearised_with_the_continuous_equivalent():
    """The sampled filter counts as F: the same diagram with the continuous block says what that is."""

    def diagram(block):
        return ct.interconnect(
            [plant(), block], connections=[["phyfilter.x[0]", "plant.x[0]"]],
            inplist=[["plant.f", "phyfilter.g[0]"], "phyfilter.f_theta[0]"], inputs=["f", "f_theta"],
            outlist=["phyfilter.f_hat[0]"], outputs="f_hat", name="d",
        )  # fmt: skip

    filt = PhyFilter([80.0, 14.0])
    sampled = flatten(diagram(sampled_block(filt.sampled(DT), 1, inertia=2.0))).linearize([0.7], [1.0, 0.0])
    continuous = flatten(diagram(phyfilter_block(filt, 1, inertia=2.0))).linearize(
        [0.7, 0.0, 0.0], [1.0, 0.0]
    )
    omega = np.array([0.1, 1.0, 7.0, 50.0])
    for w in omega:
        np.testing.assert_allclose(sampled(1j * w), continuous(1j * w), rtol=1e-9, atol=ROUNDING)


def test_linearised_loop_of_equivalents():
    """Both blocks have feedthrough as equivalents: an algebraic loop that the linearisation solves."""
    linear = flatten(compensated()).linearize()
    s = 3.0j
    F, k, m = PhyFilter([80.0, 14.0])(s), 6.0, 2.0
    # g = k (r - v) - f_hat, m s v = g, f_hat = f_theta + F (m s v - g - f_theta): F sees nothing at v = 0, no drag.
    np.testing.assert_allclose(linear(s)[0, 0], k / (m * s + k), rtol=1e-9)
    np.testing.assert_allclose(linear(s)[1, 1], 1 - F, rtol=1e-9)
