"""Wrappers of loops that exist: each finds a known disturbance and takes it off, against the loop by hand."""

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.filter import LiveRules
from phyfilter_ctl.wrappers import FeedForward, ForceEstimator, LoopModel, force_node

H = 0.01
LOAD = 2.0
WIND = np.array([0.6, 0.0, -0.2])


def wheel(low=-np.inf, high=np.inf):
    return LoopModel(
        x=lambda y: [y[0]],
        g=lambda y, u: u - 0.3 * np.sin(y),
        compensate=lambda y, f_hat: -f_hat,
        inertia=lambda y: 0.5,
        low=low,
        high=high,
    )


def ran(model, n=300):
    feedforward = FeedForward(PhyFilter([10.0]).sampled(H).live(1), model)
    y, rows = np.zeros(1), []
    for k in range(n):
        u = feedforward(k * H, None if 100 <= k < 105 else y, 2.0 * (1.0 - y))
        rows.append((y[0], u[0], feedforward.live.f_hat[0]))
        y = y + H * (u - 0.3 * np.sin(y) + LOAD) / 0.5
    return np.array(rows)


def test_a_loop_gets_rid_of_its_load():
    y, _, f_hat = ran(wheel())[-1]
    assert f_hat == pytest.approx(LOAD, abs=1e-3)
    assert 2.0 * (1.0 - y) == pytest.approx(0.3 * np.sin(y), abs=1e-3)  # as without the load


def test_what_the_limits_take_away_is_no_residual():
    rows = ran(wheel(low=-0.5, high=0.5))
    assert rows[:, 1].min() == -0.5
    assert rows[-1, 2] == pytest.approx(LOAD, abs=0.05)


def test_loops_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match='expected a filter sampled with g="hold"'):
        FeedForward(PhyFilter([10.0]).sampled(H, g="average").live(1), wheel())
    with pytest.raises(ValueError, match="expected low < high"):
        wheel(low=1.0, high=-1.0)


# -- ROS 2 ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def messages():
    """The message types of ROS 2 Humble, of the bag reader's own type store."""
    rosbags = pytest.importorskip(
        "rosbags.typesys", reason="rosbags is not installed: no ROS 2 message types"
    )
    return rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE).types


def stamped(types_, kind, outer, inner, k, vector, frame="map", late=0.0):
    ns = 1_760_000_000_123_456_789 + round((k * H + late) * 1e9)
    header = types_["std_msgs/msg/Header"](types_["builtin_interfaces/msg/Time"](*divmod(ns, 10**9)), frame)
    Vector3 = types_["geometry_msgs/msg/Vector3"]
    both = {"linear": "angular", "force": "torque"}
    body = types_[f"geometry_msgs/msg/{outer.capitalize()}"](
        **{inner: Vector3(*vector), both[inner]: Vector3(0.0, 0.0, 0.0)}
    )
    return types_[f"geometry_msgs/msg/{kind}"](header, body)


def flown(messages, hear, command):
    """A body of 1.5 kg that a wind of (0.6, 0, -0.2) N pushes; stamps as they are since 1970, jittering."""
    rng, v = np.random.default_rng(0), np.zeros(3)
    for k in range(200):
        late = 2e-3 * rng.random()
        answer = hear(stamped(messages, "TwistStamped", "twist", "linear", k, v, late=late))
        force = np.array([np.sin(0.1 * k), 0.5, 1.5 * 9.81])
        command(stamped(messages, "WrenchStamped", "wrench", "force", k, force))
        rate = (force + WIND - [0.0, 0.0, 1.5 * 9.81]) / 1.5
        v = v + rate * H
    return answer


def estimator():
    live = PhyFilter([10.0]).sampled(H).live(3, LiveRules(longest_gap=0.1))
    return ForceEstimator(live, mass=1.5, frame_id="map", weight=(0.0, 0.0, -1.5 * 9.81))


def test_messages_in_force_out(messages):
    ours = estimator()
    f_hat = flown(messages, ours.on_velocity, ours.on_force)
    # Stamps that are off by up to 2 ms: a v'/m of 1 N over a step of 10 ms, filtered.
    np.testing.assert_allclose(f_hat, WIND, atol=0.1)
    assert ours.live.health.accepted == 200
    with pytest.raises(ValueError, match="expected the frame 'map', got 'base_link'"):
        ours.on_velocity(stamped(messages, "TwistStamped", "twist", "linear", 200, [0.0] * 3, "base_link"))


def test_the_node_wires_topics(messages, monkeypatch):
    """With a stand-in of rclpy that only notes what the node asks of it."""
    heard, sent = {}, []
    empty = stamped(messages, "WrenchStamped", "wrench", "force", 0, [0.0] * 3)

    class Node:
        def __init__(self, name):
            self.name, self.context = name, types.SimpleNamespace(on_shutdown=lambda function: None)

        def create_publisher(self, kind, topic, depth):
            return types.SimpleNamespace(publish=sent.append)

        def create_subscription(self, kind, topic, function, depth):
            heard[topic] = function

    package = types.ModuleType("geometry_msgs.msg")
    package.TwistStamped, package.WrenchStamped = object, lambda: empty
    node = types.ModuleType("rclpy.node")
    node.Node = Node
    for name, module in {
        "geometry_msgs": types.ModuleType("geometry_msgs"),
        "geometry_msgs.msg": package,
        "rclpy": types.ModuleType("rclpy"),
        "rclpy.node": node,
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    assert force_node(estimator(), name="wind").name == "wind"
    flown(messages, heard["~/velocity"], heard["~/force"])
    force = sent[-1].wrench.force
    np.testing.assert_allclose([force.x, force.y, force.z], WIND, atol=0.1)


def test_without_ros_it_says_so():
    if "rclpy" in sys.modules:
        pytest.skip("ROS 2 is here")
    with pytest.raises(ImportError, match="needs ROS 2"):
        force_node(estimator())


@pytest.mark.slow
def test_the_page_on_loops_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: docs/loops.md is not run")
    pytest.importorskip("gymnasium", reason="Gymnasium is not installed: docs/loops.md is not run")
    text = (Path(__file__).parents[1] / "docs/loops.md").read_text()
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.S):
        exec(compile(block, "docs/loops.md", "exec"), names)
    assert "1 samples with NaN" in capsys.readouterr().out
    assert (tmp_path / "filter.fmu").exists()
