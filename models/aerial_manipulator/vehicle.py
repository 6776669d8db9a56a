"""What flies: delay of the commands, platform and arm, load, wind and sensors."""

from __future__ import annotations

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.blocks import FunctionBlock, delay_line, wired
from phyfilter_ctl.plants import (
    Columns,
    Plant,
    aerial_manipulator,
    plant,
    quaternion_product,
    stack,
    wind_field,
)
from phyfilter_ctl.plants.algebra import Array
from phyfilter_ctl.plants.factory import Results

from .mission import arm
from .params import params

__all__ = [
    "MEASURED",
    "NOISES",
    "SHOWN",
    "level_thrusts",
    "nominal_inertia",
    "nominal_mass",
    "steps_of_delay",
    "vehicle_part",
]

FloatArray = NDArray[np.float64]

NOISES = {"n_r": 3, "n_v": 3, "n_q": 3, "n_omega": 3, "n_joint": 5, "n_joint_rate": 5, "n_wind": 3}
"""Inputs: unit white noise of sensors and wind, and how many entries each has."""

MEASURED = ("r_m", "v_m", "q_m", "omega_m", "joint_m", "joint_rate_m")
"""What the sensors give."""

SHOWN = ("r", "v", "q", "omega", "r_e", "f_coupling", "f_payload", "f_wind", "tau_coupling", "tau_payload")
"""Outputs of the vehicle that are the truth."""


def steps_of_delay() -> int:
    """Samples between a command and the rotors."""
    return round(params().vehicle.delay / params().sampling.dt)


def nominal_mass() -> float:
    """Platform and arm, kg."""
    return params().vehicle.mass + arm().mass


def nominal_inertia() -> FloatArray:
    """Diagonal of the inertia of platform and arm at home about the platform's centre of mass, kg m^2."""
    own = np.asarray(arm().inertia(arm().home), dtype=float)
    return np.array(params().vehicle.inertia) + np.diag(own)


def level_thrusts() -> FloatArray:
    """Thrust of each rotor that holds platform and arm level and at rest, N."""
    return np.array([entry.start for entry in manipulator().functions.inputs[:4]])


def manipulator() -> Plant:
    """The vehicle of ``params.toml``."""
    values = params().vehicle
    return aerial_manipulator(
        arm=arm(),
        mass=values.mass,
        J=values.inertia,
        rotor_arm=values.rotor_arm,
        torque_ratio=values.torque_ratio,
        motor_lag=values.motor_lag,
        drag=values.drag,
        gravity=values.gravity,
        rotor_max=values.rotor_max,
        servo_bandwidth=values.servo_bandwidth,
        servo_damping=values.servo_damping,
        nominal_mass=nominal_mass(),
        nominal_J=nominal_inertia(),
        name="manipulator",
    )


def sensors() -> Plant:
    """What is measured: the truth and white noise of unit variance, scaled."""
    values, joints = params().sensors, arm().joints
    three, unit = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        tilt = stack(ca.SX(1.0), 0.5 * p.attitude * u.n_q)
        return {}, {
            "r_m": u.r + p.position * u.n_r,
            "v_m": u.v + p.velocity * u.n_v,
            "q_m": quaternion_product(u.q, tilt) / ca.norm_2(tilt),
            "omega_m": u.omega + p.rate * u.n_omega,
            "joint_m": u.joint + p.joint * u.n_joint,
            "joint_rate_m": u.joint_rate + p.joint_rate * u.n_joint_rate,
        }

    return plant(
        equations,
        name="sensors",
        states={},
        inputs={
            "r": (three, "m"),
            "v": (three, "m/s"),
            "q": unit,
            "omega": (three, "rad/s"),
            "joint": (arm().home, "rad"),
            "joint_rate": (np.zeros(joints), "rad/s"),
            **{name: np.zeros(size) for name, size in NOISES.items() if name != "n_wind"},
        },
        outputs={
            "r_m": "m",
            "v_m": "m/s",
            "q_m": "",
            "omega_m": "rad/s",
            "joint_m": "rad",
            "joint_rate_m": "rad/s",
        },
        parameters={
            "position": (values.position, "m"),
            "velocity": (values.velocity, "m/s"),
            "attitude": (values.attitude, "rad"),
            "rate": (values.rate, "rad/s"),
            "joint": (values.joint, "rad"),
            "joint_rate": (values.joint_rate, "rad/s"),
        },
    )


def load() -> FunctionBlock:
    """The load at the gripper: a share of its mass, and what always hangs there (0 but for analysis)."""

    def equations(t: Array, x: Columns, u: Columns, p: Columns) -> tuple[Results, Results]:
        return {}, {"payload": p.mass * u.taken + p.held}

    return plant(
        equations,
        name="load",
        states={},
        inputs={"taken": (0.0, "", "share of the load that hangs")},
        outputs={"payload": "kg"},
        parameters={"mass": (params().mission.payload, "kg"), "held": (0.0, "kg")},
    )


def wind() -> Plant:
    """The fan of ``params.toml``."""
    values = params().wind
    return wind_field(
        jet_speed=values.jet_speed,
        airspeed=values.airspeed,
        jet_origin=values.jet_origin,
        jet_direction=values.jet_direction,
        jet_width=values.jet_width,
        turbulence=values.turbulence,
        length_scale=values.length_scale,
        noise_interval=params().sampling.dt,
    )


def vehicle_part() -> ct.InterconnectedSystem:
    """What flies: delay of the commands, platform and arm, load, wind and sensors."""
    dt = params().sampling.dt
    delay = delay_line(
        [f"thrust[{i}]" for i in range(4)],
        steps_of_delay(),
        dt,
        name="delay",
        start=level_thrusts(),
        unit="N",
    )
    measured = ("r", "v", "q", "omega", "joint", "joint_rate")
    wires = {
        "manipulator.thrust": "delay.thrust_delayed",
        "manipulator.payload": "load.payload",
        "manipulator.wind": "wind.wind",
        "wind.r": "manipulator.r",
        **{f"sensors.{name}": f"manipulator.{name}" for name in measured},
    }
    inputs = {
        "thrust": "delay.thrust",
        "joint_ref": "manipulator.joint_ref",
        "joint_rate_ref": "manipulator.joint_rate_ref",
        "taken": "load.taken",
        **{name: f"sensors.{name}" for name in NOISES if name != "n_wind"},
        "n_wind": "wind.noise",
    }
    return wired(
        [delay, manipulator(), load(), wind(), sensors()],
        wires,
        inputs=inputs,
        outputs={
            **{name: f"sensors.{name}" for name in MEASURED},
            **{name: f"manipulator.{name}" for name in SHOWN},
            "wind": "wind.wind",
        },
        name="vehicle",
    )
