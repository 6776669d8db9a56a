"""The L1 adaptive estimate against its predictor by matrix exponentials, closed forms and PhyFilter."""

import casadi as ca
import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from phyfilter_ctl import PhyFilter, simulate, simulate_batch
from phyfilter_ctl.controllers import l1_adaptive
from phyfilter_ctl.diagram import flatten

H, POLE, BANDWIDTH = 0.002, -5.0, 20.0
N = 400
# The same numbers in another order; (x_k - x_{k-1})/h magnifies the rounding of x (of size 1) by 500.
SAME = 1e-11


def by_block(x, known, **options):
    """f_hat at all instants, (N, n_x), by the functions alone."""
    settings = {"dt": H, "pole": POLE, "bandwidth": BANDWIDTH, "channels": x.shape[1]} | options
    law = l1_adaptive(**settings).law
    assert law is not None
    v = np.hstack([x, known])
    start = np.array([entry.start for entry in law.states])
    q = [entry.start for entry in law.parameters]
    state, put_in = ca.SX.sym("s", len(start)), ca.SX.sym("v", v.shape[1])
    results = [function(0.0, state, put_in, q) for function in (law.dynamics, law.output)]
    _, outputs = ca.Function("both", [state, put_in], results).mapaccum(len(v))(start, v.T)
    return np.array(outputs).T


def record(channels=3):
    rng = np.random.default_rng(0)
    x = 1.0 + 0.02 * np.cumsum(rng.standard_normal((N, channels)), axis=0)
    return x, rng.standard_normal((N, channels))


def moved_by(u, start=0.7):
    """x with (x_k - x_{k-1})/h = u_k, k >= 1, at g = 0."""
    return start + np.cumsum(np.concatenate([[0.0], H * u[1:]]))[:, None]


@pytest.mark.parametrize("between", ["hold", "average"])
def test_predictor_is_the_solution_of_its_equation(between):
    """x_hat' = g + sigma + pole (x_hat - x) with x' and the right-hand side constant, by expm of the whole."""
    x, g = record(1)
    x, g = x[:, 0], g[:, 0]
    # z = (x_hat, x, x', g + sigma)
    A = np.array([[POLE, -POLE, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0] * 4, [0.0] * 4])
    transition, phi = expm(A * H), (1.0 - np.exp(POLE * H)) / -POLE
    x_hat, sigma, f_hat, expected = x[0], 0.0, 0.0, [0.0]
    for k in range(1, N):
        known = g[k - 1] if between == "hold" else 0.5 * (g[k - 1] + g[k])
        x_hat = transition[0] @ [x_hat, x[k - 1], (x[k] - x[k - 1]) / H, known + sigma]
        sigma = -np.exp(POLE * H) * (x_hat - x[k]) / phi
        f_hat += (1.0 - np.exp(-BANDWIDTH * H)) * (sigma - f_hat)
        expected.append(f_hat)
    out = by_block(x[:, None], g[:, None], g=between)[:, 0]
    np.testing.assert_allclose(out, expected, rtol=0.0, atol=SAME)


@pytest.mark.parametrize("between", ["hold", "average"])
@pytest.mark.parametrize("pole", [-0.1, -5.0, -300.0])
def test_it_is_a_filter_of_order_one_a_little_low(between, pole):
    x, g = record()
    filtered = PhyFilter([BANDWIDTH]).sampled(H, g=between).run(x, g)
    low = np.exp(pole * H)
    np.testing.assert_allclose(by_block(x, g, pole=pole, g=between), low * filtered, rtol=0.0, atol=SAME)


def test_constant_residual_in_closed_form():
    """f_hat_k = exp(pole h) f (1 - exp(-bandwidth k h)); the bias is the law's own."""
    k = np.arange(N)
    out = by_block(moved_by(np.full(N, 3.0)), np.zeros((N, 1)))[:, 0]
    expected = np.exp(POLE * H) * 3.0 * -np.expm1(-BANDWIDTH * k * H)
    np.testing.assert_allclose(out, expected, rtol=0.0, atol=SAME)


def test_ramp_lags_by_the_inverse_of_the_bandwidth():
    times = H * np.arange(1000)
    u = np.concatenate([[0.0], times[1:] - 0.5 * H])  # means of f = t over the steps
    out = by_block(moved_by(u), np.zeros((1000, 1)))[-1, 0]
    lag = times[-1] - out / np.exp(POLE * H)
    assert abs(lag - 1.0 / BANDWIDTH) < 1.1 * BANDWIDTH * H**2 / 12.0


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-4, 0.5), st.floats(1e-3, 1e4), st.floats(1e-3, 1e4), st.integers(0, 100))
def test_never_larger_than_the_residual(period, speed, bandwidth, seed):
    """Stable at every rate: f_hat is a mean of past u_k with weights that add up to at most 1."""
    u = np.random.default_rng(seed).uniform(-1.0, 1.0, 60)
    u[0] = 0.0
    x = period * np.cumsum(u)[:, None]
    out = by_block(x, np.zeros((60, 1)), dt=period, pole=-speed, bandwidth=bandwidth)
    assert np.abs(out).max() <= np.abs(u).max() * (1.0 + 1e-9)


def mass_diagram(**options):
    """A mass in one dimension under a known and an unknown force; the block sees momentum and the known one."""
    body = ct.ss([[0.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], inputs=["g[0]", "f"], outputs=["x[0]"],
                 name="body")  # fmt: skip
    block = l1_adaptive(dt=H, pole=POLE, bandwidth=BANDWIDTH, channels=1, **options)
    return ct.interconnect([body, block], inputs=["g[0]", "f"], outputs=["x[0]", "f_hat[0]"], name="diagram")


@pytest.fixture(scope="module")
def flat():
    return flatten(mass_diagram(g="average"))


def test_vm_is_c(flat):
    times = H * np.arange(500)
    u = np.random.default_rng(3).standard_normal((2, 500))
    options = {"method": "rk4", "max_step": H}
    in_vm, in_c = (simulate(flat, times, u, [0.5], backend=backend, **options) for backend in ("vm", "c"))
    assert in_c.backend == "c"
    np.testing.assert_allclose(in_c.outputs, in_vm.outputs, rtol=0.0, atol=SAME)
    alone = by_block(in_vm.outputs[:1].T, u[:1].T, g="average")
    np.testing.assert_allclose(in_vm.outputs[1], alone[:, 0], rtol=0.0, atol=SAME)


def test_parameters_tune_it_without_a_new_block(flat):
    times = H * np.arange(300)
    u = np.random.default_rng(4).standard_normal((2, 300))
    tuned = simulate_batch(flat, times, u, params={"l1.bandwidth": [5.0, 50.0], "l1.pole": [-1.0, -50.0]})
    for response, bandwidth, pole in zip(tuned, (5.0, 50.0), (-1.0, -50.0), strict=True):
        x = response.outputs[:1].T
        expected = by_block(x, u[:1].T, pole=pole, bandwidth=bandwidth, g="average")
        np.testing.assert_allclose(response.outputs[1], expected[:, 0], rtol=0.0, atol=1e-9)


def test_in_a_linear_model_it_is_its_transfer_function(flat):
    linear = flat.linearize(params={"l1.bandwidth": 30.0})
    for omega in (0.5, 30.0, 400.0):
        s = 1j * omega
        # The known force cancels: what x tells of it is taken off.
        expected = np.exp(POLE * H) * 30.0 / (s + 30.0)
        np.testing.assert_allclose(linear(s)[1], [0.0, expected], atol=1e-12)


def test_response_to_a_sine_is_that_of_the_transfer_function(flat):
    times, omega = H * np.arange(3000), 10.0
    response = simulate(flat, times, [np.zeros(3000), np.sin(omega * times)])
    steady = slice(1500, None)
    parts = np.column_stack([np.sin(omega * times[steady]), np.cos(omega * times[steady])])
    real, imaginary = np.linalg.lstsq(parts, response.outputs[1, steady], rcond=None)[0]
    expected = np.exp(POLE * H) * BANDWIDTH / (1j * omega + BANDWIDTH)
    # Sampling costs second order in omega h: 4e-4/12 and 1.6e-3/12 of it.
    assert abs(real + 1j * imaginary - expected) < 3e-4


def test_held_g_does_not_act_at_once():
    law = l1_adaptive(dt=H, pole=POLE, bandwidth=BANDWIDTH).law
    smooth = l1_adaptive(dt=H, pole=POLE, bandwidth=BANDWIDTH, g="average").law
    assert law is not None
    assert smooth is not None
    assert law.feedthrough[:, :3].any()
    assert not law.feedthrough[:, 3:].any()
    assert smooth.feedthrough[:, 3:].any()


def test_a_copy_keeps_its_transfer_function():
    twin = l1_adaptive(dt=H, pole=POLE, bandwidth=BANDWIDTH, channels=1).copy("twin")
    diagram = ct.interconnect([twin], inputs=["x[0]", "g[0]"], outputs=["f_hat[0]"], name="alone")
    expected = -np.exp(POLE * H) * BANDWIDTH / (2j + BANDWIDTH)
    assert abs(flatten(diagram).linearize()(2j)[0, 1] - expected) < 1e-12


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"dt": 0.0}, "dt: expected a finite number > 0 s, got 0.0"),
        ({"bandwidth": -1.0}, "bandwidth: expected a finite number > 0 rad/s"),
        ({"pole": 5.0}, "pole: expected a negative number of rad/s, got 5.0"),
        ({"pole": np.nan}, "pole"),
        ({"channels": 0}, "channels: expected at least 1, got 0"),
        ({"g": "zoh"}, "g: expected one of"),
    ],
)
def test_bad_input(options, words):
    with pytest.raises(ValueError, match=words):
        l1_adaptive(**({"dt": H, "pole": POLE, "bandwidth": BANDWIDTH} | options))


def test_channels_are_a_number():
    with pytest.raises(TypeError, match=r"channels: expected a whole number, got 2\.5"):
        l1_adaptive(dt=H, pole=POLE, bandwidth=BANDWIDTH, channels=2.5)
