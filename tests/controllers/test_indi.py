"""INDI's force estimate against scipy's bilinear filters, PhyFilter with H's poles, and the incremental command."""

import casadi as ca
import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import bilinear, lfilter
from scipy.spatial.transform import Rotation

from phyfilter_ctl import PhyFilter, simulate, simulate_batch
from phyfilter_ctl.controllers import indi
from phyfilter_ctl.diagram import flatten

H, MASS, BANDWIDTH, DAMPING, GRAVITY = 0.002, 3.0, 30.0, 0.8, 9.81
OPTIONS = {"mass": MASS, "gravity": GRAVITY, "bandwidth": BANDWIDTH, "damping": DAMPING, "dt": H}
N = 600
# Forces of size 30 over a few hundred steps; scipy's direct form loses 1/(w h)^2 = 280 of rounding.
SAME = 1e-10
UPRIGHT = np.array([0.0, 0.0, GRAVITY])
LEVEL = np.tile([1.0, 0.0, 0.0, 0.0], (N, 1))


def by_block(a, q, g, **options):
    """f_hat at all instants, (N, 3), by the functions alone."""
    law = indi(**(OPTIONS | options)).law
    assert law is not None
    v = np.hstack([a, q, g])
    start, p = ([entry.start for entry in group] for group in (law.states, law.parameters))
    state, put_in = ca.SX.sym("s", len(start)), ca.SX.sym("v", v.shape[1])
    results = [function(0.0, state, put_in, p) for function in (law.dynamics, law.output)]
    _, outputs = ca.Function("both", [state, put_in], results).mapaccum(len(v))(start, v.T)
    return np.array(outputs).T


def H_of(signal):
    """H by Tustin's rule, from scipy, started at rest."""
    w = BANDWIDTH
    numerator, denominator = bilinear([w * w], [1.0, 2.0 * DAMPING * w, w * w], 1.0 / H)
    return lfilter(numerator, denominator, signal, axis=0)


def flight(seed=0):
    """Specific force, attitude and known force of any kind; and the acceleration they tell."""
    rng = np.random.default_rng(seed)
    a, g = rng.standard_normal((2, N, 3)) + UPRIGHT
    turns = Rotation.from_rotvec(np.cumsum(0.05 * rng.standard_normal((N, 3)), axis=0))
    q = np.roll(turns.as_quat(), 1, axis=1)  # scipy's scalar part is last
    return a, q, g, turns.apply(a) - UPRIGHT


def test_estimate_is_both_filters():
    a, q, g, acceleration = flight()
    out = by_block(a, q, g)
    np.testing.assert_allclose(out, H_of(MASS * acceleration) - H_of(g), rtol=0.0, atol=SAME)


def test_it_is_the_incremental_command():
    """m a_des - f_hat = H g + m (a_des - H v'): an increment on the force that acts, by equal filters."""
    a, q, g, acceleration = flight(1)
    wanted = np.random.default_rng(2).standard_normal((N, 3))
    incremental = H_of(g) + MASS * (wanted - H_of(acceleration))
    np.testing.assert_allclose(MASS * wanted - by_block(a, q, g), incremental, rtol=0.0, atol=SAME)


def test_it_is_the_filter_with_the_poles_of_h():
    """PhyFilter on m v, where v' is on straight lines between samples, so that its mean is that of the ends."""
    rng = np.random.default_rng(3)
    v_dot, g = np.cumsum(0.1 * rng.standard_normal((2, N, 3)), axis=1)
    v_dot[0] = g[0] = 0.0  # the filter has no sample before the first
    x = MASS * np.cumsum(np.vstack([np.zeros((1, 3)), 0.5 * H * (v_dot[1:] + v_dot[:-1])]), axis=0)
    F = PhyFilter([BANDWIDTH**2, 2.0 * DAMPING * BANDWIDTH], [BANDWIDTH**2, 0.0])
    out = by_block(v_dot + UPRIGHT, LEVEL, g)
    tustin = F.sampled(H, "tustin", "average").run(x, g)
    np.testing.assert_allclose(out, tustin, rtol=0.0, atol=SAME)
    exact = F.sampled(H, g="average").run(x, g)
    # Tustin moves the corner by (w h)^2/12 = 3e-4 of itself.
    assert 0.0 < np.abs(out - exact).max() < 1e-3 * np.abs(exact).max()


def test_constant_residual_exactly_and_ramp_with_its_lag():
    """1 - H has a zero at s = 0; a ramp of slope 1 lags by 2 damping/w, by Tustin's rule too."""
    times = H * np.arange(2000)
    level = np.tile([1.0, 0.0, 0.0, 0.0], (2000, 1))
    a = np.tile(UPRIGHT, (2000, 1))
    a[:, 0], a[:, 1] = 2.0 / MASS, times / MASS
    out = by_block(a, level, np.zeros((2000, 3)))[-1]
    assert abs(out[0] - 2.0) < SAME
    assert abs(times[-1] - out[1] - 2.0 * DAMPING / BANDWIDTH) < SAME
    assert abs(out[2]) < SAME


@settings(max_examples=60, deadline=None)
@given(st.floats(1e-4, 10.0), st.floats(1e-2, 1e4), st.floats(0.05, 5.0))
def test_stable_at_every_rate(period, bandwidth, damping):
    """Its poles are those of H by z = (1 + s h/2)/(1 - s h/2), inside the unit circle."""
    law = indi(mass=1.0, bandwidth=bandwidth, damping=damping, dt=period).law
    assert law is not None
    jacobian = law.dynamics.jacobian()
    p = [entry.start for entry in law.parameters]
    A = np.array(jacobian(0.0, np.zeros(6), [0, 0, 0, 1, 0, 0, 0, 0, 0, 0], p, np.zeros(6))[1])
    a_1, a_0 = -np.trace(A[::3, ::3]), np.linalg.det(A[::3, ::3])
    half = 0.5 * bandwidth * period
    leading = 1.0 + 2.0 * damping * half + half**2
    expected = [2.0 * (half**2 - 1.0), 1.0 - 2.0 * damping * half + half**2]
    np.testing.assert_allclose([a_1, a_0], np.array(expected) / leading, atol=1e-9)
    # The triangle of stable polynomials z^2 + a_1 z + a_0, open; to rounding at the slowest.
    assert abs(a_0) < 1.0 + 1e-12
    assert abs(a_1) < 1.0 + a_0 + 1e-12


@pytest.fixture(scope="module")
def flat():
    block = indi(**OPTIONS)
    diagram = ct.interconnect([block], inputs=block.input_labels, outputs=block.output_labels, name="diagram")
    return flatten(diagram)


def test_vm_is_c_is_the_law(flat):
    a, q, g, _ = flight(4)
    times = H * np.arange(N)
    u = np.hstack([a, q, g]).T
    in_vm, in_c = (simulate(flat, times, u, backend=backend) for backend in ("vm", "c"))
    assert in_c.backend == "c"
    np.testing.assert_allclose(in_c.outputs, in_vm.outputs, rtol=0.0, atol=SAME)
    np.testing.assert_allclose(in_vm.outputs.T, by_block(a, q, g), rtol=0.0, atol=SAME)


def test_parameters_tune_it_without_a_new_block(flat):
    a, q, g, _ = flight(5)
    u = np.hstack([a, q, g]).T
    changes = {"bandwidth": [5.0, 80.0], "mass": [2.0, 4.0], "damping": [0.5, 1.0], "gravity": [9.8, 1.6]}
    responses = simulate_batch(
        flat, H * np.arange(N), u, params={f"indi.{key}": values for key, values in changes.items()}
    )
    for i, response in enumerate(responses):
        expected = by_block(a, q, g, **{key: values[i] for key, values in changes.items()})
        np.testing.assert_allclose(response.outputs.T, expected, rtol=0.0, atol=SAME)


def test_in_a_linear_model_it_is_h_itself(flat):
    point = [*UPRIGHT, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    linear = flat.linearize(u0=point, params={"indi.bandwidth": 25.0})
    for omega in (1.0, 25.0, 300.0):
        s = 1j * omega
        expected = 25.0**2 / (s * s + 2.0 * DAMPING * 25.0 * s + 25.0**2)
        np.testing.assert_allclose(linear(s)[:, 7:], -expected * np.eye(3), atol=1e-12)
        np.testing.assert_allclose(linear(s)[:, :3], MASS * expected * np.eye(3), atol=1e-12)
        # A tilt turns the specific force: q[2] turns z to x, twice as far.
        np.testing.assert_allclose(linear(s)[0, 5], 2.0 * MASS * GRAVITY * expected, atol=1e-9)


@pytest.mark.parametrize("name", ["mass", "bandwidth", "damping", "dt"])
@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_bad_input(name, value):
    with pytest.raises(ValueError, match=f"{name}: expected a finite number > 0"):
        indi(**(OPTIONS | {name: value}))


def test_gravity_is_a_number():
    with pytest.raises(ValueError, match="gravity: expected a finite number"):
        indi(**(OPTIONS | {"gravity": np.inf}))
