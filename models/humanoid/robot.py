"""Humanoids in MuJoCo: dm_control's (40.8 kg, 21 motors) and the Berkeley Humanoid (16.1 kg, 12 motors, no arms)."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phyfilter_ctl.plants.legged.simulator import simulator

from .params import params

__all__ = ["GRIPS", "Friction", "HandForce", "Humanoid", "Robot", "Sole", "load", "unit"]

FloatArray = NDArray[np.float64]
HandForce = tuple[float, float, float]
Friction = Literal["pyramidal", "elliptic"]

Robot = Literal["suite", "berkeley"]

# Point of attack by name: body, and place in its frame, m. The Berkeley Humanoid has no arms.
GRIPS: dict[Robot, dict[str, tuple[str, tuple[float, float, float]]]] = {
    "suite": {"hand": ("right_hand", (0.0, 0.0, 0.0))},
    "berkeley": {"torso": ("torso", (0.02, 0.0, 0.22)), "pelvis": ("torso", (0.0, 0.0, 0.0))},
}
_FEET: dict[Robot, tuple[str, str]] = {
    "suite": ("right_foot", "left_foot"),
    "berkeley": ("lr_faa", "ll_faa"),
}
_BOXES = ("r_foot1", "l_foot1")  # the Berkeley Humanoid's soles
# Lowest points of the two capsules of each foot, in the foot's frame, m: where MuJoCo makes contact.
_CAPSULES = np.array(
    [
        [[-0.07, -0.02, -0.027], [0.14, -0.04, -0.027], [-0.07, 0.0, -0.027], [0.14, 0.02, -0.027]],
        [[-0.07, 0.02, -0.027], [0.14, 0.04, -0.027], [-0.07, 0.0, -0.027], [0.14, -0.02, -0.027]],
    ]
)


def unit(heading: float) -> FloatArray:
    """Horizontal unit vector (2,) of a heading.

    Parameters
    ----------
    heading : float
        In degrees: 0 forwards, 90 to the left.

    Examples
    --------
    >>> unit(90.0).tolist()
    [0.0, 1.0]
    """
    angle = np.radians(heading)
    return np.array([round(float(np.cos(angle)), 12), round(float(np.sin(angle)), 12)])


@dataclass(frozen=True, eq=False)
class Sole:
    """The underside of a foot: a frame that is upright when the foot is flat, and its corners.

    Attributes
    ----------
    body : int
    place, turn
        Of the frame in that of the body, (3,) in m and (3, 3).
    corners : (4, 3) array
        In the frame, m.
    """

    body: int
    place: FloatArray
    turn: FloatArray
    corners: FloatArray

    @property
    def height(self) -> float:
        """Of the frame above a floor on which the foot stands, m."""
        return -float(self.corners[:, 2].min())

    def frame(self, data: Any) -> tuple[FloatArray, FloatArray]:
        """Place (3,) and attitude (3, 3) in the world."""
        attitude = data.xmat[self.body].reshape(3, 3)
        return data.xpos[self.body] + attitude @ self.place, attitude @ self.turn


@dataclass(frozen=True, eq=False)
class Humanoid:
    """The model and what is asked of it again and again.

    Attributes
    ----------
    mujoco : module
    model : mujoco.MjModel
    torque : (nv,) array
        Greatest motor torque of each degree of freedom in N m, 0 for the base.
    motor_dof : (nu,) array
        Degree of freedom of each motor.
    soles : tuple of Sole
        Right and left.
    hand, offset
        Body on which the force acts, and where in its frame, (3,) in m.
    gears : float
        Factor on the motors' torque.
    friction : {"pyramidal", "elliptic"}
        MuJoCo's friction cones.
    robot : {"suite", "berkeley"}
        Which one.
    grip : str
        Where the force acts, of ``GRIPS[robot]``.
    """

    mujoco: ModuleType
    model: Any  # MuJoCo ships no types
    torque: FloatArray
    motor_dof: NDArray[np.intp]
    soles: tuple[Sole, Sole]
    hand: int
    offset: FloatArray
    gears: float
    friction: Friction = "elliptic"
    robot: Robot = "suite"
    grip: str = "hand"

    @property
    def mass(self) -> float:
        """kg."""
        return float(self.model.body_mass.sum())

    @property
    def weight(self) -> float:
        """N."""
        return self.mass * float(-self.model.opt.gravity[2])

    @property
    def nv(self) -> int:
        """Degrees of freedom, the base's 6 first."""
        return int(self.model.nv)

    def data(self) -> Any:
        """Fresh ``mujoco.MjData``."""
        return self.mujoco.MjData(self.model)

    def joint(self, name: str) -> int:
        """Index of a joint among the 21."""
        return int(self.model.jnt_dofadr[self.model.joint(name).id]) - 6

    def corners(self, data: Any) -> FloatArray:
        """Corners of the feet (2, 4, 3) in the world."""
        frames = [(sole, *sole.frame(data)) for sole in self.soles]
        return np.array([place + sole.corners @ turn.T for sole, place, turn in frames])

    def point(self, data: Any) -> FloatArray:
        """Where the force acts (3,) in the world."""
        return data.xpos[self.hand] + data.xmat[self.hand].reshape(3, 3) @ self.offset

    def pull(self, data: Any, force: ArrayLike) -> None:
        """Let a force (3,) in N act there in the steps to come."""
        x, y, z = np.asarray(force, dtype=float).tolist()
        a, b, c = (self.point(data) - data.xipos[self.hand]).tolist()
        data.xfrc_applied[self.hand] = (x, y, z, b * z - c * y, c * x - a * z, a * y - b * x)

    def jacobian(self, data: Any, point: FloatArray, body: int) -> FloatArray:
        """Jacobian (3, nv) of a point in the world that moves with a body."""
        J = np.zeros((3, self.nv))
        self.mujoco.mj_jac(self.model, data, J, None, point, body)
        return J

    def centre_jacobian(self, data: Any) -> FloatArray:
        """Jacobian (3, nv) of the centre of mass relative to the feet's centre."""
        centre, foot = np.zeros((3, self.nv)), np.zeros((3, self.nv))
        self.mujoco.mj_jacSubtreeCom(self.model, data, centre, 1)
        for sole in self.soles:
            self.mujoco.mj_jacBodyCom(self.model, data, foot, None, sole.body)
            centre -= 0.5 * foot
        return centre

    def implicit_inertia(self, data: Any) -> FloatArray:
        """M + h D (nv, nv): what a step of MuJoCo, implicit in the damping D, divides forces by."""
        M = np.zeros((self.nv, self.nv))
        self.mujoco.mj_fullM(self.model, data, M)
        return M + float(self.model.opt.timestep) * np.diag(self.model.dof_damping)

    def hand_jacobian(self, data: Any) -> FloatArray:
        """Jacobian (3, nv) of the point on which the force acts."""
        return self.jacobian(data, self.point(data), self.hand)

    def difference(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Change (nv,) that leads from one configuration to the other."""
        change = np.zeros(self.nv)
        self.mujoco.mj_differentiatePos(self.model, change, 1.0, start, end)
        return change

    def moved(self, q: FloatArray, change: FloatArray) -> FloatArray:
        """Configuration after a change (nv,)."""
        result = np.array(q)
        self.mujoco.mj_integratePos(self.model, result, change, 1.0)
        return result


def load(
    gears: float = 1.0,
    friction: Friction = "elliptic",
    *,
    robot: Robot = "suite",
    grip: str | None = None,
) -> Humanoid:
    """Read a humanoid.

    Parameters
    ----------
    gears : float
        Factor on all motor torques: 2 is the variant with doubled gears.
    friction : {"pyramidal", "elliptic"}
        Cones: elliptic and stiff ones, or MuJoCo's default, in which feet creep under a lasting force.
    robot : {"suite", "berkeley"}
        dm_control's, or the Berkeley Humanoid.
    grip : str, optional
        Where the force acts: "hand", or of the Berkeley Humanoid "torso" or "pelvis". None: the first.

    Raises
    ------
    ValueError
        For gears that are not positive, unknown cones, robots or grips, or without the extra ``mujoco``.
    """
    if not (np.isfinite(gears) and gears > 0.0):
        raise ValueError(f"gears: expected a positive factor on the motor torques, got {gears}")
    if friction not in get_args(Friction):
        raise ValueError(f"friction: expected one of {', '.join(get_args(Friction))}, got {friction!r}")
    if robot not in GRIPS:
        raise ValueError(f"robot: expected one of {', '.join(GRIPS)}, got {robot!r}")
    grip = next(iter(GRIPS[robot])) if grip is None else grip
    if grip not in GRIPS[robot]:
        raise ValueError(f"grip: expected one of {', '.join(GRIPS[robot])}, got {grip!r}")
    try:
        mujoco = simulator("the humanoid")
    except ImportError as error:
        raise ValueError(str(error)) from None
    model = _suite(mujoco) if robot == "suite" else _berkeley(mujoco)
    model.actuator_gear[:, 0] *= gears
    if friction == "elliptic":
        model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, params().contacts.impratio
    motor_dof = model.jnt_dofadr[model.actuator_trnid[:, 0]].astype(np.intp)
    torque = np.zeros(model.nv)
    torque[motor_dof] = model.actuator_gear[:, 0]
    body, offset = GRIPS[robot][grip]
    hand, place = int(model.body(body).id), np.array(offset)
    soles = _soles(mujoco, model, robot)
    return Humanoid(mujoco, model, torque, motor_dof, soles, hand, place, float(gears), friction, robot, grip)


def _suite(mujoco: ModuleType) -> Any:
    package = find_spec("dm_control")
    if package is None or package.origin is None:
        raise ValueError(
            "the humanoid comes with dm_control, which the extra mujoco brings: pip install 'phyfilter-ctl[mujoco]'"
        )
    return mujoco.MjModel.from_xml_path(str(Path(package.origin).parent / "suite" / "humanoid.xml"))


def _berkeley(mujoco: ModuleType) -> Any:
    """Motors that give a share of their greatest torque in place of the file's position servos."""
    model = mujoco.MjModel.from_xml_path(str(Path(__file__).with_name("berkeley") / "berkeley_humanoid.xml"))
    numbers = params().berkeley
    model.opt.timestep, model.opt.integrator = numbers.timestep, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.iterations, model.opt.ls_iterations = 100, 50  # MuJoCo's own: the file's are few, for a GPU
    joints = model.actuator_trnid[:, 0]
    model.actuator_gear[:, 0] = model.jnt_actfrcrange[joints, 1]
    model.jnt_actfrclimited[:] = 0
    model.actuator_gainprm[:, 0] = 1.0
    model.actuator_biasprm[:] = 0.0
    model.actuator_ctrlrange[:], model.actuator_ctrllimited[:] = (-1.0, 1.0), 1
    return model


def _soles(mujoco: ModuleType, model: Any, robot: Robot) -> tuple[Sole, Sole]:
    right, left = (int(model.body(name).id) for name in _FEET[robot])
    if robot == "suite":
        at, straight = np.zeros(3), np.eye(3)
        return Sole(right, at, straight, _CAPSULES[0]), Sole(left, at, straight, _CAPSULES[1])

    def box(body: int, name: str) -> Sole:
        geom, turn = model.geom(name), np.zeros(9)
        mujoco.mju_quat2Mat(turn, geom.quat)
        corners = geom.size * np.array([[x, y, -1.0] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
        return Sole(body, np.array(geom.pos), turn.reshape(3, 3), corners)

    return box(right, _BOXES[0]), box(left, _BOXES[1])
