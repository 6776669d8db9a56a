"""The closed loop as a python-control diagram.

    reference --> position --F--> attitude --thrust--> delay --> quadrotor --> sensors --+
                     ^                                    |           ^                  |
                     |                                    v          wind                |
                     +--f_hat-- filter <--g-- prior <-----+-----------------q, v --------+
                                   ^------ f_theta -- seer <------ v, g -----------------+

x = m v,  m v' = g + f:  g = the thrust that acts - m g e_z - R D R' v,  f = f_mass + f_wind.
"""

from __future__ import annotations

from dataclasses import replace

import control as ct
import numpy as np

from phyfilter_ctl.blocks import FunctionBlock, delay_line, signal_names, wired
from phyfilter_ctl.controllers import Multirotor
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.plants import Columns, Plant, Sensor, circle, plant, rotate, sensors, wind_field
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .events import with_events
from .methods import Method, estimator, seer_block
from .params import params
from .payload import payload_systems

__all__ = ["MEASURED", "NOISES", "build", "controller_part", "filter_part", "multirotor", "vehicle_part"]

NOISES = ("n_r", "n_v", "n_q", "n_omega", "n_a", "n_wind")
"""Inputs of three entries each: unit white noise of the sensors and of the wind."""

MEASURED = ("r_m", "v_m", "q_m", "omega_m", "a_m")
"""What the sensors give."""


def multirotor() -> Multirotor:
    """The vehicle of ``params.toml``."""
    values = params().vehicle
    return Multirotor(
        mass=values.mass,
        J=values.inertia,
        arm=values.arm,
        torque_ratio=values.torque_ratio,
        motor_lag=values.motor_lag,
        rotor_max=values.rotor_max,
        drag=values.drag,
        gravity=values.gravity,
        delay=values.delay,
    )


def sensors_part() -> Plant:
    """What is measured."""
    values = params().sensors
    return sensors(
        {
            "r": Sensor("position", values.position, "m"),
            "v": Sensor("velocity", values.velocity, "m/s"),
            "q": Sensor("attitude", values.attitude, "rad", quaternion=True),
            "omega": Sensor("rate", values.rate, "rad/s"),
            "a": Sensor("specific_force", values.specific_force, "m/s^2"),
        }
    )


def momentum() -> FunctionBlock:
    """x = m v with the nominal mass."""

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"x": p.mass * u.v}

    return plant(
        equations,
        name="momentum",
        states={},
        inputs={"v": (np.zeros(3), "m/s")},
        outputs={"x": "kg m/s"},
        params={"mass": (params().vehicle.mass, "kg")},
    )


def measured_force() -> FunctionBlock:
    """What PhyFilter takes where v' is measured: x = 0, and g less M x' in the place of g.

    f_hat = f_theta + s F x - F (g + f_theta) becomes f_theta + F (M x' - g - f_theta): the same F, no difference of x.
    """
    vehicle = params().vehicle

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {
            "g": u.g - p.mass * (rotate(u.q, u.a) - p.gravity * np.array([0.0, 0.0, 1.0])),
            "x": np.zeros(3),
        }

    return plant(
        equations,
        name="measured",
        states={},
        inputs={
            "a": (np.zeros(3), "m/s^2", "measured specific force, body frame"),
            "q": ([1.0, 0.0, 0.0, 0.0], "", "measured attitude"),
            "g": (np.zeros(3), "N", "known force"),
        },
        outputs={"g": "N", "x": "kg m/s"},
        params={"mass": (vehicle.mass, "kg"), "gravity": (vehicle.gravity, "m/s^2")},
    )


def _scaled(factor: float) -> FunctionBlock:
    """A model that is wrong by a factor."""
    return plant(
        lambda t, x, u, p: ({}, {"f_theta": p.factor * u.f}),
        name="scaled",
        states={},
        inputs={"f": (np.zeros(3), "N")},
        outputs={"f_theta": "N"},
        params={"factor": (factor, "")},
    )


def acceleration_feature(period: float) -> FunctionBlock:
    """SEER-I's feature: the difference of two velocities of the history over their distance in time."""

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"z": (u.v - u.v_before) / p.distance}

    return plant(
        equations,
        name="history",
        states={},
        inputs={"v": (np.zeros(3), "m/s"), "v_before": (np.zeros(3), "m/s")},
        outputs={"z": "m/s^2"},
        params={"distance": (period, "s")},
    )


def wind() -> FunctionBlock:
    """The fan of ``params.toml``, switched off: speed, directions and turbulence are drawn per flight."""
    values, mission = params().wind, params().mission
    return wind_field(
        jet_speed=0.0,
        airspeed=values.airspeed,
        jet_origin=(-values.fan_distance, values.jet_offset, mission.height),
        jet_direction=(1.0, 0.0, 0.0),
        jet_width=values.jet_width,
        turbulence=values.turbulence,
        length_scale=values.length_scale,
        noise_interval=params().sampling.dt,
    )


def vehicle_part(*, delayed: bool = True, events: bool = False) -> ct.InterconnectedSystem:
    """What flies: delay of the commands, vehicle, wind and sensors.

    Parameters
    ----------
    delayed : bool
        False leaves the delay out: there is no sampled block then.
    events : bool
        Whether the vehicle has the parameters of :func:`~.events.with_events`.
    """
    drone, dt = multirotor(), params().sampling.dt
    delay = [drone.thrust_delay(dt)] if delayed else []
    signals = {name: f"quadrotor.{name}" for name in ("r", "v", "q", "omega", "a", "f_mass", "f_wind")}
    signals |= {name: f"sensors.{name}" for name in MEASURED} | {"wind": "wind.wind"}
    return wired(
        [*delay, with_events(drone.plant()) if events else drone.plant(), wind(), sensors_part()],
        signals | ({"quadrotor.thrust": "delay.thrust_delayed"} if delayed else {}),
        inputs={"thrust": "delay.thrust" if delayed else "quadrotor.thrust", "n_wind": "wind.noise"}
        | {name: f"sensors.{name}" for name in NOISES if name != "n_wind"},
        outputs=[*MEASURED, "r", "v", "q", "f_mass", "f_wind", "wind"],
        name="vehicle",
    )


def controller_part(method: Method) -> ct.InterconnectedSystem:
    """What tracks: reference, outer loop and attitude loop."""
    drone, dt = multirotor(), params().sampling.dt
    kp, kd, ki = method.gains
    gains = drone.gains(dt, sharpness=params().tuning.sharpness)
    position = drone.position(dt, kp=kp, kd=kd, ki=ki, gains=gains)
    # Half a sample earlier than the default, as it was when all methods were tuned.
    lead = drone.motor_lag + (drone.delay + 0.5 * dt) + 0.5 * dt
    attitude = drone.attitude(dt, gains=gains, thrust_lead=lead)
    values = params().mission
    reference = circle(radius=values.radius, speed=values.speed, height=values.height, ramp=values.ramp)
    signals = {name: f"reference.{name}" for name in ("r_ref", "v_ref", "a_ref", "j_ref")}
    return wired(
        [reference, position, attitude],
        signals | {"F": "position.F", "thrust": "attitude.thrust"},
        inputs={
            "r_m": "position.r",
            "v_m": "position.v",
            "q_m": ["position.q", "attitude.q"],
            "omega_m": "attitude.omega",
            "f_hat": "position.f_hat",
        },
        outputs=["F", "thrust", "r_ref", "v_ref"],
        name="controller",
    )


def filter_part(
    method: Method, model: Chebyshev | None = None, *, prior: FunctionBlock | None = None
) -> ct.InterconnectedSystem | None:
    """What estimates the unknown force from the measurements and the commands; None where the method does not.

    Parameters
    ----------
    method : Method
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    prior : FunctionBlock, optional
        Another known force than that of the method: named "prior", inputs F, q and v, output g.

    Raises
    ------
    ValueError
        If the method needs a model and none is given.
    """
    dt = params().sampling.dt
    block = estimator(method)
    if block is None and not method.uses_seer:
        return None
    known = multirotor().known_force(dt, kind=method.known)
    systems: list[ct.InputOutputSystem] = [momentum(), known if prior is None else prior]
    signals = {"g": "prior.g"}
    velocity, attitude, felt = ["momentum.v", "prior.v"], ["prior.q"], None
    outputs = {"g": "prior.g"}
    if method.uses_seer:
        if model is None:
            raise ValueError(
                f"{method.name}: expected a trained SEER-I model, got None; training.train() makes one"
            )
        steps = round(params().seer.history / dt)
        systems += [
            delay_line([f"v[{i}]" for i in range(3)], steps, dt, name="past", unit="m/s"),
            acceleration_feature(steps * dt),
            seer_block(method, model),
        ]
        signals |= {"history.v_before": "past.v_delayed", "z": "history.z", "f_theta": "seer.f_theta"}
        velocity += ["past.v", "history.v"]
        outputs |= {"f_theta": "f_theta"}
    if block is not None:
        systems.append(block)
        outputs |= {"f_hat": "filter.f_hat"}
        if method.name == "indi":
            felt = "filter"
        elif method.name == "accelerometer":
            systems.append(measured_force())
            felt = "measured"
            signals |= {"filter.g": "measured.g", "filter.x": "measured.x"}
        if method.uses_seer and method.model_scale != 1.0:
            systems.append(_scaled(method.model_scale))
            signals |= {"scaled.f": "seer.f_theta", "f_theta": "scaled.f_theta"}
        elif not method.uses_seer and method.payload != "lumped":
            more, own = payload_systems(method.payload == "told")
            systems += more
            signals |= own | {"filter.f_theta": "payload_model.f_theta"}
            outputs |= {"f_theta": "payload_model.f_theta"}
    else:
        outputs |= {"f_hat": "seer.f_theta"}
    if felt is None or method.uses_seer:
        signals |= {"x": "momentum.x"}
    inputs: dict[str, str | list[str]] = {
        "v_m": velocity,
        "q_m": attitude if felt is None else [*attitude, f"{felt}.q"],
        **({"thrust": "prior.thrust"} if prior is None else {}),
        "F": "prior.F",
    }
    if felt is not None:
        inputs["a_m"] = f"{felt}.a"
    return wired(systems, signals, inputs=inputs, outputs=outputs, name="estimator")


def build(
    method: Method | None = None,
    model: Chebyshev | None = None,
    *,
    prior: FunctionBlock | None = None,
    delay_apart: bool = False,
    events: bool = False,
) -> ct.InterconnectedSystem:
    """The whole closed loop.

    Parameters
    ----------
    method : Method, optional
        None: the observer of order 1 at 6 rad/s, which needs no training.
    model : Chebyshev, optional
        SEER-I's model, for the methods that use it.
    prior : FunctionBlock, optional
        As for :func:`filter_part`.
    delay_apart : bool
        Whether the delay of the commands is a block of its own, beside the vehicle.
    events : bool
        As for :func:`vehicle_part`.

    Returns
    -------
    control.InterconnectedSystem
        Named "drone". Inputs: white noise of unit variance n_r, n_v, n_q, n_omega, n_a, n_wind, three entries each,
        each value held for a sample. Outputs r, v, q, r_ref, v_ref, f_mass, f_wind, wind, what is measured, F, thrust,
        and where the method has them g, f_theta and f_hat.

    Examples
    --------
    >>> drone = build()
    >>> drone.name, drone.ninputs, drone.output_labels[:3]
    ('drone', 18, ['r[0]', 'r[1]', 'r[2]'])
    """
    method = Method("observer", 2.0, 6.0) if method is None else method
    vehicle, controller = vehicle_part(delayed=not delay_apart, events=events), controller_part(method)
    filter = filter_part(method, model, prior=prior)
    signals = {name: f"vehicle.{name}" for name in ("r", "v", "q", "f_mass", "f_wind", "wind", *MEASURED)}
    signals |= {name: f"controller.{name}" for name in ("r_ref", "v_ref", "F", "thrust")}
    wires: dict[str, str] = {}
    systems: list[ct.InputOutputSystem] = [vehicle, controller]
    drone, dt = multirotor(), params().sampling.dt
    if late := method.late + (drone.delay_steps(dt) if delay_apart else 0):
        systems.append(replace(drone, delay=late * dt).thrust_delay(dt, name="late"))
        wires |= {"vehicle.thrust": "late.thrust_delayed"}
    if filter is not None:
        systems.append(filter)
        signals |= {name: f"estimator.{name}" for name in signal_names(filter.output_labels)}
    return wired(systems, signals | wires, inputs=NOISES, outputs=[*signals], name="drone")
