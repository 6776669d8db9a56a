"""What ``control.input_output_response`` takes, ``simulate`` takes: the same arguments, the same numbers."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import flatten, sampled_block, simulate, simulate_batch

T = np.linspace(0.0, 1.0, 11)
U = np.sin(3.0 * T)
EXACT = {"solve_ivp_kwargs": {"rtol": 1e-10, "atol": 1e-12}}
# Both have error control far below; numbers are of size 1.
CLOSE = 1e-6

OSCILLATOR = ct.ss([[0.0, 1.0], [-4.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0, name="oscillator")
THREE = ct.ss(-np.eye(3), np.ones((3, 1)), np.eye(3), 0.0, name="three")


def lags(**sizes):
    return ct.nlsys(
        lambda t, x, u, params: [u[0] - x[0], x[0] - x[1] ** 3],
        lambda t, x, u, params: [x[1], u[0]],
        name="lags",
        **sizes,
    )


def same(system, times, *arguments, **keywords):
    """The two responses; how ct is to integrate is its own business."""
    ivp = EXACT if ct.isctime(system) else {}
    expected = ct.input_output_response(system, times, *arguments, **keywords, **ivp)
    at, squeeze = keywords.pop("t_eval", None), keywords.pop("squeeze", None)
    found = simulate(system, times if at is None else (times, at), *arguments, **keywords)
    found = found if squeeze is None else found(squeeze=squeeze)
    np.testing.assert_allclose(found.time, expected.time, rtol=1e-12)
    assert found.outputs.shape == expected.outputs.shape
    np.testing.assert_allclose(found.outputs, expected.outputs, atol=CLOSE)
    np.testing.assert_allclose(found.inputs, expected.inputs, atol=CLOSE)
    if system.nstates != 0:
        np.testing.assert_allclose(found.states, expected.states, atol=CLOSE)
    return found


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_an_estimator_corrects_or_predicts(dt):
    plant = ct.c2d(OSCILLATOR, dt) if dt else OSCILLATOR
    estimator = ct.create_estimator_iosystem(plant, np.eye(1), 0.1 * np.eye(1), G=np.array([[0.0], [1.0]]))
    arguments = (T, [np.cos(T), U], [1.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    responses = [same(estimator, *arguments, params={"correct": correct}) for correct in (True, False)]
    assert np.abs(responses[0].outputs - responses[1].outputs).max() > 0.1
    flat = flatten(estimator, params={"correct": False})
    np.testing.assert_array_equal(
        simulate(flat, *arguments, params={"correct": False}).outputs, responses[1].outputs
    )
    with pytest.raises(ValueError, match=r"correct: the model was made with False.* got True; .*flatten"):
        simulate(flat, *arguments, params={"correct": True})
    with pytest.raises(ValueError, match="no parameter is called corect"):
        simulate(estimator, *arguments, params={"corect": False})


def test_what_is_no_number_goes_over_the_blocks_own():
    block = ct.nlsys(
        lambda t, x, u, params: u - x if params["kind"] == "lag" else u,
        None,
        inputs=1,
        outputs=1,
        states=1,
        params={"kind": "lag"},
        name="block",
    )
    assert same(block, T, U, params={"kind": "integrator"}).outputs[-1] > same(block, T, U).outputs[-1]
    loop = ct.interconnect(
        [block, OSCILLATOR], connections=[["oscillator", "block"]], inplist="block", outlist="oscillator"
    )
    same(loop, T, U, params={"kind": "integrator"})


def test_what_is_no_number_reaches_into_a_sampled_diagram():
    step = ct.nlsys(
        lambda t, x, u, params: u if params.get("fast", True) else 0.5 * (x + u),
        None,
        inputs=1,
        outputs=1,
        states=1,
        dt=0.1,
        name="step",
    )
    gain = ct.ss([], [], [], [[2.0]], 0.1, name="gain")
    law = ct.interconnect(
        [gain, step], connections=[["step", "gain"]], inplist="gain", outlist="step", name="law"
    )
    block = sampled_block(law, name="law")
    fast, slow = (simulate(block, T, 1.0, params={"fast": fast}).outputs[-1] for fast in (True, False))
    np.testing.assert_allclose([fast, slow], [2.0, 2.0 - 2.0 * 0.5**10], rtol=1e-12)


@pytest.mark.parametrize(
    "sizes",
    [{}, {"states": 2}, {"inputs": 1, "outputs": 2}, {"states": 2, "outputs": 2}, {"inputs": ["force"]}],
    ids=str,
)
def test_sizes_left_open_are_those_of_what_is_given(sizes):
    same(lags(**sizes), T, U[None], [0.5, 0.2])


def test_sizes_that_nothing_tells():
    assert simulate(ct.nlsys(lambda t, x, u, params: u - x, None), T, U).outputs.shape == (1, 11)
    with pytest.raises(
        ValueError, match="block lags: the number of its outputs is not set, and its output function"
    ):
        simulate(lags(), T, U)  # no start is one state, and it has two
    with pytest.raises(ValueError, match="block lags: the numbers of inputs, outputs and states are not set"):
        simulate(lags(), T, U, {"x": 1.0})


@pytest.mark.parametrize("spacing", [1.0, 0.3])
@pytest.mark.parametrize("kind", ["function", "linear", "diagram"])
def test_an_unknown_sampling_interval_is_that_of_the_times(kind, spacing):
    linear = ct.ss([[0.5]], [[1.0]], [[1.0]], 0.0, True, name="linear")
    function = ct.nlsys(
        lambda t, x, u, params: 0.5 * x + u + 0.1 * t,
        None,
        inputs=1,
        outputs=1,
        states=1,
        dt=True,
        name="function",
    )
    diagram = ct.interconnect(
        [function, linear], connections=[["linear", "function"]], inplist="function", outlist="linear"
    )
    system = {"function": function, "linear": linear, "diagram": diagram}[kind]
    same(system, spacing * np.arange(11), U)
    with pytest.raises(
        ValueError, match=r"timepts: expected two times or more, evenly spaced, .*0\.1 to 0\.2 s apart"
    ):
        simulate(system, [0.0, 0.1, 0.3], 1.0)
    assert system.dt is True


@pytest.mark.parametrize("start", [[1.0], [1.0, 2.0], [[1.0], 2.0]])
def test_a_shorter_start_is_filled_with_zeros_and_a_warning(start):
    with pytest.warns(UserWarning, match="too short; padding with zeros"):
        expected = ct.input_output_response(THREE, T, U, start, **EXACT)
    with pytest.warns(UserWarning, match="initial_state: . of 3 states are given, the others start at 0"):
        found = simulate(THREE, T, U, start)
    np.testing.assert_allclose(found.states, expected.states, atol=CLOSE)


def test_a_start_that_ends_in_0_is_filled_silently():
    same(THREE, T, U, [1.0, 0.0])


STATIC = ct.ss([], [], [], [[2.0]])


@pytest.mark.parametrize(
    "system", [THREE, lags(inputs=1, outputs=2, states=2), STATIC], ids=["linear", "function", "static"]
)
@pytest.mark.parametrize("at", [[0.05, 0.3, 0.95], [0.3], np.linspace(0.0, 1.0, 28), T[3:5]], ids=len)
def test_the_response_at_times_of_its_own(system, at):
    """Between those of the inputs, on some of them, off one by rounding."""
    same(system, T, U, t_eval=np.asarray(at))


def test_a_discrete_response_at_times_of_its_own():
    lag = ct.ss([[0.5]], [[1.0]], [[1.0]], 0.0, 0.1)
    same(lag, np.array([0.0, 1.0]), np.array([1.0, 3.0]), t_eval=0.1 * np.arange(11))
    with pytest.raises(ValueError, match="timepts: expected the sampling interval"):
        simulate(lag, (T, [0.0, 0.2]), U)


def test_held_inputs_are_held_between_times_too():
    lag = ct.tf([1.0], [1.0, 1.0])
    dense = simulate(lag, np.linspace(0.0, 1.0, 41), np.repeat(U, 4)[:41], interpolation="hold")
    found = simulate(lag, (T, dense.time), U, interpolation="hold")
    np.testing.assert_allclose(found.outputs, dense.outputs, atol=CLOSE)


def test_a_batch_has_times_of_its_own_too():
    at = [0.05, 0.3, 0.95]
    runs = simulate_batch(THREE, (T, at), U, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert runs.states.shape == (2, 3, 3)
    single = simulate(THREE, (T, at), U, [0.0, 1.0, 0.0])
    np.testing.assert_allclose(runs.states[1], single.states, atol=CLOSE)


def test_times_beyond_those_of_the_inputs_are_refused():
    for at in ([-0.1, 0.5], [0.5, 1.1]):
        with pytest.raises(ValueError, match="timepts: expected times of the response from 0 to 1 s"):
            simulate(THREE, (T, at), U)


def test_a_batch_corrects_too():
    estimator = ct.create_estimator_iosystem(OSCILLATOR, np.eye(1), np.eye(1), G=np.array([[0.0], [1.0]]))
    starts = np.array([[1.0, 0.0, 1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 1.0, 0.0, 0.0, 1.0]])
    runs = simulate_batch(estimator, T, [np.cos(T), U], starts, params={"correct": False})
    for run, start in zip(runs, starts, strict=True):
        single = simulate(estimator, T, [np.cos(T), U], start, params={"correct": False})
        np.testing.assert_allclose(run.outputs, single.outputs, atol=CLOSE)
