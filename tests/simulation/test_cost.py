"""Which backend "auto" takes, and the loop of matrix products for affine diagrams."""

import control as ct
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.copies import copy_key
from phyfilter_ctl.simulation import simulate
from phyfilter_ctl.simulation.arguments import prepare
from phyfilter_ctl.simulation.cost import expected_cost

# The same matrices by another exponential.
EXACT = 1e-12


def run_of(flat, times, inputs=0.0):
    return prepare(flat, times, inputs, None, None, "linear")


def network(n):
    return ct.nlsys(
        lambda t, x, u, params: u[0] + np.sin(np.roll(np.ones(n), 1) * x) * 3.0 - x**3, None, inputs=1, outputs=n,
        states=n, name="network",
    )  # fmt: skip


def test_cost_counts_steps_and_runs_and_not_rows():
    """Twice as fast, twice as long or twice as many is twice the steps; rows alone cost next to nothing."""
    flat = flatten(network(20))
    few, many = np.linspace(0.0, 10.0, 11), np.linspace(0.0, 10.0, 1001)
    options = {"fixed": False, "max_step": None, "runs": 1}
    once = expected_cost(flat, run_of(flat, few), 100.0, **options)
    assert expected_cost(flat, run_of(flat, few), 200.0, **options).steps == 2.0 * once.steps
    assert expected_cost(flat, run_of(flat, 2.0 * few), 100.0, **options).steps == 2.0 * once.steps
    assert expected_cost(flat, run_of(flat, many), 100.0, **options).steps == once.steps
    bent = expected_cost(flat, run_of(flat, many, np.sin(20.0 * many)), 1.0, **options)
    assert bent.steps == 999.0  # an integrator starts anew at each kink
    batch = expected_cost(flat, run_of(flat, few), 100.0, **(options | {"runs": 2000}))
    assert once.vm < once.c
    assert batch.c < batch.vm
    assert "predicted" in once.explained("vm")


@pytest.mark.slow
def test_runs_of_many_states_take_c():
    """Of 600 pendulums, each against SciPy: to make the functions of a step takes the virtual machine longer."""
    n = 600
    sys = ct.nlsys(
        lambda t, x, u, params: np.concatenate([x[n:], u[0] - params["g"] * np.sin(x[:n])]),
        lambda t, x, u, params: x[:1], inputs=1, outputs=1, states=2 * n, params={"g": 9.8}, name="pendulums",
    )  # fmt: skip
    flat = flatten(sys)
    t = np.linspace(0.0, 20.0, 11)
    long = simulate(flat, t, 0.1, 0.1)
    assert long.backend == "c"
    assert long.explanation.startswith("c: about")
    one = solve_ivp(lambda t, x: [x[1], 0.1 - 9.8 * np.sin(x[0])], (0.0, 20.0), [0.1, 0.1], "DOP853", t, rtol=1e-11,
                    atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(long.outputs, one.y[0], atol=1e-6)


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_matrix_loop_equals_forced_response_and_the_exponential_method(interpolation):
    rng = np.random.default_rng(5)
    A = rng.normal(size=(6, 6)) - 3.0 * np.eye(6)
    sys = ct.ss(A, rng.normal(size=(6, 2)), rng.normal(size=(3, 6)), rng.normal(size=(3, 2)))
    t = np.linspace(0.5, 4.5, 81)
    u, start = rng.normal(size=(2, 81)), rng.normal(size=6)
    ours = simulate(sys, t, u, start, interpolation=interpolation)
    assert (ours.backend, ours.method) == ("numpy", "exact")
    machine = simulate(sys, t, u, start, interpolation=interpolation, backend="vm")
    np.testing.assert_allclose(ours.states, machine.states, rtol=EXACT, atol=EXACT)
    np.testing.assert_allclose(ours.outputs, machine.outputs, rtol=EXACT, atol=EXACT)
    if interpolation == "linear":
        theirs = ct.forced_response(sys, t, u, start)
        np.testing.assert_allclose(ours.outputs, theirs.outputs, rtol=1e-10, atol=1e-10)


def test_matrix_loop_with_parameters_time_and_uneven_times():
    """x' = -k x + t + 2 + u by hand; times of two distances; a diagram that is not affine is refused."""
    sys = ct.nlsys(lambda t, x, u, params: -params["k"] * x + t + 2.0 + u, None, inputs=1, outputs=1, states=1,
                   params={"k": 0.7}, name="lag")  # fmt: skip
    t = np.concatenate([np.linspace(0.0, 1.0, 11), 1.0 + 0.25 * np.arange(1, 9)])
    for k in (0.7, 3.0):
        response = simulate(sys, t, 1.0, 0.4, params={"k": k}, backend="numpy")
        particular = t / k - 1.0 / k**2 + 3.0 / k
        expected = particular + (0.4 - particular[0]) * np.exp(-k * t)
        np.testing.assert_allclose(response.outputs, expected, rtol=EXACT)
    square = ct.nlsys(lambda t, x, u, params: u**2 - x, None, inputs=1, outputs=1, states=1, name="square")
    with pytest.raises(ValueError, match="expected an affine diagram"):
        simulate(square, t, 1.0, backend="numpy")
    assert simulate(square, t, 1.0).backend == "vm"


def test_matrix_loop_tells_of_overflow():
    grows = simulate(
        ct.ss([[40.0]], [[1.0]], [[1.0]], 0.0), np.linspace(0.0, 100.0, 101), 1.0, backend="numpy"
    )
    assert not grows.success
    assert 15.0 < grows.failed_at < 20.0
    assert np.isnan(grows.outputs[-1])
    assert np.isfinite(grows.outputs[:15]).all()


def test_copies_are_traced_once_and_others_are_not():
    """The same code on other numbers, in closures, defaults or parameters, is another block."""

    def lag(rate, bias=0.0, gain=1.0):
        return ct.nlsys(lambda t, x, u, params, bias=bias: params["gain"] * rate * (u - x) + bias, None, inputs=1,
                        outputs=1, states=1, params={"gain": gain})  # fmt: skip

    blocks = [lag(2.0), lag(2.0), lag(3.0), lag(2.0, bias=1.0), lag(2.0, gain=5.0)]
    keys = [copy_key(block, {}) for block in blocks]
    assert keys[0] == keys[1]
    assert len(set(keys)) == 4
    assert copy_key(ct.tf([1.0], [1.0, 1.0]), {}) is None
    for i, block in enumerate(blocks):
        block.name = f"lag{i}"
    flat = flatten(ct.InterconnectedSystem(blocks, inplist=[(i, 0) for i in range(5)], outlist=[], inputs=5, outputs=0,
                                           name="all"))  # fmt: skip
    rates = np.asarray(flat.dynamics(0.0, np.zeros(5), np.ones(5), flat.start_parameters(), [])).ravel()
    assert rates.tolist() == [2.0, 2.0, 3.0, 3.0, 10.0]
