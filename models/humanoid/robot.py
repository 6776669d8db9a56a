"""dm_control's humanoid in MuJoCo: 40.8 kg, 21 motors, a free base."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.plants.legged.simulator import simulator

from .params import params

__all__ = ["FEET", "HAND", "Friction", "HandForce", "Humanoid", "load"]

FloatArray = NDArray[np.float64]
HandForce = tuple[float, float, float]
Friction = Literal["pyramidal", "elliptic"]

HAND = "right_hand"
FEET = ("right_foot", "left_foot")
# Lowest points of the two capsules of each foot, in the foot's frame, m: where MuJoCo makes contact.
_CORNERS = np.array(
    [
        [[-0.07, -0.02, -0.027], [0.14, -0.04, -0.027], [-0.07, 0.0, -0.027], [0.14, 0.02, -0.027]],
        [[-0.07, 0.02, -0.027], [0.14, 0.04, -0.027], [-0.07, 0.0, -0.027], [0.14, -0.02, -0.027]],
    ]
)
FOOT_HEIGHT = 0.027


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
    hand, feet
        Numbers of the bodies.
    gears : float
        Factor on the motors' torque.
    friction : {"pyramidal", "elliptic"}
        MuJoCo's friction cones.
    """

    mujoco: ModuleType
    model: Any  # MuJoCo ships no types
    torque: FloatArray
    motor_dof: NDArray[np.intp]
    hand: int
    feet: tuple[int, int]
    gears: float
    friction: Friction = "pyramidal"

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
        places = [
            data.xpos[foot] + corners @ data.xmat[foot].reshape(3, 3).T
            for foot, corners in zip(self.feet, _CORNERS, strict=True)
        ]
        return np.array(places)

    def jacobian(self, data: Any, point: FloatArray, body: int) -> FloatArray:
        """Jacobian (3, nv) of a point in the world that moves with a body."""
        J = np.zeros((3, self.nv))
        self.mujoco.mj_jac(self.model, data, J, None, point, body)
        return J

    def centre_jacobian(self, data: Any) -> FloatArray:
        """Jacobian (3, nv) of the centre of mass relative to the feet's centre."""
        centre, foot = np.zeros((3, self.nv)), np.zeros((3, self.nv))
        self.mujoco.mj_jacSubtreeCom(self.model, data, centre, 1)
        for number in self.feet:
            self.mujoco.mj_jacBodyCom(self.model, data, foot, None, number)
            centre -= 0.5 * foot
        return centre

    def implicit_inertia(self, data: Any) -> FloatArray:
        """M + h D (nv, nv): what a step of MuJoCo, implicit in the damping D, divides forces by."""
        M = np.zeros((self.nv, self.nv))
        self.mujoco.mj_fullM(self.model, data, M)
        return M + float(self.model.opt.timestep) * np.diag(self.model.dof_damping)

    def hand_jacobian(self, data: Any) -> FloatArray:
        """Jacobian (3, nv) of the hand on which the force acts."""
        return self.jacobian(data, data.xpos[self.hand], self.hand)

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


def load(gears: float = 1.0, friction: Friction = "pyramidal") -> Humanoid:
    """Read the humanoid from dm_control's files.

    Parameters
    ----------
    gears : float
        Factor on all motor torques: 2 is the variant with doubled gears.
    friction : {"pyramidal", "elliptic"}
        Cones: the model's own, in which feet creep under a lasting force, or elliptic and stiffer ones.

    Raises
    ------
    ValueError
        For gears that are not positive, unknown cones, or without the extra ``mujoco``.
    """
    if not (np.isfinite(gears) and gears > 0.0):
        raise ValueError(f"gears: expected a positive factor on the motor torques, got {gears}")
    if friction not in get_args(Friction):
        raise ValueError(f"friction: expected one of {', '.join(get_args(Friction))}, got {friction!r}")
    try:
        mujoco = simulator("the humanoid")
    except ImportError as error:
        raise ValueError(str(error)) from None
    package = find_spec("dm_control")
    if package is None or package.origin is None:
        raise ValueError(
            "the humanoid comes with dm_control, which the extra mujoco brings: pip install 'phyfilter-ctl[mujoco]'"
        )
    model = mujoco.MjModel.from_xml_path(str(Path(package.origin).parent / "suite" / "humanoid.xml"))
    model.actuator_gear[:, 0] *= gears
    if friction == "elliptic":
        model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, params().contacts.impratio
    motor_dof = model.jnt_dofadr[model.actuator_trnid[:, 0]].astype(np.intp)
    torque = np.zeros(model.nv)
    torque[motor_dof] = model.actuator_gear[:, 0]
    feet = (int(model.body(FEET[0]).id), int(model.body(FEET[1]).id))
    hand = int(model.body(HAND).id)
    return Humanoid(mujoco, model, torque, motor_dof, hand, feet, float(gears), friction)
