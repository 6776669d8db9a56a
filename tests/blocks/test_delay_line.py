"""A delay of whole samples against shifted arrays, and in a sampled loop."""

import control as ct
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl import flatten, simulate
from phyfilter_ctl.blocks import delay_line, sampled_block

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
