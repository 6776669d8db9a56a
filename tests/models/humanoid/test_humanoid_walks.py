"""The Berkeley Humanoid's steps and policies: kinematics, many robots against one, filter, training, command line."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

ROOM = f"{models.__name__}.humanoid"
crowd = importlib.import_module(f"{ROOM}.crowd")
practice = importlib.import_module(f"{ROOM}.practice")
robot = importlib.import_module(f"{ROOM}.robot")
stepping = importlib.import_module(f"{ROOM}.stepping")
walk_params = importlib.import_module(f"{ROOM}.walk_params").walk_params
walk_study = importlib.import_module(f"{ROOM}.walk_study")
walking = importlib.import_module(f"{ROOM}.walking")
ppo = importlib.import_module(f"{models.__name__}.quadruped.ppo")
walks = importlib.import_module(f"{ROOM}.walks")

# m and rad: Newton's method to rounding.
FLAT = 1e-10
# Of a force of 5 N: contacts of the twin differ from the robot's as feet land.
ESTIMATED = 2.0


def placed(joints):
    """Places (2, 3) and attitudes of the soles, left first, of a robot whose trunk is at the origin."""
    humanoid = robot.load(robot="berkeley")
    data = humanoid.data()
    data.qpos[:7], data.qpos[7:] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0), joints
    mujoco.mj_forward(humanoid.model, data)
    frames = [sole.frame(data) for sole in reversed(humanoid.soles)]
    return np.array([place for place, _ in frames]), np.array([turn for _, turn in frames]), data


def test_neutral_stance_is_flat_and_below_the_centre_of_mass():
    stance, steps = stepping.neutral(), walk_params().steps
    places, turns, data = placed(stance.q)
    np.testing.assert_allclose(turns, np.tile(np.eye(3), (2, 1, 1)), atol=FLAT)
    np.testing.assert_allclose(places[:, 0], data.subtree_com[1][0], atol=FLAT)
    np.testing.assert_allclose(places[:, 1:], [[s * steps.width, -steps.height] for s in (1, -1)], atol=FLAT)


def test_swinging_foot_is_lifted_and_the_other_stays():
    """Through MuJoCo's kinematics, half way through a swing in place."""
    steps, clock = walk_params().steps, stepping.Clock(1)
    servo = walk_params().servo
    clock.restart(
        np.array([0]), np.array([0.25 * steps.duty - steps.frequency * servo.timestep * servo.decimation])
    )
    still, up = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])
    joints = clock.target(still, up, still, still)[0]
    rise = placed(joints)[0][:, 2] + steps.height
    # The Jacobian is that of the neutral stance: a tenth of the lift is its curvature.
    assert rise[0] == pytest.approx(steps.lift, rel=0.2)
    assert abs(rise[1]) < 0.1 * steps.lift


def test_foot_lands_where_the_speed_asks_for():
    steps, clock = walk_params().steps, stepping.Clock(1)
    going, command = np.array([[0.3, 0.1, 0.0]]), np.array([[0.2, 0.0, 0.1]])
    clock.restart(np.array([0]), np.array([0.5 * steps.duty - 1e-6]))
    clock.airborne[:] = [True, False]
    clock.target(going, np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 3)), command)
    wanted = 0.25 / steps.frequency * command[0] + [steps.place[0] * 0.1, steps.place[1] * 0.1, 0.0]
    dt = walk_params().servo.timestep * walk_params().servo.decimation
    np.testing.assert_allclose(clock.place[0, 0], wanted - dt * command[0], atol=1e-12)


def test_forces_in_the_heading_of_the_trunk():
    np.testing.assert_allclose(
        practice.turned(np.array([[1.0, 0.0]]), np.array([np.pi / 2])), [[0.0, -1.0]], atol=1e-15
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--policy", "steps"], "--policy, --train: they are those of --robot berkeley"),
        (["--robot", "berkeley", "--policy", "none"], "no policy 'none': neither a file nor one"),
        (["--robot", "berkeley", "--seed", "1"], "--seed: they go with --train"),
        (["--robot", "berkeley", "--train", "--policy", "steps"], "--policy, --train: one or the other"),
        (["--robot", "berkeley", "--policy", "steps", "--gears", "2"], "--gears, --friction: policies"),
        (["--robot", "berkeley", "--train", "--iterations", "0"], "iterations: expected 1 or more, got 0"),
    ],
)
def test_wrong_options_say_so(arguments, words, capsys):
    assert main(["run", "humanoid", *arguments]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_many_robots_are_the_single_one():
    """Force, inertia and Jacobian of a tilted robot of a crowd against MuJoCo's of one, one step apart."""
    many = crowd.Crowd(2)
    many.reset(np.arange(2), np.tile(stepping.neutral().q, (2, 1)), np.array([0.4, -1.0]))
    many.qpos[1, 3:7] = np.array([0.9, 0.1, -0.3, 0.3]) / np.sqrt(1.0)
    many.qpos[1, 3:7] /= np.linalg.norm(many.qpos[1, 3:7])
    q, single = many.qpos[1].copy(), many.humanoid
    data = single.data()
    data.qpos[:] = q
    mujoco.mj_forward(single.model, data)
    np.testing.assert_allclose(many.force_jacobian()[1], single.hand_jacobian(data)[:2, :6], atol=1e-12)
    assert np.abs(single.hand_jacobian(data)[:, 6:]).max() == 0.0
    force = np.array([[0.0, 0.0], [3.0, -7.0]])
    many.push(force)
    single.pull(data, [3.0, -7.0, 0.0])
    data.ctrl[:] = stepping.neutral().q
    mujoco.mj_step(single.model, data)
    many.step(np.tile(stepping.neutral().q, (2, 1)))
    # Targets are sent in steps of 2^-16 rad.
    np.testing.assert_allclose(many.qvel[1], data.qvel, atol=1e-4)
    M = np.zeros((18, 18))
    mujoco.mj_fullM(single.model, data, M)
    kd = np.concatenate([np.zeros(6), np.tile(walk_params().servo.kd, 2)])
    h = float(single.model.opt.timestep)
    np.testing.assert_allclose(
        many.implicit_inertia()[1], M + h * np.diag(single.model.dof_damping + kd), atol=1e-12
    )


@pytest.mark.slow
def test_steps_stand_and_the_filter_finds_the_force():
    cases = [
        walks.Case(5.0, heading, "slow", mode) for heading in (0.0, 90.0) for mode in ("alone", "torque")
    ]
    fates = walks.march(cases, None, duration=5.0)
    assert all(fate.held for fate in fates)
    assert all(fate.steps > 0 for fate in fates)
    assert [np.isnan(fate.estimate) for fate in fates] == [True, False] * 2
    assert max(abs(fate.estimate - 5.0) for fate in fates[1::2]) < ESTIMATED
    again = walks.march(cases, None, duration=5.0)
    assert [fate.time for fate in again] == [fate.time for fate in fates]
    assert [fate.velocity for fate in again] == [fate.velocity for fate in fates]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # the library's dependencies warn about one another
def test_training_resumes_and_its_policy_marches(tmp_path, capsys):
    for name in ("torch", "rsl_rl"):
        pytest.importorskip(name, reason=f"{name} is not installed: nothing is trained")

    def tiny(iterations, **changes):
        return walking.Trainer(ppo.Job(**({"seed": 5, "environments": 4} | changes), iterations=iterations))

    whole = ppo.train(tiny(3))
    checkpoint = tmp_path / "part.npz"
    ppo.train(tiny(1), checkpoint=checkpoint)
    resumed = ppo.train(tiny(3), checkpoint=checkpoint)
    assert resumed.record["reward"] == whole.record["reward"]
    for first, second in zip(whole.layers, resumed.layers, strict=True):
        assert np.array_equal(first[0], second[0])
    with pytest.raises(ValueError, match="a checkpoint of another training: seed 5, not 6"):
        ppo.train(tiny(3, seed=6), checkpoint=checkpoint)
    network = importlib.import_module(f"{models.__name__}.quadruped.network")
    network.save(whole, tmp_path / "p.json")
    figures = tmp_path / "f.json"
    arguments = [
        "run",
        "humanoid",
        "--robot",
        "berkeley",
        "--policy",
        str(tmp_path / "p.json"),
        "--grips",
        "torso",
    ]
    arguments += ["--forces", "5", "--profiles", "slow", "--duration", "4", "--workers", "1", "--quiet"]
    assert main([*arguments, "--json", str(figures)]) == 0
    printed, found = capsys.readouterr().out, json.loads(figures.read_text())
    assert "torso, slow, in place, from all sides" in printed
    assert len(found["trials"]) == 4 * (8 + 2)


@pytest.mark.slow
def test_shipped_policies_step_under_a_slow_force_and_are_told_it():
    """5 s in place: nobody falls without a force; 10 N are estimated and stood."""
    for seed in range(3):
        policy = walks.load(f"berkeley-{seed}")
        assert policy.record["seed"] == seed
        assert policy.record["reward"][-1] > policy.record["reward"][0]
        cases = [walks.Case(0.0, 0.0, "slow", "alone")]
        cases += [walks.Case(10.0, heading, "slow", "filter") for heading in (0.0, 90.0)]
        free, *pulled = walks.march(cases, policy, duration=5.0)
        assert free.held
        assert np.hypot(*free.velocity) < 0.2
        assert all(fate.held for fate in pulled)
        assert max(abs(fate.estimate - 10.0) for fate in pulled) < ESTIMATED
