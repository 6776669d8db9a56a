"""Order and accuracy of the methods, by closed forms and by numbers with 40 digits."""

from math import factorial

import control as ct
import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.signal import cont2discrete, dlsim

from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.simulation import simulate
from phyfilter_ctl.simulation.flow import tables

# Sums of a few dozen rounded numbers of size 1.
ROUNDING = 1e-13
# A method of fourth order gains 16 when the step halves; at these steps its next term still shows.
FOURTH = (3.7, 4.3)


def order_of(error):
    """Slopes of log error over log step, where each step is half the one before."""
    return np.log2(np.array(error[:-1]) / np.array(error[1:]))


def test_fourth_order():
    """x' = -x^2 + t has a Riccati solution; a tight adaptive run of python-control stands for it."""
    system = ct.nlsys(
        lambda t, x, u, p: [-x[0] ** 2 - 3.0 * x[0] + t * x[1], -2.0 * x[1] + u[0] * np.cos(x[0])], None,
        inputs=1, outputs=2, states=2, name="system",
    )  # fmt: skip
    times = np.array([0.0, 2.0])
    exact = ct.input_output_response(
        system,
        times,
        [0.0, 2.0],
        [1.0, -1.0],
        solve_ivp_kwargs={"method": "DOP853", "rtol": 1e-13, "atol": 1e-14},
    ).states[:, -1]
    errors = [
        np.abs(
            simulate(system, times, [0.0, 2.0], [1.0, -1.0], method="rk4", max_step=0.1 / 2**i).states[:, -1] - exact
        ).max()
        for i in range(4)
    ]  # fmt: skip
    slopes = order_of(errors)
    assert FOURTH[0] < slopes[-1] < FOURTH[1], (errors, slopes)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_repeated_poles_exactly(order):
    times = np.linspace(0.0, 1.0, 21)
    response = simulate(ct.tf([50.0**order], np.poly([-50.0] * order)), times, 1.0)
    assert response.method == "exact"
    gone = np.exp(-50.0 * times) * sum((50.0 * times) ** k / factorial(k) for k in range(order))
    np.testing.assert_allclose(response.outputs, 1.0 - gone, atol=ROUNDING)


def test_stiff_chain_exactly():
    """Poles at -1e6, -1e3 and -1 under a sampled sine on straight lines, 20 steps of 50 ms: against 40 digits."""
    A = np.diag([-1e6, -1e3, -1.0]) + np.diag([1e6, 1e3], -1)
    system = ct.ss(A, [[1e6], [0.0], [0.0]], np.eye(3), np.zeros((3, 1)))
    times = np.linspace(0.0, 1.0, 21)
    u = np.sin(3.0 * times)
    ours = simulate(system, times, u, method="exact").states
    with mpmath.workdps(40):
        E, Q = mpmath.eig(mpmath.matrix(A.tolist()))
        exact = [mpmath.matrix(3, 1)]
        for k in range(20):
            h = mpmath.mpf(float(times[k + 1])) - mpmath.mpf(float(times[k]))
            u0, u1 = (mpmath.mpf(float(u[i])) for i in (k, k + 1))

            def phi(index, h=h):
                parts = [
                    mpmath.exp(e * h) - sum((e * h) ** j / mpmath.factorial(j) for j in range(index))
                    for e in E
                ]
                return Q * mpmath.diag([v / (e * h) ** index for v, e in zip(parts, E, strict=True)]) * Q**-1

            B = mpmath.matrix([1e6, 0, 0])
            exact.append(phi(0) * exact[-1] + h * phi(1) * B * u0 + h * phi(2) * B * (u1 - u0))
        exact = np.array([[float(v) for v in column] for column in exact]).T
    size = np.abs(exact).max(axis=1, keepdims=True)
    assert np.abs((ours - exact) / size).max() < ROUNDING


def test_linear_mimo_against_scipy():
    """Random stable system; scipy's first-order hold is exact for inputs on straight lines."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((6, 6)) - 4.0 * np.eye(6)
    B, C, D = rng.standard_normal((6, 2)), rng.standard_normal((3, 6)), rng.standard_normal((3, 2))
    times = 0.1 * np.arange(200)
    u = rng.standard_normal((200, 2))
    x0 = rng.standard_normal(6)
    discrete = cont2discrete((A, B, C, D), 0.1, method="foh")
    # scipy's state is x minus what the hold adds of the input now.
    _, y, _ = dlsim(discrete, u, t=times, x0=x0 - _foh_offset(A, B, 0.1) @ u[0])
    ours = simulate(ct.ss(A, B, C, D), times, u.T, x0)
    np.testing.assert_allclose(ours.outputs.T, y, atol=1e-11)


def _foh_offset(A, B, h):
    """phi_2(A h) B h by its series."""
    total, term = np.zeros_like(A), np.eye(len(A)) / 2.0
    for k in range(1, 40):
        total = total + term
        term = term @ A * h / (k + 2)
    return h * total @ B


def held(signal, factor=1.0):
    """x' = factor x + signal under a sampled gain -1."""
    plant = ct.nlsys(lambda t, x, u, p: [factor * x[0] + signal(t, x[0], u[0])], None, inputs="v", outputs="x",
                     states=1, name="plant")  # fmt: skip
    law = sampled_block(ct.ss([], [], [], [[-1.0]], 0.1, inputs="x", outputs="v", name="law"), name="law")
    return ct.interconnect([plant, law], inputs=None, outputs="x", name="loop")


@pytest.mark.parametrize(
    ("signal", "exact"),
    [
        (lambda t, x, v: 3.0 * v + 2.0 * t + 1.0, True),
        (lambda t, x, v: np.where(v < 0.5, 1.0, 2.0), False),
        (lambda t, x, v: np.where(x < 0.5, 1.0, 2.0), False),
        (lambda t, x, v: np.sign(x), False),
        (lambda t, x, v: v * x, False),
        (lambda t, x, v: v * t, False),
        (lambda t, x, v: np.sin(t), False),
        (lambda t, x, v: v**2, False),
    ],
)
def test_exact_is_for_affine_diagrams_only(signal, exact):
    """Jointly in states, time, inputs and held outputs; others are refused, and not taken by "auto"."""
    system = held(signal)
    times = np.linspace(0.0, 1.0, 21)
    assert (simulate(system, times, None, 0.3, backend="vm").method == "exact") is exact
    if not exact:
        with pytest.raises(ValueError, match=r"method='exact': loop is not affine .* take method='stiff'"):
            simulate(system, times, None, 0.3, method="exact")


def test_flow_under_a_sampled_law_by_hand():
    """x' = -2 x + 3 v + 2 t + 1 between instants, its solution written out; times fall between the instants too."""
    times = np.sort(np.concatenate([0.1 * np.arange(9), [0.033, 0.25, 0.712]]))
    ours = simulate(held(lambda t, x, v: 3.0 * v + 2.0 * t + 1.0, -2.0), times, None, 0.3).states[0]
    x, expected = 0.3, []
    for k in range(8):
        v, begin = -x, 0.1 * k

        def at(t, x=x, v=v, begin=begin):
            # A particular solution is t + 3 v / 2.
            return t + 1.5 * v + (x - begin - 1.5 * v) * np.exp(-2.0 * (t - begin))

        expected += [at(t) for t in times if begin - 1e-9 < t < begin + 0.1 - 1e-9]
        x = at(begin + 0.1)
    np.testing.assert_allclose(ours, [*expected, x], atol=ROUNDING)


def test_matrices_keep_uncoupled_states_apart():
    blocks = [ct.tf([1.0], [1.0, 1.0 + i], inputs="u", outputs=f"y{i}", name=f"lag{i}") for i in range(50)]
    system = flatten(ct.interconnect(blocks, inputs="u", outputs=[f"y{i}" for i in range(50)], name="many"))
    # Of each lag e^{A h}, and what the input before and after adds.
    assert tables(system, np.zeros(0), np.array([0.1])).columns.shape == (1, 50 * 3)
    times = np.linspace(0.0, 1.0, 11)
    rates = 1.0 + np.arange(50)[:, None]
    np.testing.assert_allclose(
        simulate(system, times, 1.0).outputs, (1.0 - np.exp(-rates * times)) / rates, atol=ROUNDING
    )


@pytest.mark.parametrize("rtol", [1e-4, 1e-7, 1e-10])
def test_adaptive_keeps_its_tolerance(rtol):
    """An oscillator over ten periods, at the ends of steps and inside them; kinks of the input are not stepped over."""
    system = ct.nlsys(
        lambda t, x, u, p: [x[1], u[0] - x[0] * (1.0 + 0.0 * x[1] ** 2)], None, inputs=1, outputs=2, states=2,
        name="oscillator",
    )  # fmt: skip
    times = np.sort(np.concatenate([np.linspace(0.0, 20.0 * np.pi, 50), np.arange(1.0, 62.0)]))
    free = simulate(system, times, 0.0, [1.0, 0.0], method="adaptive", rtol=rtol, atol=rtol)
    # The error of a step is kept; over 60 s it adds up.
    np.testing.assert_allclose(free.outputs[0], np.cos(times), atol=60.0 * rtol)
    corner = simulate(system, [0.0, 1.0, 2.0], [0.0, 1.0, 0.0], method="adaptive", rtol=rtol, atol=rtol)
    exact = 1.0 - np.sin(1.0)  # ramp t - sin t, at t = 1
    np.testing.assert_allclose(corner.outputs[0, 1], exact, atol=10.0 * rtol)
    np.testing.assert_allclose(corner.outputs[0, 2], np.array(2.0 - np.sin(2.0) - 2.0 * (1.0 - np.sin(1.0))),
                               atol=10.0 * rtol)  # fmt: skip


@pytest.mark.parametrize("method", ["rk4", "adaptive"])
def test_newton_inside(method):
    """A nonlinear algebraic loop e = r - g (y + y^3), y = x + e / 5, solved at every stage: RK4 by hand with brentq."""
    lag = ct.nlsys(lambda t, x, u, p: [-x[0] + u[0]], lambda t, x, u, p: [x[0] + 0.2 * u[0]], inputs="e", outputs="y",
                   states=1, name="lag")  # fmt: skip
    bend = ct.nlsys(None, lambda t, x, u, p: [u[1] - p["g"] * (u[0] + u[0] ** 3)], inputs=["y", "r"], outputs="e",
                    params={"g": 0.5}, name="bend")  # fmt: skip
    system = ct.InterconnectedSystem(
        [lag, bend], connections=[["lag.e", "bend.e"], ["bend.y", "lag.y"]], inplist=["bend.r"], outlist=["lag.y"],
        inputs="r", outputs="y", name="loop",
    )  # fmt: skip
    times = np.linspace(0.0, 1.0, 41)

    def error(t, x):
        def residual(e):
            y = x + 0.2 * e
            return e - (np.interp(t, times, np.sin(times)) - 0.5 * (y + y**3))

        return brentq(residual, -10.0, 10.0, xtol=1e-15, rtol=1e-14)

    x, y, h = 0.0, [], 0.025
    for t in times:
        y.append(x + 0.2 * error(t, x))
        k1 = error(t, x) - x
        k2 = error(t + h / 2, x + h / 2 * k1) - (x + h / 2 * k1)
        k3 = error(t + h / 2, x + h / 2 * k2) - (x + h / 2 * k2)
        k4 = error(t + h, x + h * k3) - (x + h * k3)
        x += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    ours = simulate(system, times, np.sin(times), method=method, max_step=h)
    # Newton stops at 1e-8 or finer; the adaptive run has another error than RK4.
    np.testing.assert_allclose(ours.outputs, y, atol=1e-8)


def test_straight_inputs_are_not_cut_into_pieces():
    system = ct.nlsys(lambda t, x, u, p: [u[0] - x[0] ** 3], None, inputs=1, outputs=1, states=1, name="soft")
    times = np.linspace(0.0, 1.0, 1001)
    straight = simulate(system, times, 0.1 + 0.7 * times, method="adaptive", backend="vm")
    assert straight.steps < 100
    wavy = simulate(system, times, np.sin(9.0 * times), method="adaptive", backend="vm")
    assert wavy.steps >= 1000
    coarse = simulate(system, times, 0.1 + 0.7 * times, method="adaptive", backend="vm", max_step=0.0005)
    assert coarse.steps >= 2000


@pytest.mark.parametrize("backend", ["vm", "numpy"])
def test_steps_of_several_lengths(backend):
    """Five lengths of steps, a set of matrices for each."""
    rng = np.random.default_rng(4)
    times = np.cumsum(rng.integers(1, 6, 300)) * 0.01
    response = simulate(ct.tf([9.0], [1.0, 2.0, 9.0]), times, 1.0, method="exact", backend=backend)
    t = times - times[0]
    w = np.sqrt(8.0)
    exact = 1.0 - np.exp(-t) * (np.cos(w * t) + np.sin(w * t) / w)
    np.testing.assert_allclose(response.outputs, exact, atol=ROUNDING)


@pytest.mark.parametrize(
    ("drive", "end"),
    [
        # x(1) = int_0^1 e^(s - 1) drive(s) ds; the input is u = 2 s.
        (lambda t, u: np.clip(u, -1.0, 1.0), 1.0 - 2.0 * (np.exp(-0.5) - np.exp(-1.0))),
        (lambda t, u: np.sin(40.0 * t), (np.sin(40.0) - 40.0 * np.cos(40.0) + 40.0 * np.exp(-1.0)) / 1601.0),
    ],
    ids=["saturated", "oscillating"],
)
def test_linear_states_behind_a_nonlinear_drive_are_integrated_to_tolerance(drive, end):
    """Between two times the drive is no straight line, though the states are linear."""
    lag = ct.nlsys(
        lambda t, x, u, params: [drive(t, u[0]) - x[0]], None, inputs=1, outputs=1, states=1, name="lag"
    )
    response = simulate(lag, [0.0, 1.0], [0.0, 2.0])
    assert response.outputs[-1] == pytest.approx(end, abs=1e-7)


def swing(t, x, u, p):
    return [x[1], u[0] - p["pull"] * np.sin(x[0]) - 0.2 * x[1]]


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
def test_one_step_from_kink_to_kink_keeps_the_tolerance(interpolation):
    """Of 250 kinks most are passed by one step; a burst in the middle and jumps of the input ask for more."""
    system = ct.nlsys(swing, None, inputs=1, outputs=2, states=2, params={"pull": 9.8}, name="swing")
    times = np.linspace(0.0, 5.0, 251)
    u = np.sin(times) + np.where(np.abs(times - 2.5) < 0.1, 500.0, 0.0) + np.sign(np.sin(3.0 * times))
    x, expected = np.array([0.4, 0.0]), [[0.4, 0.0]]
    for k in range(250):
        begin, end = times[k : k + 2]
        rise = (u[k + 1] - u[k]) / (end - begin) * (interpolation == "linear")
        solved = solve_ivp(
            lambda t, x, k=k, begin=begin, rise=rise: swing(t, x, [u[k] + rise * (t - begin)], {"pull": 9.8}),
            (begin, end), x, "DOP853", rtol=1e-11, atol=1e-11,
        )  # fmt: skip
        x = solved.y[:, -1]
        expected.append(x)
    for method in ("adaptive", "stiff"):
        ours = simulate(
            system, times, u, [0.4, 0.0], method=method, backend="vm", interpolation=interpolation, rtol=1e-8,
            atol=1e-10,
        )  # fmt: skip
        assert ours.steps > 260
        # The pendulum turns over at 100 rad/s: the error of its rate, 1e-8 of that, adds up over a second.
        np.testing.assert_allclose(ours.states.T, expected, rtol=1e-7, atol=2e-6)


def test_steps_from_node_to_node_count_as_steps():
    system = ct.nlsys(swing, None, inputs=1, outputs=2, states=2, params={"pull": 9.8}, name="swing")
    times = np.linspace(0.0, 20.0, 2001)
    free = simulate(system, times, np.sin(times), method="adaptive", backend="vm")
    short = simulate(
        system, times, np.sin(times), method="adaptive", backend="vm", limits={"max_steps": 1500}
    )
    assert free.steps < 2050
    assert not short.success
    assert 14.5 < short.failed_at < 15.0
    reached = times <= short.failed_at
    np.testing.assert_array_equal(short.states[:, reached], free.states[:, reached])
    fine = simulate(system, times, np.sin(times), method="adaptive", backend="vm", max_step=0.004)
    assert fine.steps >= 3 * 2000


def test_steps_in_blocks_are_those_one_by_one():
    """A growing, an undamped and a fast mode; 1,237 steps against powers of an exponential by SciPy."""
    A = np.array([[0.1, 0.3, 0.0], [0.0, 0.0, 4.0], [0.2, -4.0, -30.0]])
    B, start = np.array([[1.0], [0.5], [-2.0]]), np.array([1.0, -1.0, 0.5])
    times = 0.01 * np.arange(1238)
    u = np.random.default_rng(2).normal(size=1238)
    ours = simulate(ct.ss(A, B, np.eye(3), np.zeros((3, 1))), times, u, start)
    whole = np.zeros((5, 5))
    whole[:3, :3], whole[:3, 3:4], whole[3, 4] = A, B, 1.0
    power, x = expm(0.01 * whole), start
    for k in range(1238):
        np.testing.assert_allclose(ours.states[:, k], x, rtol=1e-11, atol=1e-11)
        if k < 1237:
            x = (power @ np.concatenate([x, [u[k], (u[k + 1] - u[k]) / 0.01]]))[:3]
