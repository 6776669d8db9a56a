"""Position and attitude control of a multirotor, as sampled blocks."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .. import _signals
from .._renamed import takes_rotors
from ..blocks.sampled import SampledBlock, sampled_block
from ..plants.algebra import Array, cross, dot, norm, quaternion_product, rotate, rotate_back, stack, where
from ..plants.declaration import Columns
from ..plants.factory import Results, plant
from ._equations import (
    UP,
    clip,
    drag_force,
    each_axis,
)
from .allocation import allocate
from .attitude import AttitudeGains, attitude_error

__all__ = ["Vehicle", "attitude_controller", "position_controller"]

# N: far below any thrust, yet its square divides without overflow where the law is linearised.
_TINY = 1e-9
_AXES = "horizontal and vertical"


class Vehicle(Protocol):
    """What of a multirotor its attitude loop needs; see :class:`Multirotor`."""

    @property
    def mass(self) -> float:
        """kg."""
        ...

    @property
    def J(self) -> ArrayLike:
        """(3,) in kg m^2."""
        ...

    @property
    def arm(self) -> float:
        """m."""
        ...

    @property
    def torque_ratio(self) -> float:
        """m."""
        ...

    @property
    def motor_lag(self) -> float:
        """s."""
        ...

    @property
    def rotor_max(self) -> float:
        """N."""
        ...

    @property
    def gravity(self) -> float:
        """m/s^2."""
        ...

    @property
    def delay(self) -> float:
        """s."""
        ...


def position_controller(
    *,
    mass: float,
    gravity: float = 9.81,
    drag: ArrayLike = 0.0,
    kp: ArrayLike,
    kd: ArrayLike,
    ki: ArrayLike = 0.0,
    integral_limit: ArrayLike = 3.0,
    drag_lead: float = 0.0,
    dt: float,
    name: str = "position",
) -> SampledBlock:
    """Force that makes a multirotor follow a trajectory, with drag fed forward.

        F = m (a_ref + g e_z + Kp e_r + Kd e_v + i) + R D R' (v_ref + drag_lead a_ref) - f_hat
        e_r = r_ref - r,    e_v = v_ref - v
        i_(k+1) = clip(i_k + Ki h e_r, -integral_limit, integral_limit)

    with D = diag(drag), R the measured attitude, h the period, and i = 0 on an axis with Ki = 0.

    Parameters
    ----------
    mass : float
        Nominal mass m in kg.
    gravity : float
        g in m/s^2.
    drag : number or (3,) array
        Rotor drag along the body's axes in N s/m.
    kp, kd, ki : number or (2,) array
        Gains in 1/s^2, 1/s and 1/s^3: horizontal and vertical, or one for both.
    integral_limit : number or (2,) array
        Largest acceleration in m/s^2 that the integral asks for on each axis; it stops there (clamping) and does not
        wind up.
    drag_lead : float
        How much earlier in s the drag's share of F is asked for. The attitude loop knows the rate of the rest of F from
        the jerk, but follows this share kw/kR later.
    dt : float
        Sampling interval in seconds.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs r, v and q (measured), r_ref, v_ref, a_ref, and f_hat (estimate of the unknown force, N, world); output F
        (N, world). All arguments but ``dt`` are parameters of the block, gains and limits with two entries.

    Raises
    ------
    ValueError
        For a mass or a period that is not positive, or gains, drag or limits that are negative or of another shape.

    Notes
    -----
    The drag acts at the reference's speed, not at the measured one, so that it adds no feedback: M. Faessler,
    A. Franchi, D. Scaramuzza, "Differential flatness of quadrotor dynamics subject to rotor drag for accurate tracking
    of high-speed trajectories", IEEE Robotics and Automation Letters 3(2), 2018.

    Examples
    --------
    Hover, 0.1 m too low:

    >>> block = position_controller(mass=3.0, kp=[5.0, 8.0], kd=4.0, dt=0.002)
    >>> inputs = np.zeros(22)
    >>> inputs[[2, 6]] = -0.1, 1.0
    >>> values = [entry.start for entry in block.law.parameters]
    >>> block.law.output(0.0, [0.0] * 3, inputs, values).full().ravel().round(3).tolist()
    [0.0, 0.0, 31.83]
    """
    _signals.number("mass", mass, "kg", above=0.0)
    _signals.number("dt", dt, "s", above=0.0)
    _signals.number("gravity", gravity, "m/s^2", least=0.0)
    _signals.number("drag_lead", drag_lead, "s", least=0.0)
    zero = np.zeros(3)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        kp, kd, ki, limit = (each_axis(value) for value in (p.kp, p.kd, p.ki, p.integral_limit))
        e_r, e_v = u.r_ref - u.r, u.v_ref - u.v
        wanted = u.a_ref + p.gravity * UP + kp * e_r + kd * e_v + x.integral
        F = p.mass * wanted + drag_force(u.q, u.v_ref + p.drag_lead * u.a_ref, p.drag) - u.f_hat
        # Without a gain the state is emptied: an integrator that nothing drives would be a mode at 0 of the whole loop.
        following = where(ki, clip(x.integral + ki * dt * e_r, -limit, limit), 0.0)
        return {"integral": following}, {"F": F}

    law = plant(
        equations,
        name=name,
        states={"integral": (zero, "m/s^2", "acceleration that the integral asks for")},
        inputs={
            "r": (zero, "m", "position, world"),
            "v": (zero, "m/s", "velocity, world"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "r_ref": (zero, "m", "wanted position"),
            "v_ref": (zero, "m/s", "wanted velocity"),
            "a_ref": (zero, "m/s^2", "wanted acceleration"),
            "f_hat": (zero, "N", "estimated unknown force, world"),
        },
        optional=["f_hat"],
        outputs={"F": ("N", "wanted thrust, world")},
        params={
            "mass": (mass, "kg", "nominal mass"),
            "gravity": (gravity, "m/s^2", "gravity, against z"),
            "drag": (_signals.filled("drag", drag, (3,), least=0.0), "N s/m", "rotor drag, body axes"),
            "kp": (_signals.filled("kp", kp, (2,), least=0.0), "1/s^2", f"position gain, {_AXES}"),
            "kd": (_signals.filled("kd", kd, (2,), least=0.0), "1/s", f"velocity gain, {_AXES}"),
            "ki": (_signals.filled("ki", ki, (2,), least=0.0), "1/s^3", f"integral gain, {_AXES}"),
            "integral_limit": (
                _signals.filled("integral_limit", integral_limit, (2,), least=0.0),
                "m/s^2",
                f"largest share of the integral, {_AXES}",
            ),
            "drag_lead": (drag_lead, "s", "how much earlier drag is asked for"),
        },
        dt=dt,
    )
    return sampled_block(law, name=name)


@takes_rotors
def attitude_controller(
    vehicle: Vehicle,
    gains: AttitudeGains,
    *,
    dt: float,
    thrust_lead: float | None = None,
    tilt_lead: float = 0.0,
    rate_feedforward: float = 1.0,
    tilt_max: float = 1.0,
    lift_min: float = 0.1,
    yaw: float = 0.0,
    trim: ArrayLike | None = None,
    torque_estimate: bool = False,
    name: str = "attitude",
) -> SampledBlock:
    """Rotor thrusts that point the thrust of a multirotor along a wanted force, and make it as large.

        z      = direction of F + tilt_lead m j_ref
        tau    = J (kR e + kw (omega_ref - omega)) + omega x J omega - tau_hat
        omega_ref = R' (z x z'),  F' = m j_ref
        T      = (F + thrust_lead m j_ref) . R e_z
        rotors = allocate(T, (1 + motor_lag s)/(1 + lead_filter s) tau - trim)

    with the attitude error e (``controllers/attitude.py``) from the measured attitude R to the one whose z axis is z at
    heading ``yaw``, and ``controllers/allocation.py`` for the limits.

    Parameters
    ----------
    vehicle : Multirotor
        Its nominal mass, inertia, rotors, gravity and delay. A motor_lag of 0 means no lead of the torque.
    gains : AttitudeGains
        kR of attitude error in 1/s^2, kw of angular rate in 1/s, tilt and yaw, and lead_filter, the time constant in s
        that takes the motor lag's place (the lead multiplies the gyroscope's noise by motor_lag/lead_filter): of
        :meth:`Multirotor.gains`.
    dt : float
        Sampling interval in seconds.
    thrust_lead : float, optional
        How much earlier the size of the thrust is asked for, in s. None means motor_lag + delay + dt/2, with which
        it arrives in time; 0 means not at all.
    tilt_lead : float
        The same of its direction. With ``rate_feedforward`` at 1 the tilt follows a steadily turning direction without
        lag, and 0 is right.
    rate_feedforward : float
        Share of omega_ref that is used, 0 to 1.
    tilt_max : float
        Largest angle of z from the vertical in rad; the horizontal part of F is cut down to it.
    lift_min : float
        Least vertical part of F that is made, as a share of m g; it also gives z a meaning where F is 0.
    yaw : float
        Wanted heading in rad.
    trim : (3,) array, optional
        Known constant torque on the body, such as the weight of an arm, in N m, that the rotors make up. None means
        none, and no parameter.
    torque_estimate : bool
        Whether there is an input tau_hat, the estimate of an unknown torque; without it tau_hat is 0.
    name : str
        Name of the block.

    Returns
    -------
    SampledBlock
        Inputs F (N, world), q, omega (rad/s, body), j_ref (m/s^3, world) and, if asked for, tau_hat (N m, body); output
        thrust (N, command to each rotor). All numbers but the delay and ``dt`` are parameters of the block, gains
        with two entries.

    Raises
    ------
    ValueError
        For times or a lift that are not positive, gains that are negative or of another shape, or a tilt_max that is
        not between 0 and pi/2.
    TypeError
        For a vehicle or gains of another kind.

    Notes
    -----
    Tilt and heading have each their own error and gains, and the tilt does not wait for the heading: D. Brescianini,
    R. D'Andrea, "Tilt-prioritized quadrocopter attitude control", IEEE Transactions on Control Systems Technology
    28(2), 2020. Lead and rate take the trajectory's jerk, no measured signal, so they add no noise: F' leaves out what
    the feedback adds to F, and omega_ref the rate at which the heading would turn about z.

    Examples
    --------
    Hover needs a quarter of the weight from each rotor:

    >>> from phyfilter_ctl.controllers import Multirotor
    >>> drone = Multirotor(mass=3.0)
    >>> block = attitude_controller(drone, drone.gains(0.002), dt=0.002)
    >>> values = [entry.start for entry in block.law.parameters]
    >>> hover = [0.0, 0.0, 29.43, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    >>> block.law.output(0.0, [0.0] * 3, hover, values).full().ravel().round(4).tolist()
    [7.3575, 7.3575, 7.3575, 7.3575]
    """
    if not (hasattr(vehicle, "rotor_max") and isinstance(gains, AttitudeGains)):
        raise TypeError(
            "attitude_controller: expected a Multirotor and AttitudeGains, such as its gains(dt), got "
            f"{type(vehicle).__name__} and {type(gains).__name__}"
        )
    _signals.number("dt", dt, "s", above=0.0)
    lead = vehicle.motor_lag + vehicle.delay + 0.5 * dt if thrust_lead is None else thrust_lead
    _signals.number("gravity", vehicle.gravity, "m/s^2", above=0.0)
    _signals.number("lead_filter", gains.lead_filter, "s", above=0.0)
    _signals.number("lift_min", lift_min, "weights", above=0.0)
    _signals.number("thrust_lead", lead, "s", least=0.0)
    _signals.number("tilt_lead", tilt_lead, "s", least=0.0)
    if not 0.0 < tilt_max < 0.5 * np.pi:
        raise ValueError(f"tilt_max: expected an angle between 0 and pi/2 rad, got {tilt_max}")
    zero = np.zeros(3)

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        rate = p.mass * u.j_ref
        aimed = _limited(u.F + p.tilt_lead * rate, p)
        size = norm(aimed)
        z = aimed / size
        turning = rotate_back(u.q, cross(z, rate) / size)
        error = attitude_error(u.q, _attitude(z, p.yaw))
        angular = each_axis(p.kR) * error + each_axis(p.kw) * (p.rate_feedforward * turning - u.omega)
        torque = p.J * angular + cross(u.omega, p.J * u.omega)
        if torque_estimate:
            torque = torque - u.tau_hat
        sharpness = p.motor_lag / p.lead_filter
        led = where(p.motor_lag, sharpness * torque + (1.0 - sharpness) * x.smooth, torque)
        if known:
            led = led - p.trim
        T = dot(_limited(u.F, p) + p.thrust_lead * rate, rotate(u.q, UP))
        rotors = allocate(T, led, arm=p.arm, torque_ratio=p.torque_ratio, rotor_max=p.rotor_max)
        kept = np.exp(-dt / p.lead_filter)
        return {"smooth": kept * x.smooth + (1.0 - kept) * torque}, {"thrust": rotors}

    known = (
        {}
        if trim is None
        else {"trim": (_signals.array("trim", trim, (3,)), "N m", "known constant torque, body")}
    )
    estimate = {"tau_hat": (zero, "N m", "estimated unknown torque, body")} if torque_estimate else {}
    law = plant(
        equations,
        name=name,
        states={"smooth": (zero, "N m", "smoothed torque of the lead")},
        inputs={
            "F": ([0.0, 0.0, vehicle.mass * vehicle.gravity], "N", "wanted thrust, world"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "attitude quaternion, body to world"),
            "omega": (zero, "rad/s", "angular velocity, body"),
            "j_ref": (zero, "m/s^3", "wanted jerk"),
            **estimate,
        },
        optional=list(estimate),
        outputs={"thrust": ("N", "commanded thrust of each rotor")},
        params={
            "mass": (vehicle.mass, "kg", "nominal mass"),
            "J": (vehicle.J, "kg m^2", "moments of inertia"),
            "arm": (vehicle.arm, "m", "rotor to centre of mass"),
            "torque_ratio": (vehicle.torque_ratio, "m", "yaw torque per thrust"),
            "gravity": (vehicle.gravity, "m/s^2", "gravity, against z"),
            "rotor_max": (vehicle.rotor_max, "N", "largest thrust of a rotor"),
            "kR": (_signals.filled("kR", gains.kR, (2,), least=0.0), "1/s^2", "attitude gain, tilt and yaw"),
            "kw": (_signals.filled("kw", gains.kw, (2,), least=0.0), "1/s", "rate gain, tilt and yaw"),
            "motor_lag": (vehicle.motor_lag, "s", "time constant that the lead takes out"),
            "lead_filter": (gains.lead_filter, "s", "time constant that takes its place"),
            "thrust_lead": (lead, "s", "how much earlier thrust is asked for"),
            "tilt_lead": (tilt_lead, "s", "how much earlier tilt is asked for"),
            "rate_feedforward": (rate_feedforward, "", "share of the rate fed forward"),
            "tilt_max": (tilt_max, "rad", "largest tilt asked for"),
            "lift_min": (lift_min, "", "least vertical force, share of the weight"),
            "yaw": (yaw, "rad", "wanted heading"),
            **known,
        },
        dt=dt,
    )
    return sampled_block(law, name=name)


def _limited(F: Array, p: Columns) -> Array:
    """A force with a least vertical part, and no further from the vertical than the largest tilt."""
    up = np.fmax(F[2], p.lift_min * p.mass * p.gravity)
    share = np.fmin(1.0, np.tan(p.tilt_max) * up / np.fmax(norm(F[:2]), _TINY))
    return stack(share * F[0], share * F[1], up)


def _attitude(z: Array, yaw: Array) -> Array:
    """Attitude with a z axis (not downwards), turned from the vertical the shortest way, after the heading."""
    upright = stack(1.0 + z[2], -z[1], z[0], 0.0) / np.sqrt(2.0 * (1.0 + z[2]))
    return quaternion_product(upright, stack(np.cos(0.5 * yaw), 0.0, 0.0, np.sin(0.5 * yaw)))
