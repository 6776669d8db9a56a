"""simulate against closed forms and python-control, its conventions and its refusals."""

import control as ct
import matplotlib as mpl
import numpy as np
import pytest

from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.plants import plant
from phyfilter_ctl.simulation import SimulationResponse, simulate

# Both sides integrate with tolerance 1e-10 or finer.
AGREES = 1e-8
EXACT = 1e-13
TIMES = np.linspace(0.0, 3.0, 61)


def pendulum():
    return ct.nlsys(
        lambda t, x, u, p: np.array([x[1], -p["g"] * np.sin(x[0]) - p["c"] * x[1] + u[0] - 0.5 * u[1]]),
        lambda t, x, u, p: np.array([x[0], x[1] + u[1]]),
        inputs=["tau", "wind"], outputs=["angle", "rate"], states=["angle", "rate"],
        params={"g": 9.81, "c": 0.4}, name="pendulum",
    )  # fmt: skip


def reference(system, inputs, start, **options):
    return ct.input_output_response(
        system, TIMES, inputs, start, solve_ivp_kwargs={"rtol": 1e-11, "atol": 1e-12, "method": "DOP853",
                                                        "max_step": 0.01}, **options,
    )  # fmt: skip


@pytest.mark.parametrize("method", ["rk4", "adaptive", "stiff", "auto"])
@pytest.mark.parametrize("backend", ["vm", "auto"])
def test_same_response_as_python_control(method, backend):
    inputs = [np.sin(2.0 * TIMES), 0.3]
    ours = simulate(
        pendulum(),
        TIMES,
        inputs,
        [0.5, -0.2],
        params={"c": 0.9},
        method=method,
        backend=backend,
        max_step=0.004,
    )
    theirs = reference(pendulum(), inputs, [0.5, -0.2], params={"c": 0.9})
    np.testing.assert_allclose(ours.outputs, theirs.outputs, atol=AGREES)
    np.testing.assert_allclose(ours.states, theirs.states, atol=AGREES)
    np.testing.assert_array_equal(ours.inputs, theirs.inputs)
    assert ours.success
    assert ours.message is None


def test_response_is_python_controls():
    response = simulate(pendulum(), TIMES, 0.0, [0.1, 0.0])
    assert isinstance(response, SimulationResponse)
    assert isinstance(response, ct.TimeResponseData)
    assert (response.output_labels, response.input_labels) == (["angle", "rate"], ["tau", "wind"])
    assert response.state_labels == ["angle", "rate"]
    assert response.outputs.shape == (2, 61)
    time, outputs = response
    np.testing.assert_array_equal(time, TIMES)
    np.testing.assert_array_equal(outputs, response.outputs)
    single = ct.tf([1.0], [1.0, 1.0])
    assert simulate(single, TIMES, 1.0).outputs.shape == (61,)
    assert simulate(single, TIMES, 1.0)(squeeze=False).outputs.shape == (1, 61)
    with mpl.rc_context({"backend": "Agg"}):
        figure = response.plot().figure
        assert len(figure.axes) == 4
        import matplotlib.pyplot as plt

        plt.close(figure)


def test_inputs_as_python_control_takes_them():
    flat = flatten(pendulum())
    table = np.vstack([np.cos(TIMES), np.full(61, 0.3)])
    for given in (table, [np.cos(TIMES), 0.3], (np.cos(TIMES), [0.3]), [table]):
        np.testing.assert_array_equal(simulate(flat, TIMES, given).inputs, table)
    assert np.all(simulate(flat, TIMES, 2.0).inputs == 2.0)
    # As many times as inputs: a list is still one of inputs.
    assert simulate(flat, [0.0, 1.0], [3.0, [4.0, 5.0]]).inputs.tolist() == [[3.0, 3.0], [4.0, 5.0]]
    for wrong in (table[:1], [1.0, 2.0, 3.0], table[:, :5], np.cos(TIMES)):
        with pytest.raises(ValueError, match=r"inputs: expected .* \(tau, wind\), got"):
            simulate(flat, TIMES, wrong)
    with pytest.raises(ValueError, match="got nan in wind at row 4"):
        simulate(flat, TIMES, [0.0, np.where(np.arange(61) == 4, np.nan, 1.0)])


def test_starts_are_those_of_the_blocks_unless_given():
    model = plant(
        lambda t, x, u, p: {"v": u.force - x.v, "s": x.v}, states={"v": (2.0, "m/s", ""), "s": 1.0},
        inputs={"force": (2.0, "N")}, params={}, name="car",
    )  # fmt: skip
    flat = flatten(model)
    rest = simulate(flat, TIMES)
    assert rest.states[:, 0].tolist() == [2.0, 1.0]
    np.testing.assert_allclose(rest.states[0], 2.0, rtol=EXACT)  # at its default the force holds the speed
    assert simulate(flat, TIMES, 0.0, {"s": 5.0}).states[:, 0].tolist() == [2.0, 5.0]
    assert simulate(flat, TIMES, 0.0, [3.0, 0]).states[:, 0].tolist() == [3.0, 0.0]
    assert simulate(flat, TIMES, 0.0, [np.array([3.0]), [4.0]]).states[:, 0].tolist() == [3.0, 4.0]
    assert simulate(flat, TIMES, 0.0, 0.0).states[:, 0].tolist() == [0.0, 0.0]
    for wrong in ([1.0, 2.0, 3.0], [], {"w": 1.0}, [np.nan, 0.0]):
        with pytest.raises(ValueError, match="initial_state: expected"):
            simulate(flat, TIMES, 0.0, wrong)


def test_discrete_diagrams_are_recursions():
    system = ct.interconnect(
        [ct.tf([0.3, 0.1], [1.0, -1.2, 0.5], 0.05, inputs="u", outputs="y", name="a"),
         ct.ss([[0.9]], [[0.1]], [[1.0]], [[0.0]], 0.05, inputs="y", outputs="w", name="b")],
        inputs="u", outputs=["y", "w"],
    )  # fmt: skip
    times = 0.05 * np.arange(2345)
    u = np.random.default_rng(0).standard_normal(len(times))
    ours = simulate(system, times, u, [0.1, -0.2, 0.3])
    theirs = ct.input_output_response(system, times, u, [0.1, -0.2, 0.3])
    np.testing.assert_allclose(ours.outputs, theirs.outputs, atol=EXACT)
    np.testing.assert_allclose(ours.states, theirs.states, atol=EXACT)
    assert ours.method == "discrete"
    with pytest.raises(ValueError, match=r"sampling interval 0\.05 s"):
        simulate(system, 0.1 * np.arange(5), 0.0)


def test_static_diagrams():
    system = ct.nlsys(None, lambda t, x, u, p: t + u**2, inputs=1, outputs=1, name="square")
    for method in ("rk4", "adaptive"):
        response = simulate(system, TIMES, np.sin(TIMES), method=method)
        np.testing.assert_allclose(response.outputs, TIMES + np.sin(TIMES) ** 2, rtol=EXACT)


def test_times_need_not_be_even_nor_start_at_zero():
    rng = np.random.default_rng(1)
    times = 5.0 + np.cumsum(rng.uniform(0.001, 0.2, 200))
    lag = ct.tf([2.0], [1.0, 2.0])
    exact = 1.0 - np.exp(-2.0 * (times - times[0]))
    for method, tolerance in (("exact", EXACT), ("adaptive", AGREES), ("rk4", 1e-5)):
        np.testing.assert_allclose(simulate(lag, times, 1.0, method=method).outputs, exact, atol=tolerance)
    assert simulate(lag, [3.0], 1.0, 2.0).states.tolist() == [[2.0]]


def test_held_inputs_jump_at_the_times():
    """x' = u, u a staircase: x is the sum of the steps; on straight lines it is the trapezoidal one."""
    integrator = ct.tf([1.0], [1.0, 0.0])
    u = np.random.default_rng(2).standard_normal(61)
    step = TIMES[1]
    for method in ("exact", "rk4", "adaptive"):
        held = simulate(integrator, TIMES, u, method=method, interpolation="hold").outputs
        np.testing.assert_allclose(held[1:], step * np.cumsum(u[:-1]), atol=EXACT)
        straight = simulate(integrator, TIMES, u, method=method).outputs
        np.testing.assert_allclose(straight[1:], step * np.cumsum((u[1:] + u[:-1]) / 2), atol=EXACT)


@pytest.mark.parametrize("method", ["rk4", "adaptive", "stiff"])
def test_divergence_is_a_status(method):
    """x' = x^2 from 1 is at infinity at t = 1."""
    system = ct.nlsys(lambda t, x, u, p: x**2, None, inputs=0, outputs=1, states=["mass"], name="bad")
    response = simulate(system, np.linspace(0.0, 2.0, 201), 0.0, 1.0, method=method)
    assert not response.success
    assert "try" in response.message
    assert abs(response.failed_at - 1.0) < 0.05
    reached = response.time < 0.99
    np.testing.assert_allclose(response.states[0, reached], 1 / (1 - response.time[reached]), rtol=1e-3)
    assert np.all(np.isnan(response.states[0, response.time > 1.06]))


def test_outputs_that_are_not_finite_are_named():
    system = ct.nlsys(
        lambda t, x, u, p: [-1.0 + 0.0 * x[0]], lambda t, x, u, p: [x[0], np.sqrt(x[0])],
        inputs=0, outputs=["height", "root"], states=1, name="fall",
    )  # fmt: skip
    response = simulate(system, np.linspace(0.0, 2.0, 21), 0.0, 0.95)
    assert not response.success
    assert "output root is nan at t = 1 s" in response.message
    assert np.isfinite(response.states).all()
    assert np.isfinite(response.outputs[0, :11]).all()
    assert np.isnan(response.outputs[:, 11:]).all()


def test_wrong_options_are_refused():
    system = ct.tf([1.0], [1.0, 1.0])
    for options, message in (
        ({"method": "euler"}, "method: expected one of"),
        ({"backend": "gpu"}, "backend: expected one of"),
        ({"interpolation": "cubic"}, "interpolation: expected 'linear' or 'hold'"),
        ({"max_step": 0.0}, "max_step: expected a positive"),
        ({"rtol": 0.0}, "rtol, atol"),
        ({"method": "exact", "backend": "c"}, "virtual machine"),
        ({"params": {"k": 1.0}}, "no parameter is called k"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate(system, TIMES, 1.0, **options)
    for times in ([0.0, 0.0], [[0.0, 1.0]], [0.0, np.inf], [], [1.0, 0.0]):
        with pytest.raises(ValueError, match="timepts: expected"):
            simulate(system, times, 1.0)


def test_progress_bar_shows(capfd):
    simulate(ct.tf([1.0], [1.0, 1.0]), np.linspace(0.0, 10.0, 20001), 1.0, limits={"progress": True})
    assert "simulated: 100%" in capfd.readouterr().err
