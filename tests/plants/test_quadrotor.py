"""The quadrotor against derivations of its own, its balances along runs, and what is refused."""

from itertools import pairwise

import control as ct
import numpy as np
import pytest
import sympy as sp
from scipy.spatial.transform import Rotation

import phyfilter_ctl as pf
from phyfilter_ctl.plants import allocation_matrix, quadrotor, wind_field

# Rounding of some tens of operations on numbers up to 100.
EXACT = 1e-12
# Central differences of step 1e-5: rounding 1e-9 on accelerations of 1e2 rad/s^2, third derivatives times 1e-10.
DIFFERENCE = 1e-6
# A method of order 4 divides its error by 16 when the step is halved; below 12 it would be of order 3.6.
ORDER_FOUR = (12.0, 22.0)
# C and the virtual machine evaluate the same expressions in another order, 1000 steps long.
COMPILED = 1e-10

G = 9.81
M, J = 3.0, np.array([0.035, 0.035, 0.06])
UNEQUAL = {
    "mass": 2.0,
    "J": [0.02, 0.03, 0.06],
    "drag": [0.8, 0.5, 0.2],
    "added_mass": 0.7,
    "torque_ratio": 0.02,
}
R, V, Q, OMEGA, ROTOR = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 17)


def attitude(q):
    """Matrix R of a quaternion (w, x, y, z), by scipy."""
    return Rotation.from_quat(np.roll(q, -1, axis=-1)).as_matrix()


def anywhere(rng):
    """State of 17 with a unit quaternion; inputs of 7 with thrusts within limits and without."""
    q = rng.normal(size=4)
    rotor = rng.uniform(0.0, 16.0, 4)
    x = np.concatenate([rng.normal(size=6), q / np.linalg.norm(q), 3.0 * rng.normal(size=3), rotor])
    return x, np.concatenate([rng.uniform(-5.0, 25.0, 4), 4.0 * rng.normal(size=3)])


def forces_of_rotors(rotor, arm, torque_ratio):
    """Thrust and torque from each rotor's place, one by one."""
    total, torque = np.zeros(3), np.zeros(3)
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]  # front left, and on counter-clockwise
    for (side_x, side_y), spin, thrust in zip(corners, [1, -1, 1, -1], rotor, strict=True):
        place = arm * np.array([side_x, side_y, 0.0]) / np.sqrt(2.0)
        total += [0.0, 0.0, thrust]
        torque += np.cross(place, [0.0, 0.0, thrust])
        torque[2] += spin * torque_ratio * thrust
    return total, torque


def by_matrices(x, u, mass, J, drag, added_mass, torque_ratio, arm=0.25, motor_lag=0.04, rotor_max=16.2):
    """Derivatives and outputs with rotation matrices and the whole inertia matrix."""
    turn, inertia, v, omega, wind = attitude(x[Q]), np.diag(J), x[V], x[OMEGA], u[4:]
    thrust, torque = forces_of_rotors(x[ROTOR], arm, torque_ratio)
    drag_matrix = turn @ np.diag(drag) @ turn.T
    down = np.array([0.0, 0.0, -G])
    acceleration = (turn @ thrust - drag_matrix @ (v - wind)) / (mass + added_mass) + down
    w, axis = x[Q][0], x[Q][1:]
    rates = np.concatenate([[-axis @ omega], w * omega + np.cross(axis, omega)]) / 2.0
    spin = np.linalg.inv(inertia) @ (torque - np.cross(omega, inertia @ omega))
    lag = (np.clip(u[:4], 0.0, rotor_max) - x[ROTOR]) / motor_lag
    outputs = [x, turn.T @ (acceleration - down), -added_mass * (acceleration - down), drag_matrix @ wind]
    return np.concatenate([v, acceleration, rates, spin, lag]), np.concatenate(outputs)


def run(block, t, inputs, start, **options):
    held = np.tile(np.asarray(inputs, dtype=float)[:, None], len(t))
    response = pf.simulate(block, t, held, start, backend="vm", **options)
    assert response.success, response.message
    return response.states.T


def test_equations_by_rotation_matrices():
    block = quadrotor(**UNEQUAL)
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, u = anywhere(rng)
        dx, y = by_matrices(x, u, **UNEQUAL)
        np.testing.assert_allclose(block.dynamics(0.0, x, u), dx, rtol=EXACT, atol=1e2 * EXACT)
        np.testing.assert_allclose(block.output(0.0, x, u), y, rtol=EXACT, atol=1e2 * EXACT)


def test_written_with_the_nominal_mass():
    """m v' = T R e_z - m g e_z - R D R' v + f_mass + f_wind, from the outputs, and a = R'(v' + g e_z)."""
    block = quadrotor(**UNEQUAL)
    rng = np.random.default_rng(2)
    for _ in range(20):
        x, u = anywhere(rng)
        rate, y = block.dynamics(0.0, x, u)[V], block.output(0.0, x, u)
        turn, up = attitude(x[Q]), np.array([0.0, 0.0, 1.0])
        known = (
            turn @ up * x[ROTOR].sum() - 2.0 * G * up - turn @ (np.array(UNEQUAL["drag"]) * (turn.T @ x[V]))
        )
        np.testing.assert_allclose(2.0 * rate, known + y[20:23] + y[23:26], rtol=EXACT, atol=10 * EXACT)
        np.testing.assert_allclose(turn @ y[17:20], rate + G * up, rtol=EXACT, atol=10 * EXACT)
        np.testing.assert_allclose(y[20:23], -0.7 * (rate + G * up), rtol=EXACT, atol=10 * EXACT)


@pytest.mark.slow
def test_rotation_by_lagrange_in_euler_angles():
    """d/dt dL/d(angles') - dL/d(angles) = W' tau with L = omega' J omega/2, omega = W(angles) angles', by SymPy."""
    roll, pitch, yaw = angles = sp.symbols("roll pitch yaw")
    rates = sp.Matrix(sp.symbols("droll dpitch dyaw"))
    turn = sp.rot_axis3(-yaw) * sp.rot_axis2(-pitch) * sp.rot_axis1(-roll)
    columns = []
    for angle in angles:  # R' dR/d(angle) is the skew matrix of that column of W
        S = sp.simplify(turn.T * turn.diff(angle))
        columns.append(sp.Matrix([S[2, 1], S[0, 2], S[1, 0]]))
    W = sp.Matrix.hstack(*columns)
    omega = W * rates
    energy = (omega.T * sp.diag(*UNEQUAL["J"]) * omega)[0] / 2
    momenta = sp.Matrix([energy]).jacobian(rates).T
    bias = momenta.jacobian(angles) * rates - sp.Matrix([energy]).jacobian(angles).T
    drift = omega.jacobian(angles) * rates  # W' angles'
    evaluate = sp.lambdify([angles, rates], [momenta.jacobian(rates), bias, W, drift])

    block = quadrotor(**UNEQUAL)
    rng = np.random.default_rng(3)
    for _ in range(10):
        now, rate = rng.uniform(-1.2, 1.2, 3), rng.normal(size=3)
        H, C, W_now, W_drift = evaluate(now, rate)
        x, u = anywhere(rng)
        x[Q] = np.roll(Rotation.from_euler("ZYX", now[::-1]).as_quat(), 1)
        x[OMEGA] = W_now @ rate
        _, torque = forces_of_rotors(x[ROTOR], 0.25, 0.02)
        acceleration = np.linalg.solve(H, W_now.T @ torque - np.ravel(C))
        expected = W_now @ acceleration + np.ravel(W_drift)
        np.testing.assert_allclose(block.dynamics(0.0, x, u)[OMEGA], expected, rtol=1e-10, atol=1e-10)


def test_allocation_is_each_rotor_at_its_place():
    A = allocation_matrix(0.3, 0.02)
    for i, column in enumerate(A.T):
        thrust, torque = forces_of_rotors(np.eye(4)[i], 0.3, 0.02)
        np.testing.assert_allclose(column, [thrust[2], *torque], rtol=EXACT)
    np.testing.assert_allclose(np.linalg.inv(A) @ A, np.eye(4), atol=EXACT)
    block = quadrotor()
    x, u = anywhere(np.random.default_rng(4))
    x[OMEGA] = 0.0
    wrench = allocation_matrix(0.25, 0.016) @ x[ROTOR]
    np.testing.assert_allclose(block.dynamics(0.0, x, u)[OMEGA] * J, wrench[1:], rtol=1e-10)
    assert block.output(0.0, x, np.zeros(7))[19] * M == pytest.approx(
        wrench[0] - 0.9 * (attitude(x[Q]).T @ x[V])[2]
    )


def test_starts_in_hover_and_stays():
    block = quadrotor()
    assert block.dynamics(
        0.0, block.start_state, np.r_[np.full(4, M * G / 4.0), np.zeros(3)]
    ) == pytest.approx(np.zeros(17), abs=EXACT)
    response = pf.simulate(block, [0.0, 1.0], backend="vm")  # the default of the command is hover thrust
    np.testing.assert_allclose(response.states[:, -1], block.start_state, atol=EXACT)
    assert response.outputs[19, -1] == pytest.approx(G)  # an accelerometer at rest
    half = quadrotor(mass=1.5)
    assert half.start_state[ROTOR] == pytest.approx(np.full(4, 1.5 * G / 4.0))
    assert [entry.name for entry in block.functions.inputs] == [
        *(f"thrust[{i}]" for i in range(4)),
        *(f"wind[{i}]" for i in range(3)),
    ]


def test_free_fall_keeps_its_momentum_but_for_gravity():
    """Tumbling, without thrust and drag: v = v_0 - g t, which is linear and so exact for any step."""
    block = quadrotor(drag=[0.0, 0.0, 0.0])
    start = block.start_state
    start[V], start[OMEGA], start[ROTOR] = [1.0, 2.0, 3.0], [4.0, -3.0, 5.0], 0.0
    t = np.linspace(0.0, 2.0, 21)
    states = run(block, t, np.zeros(7), start, method="rk4", max_step=0.02)
    np.testing.assert_allclose(states[:, V], start[V] - np.outer(t, [0.0, 0.0, G]), atol=EXACT * 100)
    np.testing.assert_allclose(states[:, 2], 3.0 * t - G * t**2 / 2.0, atol=EXACT * 100)


def balances(step):
    """Largest defects of energy and of torque-free angular momentum with steps of that length."""
    t = np.arange(0.0, 1.0 + step / 2.0, step)
    block = quadrotor(**UNEQUAL)
    start = block.start_state
    start[V], start[OMEGA], start[ROTOR] = [2.0, -1.0, 0.5], [3.0, -4.0, 2.0], [2.0, 6.0, 9.0, 4.0]
    wind = np.array([3.0, -2.0, 1.0])
    states = run(block, t, [8.0, 7.5, 8.2, 7.9, *wind], start, method="rk4", max_step=step)
    turn, v, omega = attitude(states[:, Q]), states[:, V], states[:, OMEGA]
    weight, inertia = 2.7, np.array(UNEQUAL["J"])
    energy = weight * (np.sum(v**2, axis=1) / 2.0 + G * states[:, 2]) + omega**2 @ inertia / 2.0
    wrench = states[:, ROTOR] @ allocation_matrix(0.25, 0.02).T
    through_air = np.einsum("kji,kj->ki", turn, v - wind)
    drag_force = -np.einsum("kij,kj->ki", turn, through_air * UNEQUAL["drag"])
    thrust_force = wrench[:, :1] * turn[:, :, 2]
    power = np.sum((thrust_force + drag_force) * v, axis=1) + np.sum(wrench[:, 1:] * omega, axis=1)
    work = step / 3.0 * (power[:-2:2] + 4.0 * power[1:-1:2] + power[2::2])  # Simpson, of order 4 too
    energy_defect = np.abs(energy[2::2] - energy[0] - np.cumsum(work)).max()

    start[ROTOR] = 0.0
    states = run(block, t, np.zeros(7), start, method="rk4", max_step=step)
    momentum = np.einsum("kij,kj->ki", attitude(states[:, Q]), states[:, OMEGA] * inertia)
    return np.array([energy_defect, np.abs(momentum - momentum[0]).max()])


def test_energy_and_angular_momentum_balance_to_the_order_of_the_method():
    coarse, fine = balances(0.01), balances(0.005)
    # Energy of 30 J, momentum of 0.2 N m s.
    assert (fine < [1e-5, 2e-9]).all()
    assert (coarse / fine > ORDER_FOUR[0]).all()


def test_runge_kutta_converges_with_order_four():
    block = quadrotor(**UNEQUAL)
    start = block.start_state
    start[V], start[OMEGA], start[ROTOR] = [2.0, -1.0, 0.5], [3.0, -4.0, 2.0], [2.0, 6.0, 9.0, 4.0]
    inputs, t = [8.0, 7.5, 8.2, 7.9, 3.0, -2.0, 1.0], np.array([0.0, 0.8])
    exact = run(block, t, inputs, start, method="adaptive", rtol=1e-12, atol=1e-13)[-1]
    errors = [
        np.abs(run(block, t, inputs, start, method="rk4", max_step=step)[-1] - exact).max()
        for step in (0.01, 0.005, 0.0025)
    ]
    for coarse, fine in pairwise(errors):
        assert ORDER_FOUR[0] < coarse / fine < ORDER_FOUR[1]


def test_gyroscopic_term_turns_a_tilted_spin():
    """Torque-free, J = (A, A, C): omega_xy turns at (C - A)/A omega_z in the body."""
    block = quadrotor(gravity=0.0, drag=[0.0, 0.0, 0.0])
    start = block.start_state
    start[OMEGA] = [0.5, 0.0, 3.0]
    t = np.linspace(0.0, 2.0, 21)
    omega = run(block, t, np.zeros(7), start, method="adaptive", rtol=1e-10, atol=1e-12)[:, OMEGA]
    turn = (J[2] - J[0]) / J[0] * 3.0 * t
    np.testing.assert_allclose(omega[:, 0], 0.5 * np.cos(turn), atol=1e-8)
    np.testing.assert_allclose(omega[:, 1], 0.5 * np.sin(turn), atol=1e-8)
    np.testing.assert_allclose(omega[:, 2], 3.0, atol=1e-8)


def test_drag_gives_a_terminal_speed_and_carries_along_with_the_wind():
    """v_z' = -g - (d/m) v_z without thrust; v_x -> the wind with time constant m/d in hover, where nothing tilts."""
    block = quadrotor(mass=2.0, drag=[0.8, 0.8, 4.0], added_mass=0.5)
    start = block.start_state
    start[ROTOR] = 0.0
    t = np.linspace(0.0, 3.0, 31)
    fall = run(block, t, np.zeros(7), start, method="adaptive", rtol=1e-10, atol=1e-12)
    terminal = 2.5 * G / 4.0
    np.testing.assert_allclose(fall[:, 5], -terminal * (1.0 - np.exp(-4.0 / 2.5 * t)), atol=1e-8)
    drift = run(block, t, [*np.full(4, 2.5 * G / 4.0), 3.0, 0.0, 0.0], block.start_state, rtol=1e-10)
    np.testing.assert_allclose(drift[:, 3], 3.0 * (1.0 - np.exp(-0.8 / 2.5 * t)), atol=1e-8)


def test_motors_lag_and_saturate():
    block = quadrotor()
    t = np.linspace(0.0, 0.2, 11)
    rotor = run(block, t, [10.0, 30.0, -5.0, 0.0, 0.0, 0.0, 0.0], block.start_state, rtol=1e-11)[:, ROTOR]
    for i, end in enumerate([10.0, 16.2, 0.0, 0.0]):
        expected = end + (M * G / 4.0 - end) * np.exp(-t / 0.04)
        np.testing.assert_allclose(rotor[:, i], expected, atol=1e-8)


def test_linearises_to_central_differences():
    block = quadrotor(**UNEQUAL)
    rng = np.random.default_rng(5)
    for _ in range(3):
        x, u = anywhere(rng)
        u[:4] = [8.0, 3.0, 20.0, -1.0]  # within limits and beyond them, away from the kinks
        linear = block.linearize(x, u)
        z = np.concatenate([x, u])
        slopes = {"state": [], "output": []}
        for i in range(24):
            up, down = (z + sign * 1e-5 * np.eye(24)[i] for sign in (1.0, -1.0))
            for kind, function in (("state", block.dynamics), ("output", block.output)):
                ends = [function(0.0, point[:17], point[17:]) for point in (up, down)]
                slopes[kind].append((ends[0] - ends[1]) / 2e-5)
        np.testing.assert_allclose(
            np.hstack([linear.A, linear.B]), np.transpose(slopes["state"]), atol=DIFFERENCE
        )
        np.testing.assert_allclose(
            np.hstack([linear.C, linear.D]), np.transpose(slopes["output"]), atol=DIFFERENCE
        )


def test_parameters_vary_from_run_to_run():
    """A batch over the added mass: the rotors at hover thrust, it sags with dm g/(m + dm)."""
    extra = np.array([-0.5, 0.0, 0.6])
    runs = pf.simulate_batch(
        quadrotor(drag=[0.0, 0.0, 0.0]), [0.0, 1.0], params={"added_mass": extra}, backend="vm"
    )
    sag = [float(response.states[2, -1]) for response in runs]
    np.testing.assert_allclose(sag, -extra / (M + extra) * G / 2.0, atol=1e-8)


def test_virtual_machine_and_c_fly_the_same_in_a_windy_diagram():
    drone = quadrotor(added_mass=0.5)
    field = wind_field(
        mean=[1.0, 0.5, 0.0], jet_speed=4.0, jet_origin=[-1.0, 0.2, 0.0], turbulence=0.2, jet_width=1.0
    )
    diagram = ct.interconnect(
        [drone, field],
        inputs=[*drone.input_labels[:4], *field.input_labels[3:]],
        outputs=[*drone.output_labels, *field.output_labels],
        name="windy",
    )
    t = np.linspace(0.0, 2.0, 1001)
    noise = np.random.default_rng(6).normal(size=(3, len(t)))
    inputs = [*np.array([8.6, 8.58, 8.6, 8.59])[:, None] * np.ones(len(t)), *noise]
    options = {"method": "rk4", "max_step": 0.002, "interpolation": "hold"}
    by_vm, by_c = (pf.simulate(diagram, t, inputs, backend=backend, **options) for backend in ("vm", "c"))
    np.testing.assert_allclose(by_c.states, by_vm.states, atol=COMPILED)
    np.testing.assert_allclose(by_c.outputs, by_vm.outputs, atol=COMPILED)
    assert by_vm.states[0, -1] > 0.5  # blown along


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"mass": -1.0}, "mass: expected a finite number > 0 kg, got -1"),
        ({"added_mass": -3.0}, "added_mass: expected more than -3 kg"),
        ({"added_mass": float("nan")}, "added_mass: expected more than"),
        ({"added_mass": 4.0}, "rotor_max: expected at least 17.17 N.*cannot carry"),
        ({"rotor_max": 5.0}, "rotor_max: expected at least 7.357 N"),
        ({"rotor_max": 0.0}, "rotor_max: expected a finite number > 0"),
        ({"J": [0.1, 0.1]}, "J: expected"),
        ({"J": [0.1, 0.1, 0.0]}, "J: expected three moments of inertia in kg m.2, positive"),
        ({"drag": [0.1, -0.1, 0.0]}, "drag: expected three drag coefficients"),
        ({"drag": 0.9}, "drag: expected shape"),
        ({"arm": 0.0}, "arm: expected a finite number > 0 m"),
        ({"torque_ratio": -0.1}, "torque_ratio: expected a finite number > 0"),
        ({"motor_lag": 0.0}, "motor_lag: expected a finite number > 0 s"),
        ({"gravity": -9.81}, "gravity: expected 0 m/s.2 or more"),
    ],
)
def test_bad_numbers_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        quadrotor(**given)


def test_allocation_without_inverse_is_refused():
    with pytest.raises(ValueError, match="torque_ratio: expected a finite number > 0 m, got 0"):
        allocation_matrix(0.25, 0.0)
