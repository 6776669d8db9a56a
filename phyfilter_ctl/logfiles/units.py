"""Units of well-known fields, where a format leaves them to its documentation.

Sources: the comments of PX4's ``msg/*.msg``; those of ROS ``common_interfaces``, and REP 103; the log groups of the
Crazyflie's firmware.
"""

from __future__ import annotations

import re


def _each(names: str, unit: str) -> dict[str, str]:
    return dict.fromkeys(names.split(), unit)


_MOTION = {**_each("x y z", "m"), **_each("vx vy vz", "m/s"), **_each("ax ay az", "m/s^2")}

_PX4: dict[str, dict[str, str]] = {
    "vehicle_local_position": {
        **_MOTION,
        **_each("eph epv ref_alt dist_bottom", "m"),
        **_each("evh evv z_deriv", "m/s"),
        **_each("ref_lat ref_lon", "deg"),
        "heading": "rad",
    },
    "vehicle_local_position_setpoint": {
        **_MOTION,
        "acceleration": "m/s^2",
        "thrust": "1",
        "yaw": "rad",
        "yawspeed": "rad/s",
    },
    "vehicle_odometry": {"position": "m", "q": "1", "velocity": "m/s", "angular_velocity": "rad/s"},
    "vehicle_attitude": {"q": "1"},
    "vehicle_attitude_setpoint": {"q_d": "1", "thrust_body": "1"},
    "vehicle_angular_velocity": {"xyz": "rad/s", "xyz_derivative": "rad/s^2"},
    "vehicle_acceleration": {"xyz": "m/s^2"},
    "sensor_accel": _each("x y z", "m/s^2"),
    "sensor_gyro": _each("x y z", "rad/s"),
    "actuator_motors": {"control": "1"},
    "vehicle_thrust_setpoint": {"xyz": "1"},
    "vehicle_torque_setpoint": {"xyz": "1"},
    "wind": _each("windspeed_north windspeed_east", "m/s"),
}
# PX4 also spells units in names: gyro_rad, accelerometer_m_s2, voltage_v.
_PX4_ENDINGS = (
    ("_m_s2", "m/s^2"),
    ("_m_s", "m/s"),
    ("_rad_s", "rad/s"),
    ("_rad", "rad"),
    ("_deg", "deg"),
    ("_rpm", "rpm"),
    ("_pa", "Pa"),
    ("_v", "V"),
    ("_a", "A"),
    ("_m", "m"),
    ("_ga", "Gauss"),
)

_ROS: dict[str, dict[str, str]] = {
    "geometry_msgs/msg/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/msg/Accel": {"linear": "m/s^2", "angular": "rad/s^2"},
    "geometry_msgs/msg/Pose": {"position": "m", "orientation": "1"},
    "geometry_msgs/msg/Transform": {"translation": "m", "rotation": "1"},
    "geometry_msgs/msg/Wrench": {"force": "N", "torque": "N m"},
    "geometry_msgs/msg/PointStamped": {"point": "m"},
    "geometry_msgs/msg/Inertia": {"m": "kg", "com": "m"},
    "sensor_msgs/msg/Imu": {"orientation": "1", "angular_velocity": "rad/s", "linear_acceleration": "m/s^2"},
    "sensor_msgs/msg/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/msg/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/msg/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current": "A", "percentage": "1"},
}

_CRAZYFLIE: dict[str, str] = {
    **{f"stateEstimate.{name}": unit for name, unit in _MOTION.items() if name[0] != "a"},
    **_each("stateEstimate.ax stateEstimate.ay stateEstimate.az acc.x acc.y acc.z", "g"),
    **_each("stateEstimate.roll stateEstimate.pitch stateEstimate.yaw", "deg"),
    **_each("stateEstimate.qx stateEstimate.qy stateEstimate.qz stateEstimate.qw", "1"),
    **_each("gyro.x gyro.y gyro.z", "deg/s"),
    **_each("stateEstimateZ.x stateEstimateZ.y stateEstimateZ.z", "mm"),
    **_each("stateEstimateZ.vx stateEstimateZ.vy stateEstimateZ.vz", "mm/s"),
    **_each("stateEstimateZ.ax stateEstimateZ.ay stateEstimateZ.az", "mm/s^2"),
    **_each("rpm.m1 rpm.m2 rpm.m3 rpm.m4", "rpm"),
    "pm.vbat": "V",
}


def px4(topic: str, field: str) -> str:
    """Unit of a field of a uORB topic; empty where it is not known."""
    base = re.sub(r"\[\d+\]", "", field)
    return _PX4.get(topic, {}).get(base) or next((u for end, u in _PX4_ENDINGS if base.endswith(end)), "")


def ros(message: str, field: str) -> str:
    """Unit of what a field of a ROS message holds, its members included; empty where it is not known."""
    return _ROS.get(message, {}).get(field, "")


def crazyflie(variable: str) -> str:
    """Unit of a log variable of the Crazyflie; empty where it is not known."""
    return _CRAZYFLIE.get(variable, "")
