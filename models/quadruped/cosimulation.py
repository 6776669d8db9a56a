"""The robot's and the joint loop's FMUs walk together, against the same walk in one process."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyfilter_ctl.fmi import Reference, UnpackedFmu, describe, replay
from phyfilter_ctl.fmi.description import Fmi
from phyfilter_ctl.fmi.instance import FmuInstance
from phyfilter_ctl.plants import JointQuantities
from phyfilter_ctl.plants.legged.simulator import simulator

from .batch import Motion
from .gait import following, trot
from .handover import Gains, joint_loop_fmu, quadruped_fmu, resting, robot_xml
from .loop import make_filter, paper_filter
from .params import params
from .policy import ACTIONS, Policy, observe, shipped
from .terrain import Terrain

__all__ = ["Agreement", "cosimulation", "figures", "table"]

FloatArray = NDArray[np.float64]

_JOINTS = 12
_BASE = 7  # positions of the trunk before those of the joints
_SPEED = 0.5  # m/s, of the walk
_RAMP = 1.0  # s, until it is reached
# The trot alone walks with these; the vendor's are for policies.
_STIFF = Gains(100.0, 2.0)


@dataclass(frozen=True)
class Agreement:
    """How far two FMUs are from the walk in one process.

    Attributes
    ----------
    who : str
        What gave the targets.
    fmi : str
    steps : int
        Of the joint loop.
    distance : float
        Walked along x in process, m.
    f_hat : float
        Largest |f_hat|, N m: below the limit, the FMU's filter and the one in process are the same.
    robot : float
        Largest difference of the robot's FMU on the recorded torques: m, rad, m/s, rad/s and N; 0 is to the bit.
    torque, estimate : float
        Largest difference of the joint loop's FMU on the recorded motion, N m.
    loop : float
        Largest difference of joint angles with both FMUs in the loop, rad.
    sizes : dict of str to int
        Bytes of each FMU.
    seconds : dict of str to float
        Of a step of the joint loop, median: "process", "fmus", and of the latter "robot" and "joint loop".
    """

    who: str
    fmi: str
    steps: int
    distance: float
    f_hat: float
    robot: float
    torque: float
    estimate: float
    loop: float
    sizes: Mapping[str, int]
    seconds: Mapping[str, float]


class _Walker:
    """Gives targets at the policy's rate; the trot alone where there is no policy."""

    def __init__(self, policy: Policy | None) -> None:
        self._policy = policy
        self._phase = np.zeros(1)
        self._action = np.zeros((1, ACTIONS))

    def target(self, t: float, qpos: FloatArray, qvel: FloatArray) -> FloatArray:
        """Joint angles (12,) from now on."""
        control = params().control
        command = np.array([[_SPEED * min(1.0, t / _RAMP), 0.0, 0.0]])
        if self._policy is not None:
            self._action = self._policy(observe(_motion(qpos, qvel), self._phase, command, self._action))
        self._phase = following(self._phase, command)
        return (trot(self._phase, command) + control.action_scale * self._action)[0]


def _motion(qpos: FloatArray, qvel: FloatArray) -> Motion:
    w, x, y, z = qpos[3:7]
    up = np.array([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    # The policies look at neither velocity nor heading.
    return Motion(
        position=qpos[None, :3],
        velocity=np.full((1, 3), np.nan),
        rate=qvel[None, 3:6],
        up=up[None],
        yaw=np.full(1, np.nan),
        q=qpos[None, _BASE:],
        qd=qvel[None, 6:],
    )


@dataclass(frozen=True)
class _Record:
    """A walk; what is read at every step, then what is commanded there."""

    motion: FloatArray  # (N + 1, nq + nv + feet)
    target: FloatArray  # (N, 12)
    torque: FloatArray  # (N, 12)
    f_hat: FloatArray  # (N, 12)
    seconds: float


def _in_process(xml: str, start: FloatArray, walker: _Walker, gains: Gains, steps: int) -> _Record:
    mujoco, control = simulator("the quadruped"), params().control
    limits = np.tile(params().robot.torque_limits, 4)
    model = mujoco.MjModel.from_xml_string(xml)
    data, joint_filter = mujoco.MjData(model), make_filter(paper_filter())
    data.qpos[:] = start
    seen = copy(data)  # a look at the foot loads must not leave a warm start behind
    mujoco.mj_forward(model, seen)
    motion = [np.concatenate([data.qpos, data.qvel, seen.sensordata])]
    targets, torques, estimates = [], [], []
    target, torque = np.zeros(_JOINTS), np.zeros(_JOINTS)
    state = joint_filter.start(data.qvel[6:])
    clock = [time.perf_counter()]
    for k in range(steps):
        q, qd = data.qpos[_BASE:], data.qvel[6:]
        if k % control.decimation == 0:
            target = walker.target(k * control.dt, data.qpos, data.qvel)
        state, f_hat = joint_filter.step(state, qd, JointQuantities(qd.copy()), torque)
        torque = np.clip(gains.kp * (target - f_hat / gains.kp - q) - gains.kd * qd, -limits, limits)
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
        targets.append(target)
        torques.append(torque)
        estimates.append(f_hat)
        motion.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
        clock.append(time.perf_counter())
    return _Record(
        np.array(motion), np.array(targets), np.array(torques), np.array(estimates), _median(np.diff(clock))
    )


def _median(times: list[float] | FloatArray) -> float:
    return float(np.median(np.asarray(times)))


class _Running:
    """An FMU that takes whole vectors and gives whole vectors."""

    def __init__(self, path: Path, start: FloatArray) -> None:
        self._fmu = UnpackedFmu(path)
        self._instance = FmuInstance(self._fmu, "cs", path.stem)
        self._inputs, self._outputs = self._instance.signals("input"), self._instance.signals("output")
        self._h, self._k = params().control.dt, 0
        self._times: list[float] = []
        self._instance.initialise(0.0)
        self._inputs.write(self._instance, start)
        self._instance.begin()

    def read(self) -> FloatArray:
        """All outputs."""
        return self._outputs.read(self._instance)

    def step(self, inputs: FloatArray) -> FloatArray:
        """Outputs after one step on held inputs."""
        began = time.perf_counter()
        self._inputs.write(self._instance, inputs)
        self._instance.do_step(self._k * self._h, self._h)
        self._k += 1
        outputs = self._outputs.read(self._instance)
        self._times.append(time.perf_counter() - began)
        return outputs

    @property
    def seconds(self) -> float:
        """Of a step, median."""
        return _median(self._times)

    def close(self) -> None:
        """Free the instance and its folder."""
        self._instance.close()
        self._fmu.close()


_NO_FORCE = np.zeros(3)


def _driven(path: Path, inputs: FloatArray, outputs: FloatArray) -> FloatArray:
    """What an FMU makes of recorded rows of inputs, each held over the step to its row, less the recorded outputs."""
    description = describe(path)
    sides = zip(("input", "output"), (inputs, outputs), strict=True)
    labels = [
        dict(zip([label for v in description.of(side) for label in v.labels], rows.T, strict=True))
        for side, rows in sides
    ]
    record = Reference(params().control.dt * np.arange(len(inputs), dtype=float), *labels)
    return replay(path, record, inputs_at="end")[1] - outputs


def _joints(motion: FloatArray) -> tuple[FloatArray, FloatArray]:
    nq = _BASE + _JOINTS
    return motion[..., _BASE:nq], motion[..., nq + 6 : nq + 6 + _JOINTS]


def _together(
    robot_path: Path, loop_path: Path, walker: _Walker, steps: int
) -> tuple[FloatArray, dict[str, float]]:
    """Both FMUs in the loop: joint angles (N + 1, 12), and seconds per step."""
    control = params().control
    nq = _BASE + _JOINTS
    robot = _Running(robot_path, np.zeros(_JOINTS + 3))
    try:
        motion = robot.read()
        target = walker.target(0.0, motion[:nq], motion[nq : nq + 6 + _JOINTS])
        loop = _Running(loop_path, np.concatenate([target, *_joints(motion)]))
        try:
            angles, torque = [motion[_BASE:nq]], loop.read()[:_JOINTS]
            clock = [time.perf_counter()]
            for k in range(1, steps + 1):
                motion = robot.step(np.concatenate([torque, _NO_FORCE]))
                if k % control.decimation == 0:
                    target = walker.target(k * control.dt, motion[:nq], motion[nq : nq + 6 + _JOINTS])
                torque = loop.step(np.concatenate([target, *_joints(motion)]))[:_JOINTS]
                angles.append(motion[_BASE:nq])
                clock.append(time.perf_counter())
        finally:
            loop.close()
    finally:
        robot.close()
    seconds = {"fmus": _median(np.diff(clock)), "robot": robot.seconds, "joint loop": loop.seconds}
    return np.array(angles), seconds


def cosimulation(
    *,
    duration: float = 2.0,
    policy: str | None = None,
    terrain: Terrain | None = None,
    fmi: Fmi = "3.0",
    folder: str | Path | None = None,
) -> Agreement:
    """Let the robot's and the joint loop's FMUs walk together, and compare with the same walk in one process.

    Parameters
    ----------
    duration : float
        s.
    policy : str, optional
        A shipped one, with the vendor's gains; None: the trot alone, open loop, with stiffer ones.
    terrain : Terrain, optional
        None: flat.
    fmi : {"3.0", "2.0"}
    folder : str or Path, optional
        Where ``quadruped.fmu`` and ``joint_loop.fmu`` stay; None: nowhere.

    Returns
    -------
    Agreement

    Raises
    ------
    ValueError
        If the duration is shorter than one step of the policy, or there is no such policy.
    ImportError
        Without the extra ``mujoco``.
    CompilerError
        Without a C compiler, or on another system than Linux.
    """
    control = params().control
    steps = round(duration / control.dt) if np.isfinite(duration) else 0
    if steps < control.decimation:
        raise ValueError(f"duration: expected at least {control.dt * control.decimation} s, got {duration}")
    chosen = None if policy is None else shipped(policy)
    gains = _STIFF if chosen is None else Gains(control.kp, control.kd)
    joints = trot(np.zeros(1), np.zeros((1, 3)))[0]
    record = _in_process(robot_xml(terrain), resting(joints), _Walker(chosen), gains, steps)
    with tempfile.TemporaryDirectory(prefix="phyfilter-") as scratch:
        place = Path(scratch if folder is None else folder)
        robot = quadruped_fmu(place / "quadruped.fmu", terrain=terrain, joints=joints, fmi=fmi)
        loop = joint_loop_fmu(place / "joint_loop.fmu", gains=gains, fmi=fmi)
        # The robot starts without torques.
        on_torques = _driven(robot, np.pad(record.torque, ((1, 0), (0, len(_NO_FORCE)))), record.motion)
        given = np.hstack([record.target, *_joints(record.motion[:-1])])
        on_motion = _driven(loop, given, np.hstack([record.torque, record.f_hat]))
        angles, seconds = _together(robot, loop, _Walker(chosen), steps)
        sizes = {"robot": robot.stat().st_size, "joint loop": loop.stat().st_size}
    walked = record.motion[:, _BASE : _BASE + _JOINTS]
    return Agreement(
        who="the trot alone" if policy is None else f"policy {policy}",
        fmi=fmi,
        steps=steps,
        distance=float(record.motion[-1, 0] - record.motion[0, 0]),
        f_hat=float(np.abs(record.f_hat).max()),
        robot=float(np.abs(on_torques).max()),
        torque=float(np.abs(on_motion[:, :_JOINTS]).max()),
        estimate=float(np.abs(on_motion[:, _JOINTS:]).max()),
        loop=float(np.abs(angles - walked).max()),
        sizes=sizes,
        seconds={"process": record.seconds, **seconds},
    )


# ---- what is printed ----


def table(found: Agreement) -> str:
    """The lines that are printed.

    Parameters
    ----------
    found : Agreement
    """
    micro = {name: 1e6 * value for name, value in found.seconds.items()}
    megabytes = {name: 1e-6 * value for name, value in found.sizes.items()}
    robot = "to the bit" if found.robot == 0.0 else f"within {found.robot:.2g} (m, rad, s, N)"
    rows = {
        "robot, on the torques of the walk in process": robot,
        "joint loop, on its motion": f"torque within {found.torque:.2g} N m, f_hat within {found.estimate:.2g} N m",
        "both in the loop": f"joint angles within {found.loop:.2g} rad",
        "size": f"robot {megabytes['robot']:.1f} MB, joint loop {megabytes['joint loop']:.2f} MB",
        "time of a step": f"{micro['fmus']:.0f} us (robot {micro['robot']:.0f}, joint loop {micro['joint loop']:.0f}); "
        f"in process {micro['process']:.0f} us",
    }
    head = (
        f"quadruped and joint loop as FMUs (FMI {found.fmi}); {found.who}, {found.steps} steps of the joint loop, "
        f"{found.distance:.2f} m walked, |f_hat| up to {found.f_hat:.1f} N m"
    )
    if found.f_hat >= params().filter.limit:
        rows["f_hat was at its limit"] = "there the FMU's filter winds up, the one in process does not"
    return "\n".join([head, *(f"  {label:<47}{text}" for label, text in rows.items())])


def figures(found: Agreement) -> dict[str, object]:
    """The same for JSON.

    Parameters
    ----------
    found : Agreement
    """
    return {
        "targets": found.who,
        "fmi": found.fmi,
        "steps": found.steps,
        "distance_m": found.distance,
        "f_hat_max_Nm": found.f_hat,
        "robot_max_abs_difference": found.robot,
        "torque_max_abs_difference_Nm": found.torque,
        "f_hat_max_abs_difference_Nm": found.estimate,
        "closed_loop_joint_angle_max_abs_difference_rad": found.loop,
        "bytes": dict(found.sizes),
        "seconds_per_step": dict(found.seconds),
    }
