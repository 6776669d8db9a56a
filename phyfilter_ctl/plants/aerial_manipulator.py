"""A multirotor that carries a serial arm: coupled six degrees of freedom, servos, wind, a load in the gripper."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from .._renamed import takes_pairs
from .._sections import FloatArray
from .algebra import Array, cross, quaternion_rate, rotate, rotate_back, stack
from .coupling import coupled_accelerations, coupling_force, coupling_torque, payload_motion
from .declaration import Columns
from .factory import Plant, Results, plant
from .quadrotor import _SIGNS, _check_positive, _three, allocation_matrix, check_carries
from .serial_arm import SerialArm
from .small_arm import small_arm

__all__ = ["aerial_manipulator"]


@takes_pairs
def aerial_manipulator(
    *,
    arm: SerialArm | None = None,
    mass: float = 2.55,
    J: ArrayLike = (0.035, 0.035, 0.06),
    rotor_arm: float = 0.25,
    torque_ratio: float = 0.016,
    motor_lag: float = 0.04,
    drag: ArrayLike = (0.9, 0.9, 0.9),
    gravity: float = 9.81,
    rotor_max: float = 16.2,
    servo: tuple[float, float] = (40.0, 1.0),
    nominal: tuple[float | None, ArrayLike | None] = (None, None),
    name: str = "aerial_manipulator",
) -> Plant:
    """A multirotor with motor lag and rotor drag that carries a serial arm with a load in its gripper, in wind.

        r' = v,       m_b v' = T R e_z - m_b g e_z - R D R' (v - wind) + Delta_F + f_payload
        q' = q (0, omega)/2,      J omega' = -omega x J omega + tau + Delta_tau + tau_payload
        rotor' = (clip(thrust, 0, rotor_max) - rotor)/motor_lag,      (T, tau) = A rotor
        joint' = joint_rate,      joint_rate' = 2 zeta w (wanted - joint_rate)
        wanted = clip(w/(2 zeta) (clip(joint_ref) - joint) + joint_rate_ref, -rate_limit, rate_limit)

    with Delta_F and Delta_tau of :func:`coupling_force` and :func:`coupling_torque`; they hold v' and omega', so the
    six equations are solved together. Written with a nominal mass and inertia, as a controller knows the plant:

        m_hat v' = T R e_z - m_hat g e_z - R D R' v + f_coupling + f_payload + f_wind
        J_hat omega' = -omega x J_hat omega + tau + tau_coupling + tau_payload

    Parameters
    ----------
    arm : SerialArm, optional
        None means :func:`small_arm`. Its masses and lengths are constants of the plant, no parameters.
    mass : float
        m_b of the platform without the arm, in kg.
    J : (3,) array
        Moments of inertia of the platform without the arm about the body's axes, in kg m^2.
    rotor_arm : float
        Distance of each rotor from the platform's centre of mass in m.
    torque_ratio : float
        Yaw torque per thrust in m.
    motor_lag : float
        Time constant of the rotors' thrust in s.
    drag : (3,) array
        Rotor drag D along the body's axes in N s/m; it acts on the platform's centre of mass.
    gravity : float
        g in m/s^2, against the z axis of the world.
    rotor_max : float
        Largest thrust of each rotor in N.
    servo : (float, float)
        Bandwidth w (rad/s) and damping zeta of the joint servos.
    nominal : (float or None, (3,) array or None)
        m_hat in kg, and the diagonal of J_hat in kg m^2. None means m_b and J: f_coupling and tau_coupling are then the
        paper's Delta_F and Delta_tau, the arm's weight included. With the mass of platform and arm f_coupling is 0 in
        hover at rest.
    name : str
        Name of the block.

    Returns
    -------
    Plant
        Inputs thrust[i] (N, commanded to each rotor), wind[i] (m/s, world, optional), joint_ref[i] (rad),
        joint_rate_ref[i] (rad/s) and payload (kg in the gripper, optional). Outputs r, v of the platform's centre of
        mass (m, m/s, world), the unit quaternion q (w, x, y, z) from the body to the world frame, omega (rad/s, body),
        rotor (N), joint (rad), joint_rate (rad/s), a = R' (v' + g e_z) (m/s^2, body: what an accelerometer reads), r_e
        and v_e of the end effector (m, m/s, world), f_coupling, f_payload and f_wind = R D R' wind (N, world),
        tau_coupling and tau_payload (N m, body). Parameters as the arguments, but for arm, and servo_bandwidth,
        servo_damping, nominal_mass and nominal_J. It starts level and at rest, the joints at ``arm.home``, rotors and
        the default of the command at the thrusts that keep it so.

    Raises
    ------
    ValueError
        For a mass, inertia, length, lag or limit that is not positive, a negative drag or gravity, or rotors that
        cannot hold the platform level with the arm at ``arm.home``.
    TypeError
        For an arm that is no SerialArm.

    Notes
    -----
    Newton-Euler equations; the coupling is the paper's Eq. (coupling_V), corrected. The paper's frames have z down:
    turned over about x, only gravity and thrust change their signs (see :mod:`.coupling`). The servos are rigid: the
    joints follow their references as a second-order lag with the given rate, whatever the load, within the limits of
    angle and rate of the arm's links; the torques that this takes act on the platform. Drag of the arm, and what
    quadrotor leaves out, are left out. The load is a point mass which may vary in time.
    The defaults make 3 kg with :func:`small_arm`, the vehicle of :func:`quadrotor`.

    Examples
    --------
    >>> vehicle = aerial_manipulator()
    >>> rates = vehicle.dynamics(0.0, vehicle.start_state, [entry.start for entry in vehicle.functions.inputs])
    >>> float(np.abs(rates).max().round(9))
    0.0
    """
    arm = small_arm() if arm is None else arm
    if not isinstance(arm, SerialArm):
        raise TypeError(f"arm: expected a SerialArm, such as small_arm() makes, got {type(arm).__name__}")
    servo_bandwidth, servo_damping = _pair("servo", servo, "bandwidth in rad/s and damping")
    nominal_mass, nominal_J = _pair("nominal", nominal, "mass in kg and J in kg m^2")
    nominal_mass = mass if nominal_mass is None else nominal_mass
    for label, value, unit in (
        ("mass", mass, "kg"),
        ("rotor_arm", rotor_arm, "m"),
        ("motor_lag", motor_lag, "s"),
        ("rotor_max", rotor_max, "N"),
        ("servo_bandwidth", servo_bandwidth, "rad/s"),
        ("servo_damping", servo_damping, ""),
        ("nominal_mass", nominal_mass, "kg"),
    ):
        _check_positive(label, value, unit)
    check_carries(mass, arm.mass, gravity, rotor_max)
    words = "moments of inertia in kg m^2, positive"
    inertia = _three("J", J, words, positive=True)
    nominal_J = inertia if nominal_J is None else _three("nominal_J", nominal_J, words, positive=True)
    coefficients = _three("drag", drag, "drag coefficients in N s/m, 0 or more", positive=False)
    level = _level_thrusts(arm, mass, gravity, allocation_matrix(rotor_arm, torque_ratio), rotor_max)
    return _declare(
        arm,
        level,
        {
            "mass": (mass, "kg", "mass of the platform alone"),
            "J": (inertia, "kg m^2", "moments of inertia of the platform alone"),
            "rotor_arm": (rotor_arm, "m", "rotor to the platform's centre of mass"),
            "torque_ratio": (torque_ratio, "m", "yaw torque per thrust"),
            "motor_lag": (motor_lag, "s", "time constant of the rotors"),
            "drag": (coefficients, "N s/m", "rotor drag, body axes"),
            "gravity": (gravity, "m/s^2", "gravity, against z"),
            "rotor_max": (rotor_max, "N", "largest thrust of a rotor"),
            "servo_bandwidth": (servo_bandwidth, "rad/s", "natural frequency of the servos"),
            "servo_damping": (servo_damping, "", "damping of the servos"),
            "nominal_mass": (nominal_mass, "kg", "mass that f_... go with"),
            "nominal_J": (nominal_J, "kg m^2", "moments of inertia that tau_... go with"),
        },
        name,
    )


def _pair(name: str, given: tuple[Any, Any], words: str) -> tuple[Any, Any]:
    if not isinstance(given, list | tuple) or len(given) != 2:
        raise ValueError(f"{name}: expected a pair, {words}, got {given!r}")
    return given[0], given[1]


def _declare(
    arm: SerialArm, level: FloatArray, parameters: dict[str, tuple[ArrayLike, str, str]], name: str
) -> Plant:
    zero, rest = np.zeros(3), np.zeros(arm.joints)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return _equations(arm, x, u, p)

    return plant(
        equations,
        name=name,
        states={
            "r": (zero, "m", "position of the platform's centre of mass, world"),
            "v": (zero, "m/s", "velocity of the platform's centre of mass, world"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "omega": (zero, "rad/s", "angular velocity, body"),
            "rotor": (level, "N", "thrust of each rotor"),
            "joint": (arm.home, "rad", "joint angles"),
            "joint_rate": (rest, "rad/s", "joint rates"),
        },
        inputs={
            "thrust": (level, "N", "commanded thrust of each rotor"),
            "wind": (zero, "m/s", "wind, world"),
            "joint_ref": (arm.home, "rad", "commanded joint angles"),
            "joint_rate_ref": (rest, "rad/s", "commanded joint rates"),
            "payload": (0.0, "kg", "load in the gripper"),
        },
        optional=["wind", "payload"],
        outputs={
            "r": "m",
            "v": "m/s",
            "q": "",
            "omega": "rad/s",
            "rotor": "N",
            "joint": "rad",
            "joint_rate": "rad/s",
            "a": ("m/s^2", "specific force, body"),
            "r_e": ("m", "end effector, world"),
            "v_e": ("m/s", "velocity of the end effector, world"),
            "f_coupling": ("N", "force of the arm, world"),
            "tau_coupling": ("N m", "torque of the arm, body"),
            "f_payload": ("N", "force of the load, world"),
            "tau_payload": ("N m", "torque of the load, body"),
            "f_wind": ("N", "force of the wind, world"),
        },
        params=parameters,
    )


def _equations(arm: SerialArm, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
    length = p.rotor_arm / np.sqrt(2.0)
    wrench = stack(1.0, length, length, p.torque_ratio) * (_SIGNS @ x.rotor)
    upward = np.array([0.0, 0.0, 1.0])
    joint_acceleration = _servo(arm, x, u, p)
    motion = arm.motion(x.joint, x.joint_rate, joint_acceleration=joint_acceleration)
    load = payload_motion(u.payload, motion)
    specific, omega_rate = coupled_accelerations(
        (motion, load),
        mass=p.mass,
        J=ca.diag(p.J),
        omega=x.omega,
        force=wrench[0] * upward - p.drag * rotate_back(x.q, x.v - u.wind),
        torque=wrench[1:],
    )
    felt = rotate(x.q, specific)
    v_rate = felt - p.gravity * upward
    command = np.fmin(np.fmax(u.thrust, 0.0), p.rotor_max)
    derivatives: Results = {
        "r": x.v,
        "v": v_rate,
        "q": quaternion_rate(x.q, x.omega),
        "omega": omega_rate,
        "rotor": (command - x.rotor) / p.motor_lag,
        "joint": x.joint_rate,
        "joint_rate": joint_acceleration,
    }
    state = {"q": x.q, "omega": x.omega, "v_rate": v_rate, "omega_rate": omega_rate, "gravity": p.gravity}
    # What a nominal mass and inertia other than the platform's own leave to explain.
    excess, excess_J = p.nominal_mass - p.mass, p.nominal_J - p.J
    tip_v = motion.tip_velocity + cross(x.omega, motion.tip)
    outputs: Results = {
        **{name: getattr(x, name) for name in ("r", "v", "q", "omega", "rotor", "joint", "joint_rate")},
        "a": specific,
        "r_e": x.r + rotate(x.q, motion.tip),
        "v_e": x.v + rotate(x.q, tip_v),
        "f_coupling": coupling_force(motion, **state) + excess * felt,
        "tau_coupling": coupling_torque(motion, **state)
        + excess_J * omega_rate
        + cross(x.omega, excess_J * x.omega),
        "f_payload": coupling_force(load, **state),
        "tau_payload": coupling_torque(load, **state),
        "f_wind": rotate(x.q, p.drag * rotate_back(x.q, u.wind)),
    }
    return derivatives, outputs


def _servo(arm: SerialArm, x: Columns, u: Columns, p: Columns) -> Array:
    """Joint accelerations: a second-order lag, as a position loop around a rate loop with a limit."""
    lower, upper = arm.limits
    fastest = arm.rate_limits
    target = np.fmin(np.fmax(u.joint_ref, lower), upper)
    wanted = p.servo_bandwidth / (2.0 * p.servo_damping) * (target - x.joint) + u.joint_rate_ref
    wanted = np.fmin(np.fmax(wanted, -fastest), fastest)
    return 2.0 * p.servo_damping * p.servo_bandwidth * (wanted - x.joint_rate)


def _level_thrusts(
    arm: SerialArm, mass: float, gravity: float, allocation: FloatArray, rotor_max: float
) -> FloatArray:
    """Thrusts that hold platform and arm level and at rest, (4,)."""
    moment = arm.mass * np.asarray(arm.centre_of_mass(arm.home))
    torque = np.cross(moment, [0.0, 0.0, gravity])
    thrusts = np.linalg.solve(allocation, [(mass + arm.mass) * gravity, *torque])
    if thrusts.min() < 0.0 or thrusts.max() > rotor_max:
        raise ValueError(
            f"arm: at its home joints {arm.home.round(3).tolist()} rad it needs rotor thrusts of "
            f"{thrusts.round(2).tolist()} N to stay level, expected 0 to {rotor_max:g} N each: mount it nearer to the "
            "centre of mass, choose another home, or take a lighter arm"
        )
    return np.asarray(thrusts, dtype=float)
