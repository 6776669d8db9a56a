"""The quadruped's parts: masses, trot, batch, grounds, policies, and what is refused."""

from __future__ import annotations

import importlib
import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from phyfilter_ctl import models
from phyfilter_ctl.cli import main

ROOM = f"{models.__name__}.quadruped"
batch = importlib.import_module(f"{ROOM}.batch")
gait = importlib.import_module(f"{ROOM}.gait")
loop = importlib.import_module(f"{ROOM}.loop")
methods = importlib.import_module(f"{ROOM}.methods")
params = importlib.import_module(f"{ROOM}.params")
policy = importlib.import_module(f"{ROOM}.policy")
robot = importlib.import_module(f"{ROOM}.robot")
terrain = importlib.import_module(f"{ROOM}.terrain")

P = params.params()
# m, rad: closed forms in double precision.
EXACT = 1e-9
# kg m^2: rods and points for capsules and cylinders, part of the inertia.
SLENDER = 0.06
# m: a height field of 6 cm cells is made of triangles, the function is bilinear; a stair's edge is sharp.
FACET = 0.02


def forward(q: np.ndarray) -> np.ndarray:
    """Feet in the trunk's frame by rotations, (4, 3): another route than the closed form of the legs."""
    found = []
    for k, (roll, hip, knee) in enumerate(q.reshape(4, 3)):
        side = robot.SIDE[k]
        R = Rotation.from_euler("x", roll)
        thigh = R * Rotation.from_euler("y", hip)
        shank = thigh * Rotation.from_euler("y", knee)
        out = R.apply([0.0, side * P.robot.abduction, 0.0])
        found.append(out + thigh.apply([0.0, 0.0, -P.robot.thigh]) + shank.apply([0.0, 0.0, -P.robot.shank]))
    return np.array(found)


# -- robot -------------------------------------------------------------------------------------------------------


def test_mjcf_has_the_masses_of_the_table_and_needs_no_file():
    root = ET.fromstring(robot.mjcf())
    masses = [float(geom.get("mass", "0")) for geom in root.iter("geom")]
    assert sum(masses) == pytest.approx(P.robot.mass)
    assert len(list(root.iter("joint"))) - 1 == 12  # one is the default
    assert not [entry for entry in root.iter() if "file" in entry.attrib]
    limits = [motor.get("ctrlrange").split() for motor in root.iter("motor")]
    assert [float(high) for _, high in limits] == list(P.robot.torque_limits) * 4


def test_mujoco_weighs_the_robot_and_finds_it_as_wide_as_the_paper():
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: the model is not compiled")
    model = robot.compile_model()
    data = mujoco.MjData(model)
    data.qpos[7:] = gait.neutral()
    mujoco.mj_kinematics(model, data)
    assert model.body_mass.sum() == pytest.approx(P.robot.mass)
    feet = np.array([data.geom(f"{leg}_foot").xpos for leg in robot.LEGS])
    width = np.ptp(feet[:, 1]) + 2.0 * P.robot.foot_radius
    assert width == pytest.approx(0.37, abs=0.01)  # 548 x 370 mm
    assert (feet[:, 2] - P.robot.foot_radius) == pytest.approx(np.zeros(4), abs=EXACT)


def test_inertia_of_the_joints_against_mujoco():
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: no inertia to compare with")
    model = robot.compile_model()
    data = mujoco.MjData(model)
    data.qpos[7:] = gait.neutral()
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    assert robot.joint_inertia() == pytest.approx(np.diag(M)[6:], rel=SLENDER)


def test_payload_that_the_legs_cannot_carry():
    largest, joint = robot.largest_payload()
    assert (largest, joint) == (pytest.approx(37.2, abs=0.1), "knee")
    robot.check_payload(largest - 0.01)
    with pytest.raises(ValueError, match=r"two legs of a trot carry 37\.2 kg at most, then the knee motors"):
        robot.check_payload(largest + 0.01)
    with pytest.raises(ValueError, match="with motors at 50 %"):
        robot.check_payload(20.0, strength=0.5)
    with pytest.raises(ValueError, match="the trunk"):
        robot.check_payload(-8.0)
    with pytest.raises(ValueError, match="payload"):
        robot.check_payload(float("nan"))


def test_largest_payload_by_the_jacobian_of_the_foot():
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: no Jacobian")
    model = robot.compile_model()
    data = mujoco.MjData(model)
    data.qpos[7:] = gait.neutral()
    mujoco.mj_forward(model, data)
    payload, _ = robot.largest_payload()
    weight = 0.5 * (P.robot.mass + payload) * robot.GRAVITY
    J = np.zeros((3, model.nv))
    mujoco.mj_jacGeom(model, data, J, None, model.geom("FL_foot").id)
    torque = np.abs(J[2, 6:9] * weight)
    assert np.max(torque / np.array(P.robot.torque_limits)) == pytest.approx(1.0)


# -- gait --------------------------------------------------------------------------------------------------------


@given(st.floats(0.0, 2.0 * np.pi), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
@settings(max_examples=60, deadline=None)
def test_trot_puts_the_feet_where_it_says(phase, vx, vy, turn):
    wanted = gait.feet(phase, [vx, vy, turn])
    q = gait.trot(phase, [vx, vy, turn])
    inside = (q.reshape(4, 3) > np.array(P.robot.lower) + EXACT) & (
        q.reshape(4, 3) < np.array(P.robot.upper) - EXACT
    )
    reached = np.linalg.norm(wanted, axis=1) < 0.4
    good = inside.all(axis=1) & reached
    assert good.sum() >= 3
    assert forward(q)[good] == pytest.approx(wanted[good], abs=EXACT)


def test_standing_feet_move_as_the_ground_does():
    command, step = np.array([0.6, -0.2, 0.5]), 1e-6
    phase = 0.4 * np.pi
    rate = 2.0 * np.pi * float(gait.frequency(command))
    velocity = (gait.feet(phase + rate * step, command) - gait.feet(phase, command)) / step
    stands = gait.standing(phase)
    assert stands.tolist() == [True, False, False, True]
    where = robot.hips(P.robot) + gait.feet(np.pi, np.zeros(3)) * [0.0, 1.0, 0.0]
    trunk = np.array([command[0], command[1], 0.0])
    over_ground = velocity + trunk + np.cross([0.0, 0.0, command[2]], where)
    assert over_ground[stands] == pytest.approx(np.zeros((2, 3)), abs=1e-6)  # difference quotient


def test_frequency_grows_with_speed():
    assert gait.frequency([[0.3, 0.0, 1.0], [-1.0, 0.0, 0.0], [3.0, 0.0, 0.0]]).tolist() == [2.5, 2.5, 4.0]


# -- ground ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("hills", 0.1), "expected one of flat, stairs"),
        (("rough", 1.1), r"difficulty in \[0, 1\], got 1.1"),
        (("rough", float("nan")), "difficulty"),
        (("rough", 0.5, -1), "seed"),
    ],
)
def test_terrain_out_of_range(arguments, message):
    with pytest.raises(ValueError, match=message):
        terrain.Terrain(*arguments)


@pytest.mark.parametrize("kind", terrain.KINDS)
def test_heights_are_those_that_mujoco_meets(kind):
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: no rays")
    ground = terrain.Terrain(kind, 0.6, 3)
    model = robot.compile_model(terrain=ground)
    data = mujoco.MjData(model)
    data.qpos[0] = -1.5  # out of the way
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.5, 8.0, 40), rng.uniform(-1.5, 1.5, 40)])
    edge = np.mod(points[:, 0] - 1.0, 0.3)
    points = points[(edge > 0.02) & (edge < 0.28)]
    # Tiles: from gravel to slopes, in three levels.
    middle = terrain.tile_centre(2, 2) if kind == "tiles" else np.zeros(2)
    points += middle
    # Of three numbers; the binding wants an array.
    geom, down = np.zeros(1, dtype=np.int32), np.array([0.0, 0.0, -1.0])
    for x, y in points:
        depth = mujoco.mj_ray(model, data, np.array([x, y, 5.0]), down, None, 1, -1, geom, None)
        assert 5.0 - depth == pytest.approx(float(ground.height(x, y)), abs=FACET)
    flat = ground.height(
        middle[0] + np.linspace(*((-0.4, 0.4) if kind == "tiles" else (-1.0, 0.9)), 20), middle[1]
    )
    assert np.all(flat == 0.0), "the start is flat"


def test_random_grounds_repeat():
    first, again, other = (terrain.Terrain("rough", 0.5, seed).grid[2] for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
    assert terrain.Terrain("gravel", 0.4).friction == pytest.approx(0.85)


# -- batch and loop ----------------------------------------------------------------------------------------------


def test_batch_equals_single_robots():
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to step")
    payloads, friction = np.array([-1.0, 0.0, 5.0]), np.array([0.1, 0.8, 1.2])
    many = batch.Batch(3)
    many.set_payload(payloads)
    many.set_friction(friction)
    rng = np.random.default_rng(1)
    torque = rng.uniform(-8.0, 8.0, (60, 3, 12))
    for now in torque:
        many.step(now)
    for k in range(3):
        alone = batch.Batch(1, threads=1)
        alone.set_payload(payloads[k])
        alone.set_friction(friction[k])
        for now in torque:
            alone.step(now[k : k + 1])
        assert np.array_equal(alone.qpos[0], many.qpos[k])
    model = robot.compile_model()  # without any batch
    data = mujoco.MjData(model)
    data.qpos[7:] = gait.neutral()
    for now in torque:
        data.ctrl[:] = now[1]
        mujoco.mj_step(model, data)
    assert many.qpos[1] == pytest.approx(data.qpos, abs=EXACT)


def test_payload_is_a_box_on_the_back():
    """Mass, centre and inertia as MuJoCo's compiler puts trunk and box together."""
    mujoco = pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to weigh")
    payload = 4.0
    box = f'<geom type="box" size="0.125 0.08 0.05" pos="0 0 0.11" mass="{payload}"/>'
    text = robot.mjcf().replace('<body name="FL_hip"', f'{box}<body name="FL_hip"', 1)
    wanted = mujoco.MjModel.from_xml_string(text)
    one = batch.Batch(1)
    one.set_payload(payload)
    trunk = wanted.body("trunk").id
    found = one._pool.get_model(0)
    assert found.body_mass[trunk] == pytest.approx(wanted.body_mass[trunk])
    assert found.body_ipos[trunk] == pytest.approx(wanted.body_ipos[trunk])
    assert np.sort(found.body_inertia[trunk]) == pytest.approx(np.sort(wanted.body_inertia[trunk]))


def test_loop_corrects_the_target_as_the_torque():
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to step")
    one = batch.Batch(2)
    joint_loop = loop.JointLoop(one, loop.paper_filter())
    joint_loop.strength[1] = 0.5
    target = np.tile(gait.neutral(), (2, 1))
    for _ in range(30):
        joint_loop.advance(target)
    q, qd = one.q.copy(), one.qd.copy()
    given = joint_loop.update(target)
    plain = P.control.kp * (target - q) - P.control.kd * qd - joint_loop.f_hat
    assert np.abs(joint_loop.f_hat).max() > 1.0, "the legs carry the robot, the filter finds it"
    limits = np.tile(P.robot.torque_limits, 4)
    half_a_step = 0.5 * P.control.kp * P.control.resolution + EXACT
    assert joint_loop.torque == pytest.approx(np.clip(plain, -limits, limits), abs=half_a_step)
    assert given[1] == pytest.approx(0.5 * joint_loop.torque[1])


def test_filter_takes_the_sag_of_a_loaded_stance():
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to step")
    heights = []
    for choice in (None, loop.paper_filter()):
        one = batch.Batch(1)
        one.set_payload(4.0)
        joint_loop = loop.JointLoop(one, choice)
        # A stance without a policy needs stiffer gains.
        joint_loop.kp[:], joint_loop.kd[:], joint_loop.nominal = 80.0, 2.0, 80.0
        for _ in range(300):
            joint_loop.advance(gait.neutral()[None])
        heights.append(float(one.qpos[0, 2]))
    nominal = P.gait.height + P.robot.foot_radius
    assert heights[0] < nominal - 0.01
    assert heights[1] == pytest.approx(nominal, abs=0.003)


def test_fade_takes_the_estimate_from_the_motors_of_a_tilted_robot():
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing to step")
    two = batch.Batch(2)
    choice = loop.FilterChoice((4.0,), gate="tilt", gate_action="hold", fade=(0.05, 0.5))
    joint_loop = loop.JointLoop(two, choice)
    target = np.tile(gait.neutral(), (2, 1))
    for _ in range(10):
        joint_loop.advance(target)
    before = joint_loop.f_hat.copy()
    two.qpos[1, 3:7] = [np.cos(0.2), np.sin(0.2), 0.0, 0.0]  # rolled by 0.4 rad
    for _ in range(20):  # 100 ms without a step of the robot
        joint_loop.update(target)
    assert np.all(joint_loop.share[0] == 1.0)
    assert joint_loop.share[1] == pytest.approx(np.exp(-0.1 / 0.05))
    assert joint_loop.f_hat[1] == pytest.approx(before[1] * np.exp(-2.0))
    with pytest.raises(ValueError, match="two positive times and the gate 'tilt'"):
        loop.FilterChoice((1.0,), fade=(0.1, 0.1))
    with pytest.raises(ValueError, match="two positive times"):
        loop.FilterChoice((1.0,), gate="tilt", fade=(0.1, 0.0))


# -- policies ----------------------------------------------------------------------------------------------------


def small(rng: np.random.Generator) -> policy.Policy:
    layers = ((rng.normal(size=(5, 47)), rng.normal(size=5)), (rng.normal(size=(12, 5)), rng.normal(size=12)))
    return policy.Policy(layers, P.robot.name, {"seed": 0, "filter": None, "reward": [0.0]})


def test_policy_survives_its_file(tmp_path: Path):
    rng = np.random.default_rng(2)
    first = small(rng)
    policy.save(first, tmp_path / "p.json")
    again = policy.load(tmp_path / "p.json")
    seen = rng.normal(size=(7, 47))
    hidden = seen @ first.layers[0][0].T + first.layers[0][1]
    hidden = np.where(hidden > 0.0, hidden, np.exp(hidden) - 1.0)
    limit = P.control.action_limit
    wanted = np.clip(hidden @ first.layers[1][0].T + first.layers[1][1], -limit, limit)
    assert first(seen) == pytest.approx(wanted)
    assert again(seen) == pytest.approx(wanted, abs=1e-3)  # six digits of every number
    assert again.record["seed"] == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot": "another"}, "a policy of the robot 'another', expected 'lite3-primitives'"),
        ({"format": "something"}, "expected a file with"),
        ({"version": 9}, "version 9, this one reads 1"),
        ({"activation": "tanh"}, "activation 'tanh'"),
        ({"shapes": [[5, 47], [12, 6]]}, "are announced"),
        ({"layers": [{"weights": [[1.0]], "bias": [0.0]}], "shapes": [[1, 1]]}, "layer 0: expected weights"),
        ({"layers": [{"weights": [[1.0]]}]}, "damaged, KeyError"),
    ],
)
def test_policy_files_that_are_refused(tmp_path: Path, change, message):
    path = tmp_path / "p.json"
    policy.save(small(np.random.default_rng(2)), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=message):
        policy.load(path)


def test_no_json_and_numbers_that_are_not_finite(tmp_path: Path):
    path = tmp_path / "p.json"
    path.write_text("{")
    with pytest.raises(ValueError, match="expected a policy in JSON"):
        policy.load(path)
    weights = np.full((12, 47), np.nan)
    with pytest.raises(ValueError, match="not all numbers are finite"):
        policy.Policy(((weights, np.zeros(12)),), P.robot.name, {})
    with pytest.raises(ValueError, match="expected 12 actions, got 3"):
        policy.Policy(((np.zeros((3, 47)), np.zeros(3)),), P.robot.name, {})


@pytest.mark.parametrize("name", sorted(path.stem for path in policy.FOLDER.glob("*.json")))
def test_shipped_policies_say_how_they_were_trained(name):
    shipped = policy.shipped(name)
    record = shipped.record
    family, seed = name.rsplit("-", 1)
    assert record["seed"] == int(seed)
    assert (record["filter"] is None) == ("base" in family)
    assert record["steps"] == record["environments"] * record["iterations"] * P.training.horizon
    assert len(record["reward"]) == record["iterations"] // record["reward_every"]
    assert record["reward"][-1] > 2.0 * record["reward"][0]


def test_every_method_has_its_policies():
    for method in methods.METHODS.values():
        assert len(method.policies()) == len(method.seeds) > 0
    with pytest.raises(ValueError, match=r"no policy 'none-0': neither a file nor one .*base-0"):
        policy.shipped("none-0")


# -- what is missing ---------------------------------------------------------------------------------------------


def test_missing_extra_is_named(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(
        ImportError, match=r"the quadruped needs the extra mujoco: pip install 'phyfilter-ctl\[mujoco\]'"
    ):
        batch.Batch(1)
    assert main(["run", "quadruped", "--quick", "--quiet", "--picture", "none"]) == 2
    assert "needs the extra mujoco" in capsys.readouterr().err
    assert robot.joint_inertia().shape == (12,), "everything that needs no simulator works"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--payload", "4"], "two legs of a trot carry"),
        (["--speed", "9"], "expected up to 3.0 m/s, got 9.0"),
        (["--terrain", "hills"], "expected some of stairs, rough, wave, gravel or none, got hills"),
        (["--difficulty", "2"], "difficulty in [0, 1], got 2.0"),
        (["--policy", "/nowhere/p.json"], "/nowhere/p.json"),
        (["--picture", "p.txt"], "expected a file that ends in"),
        (["--threads", "0"], "--threads"),
        (["--train", "--iterations", "0"], "iterations: expected 1 or more"),
        (["--train", "--velocity", "7"], "velocity: expected a speed up to 3.0 m/s"),
        (["--train", "--seed", "-1"], "seed: expected 0 or more"),
        (["--train", "--out", "/nowhere/p.json"], "there is no folder"),
    ],
)
def test_bad_options_are_refused_before_anything_runs(arguments, message, capsys):
    assert main(["run", "quadruped", "--quiet", *arguments]) == 2
    assert message in capsys.readouterr().err
