"""The filter as a block: wired by python-control unmodified, right in closed loop, refusals."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, phyfilter_block, stack

FILTER = PhyFilter.from_poles([-8.0 + 6j, -8.0 - 6j])


def test_interconnect_takes_it_unmodified():
    """M x' = g + f with a constant f: tau = -f_hat cancels it, and x comes to rest. Closed form by algebra."""
    mass = ct.ss(
        [[0.0]], [[0.5, 0.5]], [[1.0]], [[0.0, 0.0]], inputs=["tau", "f"], outputs=["x[0]"], name="mass"
    )
    invert = ct.ss([], [], [], [[-1.0]], inputs=["f_hat[0]"], outputs=["tau"], name="invert")
    to_g = ct.ss([], [], [], [[1.0]], inputs=["tau"], outputs=["g[0]"], name="to_g")
    filter_block = phyfilter_block(FILTER, 1, inertia=2.0)
    loop = ct.interconnect(
        [mass, filter_block, invert, to_g], inputs=["f", "f_theta[0]"], outputs=["x[0]", "f_hat[0]"]
    )
    t = np.linspace(0.0, 3.0, 301)
    response = ct.forced_response(loop, t, [np.full_like(t, 3.0), np.zeros_like(t)])
    # f_hat = F f, whatever the loop does, because g = tau is known.
    expected = 3.0 * ct.step_response(FILTER.transfer_function, t).outputs
    np.testing.assert_allclose(response.outputs[1], expected, atol=1e-8)
    assert response.outputs[1, -1] == pytest.approx(3.0, abs=1e-6)


def test_nonlinear_plant_in_the_loop():
    """A pendulum velocity with unknown drag, simulated by python-control's own integrator."""
    drag = ct.nlsys(
        None, lambda t, x, u, params: -0.4 * u * np.abs(u), inputs=["x[0]"], outputs=["f"], name="drag"
    )
    plant = ct.nlsys(
        lambda t, x, u, params: u[0] + u[1],
        lambda t, x, u, params: x,
        inputs=["g", "f"],
        outputs=["x[0]"],
        states=["v"],
        name="plant",
    )
    known = ct.ss([], [], [], [[1.0], [1.0]], inputs=["push"], outputs=["g", "g[0]"], name="known")
    loop = ct.interconnect(
        [plant, drag, known, phyfilter_block(FILTER, 1)],
        inputs=["push", "f_theta[0]"],
        outputs=["f", "f_hat[0]"],
    )
    t = np.linspace(0.0, 6.0, 601)
    push = 2.0 + np.sin(t)
    response = ct.input_output_response(
        loop, t, [push, np.zeros_like(t)], solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-10}
    )
    f, f_hat = response.outputs
    filtered = ct.forced_response(FILTER.transfer_function, t, f).outputs
    np.testing.assert_allclose(f_hat, filtered, atol=2e-4)  # f between samples is not quite a straight line
    assert np.abs(f_hat - f)[300:].max() < 0.2 * np.abs(f).max()


def test_full_inertia_mixes_the_channels():
    M = np.array([[2.0, 0.3], [0.3, 1.0]])
    block = phyfilter_block(FILTER, 2, inertia=M)
    s = 3.0j
    np.testing.assert_allclose(block(s)[:, :2], s * FILTER(s) * M, rtol=1e-12)
    np.testing.assert_allclose(block(s)[:, 2:4], -FILTER(s) * np.eye(2), atol=1e-14)
    np.testing.assert_allclose(block(s)[:, 4:], FILTER.error(s) * np.eye(2), atol=1e-14)


def test_one_filter_per_channel():
    filters = [FILTER, PhyFilter([3.0])]
    block = phyfilter_block(filters, name="bank")
    assert block.name == "bank"
    assert block.output_labels == ["f_hat[0]", "f_hat[1]"]
    assert block.nstates == 3
    s = 1.0 + 2.0j
    np.testing.assert_allclose(np.diag(block(s)[:, 2:4]), [-entry(s) for entry in filters], rtol=1e-12)


def test_sampled_block_is_discrete():
    block = phyfilter_block(FILTER.sampled(0.01), 2)
    assert block.dt == 0.01
    assert block.nstates == 4
    # Held g: no direct path from g, so a command that depends on f_hat makes no algebraic loop.
    np.testing.assert_array_equal(block.D[:, 2:4], 0.0)


def test_rest_state_removes_the_bump():
    block = phyfilter_block(FILTER, 2)
    t = np.linspace(0.0, 1.0, 11)
    inputs = np.vstack([np.full((1, 11), 5.0), np.full((1, 11), -2.0), np.zeros((4, 11))])
    started = ct.forced_response(block, t, inputs, X0=block.rest_state([5.0, -2.0]))
    np.testing.assert_allclose(started.outputs, 0.0, atol=1e-10)
    bumped = ct.forced_response(block, t, inputs)
    assert np.abs(bumped.outputs).max() > 10.0
    with pytest.raises(ValueError, match="x0: expected shape"):
        block.rest_state([1.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((FILTER,), "number of channels"),
        ((FILTER, 0), "at least 1"),
        (([FILTER, FILTER, FILTER], 2), "3 filters for 2 channels"),
        ((FILTER.sampled(0.01, limit=1.0), 2), "limit=.*no linear block"),
        ((FILTER.sampled(0.01, nonfinite="hold"), 2), "nonfinite='hold' has no linear block"),
        ((FILTER.sampled(0.01, E=np.eye(3)[:, :2]), 2), "contradicts the 3 rows of E"),
    ],
)
def test_bad_blocks_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        phyfilter_block(*arguments)


@pytest.mark.parametrize("inertia", [np.zeros((2, 3)), [1.0, np.nan], np.ones((4, 2, 2))])
def test_bad_inertia_is_refused(inertia):
    with pytest.raises(ValueError, match="inertia: expected"):
        phyfilter_block(FILTER, 2, inertia=inertia)


def test_a_stack_goes_in_as_it_is():
    sampled = stack([FILTER.sampled(0.01), PhyFilter([3.0]).sampled(0.01)])
    assert phyfilter_block(sampled).noutputs == 2
