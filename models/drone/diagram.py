"""The closed loop as a python-control diagram.

    reference --> position --F--> attitude --thrust--> delay --> quadrotor --> sensors --+
                     ^                                    |           ^                  |
                     |                                    v          wind                |
                     +--f_hat-- filter <--g-- prior <-----+-----------------q, v --------+
                                   ^------ f_theta -- seer <------ v, g -----------------+

x = m v,  m v' = g + f:  g = the thrust that acts - m g e_z - R D R' v,  f = f_mass + f_wind.
"""

from __future__ import annotations

import control as ct
import numpy as np

from phyfilter_ctl.blocks import FunctionBlock, SampledBlock, delay_line, signal_names, wired
from phyfilter_ctl.controllers import attitude_controller, attitude_gains, known_force, position_controller
from phyfilter_ctl.learned import Chebyshev
from phyfilter_ctl.plants import Columns, Plant, Sensor, plant, quadrotor, sensors, wind_field
from phyfilter_ctl.plants.algebra import Array, rotate
from phyfilter_ctl.plants.factory import Results

from .events import with_events
from .methods import Method, estimator, filter_of, seer_block
from .params import params
from .payload import nothing, payload_systems
from .reference import circle

__all__ = ["MEASURED", "NOISES", "build", "controller_part", "filter_part", "steps_of_delay", "vehicle_part"]

NOISES = ("n_r", "n_v", "n_q", "n_omega", "n_a", "n_wind")
"""Inputs of three entries each: unit white noise of the sensors and of the wind."""

MEASURED = ("r_m", "v_m", "q_m", "omega_m", "a_m")
"""What the sensors give."""


def steps_of_delay() -> int:
    """Samples between a command and the rotors."""
    return round(params().vehicle.delay / params().sampling.dt)


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


def quadrotor_plant() -> FunctionBlock:
    """The vehicle of ``params.toml``."""
    values = params().vehicle
    return quadrotor(
        mass=values.mass,
        J=values.inertia,
        arm=values.arm,
        torque_ratio=values.torque_ratio,
        motor_lag=values.motor_lag,
        drag=values.drag,
        gravity=values.gravity,
        rotor_max=values.rotor_max,
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


def thrust_delay(steps: int, name: str = "delay") -> SampledBlock:
    """Commands that reach the rotors some samples late, hovering until the first has come through."""
    labels, hover = (
        [f"thrust[{i}]" for i in range(4)],
        0.25 * params().vehicle.mass * params().vehicle.gravity,
    )
    return delay_line(labels, steps, params().sampling.dt, name=name, start=hover, unit="N")


def vehicle_part(*, delayed: bool = True, events: bool = False) -> ct.InterconnectedSystem:
    """What flies: delay of the commands, vehicle, wind and sensors.

    Parameters
    ----------
    delayed : bool
        False leaves the delay out: there is no sampled block then.
    events : bool
        Whether the vehicle has the parameters of :func:`~.events.with_events`.
    """
    delay = [thrust_delay(steps_of_delay())] if delayed else []
    wires = {
        "wind.r": "quadrotor.r",
        "quadrotor.wind": "wind.wind",
        **({"quadrotor.thrust": "delay.thrust_delayed"} if delayed else {}),
    }
    return wired(
        [*delay, with_events(quadrotor_plant()) if events else quadrotor_plant(), wind(), sensors_part()],
        wires | {f"sensors.{name}": f"quadrotor.{name}" for name in ("r", "v", "q", "omega", "a")},
        inputs={"thrust": "delay.thrust" if delayed else "quadrotor.thrust", "n_wind": "wind.noise"}
        | {name: f"sensors.{name}" for name in NOISES if name != "n_wind"},
        outputs={name: f"sensors.{name}" for name in MEASURED}
        | {name: f"quadrotor.{name}" for name in ("r", "v", "q", "f_mass", "f_wind")}
        | {"wind": "wind.wind"},
        name="vehicle",
    )


def controller_part(method: Method) -> ct.InterconnectedSystem:
    """What tracks: reference, outer loop and attitude loop."""
    vehicle, dt = params().vehicle, params().sampling.dt
    kp, kd, ki = method.gains
    # A held command acts half a sample later on average.
    late = vehicle.delay + 0.5 * dt
    gains = attitude_gains(motor_lag=vehicle.motor_lag, delay=late, sharpness=params().tuning.sharpness)
    position = position_controller(
        mass=vehicle.mass,
        gravity=vehicle.gravity,
        drag=vehicle.drag,
        drag_lead=gains.kw[0] / gains.kR[0],  # the attitude loop's lag
        kp=kp,
        kd=kd,
        ki=ki,
        dt=dt,
    )
    attitude = attitude_controller(
        mass=vehicle.mass,
        J=vehicle.inertia,
        arm=vehicle.arm,
        torque_ratio=vehicle.torque_ratio,
        gravity=vehicle.gravity,
        rotor_max=vehicle.rotor_max,
        kR=gains.kR,
        kw=gains.kw,
        motor_lag=vehicle.motor_lag,
        lead_filter=gains.lead_filter,
        delay=late,
        dt=dt,
    )
    wires = {f"position.{name}": f"reference.{name}" for name in ("r_ref", "v_ref", "a_ref")}
    return wired(
        [circle(), position, attitude],
        wires | {"attitude.j_ref": "reference.j_ref", "attitude.F": "position.F"},
        inputs={
            "r_m": "position.r",
            "v_m": "position.v",
            "q_m": ["position.q", "attitude.q"],
            "omega_m": "attitude.omega",
            "f_hat": "position.f_hat",
        },
        outputs={
            "F": "position.F",
            "thrust": "attitude.thrust",
            "r_ref": "reference.r_ref",
            "v_ref": "reference.v_ref",
        },
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
    vehicle, dt = params().vehicle, params().sampling.dt
    block = estimator(method)
    if block is None and not method.uses_seer:
        return None
    known = known_force(
        mass=vehicle.mass,
        gravity=vehicle.gravity,
        drag=vehicle.drag,
        motor_lag=vehicle.motor_lag,
        rotor_max=vehicle.rotor_max,
        delay_steps=steps_of_delay(),
        kind=method.known,
        dt=dt,
        name="prior",
    )
    systems: list[ct.InputOutputSystem] = [momentum(), known if prior is None else prior]
    wires: dict[str, str] = {}
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
        wires |= {
            "history.v_before": "past.v_delayed",
            "seer.z": "history.z",
            "seer.x": "momentum.x",
            "seer.g": "prior.g",
        }
        velocity += ["past.v", "history.v"]
        outputs |= {"f_theta": "seer.f_theta"}
    if block is not None:
        systems.append(block)
        outputs |= {"f_hat": "filter.f_hat"}
        if method.name == "indi":
            felt, wires = "filter", wires | {"filter.g": "prior.g"}
        elif method.name == "accelerometer":
            systems.append(measured_force())
            felt = "measured"
            wires |= {"measured.g": "prior.g", "filter.g": "measured.g", "filter.x": "measured.x"}
        else:
            wires |= {"filter.g": "prior.g", "filter.x": "momentum.x"}
        if method.uses_seer and method.model_scale != 1.0:
            systems.append(_scaled(method.model_scale))
            wires |= {"scaled.f": "seer.f_theta", "filter.f_theta": "scaled.f_theta"}
            outputs |= {"f_theta": "scaled.f_theta"}
        elif method.uses_seer:
            wires |= {"filter.f_theta": "seer.f_theta"}
        elif method.payload != "lumped":
            more, own = payload_systems(method.payload == "told")
            systems += more
            wires |= own | {"filter.f_theta": "payload_model.f_theta"}
            outputs |= {"f_theta": "payload_model.f_theta"}
        elif filter_of(method) is not None:
            systems.append(nothing("no_model"))
            wires |= {"filter.f_theta": "no_model.zero"}
    else:
        outputs |= {"f_hat": "seer.f_theta"}
    inputs: dict[str, str | list[str]] = {
        "v_m": velocity,
        "q_m": attitude if felt is None else [*attitude, f"{felt}.q"],
        **({"thrust": "prior.thrust"} if prior is None else {}),
        "F": "prior.F",
    }
    if felt is not None:
        inputs["a_m"] = f"{felt}.a"
    return wired(systems, wires, inputs=inputs, outputs=outputs, name="estimator")


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
    wires = {f"controller.{name}": f"vehicle.{name}" for name in MEASURED if name != "a_m"}
    wires |= {"vehicle.thrust": "controller.thrust"}
    outputs = {name: f"vehicle.{name}" for name in ("r", "v", "q", "f_mass", "f_wind", "wind", *MEASURED)}
    outputs |= {name: f"controller.{name}" for name in ("r_ref", "v_ref", "F", "thrust")}
    systems: list[ct.InputOutputSystem] = [vehicle, controller]
    if late := method.late + (steps_of_delay() if delay_apart else 0):
        systems.append(thrust_delay(late, "late"))
        wires |= {"late.thrust": "controller.thrust", "vehicle.thrust": "late.thrust_delayed"}
    if filter is not None:
        systems.append(filter)
        wires |= {"controller.f_hat": "estimator.f_hat"}
        known = signal_names(filter.input_labels)
        wires |= {f"estimator.{name}": f"controller.{name}" for name in ("F", "thrust") if name in known}
        wires |= {f"estimator.{name}": f"vehicle.{name}" for name in MEASURED if name in known}
        outputs |= {name: f"estimator.{name}" for name in signal_names(filter.output_labels)}
    else:
        systems.append(nothing("no_estimate"))
        wires |= {"controller.f_hat": "no_estimate.zero"}
    return wired(
        systems, wires, inputs={name: f"vehicle.{name}" for name in NOISES}, outputs=outputs, name="drone"
    )
