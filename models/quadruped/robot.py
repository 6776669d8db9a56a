"""The quadruped as a generated MJCF model of primitives, and its statics.

Joints in the order FL, FR, HL, HR, each abduction (about x), hip and knee (about y); z up, x forward, y left. Knees
bend backwards: hip angles are positive, knee angles negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.plants import LeggedRobot, load_robot
from phyfilter_ctl.plants.legged.simulator import simulator

from .params import FOLDER, Params, Robot, params

if TYPE_CHECKING:
    from mujoco._structs import MjModel  # the public name is not seen by type checkers

    from .terrain import Terrain

__all__ = [
    "LEGS",
    "SIDE",
    "check_payload",
    "compile_model",
    "hips",
    "joint_inertia",
    "largest_payload",
    "legged",
    "mjcf",
]

FloatArray = NDArray[np.float64]

LEGS = ("FL", "FR", "HL", "HR")
# Left is +1.
SIDE: FloatArray = np.array([1.0, -1.0, 1.0, -1.0])
_FRONT: FloatArray = np.array([1.0, 1.0, -1.0, -1.0])
_JOINTS = ("abduction", "hip", "knee")
_RADII = {"hip": 0.035, "thigh": 0.02, "shank": 0.012}
GRAVITY = 9.81


def hips(robot: Robot) -> FloatArray:
    """Abduction axes in the trunk's frame, (4, 3) m."""
    return np.stack([robot.hip_x * _FRONT, robot.hip_y * SIDE, np.zeros(4)], axis=1)


def mjcf(parameters: Params | None = None, *, terrain: Terrain | None = None) -> str:
    """The model as XML.

    Parameters
    ----------
    parameters : Params, optional
        None: those of ``params.toml``.
    terrain : Terrain, optional
        None: a plane.

    Returns
    -------
    str
        Torque motors as actuators, a free trunk, one touch sensor per foot; nothing but primitives and no files.

    Examples
    --------
    >>> mjcf().count("<motor")
    12
    """
    p = params() if parameters is None else parameters
    robot = p.robot
    legs = "".join(_leg(robot, k) for k in range(4))
    motors = "".join(
        f'<motor name="{leg}_{joint}" joint="{leg}_{joint}" ctrllimited="true" ctrlrange="{-limit} {limit}"/>\n'
        for leg in LEGS
        for joint, limit in zip(_JOINTS, robot.torque_limits, strict=True)
    )
    touch = "".join(f'<touch name="{leg}_touch" site="{leg}_foot"/>\n' for leg in LEGS)
    length, width, height = (0.5 * side for side in robot.trunk)
    z = p.gait.height + robot.foot_radius
    default = f"""<default>
<geom contype="0" conaffinity="1" rgba=".25 .28 .33 1"/>
<joint damping="{robot.damping}" armature="{robot.armature}"/>
</default>
"""
    trunk = f"""<body name="trunk" pos="0 0 {z}">
<freejoint name="base"/>
<geom name="trunk" type="box" size="{length} {width} {height}" mass="{robot.trunk_mass}" rgba=".9 .9 .92 1"/>
{legs}</body>
"""
    rest = f"<actuator>\n{motors}</actuator>\n<sensor>\n{touch}</sensor>\n"
    return _scene(p, terrain, default=default, robot=trunk, rest=rest)


def _scene(p: Params, terrain: Terrain | None, *, default: str = "", robot: str = "", rest: str = "") -> str:
    """MJCF of the ground, and of what stands on it."""
    assets, ground = ("", _PLANE) if terrain is None else terrain.xml()
    return f"""<mujoco model="{p.robot.name}">
<compiler angle="radian" autolimits="true"/>
<option timestep="{p.control.dt}" integrator="implicitfast" gravity="0 0 {-GRAVITY}" iterations="10"
 ls_iterations="20"/>
<visual><global offwidth="960" offheight="540"/><headlight ambient=".45 .45 .45" diffuse=".5 .5 .5"/></visual>
{default}<asset>
<texture name="sky" type="skybox" builtin="gradient" rgb1="1 1 1" rgb2=".8 .87 .95" width="64" height="64"/>
<texture name="grid" type="2d" builtin="checker" rgb1=".86 .87 .89" rgb2=".78 .8 .83" width="128" height="128"/>
<material name="ground" texture="grid" texrepeat="2 2" texuniform="true"/>
{assets}</asset>
<worldbody>
<light pos="0 0 4" dir="0 0 -1" directional="true" castshadow="true"/>
{ground}{robot}</worldbody>
{rest}</mujoco>
"""


_PLANE = (
    '<geom name="ground" type="plane" size="0 0 1" contype="1" conaffinity="0" material="ground" '
    'rgba="1 1 1 1"/>\n'
)


def _leg(robot: Robot, k: int) -> str:
    leg, side = LEGS[k], SIDE[k]
    x, y, z = hips(robot)[k]
    ranges = [f'range="{low} {high}"' for low, high in zip(robot.lower, robot.upper, strict=True)]
    if side < 0.0:
        ranges[0] = f'range="{-robot.upper[0]} {-robot.lower[0]}"'
    out, friction = side * robot.abduction, f"{robot.friction} 0.005 0.0001"
    half = 0.5 * _RADII["hip"]
    return f"""<body name="{leg}_hip" pos="{x} {y} {z}">
<joint name="{leg}_abduction" axis="1 0 0" {ranges[0]}/>
<geom type="cylinder" size="{_RADII["hip"]} {half}" euler="1.5707963 0 0" pos="0 {0.5 * out} 0"
 mass="{robot.hip_mass}"/>
<body name="{leg}_thigh" pos="0 {out} 0">
<joint name="{leg}_hip" axis="0 1 0" {ranges[1]}/>
<geom type="capsule" size="{_RADII["thigh"]}" fromto="0 0 0 0 0 {-robot.thigh}" mass="{robot.thigh_mass}"/>
<body name="{leg}_shank" pos="0 0 {-robot.thigh}">
<joint name="{leg}_knee" axis="0 1 0" {ranges[2]}/>
<geom type="capsule" size="{_RADII["shank"]}" fromto="0 0 0 0 0 {-robot.shank}" mass="{robot.shank_mass}"/>
<geom name="{leg}_foot" type="sphere" size="{robot.foot_radius}" pos="0 0 {-robot.shank}" mass="{robot.foot_mass}"
 friction="{friction}" priority="1" rgba=".1 .1 .1 1"/>
<site name="{leg}_foot" pos="0 0 {-robot.shank}" size="{1.2 * robot.foot_radius}" group="4"/>
</body></body></body>
"""


def compile_model(*, terrain: Terrain | None = None) -> MjModel:
    """The model of primitives in MuJoCo.

    Parameters
    ----------
    terrain : Terrain, optional
        None: a plane.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    return legged(terrain=terrain).model


def legged(parameters: Params | None = None, *, terrain: Terrain | None = None) -> LeggedRobot:
    """The robot in MuJoCo: the one of primitives, or one from a file.

    Parameters
    ----------
    parameters : Params, optional
        None: those of ``params.toml``.
    terrain : Terrain, optional
        None: a plane.

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    """
    p = params() if parameters is None else parameters
    robot, limits = p.robot, np.tile(p.robot.torque_limits, 4)
    if robot.file:
        return load_robot(
            FOLDER / robot.file,
            joints=robot.joints,
            feet=robot.feet,
            torque_limits=limits,
            ground=_scene(p, terrain),
        )
    model: MjModel = simulator("the quadruped").MjModel.from_xml_string(mjcf(p, terrain=terrain))
    return LeggedRobot.of(
        model,
        base="trunk",
        joints=robot.joints,
        feet=robot.feet,
        torque_limits=limits,
        touch=[f"{leg}_touch" for leg in LEGS],
    )


def joint_inertia(parameters: Params | None = None) -> FloatArray:
    """Diagonal of the joints' inertia in the neutral stance, trunk held, (12,) kg m^2: the filter's constant M.

    Links as rods and points about each axis, rotors added; or the table's. The filter needs no simulator.

    Parameters
    ----------
    parameters : Params, optional
    """
    p = params() if parameters is None else parameters
    robot, height = p.robot, p.gait.height
    if robot.inertia:
        return np.tile(robot.inertia, 4)
    L1, L2 = robot.thigh, robot.shank
    knee_angle = np.arccos((height**2 - L1**2 - L2**2) / (2.0 * L1 * L2))
    lean = np.arctan2(L2 * np.sin(knee_angle), L1 + L2 * np.cos(knee_angle))
    knee_x, knee_z = L1 * np.sin(lean), L1 * np.cos(lean)
    middle = 0.5 * np.hypot(knee_x, knee_z + height)
    shank_end = robot.foot_mass * L2**2
    at_knee = robot.shank_mass * L2**2 / 3.0 + shank_end
    at_hip = (
        robot.thigh_mass * L1**2 / 3.0
        + robot.shank_mass * (middle**2 + L2**2 / 12.0)
        + robot.foot_mass * height**2
    )
    rest = robot.thigh_mass + robot.shank_mass + robot.foot_mass
    at_abduction = (
        0.25 * robot.hip_mass * robot.abduction**2
        + rest * robot.abduction**2
        + robot.thigh_mass * knee_z**2 / 3.0
        + robot.shank_mass * (knee_z**2 + knee_z * height + height**2) / 3.0
        + robot.foot_mass * height**2
    )
    return np.tile(np.array([at_abduction, at_hip, at_knee]) + robot.armature, 4)


def largest_payload(strength: float = 1.0, *, parameters: Params | None = None) -> tuple[float, str]:
    """What two diagonal legs of a trot can carry at rest, and which joint gives way.

    F = (m + payload) g / 2 on each foot, below its hip: abduction F l_a, hip 0, knee F x_knee.

    Parameters
    ----------
    strength : float
        Part of the torque that the motors give.
    parameters : Params, optional

    Returns
    -------
    payload : float
        In kg; negative where they cannot carry the robot itself.
    joint : str
    """
    p = params() if parameters is None else parameters
    robot, L1, L2 = p.robot, p.robot.thigh, p.robot.shank
    knee_angle = np.arccos((p.gait.height**2 - L1**2 - L2**2) / (2.0 * L1 * L2))
    knee_x = L1 * np.sin(np.arctan2(L2 * np.sin(knee_angle), L1 + L2 * np.cos(knee_angle)))
    levers = {
        "abduction": (robot.abduction, robot.torque_limits[0]),
        "knee": (knee_x, robot.torque_limits[2]),
    }
    carried = {name: 2.0 * strength * limit / (lever * GRAVITY) for name, (lever, limit) in levers.items()}
    joint = min(carried, key=lambda name: carried[name])
    return float(carried[joint] - robot.mass), joint


def check_payload(payload: float, *, strength: float = 1.0, parameters: Params | None = None) -> None:
    """Refuse a payload that the legs cannot carry.

    Parameters
    ----------
    payload : float
        In kg; negative for a robot that is lighter than it thinks.
    strength : float
        Part of the torque that the motors give.
    parameters : Params, optional

    Raises
    ------
    ValueError
        With the joint that gives way.
    """
    robot = (params() if parameters is None else parameters).robot
    largest, joint = largest_payload(strength, parameters=parameters)
    if not np.isfinite(payload) or payload <= -robot.trunk_mass:
        raise ValueError(
            f"payload: expected more than {-robot.trunk_mass:.2f} kg, the trunk, got {payload} kg"
        )
    if payload > largest:
        motors = "" if strength == 1.0 else f" with motors at {100.0 * strength:.0f} %"
        raise ValueError(
            f"payload of {payload:.1f} kg: two legs of a trot carry {largest:.1f} kg at most{motors}, then the "
            f"{joint} motors reach their limit; choose less"
        )
