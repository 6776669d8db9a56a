"""Robots from anybody's files: MuJoCo's own reading of the file is the other route."""

from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl.plants.legged import JointSpacePrior, load_robot

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

GO1 = Path(__file__).parents[2] / "models" / "quadruped" / "go1" / "go1.xml"
LEGS = ("FL", "FR", "RL", "RR")
JOINTS = [f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf")]
# kg m^2, N m: the same sums in another order.
EXACT = 1e-12
URDF = """<robot name="hopper"><link name="torso"><inertial><mass value="2"/>
<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="leg"><inertial><mass value=".5"/><inertia ixx=".002" iyy=".002" izz=".001" ixy="0" ixz="0" iyz="0"/>
</inertial><visual><geometry><mesh filename="nowhere.stl"/></geometry></visual></link>
<link name="toe"><inertial><mass value=".1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><sphere radius=".02"/></geometry></collision></link>
<joint name="hip" type="revolute"><parent link="torso"/><child link="leg"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="20" velocity="30"/></joint>
<joint name="ankle" type="fixed"><parent link="leg"/><child link="toe"/><origin xyz="0 0 -.2"/></joint></robot>"""


@pytest.fixture(scope="module")
def go1():
    return load_robot(GO1, joints=JOINTS, feet=LEGS)


def test_quantities_are_those_of_the_file_in_the_order_of_the_names(go1):
    raw = mujoco.MjModel.from_xml_path(str(GO1))
    plain = mujoco.MjData(raw)
    rng = np.random.default_rng(0)
    data = go1.stand(np.tile([0.1, 0.9, -1.8], 4) + rng.uniform(-0.2, 0.2, 12))
    data.qvel[:] = rng.normal(size=18)
    plain.qpos[:7], plain.qvel[:6] = data.qpos[:7], data.qvel[:6]
    for k, name in enumerate(JOINTS):
        plain.joint(name).qpos, plain.joint(name).qvel = data.qpos[go1.qpos[k]], data.qvel[go1.dof[k]]
    mujoco.mj_forward(raw, plain)
    mujoco.mj_forward(go1.model, data)
    found, M = go1.quantities(data), np.zeros((18, 18))
    mujoco.mj_fullM(raw, plain, M)
    order = [*range(6), *(int(raw.joint(name).dofadr[0]) for name in JOINTS)]
    assert np.asarray(found.M) == pytest.approx(M[np.ix_(order, order)], abs=EXACT)
    assert found.bias == pytest.approx((plain.qfrc_bias - plain.qfrc_passive)[order], abs=EXACT)
    assert go1.mass == pytest.approx(12.743448)
    assert go1.torque_limits.tolist() == [23.7, 23.7, 35.55] * 4


def test_estimated_contact_of_a_standing_robot_is_the_true_one(go1):
    stance = np.tile([0.0, 0.9, -1.8], 4)
    data = go1.stand(stance)
    for _ in range(400):
        q, qd = data.qpos[go1.qpos], data.qvel[go1.dof]
        data.ctrl[go1.motors] = 200.0 * (stance - q) - 4.0 * qd
        mujoco.mj_step(go1.model, data)
    mujoco.mj_forward(go1.model, data)
    found = go1.quantities(data)
    assert found.contact_estimate[2] == pytest.approx(9.81 * go1.mass, rel=1e-3), "the feet carry the weight"
    assert found.contact_torque[2] == pytest.approx(9.81 * go1.mass, rel=0.01), "the robot is at rest"
    known, estimated = (
        JointSpacePrior(contact=word, base="floating").known_torque(found, data.ctrl[go1.motors])
        for word in ("known", "estimated")
    )
    # Dry friction of up to 1 N m is in the true constraint torques alone, and so are forces between the feet.
    assert np.abs(known - estimated).max() < 3.0
    assert np.abs(found.contact_torque[6:]).max() > 4.0


def test_urdf_gets_a_free_joint_motors_and_a_ground():
    robot = load_robot(URDF, joints=["hip"], feet=["toe"])
    assert robot.mass == pytest.approx(2.6), "the root's mass and that of the fixed toe count"
    assert robot.torque_limits.tolist() == [20.0]
    assert robot.model.nq == 8
    data = robot.stand([0.0])
    assert data.qpos[2] == pytest.approx(0.22)
    for _ in range(20):
        mujoco.mj_step(robot.model, data)
    assert data.sensordata[robot.touch[0]] > 0.0, "the foot stands"


def test_position_servos_give_way_to_torques(go1):
    data = go1.stand(np.tile([0.0, 0.9, -1.8], 4))
    data.ctrl[go1.motors[1]] = 5.0
    mujoco.mj_forward(go1.model, data)
    assert data.qfrc_actuator[go1.dof].tolist() == [0.0, 5.0, *[0.0] * 10]
    data.ctrl[go1.motors[1]] = 50.0
    mujoco.mj_forward(go1.model, data)
    assert data.qfrc_actuator[go1.dof[1]] == 23.7


def test_ground_and_options():
    hill = '<mujoco><worldbody><geom name="hill" type="box" size="1 1 .1"/></worldbody></mujoco>'
    robot = load_robot(URDF, joints=["hip"], feet=["toe"], ground=hill, options={"timestep": 0.004})
    assert robot.model.opt.timestep == 0.004
    assert robot.model.geom("hill").size.tolist() == [1.0, 1.0, 0.1]


@pytest.mark.parametrize(
    "shape",
    [
        'type="sphere" size=".03"',
        'type="capsule" size=".02 .04"',
        'type="capsule" size=".02" fromto="-.05 0 -.3 .05 0 -.28"',
        'type="ellipsoid" size=".05 .03 .02"',
        'type="cylinder" size=".04 .02"',
        'type="box" size=".06 .03 .01"',
    ],
)
def test_lowest_point_of_any_foot_touches_the_ground(shape):
    """Against MuJoCo's collision of a plane and the tilted foot; the file is in degrees, the ground is not."""
    text = f"""<mujoco><compiler angle="degree"/><worldbody><body name="trunk"><freejoint/><geom size=".05" mass="3"/>
    <body><joint name="hip" axis="0 1 0" range="-40 40"/><geom size=".01" mass=".1" contype="0" conaffinity="0"/>
    <body name="foot" euler="25 0 10"><geom name="sole" pos="0 0 -.3" mass=".1" {shape}/></body></body></body>
    </worldbody><actuator><motor joint="hip" gear="-3" ctrlrange="-4 4"/></actuator></mujoco>"""
    text = text.replace('pos="0 0 -.3"', "") if "fromto" in shape else text
    robot = load_robot(text, joints=["hip"], feet=["sole"])
    assert robot.torque_limits.tolist() == [12.0]
    assert robot.model.jnt_range[1] == pytest.approx(np.radians([-40.0, 40.0]))
    data = robot.stand([0.3])
    data.qpos[2] -= 1e-3
    mujoco.mj_forward(robot.model, data)
    assert min(contact.dist for contact in data.contact) == pytest.approx(-1e-3, abs=1e-9)
    assert data.sensordata[robot.touch[0]] > 0.0
    assert load_robot(text, joints=["hip"], feet=["foot"]).geoms.tolist() == robot.geoms.tolist()


def test_ground_of_the_file_stays_the_only_one():
    text = """<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/><body name="trunk"><freejoint/>
    <geom name="foot" size=".1" mass="1"/><body><joint name="arm"/><geom size=".02" mass=".1" pos="0 0 .2"/></body>
    </body></worldbody></mujoco>"""
    robot = load_robot(text, joints=["arm"], feet=["foot"], torque_limits=1.0)
    planes = robot.model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    assert planes.sum() == 1
    moving = '<mujoco><worldbody><body pos="9 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    with pytest.raises(ValueError, match="to be what moves first in the model"):
        load_robot(text, joints=["arm"], feet=["foot"], torque_limits=1.0, ground=moving)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": ["knee"]}, "no hinge or slide 'knee' in the file; there are: hip"),
        ({"joints": ["hip", "hip"]}, "expected different names"),
        ({"feet": ["leg"]}, "expected 'leg' to be a sphere, .* or a body with one; there are: toe"),
        ({"feet": []}, "feet: expected different names"),
        ({"torque_limits": -1.0}, "expected positive numbers in N m"),
        ({"source": "<mujoco><oops/></mujoco>"}, "no robot that MuJoCo can read"),
        ({"source": Path("/nowhere/robot.xml")}, "no robot that MuJoCo can read"),
        ({"source": URDF.replace('effort="20"', 'effort="0"')}, "does not limit the torque of 'hip'; give"),
        ({"source": "<mujoco/>"}, "without bodies"),
    ],
)
def test_files_that_are_refused(change, message):
    given = {"source": URDF, "joints": ["hip"], "feet": ["toe"]} | change
    with pytest.raises(ValueError, match=message):
        load_robot(given.pop("source"), **given)
