"""The stiff method: its order, published values, the exact solution of a heat equation, and when it is chosen."""

import control as ct
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import phyfilter_ctl as pf

# Order 5; at these steps the next term still shows.
FIFTH = (4.7, 5.4)
# Numbers of the test set for initial value problems (Mazzia, Magherini, University of Bari, release 2.4), problem
# ROBER at t = 1e11, by RADAU5 in quadruple precision.
ROBERTSON_END = (0.2083340149701255e-07, 0.8333360770334713e-13, 0.9999999791665050)


def van_der_pol(mu):
    return ct.nlsys(
        lambda t, x, u, p: [x[1], p["mu"] * (1 - x[0] ** 2) * x[1] - x[0]], None,
        inputs=1, outputs=2, states=["y", "v"], params={"mu": mu}, name="oscillator",
    )  # fmt: skip


def test_order():
    """Time, an input that runs straight and the states act on each other; a tight run of SciPy is the reference."""
    system = ct.nlsys(
        lambda t, x, u, p: [-x[0] ** 2 - 3.0 * x[0] + t * x[1], -2.0 * x[1] + u[0] * np.cos(x[0])], None,
        inputs=1, outputs=2, states=2, name="system",
    )  # fmt: skip
    exact = solve_ivp(
        lambda t, x: [-(x[0] ** 2) - 3 * x[0] + t * x[1], -2 * x[1] + t * np.cos(x[0])], [0, 2], [1.0, -1.0],
        method="DOP853", rtol=1e-13, atol=1e-14,
    ).y[:, -1]  # fmt: skip
    errors = []
    for steps in (32, 64, 128):
        # The tolerance lets every step pass.
        answer = pf.simulate(
            system,
            [0.0, 2.0],
            [0.0, 2.0],
            [1.0, -1.0],
            method="stiff",
            max_step=2.0 / steps,
            rtol=0.99,
            atol=1e3,
        )
        assert answer.steps <= steps + 3  # the first ones are short
        errors.append(float(np.abs(np.asarray(answer.states)[:, -1] - exact).max()))
    slope = np.log2(errors[0] / errors[2]) / 2  # over two halvings: parts of the error change their signs
    assert FIFTH[0] < slope < FIFTH[1], (errors, slope)


def robertson():
    return ct.nlsys(
        lambda t, x, u, p: [
            -0.04 * x[0] + 1e4 * x[1] * x[2],
            0.04 * x[0] - 1e4 * x[1] * x[2] - 3e7 * x[1] ** 2,
            3e7 * x[1] ** 2,
        ],
        None, inputs=1, outputs=3, states=3, name="robertson",
    )  # fmt: skip


def test_robertson():
    answer = pf.simulate(
        robertson(), [0.0, 40.0, 1e11], 0.0, [1.0, 0.0, 0.0], method="stiff", rtol=1e-9, atol=1e-20
    )
    assert answer.success
    # Eleven decades of time: an error of 1e-9 a step adds up to some 1e-8.
    np.testing.assert_allclose(answer.states[:, -1], ROBERTSON_END, rtol=1e-7)
    assert answer.states[:, 1].sum() == pytest.approx(1.0, abs=1e-12)  # mass


@pytest.mark.slow
def test_van_der_pol_between_its_steps():
    """Values inside the steps keep the tolerance too; SciPy's LSODA is the reference."""
    times = np.linspace(0.0, 1200.0, 25)
    answer = pf.simulate(van_der_pol(1000.0), times, 0.0, [2.0, 0.0], method="auto", rtol=1e-7, atol=1e-9)
    assert (answer.success, answer.method, answer.backend) == (True, "stiff", "vm")
    reference = solve_ivp(
        lambda t, x: [x[1], 1000 * (1 - x[0] ** 2) * x[1] - x[0]], [0, 1200], [2.0, 0.0], method="LSODA",
        t_eval=times, rtol=1e-11, atol=1e-13,
    )  # fmt: skip
    # The jump at 807 s turns an error of 1e-7 in time into one of x: away from it 1e-6 is left.
    np.testing.assert_allclose(answer.states[0], reference.y[0], atol=1e-6)


@pytest.mark.parametrize("n", [6, 16])
def test_heat_equation(n):
    """u' = u_xx by differences, by scalar instructions and by a sparse factorisation; modes decay in closed form."""
    h = 1.0 / (n + 1)
    A = (np.eye(n, k=1) - 2 * np.eye(n) + np.eye(n, k=-1)) / h**2
    grid = h * np.arange(1, n + 1)
    start = np.sin(np.pi * grid) + 0.5 * np.sin(3 * np.pi * grid)
    rate = [4 / h**2 * np.sin(k * np.pi * h / 2) ** 2 for k in (1, 3)]
    t = 0.3
    exact = np.exp(-rate[0] * t) * np.sin(np.pi * grid) + 0.5 * np.exp(-rate[1] * t) * np.sin(
        3 * np.pi * grid
    )
    answer = pf.simulate(
        ct.ss(A, np.zeros((n, 1)), np.eye(n), np.zeros((n, 1))),
        [0.0, t],
        0.0,
        start,
        method="stiff",
        rtol=1e-8,
    )
    np.testing.assert_allclose(answer.states[:, -1], exact, atol=1e-8)


def test_what_is_not_stiff_stays_explicit():
    answer = pf.simulate(van_der_pol(2.0), [0.0, 20.0], 0.0, [2.0, 0.0], backend="vm")
    assert answer.method == "adaptive"


def test_stiff_runs_in_the_virtual_machine_only():
    with pytest.raises(ValueError, match="method='stiff' runs in the virtual machine"):
        pf.simulate(van_der_pol(2.0), [0.0, 1.0], 0.0, method="stiff", backend="c")
