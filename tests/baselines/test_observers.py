"""Observers against their differential equations in python-control and in closed form, and refusals."""

from __future__ import annotations

import control as ct
import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl.baselines.observers import (
    DisturbanceObserver,
    Evolver,
    FeedbackNeuralNetwork,
    LinearESO,
    SeerII,
)

Array = NDArray[np.float64]

DT = 0.01
GAIN = 8.0
# Both sides integrate the same equation in double precision, states of size gain * |x|.
SAME = 1e-10
# Closed forms of one exponential.
CLOSED = 1e-12
# x is taken straight between samples of a curve and the integral by trapezia: some h^2 = 4e-6 of signals of size 1.
SECOND_ORDER = 1e-5
TIMED = (DisturbanceObserver, LinearESO, FeedbackNeuralNetwork, Evolver)


def simulated(A: Array, B: Array, C: Array, D: Array, inputs: Array, start: Array) -> Array:
    """python-control's simulation, inputs (N, m) straight between samples: first channel of the output."""
    t = DT * np.arange(len(inputs))
    # python-control's default 0.0 makes inputs and state floats to the type checker.
    system = ct.ss(A, B, C, D)
    response = ct.forced_response(system, t, inputs.T, start, squeeze=True)  # type: ignore[arg-type]  # as said
    return np.asarray(response.outputs)


def record(n: int = 300, seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return 0.05 * np.cumsum(rng.standard_normal(n)), np.cumsum(0.1 * rng.standard_normal(n))


# In these tests g is constant: held or straight between samples, it is then the same.


def test_disturbance_observer_is_its_equation() -> None:
    x, _ = record()
    g = np.full_like(x, 0.7)
    one = np.ones((1, 1))
    inputs = np.column_stack([x, g])
    wanted = simulated(
        -GAIN * one, np.array([[-(GAIN**2), -GAIN]]), one, np.array([[GAIN, 0.0]]), inputs, -GAIN * x[:1]
    )
    f_hat = DisturbanceObserver(GAIN, DT).run(x[:, None], g[:, None])[:, 0]
    np.testing.assert_allclose(f_hat, wanted, atol=SAME)


def test_linear_eso_is_its_equation() -> None:
    x, _ = record(seed=1)
    g = np.full_like(x, -0.3)
    A = np.array([[-2.0 * GAIN, 1.0], [-(GAIN**2), 0.0]])
    B = np.array([[2.0 * GAIN, 1.0], [GAIN**2, 0.0]])
    inputs = np.column_stack([x, g])
    wanted = simulated(A, B, np.array([[0.0, 1.0]]), np.zeros((1, 2)), inputs, np.array([x[0], 0.0]))
    f_hat = LinearESO(GAIN, DT).run(x[:, None], g[:, None])[:, 0]
    np.testing.assert_allclose(f_hat, wanted, atol=SAME)


def test_feedback_neural_network_is_its_equation() -> None:
    x, _ = record(seed=2)
    g, f_theta = np.full_like(x, 0.2), np.full_like(x, -1.1)
    B = np.array([[GAIN, 1.0, 1.0]])
    C, D = np.array([[-GAIN]]), np.array([[GAIN, 0.0, 1.0]])
    inputs = np.column_stack([x, g, f_theta])
    wanted = simulated(np.array([[-GAIN]]), B, C, D, inputs, x[:1])
    f_hat = FeedbackNeuralNetwork(GAIN, DT).run(x[:, None], g[:, None], f_theta=f_theta[:, None])[:, 0]
    np.testing.assert_allclose(f_hat, wanted, atol=SAME)


def test_evolver_is_its_equation() -> None:
    x, _ = record(seed=3)
    g, slope = np.full_like(x, 0.2), np.full_like(x, 1.5)
    B, D = np.array([[-(GAIN**2), -GAIN, 1.0]]), np.array([[GAIN, 0.0, 0.0]])
    inputs = np.column_stack([x, g, slope])
    wanted = simulated(np.array([[-GAIN]]), B, np.eye(1), D, inputs, 0.4 - GAIN * x[:1])
    f_hat = Evolver(GAIN, DT).run(x[:, None], g[:, None], slope=slope[:, None], f_theta0=[0.4])[:, 0]
    np.testing.assert_allclose(f_hat, wanted, atol=SAME)


def test_seer_ii_is_its_equation() -> None:
    # One basis function s = x, Xi Phi(t) = 2 constant: the integral is 2 (x - x(0)), straight between samples.
    x, _ = record(seed=4)
    g = np.full_like(x, 0.1)
    B, D = np.array([[-(GAIN**2) - 2.0 * GAIN, -GAIN]]), np.array([[GAIN + 2.0, 0.0]])
    inputs = np.column_stack([x - x[0], g])
    wanted = simulated(np.array([[-GAIN]]), B, np.eye(1), D, inputs, np.array([2.0 * x[0]]))
    weights = np.full((len(x), 1, 1), 2.0)
    f_hat = SeerII(GAIN, DT).run(
        x[:, None], g[:, None], basis=x[:, None], weights=weights, weight_slopes=np.zeros_like(weights)
    )[:, 0]
    np.testing.assert_allclose(f_hat, wanted, atol=SAME)


def test_seer_ii_sums_the_path_not_the_antiderivative() -> None:
    # s = sin t, Xi Phi = cos t: the integral along the path grows like t / 2, Xi Phi s does not; f_hat stays true.
    t = 0.002 * np.arange(20_001)[:, None]
    f = np.sin(t) * np.cos(t)
    x = 0.5 * np.sin(t) ** 2
    run = SeerII(GAIN, 0.002).run
    weights, slopes = np.cos(t)[:, :, None], -np.sin(t)[:, :, None]
    f_hat = run(x, basis=np.sin(t), weights=weights, weight_slopes=slopes)
    np.testing.assert_allclose(f_hat, f, atol=SECOND_ORDER)
    counted_twice = run(x, basis=np.sin(t), weights=weights, weight_slopes=2.0 * slopes)
    assert np.max(np.abs(counted_twice - f)) > 0.05


@pytest.mark.parametrize("kind", TIMED)
def test_irregular_times_on_the_grid_and_off_it(kind: type) -> None:
    x, g = record(200, seed=5)
    x, g = np.column_stack([x, -x]), np.column_stack([g, g])
    observer = kind(GAIN, DT, g="average")
    np.testing.assert_allclose(observer.run(x, g, times=DT * np.arange(200)), observer.run(x, g), atol=1e-9)
    # A sample put in the middle of a step of straight x and constant g changes nothing elsewhere.
    still = np.zeros_like(g)
    times = np.insert(DT * np.arange(200.0), 100, 99.5 * DT)
    finer = np.insert(x, 100, 0.5 * (x[99] + x[100]), axis=0)
    got = np.delete(observer.run(finer, np.insert(still, 100, 0.0, axis=0), times=times), 100, axis=0)
    np.testing.assert_allclose(got, observer.run(x, still), atol=1e-9)


def test_one_sample_and_one_step() -> None:
    for kind in TIMED:
        assert kind(GAIN, DT).run([[3.0]]).tolist() == [[0.0]]
        assert kind(GAIN, DT).run([[3.0], [3.0]]) == pytest.approx(0.0, abs=CLOSED)


def test_evolver_follows_a_named_jump_at_once() -> None:
    x = np.zeros((50, 1))
    jumps = np.zeros_like(x)
    jumps[20] = 2.0
    f_hat = Evolver(GAIN, DT).run(x, jumps=jumps)[:, 0]
    t = DT * np.arange(30)
    assert np.all(f_hat[:20] == 0.0)
    np.testing.assert_allclose(f_hat[20:], 2.0 * np.exp(-GAIN * t), atol=CLOSED)
    weights = np.zeros((50, 1, 1))
    other = SeerII(GAIN, DT).run(x, basis=x, weights=weights, weight_slopes=weights, jumps=jumps)
    np.testing.assert_allclose(other[:, 0], f_hat, atol=CLOSED)


@pytest.mark.parametrize("kind", [*TIMED, SeerII])
@pytest.mark.parametrize(("gain", "dt"), [(0.0, 0.1), (-1.0, 0.1), (np.inf, 0.1), (1.0, 0.0), (1.0, np.nan)])
def test_options_out_of_range(kind: type, gain: float, dt: float) -> None:
    with pytest.raises(ValueError, match=r"finite number > 0|positive sampling interval"):
        kind(gain, dt)


def test_wrong_signals_are_named() -> None:
    x = np.zeros((5, 2))
    observer = Evolver(GAIN, DT)
    with pytest.raises(ValueError, match=r"expected one of .*hold.*average"):
        Evolver(GAIN, DT, g="linear")  # type: ignore[arg-type]  # the value under test
    with pytest.raises(ValueError, match=r"expected one of .*hold.*average"):
        FeedbackNeuralNetwork(GAIN, DT, f_theta="linear")  # type: ignore[arg-type]  # likewise
    with pytest.raises(ValueError, match=r"g: expected shape \(5, 2\)"):
        observer.run(x, np.zeros((5, 1)))
    with pytest.raises(ValueError, match=r"slope: expected shape"):
        observer.run(x, slope=np.zeros(5))
    with pytest.raises(ValueError, match=r"slope: .* got nan in row 3"):
        observer.run(x, slope=np.where(np.arange(10).reshape(5, 2) == 7, np.nan, 0.0))
    with pytest.raises(TypeError, match="jumps: expected an array of real numbers"):
        observer.run(x, jumps=np.full((5, 2), "a"))
    with pytest.raises(ValueError, match="x: expected finite numbers"):
        observer.run(np.full((5, 2), np.inf))
    with pytest.raises(ValueError, match=r"row 2 .*stands still"):
        observer.run(x, times=[0.0, 0.1, 0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"f_theta0: expected shape \(2,\)"):
        observer.run(x, f_theta0=[1.0])
    weights = np.zeros((5, 2, 3))
    with pytest.raises(ValueError, match=r"basis: expected shape \(5, p\)"):
        SeerII(GAIN, DT).run(x, basis=np.zeros((4, 3)), weights=weights, weight_slopes=weights)
    with pytest.raises(ValueError, match=r"weights: expected shape \(5, 2, 4\)"):
        SeerII(GAIN, DT).run(x, basis=np.zeros((5, 4)), weights=weights, weight_slopes=weights)
