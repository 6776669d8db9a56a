"""The plants that ship with the toolbox against closed forms, and the vector algebra they are written in."""

import casadi as ca
import control as ct
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from phyfilter_ctl.plants import (
    Columns,
    cross,
    dot,
    mass,
    norm,
    rigid_body,
    rotate,
    rotate_back,
    skew,
    solve,
    stack,
    where,
)
from phyfilter_ctl.plants.algebra import quaternion_product, quaternion_rate, rotation_matrix

EXACT = 1e-13
# python-control's adaptive run at the tolerances below.
INTEGRATED = 1e-8
TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def run(block, t, inputs, initial_state):
    held = np.tile(np.asarray(inputs, dtype=float)[:, None], len(t))
    return ct.input_output_response(block, t, held, initial_state, solve_ivp_kwargs=TIGHT).states


def test_mass_reaches_its_terminal_speed():
    """m v' = F - c v^2: v = v_t tanh(F t/(m v_t)), r = (m/c) log cosh(F t/(m v_t)), v_t = sqrt(F/c)."""
    m, c, F = 2.0, 0.3, 5.0
    t = np.linspace(0.0, 6.0, 61)
    r, v = run(mass(1, mass=m, drag=c), t, [F], [0.0, 0.0])
    terminal = np.sqrt(F / c)
    np.testing.assert_allclose(v, terminal * np.tanh(F * t / (m * terminal)), atol=INTEGRATED)
    np.testing.assert_allclose(r, m / c * np.log(np.cosh(F * t / (m * terminal))), atol=10 * INTEGRATED)


def test_drag_acts_along_the_velocity():
    block = mass(3, mass=2.0, drag=0.5)
    v = np.array([3.0, 0.0, -4.0])
    rate = block.dynamics(0.0, np.concatenate([np.zeros(3), v]), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(rate, [*v, *(([1.0, 2.0, 3.0] - 0.5 * 5.0 * v) / 2.0)], rtol=EXACT)
    linear = block.linearize()  # at rest, where |v| v has slope 0
    np.testing.assert_allclose(linear.A[3:, 3:], np.zeros((3, 3)), atol=EXACT)
    np.testing.assert_allclose(linear.B[3:], 0.5 * np.eye(3), atol=EXACT)


def test_body_falls_and_is_held_up():
    body = rigid_body(mass=2.0, gravity=9.81)
    t = np.linspace(0.0, 1.0, 5)
    start = body.start_state
    start[3:6] = [1.0, 2.0, 3.0]
    states = run(body, t, np.zeros(6), start)
    expected = np.outer(start[3:6], t) - 0.5 * 9.81 * np.outer([0, 0, 1], t**2)
    np.testing.assert_allclose(states[:3], expected, atol=INTEGRATED)
    # Turned over about x, the thrust points down.
    start[6:10] = [0.0, 1.0, 0.0, 0.0]
    rate = body.dynamics(0.0, start, [0.0, 0.0, 19.62, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(rate[3:6], [0.0, 0.0, -19.62], atol=1e-12)


def test_symmetric_top_precesses():
    """Torque-free, J = (A, A, C): omega_xy turns at (C - A)/A omega_z in the body; momentum stays in the world."""
    A, C = 2.0, 3.0
    body = rigid_body(J=[A, A, C])
    t = np.linspace(0.0, 8.0, 41)
    start = body.start_state
    start[10:] = [0.4, 0.0, 2.0]
    states = run(body, t, np.zeros(6), start)
    turn = (C - A) / A * 2.0 * t
    np.testing.assert_allclose(states[10], 0.4 * np.cos(turn), atol=INTEGRATED)
    np.testing.assert_allclose(states[11], 0.4 * np.sin(turn), atol=INTEGRATED)
    np.testing.assert_allclose(states[12], 2.0, atol=INTEGRATED)
    np.testing.assert_allclose(np.linalg.norm(states[6:10], axis=0), 1.0, atol=INTEGRATED)
    attitude = Rotation.from_quat(states[[7, 8, 9, 6]].T)
    momentum = attitude.apply(states[10:].T * [A, A, C])
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(t), 1)), atol=10 * INTEGRATED)


def test_tumbling_keeps_energy_and_momentum():
    J = np.array([[3.0, 0.2, -0.1], [0.2, 2.0, 0.3], [-0.1, 0.3, 1.0]])
    body = rigid_body(J=J)
    start = body.start_state
    start[10:] = [0.1, 2.0, 0.2]  # about the middle axis: unstable
    states = run(body, np.linspace(0.0, 10.0, 21), np.zeros(6), start)
    omega = states[10:].T
    energy = 0.5 * np.einsum("ki,ij,kj->k", omega, J, omega)
    np.testing.assert_allclose(energy, energy[0], rtol=INTEGRATED)
    momentum = Rotation.from_quat(states[[7, 8, 9, 6]].T).apply(omega @ J)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (21, 1)), atol=10 * INTEGRATED)
    assert np.ptp(omega[:, 1]) > 3.0


def test_hover_linearises_to_double_integrators():
    body = rigid_body(mass=2.0, J=[0.1, 0.2, 0.3], gravity=9.81)
    linear = body.linearize(body.start_state, [0.0, 0.0, 19.62, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(linear.A[:3, 3:6], np.eye(3), atol=EXACT)
    # Tilted by a small angle = 2 q_v, the thrust accelerates sideways: v' = g (q_y, -q_x) 2.
    np.testing.assert_allclose(linear.A[3:5, 7:9], [[0.0, 19.62], [-19.62, 0.0]], atol=1e-12)
    np.testing.assert_allclose(linear.A[7:10, 10:], 0.5 * np.eye(3), atol=EXACT)
    np.testing.assert_allclose(linear.B[10:, 3:], np.diag([10.0, 5.0, 1.0 / 0.3]), atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: mass(0), "axes: expected at least 1"),
        (lambda: mass(mass=0.0), "mass: expected a finite number > 0, got 0"),
        (lambda: mass(drag=-1.0), "drag: expected 0 kg/m or more"),
        (lambda: rigid_body(J=[1.0, 1.0, -1.0]), "J: expected three positive moments"),
        (lambda: rigid_body(J=np.triu(np.ones((3, 3)))), "symmetric positive definite"),
        (lambda: rigid_body(J=[1.0, 1.0]), "J: expected"),
        (lambda: rigid_body(J=[1.0, np.nan, 1.0]), "J: expected"),
        (lambda: rigid_body(mass=-1.0), "mass: expected a finite number > 0"),
    ],
)
def test_bad_numbers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


RNG = np.random.default_rng(7)
V, W = RNG.normal(size=(2, 3))
Q, P = RNG.normal(size=(2, 4))
Q, P = Q / np.linalg.norm(Q), P / np.linalg.norm(P)
M = RNG.normal(size=(3, 3))
OPERATIONS = {
    "norm": (norm, (V,), np.linalg.norm(V)),
    "dot": (dot, (V, W), V @ W),
    "cross": (cross, (V, W), np.cross(V, W)),
    "skew": (lambda v, w: skew(v) @ w, (V, W), np.cross(V, W)),
    "solve": (solve, (M, V), np.linalg.inv(M) @ V),
    "stack": (lambda v: stack(1.0, v), (V,), [1.0, *V]),
    "where": (lambda v: where(v > 0.0, v, 2.0), (V,), np.where(V > 0.0, V, 2.0)),
    "product": (
        quaternion_product,
        (Q, P),
        (Rotation.from_quat(Q[[1, 2, 3, 0]]) * Rotation.from_quat(P[[1, 2, 3, 0]])).as_quat(),
    ),
    "rate": (quaternion_rate, (Q, V), None),
    "rotate": (rotate, (Q, V), Rotation.from_quat(Q[[1, 2, 3, 0]]).apply(V)),
    "rotate back": (rotate_back, (Q, V), Rotation.from_quat(Q[[1, 2, 3, 0]]).inv().apply(V)),
    "matrix": (lambda q, v: rotation_matrix(q) @ v, (Q, V), Rotation.from_quat(Q[[1, 2, 3, 0]]).apply(V)),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_algebra_is_the_same_in_numpy_and_casadi(name):
    function, arguments, expected = OPERATIONS[name]
    by_numpy = np.asarray(function(*arguments))
    symbols = [ca.SX.sym("s", *(part.shape if part.ndim == 2 else (len(part), 1))) for part in arguments]
    by_casadi = np.array(ca.Function("f", symbols, [function(*symbols)])(*arguments)).ravel()
    np.testing.assert_allclose(by_casadi, by_numpy.ravel(), atol=EXACT)
    if name == "product":  # scipy: scalar part last, sign free
        expected = np.roll(expected, 1)
        expected *= np.sign(expected @ by_numpy)
    if expected is not None:
        np.testing.assert_allclose(by_numpy, expected, atol=EXACT)


def test_quaternion_rate_is_the_derivative_of_the_attitude():
    """Attitude after a small turn, by scipy; and back to unit length from elsewhere."""
    step = 1e-6
    turned = (Rotation.from_quat(Q[[1, 2, 3, 0]]) * Rotation.from_rotvec(V * step)).as_quat()[[3, 0, 1, 2]]
    turned *= np.sign(turned @ Q)
    np.testing.assert_allclose((turned - Q) / step, quaternion_rate(Q, V), atol=1e-5)
    long = 1.1 * Q
    assert dot(long, quaternion_rate(long, V)) == pytest.approx(0.5 * 1.21 * (1.0 - 1.21))


def test_equations_may_be_run_on_numbers():
    """The same body of equations on numpy vectors, for whoever wants to step through it."""

    def drag(t, x, u, p):
        return {"v": (u.force - p.c * norm(x.v) * x.v) / p.m}

    views = [
        Columns(kind, values)
        for kind, values in (
            ("state", {"v": V}),
            ("input", {"force": W}),
            ("parameter", {"c": np.array(0.2), "m": np.array(2.0)}),
        )
    ]
    np.testing.assert_allclose(
        drag(np.array(0.0), *views)["v"], (W - 0.2 * np.linalg.norm(V) * V) / 2.0, rtol=EXACT
    )
    assert list(views[2]) == ["c", "m"]
