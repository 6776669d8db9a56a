"""Force and torque that a multirotor knows of: the priors of its estimators."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from ..blocks.sampled import SampledBlock, sampled_block
from ..plants.algebra import Array, cross, rotate, stack
from ..plants.declaration import Columns
from ..plants.factory import Results, plant
from ..plants.quadrotor import _SIGNS
from ._equations import UP, clip, drag_force

__all__ = ["KnownForce", "known_force", "known_torque"]

KnownForce = Literal["applied", "collective", "commanded"]


def known_force(
    *,
    mass: float,
    gravity: float = 9.81,
    drag: ArrayLike = 0.0,
    motor_lag: float,
    rotor_max: float,
    delay_steps: int = 0,
    kind: KnownForce = "applied",
    dt: float,
    name: str = "prior",
) -> SampledBlock:
    """The known part g of m v' = g + f: thrust, weight and rotor drag.

        g = thrust - m g e_z - R D R' v

    with the measured attitude R and velocity v, and as thrust

    * applied: R e_z times the thrust that a model of the rotors gives on the commands, delayed as they are;
    * collective: R e_z times the thrust commanded, as if neither motor lag nor delay were;
    * commanded: the force F that was wanted, as if the vehicle turned at once as well.

    Parameters
    ----------
    mass : float
        Nominal mass m in kg.
    gravity : float
        m/s^2.
    drag : number or (3,) array
        Rotor drag along the body's axes in N s/m.
    motor_lag : float
        Time constant of the rotors' thrust in s.
    rotor_max : float
        Largest thrust of a rotor in N.
    delay_steps : int
        Number of samples by which the commands reach the rotors late.
    kind : {"applied", "collective", "commanded"}
    dt : float
        Sampling interval in seconds.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs thrust (N, commanded to each rotor, not delayed), q and v (m/s, world), both measured, and F (N, world);
        that of thrust and F which the kind does not use is optional. Output g (N, world). Parameters mass, gravity,
        drag, motor_lag and rotor_max.

    Raises
    ------
    ValueError
        For a mass, lag, limit or period that is not positive, negative drag, gravity or delay, or an unknown kind.
    TypeError
        For a delay that is no whole number.

    Notes
    -----
    No command of the present instant acts on g, so that a command may depend on the force that an estimator finds with
    g, without an algebraic loop. Applied needs none: the rotors have not answered yet, and e^(-h/motor_lag) over each
    period h for which a command is held makes their model exact at the instants. Collective and commanded use the
    command of the instant before, which has been held until now. What they leave out, motor lag, delay and turning, an
    estimator finds as part of f.

    Examples
    --------
    >>> prior = known_force(mass=3.0, motor_lag=0.04, rotor_max=16.2, delay_steps=5, dt=0.002)
    >>> prior.input_labels[:5], prior.output_labels
    (['thrust[0]', 'thrust[1]', 'thrust[2]', 'thrust[3]', 'q[0]'], ['g[0]', 'g[1]', 'g[2]'])
    >>> prior.law.feedthrough.any(axis=0).tolist() == [False] * 4 + [True] * 7 + [False] * 3
    True
    """
    for label, value, unit in (
        ("mass", mass, "kg"),
        ("motor_lag", motor_lag, "s"),
        ("rotor_max", rotor_max, "N"),
        ("dt", dt, "s"),
    ):
        _signals.number(label, value, unit, above=0.0)
    _signals.number("gravity", gravity, "m/s^2", least=0.0)
    coefficients = _signals.filled("drag", drag, (3,), least=0.0)
    if kind not in get_args(KnownForce):
        raise ValueError(f"kind: expected {', '.join(map(repr, get_args(KnownForce)))}, got {kind!r}")
    steps = _signals.count("delay_steps", delay_steps, least=0)

    hover, zero = np.full(4, 0.25 * mass * gravity), np.zeros(3)
    weight = np.array([0.0, 0.0, mass * gravity])
    states = {
        "applied": {
            "rotor": (hover, "N", "modelled thrust of each rotor"),
            **(
                {"past": (np.tile(hover, steps), "N", "commands on their way, the oldest first")}
                if steps
                else {}
            ),
        },
        "collective": {"before": (hover, "N", "thrust commanded at the instant before")},
        "commanded": {"before": (weight, "N", "force wanted at the instant before")},
    }

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        axis = rotate(u.q, UP)
        if kind == "applied":
            line = stack(x.past, u.thrust) if steps else u.thrust
            answer = 1.0 - np.exp(-dt / p.motor_lag)
            following: Results = {"rotor": x.rotor + answer * (clip(line[:4], 0.0, p.rotor_max) - x.rotor)}
            if steps:
                following = {**following, "past": line[4:]}
            thrust = axis * _total(x.rotor)
        elif kind == "collective":
            following, thrust = {"before": u.thrust}, axis * _total(clip(x.before, 0.0, p.rotor_max))
        else:
            following, thrust = {"before": u.F}, x.before
        return following, {"g": thrust - p.mass * p.gravity * UP - drag_force(u.q, u.v, p.drag)}

    law = plant(
        equations,
        name=name,
        states=states[kind],
        inputs={
            "thrust": (hover, "N", "commanded thrust of each rotor"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "v": (zero, "m/s", "velocity, world"),
            "F": (weight, "N", "wanted thrust, world"),
        },
        optional=["thrust" if kind == "commanded" else "F"],
        outputs={"g": ("N", "known force, world")},
        params={
            "mass": (mass, "kg", "nominal mass"),
            "gravity": (gravity, "m/s^2", "gravity, against z"),
            "drag": (coefficients, "N s/m", "rotor drag, body axes"),
            "motor_lag": (motor_lag, "s", "time constant of the rotors"),
            "rotor_max": (rotor_max, "N", "largest thrust of a rotor"),
        },
        dt=dt,
    )
    return sampled_block(law, name=name)


def _total(rotors: Array) -> Array:
    return rotors[0] + rotors[1] + rotors[2] + rotors[3]


def known_torque(
    *,
    J: ArrayLike,
    arm: float,
    torque_ratio: float,
    motor_lag: float,
    rotor_max: float,
    trim: ArrayLike = (0.0, 0.0, 0.0),
    start: ArrayLike = 0.0,
    delay_steps: int = 0,
    dt: float,
    name: str = "prior_torque",
) -> SampledBlock:
    """The known part g of J omega' = g + f: torque of the rotors, gyroscopic torque, and what is known to pull.

        g = tau - omega x J omega + trim,      (T, tau) = A rotor

    with the measured angular velocity, and the rotors' thrusts as a model of them gives them on the commands, delayed
    as they are.

    Parameters
    ----------
    J : (3,) array
        Nominal moments of inertia about the body's axes in kg m^2.
    arm, torque_ratio : float
        As for :func:`phyfilter_ctl.plants.allocation_matrix`, in m.
    motor_lag : float
        Time constant of the rotors' thrust in s.
    rotor_max : float
        Largest thrust of a rotor in N.
    trim : (3,) array
        Known constant torque in body axes, such as the weight of an arm at rest, in N m.
    start : number or (4,) array
        Thrust of each rotor before the first sample, in N.
    delay_steps : int
        Number of samples by which the commands reach the rotors late.
    dt : float
        Sampling interval in seconds.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs thrust (N, commanded to each rotor, not delayed) and omega (rad/s, body, measured); output g (N m, body).
        Parameters J, arm, torque_ratio, motor_lag, rotor_max and trim.

    Raises
    ------
    ValueError
        For inertias, lengths, a lag, limit or period that are not positive, a negative delay, or arrays of another
        shape.
    TypeError
        For a delay that is no whole number.

    Notes
    -----
    As the kind "applied" of ``known_force``: no command of the present instant acts on g, and e^(-h/motor_lag) over
    each period h makes the rotors' model exact at the instants.

    Examples
    --------
    >>> prior = known_torque(J=[0.035, 0.035, 0.06], arm=0.25, torque_ratio=0.016, motor_lag=0.04, rotor_max=16.2,
    ...                      delay_steps=5, dt=0.002)
    >>> prior.input_labels[3:], prior.output_labels
    (['thrust[3]', 'omega[0]', 'omega[1]', 'omega[2]'], ['g[0]', 'g[1]', 'g[2]'])
    """
    for label, value, unit in (
        ("arm", arm, "m"),
        ("torque_ratio", torque_ratio, "m"),
        ("motor_lag", motor_lag, "s"),
        ("rotor_max", rotor_max, "N"),
        ("dt", dt, "s"),
    ):
        _signals.number(label, value, unit, above=0.0)
    inertia = _signals.filled("J", J, (3,), least=0.0)
    if inertia.min() <= 0.0:
        raise ValueError(f"J: expected three positive moments of inertia in kg m^2, got {J!r}")
    known, rotors = _signals.array("trim", trim, (3,)), _signals.filled("start", start, (4,))
    steps, zero = _signals.count("delay_steps", delay_steps, least=0), np.zeros(3)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        line = stack(x.past, u.thrust) if steps else u.thrust
        answer = 1.0 - np.exp(-dt / p.motor_lag)
        following: Results = {"rotor": x.rotor + answer * (clip(line[:4], 0.0, p.rotor_max) - x.rotor)}
        if steps:
            following = {**following, "past": line[4:]}
        length = p.arm / np.sqrt(2.0)
        tau = stack(length, length, p.torque_ratio) * (_SIGNS[1:] @ x.rotor)
        return following, {"g": tau - cross(u.omega, p.J * u.omega) + p.trim}

    past = {"past": (np.tile(rotors, steps), "N", "commands on their way, the oldest first")} if steps else {}
    law = plant(
        equations,
        name=name,
        states={"rotor": (rotors, "N", "modelled thrust of each rotor"), **past},
        inputs={
            "thrust": (rotors, "N", "commanded thrust of each rotor"),
            "omega": (zero, "rad/s", "angular velocity, body"),
        },
        outputs={"g": ("N m", "known torque, body")},
        params={
            "J": (inertia, "kg m^2", "nominal moments of inertia"),
            "arm": (arm, "m", "rotor to centre of mass"),
            "torque_ratio": (torque_ratio, "m", "yaw torque per thrust"),
            "motor_lag": (motor_lag, "s", "time constant of the rotors"),
            "rotor_max": (rotor_max, "N", "largest thrust of a rotor"),
            "trim": (known, "N m", "known constant torque, body"),
        },
        dt=dt,
    )
    return sampled_block(law, name=name)
