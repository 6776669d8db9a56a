"""A robot from anybody's MJCF or URDF: where its joints and feet stand in MuJoCo's arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .prior import JointQuantities, balanced_contact
from .simulator import quantities, simulator

if TYPE_CHECKING:
    from mujoco._structs import MjData, MjModel  # the public names are not seen by type checkers

__all__ = ["LeggedRobot", "load_robot"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SHAPES = ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX")
# What holds the contact points of a foot is this much larger than the foot.
_AROUND = 1.2
_GROUND = '<mujoco><worldbody><geom name="ground" type="plane" size="0 0 1"/></worldbody></mujoco>'


@dataclass(frozen=True, eq=False)
class LeggedRobot:
    """A robot in MuJoCo, its joints and feet in the order in which they were named.

    Parameters
    ----------
    model : mujoco.MjModel
        With one motor for each joint (torques in N m) and one touch sensor for each foot.
    joints : tuple of str
        n of them, each with one degree of freedom.
    feet : tuple of str
    base : int
        Body that the free joint moves.
    qpos, dof, motors, touch, geoms : int arrays
        Where the joints' angles, velocities and torques, the feet's sensors and their geoms stand.
    torque_limits : (n,) array
        N m.

    Examples
    --------
    A hopper: a trunk on one leg that bends at the hip.

    >>> text = '''<mujoco><worldbody><body name="trunk" pos="0 0 .3"><freejoint/><geom size=".05" mass="2"/>
    ... <body><joint name="hip" axis="0 1 0"/><geom type="capsule" size=".01" fromto="0 0 0 0 0 -.28" mass=".2"/>
    ... <geom name="foot" pos="0 0 -.28" size=".02" mass=".05"/></body></body></worldbody></mujoco>'''
    >>> robot = load_robot(text, joints=["hip"], feet=["foot"], torque_limits=20.0)
    >>> robot.mass, robot.torque_limits.tolist()
    (2.25, [20.0])
    >>> data = robot.stand([0.0])
    >>> round(float(data.qpos[2]), 3)
    0.3
    """

    model: MjModel
    joints: tuple[str, ...]
    feet: tuple[str, ...]
    base: int
    qpos: IntArray
    dof: IntArray
    motors: IntArray
    touch: IntArray
    geoms: IntArray
    torque_limits: FloatArray

    @staticmethod
    def of(
        model: MjModel,
        *,
        base: str,
        joints: Sequence[str],
        feet: Sequence[str],
        torque_limits: ArrayLike,
        motors: Sequence[str] | None = None,
        touch: Sequence[str] | None = None,
    ) -> LeggedRobot:
        """A model that is made already.

        Parameters
        ----------
        model : mujoco.MjModel
        base : str
            Body that the free joint moves.
        joints, feet : sequence of str
            Joints, and the feet's geoms.
        torque_limits : float or (n,) array
            N m.
        motors, touch : sequence of str, optional
            Actuators and sensors; None: they are called as joints and feet.

        Raises
        ------
        KeyError
            For names that the model does not have.
        ValueError
            If the base does not come first, moved by a free joint.
        """
        free = simulator("a legged robot").mjtJoint.mjJNT_FREE
        if not model.njnt or model.jnt_type[0] != free or model.jnt_bodyid[0] != model.body(base).id:
            raise ValueError(f"expected {base!r}, on a free joint, to be what moves first in the model")
        at = [model.joint(name) for name in joints]
        return LeggedRobot(
            model,
            tuple(joints),
            tuple(feet),
            int(model.body(base).id),
            np.array([int(joint.qposadr[0]) for joint in at]),
            np.array([int(joint.dofadr[0]) for joint in at]),
            np.array([int(model.actuator(name).id) for name in (motors or joints)]),
            np.array([int(model.sensor(name).adr[0]) for name in (touch or feet)]),
            np.array([int(model.geom(name).id) for name in feet]),
            np.broadcast_to(np.asarray(torque_limits, dtype=float), (len(at),)),
        )

    @property
    def mass(self) -> float:
        """Of the whole robot, kg."""
        return float(self.model.body_subtreemass[self.base])

    def stand(self, angles: ArrayLike) -> MjData:
        """The robot at rest, its lowest foot on the plane z = 0.

        Parameters
        ----------
        angles : (n,) array
            Of the joints, rad.

        Returns
        -------
        mujoco.MjData
        """
        mujoco = simulator("a legged robot")
        data = mujoco.MjData(self.model)
        data.qpos[self.qpos] = np.asarray(angles, dtype=float)
        mujoco.mj_kinematics(self.model, data)
        data.qpos[2] -= np.min(self._soles(data)[:, 2])
        mujoco.mj_forward(self.model, data)
        return data

    def _soles(self, data: MjData) -> FloatArray:
        """The points of the ground below the feet's centres that their lowest points touch, (feet, 3) m."""
        geom = simulator("a legged robot").mjtGeom
        found = data.geom_xpos[self.geoms].copy()
        for k, g in enumerate(self.geoms):
            up, (a, b, c) = data.geom_xmat[g].reshape(3, 3)[2], self.model.geom_size[g]
            shape = self.model.geom_type[g]
            if shape == geom.mjGEOM_BOX:
                found[k, 2] -= np.abs(up) @ (a, b, c)
            elif shape == geom.mjGEOM_ELLIPSOID:
                found[k, 2] -= np.linalg.norm(up * (a, b, c))
            elif shape == geom.mjGEOM_CYLINDER:
                found[k, 2] -= a * np.hypot(up[0], up[1]) + b * abs(up[2])
            else:
                found[k, 2] -= a + (b * abs(up[2]) if shape == geom.mjGEOM_CAPSULE else 0.0)
        return found

    def quantities(self, data: MjData, *, stepped: bool = False) -> JointQuantities:
        """What a ``JointSpacePrior`` asks for, base first, then the joints as they were named.

        The contact estimate is ``balanced_contact`` with the feet that carry by their touch sensors; everything but
        that and ``contact_torque`` is known to a robot with a model of itself.

        Parameters
        ----------
        data : mujoco.MjData
        stepped : bool
            See :func:`phyfilter_ctl.plants.legged.quantities`.
        """
        mujoco = simulator("a legged robot")
        found = quantities(self.model, data, stepped=stepped)
        order = np.concatenate([np.arange(6), self.dof])
        if found.M is None or found.bias is None or found.contact_torque is None:
            raise ValueError("MuJoCo gave no inertia, bias or contact torque")
        bias = found.bias[order]
        jacobian = np.zeros((len(self.feet), 3, self.model.nv))
        for place, geom, point in zip(jacobian, self.geoms, self._soles(data), strict=True):
            mujoco.mj_jac(self.model, data, place, None, point, self.model.geom_bodyid[geom])
        carries = (data.sensordata[self.touch] > 0.0).astype(float)
        return JointQuantities(
            qd=data.qvel[self.dof].copy(),
            M=found.M[order[:, None], order],
            bias=bias,
            contact_torque=found.contact_torque[order],
            contact_estimate=balanced_contact(bias, jacobian[:, :, order], carries),
        )


def load_robot(
    source: str | Path,
    *,
    joints: Sequence[str],
    feet: Sequence[str],
    torque_limits: ArrayLike | None = None,
    ground: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> LeggedRobot:
    """Load an MJCF or URDF file as a torque-controlled robot on the ground.

    Meshes are left out (their masses too, unless the file gives inertias, as nearly all do), a free joint is added
    where the file has none, and the file's actuators on the named joints give way to motors of the same limits. The
    friction of a contact is that of the foot, whatever the ground's.

    Parameters
    ----------
    source : str or Path
        A file, or its text.
    joints : sequence of str
        Hinges or slides that have motors, in the order that is wanted.
    feet : sequence of str
        Geoms of simple shape, or bodies with one that collides, as in a URDF, which does not name geoms.
    torque_limits : float or (n,) array, optional
        N m; None: those of the file's actuators or joints (the effort of a URDF).
    ground : str, optional
        MJCF of the world that the robot is put in, whose options hold; None: the file's options, and a plane at z = 0
        where the file has no ground of its own.
    options : mapping, optional
        Names and values of ``mujoco.MjOption`` that are set, "timestep" for one.

    Returns
    -------
    LeggedRobot

    Raises
    ------
    ImportError
        Without the extra ``mujoco``.
    ValueError
        If MuJoCo cannot read it, or joints or feet are missing, and for torque limits that are neither in the file nor
        given.
    """
    mujoco = simulator("a legged robot")
    text = str(source)
    try:
        if isinstance(source, Path) or not text.lstrip().startswith("<"):
            spec = mujoco.MjSpec.from_file(text)
        else:
            spec = mujoco.MjSpec.from_string(text)
    except (ValueError, OSError) as error:
        raise ValueError(f"{text[:60]}: no robot that MuJoCo can read: {error}") from None
    spec.compiler.fusestatic = False
    _without_meshes(mujoco, spec)
    base = _on_a_free_joint(mujoco, spec)
    limits = _limits(mujoco, spec, tuple(joints), torque_limits)
    if not feet or len(set(feet)) < len(feet):
        raise ValueError(f"feet: expected different names, got {list(feet)}")
    soles = [_foot(mujoco, spec, name) for name in feet]
    _add_motors(mujoco, spec, joints, limits)
    for name, geom in zip(feet, soles, strict=True):
        site = geom.parent.add_site(
            name=f"{name} touch", type=geom.type, pos=geom.pos, quat=geom.quat, size=_AROUND * geom.size
        )
        site.fromto, site.group = geom.fromto, 4
        spec.add_sensor(
            name=f"{name} touch",
            type=mujoco.mjtSensor.mjSENS_TOUCH,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=site.name,
        )
        geom.name, geom.priority, geom.condim = f"{name} sole", 1, max(3, geom.condim)
        geom.conaffinity = geom.conaffinity or 1
    own = any(geom.contype or geom.conaffinity for geom in spec.worldbody.geoms)
    world = mujoco.MjSpec.from_string(ground or ("<mujoco/>" if own else _GROUND))
    if ground is None:
        world.option = spec.option
    spec.option = world.option
    world.attach(spec, frame=world.worldbody.add_frame(), prefix="robot/")
    for name, value in (options or {}).items():
        setattr(world.option, name, value)
    try:
        model = world.compile()
    except ValueError as error:
        raise ValueError(f"MuJoCo cannot compile the robot: {error}") from None
    return LeggedRobot.of(
        model,
        base=f"robot/{base}",
        joints=[f"robot/{name}" for name in joints],
        feet=[f"robot/{name} sole" for name in feet],
        torque_limits=limits,
        motors=[f"robot/{name} motor" for name in joints],
        touch=[f"robot/{name} touch" for name in feet],
    )


def _without_meshes(mujoco: Any, spec: Any) -> None:
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for part in [*spec.meshes, *spec.keys]:
        spec.delete(part)


def _on_a_free_joint(mujoco: Any, spec: Any) -> str:
    """Name of the body that moves freely."""
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if len(free) > 1:
        raise ValueError(f"expected one robot with one free joint, got {len(free)} free joints")
    body = free[0].parent if free else spec.worldbody.first_body()
    if body is None:
        raise ValueError("expected a robot, got a model without bodies")
    if not free:
        body.add_freejoint(name="free")
    body.name = body.name or "base"
    return str(body.name)


def _limits(mujoco: Any, spec: Any, joints: Sequence[str], given: ArrayLike | None) -> FloatArray:
    there = {joint.name: joint for joint in spec.joints}
    one = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    for name in joints:
        if name not in there or there[name].type not in one:
            known = ", ".join(n for n, joint in there.items() if joint.type in one)
            raise ValueError(f"no hinge or slide {name!r} in the file; there are: {known or 'none'}")
    if not joints or len(set(joints)) < len(joints):
        raise ValueError(f"joints: expected different names, got {list(joints)}")
    if given is None:
        found = []
        for name in joints:
            acts = [act for act in spec.actuators if act.target == name]
            ranges = [act.forcerange * act.gear[0] for act in acts] + [there[name].actfrcrange]
            # A control is a torque where no bias makes it a servo's target.
            motors = [act for act in acts if act.biastype == mujoco.mjtBias.mjBIAS_NONE]
            ranges += [act.ctrlrange * act.gainprm[0] * act.gear[0] for act in motors]
            largest = [float(np.max(np.abs(pair))) for pair in ranges if np.max(np.abs(pair)) > 0.0]
            if not largest:
                raise ValueError(f"the file does not limit the torque of {name!r}; give torque_limits in N m")
            found.append(min(largest))
        return np.array(found)
    limits = np.broadcast_to(np.asarray(given, dtype=float), (len(joints),)).copy()
    if not (np.isfinite(limits).all() and np.all(limits > 0.0)):
        raise ValueError(f"torque_limits: expected positive numbers in N m, got {given!r}")
    return limits


def _foot(mujoco: Any, spec: Any, name: str) -> Any:
    named = [geom for geom in spec.geoms if geom.name == name]
    solid = [geom for geom in spec.geoms if geom.contype or geom.conaffinity]
    found = named or [geom for geom in solid if geom.parent.name == name]
    shapes = [getattr(mujoco.mjtGeom, f"mjGEOM_{shape}") for shape in _SHAPES]
    if len(found) != 1 or found[0].type not in shapes:
        known = ", ".join(
            dict.fromkeys(geom.name or geom.parent.name for geom in solid if geom.type in shapes)
        )
        raise ValueError(
            f"feet: expected {name!r} to be a {', '.join(_SHAPES).lower()}, or a body with one; there are: "
            f"{known or 'none'}"
        )
    return found[0]


def _add_motors(mujoco: Any, spec: Any, joints: Sequence[str], limits: FloatArray) -> None:
    for act in list(spec.actuators):
        if act.trntype == mujoco.mjtTrn.mjTRN_JOINT and act.target in joints:
            spec.delete(act)
    for name, limit in zip(joints, limits, strict=True):
        spec.add_actuator(
            name=f"{name} motor",
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            ctrllimited=mujoco.mjtLimited.mjLIMITED_TRUE,
            ctrlrange=[-limit, limit],
        )
