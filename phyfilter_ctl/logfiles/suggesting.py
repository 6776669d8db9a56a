"""Which fields of a log may be x, g and the label of a recording: by the names their makers gave them."""

from __future__ import annotations

import re
from dataclasses import dataclass

from .logfile import LogFile, Topic


@dataclass(frozen=True)
class Suggestion:
    """Fields that may serve; which frame and sign they have is for a person to say.

    Attributes
    ----------
    signal : str
        "x", "g" (or what g is made of) or "label".
    topic : str
    fields : tuple of str
    why : str
    """

    signal: str
    topic: str
    fields: tuple[str, ...]
    why: str


# Signal, name of the topic or type of its messages, fields, what they are.
_KNOWN: tuple[tuple[str, str, str, str], ...] = (
    ("x", r"vehicle_local_position|VehicleLocalPosition", "vx vy vz", "velocity, PX4's estimate, NED"),
    ("x", r"vehicle_angular_velocity|VehicleAngularVelocity", "xyz", "angular rate, PX4's, body axes FRD"),
    ("x", r"XKF1|NKF1", "VN VE VD", "velocity, ArduPilot's estimate, NED"),
    ("x", r"nav_msgs/msg/Odometry", "twist.twist.linear", "velocity, in the axes of child_frame_id"),
    ("x", r"geometry_msgs/msg/Twist(WithCovariance)?Stamped", "twist.linear", "velocity"),
    ("x", r"sensor_msgs/msg/JointState", "velocity", "joint velocities"),
    ("x", r"", "stateEstimate.vx stateEstimate.vy stateEstimate.vz", "velocity, the Crazyflie's estimate"),
    ("x", r"", "vx vy vz", "velocity by its name"),
    (
        "g",
        r"vehicle_attitude|VehicleAttitude",
        "q",
        "attitude, w first, FRD to NED: turns thrust into the axes of x",
    ),
    (
        "g",
        r"actuator_motors|ActuatorMotors",
        "control",
        "commands of the motors, 0 to 1: a thrust model makes g of it",
    ),
    (
        "g",
        r"vehicle_thrust_setpoint|VehicleThrustSetpoint",
        "xyz",
        "commanded thrust, normalised, body axes FRD",
    ),
    ("g", r"ATT", "Roll Pitch Yaw", "attitude: turns thrust into the axes of x"),
    ("g", r"RCOU", "C1 C2 C3 C4", "outputs to the motors, us of PWM: a thrust model makes g of them"),
    ("g", r"sensor_msgs/msg/JointState", "effort", "joint torques or forces"),
    ("g", r"geometry_msgs/msg/WrenchStamped", "wrench.force", "force"),
    ("g", r"", "stateEstimate.qx stateEstimate.qy stateEstimate.qz stateEstimate.qw", "attitude, w last"),
    (
        "g",
        r"",
        "motor.m1 motor.m2 motor.m3 motor.m4",
        "commands of the motors: a thrust model makes g of them",
    ),
    (
        "label",
        r"vehicle_local_position|VehicleLocalPosition",
        "ax ay az",
        "acceleration, PX4's estimate, NED",
    ),
    (
        "label",
        r"vehicle_acceleration|VehicleAcceleration",
        "xyz",
        "specific force, without gravity, body axes FRD",
    ),
    (
        "label",
        r"sensor_combined|SensorCombined",
        "accelerometer_m_s2",
        "specific force, without gravity, body axes FRD",
    ),
    ("label", r"IMU", "AccX AccY AccZ", "specific force, without gravity, body axes FRD"),
    (
        "label",
        r"sensor_msgs/msg/Imu",
        "linear_acceleration",
        "specific force, without gravity, axes of the sensor",
    ),
    ("label", r"", "ax ay az", "acceleration by its name"),
)


_AXIS = r"(_?[xyz\d])?(\[\d+\])?"
_VELOCITY = re.compile(
    rf"(v|vel|velocity|speed|omega|w|rate|gyro|qd|dq){_AXIS}(_(m_s|mps|kmh|km_h|rad_s|deg_s|rpm))?",
    re.IGNORECASE,
)
_FORCE = re.compile(
    rf"(f|force|thrust|torque|tau|effort|moment|u|cmd|command){_AXIS}(_(n|kn|nm|n_m|lbf))?", re.IGNORECASE
)
_UNITS = {
    "m/s": _VELOCITY,
    "km/h": _VELOCITY,
    "rad/s": _VELOCITY,
    "deg/s": _VELOCITY,
    "N": _FORCE,
    "N m": _FORCE,
}


def is_velocity(name: str, unit: str = "") -> bool:
    """Whether a field's unit, or its name, is that of a velocity."""
    return _is(_VELOCITY, name, unit)


def is_force(name: str, unit: str = "") -> bool:
    """Whether a field's unit, or its name, is that of a force, a torque or a command.

    Examples
    --------
    >>> is_force("force_N"), is_force("thrust"), is_force("fuel"), is_force("speed", "m/s")
    (True, True, False, False)
    """
    return _is(_FORCE, name, unit)


def _is(kind: re.Pattern[str], name: str, unit: str) -> bool:
    base = re.sub(r" *[\[(][^\d\])][^\])]*[\])]$", "", name).strip()
    return _UNITS[unit] is kind if unit in _UNITS else bool(kind.fullmatch(base))


def suggestions(log: LogFile) -> tuple[Suggestion, ...]:
    """Fields that may be x, what g is made of, or a label: known ones of PX4, ArduPilot, ROS and the Crazyflie.

    Parameters
    ----------
    log : LogFile

    Returns
    -------
    tuple of Suggestion
        Empty where nothing is known.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from phyfilter_ctl.logfiles import open_log
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder) / "short.csv"
    ...     _ = path.write_text("t_s,vx,vy,vz\\n0,1,2,3\\n1,1,2,3\\n")
    ...     suggestions(open_log(path))
    (Suggestion(signal='x', topic='table', fields=('vx', 'vy', 'vz'), why='velocity by its name'),)
    """
    found: dict[tuple[str, str], Suggestion] = {}
    for signal, pattern, fields, why in _KNOWN:
        for topic in log.topics:
            if (signal, topic.name) not in found and (names := _found(topic, pattern, fields)):
                found[signal, topic.name] = Suggestion(signal, topic.name, names, why)
    order = ("x", "g", "label")
    return tuple(sorted(found.values(), key=lambda each: order.index(each.signal)))


def _found(topic: Topic, pattern: str, fields: str) -> tuple[str, ...]:
    """The fields where the topic, or the type that its notes begin with, is the one meant; members of a vector too."""
    own = re.sub(r"\[\w+\]$", "", topic.name.rpartition("/")[2])
    kind = topic.notes[0] if topic.notes else ""
    if pattern and not any(re.fullmatch(pattern, name) for name in (own, kind, kind.rpartition("/")[2])):
        return ()
    there = {
        field.name: re.sub(r" *[\[(].*", "", field.name) for field in topic.fields
    }  # without a unit in brackets
    names = [
        n for want in fields.split() for n, base in there.items() if base == want or n.startswith(f"{want}.")
    ]
    return tuple(names) if len(names) >= len(fields.split()) else ()
