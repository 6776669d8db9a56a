"""Unitree's Go1 in the quadruped's machinery: its table against its file, and what a real robot adds to the loop."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

from phyfilter_ctl import models

mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: no Go1")

ROOM = f"{models.__name__}.quadruped"
batch = importlib.import_module(f"{ROOM}.batch")
environment = importlib.import_module(f"{ROOM}.environment")
evaluation = importlib.import_module(f"{ROOM}.evaluation")
gait = importlib.import_module(f"{ROOM}.gait")
loop = importlib.import_module(f"{ROOM}.loop")
params = importlib.import_module(f"{ROOM}.params")
policy = importlib.import_module(f"{ROOM}.policy")
robot = importlib.import_module(f"{ROOM}.robot")
training = importlib.import_module(f"{ROOM}.training")

P = params.params("go1")
# m: closed form of the legs against MuJoCo's chain of bodies.
EXACT = 1e-9


def quiet(**changes: object) -> params.Params:
    """Go1 with ideal encoders."""
    return replace(P, control=replace(P.control, noise_angle=0.0, noise_rate=0.0, **changes))


@pytest.fixture(scope="module")
def go1():
    return robot.legged(P)


def test_table_says_what_the_file_does(go1):
    model = go1.model
    assert go1.mass == pytest.approx(P.robot.mass)
    assert P.robot.trunk_mass == pytest.approx(model.body_mass[go1.base])
    assert model.dof_damping[go1.dof] == pytest.approx(np.full(12, P.robot.damping))
    assert model.dof_armature[go1.dof] == pytest.approx(np.full(12, P.robot.armature))
    assert model.geom_size[go1.geoms, 0] == pytest.approx(np.full(4, P.robot.foot_radius))
    ranges = np.array([model.jnt_range[model.joint(name).id] for name in go1.joints])
    assert ranges == pytest.approx(np.tile(np.array([P.robot.lower, P.robot.upper]).T, (4, 1)))
    assert model.opt.timestep == P.control.dt


def test_constant_inertia_is_that_of_the_neutral_stance(go1):
    data, M = go1.stand(gait.neutral(parameters=P)), np.zeros((18, 18))
    mujoco.mj_fullM(go1.model, data, M)
    assert robot.joint_inertia(P) == pytest.approx(
        np.diag(M)[go1.dof], rel=0.01
    )  # three digits; left is not right


def test_trot_puts_the_feet_where_it_says(go1):
    wanted = gait.feet(0.7, [0.5, 0.1, 0.3], parameters=P)
    data = mujoco.MjData(go1.model)
    data.qpos[go1.qpos] = gait.trot(0.7, [0.5, 0.1, 0.3], parameters=P)
    mujoco.mj_kinematics(go1.model, data)
    feet = data.geom_xpos[go1.geoms] - data.xpos[go1.base]
    assert feet == pytest.approx(wanted + robot.hips(P.robot), abs=EXACT)


def test_payload_weighs_on_the_trunk_as_a_body_of_its_own_would():
    one = batch.Batch(1, threads=1, parameters=P)
    one.set_payload(4.0)
    found = one._pool.get_model(0)
    trunk = one.robot.base
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, one.model.body_iquat[trunk])
    own, R = np.diag(one.model.body_inertia[trunk]), R.reshape(3, 3)
    m, box = one.model.body_mass[trunk], np.array([0.16**2 + 0.1**2, 0.25**2 + 0.1**2, 0.25**2 + 0.16**2])
    apart = m * 4.0 / (m + 4.0) * 0.11**2 * np.diag([1.0, 1.0, 0.0])
    wanted = R @ own @ R.T + np.diag(4.0 / 12.0 * box) + apart
    assert found.body_mass[trunk] == pytest.approx(m + 4.0)
    # kg m^2: the trunk's principal axes lie 0.4 degrees off its own.
    assert R @ np.diag(found.body_inertia[trunk]) @ R.T == pytest.approx(wanted, abs=1e-3)
    with pytest.raises(ValueError, match="principal axes of inertia lie across"):
        batch._principal_axes(np.array([np.cos(0.3), 0.0, np.sin(0.3), 0.0]))


def test_motors_give_less_the_faster_they_turn():
    one = batch.Batch(1, threads=1, parameters=quiet())
    joint_loop = loop.JointLoop(one)
    one._qvel[0, one.robot.dof] = np.tile([10.0, -10.0, 30.0], 4)
    joint_loop.update(np.full((1, 12), 9.0))  # as much as they give
    limits = np.array(P.robot.torque_limits)
    assert joint_loop.torque[0, :3] == pytest.approx(limits * [1.0 - 10.0 / 30.1, 1.0, 0.0])
    joint_loop.update(np.full((1, 12), -9.0))
    joint_loop.update(np.full((1, 12), -9.0))  # a sample later
    assert joint_loop.torque[0, :3] == pytest.approx(-limits * [1.0, 1.0 - 10.0 / 30.1, 1.0])


def test_targets_arrive_a_sample_late():
    late, at_once = (
        batch.Batch(2, threads=1, parameters=quiet()),
        batch.Batch(2, threads=1, parameters=quiet()),
    )
    delayed, plain = loop.JointLoop(late), loop.JointLoop(at_once)
    plain._delayed = lambda wanted: wanted
    rng = np.random.default_rng(0)
    targets = gait.neutral(parameters=P) + rng.uniform(-0.1, 0.1, (20, 2, 12))
    for k, target in enumerate(targets):
        late.step(delayed.update(target))
        at_once.step(plain.update(targets[max(k - 1, 0)]))
    assert np.array_equal(late.qpos, at_once.qpos)
    delayed.restart(np.array([True, False]))
    delayed.update(targets[3])
    assert np.array_equal(np.isnan(delayed.under_way), np.zeros((1, 2, 12)))


def test_encoders_are_noisy_and_the_noise_repeats():
    def walk() -> np.ndarray:
        crowd = batch.Batch(3, threads=1, parameters=P)
        joint_loop = loop.JointLoop(crowd, loop.paper_filter())
        for _ in range(5):
            joint_loop.advance(np.tile(gait.neutral(parameters=P), (3, 1)))
        return crowd.qpos.copy()

    first, again = walk(), walk()
    assert np.array_equal(first, again)
    assert not np.array_equal(first[0], first[1])


def test_full_randomisation_weakens_motors_and_pushes():
    walk = environment.Walk(6, None, seed=1, parameters=P, full=True, threads=1)
    low, high = P.randomisation.full_strength
    assert np.all((walk.loop.strength >= low) & (walk.loop.strength <= high))
    assert np.ptp(walk.loop.strength) > 0.1
    walk.age[:] = walk._resample
    walk.step(np.zeros((6, 12)))
    assert np.all(np.linalg.norm(walk.force[:, :2], axis=1) > 0.0)
    for _ in range(walk._push_steps):
        walk.step(np.zeros((6, 12)))
    assert not walk.force.any()
    plain = environment.Walk(6, None, seed=1, parameters=P, threads=1)
    assert np.all(plain.loop.strength == 1.0)


def test_one_robot_at_a_time():
    layers = ((np.zeros((12, 47)), np.zeros(12)),)
    mine = policy.Policy(layers, "go1", {})
    with pytest.raises(ValueError, match="one robot at a time, got go1, lite3-primitives"):
        evaluation.walk([evaluation.Group([mine])], [evaluation.Case()])
    [found] = evaluation.walk(
        [evaluation.Group([mine])],
        [
            evaluation.Case(robot="go1", speed=0.0),
            evaluation.Case(robot="go1", speed=0.0, disabled="FL_calf_joint"),
        ],
        starts=np.zeros(1),
        duration=0.6,
        threads=1,
    )
    assert found.trace.qpos[-1, 0, 2] > found.trace.qpos[-1, 1, 2] + 0.005, "a leg without its knee sinks"
    with pytest.raises(ValueError, match="disabled: expected one of FL_hip_joint"):
        evaluation.Case(robot="go1", disabled="knee")
    with pytest.raises(ValueError, match="expected one of the robots lite3-primitives, go1, got 'go9'"):
        evaluation.Case(robot="go9")
    with pytest.raises(ValueError, match="push_from: expected one of sides, left"):
        evaluation.Case(push_from="above")


@pytest.mark.slow
@pytest.mark.filterwarnings(
    "default"
)  # the library's dependencies warn about one another when they are imported
def test_resumed_training_equals_an_uninterrupted_one(tmp_path):
    for name in ("torch", "rsl_rl"):
        pytest.importorskip(name, reason=f"{name} is not installed: nothing is trained")

    def trainer(iterations: int) -> training.Trainer:
        wanted = training.Training(
            3, choice=loop.paper_filter(), iterations=iterations, environments=4, robot="go1", full=True
        )
        return training.Trainer(wanted, threads=1)

    whole, checkpoint = training.train(trainer(4)), tmp_path / "half.npz"
    training.train(trainer(2), checkpoint=checkpoint)
    resumed = training.train(trainer(4), checkpoint=checkpoint)
    assert whole.robot == resumed.robot == "go1"
    assert resumed.record["full_randomisation"] is True
    for first, second in zip(whole.layers, resumed.layers, strict=True):
        assert np.array_equal(first[0], second[0])
