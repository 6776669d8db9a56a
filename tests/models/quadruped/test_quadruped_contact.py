"""The forces on the feet in the filter's g: the simulator's, and what the robot knows of them."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

ROOM = f"{models.__name__}.quadruped"
batch = importlib.import_module(f"{ROOM}.batch")
contact = importlib.import_module(f"{ROOM}.contact")
evaluation = importlib.import_module(f"{ROOM}.evaluation")
gait = importlib.import_module(f"{ROOM}.gait")
loop = importlib.import_module(f"{ROOM}.loop")
params = importlib.import_module(f"{ROOM}.params")
policy = importlib.import_module(f"{ROOM}.policy")
robot = importlib.import_module(f"{ROOM}.robot")

P = params.params()
WEIGHT = P.robot.mass * robot.GRAVITY
UP = np.array([0.0, 0.0, 1.0])
# m: closed forms in double precision, twelve turns one after another.
EXACT = 1e-9
# m/rad: central differences with steps of 1e-6 rad.
DIFFERENCES = 1e-8
# N m, at rest: what MuJoCo's soft contacts and joints at 200 Hz still move after six seconds.
AT_REST = 0.05


def standing_torque(q: np.ndarray, force: float) -> np.ndarray:
    """Of the motors, on which every foot presses down with so many N."""
    _, jacobian = contact.leg_kinematics(q[None])
    return -np.einsum("lji,j->li", jacobian[0], force * UP).reshape(1, 12)


def test_legs_are_where_the_inverse_kinematics_put_them():
    rng = np.random.default_rng(4)
    command = np.stack([rng.uniform(-1, 1, 20), rng.uniform(-0.5, 0.5, 20), rng.uniform(-1, 1, 20)], axis=1)
    phase = rng.uniform(0.0, 6.0, 20)
    asked = gait.feet(phase, command)
    points, _ = contact.leg_kinematics(gait.trot(phase, command))
    assert points[2] == pytest.approx(asked + robot.hips(P.robot), abs=EXACT)
    assert np.linalg.norm(points[1] - points[0], axis=-1) == pytest.approx(P.robot.thigh)
    assert np.linalg.norm(points[2] - points[1], axis=-1) == pytest.approx(P.robot.shank)


def test_jacobian_is_the_slope_of_the_feet():
    q = gait.neutral() + np.random.default_rng(5).uniform(-0.3, 0.3, 12)
    _, jacobian = contact.leg_kinematics(q[None])
    step = 1e-6
    for joint in range(12):
        moved = q + step * np.array([[1.0], [-1.0]]) * (np.arange(12) == joint)
        feet = contact.leg_kinematics(moved)[0][2]
        wanted = np.zeros((4, 3))
        wanted[joint // 3] = jacobian[0, joint // 3, :, joint % 3]
        assert (feet[0] - feet[1]) / (2.0 * step) == pytest.approx(wanted, abs=DIFFERENCES)


def test_feet_that_press_down_carry_the_weight():
    q, tilted = gait.neutral(), np.array([[0.1, -0.2, 1.0]]) / np.sqrt(1.05)
    found = contact.carried(q[None], tilted, standing_torque(q, WEIGHT / 4.0))
    assert found[0, :3] == pytest.approx(WEIGHT * tilted[0])
    # Diagonal legs, level: the closed form of the statics of a trot (``largest_payload``), but for the centre of mass.
    torque = standing_torque(q, WEIGHT / 2.0).reshape(4, 3) * np.array([[1.0], [0.0], [0.0], [1.0]])
    _, jacobian = contact.leg_kinematics(q[None])
    found = contact.carried(q[None], UP[None], torque.reshape(1, 12))[0]
    legs = found[6:].reshape(4, 3)
    assert np.array_equal(legs[1:3], np.zeros((2, 3)))
    force = np.linalg.solve(np.swapaxes(jacobian[0, [0, 3]], -1, -2), legs[[0, 3], :, None])[..., 0]
    assert force.sum(axis=0) == pytest.approx(found[:3])
    assert found[2] == pytest.approx(WEIGHT, rel=0.02)  # the diagonal does not pass below the centre of mass


def test_nobody_carries_in_the_air():
    assert not contact.carried(gait.neutral()[None], UP[None], np.zeros((1, 12))).any()


@pytest.mark.parametrize(
    "told",
    [
        "known",
        pytest.param("estimated", marks=pytest.mark.slow),
        pytest.param("omitted", marks=pytest.mark.slow),
    ],
)
def test_filter_of_a_standing_robot_finds_what_it_is_not_told(told):
    """At rest M q'' = 0, so f_hat = -(tau + what g has of the contact): the legs' own weight where it knows J' F_c."""
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to stand on")
    one = batch.Batch(1, threads=1)
    true, of_legs = one.contact, one._pool.bind("qfrc_bias")
    joint_loop = loop.JointLoop(one, loop.FilterChoice((1.0,), contact=told))
    joint_loop.kp[:], joint_loop.kd[:], joint_loop.nominal = 80.0, 2.0, 80.0  # stands without a policy
    for _ in range(300):
        joint_loop.advance(gait.neutral()[None])
    true, of_legs = true[0, 6:], of_legs[0, 6:]
    assert joint_loop.torque[0] + true == pytest.approx(of_legs, abs=AT_REST)
    estimate = contact.carried(one.q, one.up, joint_loop.torque)[0, 6:]
    in_g = {"known": true, "estimated": estimate, "omitted": np.zeros(12)}[told]
    assert joint_loop.f_hat[0] == pytest.approx(true - in_g - of_legs, abs=AT_REST)
    assert np.abs(estimate - true).max() < 0.5 * np.abs(true).max()  # but for forces between the feet


def test_what_there_is_not_is_refused(capsys):
    with pytest.raises(ValueError, match="contact: expected one of known, estimated, omitted"):
        loop.FilterChoice((1.0,), contact="exact")
    for arguments, words in (
        (["--contact", "known", "--choose"], "--choose has filters of its own"),
        (["--contact", "known", "--train"], "add --filter"),
    ):
        assert main(["run", "quadruped", *arguments]) != 0
        assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_walk_knows_which_feet_stand():
    """Against the simulator's foot sensors, on which nothing of the estimate rests; 95 % were seen."""
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")
    group = evaluation.Group([policy.shipped("filter-0")], loop.paper_filter("estimated"))
    crowd = evaluation._Crowd(
        [group], [evaluation.Case(), evaluation.Case(0.6 * P.robot.mass)], evaluation.phases(count=2), None, 1
    )
    right = []
    for k in range(100):
        crowd.step(0.02 * k)
        estimate = contact.carried(crowd.batch.q, crowd.batch.up, crowd.loops[0].torque)[:, 6:].reshape(
            -1, 4, 3
        )
        right.append((crowd.batch.load > 5.0) == estimate.any(axis=-1))
    assert np.mean(right[25:]) > 0.85
