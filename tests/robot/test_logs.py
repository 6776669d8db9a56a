"""Robot files on logs as they are: ULog, recorded flights, mechanisms from their files."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import phyfilter_ctl as pf
from tests.robot.conftest import PX4
from tests.robot.flight import GRAVITY, fly, log_of, px4_topics, wind

# Recorded flights are no part of the project: a folder with windtunnel/ and crazyflie/ in it.
DATA = Path(os.environ.get("PHYFILTER_RECORDINGS", "no-such-folder"))
ABSENT = "PHYFILTER_RECORDINGS names no folder with recorded flights"


def test_px4s_own_file_gives_what_its_topics_do(load, tmp_path):
    pytest.importorskip("pyulog")
    from tests.logfiles.ulog_writer import write_ulog

    start = 3_000_000
    topics = px4_topics(fly(6.0))
    written = {}
    for name, (times, columns) in topics.items():
        fields = {"timestamp": ("uint64_t", start + np.round(1e6 * times).astype(np.uint64))}
        for base in dict.fromkeys(column.split("[")[0] for column in columns):
            values = [columns[column] for column in columns if column.split("[")[0] == base]
            array = np.stack(values, axis=1) if len(values) > 1 else values[0]
            fields[base] = ("float", array.astype(np.float32))
        written[name] = fields
    write_ulog(tmp_path / "flight.ulg", written, start=start)
    robot = load(PX4)
    found, expected = robot.read(tmp_path / "flight.ulg"), robot.read(log_of("flight.ulg", topics))
    assert found.name == "flight"
    np.testing.assert_allclose(found.times, expected.times, atol=1e-9)
    np.testing.assert_allclose(found.x, expected.x, atol=1e-6)  # single precision
    np.testing.assert_allclose(found.g, expected.g, atol=1e-5)
    f_hat = pf.lowpass(1, 8.0).sampled(0.02).run(found.x, found.g, None, found.inertia, found.times)
    assert np.sqrt(np.mean((f_hat - wind(found.times))[100:] ** 2)) < 0.1


ARM = """
format = "phyfilter-robot"
version = 1
preset = "arm"
mechanism = { file = "arm.xml", joints = ["shoulder", "elbow"] }
"""
MJCF = """
<mujoco><option timestep="0.0005"><flag contact="disable"/></option><worldbody><body>
<joint name="shoulder" axis="0 1 0"/>
<geom type="capsule" size="0.04" fromto="0 0 0 0.4 0 0" mass="2"/><body pos="0.4 0 0">
<joint name="elbow" axis="0 1 0"/><geom type="capsule" size="0.03" fromto="0 0 0 0.3 0 0" mass="1"/>
</body></body></worldbody></mujoco>
"""


def test_an_arms_load_is_found_from_its_own_model_file(load, tmp_path):
    """MuJoCo moves it with a torque that the log does not hold; M(q) and the bias come from the file."""
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "arm.xml").write_text(MJCF)
    robot = load(ARM)
    model = mujoco.MjModel.from_xml_string(MJCF)
    data = mujoco.MjData(model)
    h, n = 0.0005, 1500
    t = h * np.arange(n)
    f = np.stack([2.0 * np.sin(3.0 * t), 0.5 * np.cos(4.0 * t)], axis=1)
    torque = np.stack([-9.0 + 0.0 * t, -1.5 + np.sin(2.0 * t)], axis=1)
    rows = np.empty((n, 4))
    for k in range(n):
        rows[k] = [*data.qpos, *data.qvel]
        data.qfrc_applied[:] = torque[k] + f[k]
        mujoco.mj_step(model, data)
    names = {"position": rows[:, :2], "velocity": rows[:, 2:], "effort": torque}
    columns = {f"{name}[{i}]": values[:, i] for name, values in names.items() for i in range(2)}
    log = robot.read(log_of("arm.bag", {"/joint_states": (t, columns)}))
    assert log.inertia.shape == (n, 2, 2)
    u = (
        np.einsum("nij,nj->ni", 0.5 * (log.inertia[1:] + log.inertia[:-1]), np.diff(log.x, axis=0)) / h
        - log.g[:-1]
    )
    # The integrator is of first order in h: half a step of the change of M and of the bias.
    assert np.max(np.abs(u - f[:-1])) < 0.02


def windtunnel(path: Path) -> str:
    return f"""
format = "phyfilter-robot"
version = 1
time_unit = "s"
constants = {{ gravity = 9.81, mass = {MASSES[path.name]} }}
signals.v = {{ fields = ["vx", "vy", "vz"], unit = "m/s", frame = "ENU" }}
signals.q = {{ fields = ["qx", "qy", "qz", "qw"], rotation = "xyzw", frames = ["FLU", "ENU"] }}
signals.throttle = {{ field = "T_sp", unit = "1" }}
signals.hover = {{ field = "hover_throttle", unit = "1" }}
signals.fa = {{ fields = ["fax", "fay", "faz"], unit = "N", frame = "ENU" }}
expressions.thrust = "mass * gravity * throttle / hover"
model = {{ x = "v", M = "mass", g = "rotate(q, [0, 0, thrust]) - [0, 0, mass * gravity]", label = "fa", unit = "m/s" }}
"""


# kg, of the labels, as models/drone/replay_recordings.py finds them.
MASSES = {"custom_figure8_baseline_70wind.csv": 2.63, "custom_figure8_NF_100wind.csv": 2.63}


@pytest.mark.skipif(not (DATA / "windtunnel").is_dir(), reason=ABSENT)
@pytest.mark.parametrize("name", MASSES)
def test_a_recorded_flight_by_its_file_alone(load, name):
    """The same specific force as the drone's own reader of these files makes, to half a step of the thrust."""
    from phyfilter_ctl.models.drone import replay_recordings

    path = DATA / "windtunnel" / name
    theirs = replay_recordings.read(path)
    robot = load(windtunnel(path).replace(str(MASSES[name]), repr(theirs.mass)))
    check = robot.check(path)
    # As their authors say: the force is a derivative of the velocity, by five points.
    assert [finding.suspicion for finding in check] == ["label_is_derivative"]
    assert "five-point difference" in check.findings[0].message
    ours = check.recording
    middle = 0.5 * theirs.mass * (theirs.g[1:] + theirs.g[:-1])
    assert np.max(np.abs(ours.g[:-1] - middle)) < 1e-2 * np.sqrt(np.mean(middle**2))
    np.testing.assert_allclose(ours.x, theirs.v)
    np.testing.assert_allclose(ours.label, theirs.mass * theirs.label)


@pytest.mark.skipif(not (DATA / "crazyflie").is_dir(), reason=ABSENT)
def test_recorded_velocities_and_accelerations(load):
    robot = load("""
format = "phyfilter-robot"
version = 1
time_unit = "s"
signals.v = { fields = ["vx", "vy", "vz"], unit = "m/s", frame = "ENU" }
signals.a = { fields = ["ax", "ay", "az"], unit = "m/s^2", frame = "ENU" }
model = { x = "v", label = "a", unit = "m/s" }
""")
    for path in sorted((DATA / "crazyflie").glob("*.csv"))[:4]:
        ours, theirs = robot.read(path), pf.Recording.from_csv(path)
        assert robot.check(path).findings == ()
        np.testing.assert_allclose(ours.times, theirs.times - theirs.times[0], atol=1e-12)
        np.testing.assert_array_equal(ours.x, theirs.x)
        np.testing.assert_array_equal(ours.label, theirs.label)


def test_presets_of_other_vehicles_know_their_frames(load):
    """Each is tilted by 0.2 rad to its right and pushes 1.2 of its weight: known motion, nothing left for f."""
    t, ones = 0.02 * np.arange(200), np.ones(200)
    slope = GRAVITY * np.array(
        [0.0, -1.2 * np.sin(0.2), 1.2 * np.cos(0.2) - 1.0]
    )  # east is ahead, y to the left
    v = t[:, None] * slope
    up = np.array([0.0, 0.0, GRAVITY])
    half = np.array([np.cos(0.1), np.sin(0.1), 0.0, 0.0])  # about the axis ahead
    body_v = Rotation.from_quat(half, scalar_first=True).inv().apply(v)
    logs = {
        "ardupilot-copter": {
            "XKF1[0]": (t, {"VN": v[:, 1], "VE": v[:, 0], "VD": -v[:, 2]}),
            "ATT": (
                t,
                {"Roll": np.degrees(0.2) * ones, "Pitch": 0.0 * t, "Yaw": 90.0 * ones},
            ),  # towards east
            "CTUN": (t, {"ThO": 0.48 * ones, "ThH": 0.4 * ones}),
        },
        "crazyflie": {
            "table": (
                t,
                {
                    **{f"stateEstimate.v{a}": v[:, i] for i, a in enumerate("xyz")},
                    **{f"stateEstimate.q{a}": half[i] * ones for i, a in enumerate("wxyz")},
                    "stabilizer.thrust": 65535 * 1.2 * 0.03 * GRAVITY / 0.6 * ones,
                },
            )
        },
        "legged-base": {
            "/odom": (
                t,
                {
                    **{f"pose.pose.orientation.{a}": half[i] * ones for i, a in enumerate("wxyz")},
                    **{f"twist.twist.linear.{a}": body_v[:, i] for i, a in enumerate("xyz")},
                },
            ),
            "/contact_force": (
                t,
                {f"wrench.force.{a}": 20.0 * (slope + up)[i] * ones for i, a in enumerate("xyz")},
            ),
        },
    }
    constants = {"crazyflie": "mass = 0.03, full_thrust = 0.6", "legged-base": "mass = 20.0"}
    for name, topics in logs.items():
        given = constants.get(name, "mass = 2.0")
        head = 'format = "phyfilter-robot"\nversion = 1\n'
        log = load(f'{head}preset = "{name}"\nconstants = {{ {given} }}\n').read(log_of("f.log", topics))
        left = log.inertia * np.diff(log.x, axis=0) / 0.02 - log.g[:-1]
        assert np.max(np.abs(left)) < 1e-9 * log.inertia * GRAVITY, name
