"""A multirotor's numbers, once, for its plant, its controllers and what it knows of itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from numpy.typing import ArrayLike

from .. import _signals
from ..blocks.delay_line import delay_line
from ..blocks.sampled import SampledBlock
from ..plants.factory import Plant
from ..plants.quadrotor import check_carries, quadrotor
from .attitude import AttitudeGains, attitude_gains
from .known import KnownForce, known_force, known_torque
from .tracking import attitude_controller, position_controller

__all__ = ["Multirotor"]


@dataclass(frozen=True, kw_only=True)
class Multirotor:
    """A multirotor: its plant, its attitude and position loop, and the force and torque that it knows of.

    Each number is given once, times in seconds. Commands reach the rotors ``delay`` late and are held for a sample,
    which acts as half a sample more: gains, leads and the known force count both.

    Parameters
    ----------
    mass : float
        Nominal mass m in kg.
    J : (3,) array
        Moments of inertia about the body's axes in kg m^2.
    arm : float
        Distance of each rotor from the centre of mass in m.
    torque_ratio : float
        Yaw torque per thrust in m.
    motor_lag : float
        Time constant of the rotors' thrust in s; 0, an attitude loop without lead, has no plant.
    rotor_max : float
        Largest thrust of each rotor in N.
    drag : number or (3,) array
        Rotor drag along the body's axes in N s/m.
    gravity : float
        m/s^2, against the z axis of the world.
    delay : float
        From a measurement to the rotors in s. Sampled, it is the nearest whole number of samples.
    added_mass : float
        Of the plant alone in kg: what the controllers do not know of.
    name : str
        Of the plant.

    Raises
    ------
    ValueError
        For a mass, inertia, length or limit that is not positive, a negative time, drag or gravity, added mass that
        leaves no mass, or rotors that cannot carry the weight.

    Notes
    -----
    The plant's equations are those of :func:`phyfilter_ctl.plants.quadrotor`, the attitude loop's those of
    :func:`attitude_controller`; the other methods have theirs.

    Examples
    --------
    >>> drone = Multirotor(mass=1.5, J=[0.012, 0.012, 0.02], rotor_max=8.0, delay=0.01)
    >>> drone.plant().parameters["mass"], drone.delay_steps(0.002), round(drone.hover, 3)
    (1.5, 5, 3.679)
    >>> drone.attitude(0.002).output_labels
    ['thrust[0]', 'thrust[1]', 'thrust[2]', 'thrust[3]']
    """

    mass: float = 3.0
    J: ArrayLike = (0.035, 0.035, 0.06)
    arm: float = 0.25
    torque_ratio: float = 0.016
    motor_lag: float = 0.04
    rotor_max: float = 16.2
    drag: ArrayLike = (0.9, 0.9, 0.9)
    gravity: float = 9.81
    delay: float = 0.0
    added_mass: float = 0.0
    name: str = "quadrotor"

    def __post_init__(self) -> None:
        for label, unit in (("mass", "kg"), ("arm", "m"), ("torque_ratio", "m"), ("rotor_max", "N")):
            self._keep(label, _signals.number(label, getattr(self, label), unit, above=0.0))
        for label, unit in (("motor_lag", "s"), ("delay", "s"), ("gravity", "m/s^2")):
            self._keep(label, _signals.number(label, getattr(self, label), unit, least=0.0))
        self._keep("added_mass", _signals.number("added_mass", self.added_mass, "kg"))
        inertia = _signals.array("J", self.J, (3,))
        if inertia.min() <= 0.0:
            raise ValueError(f"J: expected three positive moments of inertia in kg m^2, got {self.J!r}")
        self._keep("J", tuple(inertia.tolist()))
        self._keep("drag", tuple(_signals.filled("drag", self.drag, (3,), least=0.0).tolist()))
        check_carries(self.mass, self.added_mass, self.gravity, self.rotor_max)

    def _keep(self, name: str, value: float | Sequence[float]) -> None:
        object.__setattr__(self, name, value)

    @property
    def hover(self) -> float:
        """Thrust of each rotor that carries the nominal mass, m g/4, in N."""
        return 0.25 * self.mass * self.gravity

    def delay_steps(self, dt: float) -> int:
        """Samples between a command and the rotors.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        """
        return round(self.delay / _signals.number("dt", dt, "s", above=0.0))

    def plant(self) -> Plant:
        """What flies: :func:`phyfilter_ctl.plants.quadrotor`."""
        return quadrotor(
            mass=self.mass,
            J=self.J,
            arm=self.arm,
            torque_ratio=self.torque_ratio,
            motor_lag=self.motor_lag,
            drag=self.drag,
            gravity=self.gravity,
            rotor_max=self.rotor_max,
            added_mass=self.added_mass,
            name=self.name,
        )

    def thrust_delay(self, dt: float, *, name: str = "delay") -> SampledBlock:
        """Commands on their way to the rotors, at hover until the first has come through.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        name : str
            Of the block.

        Returns
        -------
        SampledBlock
            :func:`phyfilter_ctl.blocks.delay_line` from thrust to thrust_delayed.
        """
        labels = [f"thrust[{i}]" for i in range(4)]
        return delay_line(labels, self.delay_steps(dt), dt, name=name, start=self.hover, unit="N")

    def gains(
        self,
        dt: float,
        *,
        sharpness: float = 4.0,
        damping: float = 1.0,
        modulus_margin: float = 0.6,
        yaw_ratio: float = 0.25,
    ) -> AttitudeGains:
        """The fastest attitude loop of a given modulus margin behind motor lag, delay and half a sample.

            L(s) = (kw s + kR)/s^2  e^(-(delay + dt/2) s)/(1 + motor_lag/sharpness s),     kR = (kw/(2 damping))^2

        and kw the largest for which |1 + L(j omega)| >= modulus_margin.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        sharpness : float
            How many times faster than the motor lag the lead makes the loop's lag; it multiplies the gyroscope's noise
            by as much. 1 is no lead.
        damping : float
            Damping ratio of s^2 + kw s + kR, 0.75 or more.
        modulus_margin : float
            Least distance of L from -1, between 0 and 1; 0.6 leaves some to the position loop around this one.
        yaw_ratio : float
            Bandwidth of the heading as a share of that of the tilt: the torque about z is weak.

        Returns
        -------
        AttitudeGains

        Raises
        ------
        ValueError
            For a sharpness below 1, a damping ratio below 0.75, or a margin that no gain gives.

        Examples
        --------
        >>> gains = Multirotor(delay=0.01).gains(0.002)
        >>> [round(gain, 2) for gain in (*gains.kR, *gains.kw)]
        [163.43, 10.21, 25.57, 6.39]
        """
        return attitude_gains(
            motor_lag=self.motor_lag,
            delay=self.delay + 0.5 * dt,
            sharpness=sharpness,
            damping=damping,
            modulus_margin=modulus_margin,
            yaw_ratio=yaw_ratio,
        )

    def attitude(
        self,
        dt: float,
        *,
        gains: AttitudeGains | None = None,
        thrust_lead: float | None = None,
        yaw: float = 0.0,
        trim: ArrayLike | None = None,
        torque_estimate: bool = False,
        name: str = "attitude",
    ) -> SampledBlock:
        """Rotor thrusts for a wanted force: :func:`attitude_controller`.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        gains : AttitudeGains, optional
            None means those of :meth:`gains`.
        thrust_lead : float, optional
            In s; None means motor_lag + delay + dt/2.
        yaw : float
            Wanted heading in rad.
        trim : (3,) array, optional
            Known constant torque on the body in N m.
        torque_estimate : bool
            Whether there is an input tau_hat.
        name : str
            Of the block.
        """
        return attitude_controller(
            self,
            self.gains(dt) if gains is None else gains,
            thrust_lead=thrust_lead,
            yaw=yaw,
            trim=trim,
            torque_estimate=torque_estimate,
            dt=dt,
            name=name,
        )

    def position(
        self,
        dt: float,
        *,
        kp: ArrayLike,
        kd: ArrayLike,
        ki: ArrayLike = 0.0,
        integral_limit: ArrayLike = 3.0,
        gains: AttitudeGains | None = None,
        drag_lead: float | None = None,
        name: str = "position",
    ) -> SampledBlock:
        """Force that makes the vehicle follow a trajectory, with drag fed forward.

            F = m (a_ref + g e_z + Kp e_r + Kd e_v + i) + R D R' (v_ref + drag_lead a_ref) - f_hat
            e_r = r_ref - r,    e_v = v_ref - v
            i_(k+1) = clip(i_k + Ki h e_r, -integral_limit, integral_limit)

        with D = diag(drag), R the measured attitude, h the period, and i = 0 on an axis with Ki = 0.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        kp, kd, ki : number or (2,) array
            Gains in 1/s^2, 1/s and 1/s^3: horizontal and vertical, or one for both.
        integral_limit : number or (2,) array
            Largest acceleration in m/s^2 that the integral asks for on each axis; it stops there (clamping) and does
            not wind up.
        gains : AttitudeGains, optional
            Of the attitude loop; None means those of :meth:`gains`.
        drag_lead : float, optional
            How much earlier in s the drag's share of F is asked for. The attitude loop knows the rate of the rest of F
            from the jerk, but follows this share kw/kR later: None means that.
        name : str
            Of the block.

        Returns
        -------
        SampledBlock
            Inputs r, v and q (measured), r_ref, v_ref, a_ref, and f_hat (estimate of the unknown force, N, world;
            optional); output F (N, world). Parameters mass, gravity, drag, the gains and limits with two entries, and
            drag_lead.

        Raises
        ------
        ValueError
            For a period that is not positive, or gains or limits that are negative or of another shape.

        Notes
        -----
        The drag acts at the reference's speed, not at the measured one, so that it adds no feedback: M. Faessler,
        A. Franchi, D. Scaramuzza, "Differential flatness of quadrotor dynamics subject to rotor drag for accurate
        tracking of high-speed trajectories", IEEE Robotics and Automation Letters 3(2), 2018.

        Examples
        --------
        Hover, 0.1 m too low:

        >>> block = Multirotor(mass=3.0).position(0.002, kp=[5.0, 8.0], kd=4.0)
        >>> inputs = [0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0] + [0.0] * 15
        >>> values = [entry.start for entry in block.law.parameters]
        >>> block.law.output(0.0, [0.0] * 3, inputs, values).full().ravel().round(3).tolist()
        [0.0, 0.0, 31.83]
        """
        if drag_lead is None:
            inner = self.gains(dt) if gains is None else gains
            drag_lead = inner.kw[0] / inner.kR[0]
        return position_controller(
            mass=self.mass,
            gravity=self.gravity,
            drag=self.drag,
            kp=kp,
            kd=kd,
            ki=ki,
            integral_limit=integral_limit,
            drag_lead=drag_lead,
            dt=dt,
            name=name,
        )

    def known_force(self, dt: float, *, kind: KnownForce = "applied", name: str = "prior") -> SampledBlock:
        """The known part g of m v' = g + f: thrust, weight and rotor drag.

            g = thrust - m g e_z - R D R' v

        with the measured attitude R and velocity v, and as thrust

        * applied: R e_z times the thrust that a model of the rotors gives on the commands, delayed as they are;
        * collective: R e_z times the thrust commanded, as if neither motor lag nor delay were;
        * commanded: the force F that was wanted, as if the vehicle turned at once as well.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        kind : {"applied", "collective", "commanded"}
        name : str
            Of the block.

        Returns
        -------
        SampledBlock
            Inputs thrust (N, commanded to each rotor, not delayed), q and v (m/s, world), both measured, and F (N,
            world); that of thrust and F which the kind does not use is optional. Output g (N, world). Parameters mass,
            gravity, drag, motor_lag and rotor_max.

        Notes
        -----
        No command of the present instant acts on g, so that a command may depend on the force that an estimator finds
        with g, without an algebraic loop. What collective and commanded leave out, motor lag, delay and turning, an
        estimator finds as part of f.

        Examples
        --------
        >>> prior = Multirotor(delay=0.01).known_force(0.002)
        >>> prior.input_labels[:5], prior.output_labels
        (['thrust[0]', 'thrust[1]', 'thrust[2]', 'thrust[3]', 'q[0]'], ['g[0]', 'g[1]', 'g[2]'])
        """
        return known_force(
            mass=self.mass,
            gravity=self.gravity,
            drag=self.drag,
            motor_lag=self.motor_lag,
            rotor_max=self.rotor_max,
            delay_steps=self.delay_steps(dt),
            kind=kind,
            dt=dt,
            name=name,
        )

    def known_torque(
        self,
        dt: float,
        *,
        trim: ArrayLike = (0.0, 0.0, 0.0),
        start: ArrayLike | None = None,
        name: str = "prior_torque",
    ) -> SampledBlock:
        """The known part g of J omega' = g + f: torque of the rotors, gyroscopic torque, and what is known to pull.

            g = tau - omega x J omega + trim,      (T, tau) = A rotor

        with the measured angular velocity, and the rotors' thrusts as a model of them gives them on the commands,
        delayed as they are.

        Parameters
        ----------
        dt : float
            Sampling interval in seconds.
        trim : (3,) array
            Known constant torque in body axes in N m.
        start : number or (4,) array, optional
            Thrust of each rotor before the first sample in N; None means :attr:`hover`.
        name : str
            Of the block.

        Returns
        -------
        SampledBlock
            Inputs thrust (N, commanded to each rotor, not delayed) and omega (rad/s, body, measured); output g (N m,
            body). Parameters J, arm, torque_ratio, motor_lag, rotor_max and trim.
        """
        return known_torque(
            J=self.J,
            arm=self.arm,
            torque_ratio=self.torque_ratio,
            motor_lag=self.motor_lag,
            rotor_max=self.rotor_max,
            trim=trim,
            start=self.hover if start is None else start,
            delay_steps=self.delay_steps(dt),
            dt=dt,
            name=name,
        )
