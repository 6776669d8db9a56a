"""The inertia of robots over their configurations against the constant M_hat that their filters are told.

    python benchmarks/robot_inertia.py             half a minute; the quadruped needs the extra mujoco
    python benchmarks/robot_inertia.py --quick     fewer configurations

The range of the eigenvalues of M_hat M^-1 is certain where "everywhere" is said: sampled configurations, their convex
hull and what M may be between them. It holds more than the robot's own M: "not proven" does not mean unstable. The
motors' lag and the step are in the loop, outer gains are not. Exits with status 1 if a tuned filter is not proven.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import casadi as ca
import control as ct
import numpy as np
from numpy.typing import NDArray

import phyfilter_ctl as pf
from phyfilter_ctl.analysis import configuration_hull
from phyfilter_ctl.plants import SerialArm, small_arm
from phyfilter_ctl.plants.arm_motion import joint_frames
from phyfilter_ctl.plants.legged import quantities

Floats = NDArray[np.float64]

PROVEN = pf.Status.PROVEN
MISSED: list[str] = []
# Configurations of each of the flying arm's four joints from which no singular M is left between them.
_ENOUGH = 11


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer configurations")
    quick = parser.parse_args().quick
    platform(4 if quick else _ENOUGH)
    arm_joints(11 if quick else 31)
    quadruped(5 if quick else 9)
    for line in MISSED:
        print("missed:", line)
    return int(bool(MISSED))


def _of(model: str, part: str) -> ModuleType:
    return import_module(f"phyfilter_ctl.models.{model}.{part}")


def report(
    name: str,
    filter: pf.PhyFilter | pf.FilterBank,
    verdict: tuple[float, float],
    sure: str,
    dt: float,
    actuator: ct.TransferFunction | None = None,
) -> None:
    """One line: range of the ratio over the configurations, constant, at any speed."""
    low, high = verdict
    if not np.isfinite(high):
        print(f"  {name:44} a singular M is not excluded: more configurations")
        return
    answers = []
    for words, rate in (("constant", 0.0), ("any speed", None)):
        if words == "constant" and isinstance(filter, pf.FilterBank):
            continue
        found = pf.inertia_tolerance(filter, pf.Loop(actuator=actuator), ratios=(low, high), rate=rate, dt=dt)
        # The range holds more than the robot's own M: what is refuted for it is not proven for the robot.
        if found.status is not PROVEN and "model's" in name:
            MISSED.append(f"{name}, {words}")
        answers.append(f"{words} {'proven' if found.status is PROVEN else 'not proven'}")
    print(f"  {name:44} M_hat/M {low:6.3f} to {high:6.3f} ({sure}): {', '.join(answers)}")


def held(margin: pf.FilterMargins, **sets: Any) -> Floats:
    """Least and largest M_hat/M over a set of constant M."""
    return pf.inertia_tolerance(margin.filter, margin.around, rate=0.0, **sets).ratios


def platform(points: int) -> None:
    """The flying arm's platform: six axes coupled by the arm in any configuration and 0 to 0.3 kg in the gripper."""
    arm, values = small_arm(), _of("aerial_manipulator", "params").params()
    low, high = (limit[:4] for limit in arm.limits)  # the last joint turns about the arm's own axis

    joint = ca.SX.sym("q", 4)
    motion = arm.motion(ca.vertcat(joint, 0.0))
    parts = ca.Function("arm", [joint], [motion.inertia, motion.centre, motion.tip])

    def inertia(load: float) -> Callable[[Floats], Floats]:
        def matrix(q: Floats) -> Floats:
            own, centre, tip = (np.asarray(part) for part in parts(q))
            x, y, z = (arm.mass * centre + load * tip)[:, 0]
            cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            total = (values.vehicle.mass + arm.mass + load) * np.eye(3)
            J = (
                np.diag(values.vehicle.inertia)
                + own
                + load * (float(np.sum(tip**2)) * np.eye(3) - tip @ tip.T)
            )
            return np.block([[total, -cross], [cross, J]])

        return matrix

    sets = [
        configuration_hull(inertia(load), low, high, points=points) for load in (0.0, values.mission.payload)
    ]
    vehicle = _of("aerial_manipulator", "vehicle")
    M_hat = np.array([*[vehicle.nominal().mass] * 3, *vehicle.nominal().J])
    margin = pf.margins(pf.PhyFilter([1.0]))
    sure = points >= _ENOUGH
    found = [
        held(margin, M_hat=M_hat, vertices=vertices, within=spread if sure else None)
        for vertices, spread in sets
    ]
    verdict = min(each[0] for each in found), max(each[1] for each in found)
    words = "everywhere" if sure else "sampled only"
    print(f"flying arm: {len(sets[0][0])} configurations, load 0 to {values.mission.payload:g} kg")
    act, h = ct.tf(1, [values.vehicle.motor_lag, 1]), values.sampling.dt
    tuned = pf.stack([pf.PhyFilter([3.866])] * 3 + [pf.PhyFilter([8.79])] * 3)
    report("platform, the model's 3.866 and 8.79 rad/s", tuned, verdict, words, h, act)
    fast = pf.stack([pf.PhyFilter([12.0])] * 3 + [pf.PhyFilter([30.0])] * 3)
    report("platform, 12 and 30 rad/s", fast, verdict, words, h, act)


def joint_space_inertia(arm: SerialArm, q: Floats) -> Floats:
    """M(q) of the joints with the platform held: sum of m J_v' J_v + J_w' I J_w over the links."""
    frames = joint_frames(arm.links, arm.mount, arm.base_axes, q)
    M, R = np.zeros((arm.joints, arm.joints)), np.asarray(arm.base_axes)
    for k, (link, (axis, origin)) in enumerate(zip(arm.links, frames, strict=True)):
        x, y, z = axis
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        R = (np.eye(3) + np.sin(q[k]) * K + (1.0 - np.cos(q[k])) * K @ K) @ R
        centre = np.asarray(origin) + R @ link.centre
        turning, moving = np.zeros((3, arm.joints)), np.zeros((3, arm.joints))
        for j, (direction, place) in enumerate(frames[: k + 1]):
            turning[:, j], moving[:, j] = direction, np.cross(direction, centre - np.asarray(place))
        M += link.mass * moving.T @ moving + turning.T @ R @ link.inertia @ R.T @ turning
    return M


def arm_joints(points: int) -> None:
    """The arm's five joints, platform held: M_hat the diagonal at home, and all of M at home."""
    arm = small_arm()
    low, high = (limit[1:4] for limit in arm.limits)  # neither the base's turn nor the wrist's roll changes M
    rotor = 0.002 * np.eye(5)  # of small geared servos: without it M of the last joint is next to nothing

    def inertia(q: Floats) -> Floats:
        return joint_space_inertia(arm, np.array([0.0, *q, 0.0])) + rotor

    vertices, spread = configuration_hull(inertia, low, high, points=points)
    home = joint_space_inertia(arm, np.asarray(arm.home)) + rotor
    margin = pf.margins(pf.PhyFilter([1.0]))
    for words, M_hat in (("diagonal at home", np.diag(np.diag(home))), ("M at home", home)):
        verdict = held(margin, M_hat=M_hat, vertices=vertices, within=spread)
        for n in (1, 2, 3):
            name = f"five joints, {words}, n = {n}, 20 rad/s"
            report(
                name, pf.PhyFilter.from_poles([-20.0] * n), (verdict[0], verdict[1]), "everywhere", dt=0.002
            )
    print()


def quadruped(points: int) -> None:
    """A leg with the trunk held, over all its angles; all legs with the trunk free, at random angles."""
    if find_spec("mujoco") is None:
        print("quadruped: without MuJoCo (extra mujoco) left out")
        return
    robot, p = _of("quadruped", "robot"), _of("quadruped", "params").params()
    mujoco, model = import_module("mujoco"), robot.compile_model()
    data = mujoco.MjData(model)

    def whole(q: Floats) -> Floats:
        data.qpos[7:] = q
        mujoco.mj_forward(model, data)
        M = quantities(model, data).M
        assert M is not None
        return M

    M_hat = robot.joint_inertia()
    vertices, spread = configuration_hull(
        lambda q: whole(np.tile([0.0, *q], 4))[6:9, 6:9], p.robot.lower[1:], p.robot.upper[1:], points=points
    )
    filter = pf.PhyFilter([p.filter.a0])
    margin = pf.margins(filter)
    fixed = held(margin, M_hat=M_hat[:3], vertices=vertices, within=spread)
    rng, free = np.random.default_rng(0), []
    for _ in range(200 if points < 9 else 2000):
        M = whole(rng.uniform(np.tile(p.robot.lower, 4), np.tile(p.robot.upper, 4)))
        base, mixed, own = M[:6, :6], M[:6, 6:], M[6:, 6:]
        free.append(
            held(margin, M_hat=np.diag(M_hat), vertices=[own - mixed.T @ np.linalg.solve(base, mixed)])
        )
    print("quadruped, its constant diagonal M_hat, 200 Hz")
    loose = float(np.min(free)), float(np.max(free))
    report(
        "leg, trunk held, the model's 1 rad/s", filter, (fixed[0], fixed[1]), "everywhere", dt=p.control.dt
    )
    report("12 joints, trunk free, the model's 1 rad/s", filter, loose, "sampled only", dt=p.control.dt)
    for n, w in ((1, 20.0), (2, 20.0), (3, 20.0)):
        report(
            f"leg, trunk held, n = {n}, {w:g} rad/s",
            pf.PhyFilter.from_poles([-w] * n),
            (fixed[0], fixed[1]),
            "everywhere",
            dt=p.control.dt,
        )


if __name__ == "__main__":
    sys.exit(main())
