"""The multirotor's controllers: laws against plain numpy and rotation matrices, loops against closed forms."""

from dataclasses import replace

import control as ct
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import phyfilter_ctl as pf
from phyfilter_ctl.analysis import SystemMargins
from phyfilter_ctl.blocks import delay_line, wired
from phyfilter_ctl.controllers import (
    Multirotor,
    attitude_controller,
)
from phyfilter_ctl.controllers.allocation import allocate
from phyfilter_ctl.controllers.attitude import attitude_error, attitude_gains
from phyfilter_ctl.controllers.known import known_force
from phyfilter_ctl.controllers.tracking import position_controller
from phyfilter_ctl.diagram.opening import open_loop
from phyfilter_ctl.plants import allocation_matrix, plant, quadrotor
from phyfilter_ctl.plants.algebra import quaternion_rate, rotation_matrix

H, DELAY = 0.002, 5
MASS, GRAVITY, DRAG, LAG, LIMIT = 3.0, 9.81, np.array([0.9, 0.9, 0.6]), 0.04, 16.2
J, ARM, RATIO = np.array([0.035, 0.035, 0.06]), 0.25, 0.016
GAINS = attitude_gains(motor_lag=LAG, delay=DELAY * H + H / 2)
HOVER = MASS * GRAVITY / 4
# The lag kw/kR with which the tilt follows what no rate is fed forward for.
TILT_LAG = GAINS.kw[0] / GAINS.kR[0]
A = allocation_matrix(ARM, RATIO)

ROUNDING = 1e-12
# sqrt(1 - cos^2) near a small or a half turn loses half the digits.
ANGLE = 1e-7
# Runge-Kutta steps of h on the rotors' lag: (h/lag)^5/120 of a thrust of 10 N a step, about 20 steps of memory.
STEPPED = 2e-7


def values(block, **changes):
    """Parameters of a law as a vector, some changed."""
    table = {entry.name: entry.start for entry in block.law.parameters}
    assert set(changes) <= set(table)
    return list((table | changes).values())


def starts(block):
    return [entry.start for entry in block.law.states]


def output(block, inputs, state=None, **changes):
    state = starts(block) if state is None else state
    return block.law.output(0.0, state, inputs, values(block, **changes)).full().ravel()


def following(block, inputs, state, **changes):
    return block.law.dynamics(0.0, state, inputs, values(block, **changes)).full().ravel()


def turn(q):
    """Rotation matrix of a quaternion (w, x, y, z), by scipy."""
    return Rotation.from_quat(np.asarray(q)[[1, 2, 3, 0]]).as_matrix()


def position(**changes):
    usual = {"kp": [4.0, 6.0], "kd": [3.6, 5.0], "drag": DRAG, "gravity": GRAVITY, "dt": H}
    return position_controller(mass=MASS, **(usual | changes))


VEHICLE = Multirotor(
    mass=MASS, J=J, arm=ARM, torque_ratio=RATIO, motor_lag=LAG, rotor_max=LIMIT, drag=DRAG, delay=DELAY * H
)


def attitude(vehicle=None, gains=None, **changes):
    """The attitude loop with some of the vehicle's numbers, gains and options changed."""
    vehicle, gains = replace(VEHICLE, **(vehicle or {})), GAINS._replace(**(gains or {}))
    return attitude_controller(vehicle, gains, **({"dt": H} | changes))


def known(kind="applied", **changes):
    usual = {"gravity": GRAVITY, "drag": DRAG, "motor_lag": LAG, "rotor_max": LIMIT, "delay_steps": DELAY}
    return known_force(mass=MASS, kind=kind, dt=H, **(usual | changes))


def circle():
    """Radius R at speed V from (R, 0, 0); at V = 0 the point itself."""

    def equations(t, x, u, p):
        a = p.speed / p.radius
        c, s, R = np.cos(a * t), np.sin(a * t), p.radius
        return {}, {
            "r_ref": [R * c, R * s, 0.0],
            "v_ref": [-R * a * s, R * a * c, 0.0],
            "a_ref": [-R * a**2 * c, -R * a**2 * s, 0.0],
            "j_ref": [R * a**3 * s, -R * a**3 * c, 0.0],
        }

    return plant(equations, states={}, params={"speed": 2.0, "radius": 1.5}, name="reference")


@pytest.fixture(scope="module")
def diagram():
    line = delay_line([f"thrust[{i}]" for i in range(4)], DELAY, H, name="delay", start=HOVER)
    wires = {f"position.{name}": f"quadrotor.{name}" for name in ("r", "v", "q")}
    wires |= {f"position.{name}": f"reference.{name}" for name in ("r_ref", "v_ref", "a_ref")}
    wires |= {f"attitude.{name}": f"quadrotor.{name}" for name in ("q", "omega")}
    wires |= {f"prior.{name}": f"quadrotor.{name}" for name in ("q", "v")}
    wires |= {
        "attitude.F": "position.F", "attitude.j_ref": "reference.j_ref", "delay.thrust": "attitude.thrust",
        "quadrotor.thrust": "delay.thrust_delayed", "prior.thrust": "attitude.thrust", "prior.F": "position.F",
    }  # fmt: skip
    outputs = {name: f"quadrotor.{name}" for name in ("r", "v", "q", "omega", "a", "f_mass", "f_wind")}
    outputs |= {"r_ref": "reference.r_ref", "thrust": "attitude.thrust", "g": "prior.g"}
    vehicle = quadrotor(
        mass=MASS, J=J, arm=ARM, torque_ratio=RATIO, motor_lag=LAG, drag=DRAG, rotor_max=LIMIT
    )
    inputs = {"wind": "quadrotor.wind", "f_hat": "position.f_hat"}
    blocks = [circle(), vehicle, position(), attitude(), line, known()]
    return wired(blocks, wires, inputs=inputs, outputs=outputs, name="drone")


@pytest.fixture(scope="module")
def flat(diagram):
    return pf.flatten(diagram)


def fly(flat, seconds, start=None, inputs=0.0, **parameters):
    """Times and outputs by name, one row an instant."""
    times = H * np.arange(round(seconds / H) + 1)
    run = pf.simulate(flat, times, inputs, start, params=parameters, method="rk4", backend="vm")
    assert run.success, run.message
    signals = {}
    for label, row in zip([entry.name for entry in flat.outputs], run.outputs, strict=True):
        signals.setdefault(label.split("[")[0], []).append(row)
    return times, {name: np.array(rows).T for name, rows in signals.items()}


ON_CIRCLE = {"quadrotor.r[0]": 1.5, "quadrotor.v[1]": 2.0}


# -- the laws ------------------------------------------------------------------------------------------------------


def test_position_law_against_matrices():
    rng = np.random.default_rng(0)
    block = position(ki=[1.0, 2.0], drag_lead=0.1)
    for _ in range(5):
        r, v, r_ref, v_ref, a_ref, f_hat, i = rng.standard_normal((7, 3))
        q = Rotation.random(rng=rng).as_quat(scalar_first=True)
        R, K = turn(q), np.array([[4.0, 4.0, 6.0], [3.6, 3.6, 5.0]])
        wanted = a_ref + [0.0, 0.0, GRAVITY] + K[0] * (r_ref - r) + K[1] * (v_ref - v) + i
        expected = MASS * wanted + R @ np.diag(DRAG) @ R.T @ (v_ref + 0.1 * a_ref) - f_hat
        F = output(block, np.concatenate([r, v, q, r_ref, v_ref, a_ref, f_hat]), i)
        np.testing.assert_allclose(F, expected, atol=ROUNDING * 1e2)


def test_integral_clamps_and_comes_back_at_once():
    block = position(ki=[1.0, 2.0], integral_limit=[0.5, 0.8])
    low, high = np.zeros(22), np.zeros(22)
    low[:3], high[:3], state = -1.0, 1.0, np.zeros(3)
    for k in range(1, 401):
        state = following(block, low, state)
        expected = np.minimum(np.array([1.0, 1.0, 2.0]) * k * H, [0.5, 0.5, 0.8])
        np.testing.assert_allclose(state, expected, atol=ROUNDING)
    # No wind-up: the first error of the other sign is felt.
    np.testing.assert_allclose(following(block, high, state), [0.498, 0.498, 0.796], atol=ROUNDING)
    idle = following(block, low, state, **{"ki[0]": 0.0, "ki[1]": 0.0})
    np.testing.assert_array_equal(idle, 0.0)


unit = st.builds(
    lambda seed: Rotation.random(rng=np.random.default_rng(seed)).as_quat(scalar_first=True),
    st.integers(0, 10**6),
)


@given(unit, unit, st.floats(-3.0, 3.0))
def test_attitude_error_keeps_tilt_and_heading_apart(q, wanted, heading):
    error = attitude_error(q, wanted)
    b3, z = turn(q)[:, 2], turn(wanted)[:, 2]
    angle = np.arctan2(np.linalg.norm(np.cross(b3, z)), b3 @ z)
    assume(angle < 3.1)
    assert np.linalg.norm(error[:2]) == pytest.approx(2.0 * np.sin(angle / 2.0), abs=ANGLE)
    # About the shortest way, in the body frame.
    axis = turn(q).T @ np.cross(b3, z)
    np.testing.assert_allclose(np.cross(axis, [*error[:2], 0.0]), 0.0, atol=ANGLE)
    assert axis[:2] @ error[:2] >= -ANGLE
    # Tilt, then heading, is the whole rotation.
    half = np.linalg.norm(error[:2]) / 2.0
    tilt = Rotation.from_quat([np.sqrt(1.0 - half**2), *(error[:2] / 2.0), 0.0], scalar_first=True)
    spin = Rotation.from_euler("z", 2.0 * np.arcsin(np.clip(error[2] / 2.0, -1.0, 1.0)))
    np.testing.assert_allclose((tilt * spin).as_matrix(), turn(q).T @ turn(wanted), atol=1e-6)
    # Either sign of a quaternion; any heading of the wanted attitude.
    np.testing.assert_allclose(attitude_error(-q, wanted), error, atol=ANGLE)
    spun = (Rotation.from_matrix(turn(wanted)) * Rotation.from_euler("z", heading)).as_quat(scalar_first=True)
    np.testing.assert_allclose(attitude_error(q, spun)[:2], error[:2], atol=ANGLE)


def test_attitude_error_upside_down_is_defined():
    level, over = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(attitude_error(level, over), [2.0, 0.0, 0.0])
    # On CasADi columns too, and with finite derivatives wherever it is linearised.
    block = plant(
        lambda t, x, u, p: ({}, {"error": attitude_error(u.q, level)}),
        states={},
        inputs={"q": level},
        name="error",
    )
    for q in (level, over, np.array([0.6, 0.0, 0.8, 0.0]), np.array([-0.5, 0.5, 0.5, 0.5])):
        symbolic = block.functions.output(0.0, [], q, []).full().ravel()
        np.testing.assert_allclose(symbolic, attitude_error(q, level), atol=ROUNDING)
        assert np.isfinite(block.linearize(u0=q).D).all()


signed = st.floats(-1.0, 1.0)


@given(st.floats(-10.0, 100.0), st.tuples(signed, signed, signed), st.floats(0.01, 100.0))
@example(0.015625, (0.125, -0.125, 0.015625), 0.015625)  # the yaw makes room for the tilt
def test_allocation_stays_within_limits_and_keeps_tilt(thrust, direction, size):
    torque = size * np.array(direction)
    rotors = allocate(thrust, torque, arm=ARM, torque_ratio=RATIO, rotor_max=LIMIT)
    assert rotors.min() >= 0.0
    assert rotors.max() <= LIMIT
    plain = np.linalg.solve(A, [thrust, *torque])
    made = A @ rotors
    if plain.min() >= 0.0 and plain.max() <= LIMIT:
        np.testing.assert_allclose(rotors, plain, atol=1e-9)
    share = np.linalg.solve(A, [0.0, *torque[:2], 0.0])
    fits = np.abs(share).max() <= LIMIT / 2.0
    kept = 1.0 if fits else LIMIT / 2.0 / np.abs(share).max()
    np.testing.assert_allclose(made[1:3], kept * torque[:2], atol=1e-9)
    assert made[3] * torque[2] >= -1e-9
    assert abs(made[3]) <= abs(torque[2]) + 1e-9
    # The thrust gives way to the tilt only where no part of the yaw leaves room for both.
    spin = np.linspace(0.0, 1.0, 401)[:, None] * np.linalg.solve(A, [0.0, 0.0, 0.0, torque[2]])
    rest = kept * share + spin
    low, high = (-rest.min(axis=1)).min(), LIMIT - rest.max(axis=1).min()
    coarse = 4.0 * np.abs(spin[1]).max() + 1e-9
    assert abs(made[0] - 4.0 * np.clip(thrust / 4.0, low, high)) <= coarse
    room = kept * np.abs(share).max()
    before = 4.0 * np.clip(thrust / 4.0, room, LIMIT - room)
    assert abs(made[0] - thrust) <= abs(before - thrust) + 1e-9


def test_attitude_law_within_limits_against_matrices():
    """Small errors, so that no limit acts; second instant, with the lead's state."""
    rng = np.random.default_rng(1)
    block = attitude(tilt_lead=0.01, yaw=0.1)
    for _ in range(5):
        F = MASS * (np.array([0.0, 0.0, GRAVITY]) + rng.uniform(-0.2, 0.2, 3))
        omega, jerk, smooth = (
            rng.uniform(-0.05, 0.05, 3),
            rng.uniform(-1.0, 1.0, 3),
            rng.uniform(-0.01, 0.01, 3),
        )
        q = Rotation.from_rotvec(rng.uniform(-0.01, 0.01, 3)) * Rotation.from_euler("z", 0.1)
        R = q.as_matrix()
        aimed = F + 0.01 * MASS * jerk
        z = aimed / np.linalg.norm(aimed)
        turned = np.cross([0.0, 0.0, 1.0], z)
        upright = Rotation.from_rotvec(turned / np.linalg.norm(turned) * np.arccos(z[2]))
        missing = (q.inv() * upright * Rotation.from_euler("z", 0.1)).as_quat(scalar_first=True)
        size = np.hypot(missing[0], missing[3])
        tilt = turn(missing)[:, 2]  # where the wanted axis is, seen from the body
        error = np.array([-tilt[1], tilt[0], 0.0]) / np.sqrt((1.0 + tilt[2]) / 2.0)
        error[2] = 2.0 * missing[3] / size * np.sign(missing[0])
        rate = R.T @ np.cross(z, MASS * jerk) / np.linalg.norm(aimed)
        kR, kw = (np.array([gain[0], gain[0], gain[1]]) for gain in (GAINS.kR, GAINS.kw))
        torque = J * (kR * error + kw * (rate - omega)) + np.cross(omega, J * omega)
        led = 4.0 * torque - 3.0 * smooth
        T = (F + (LAG + DELAY * H + H / 2) * MASS * jerk) @ R[:, 2]
        expected = np.linalg.solve(A, [T, *led])
        assert 0.0 < expected.min() < expected.max() < LIMIT
        inputs = np.concatenate([F, q.as_quat(scalar_first=True), omega, jerk])
        np.testing.assert_allclose(output(block, inputs, smooth), expected, atol=1e-10)
        step = 1.0 - np.exp(-H / GAINS.lead_filter)
        smoothed = smooth + step * (torque - smooth)
        np.testing.assert_allclose(following(block, inputs, smooth), smoothed, atol=1e-10)


@pytest.mark.parametrize("F", [[0.0, 0.0, 0.0], [0.0, 0.0, -50.0], [100.0, 0.0, 0.0], [1e-12, 0.0, 1e-12]])
def test_forces_without_a_usable_direction(F):
    block = attitude()
    level = [1.0, 0.0, 0.0, 0.0]
    for q in (level, [0.0, 1.0, 0.0, 0.0]):
        thrust = output(block, [*F, *q, *np.zeros(6)])
        assert np.isfinite(thrust).all()
        assert thrust.min() >= 0.0
    linear = pf.function_block(block.law, name="law").linearize(starts(block), [*F, *level, *np.zeros(6)])
    assert np.isfinite([*linear.B.ravel(), *linear.D.ravel()]).all()


def test_tilt_is_limited():
    """A force far beyond tilt_max asks for tilt_max: level, the torque is that of an error 2 sin(tilt_max/2)."""
    block = attitude({"motor_lag": 0.0}, {"kR": (10.0, 1.0)}, tilt_max=0.4)
    sideways = output(block, [1e3, 0.0, 4 * HOVER, 1.0, 0.0, 0.0, 0.0, *np.zeros(6)])
    np.testing.assert_allclose(
        (A @ sideways)[1:], [0.0, J[1] * 10.0 * 2.0 * np.sin(0.2), 0.0], atol=ROUNDING * 10
    )


# -- the known force -----------------------------------------------------------------------------------------------


def test_known_force_is_that_of_the_plant(flat):
    """m v' = g + f along a flight with a load and in wind: f from the plant, v' from its accelerometer."""
    wind = np.zeros((6, round(3.0 / H) + 1))
    wind[:3] = np.array([3.0, -2.0, 1.0])[:, None] * np.sin(np.linspace(0.0, 9.0, wind.shape[1]))
    _, y = fly(flat, 3.0, ON_CIRCLE, wind, added_mass=0.3)
    R = np.array([rotation_matrix(q / np.linalg.norm(q)) for q in y["q"]])
    rate = np.einsum("nij,nj->ni", R, y["a"]) - [0.0, 0.0, GRAVITY]
    f = y["f_mass"] + y["f_wind"]
    assert np.abs(f).max() > 1.0
    np.testing.assert_allclose(y["g"], MASS * rate - f, atol=STEPPED)


@pytest.mark.parametrize("steps", [0, 1, 5])
def test_known_forces_differ_by_lag_and_delay(steps):
    """Rotors commanded along a ramp of c N/s answer motor lag + delay later, held commands half a period more."""
    c, q, v = 5.0, [1.0, 0.0, 0.0, 0.0], np.zeros(3)
    blocks = {kind: known(kind, delay_steps=steps) for kind in ("applied", "collective", "commanded")}
    states = {kind: starts(block) for kind, block in blocks.items()}
    g = {}
    for k in range(600):
        command = HOVER + c * k * H
        inputs = [*[command] * 4, *q, *v, 0.0, 0.0, 4.0 * command]
        for kind, block in blocks.items():
            g[kind] = output(block, inputs, states[kind])[2]
            states[kind] = following(block, inputs, states[kind])
    # The model's state, exactly: a ramp of held steps lags by h/(e^(h/lag) - 1) + h and the delay.
    late = H / np.expm1(H / LAG) + H + steps * H
    assert late == pytest.approx(LAG + steps * H + H / 2, rel=2e-3)
    assert g["applied"] == pytest.approx(4.0 * c * (599 * H - late), abs=1e-6)
    assert g["collective"] == g["commanded"] == pytest.approx(4.0 * c * 598 * H, abs=1e-9)


def test_known_force_reads_what_its_kind_says():
    rng = np.random.default_rng(2)
    q = Rotation.random(rng=rng).as_quat(scalar_first=True)
    thrust, v, F = rng.uniform(0.0, 2.0 * LIMIT, 4), rng.standard_normal(3), rng.standard_normal(3)
    R = turn(q)
    rest = -MASS * GRAVITY * np.array([0.0, 0.0, 1.0]) - R @ np.diag(DRAG) @ R.T @ v
    inputs = [*thrust, *q, *v, *F]
    for kind, force in (("collective", R[:, 2] * np.minimum(thrust, LIMIT).sum()), ("commanded", F)):
        block = known(kind)
        state = following(block, inputs, starts(block))
        np.testing.assert_allclose(output(block, inputs, state), force + rest, atol=1e-10)
    for kind in ("applied", "collective", "commanded"):
        assert known(kind).input_labels == known().input_labels
        assert not known(kind, delay_steps=0).law.feedthrough[:, :4].any()


# -- the loops -----------------------------------------------------------------------------------------------------


def test_hover_is_a_fixed_point(flat):
    start = {"quadrotor.r[0]": 1.5}
    _, y = fly(flat, 0.5, start, speed=0.0)
    np.testing.assert_allclose(y["thrust"], HOVER, atol=ROUNDING * 1e2)
    np.testing.assert_allclose(y["r"], np.tile([1.5, 0.0, 0.0], (len(y["r"]), 1)), atol=ROUNDING * 1e2)
    np.testing.assert_allclose(y["g"], 0.0, atol=ROUNDING * 1e2)


def mean_error(flat, **parameters):
    """Mean distance in mm from the second round on."""
    times, y = fly(flat, 12.0, ON_CIRCLE, **parameters)
    return 1e3 * np.linalg.norm(y["r"] - y["r_ref"], axis=1)[times > 6.0].mean()


def test_circle_with_and_without_feedforward(flat):
    """2 m/s, radius 1.5 m, exact mass, no wind."""
    aware = mean_error(flat, drag_lead=TILT_LAG)
    # By the tilt loop's 1 - T = s^2/kR at the circle's 4/3 rad/s: 1.1 % of 2.7 m/s^2, over |Kp - a^2 + j Kd a|.
    a = 2.0 / 1.5
    predicted = 1e3 * (2.0 * a) * a**2 / GAINS.kR[0] / abs(4.0 - a**2 + 3.6j * a)
    assert predicted == pytest.approx(5.5, abs=0.1)
    assert aware == pytest.approx(predicted, rel=0.4)
    assert mean_error(flat) < 20.0
    unaware = mean_error(flat, rate_feedforward=0.0, thrust_lead=0.0)
    assert unaware > 90.0
    # Asking for the tilt earlier by what the loop lags does what the rate does.
    led = mean_error(flat, rate_feedforward=0.0, tilt_lead=TILT_LAG, drag_lead=TILT_LAG)
    assert led == pytest.approx(aware, rel=0.3)
    assert mean_error(flat, **{"position.drag": 0.0}) > 5.0 * mean_error(flat)


def test_a_far_start_is_flown_without_harm(flat):
    """5 m away and turned by 60 degrees: limits act, and it arrives."""
    start = {"quadrotor.r[0]": -3.5, "quadrotor.q[0]": np.cos(0.5), "quadrotor.q[1]": np.sin(0.5)}
    _, y = fly(flat, 12.0, start, speed=0.0)
    assert y["thrust"].min() >= 0.0
    assert y["thrust"].max() <= LIMIT
    np.testing.assert_allclose(y["r"][-1], [1.5, 0.0, 0.0], atol=1e-3)


def test_heading_is_reached(flat):
    _, y = fly(flat, 8.0, {"quadrotor.r[0]": 1.5}, speed=0.0, yaw=0.8)
    np.testing.assert_allclose(y["q"][-1], [np.cos(0.4), 0.0, 0.0, np.sin(0.4)], atol=1e-4)


# -- gains and margins ---------------------------------------------------------------------------------------------


def sampled_tilt_loop(omega):
    """L of the tilt at omega as it is sampled: held commands, delay, lead as a difference equation."""
    A_c = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1 / LAG, 1 / LAG], [0.0] * 4])
    step = expm(A_c * H)
    z = np.exp(1j * omega * H)
    angle, rate, _ = np.linalg.solve(z * np.eye(3) - step[:3, :3], step[:3, 3])
    keep, sharp = np.exp(-H / GAINS.lead_filter), LAG / GAINS.lead_filter
    lead = sharp + (1.0 - sharp) * (1.0 - keep) / (z - keep)
    return z**-DELAY * lead * (GAINS.kR[0] * angle + GAINS.kw[0] * rate)


def test_gains_have_the_margin_that_was_asked_for():
    omega = np.geomspace(0.1, 500.0, 5001)
    for lag, delay, sharpness, margin in (
        (0.04, 0.011, 4.0, 0.6),
        (0.1, 0.0, 1.0, 0.5),
        (0.0, 0.02, 1.0, 0.7),
    ):
        gains = attitude_gains(motor_lag=lag, delay=delay, sharpness=sharpness, modulus_margin=margin)
        assert gains.lead_filter == lag / sharpness
        assert gains.kR[0] == pytest.approx(gains.kw[0] ** 2 / 4.0)
        s = 1j * omega
        L = (gains.kw[0] * s + gains.kR[0]) / s**2 * np.exp(-s * delay) / (1.0 + s * lag / sharpness)
        assert np.abs(1.0 + L).min() == pytest.approx(margin, abs=1e-3)
        # Stable: the phase at the last crossing of |L| = 1 is above -pi.
        crossing = np.abs(L) > 1.0
        assert np.angle(-L[crossing][-1]) > 0.0
    slower = attitude_gains(motor_lag=0.08, delay=0.022)
    np.testing.assert_allclose(slower.kw, np.array(GAINS.kw) / 2.0, rtol=1e-9)
    np.testing.assert_allclose(slower.kR, np.array(GAINS.kR) / 4.0, rtol=1e-9)


def test_margin_of_the_tilt_loop():
    """The attitude loop alone, opened at the torque about x: as designed, in the diagram and as it is sampled."""
    sampled = np.array([abs(1.0 + sampled_tilt_loop(w)) for w in np.geomspace(1.0, 300.0, 400)]).min()
    assert sampled == pytest.approx(0.6, abs=0.03)

    def turning(t, x, u, p):
        """Rotors and rotation alone: a place that nothing holds would drift, a mode at 0."""
        rates = {"rotor": (u.thrust - x.rotor) / LAG, "q": quaternion_rate(x.q, x.omega)}
        return rates | {"omega": u.torque / J}, {"q": x.q, "omega": x.omega, "made": (A @ x.rotor)[1:]}

    states = {"q": [1.0, 0.0, 0.0, 0.0], "omega": np.zeros(3), "rotor": np.full(4, HOVER)}
    drives = {"thrust": np.full(4, HOVER), "torque": np.zeros(3)}
    body = plant(turning, states=states, inputs=drives, name="body")
    line = delay_line([f"thrust[{i}]" for i in range(4)], DELAY, H, name="delay", start=HOVER)
    wires = {
        "attitude.q": "body.q", "attitude.omega": "body.omega", "delay.thrust": "attitude.thrust",
        "body.thrust": "delay.thrust_delayed", "body.torque": "body.made",
    }  # fmt: skip
    inputs = {"F": "attitude.F", "j_ref": "attitude.j_ref"}
    loop = wired([body, line, attitude()], wires, inputs=inputs, outputs={"q": "body.q"})
    for axis in ("body.torque[0]", "body.torque[1]"):
        # Between continuous blocks there is no margin from instant to instant: that of the continuous equivalents.
        margin = SystemMargins(axis, open_loop(loop, axis, u0=[0.0, 0.0, 4.0 * HOVER, 0.0, 0.0, 0.0]))
        assert margin.is_stable
        assert margin.modulus_margin == pytest.approx(0.6, abs=0.05)


def test_margins_of_the_whole_loop(diagram, flat):
    """At the wanted force, hovering: tilt inside position."""
    x0 = [1.5 if entry.name == "quadrotor.r[0]" else entry.start for entry in flat.states]
    for signal, least in (("position.F[0]", 0.6), ("position.F[1]", 0.6), ("position.F[2]", 0.8)):
        margin = pf.margins(diagram, at=signal, x0=x0, params={"speed": 1e-9})
        assert margin.is_stable
        assert margin.modulus_margin > least


# -- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "changes", "message"),
    [
        (position, {"kp": [1.0, 2.0, 3.0]}, "kp: expected a number or shape"),
        (position, {"kd": -1.0}, "kd: expected"),
        (position, {"drag": [1.0, 2.0]}, "drag: expected a number or shape"),
        (position, {"dt": 0.0}, "dt: expected a finite number > 0"),
        (attitude, {"gains": {"kR": (1.0, 2.0, 3.0)}}, "kR: expected a number or shape"),
        (attitude, {"vehicle": {"gravity": 0.0}}, "gravity: expected a finite number > 0"),
        (attitude, {"tilt_max": 2.0}, "tilt_max: expected an angle"),
        (attitude, {"thrust_lead": -0.1}, "thrust_lead: expected a finite number >= 0 s"),
        (attitude, {"gains": {"lead_filter": 0.0}}, "lead_filter: expected a finite number > 0"),
        (known, {"kind": "measured"}, "kind: expected 'applied'"),
        (known, {"delay_steps": -1}, "delay_steps: expected at least 0"),
        (known, {"motor_lag": 0.0}, "motor_lag: expected a finite number > 0"),
    ],
)
def test_bad_arguments(make, changes, message):
    with pytest.raises(ValueError, match=message):
        make(**changes)


def test_a_vehicle_and_gains_of_another_kind_are_refused():
    for vehicle, gains in ((3.0, GAINS), (VEHICLE, GAINS.kR)):
        with pytest.raises(TypeError, match="expected a Multirotor and AttitudeGains"):
            attitude_controller(vehicle, gains, dt=H)


def test_bad_delay_and_gains():
    with pytest.raises(TypeError, match="whole number"):
        known(delay_steps=2.5)
    for changes, message in (
        ({"delay": 0.0, "motor_lag": 0.0}, "above 0 s"),
        ({"sharpness": 0.5}, "sharpness"),
        ({"damping": 0.2}, "damping"),
        ({"modulus_margin": 1.2}, "modulus_margin: expected one between"),
        ({"delay": -1.0}, "delay: expected a finite number >= 0 s"),
    ):
        with pytest.raises(ValueError, match=message):
            attitude_gains(**({"motor_lag": 0.04, "delay": 0.01} | changes))


def test_python_control_takes_the_blocks():
    """Wired by name, without ``wired``."""
    loop = ct.interconnect(
        [position(), attitude()],
        inputs=[
            *position().input_labels,
            "omega[0]",
            "omega[1]",
            "omega[2]",
            "j_ref[0]",
            "j_ref[1]",
            "j_ref[2]",
        ],
        outputs=[f"thrust[{i}]" for i in range(4)],
    )
    assert (loop.ninputs, loop.noutputs) == (28, 4)
