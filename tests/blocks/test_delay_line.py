"""A delay of whole samples against shifted arrays, and in a sampled loop."""

import pickle
import re
from pathlib import Path

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl import Loop, flatten, margins, simulate, transport_delay
from phyfilter_ctl.blocks import delay_line, sampled_block
from phyfilter_ctl.codegen import compile_model

H = 0.01
# A chain of lags instead of the delay: phase off by (omega h)^2/3, size by 1 - steps (omega h)^2/2.
OMEGA, STEPS = 2.0, 4
LINEAR = STEPS * (OMEGA * H) ** 2
ROUNDING = 1e-12


def run(block, u):
    """Outputs for samples u (N, n), by the recursion."""
    state, outputs = [entry.start for entry in block.law.states], []
    for row in u:
        outputs.append(block.law.output(0.0, state, row, []).full().ravel())
        state = block.law.dynamics(0.0, state, row, [])
    return np.array(outputs)


@given(st.integers(0, 6), st.integers(1, 3), st.integers(0, 100))
def test_it_is_a_shift(steps, n, seed):
    rng = np.random.default_rng(seed)
    u, start = rng.standard_normal((12, n)), rng.standard_normal(n)
    block = delay_line([f"u[{i}]" for i in range(n)], steps, H, start=start)
    expected = np.vstack([np.tile(start, (steps, 1)), u])[:12]
    np.testing.assert_array_equal(run(block, u), expected)
    assert block.law.feedthrough.any() == (steps == 0)


def test_labels():
    block = delay_line(["thrust[0]", "valve"], 2, H, name="late", unit="N")
    assert (block.name, block.period) == ("late", H)
    assert block.output_labels == ["thrust_delayed[0]", "valve_delayed"]
    assert [state.name for state in block.law.states] == ["past[0,0]", "past[0,1]", "past[1,0]", "past[1,1]"]
    assert {entry.unit for entry in (*block.law.inputs, *block.law.outputs, *block.law.states)} == {"N"}
    assert delay_line(["a", "b"], 1, H, outputs=["c", "d"]).output_labels == ["c", "d"]
    assert delay_line(["a[1,2]"], 1, H, outputs="_late").output_labels == ["a_late[1,2]"]


def test_it_holds_between_samples_and_breaks_a_loop():
    """u_k = 1 - 0.5 u_(k-1), a loop that only the delay makes one of samples."""
    law = sampled_block(ct.ss([], [], [], [[-0.5, 1.0]], H, inputs=["y", "r"], outputs="u", name="law"))
    diagram = ct.interconnect([law, delay_line(["u"], 1, H, outputs=["y"])], inputs=["r"], outputs=["u", "y"])
    times = H / 4 * np.arange(81)
    u, y = simulate(diagram, times, 1.0).outputs
    k = np.arange(81) // 4
    np.testing.assert_allclose(u, (1.0 - (-0.5) ** (k + 1)) / 1.5, atol=ROUNDING)
    np.testing.assert_allclose(y, (1.0 - (-0.5) ** k) / 1.5, atol=ROUNDING)


def test_linearised_it_is_the_delay():
    line = delay_line(["u"], STEPS, H, outputs=["y"])
    diagram = ct.interconnect([line], inputs=["u"], outputs=["y"])
    expected = np.exp(-1j * OMEGA * STEPS * H)
    assert abs(flatten(diagram).linearize()(1j * OMEGA) - expected) < LINEAR


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        (([], 1, H), ValueError, "signals: expected a sequence"),
        (("u", 1, H), ValueError, "signals: expected a sequence"),
        ((["u", "u"], 1, H), ValueError, "u more than once"),
        ((["u"], -1, H), ValueError, "0 samples or more"),
        ((["u"], 1.5, H), TypeError, "whole number"),
        ((["u"], 1, 0.0), ValueError, "dt: expected"),
    ],
)
def test_bad_input(arguments, error, message):
    with pytest.raises(error, match=message):
        delay_line(*arguments)


def test_bad_options():
    with pytest.raises(ValueError, match="expected 1 labels"):
        delay_line(["u"], 1, H, outputs=["a", "b"])
    with pytest.raises(ValueError, match="start: expected"):
        delay_line(["u"], 1, H, start=[1.0, 2.0])
    with pytest.raises(ValueError, match="start: expected"):
        delay_line(["u"], 1, H, start=np.nan)


# -- in seconds -------------------------------------------------------------------------------------------------------

# Sums of a hundred terms of size 1.
CLOSE = 1e-10
# Phase of the approximants at the frequencies up to which they are said to be right to a degree.
DEGREE = np.deg2rad(1.0)


@pytest.mark.parametrize(
    ("delay", "period", "steps"),
    [(0.02, H, 2), (0.004, H / 5, 2), (0.025, H / 2, 5), (0.0, H, 0), (H / 3, H / 3, 1)],
)
def test_a_held_command_acts_late_to_the_digit(delay, period, steps):
    """An integrator behind a computer: its place is the sum of what acted for how long, by hand."""
    block = transport_delay(["u"], delay, H, outputs=["late"], start=0.5)
    assert (block.period, len(block.law.states)) == (pytest.approx(period), steps)
    commands = np.random.default_rng(2).standard_normal(12)
    source = sampled_block(ct.ss([], [], [], [[1.0]], H, inputs="r", outputs="u", name="law"))
    body = ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]], inputs="late", outputs="place", name="body")
    diagram = ct.interconnect([source, block, body], inputs="r", outputs=["late", "place"])
    times = H * np.arange(12)
    fine = np.sort(np.concatenate([times, times[:-1] + 0.37 * H]))
    k = np.floor(fine / H + 1e-9).astype(int)
    response = simulate(diagram, fine, commands[k], interpolation="hold")
    edges = np.concatenate([[-1.0], times + delay])
    acting = np.concatenate([[0.5], commands])
    late = acting[np.searchsorted(edges, fine + 1e-9) - 1]
    np.testing.assert_allclose(response.outputs[0], late, atol=ROUNDING)
    lengths = np.clip(fine[:, None] - np.maximum(edges, 0.0), 0.0, np.diff([0.0, *edges[1:], 1.0]))
    np.testing.assert_allclose(response.outputs[1], lengths @ acting, atol=CLOSE)


@pytest.mark.parametrize("delay", [0.02, 0.004, 0.033])
def test_a_measurement_is_read_as_it_was(delay):
    """A ramp, of which a block every H reads what was: exact at its instants, whatever is between."""
    block = transport_delay(["x"], delay, H, outputs=["seen"])
    reader = sampled_block(ct.ss([], [], [], [[1.0]], H, inputs="seen", outputs="y", name="reader"))
    diagram = ct.interconnect([block, reader], inputs="x", outputs="y")
    times = H * np.arange(20)
    seen = simulate(diagram, times, 3.0 * times).outputs
    np.testing.assert_allclose(seen, 3.0 * np.maximum(times - delay, 0.0), atol=CLOSE)


@pytest.mark.parametrize(
    ("order", "numdeg", "phase", "gain"),
    [
        (1, None, 0.6, None),
        (2, None, 1.7, None),
        (3, None, 3.0, None),
        (5, None, 6.1, None),
        (3, 2, 2.1, 0.01),
        (5, 4, 5.0, 0.01),
    ],
)
def test_a_continuous_delay_is_as_right_as_it_says(order, numdeg, phase, gain):
    """Against e^(-s delay), for two signals that do not mix; and as a block in a diagram, pickled."""
    delay = 0.25
    block = transport_delay(["a", "b[0]"], delay, order=order, numdeg=numdeg)
    assert block.output_labels == ["a_delayed", "b_delayed[0]"]
    assert block.nstates == 2 * order
    linear = flatten(pickle.loads(pickle.dumps(block))).linearize()
    for omega in np.linspace(0.05, 1.0, 12) * phase / delay:
        H_ = linear(1j * omega)
        assert abs(H_[0, 1]) + abs(H_[1, 0]) == 0.0
        ratio = H_[0, 0] * np.exp(1j * omega * delay)
        assert abs(np.angle(ratio)) < DEGREE
        assert abs(abs(ratio) - 1.0) < (gain or CLOSE)
    assert bool(np.any(linear.D)) == (numdeg is None)


def test_a_continuous_delay_starts_at_rest_on_its_start():
    block = transport_delay(["a", "b"], 0.3, start=[2.0, -1.0], unit="N")
    response = simulate(block, np.linspace(0.0, 2.0, 21))
    np.testing.assert_allclose(response.outputs, np.repeat([[2.0], [-1.0]], 21, axis=1), atol=1e-9)
    assert simulate(transport_delay(["a"], 0.0), [0.0, 1.0], [[3.0, 4.0]]).outputs.tolist() == [3.0, 4.0]


def test_a_continuous_delay_shifts_a_smooth_signal():
    times = np.linspace(0.0, 4.0, 401)
    block = transport_delay(["u"], 0.4)
    y = simulate(block, times, np.sin(2.0 * times)).outputs
    np.testing.assert_allclose(y[200:], np.sin(2.0 * (times[200:] - 0.4)), atol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "kind", "message"),
    [
        ((["u"], -0.1), ValueError, "delay: expected a finite number >= 0 s"),
        ((["u"], 0.1, 0.0), ValueError, "dt"),
        (
            (["u"], H * np.sqrt(2.0), H),
            ValueError,
            r"1\.41421 periods .* expected one such as 7/5 of a period",
        ),
        (([], 0.1), ValueError, "signals"),
        ((["u"], 0.1, None, "3"), TypeError, "order: expected a whole number"),
        ((["u"], 0.1, None, 0), ValueError, "order: expected 1 or more"),
        ((["u"], 0.1, None, 2, 3), ValueError, "numdeg at most order"),
    ],
)
def test_delays_that_are_none_are_refused(arguments, kind, message):
    named = dict(zip(("order", "numdeg"), arguments[3:], strict=False))
    with pytest.raises(kind, match=message):
        transport_delay(*arguments[:3], **named)


@pytest.mark.parametrize("delay", [0.004, 0.01])
def test_margins_count_it(delay):
    """What is left of the delay margin of an integrator under a held proportional law, opened where the delay ends."""
    body = ct.tf([1.0], [1.0, 0.0], inputs="late", outputs="y", name="body")

    def margin(command, signal, *more):
        law = sampled_block(
            ct.ss([], [], [], [[1.0, -30.0]], H, inputs=["r", "y"], outputs=command, name="law")
        )
        diagram = ct.interconnect([body, law, *more], inputs="r", outputs="y")
        return margins(diagram, at=signal).delay_margin

    left = margin("u", "delay.late", transport_delay(["u"], delay, H, outputs=["late"]))
    assert margin("late", "law.late") - left == pytest.approx(delay, rel=1e-4)


def test_the_page_on_delays():
    """Its blocks run; then its figures, by the diagrams of the page with one wire another."""
    text = (Path(__file__).parents[2] / "docs/delay.md").read_text()
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(compile(block, "docs/delay.md", "exec"), names)
    t = names["t"]

    def largest(parts, inputs):
        diagram = ct.interconnect(parts, inputs=inputs, outputs="f_hat[0]", name="loop")
        return np.abs(simulate(diagram, t, [np.sin(9.0 * t), 0.0]).outputs).max(), diagram

    blocks = [
        names["body"],
        sampled_block(names["law"]),
        names["computer"],
        names["sensor"],
        names["observer"],
    ]
    found = {}
    for wire in ("torque", "command"):
        acting = ct.ss([], [], [], [[1.0]], inputs=wire, outputs="g[0]", name="acting")
        found[wire], diagram = largest([*blocks, acting], ["goal", "load"])
    # The formula's g is what was commanded, the last of the two.
    margin = margins(diagram, at="computer.torque").delay_margin
    formula = margins(names["F"].sampled(H), Loop(0.0, 4.0, delay=0.004))
    assert margin == pytest.approx(formula.delay_margin, rel=1e-5)
    deaf = sampled_block(names["F"].sampled(H), 1, inertia=0.5, f_theta=False, name="observer")
    untold, _ = largest([names[n] for n in ("body", "late", "command", "known")] + [deaf], ["u", "load"])
    figures = (found["torque"], found["command"], untold, 1e3 * margin)
    assert [f"{figure:.2g}" for figure in figures[:3]] == ["0.076", "0.052", "0.027"]
    assert f"{figures[3]:.1f}" == "91.3"


def test_c_delays_alike():
    """A held command by a part of a period, and a smooth signal by an approximant, in one diagram."""
    law = sampled_block(ct.ss([], [], [], [[2.0]], H, inputs="r", outputs="u", name="law"))
    held = transport_delay(["u"], 0.4 * H, H, outputs=["late"], name="held")
    pipe = transport_delay(["late"], 0.05, order=3, numdeg=2, outputs=["y"], name="pipe")
    diagram = ct.interconnect([law, held, pipe], inputs="r", outputs=["late", "y"])
    times = H / 5 * np.arange(101)
    r = np.sin(20.0 * times)
    by_c = compile_model(flatten(diagram)).simulate(
        times, r[:, None], method="adaptive", rtol=1e-10, atol=1e-12
    )
    np.testing.assert_allclose(by_c.outputs.T, simulate(diagram, times, r).outputs, atol=1e-8)
