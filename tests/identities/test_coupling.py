"""Coupling force and torque of a moving arm against two derivations that share nothing with them.

One: positions and attitudes of all links, differentiated twice in time by CasADi, and the balances of momentum about
the origin of the world. The other: Lagrange's equations of platform and a reduced arm in Euler angles, by SymPy.
"""

import casadi as ca
import numpy as np
import pytest
import sympy as sp
from scipy.spatial.transform import Rotation

from phyfilter_ctl.plants import Link, SerialArm, coupling_force, coupling_torque, small_arm
from phyfilter_ctl.plants.coupling import payload_motion

# Rounding of some thousand operations on forces up to 1e2 N.
EXACT = 1e-10
# What a misprint must at least do, N or N m, at the random points below, where the terms are of order 1 and more.
VISIBLE = 1e-2
G = 9.81
MASS, J = 2.55, np.array([[0.035, 0.002, -0.001], [0.002, 0.04, 0.003], [-0.001, 0.003, 0.06]])
UP = np.array([0.0, 0.0, 1.0])


def moment(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def crooked_arm(joints):
    """Axes, offsets and inertias without any symmetry."""
    rng = np.random.default_rng(5)
    links = []
    for _ in range(joints):
        turn = Rotation.random(rng=rng).as_matrix()
        inertia = turn @ np.diag([3e-3, 4e-3, 5e-3]) @ turn.T
        links.append(
            Link(rng.normal(size=3), 0.2 * rng.normal(size=3), 0.3, 0.1 * rng.normal(size=3), inertia)
        )
    return SerialArm(links, [0.05, -0.02, -0.1])


ARMS = {"small": small_arm(), "crooked": crooked_arm(4)}


def anywhere(rng, joints):
    """Attitude, rates and accelerations of platform and joints."""
    q = rng.normal(size=4)
    return {
        "r": rng.normal(size=3),
        "q": q / np.linalg.norm(q),
        "joint": rng.uniform(-2.0, 2.0, joints),
        "v": 2.0 * rng.normal(size=3),
        "omega": 3.0 * rng.normal(size=3),
        "rate": 3.0 * rng.normal(size=joints),
        "v_rate": 5.0 * rng.normal(size=3),
        "omega_rate": 10.0 * rng.normal(size=3),
        "acceleration": 20.0 * rng.normal(size=joints),
    }


def attitude(q):
    return Rotation.from_quat(np.roll(q, -1)).as_matrix()


# -- momentum balance -------------------------------------------------------------------------------------------------


def transforms(arm, r, R, joint):
    """World position and attitude of each link's centre of mass, then of the tip, by Rodrigues' formula."""
    R, p, places = R @ ca.SX(arm.base_axes), r + R @ ca.SX(arm.mount), []
    for i, link in enumerate(arm.links):
        S = ca.SX(moment(link.axis))
        R = R @ (ca.SX.eye(3) + ca.sin(joint[i]) * S + (1 - ca.cos(joint[i])) * S @ S)
        places.append((p + R @ ca.SX(link.centre), R))
        p = p + R @ ca.SX(link.offset)
    return places, (p, R)


def balance(arm):
    """(state, rates, load) -> force and torque about the origin on all bodies, without weight, from momentum."""
    n = arm.joints
    r, q, joint, load = ca.SX.sym("r", 3), ca.SX.sym("q", 4), ca.SX.sym("joint", n), ca.SX.sym("load")
    v, omega, rate = ca.SX.sym("v", 3), ca.SX.sym("omega", 3), ca.SX.sym("rate", n)
    w, e = q[0], q[1:]
    S = ca.skew(e)
    R = ca.SX.eye(3) + 2 * w * S + 2 * S @ S
    turning = 0.5 * ca.vertcat(-ca.dot(e, omega), w * omega + ca.cross(e, omega))
    places, tip = transforms(arm, r, R, joint)
    bodies = [(MASS, ca.SX(J), r, R)]
    bodies += [
        (link.mass, ca.SX(link.inertia), *place) for link, place in zip(arm.links, places, strict=True)
    ]
    bodies += [(load, ca.SX(3, 3), *tip)]
    configuration, velocity = ca.vertcat(r, q, joint), ca.vertcat(v, turning, rate)
    linear, angular, weight, weight_moment = ca.SX(3, 1), ca.SX(3, 1), ca.SX(3, 1), ca.SX(3, 1)
    for m, inertia, place, axes in bodies:
        speed = ca.jtimes(place, configuration, velocity)
        axes_rate = ca.reshape(ca.jtimes(ca.vec(axes), configuration, velocity), 3, 3)
        spin = ca.inv_skew(axes_rate @ axes.T)
        linear += m * speed
        angular += m * ca.cross(place, speed) + axes @ inertia @ axes.T @ spin
        weight += m * G * ca.SX(UP)
        weight_moment += ca.cross(place, m * G * ca.SX(UP))
    v_rate, omega_rate = ca.SX.sym("v_rate", 3), ca.SX.sym("omega_rate", 3)
    acceleration = ca.SX.sym("acceleration", n)
    state = ca.vertcat(configuration, v, omega, rate)
    change = ca.vertcat(velocity, v_rate, omega_rate, acceleration)
    results = [ca.jtimes(linear, state, change) + weight, ca.jtimes(angular, state, change) + weight_moment]
    arguments = [r, q, joint, v, omega, rate, v_rate, omega_rate, acceleration, load]
    return ca.Function("balance", arguments, results)


@pytest.fixture(scope="module", params=ARMS)
def case(request):
    arm = ARMS[request.param]
    return arm, balance(arm)


def platform_needs(point, force, torque):
    """Force (world) and torque (body) on the platform's centre that its equations of motion ask for."""
    needed = MASS * (point["v_rate"] + G * UP) - force
    omega = point["omega"]
    return needed, J @ point["omega_rate"] + np.cross(omega, J @ omega) - torque


def coupling(arm, point, load=0.0):
    where = {name: point[name] for name in ("q", "omega", "v_rate", "omega_rate")}
    motion = arm.motion(point["joint"], point["rate"], joint_acceleration=point["acceleration"])
    carried = payload_motion(load, motion)
    force = coupling_force(motion, gravity=G, **where) + coupling_force(carried, gravity=G, **where)
    return force, coupling_torque(motion, gravity=G, **where) + coupling_torque(carried, gravity=G, **where)


@pytest.mark.parametrize("load", [0.0, 0.3])
def test_equal_to_the_balance_of_momentum(case, load):
    arm, momentum = case
    rng = np.random.default_rng(1)
    largest = 0.0
    for _ in range(30):
        point = anywhere(rng, arm.joints)
        force, torque = (np.array(part).ravel() for part in momentum(*point.values(), load))
        own, own_torque = platform_needs(point, *coupling(arm, point, load))
        np.testing.assert_allclose(own, force, atol=EXACT)
        about_origin = np.cross(point["r"], own) + attitude(point["q"]) @ own_torque
        np.testing.assert_allclose(about_origin, torque, atol=EXACT)
        largest = max(largest, float(np.abs(force).max()))
    assert largest > 10.0


def test_motion_equals_its_derivatives(case):
    """Every rate of ArmMotion is the derivative in time of what it is the rate of, by CasADi."""
    arm, _ = case
    n = arm.joints
    joint, rate, acceleration = (ca.SX.sym(name, n) for name in ("joint", "rate", "acceleration"))
    motion = arm.motion(joint, rate, joint_acceleration=acceleration)
    state, change = ca.vertcat(joint, rate), ca.vertcat(rate, acceleration)
    pairs = [
        (motion.centre, motion.centre_velocity),
        (motion.centre_velocity, motion.centre_acceleration),
        (motion.inertia, motion.inertia_rate),
        (motion.momentum, motion.momentum_rate),
        (motion.tip, motion.tip_velocity),
        (motion.tip_velocity, motion.tip_acceleration),
        (motion.tip, arm.jacobian(joint) @ rate),
    ]
    wrong = ca.Function(
        "wrong",
        [joint, rate, acceleration],
        [ca.vertcat(*[ca.jtimes(ca.vec(a), state, change) - ca.vec(b) for a, b in pairs])],
    )
    point = anywhere(np.random.default_rng(2), n)
    difference = np.array(wrong(point["joint"], point["rate"], point["acceleration"]))
    np.testing.assert_allclose(difference, 0.0, atol=EXACT)


# -- the paper's equation ---------------------------------------------------------------------------------------------


def printed(arm, point, *, square=False, product="cross"):
    """Delta_F and Delta_tau as in Eq. (coupling_V), in its own frames with z down; ``square`` for J_m' omega'."""
    N = np.diag([1.0, -1.0, -1.0])  # turned over about x: an own inverse
    motion = arm.motion(point["joint"], point["rate"], joint_acceleration=point["acceleration"])
    R = N @ attitude(point["q"]) @ N
    omega, omega_rate, v_rate = N @ point["omega"], N @ point["omega_rate"], N @ point["v_rate"]
    P, P1, P2 = N @ motion.centre, N @ motion.centre_velocity, N @ motion.centre_acceleration
    Jm, Jm1, L, L1 = (
        N @ motion.inertia @ N,
        N @ motion.inertia_rate @ N,
        N @ motion.momentum,
        N @ motion.momentum_rate,
    )
    m, w = motion.mass, moment(omega)
    force = -m * v_rate + m * G * UP - m * R @ (w @ w @ P + moment(omega_rate) @ P + 2 * w @ P1 + P2)
    felt = R.T @ (G * UP - v_rate)
    pull = m * (moment(P) @ felt if product == "cross" else P * felt)
    last = Jm1 @ (omega_rate if square else omega)
    torque = -Jm @ omega_rate - w @ Jm @ omega + pull - last - w @ L - L1
    return N @ force, N @ torque


def test_printed_equation_with_its_slips_corrected(case):
    """Turned over to z up, the paper's corrected equation is ours; the force is right as printed."""
    arm, _ = case
    point = anywhere(np.random.default_rng(3), arm.joints)
    for ours, theirs in zip(coupling(arm, point), printed(arm, point), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=EXACT)


@pytest.mark.parametrize("slip", ["sign of the force", "J' w'", "no cross product"])
def test_misprints_break_the_balance(case, slip):
    arm, momentum = case
    point = anywhere(np.random.default_rng(4), arm.joints)
    force, torque = printed(
        arm, point, square=slip == "J' w'", product="" if slip == "no cross product" else "cross"
    )
    if slip == "sign of the force":
        force = -force  # the paper's platform equation subtracts it
    own, own_torque = platform_needs(point, force, torque)
    expected, about_origin = (np.array(part).ravel() for part in momentum(*point.values(), 0.0))
    missed = own - expected, np.cross(point["r"], expected) + attitude(point["q"]) @ own_torque - about_origin
    assert np.abs(missed[slip != "sign of the force"]).max() > VISIBLE
    assert np.abs(missed[slip == "sign of the force"]).max() < EXACT


# -- Lagrange ---------------------------------------------------------------------------------------------------------


def lagrange(arm):
    """Generalised forces on (x, y, z, yaw, pitch, roll) by Lagrange's equations; the joint is prescribed."""
    c, d, e = (sp.Matrix(sp.symbols(f"{name}0:7")) for name in ("c", "cd", "cdd"))
    (link,) = arm.links

    def number(values):
        return sp.Matrix(values.tolist()).applyfunc(lambda entry: entry if entry else sp.Integer(0))

    def rotation(axis, angle):
        S = number(moment(axis))
        return sp.eye(3) + sp.sin(angle) * S + (1 - sp.cos(angle)) * S * S

    x, y, z = np.eye(3)
    R = rotation(z, c[3]) * rotation(y, c[4]) * rotation(x, c[5])
    # Body rates of yaw, pitch and roll, one after the other.
    omega = rotation(x, -c[5]) * (rotation(y, -c[4]) * number(z) * d[3] + number(y) * d[4]) + number(x) * d[5]
    base = number(arm.base_axes)
    axes = base * rotation(link.axis, c[6])
    spin = axes.T * omega + number(link.axis) * d[6]
    r = c[:3, 0]
    speed = d[:3, 0]
    place = r + R * (number(arm.mount) + axes * number(link.centre))
    place_speed = place.jacobian(c) * d
    kinetic = MASS * speed.dot(speed) + (omega.T * number(J) * omega)[0]
    kinetic += link.mass * place_speed.dot(place_speed) + (spin.T * number(link.inertia) * spin)[0]
    energy = kinetic / 2 - G * (MASS * r[2] + link.mass * place[2])
    forces = []
    for i in range(6):
        momentum = energy.diff(d[i])
        rate = sum(momentum.diff(c[k]) * d[k] + momentum.diff(d[k]) * e[k] for k in range(7))
        forces.append(rate - energy.diff(c[i]))
    omega_rate = omega.jacobian(c) * d + omega.jacobian(d) * e
    parts = [
        sp.Matrix(forces),
        omega,
        omega_rate,
        sp.Matrix(omega.jacobian(d[3:6, 0]).T.vec()),
        sp.Matrix(R.T.vec()),
    ]
    return sp.lambdify([list(c), list(d), list(e)], list(sp.Matrix.vstack(*parts)), modules="math", cse=True)


@pytest.mark.slow
def test_equal_to_lagrange_for_a_reduced_arm():
    """One joint, about y and off the middle; platform and link with all six moments of inertia."""
    turn = Rotation.from_euler("xyz", [0.3, -0.5, 0.7]).as_matrix()
    inertia = turn @ np.diag([3e-3, 4e-3, 5e-3]) @ turn.T
    arm = SerialArm([Link([0, 1, 0], [0.3, 0.0, 0.0], 0.4, [0.15, 0.03, -0.02], inertia)], [0.05, 0.0, -0.1])
    evaluate = lagrange(arm)
    rng = np.random.default_rng(6)
    for _ in range(10):
        coordinates, rates, accelerations = rng.uniform(-1.0, 1.0, 7), *(3.0 * rng.normal(size=(2, 7)))
        result = np.array(evaluate(coordinates, rates, accelerations))
        forces, omega, omega_rate, to_euler, R = np.split(result, [6, 9, 12, 21])
        to_euler, R = to_euler.reshape(3, 3), R.reshape(3, 3)
        point = {
            "q": np.roll(Rotation.from_matrix(R).as_quat(), 1),
            "omega": omega,
            "omega_rate": omega_rate,
            "v_rate": accelerations[:3],
            "joint": coordinates[6:],
            "rate": rates[6:],
            "acceleration": accelerations[6:],
        }
        own, own_torque = platform_needs(point, *coupling(arm, point))
        np.testing.assert_allclose(own, forces[:3], atol=EXACT)
        np.testing.assert_allclose(to_euler.T @ own_torque, forces[3:], atol=EXACT)
