"""The aerial manipulator against other ways to its accelerations, its balances along runs, and what is refused."""

from itertools import pairwise

import control as ct
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.plants import (
    Link,
    SerialArm,
    aerial_manipulator,
    coupling_force,
    coupling_torque,
    quadrotor,
    rigid_body,
    small_arm,
)
from phyfilter_ctl.plants.coupling import payload_motion

# Rounding of some thousand operations on forces and accelerations up to 1e3.
EXACT = 1e-10
# Central differences of step 1e-5: rounding 1e-9 on accelerations of 1e3, third derivatives times 1e-10.
DIFFERENCE = 1e-5
# A method of order 4 divides its error by 16 when the step is halved; below 12 it would be of order 3.6.
ORDER_FOUR = (12.0, 22.0)
# C and the virtual machine evaluate the same expressions in another order, 500 steps long.
COMPILED = 1e-10

G, M, J = 9.81, 2.55, np.diag([0.035, 0.035, 0.06])
UP = np.array([0.0, 0.0, 1.0])
ARM = small_arm()
VEHICLE = aerial_manipulator()
UNEQUAL = {"mass": 2.0, "J": (0.02, 0.03, 0.06), "drag": (0.8, 0.5, 0.2), "torque_ratio": 0.02}
R, V, Q, OMEGA, ROTOR = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13), slice(13, 17)
JOINT, RATE = slice(17, 22), slice(22, 27)
INPUTS = np.array([entry.start for entry in VEHICLE.functions.inputs])


def attitude(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1)).as_matrix()


def anywhere(rng, plant=VEHICLE):
    """State with a unit quaternion, inputs with a load."""
    x = rng.normal(size=len(plant.start_state))
    x[Q] /= np.linalg.norm(x[Q])
    x[OMEGA] *= 2.0
    x[ROTOR] = rng.uniform(0.0, 16.0, 4)
    n = (len(x) - 17) // 2
    u = np.concatenate(
        [rng.uniform(-5.0, 25.0, 4), 4.0 * rng.normal(size=3), x[17 : 17 + n], rng.normal(size=n)]
    )
    u[7 : 7 + n] += 0.1 * rng.normal(size=n)
    return x, np.append(u, rng.uniform(0.0, 0.5))


def outputs(plant, x, u, **params):
    values = plant.output(0.0, x, u, params=params)
    names = {}
    for label, value in zip(plant.output_labels, values, strict=True):
        names.setdefault(label.split("[")[0], []).append(value)
    return {name: np.array(entries) for name, entries in names.items()}


def wrench(rotor, arm=0.25, torque_ratio=0.016):
    """Thrust and torque from each rotor's place, one by one: front left, and on counter-clockwise."""
    places = arm / np.sqrt(2.0) * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    torque = sum(np.cross(place, thrust * UP) for place, thrust in zip(places, rotor, strict=True))
    return rotor.sum() * UP, torque + torque_ratio * (rotor @ [1, -1, 1, -1]) * UP


def arm_motion(x, dx):
    """Motion of the arm at a state with derivative."""
    return ARM.motion(x[JOINT], x[RATE], joint_acceleration=dx[RATE])


# -- accelerations ----------------------------------------------------------------------------------------------------


def missing(rates, x, bodies, inertia, force, torque):
    """What the six equations of a platform of 2 kg miss for accelerations (v', omega')."""
    omega = x[OMEGA]
    own = {"q": x[Q], "omega": omega, "v_rate": rates[:3], "omega_rate": rates[3:]}
    f = force - 2.0 * (rates[:3] + G * UP)
    tau = torque - inertia @ rates[3:] - np.cross(omega, inertia @ omega)
    for body in bodies:
        f, tau = f + coupling_force(body, **own), tau + coupling_torque(body, **own)
    return np.concatenate([f, tau])


def test_accelerations_solve_the_six_equations():
    """The matrix of the six equations by probing, and LU; the plant eliminates down to three."""
    plant = aerial_manipulator(**UNEQUAL)
    inertia, drag = np.diag(UNEQUAL["J"]), np.array(UNEQUAL["drag"])
    rng = np.random.default_rng(1)
    for _ in range(10):
        x, u = anywhere(rng)
        dx = plant.dynamics(0.0, x, u)
        motion, turn = arm_motion(x, dx), attitude(x[Q])
        load = payload_motion(u[-1], motion)
        force, torque = wrench(x[ROTOR], torque_ratio=0.02)
        force = turn @ (force - drag * (turn.T @ (x[V] - u[4:7])))

        known = (x, (motion, load), inertia, force, torque)
        at_rest = missing(np.zeros(6), *known)
        matrix = np.column_stack([at_rest - missing(unit, *known) for unit in np.eye(6)])
        expected = np.linalg.solve(matrix, at_rest)
        np.testing.assert_allclose(np.concatenate([dx[V], dx[OMEGA]]), expected, rtol=EXACT, atol=EXACT)


@pytest.mark.parametrize("nominal", [(None, None), (3.0, (0.05, 0.06, 0.07))])
def test_balance_in_nominal_mass_and_inertia(nominal):
    plant = aerial_manipulator(**UNEQUAL, nominal=nominal)
    m = nominal[0] or UNEQUAL["mass"]
    inertia, drag = np.array(nominal[1] or UNEQUAL["J"]), np.array(UNEQUAL["drag"])
    rng = np.random.default_rng(2)
    for _ in range(20):
        x, u = anywhere(rng)
        dx, y, turn = plant.dynamics(0.0, x, u), outputs(plant, x, u), attitude(x[Q])
        force, torque = wrench(x[ROTOR], torque_ratio=0.02)
        known = turn @ (force - drag * (turn.T @ x[V])) - m * G * UP
        unknown = y["f_coupling"] + y["f_payload"] + y["f_wind"]
        np.testing.assert_allclose(m * dx[V], known + unknown, atol=EXACT)
        gyroscopic = np.cross(x[OMEGA], inertia * x[OMEGA])
        np.testing.assert_allclose(
            inertia * dx[OMEGA], torque - gyroscopic + y["tau_coupling"] + y["tau_payload"], atol=EXACT
        )
        np.testing.assert_allclose(y["f_wind"], turn @ (drag * (turn.T @ u[4:7])), atol=EXACT)
        np.testing.assert_allclose(y["a"], turn.T @ (dx[V] + G * UP), atol=EXACT)


def test_coupling_outputs_are_the_coupling_functions():
    x, u = anywhere(np.random.default_rng(3))
    dx, y = VEHICLE.dynamics(0.0, x, u), outputs(VEHICLE, x, u)
    where = {"q": x[Q], "omega": x[OMEGA], "v_rate": dx[V], "omega_rate": dx[OMEGA]}
    motion = arm_motion(x, dx)
    np.testing.assert_allclose(y["f_coupling"], coupling_force(motion, **where), atol=EXACT)
    np.testing.assert_allclose(y["tau_coupling"], coupling_torque(motion, **where), atol=EXACT)
    # The load's force pulls at the tip.
    turn = attitude(x[Q])
    np.testing.assert_allclose(y["tau_payload"], np.cross(motion.tip, turn.T @ y["f_payload"]), atol=EXACT)


def test_load_is_a_heavier_last_link():
    """A point mass welded to the tip: mass, centre and inertia of the last link by the parallel-axis theorem."""
    load, last = 0.3, ARM.links[-1]
    total = last.mass + load
    centre = (last.mass * last.centre + load * last.offset) / total
    inertia = last.inertia.copy()
    for m, place in ((last.mass, last.centre - centre), (load, last.offset - centre)):
        inertia += m * (place @ place * np.eye(3) - np.outer(place, place))
    heavy = Link(last.axis, last.offset, total, centre, inertia, lower=last.lower, upper=last.upper)
    other = aerial_manipulator(arm=SerialArm([*ARM.links[:-1], heavy], ARM.mount, home=ARM.home))
    rng = np.random.default_rng(4)
    for _ in range(5):
        x, u = anywhere(rng)
        loaded, empty = np.append(u[:-1], load), np.append(u[:-1], 0.0)
        np.testing.assert_allclose(
            VEHICLE.dynamics(0.0, x, loaded), other.dynamics(0.0, x, empty), rtol=EXACT, atol=EXACT
        )


def test_locked_arm_is_one_rigid_body():
    """Composite mass and inertia in phyfilter_ctl's rigid body, whose point is the common centre of mass."""
    rng = np.random.default_rng(5)
    for _ in range(5):
        x, u = anywhere(rng)
        x[RATE], u[7:12], u[12:17], u[-1] = 0.0, x[JOINT], 0.0, 0.0
        lower, upper = ARM.limits
        x[JOINT] = u[7:12] = np.clip(x[JOINT], lower, upper)
        dx = VEHICLE.dynamics(0.0, x, u)
        np.testing.assert_allclose(dx[RATE], 0.0, atol=EXACT)
        turn, omega = attitude(x[Q]), x[OMEGA]
        total, moment = M + ARM.mass, ARM.mass * np.asarray(ARM.centre_of_mass(x[JOINT]))
        c = moment / total
        inertia = J + ARM.inertia(x[JOINT]) - total * (c @ c * np.eye(3) - np.outer(c, c))
        force, torque = wrench(x[ROTOR])
        force = force - 0.9 * (turn.T @ (x[V] - u[4:7]))
        body = rigid_body(mass=total, J=inertia, gravity=G)
        state = np.concatenate([x[R], x[V], x[Q], omega])
        rate = body.dynamics(0.0, state, np.concatenate([force, torque - np.cross(c, force)]))
        np.testing.assert_allclose(dx[OMEGA], rate[10:], rtol=EXACT, atol=EXACT)
        central = dx[V] + turn @ (np.cross(dx[OMEGA], c) + np.cross(omega, np.cross(omega, c)))
        np.testing.assert_allclose(central, rate[3:6], rtol=EXACT, atol=EXACT)


def test_without_weight_in_the_arm_it_is_the_quadrotor():
    links = [Link(link.axis, link.offset, 1e-12, link.centre, 1e-12 * np.ones(3)) for link in ARM.links]
    plant, drone = aerial_manipulator(arm=SerialArm(links), mass=3.0), quadrotor()
    x, u = anywhere(np.random.default_rng(6))
    rate = plant.dynamics(0.0, x, np.append(u[:-1], 0.0))
    np.testing.assert_allclose(rate[:17], drone.dynamics(0.0, x[:17], u[:7]), rtol=1e-8, atol=1e-8)


def test_end_effector_moves_as_its_velocity_says():
    x, u = anywhere(np.random.default_rng(7))
    dx, h = VEHICLE.dynamics(0.0, x, u), 1e-6
    ahead, behind = (outputs(VEHICLE, x + side * h * dx, u)["r_e"] for side in (1, -1))
    np.testing.assert_allclose(outputs(VEHICLE, x, u)["v_e"], (ahead - behind) / (2 * h), atol=1e-8)
    tip = x[R] + attitude(x[Q]) @ ARM.end_effector(x[JOINT])
    np.testing.assert_allclose(outputs(VEHICLE, x, u)["r_e"], tip, atol=EXACT)


def test_linearisation_is_that_of_central_differences():
    x, u = anywhere(np.random.default_rng(8))
    linear, h = VEHICLE.linearize(x, u), 1e-5

    def differences(function, point):
        units = h * np.eye(len(point))
        return np.column_stack([(function(point + d) - function(point - d)) / (2 * h) for d in units])

    for matrix, function, point in (
        (linear.A, lambda z: VEHICLE.dynamics(0.0, z, u), x),
        (linear.B, lambda z: VEHICLE.dynamics(0.0, x, z), u),
        (linear.C, lambda z: VEHICLE.output(0.0, z, u), x),
        (linear.D, lambda z: VEHICLE.output(0.0, x, z), u),
    ):
        np.testing.assert_allclose(matrix, differences(function, point), rtol=DIFFERENCE, atol=DIFFERENCE)


# -- balances along runs ----------------------------------------------------------------------------------------------


def momentum(x):
    """Linear momentum, and angular momentum about the common centre of mass, world."""
    turn, omega = attitude(x[Q]), x[OMEGA]
    motion = ARM.motion(x[JOINT], x[RATE])
    linear = (M + ARM.mass) * x[V] + ARM.mass * turn @ (
        np.cross(omega, motion.centre) + motion.centre_velocity
    )
    about_platform = turn @ ((J + motion.inertia) @ omega + motion.momentum)
    about_platform += ARM.mass * np.cross(turn @ motion.centre, x[V])
    centre = ARM.mass * turn @ motion.centre / (M + ARM.mass)
    return linear, about_platform - np.cross(centre, linear)


def energy(x):
    turn, omega = attitude(x[Q]), x[OMEGA]
    centre = np.asarray(ARM.centre_of_mass(x[JOINT]))
    swing = turn @ np.cross(omega, centre)
    kinetic = 0.5 * (M + ARM.mass) * x[V] @ x[V] + ARM.mass * x[V] @ swing
    kinetic += 0.5 * omega @ (J + ARM.inertia(x[JOINT])) @ omega
    return kinetic + G * ((M + ARM.mass) * x[2] + ARM.mass * (turn @ centre)[2])


def falling(step, **start):
    """States at 0 ... 0.4 s without thrust and drag, tumbling, the joints on their way to other angles."""
    x, u = VEHICLE.start_state, INPUTS.copy()
    x[ROTOR], x[OMEGA], u[:4] = 0.0, [2.0, -1.0, 3.0], 0.0
    u[7:12] += start.get("turn", np.zeros(5))
    return pf.simulate(
        VEHICLE,
        np.linspace(0.0, 0.4, 3),
        u.tolist(),
        x,
        params={"drag": np.zeros(3)},
        method="rk4",
        max_step=step,
        backend="vm",
    ).states.T


def test_momentum_is_kept_in_free_fall_while_the_arm_moves():
    turn = np.array([0.25, 0.2, -0.25, 0.2, 0.25])
    steps, errors = (0.01, 0.005, 0.0025), []
    for step in steps:
        states = falling(step, turn=turn)
        (start, spin), (end, end_spin) = momentum(states[0]), momentum(states[-1])
        fallen = start - (M + ARM.mass) * G * 0.4 * UP
        errors.append((np.abs(end - fallen).max(), np.abs(end_spin - spin).max()))
    moved = np.abs(states[-1, JOINT] - states[0, JOINT])
    assert moved.min() > 0.1
    assert np.abs(states[-1, OMEGA] - states[0, OMEGA]).max() > 0.1
    for coarse, fine in pairwise(np.array(errors)):
        assert (coarse / fine > ORDER_FOUR[0]).all()
        assert (coarse / fine < ORDER_FOUR[1]).all()
    assert np.max(errors[-1]) < 1e-6


def test_energy_is_kept_with_a_locked_arm():
    errors = [abs(energy(states[-1]) - energy(states[0])) for states in map(falling, (0.04, 0.02, 0.01))]
    for coarse, fine in pairwise(errors):
        assert coarse / fine > ORDER_FOUR[0]
    assert errors[-1] < 1e-5


def test_energy_comes_from_thrust_and_goes_into_drag():
    """Locked arm; derivative of the energy along the motion against the power of the forces."""
    rng, h = np.random.default_rng(9), 1e-6
    for _ in range(5):
        x, u = anywhere(rng)
        lower, upper = ARM.limits
        x[RATE], u[12:17], u[-1] = 0.0, 0.0, 0.0
        x[JOINT] = u[7:12] = np.clip(x[JOINT], lower, upper)
        dx = VEHICLE.dynamics(0.0, x, u)
        rise = (energy(x + h * dx) - energy(x - h * dx)) / (2 * h)
        force, torque = wrench(x[ROTOR])
        drag = -0.9 * (x[V] - u[4:7])
        power = (attitude(x[Q]) @ force + drag) @ x[V] + torque @ x[OMEGA]
        assert rise == pytest.approx(power, rel=1e-6, abs=1e-6)


# -- servos, start, compiled ------------------------------------------------------------------------------------------


def arm_run(times, reference, rate_reference=None, **params):
    inputs = [np.full(len(times), value) for value in INPUTS]
    inputs[7] = ARM.home[0] + np.broadcast_to(reference, len(times))
    if rate_reference is not None:
        inputs[12] = rate_reference
    run = pf.simulate(VEHICLE, times, np.array(inputs), params=params, rtol=1e-10, atol=1e-12)
    assert run.success
    return run.states[JOINT.start] - ARM.home[0], run.states[RATE.start]


@pytest.mark.slow
def test_servo_is_a_second_order_lag():
    """Critically damped step and, with the rate fed forward, a sine behind by (w_r/w)^2 only."""
    times = np.linspace(0.0, 0.3, 31)
    joint, _ = arm_run(times, 0.1)
    np.testing.assert_allclose(joint, 0.1 * (1.0 - (1.0 + 40.0 * times) * np.exp(-40.0 * times)), atol=1e-8)
    times = np.linspace(0.0, 3.0, 1501)
    joint, _ = arm_run(times, 0.3 * np.sin(4.0 * times), 1.2 * np.cos(4.0 * times))
    late = times > 1.0
    miss = np.abs(joint - 0.3 * np.sin(4.0 * times))[late].max()
    # (2 w s + w^2)/(s + w)^2 - 1 = -(s/(s + w))^2: 0.3 * 16/(16 + 1600)
    assert miss == pytest.approx(0.3 * 16.0 / 1616.0, rel=1e-2)


def test_servo_keeps_its_limits():
    times = np.linspace(0.0, 1.5, 301)
    joint, rate = arm_run(times, 9.0)  # far beyond
    assert rate.max() == pytest.approx(6.0, rel=1e-3)
    assert rate.max() < 6.0
    assert joint[-1] == pytest.approx(ARM.limits[1][0], abs=1e-6)
    assert joint.max() < ARM.limits[1][0] + 1e-9


def test_it_starts_in_equilibrium_and_carries_its_weight():
    for mount in ([0.06, 0.0, -0.04], [-0.1, 0.03, 0.0]):
        plant = aerial_manipulator(arm=small_arm(mount=mount), nominal=(3.0, None))
        start = [entry.start for entry in plant.functions.inputs]
        np.testing.assert_allclose(plant.dynamics(0.0, plant.start_state, start), 0.0, atol=EXACT)
        assert plant.start_state[ROTOR].sum() == pytest.approx(3.0 * G)
        np.testing.assert_allclose(outputs(plant, plant.start_state, start)["f_coupling"], 0.0, atol=EXACT)
        start[-1] = 0.3
        load = outputs(plant, plant.start_state, start)
        sag = plant.dynamics(0.0, plant.start_state, start)
        assert sag[5] < 0.0
        assert load["f_payload"][2] < -0.5 * 0.3 * G


def test_machine_code_gives_what_the_virtual_machine_gives():
    find_compiler()  # skipped where there is none
    times = np.linspace(0.0, 0.5, 51)
    rng = np.random.default_rng(10)
    u = np.tile(INPUTS[:, None], 51) + 0.1 * rng.normal(size=(len(INPUTS), 51))
    runs = [
        pf.simulate(VEHICLE, times, u, method="rk4", max_step=0.001, backend=backend)
        for backend in ("vm", "c")
    ]
    np.testing.assert_allclose(runs[0].states, runs[1].states, rtol=COMPILED, atol=COMPILED)
    assert np.ptp(runs[0].states[JOINT], axis=1).min() > 0.01


def test_parameters_can_be_changed_and_it_joins_diagrams():
    heavier = VEHICLE.with_parameters({"mass": 3.0, "servo_bandwidth": 20.0})
    x, u = anywhere(np.random.default_rng(11))
    np.testing.assert_allclose(
        heavier.dynamics(0.0, x, u),
        VEHICLE.dynamics(0.0, x, u, params={"mass": 3.0, "servo_bandwidth": 20.0}),
    )
    sky = ct.ss([], [], [], [[2.0]], inputs=["gust"], outputs=["wind[0]"], name="sky")
    others = [label for label in VEHICLE.input_labels if label != "wind[0]"]
    both = ct.interconnect(
        [sky, VEHICLE], inputs=["gust", *others], outputs=VEHICLE.output_labels, name="flight"
    )
    run = pf.simulate(both, np.linspace(0.0, 0.2, 3), [1.0, *np.delete(INPUTS, 4)])
    moved = dict(zip(VEHICLE.output_labels, run.outputs[:, -1], strict=True))
    assert moved["f_wind[0]"] == pytest.approx(0.9 * 2.0, rel=1e-3)
    assert moved["v[0]"] == pytest.approx(0.9 * 2.0 / 3.0 * 0.2, rel=0.1)


BAD = [
    ({"mass": 0.0}, "mass: expected a finite number > 0"),
    ({"mass": -0.4}, "mass: expected a finite number > 0"),
    ({"J": (1.0, 1.0)}, "J: expected shape"),
    ({"J": (1.0, 1.0, -1.0)}, "J: expected three moments"),
    ({"nominal": (None, (1.0, 0.0, 1.0))}, "nominal_J: expected three moments"),
    ({"nominal": (0.0, None)}, "nominal_mass: expected a finite number > 0"),
    ({"drag": (-1.0, 0.0, 0.0)}, "drag: expected three"),
    ({"rotor_max": 5.0}, "rotor_max: expected at least 7.3"),
    ({"rotor_arm": 0.0}, "rotor_arm: expected a finite number > 0"),
    ({"torque_ratio": -1.0}, "torque_ratio: expected a finite number > 0"),
    ({"motor_lag": 0.0}, "motor_lag: expected a finite number > 0"),
    ({"servo": (0.0, 1.0)}, "servo_bandwidth: expected a finite number > 0"),
    ({"servo": 40.0}, "servo: expected a pair, bandwidth"),
    ({"servo": (40.0, np.nan)}, "servo_damping: expected a finite number > 0"),
    ({"gravity": -9.81}, "gravity: expected 0 m/s"),
    ({"arm": small_arm(mount=(3.0, 0.0, 0.0))}, "arm: at its home joints .* mount it nearer"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_input_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        aerial_manipulator(**change)


def test_an_arm_is_an_arm():
    with pytest.raises(TypeError, match=r"arm: expected a SerialArm, .* got float"):
        aerial_manipulator(arm=0.25)


def test_wind_and_payload_may_be_left_open():
    optional = {entry.name.split("[")[0] for entry in VEHICLE.functions.inputs if entry.optional}
    assert optional == {"wind", "payload"}
