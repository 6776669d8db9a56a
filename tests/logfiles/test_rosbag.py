"""ROS 1 bags, ROS 2 bags and MCAP by rosbags' own writers."""

from __future__ import annotations

import contextlib
import sqlite3
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import phyfilter_ctl as pf

START = 1_700_000_000_123_456_789
IMU, JOINTS, TEXT = "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "std_msgs/msg/String"
OWN, POSES = "robot_msgs/msg/Motors", "geometry_msgs/msg/PoseArray"
KINDS = ["rosbag1", "rosbag2 sqlite3", "rosbag2 mcap"]


def received(k: int) -> int:
    """Every 10 ms with a gap and a step back, 12 ms after the measurement and a bit."""
    return START + 10_000_000 * k + (700_000_000 if k >= 30 else 0) - (25_000_000 if k == 50 else 0)


def late(k: int) -> int:
    return 12_000_000 + 1_000_000 * (k % 3)


def write(path: Path, kind: str, count: int = 100, packed: str = "") -> Path:
    """A bag with an IMU, joints, text, poses and a message of the robot's own; its chunks packed by a format."""
    ros1 = kind == "rosbag1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float32[4] speed\nbool armed\nstring mode\n", OWN))
    types = store.types
    if ros1:
        writer, path = Writer1(path.with_suffix(".bag")), path.with_suffix(".bag")
        if packed:
            writer.set_compression(Writer1.CompressionFormat[packed])
    else:
        storage = StoragePlugin.MCAP if kind.endswith("mcap") else StoragePlugin.SQLITE3
        writer = Writer2(path, version=9, storage_plugin=storage)
        if packed:
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat[packed])
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]

    def header(ns: int) -> object:
        stamp = types["builtin_interfaces/msg/Time"](ns // 10**9, ns % 10**9)
        fields = {"stamp": stamp, "frame_id": "base"}
        return types["std_msgs/msg/Header"](**({"seq": 7, **fields} if ros1 else fields))

    with writer:
        names = {"/imu": IMU, "/joints": JOINTS, "/text": TEXT, "/motors": OWN, "/poses": POSES}
        connections = {
            topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()
        }

        def put(topic: str, ns: int, message: object) -> None:
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connections[topic], ns, serialize(message, names[topic]))

        for k in range(count):
            imu = types[IMU](
                header=header(received(k) - late(k)),
                orientation=quaternion(0.0, 0.0, 0.0, 1.0),
                orientation_covariance=np.arange(9.0),
                angular_velocity=vector(0.5 * k, -k, 0.0),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector(float("nan"), 0.0, 9.75),
                linear_acceleration_covariance=np.zeros(9),
            )
            put("/imu", received(k), imu)
            if k % 10 == 0:
                ns = received(k) + 3_000_000
                position = np.array([k, -k], float)
                joints = types[JOINTS](header(0), ["a", "b"], position, np.empty(0), np.full(2, 0.125))
                put("/joints", ns, joints)
                put("/motors", ns, types[OWN](np.arange(4, dtype=np.float32) + k, k > 50, "auto"))
                put("/text", ns, types[TEXT]("hello"))
                put("/poses", ns, types[POSES](header(ns), []))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_what_was_written_is_read(tmp_path: Path, kind: str) -> None:
    log = pf.open_log(write(tmp_path / "bag", kind))
    assert log.format == kind.split()[0]
    assert log.start == datetime.fromtimestamp(START // 10**9, UTC).replace(microsecond=123_456)
    expected = np.array([received(k) for k in range(100)])
    expected = expected[np.argsort(expected, kind="stable")]  # a bag gives its messages by time
    imu = log.read("/imu", ["angular_velocity.x", "linear_acceleration.x", "orientation_covariance"])
    np.testing.assert_array_equal(imu.times, (expected - START) / 1e9)
    assert sorted(imu.values[:, 0]) == [0.5 * k for k in range(100)]
    assert np.isnan(imu.values[:, 1]).all()
    assert (imu.values[:, 2:] == np.arange(9.0)).all()
    assert imu.units[:3] == ("rad/s", "m/s^2", "")
    motors = log.read("/motors")
    assert motors.fields == ("speed[0]", "speed[1]", "speed[2]", "speed[3]", "armed")
    np.testing.assert_array_equal(motors.values[:, :4], np.arange(4) + np.arange(0, 100, 10)[:, None])
    topics = {topic.name: topic for topic in log.topics}
    assert topics["/imu"].clock.gaps == 1
    assert not topics["/text"].fields
    assert (
        "left out: name (2 elements), velocity (0 elements in the first message)" in topics["/joints"].notes
    )
    joints = log.read("/joints", ["effort", "position[1]"])
    assert joints.values[3].tolist() == [0.125, 0.125, -30.0]


@pytest.mark.parametrize("kind", KINDS)
def test_the_header_is_another_clock(tmp_path: Path, kind: str) -> None:
    log = pf.open_log(write(tmp_path / "bag", kind))
    topics = {topic.name: topic for topic in log.topics}
    said = "header.stamp is 13 ms before the reception, which is the clock (12 to 14 ms)"
    assert said in topics["/imu"].notes
    assert "header.stamp is never set" in topics["/joints"].notes
    stamped = log.read("/imu", ["angular_velocity.x"], clock="header.stamp")
    k = np.rint(2 * stamped.values[:, 0]).astype(int)
    np.testing.assert_array_equal(stamped.times, [(received(j) - late(j) - START) / 1e9 for j in k])


def test_a_bag_is_refused_where_it_is_broken(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", "rosbag1")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="no readable rosbag1 log"):
        pf.open_log(path)
    path.write_bytes(b"#ROSBAG V1.2\n" + whole[13:])
    with pytest.raises(ValueError, match="a ROS bag of format 1; convert it"):
        pf.open_log(path)
    other = tmp_path / "bag.log"
    other.write_bytes(whole)
    with pytest.raises(ValueError, match=r"rename it: rosbags tells bags by \.bag"):
        pf.open_log(other)
    folder = tmp_path / "empty"
    folder.mkdir()
    with pytest.raises(ValueError, match=r"a folder without metadata\.yaml is no ROS 2 bag"):
        pf.open_log(folder)


def test_messages_that_the_bag_does_not_define_are_the_usual_ones_or_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", "rosbag2 sqlite3")
    with contextlib.closing(sqlite3.connect(next(path.glob("*.db3")))) as data:  # as ROS 2 Humble wrote them
        data.execute("delete from message_definitions")
        data.commit()
    log = pf.open_log(path)
    assert log.notes == (
        "left out, /motors: robot_msgs/msg/Motors is not defined",
        "the bag does not define its messages: they are taken for those of ROS 2 Humble",
    )
    assert log.read("/joints", ["effort[0]"]).values[0, 0] == 0.125


def test_a_single_mcap_file_needs_no_folder(tmp_path: Path) -> None:
    (path,) = write(tmp_path / "bag", "rosbag2 mcap").glob("*.mcap")
    log = pf.open_log(path)
    assert log.format == "mcap"
    assert log.read("/motors").values[9, :4].tolist() == [90.0, 91.0, 92.0, 93.0]
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(ValueError, match="no readable mcap log"):
        pf.open_log(path)
