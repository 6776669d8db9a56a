"""What flies: delay of the commands, platform and arm, load, wind and sensors."""

from __future__ import annotations

from functools import lru_cache

import control as ct
import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.blocks import FunctionBlock, delay_line, wired
from phyfilter_ctl.controllers import Multirotor
from phyfilter_ctl.plants import (
    Columns,
    Plant,
    Sensor,
    aerial_manipulator,
    plant,
    sensors,
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
    "nominal",
    "vehicle_part",
]

FloatArray = NDArray[np.float64]

NOISES = {"n_r": 3, "n_v": 3, "n_q": 3, "n_omega": 3, "n_joint": 5, "n_joint_rate": 5, "n_wind": 3}
"""Inputs: unit white noise of sensors and wind, and how many entries each has."""

MEASURED = ("r_m", "v_m", "q_m", "omega_m", "joint_m", "joint_rate_m")
"""What the sensors give."""

SHOWN = ("r", "v", "q", "omega", "r_e", "f_coupling", "f_payload", "f_wind", "tau_coupling", "tau_payload")
"""Outputs of the vehicle that are the truth."""


@lru_cache(maxsize=1)
def nominal() -> Multirotor:
    """What controllers and filters take the vehicle for: platform and arm, rigid and at home."""
    values = params().vehicle
    own = np.asarray(arm().inertia(arm().home), dtype=float)  # about the platform's centre of mass
    return Multirotor(
        mass=values.mass + arm().mass,
        J=np.array(values.inertia) + np.diag(own),
        arm=values.rotor_arm,
        torque_ratio=values.torque_ratio,
        motor_lag=values.motor_lag,
        rotor_max=values.rotor_max,
        drag=values.drag,
        gravity=values.gravity,
        delay=values.delay,
    )


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
        servo=(values.servo_bandwidth, values.servo_damping),
        nominal=(nominal().mass, nominal().J),
        name="manipulator",
    )


def sensors_part() -> Plant:
    """What is measured."""
    values, at_rest = params().sensors, np.zeros(arm().joints)
    return sensors(
        {
            "r": Sensor("position", values.position, "m"),
            "v": Sensor("velocity", values.velocity, "m/s"),
            "q": Sensor("attitude", values.attitude, "rad", quaternion=True),
            "omega": Sensor("rate", values.rate, "rad/s"),
            "joint": Sensor("joint", values.joint, "rad", arm().home),
            "joint_rate": Sensor("joint_rate", values.joint_rate, "rad/s", at_rest),
        }
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
        params={"mass": (params().mission.payload, "kg"), "held": (0.0, "kg")},
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
        nominal().delay_steps(dt),
        dt,
        name="delay",
        start=level_thrusts(),
        unit="N",
    )
    signals = {name: f"manipulator.{name}" for name in (*SHOWN, "joint", "joint_rate")}
    signals |= {name: f"sensors.{name}" for name in MEASURED} | {
        "wind": "wind.wind",
        "payload": "load.payload",
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
        [delay, manipulator(), load(), wind(), sensors_part()],
        signals | {"manipulator.thrust": "delay.thrust_delayed"},
        inputs=inputs,
        outputs=[*MEASURED, *SHOWN, "wind"],
        name="vehicle",
    )
