"""The serial arm: kinematics against scipy's rotations, its inverse both ways round, the small arm's path."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from phyfilter_ctl.blocks import sampled_block
from phyfilter_ctl.plants import Link, SerialArm, plant, small_arm

# Rounding of some hundred operations on lengths below 1 m.
EXACT = 1e-13
# The elbow's angle from its cosine: rounding 1e-16 there is 1e-8 rad in the angle at a stretched arm, but only 1e-13
# this far from it.
INVERTED = 1e-10
BENT = 0.05
# Central differences of step 1e-6: rounding 1e-16/1e-6, third derivatives times 1e-12, and rates up to 1e2.
DIFFERENCE = 1e-7

ARM = small_arm()
LOWER, UPPER = ARM.limits
ROD = {"mass": 0.1, "centre": (0.1, 0.0, 0.0), "inertia": (1e-5, 4e-4, 4e-4)}


def rods(count=5, **changes):
    axes = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (1, 0, 0)]
    offsets = [(0.03, 0.0, 0.05), (0.2, 0.0, -0.03), (0.15, 0.0, 0.02), (0.05, 0.0, 0.0), (0.05, 0.0, 0.0)]
    if "axis" in changes:
        axes[changes["at"]] = changes["axis"]
    if "offset" in changes:
        offsets[changes["at"]] = changes["offset"]
    return [Link(axis, offset, **ROD) for axis, offset in zip(axes[:count], offsets[:count], strict=True)]


# Shoulder off the yaw axis, bars that are not straight, a base that is tilted as well.
BENT_ARM = SerialArm(
    rods(), [0.02, -0.01, -0.05], base_axes=Rotation.from_euler("xyz", [2.8, 0.3, -0.4]).as_matrix()
)
ARMS = {"small": ARM, "bent": BENT_ARM}


def chain(arm, joint):
    """Body attitude and place of every link's centre, and of the tip, by scipy."""
    axes = np.array(arm.base_axes)  # a copy: scipy 1.15 wants one that it may write
    turn, place, links = Rotation.from_matrix(axes), arm.mount, []
    for link, angle in zip(arm.links, joint, strict=True):
        turn = turn * Rotation.from_rotvec(angle * link.axis)
        links.append((link, turn.as_matrix(), place + turn.as_matrix() @ link.centre))
        place = place + turn.as_matrix() @ link.offset
    return links, turn, place


@pytest.mark.parametrize("name", ARMS)
def test_kinematics_are_those_of_a_chain_of_rotations(name):
    arm = ARMS[name]
    rng = np.random.default_rng(1)
    for joint in rng.uniform(-2.0, 2.0, (10, 5)):
        links, _, tip = chain(arm, joint)
        np.testing.assert_allclose(arm.end_effector(joint), tip, atol=EXACT)
        centre = sum(link.mass * place for link, _, place in links) / arm.mass
        np.testing.assert_allclose(arm.centre_of_mass(joint), centre, atol=EXACT)
        inertia = sum(
            R @ link.inertia @ R.T + link.mass * (place @ place * np.eye(3) - np.outer(place, place))
            for link, R, place in links
        )
        np.testing.assert_allclose(arm.inertia(joint), inertia, atol=EXACT)
        assert np.linalg.eigvalsh(inertia)[0] > 0.0


def test_jacobian_and_momentum_by_differences():
    joint, rate = np.random.default_rng(2).uniform(-2.0, 2.0, (2, 5))
    h = 1e-6
    ahead, behind = (chain(ARM, joint + side * h * rate) for side in (1, -1))
    np.testing.assert_allclose(ARM.jacobian(joint) @ rate, (ahead[2] - behind[2]) / (2 * h), atol=DIFFERENCE)
    momentum = np.zeros(3)
    for (link, R, place), (_, next_R, next_place), (_, last_R, last_place) in zip(
        chain(ARM, joint)[0], ahead[0], behind[0], strict=True
    ):
        spin = Rotation.from_matrix(next_R @ last_R.T).as_rotvec() / (2 * h)
        momentum += R @ link.inertia @ R.T @ spin
        momentum += link.mass * np.cross(place, (next_place - last_place) / (2 * h))
    np.testing.assert_allclose(ARM.angular_momentum(joint, rate), momentum, atol=DIFFERENCE)
    assert np.abs(momentum).max() > 1e-3


def test_same_in_numpy_and_casadi():
    rng = np.random.default_rng(3)
    joint, rate, acceleration = rng.uniform(-1.5, 1.5, (3, 5))
    p = np.array(ARM.from_base([0.25, 0.05, 0.1]))
    columns = [ca.SX.sym("s", 5) for _ in range(3)]
    point, pitch = ca.SX.sym("p", 3), ca.SX.sym("pitch")
    motion = ARM.motion(columns[0], columns[1], joint_acceleration=columns[2])
    symbolic = [
        *[ca.vec(value) for name, value in vars(motion).items() if name != "mass"],
        ca.vec(ARM.jacobian(columns[0])),
        ARM.inverse(point, pitch, roll=0.3),
        ARM.inverse(p, pitch),  # numbers beside a symbol
        ARM.inverse_rates(columns[0], point, pitch_rate=pitch),
        ARM.reachable(point, pitch),
        ARM.from_base(ARM.to_base(point)),
    ]
    evaluate = ca.Function("f", [*columns, point, pitch], [ca.vertcat(*symbolic)])
    numbers = ARM.motion(joint, rate, joint_acceleration=acceleration)
    expected = [
        *[np.ravel(value, order="F") for name, value in vars(numbers).items() if name != "mass"],
        np.ravel(ARM.jacobian(joint), order="F"),
        ARM.inverse(p, 0.2, roll=0.3),
        ARM.inverse(p, 0.2),
        ARM.inverse_rates(joint, p, pitch_rate=0.2),
        [float(ARM.reachable(p, 0.2))],
        p,
    ]
    found = np.array(evaluate(joint, rate, acceleration, p, 0.2)).ravel()
    np.testing.assert_allclose(found, np.concatenate(expected), atol=1e-12)


def angles():
    return st.tuples(*[st.floats(-3.1, 3.1) for _ in range(5)]).map(np.array)


def is_regular(arm, joint, elbow):
    """Within the branch of the inverse: elbow on its side, point before the base's axis, away from singularities."""
    x, y = np.asarray(arm.to_base(arm.end_effector(joint)))[:2]
    bend = joint[2] - (0.0 if arm is ARM else np.arctan2(0.03, 0.2) - np.arctan2(-0.02, 0.15))
    side = np.sin(bend) * (1.0 if elbow == "down" else -1.0)
    return side > BENT and x * np.cos(joint[0]) + y * np.sin(joint[0]) > BENT


@given(joint=angles(), elbow=st.sampled_from(["down", "up"]), name=st.sampled_from(sorted(ARMS)))
@example(joint=np.array([0.0, -1.0, 1.5, -0.5, 0.0]), elbow="down", name="small")
@settings(max_examples=200, deadline=None, derandomize=True)
def test_inverse_undoes_the_forward_kinematics(joint, elbow, name):
    """Joint angles -> tip, pitch, roll -> the same joint angles, up to whole turns."""
    arm = ARMS[name]
    if not is_regular(arm, joint, elbow):
        return
    found = arm.inverse(arm.end_effector(joint), joint[1:4].sum(), roll=joint[4], elbow=elbow)
    np.testing.assert_allclose(np.exp(1j * found), np.exp(1j * joint), atol=INVERTED)


@given(
    x=st.floats(-0.35, 0.35), y=st.floats(-0.35, 0.35), z=st.floats(-0.3, 0.4), pitch=st.floats(-3.0, 3.0),
    roll=st.floats(-3.0, 3.0), elbow=st.sampled_from(["down", "up"]),
)  # fmt: skip
@example(x=2e-203, y=2e-203, z=-0.25, pitch=1.0, roll=0.0, elbow="down")
@settings(max_examples=200, deadline=None, derandomize=True)
def test_forward_undoes_the_inverse_kinematics(x, y, z, pitch, roll, elbow):
    """Wherever the arm reaches: tip, and the gripper's direction, by scipy."""
    p = ARM.from_base([x, y, z])
    joint = np.asarray(ARM.inverse(p, pitch, roll=roll, elbow=elbow))
    assert np.isfinite(joint).all()
    if not ARM.reachable(p, pitch, roll=roll, elbow=elbow):
        return
    _, turn, tip = chain(ARM, joint)
    np.testing.assert_allclose(tip, p, atol=INVERTED)
    across, along = np.asarray(ARM.to_base(p), dtype=float)[
        [1, 0]
    ]  # the mount's offset rounds the smallest x and y away
    heading = np.arctan2(across, along)
    ahead = ARM.base_axes @ [
        np.cos(pitch) * np.cos(heading),
        np.cos(pitch) * np.sin(heading),
        -np.sin(pitch),
    ]
    np.testing.assert_allclose(turn.apply([1.0, 0.0, 0.0]), ahead, atol=INVERTED)
    assert (joint >= LOWER).all()
    assert (joint <= UPPER).all()


def test_rates_are_the_derivative_of_the_inverse():
    rng = np.random.default_rng(4)
    checked = 0
    for arm in ARMS.values():
        for base in rng.uniform([0.15, -0.2, -0.05], [0.3, 0.2, 0.2], (20, 3)):
            p, velocity = np.asarray(arm.from_base(base)), rng.normal(size=3)
            pitch, pitch_rate, roll_rate = rng.uniform(-0.5, 0.5, 3)
            joint = np.asarray(arm.inverse(p, pitch))
            if not arm.reachable(p, pitch) or abs(np.sin(joint[2])) < 0.3:
                continue
            h = 1e-6
            ahead, behind = (
                np.asarray(arm.inverse(p + s * velocity, pitch + s * pitch_rate, roll=s * roll_rate))
                for s in (h, -h)
            )
            rates = arm.inverse_rates(joint, velocity, pitch_rate=pitch_rate, roll_rate=roll_rate)
            np.testing.assert_allclose(rates, (ahead - behind) / (2 * h), atol=DIFFERENCE)
            np.testing.assert_allclose(arm.jacobian(joint) @ rates, velocity, atol=1e-10)
            checked += 1
    assert checked >= 20


def test_nothing_breaks_out_of_reach_or_where_rates_are_infinite():
    far = np.asarray(ARM.inverse(ARM.from_base([1.0, 0.0, 0.05])))
    np.testing.assert_allclose(far, 0.0, atol=EXACT)  # stretched towards it
    assert not ARM.reachable(ARM.from_base([1.0, 0.0, 0.05]))
    assert ARM.reachable(ARM.from_base([0.409, 0.0, 0.05]))
    assert not ARM.reachable(ARM.from_base([0.411, 0.0, 0.05]))
    stretched = ARM.inverse_rates(np.zeros(5), [1.0, 0.3, 0.4])
    assert np.isfinite(stretched).all()
    assert stretched[1] == 0.0
    np.testing.assert_allclose(ARM.inverse(ARM.from_base([0.0, 0.0, 0.2]))[0], 0.0)
    slope = ca.SX.sym("p", 3)
    jacobian = ca.Function("f", [slope], [ca.jacobian(ARM.inverse(slope), slope)])
    inside = np.array(jacobian(ARM.from_base([0.28, 0.0, 0.105])))
    np.testing.assert_allclose(inside[:, 0], ARM.inverse_rates(ARM.home, [1.0, 0.0, 0.0]), atol=1e-11)


def circle(phase):
    """The paper's path with its derivative by the phase, in the base frame."""
    s, c = np.sin(phase), np.cos(phase)
    offsets = np.column_stack([s / 5**0.5, s / 1.25**0.5, c])
    return [0.28, 0.0, 0.105] + 0.1 * offsets, 0.1 * np.column_stack([c / 5**0.5, c / 1.25**0.5, -s])


def test_small_arm_flies_the_training_path():
    """Within limits of angle and, at 4.5 rad/s, of rate; all below the mount, as only a z axis down gives."""
    path, along = circle(np.linspace(0.0, 2.0 * np.pi, 200))
    points = [ARM.from_base(p) for p in path]
    ARM.check_reachable(points)
    assert max(p[2] for p in points) < ARM.mount[2]
    rates = [
        ARM.inverse_rates(ARM.inverse(p), ARM.base_axes @ (4.5 * speed))
        for p, speed in zip(points, along, strict=True)
    ]
    assert np.abs(rates).max() < 0.9 * ARM.rate_limits.min()
    np.testing.assert_allclose(ARM.end_effector(ARM.home), ARM.from_base([0.28, 0.0, 0.105]), atol=EXACT)
    upright = SerialArm(ARM.links, ARM.mount, base_axes=np.eye(3))
    assert min(upright.from_base(p)[2] for p in path) > ARM.mount[2]
    assert ARM.mass == pytest.approx(0.45)


def test_inverse_kinematics_as_a_sampled_block():
    def law(t, x, u, p):
        return {"last": u.point}, {"joint": ARM.inverse(u.point, 0.1)}

    zero = np.zeros(3)
    block = sampled_block(plant(law, states={"last": zero}, inputs={"point": zero}, dt=0.01), name="inverse")
    assert block.output_labels == [f"joint[{i}]" for i in range(5)]
    assert block.law is not None
    p = ARM.from_base([0.3, 0.05, 0.1])
    joint = np.array(block.law.output(0.0, zero, p, [])).ravel()
    np.testing.assert_allclose(joint, ARM.inverse(p, 0.1), atol=EXACT)


def test_arms_are_frozen():
    with pytest.raises(ValueError, match="read-only"):
        ARM.mount[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        ARM.links[0].inertia[0, 0] = 1.0
    mine = np.zeros(3)
    SerialArm(ARM.links, mine)
    mine[0] = 1.0  # the arm has a copy


BAD = [
    (lambda: Link((0, 0, 0), (1, 0, 0), **ROD), "axis: expected a direction"),
    (lambda: Link((0, 1), (1, 0, 0), **ROD), r"axis: expected shape \(3,\)"),
    (
        lambda: Link((0, 1, 0), (1, 0, 0), **(ROD | {"mass": 0.0})),
        "mass: expected a finite number > 0 kg, got 0",
    ),
    (
        lambda: Link((0, 1, 0), (1, 0, 0), **(ROD | {"inertia": (1, 1, -1)})),
        "symmetric and positive definite",
    ),
    (
        lambda: Link((0, 1, 0), (1, 0, 0), **(ROD | {"inertia": np.triu(np.ones((3, 3)))})),
        "symmetric and positive",
    ),
    (lambda: Link((0, 1, 0), (1, 0, 0), **(ROD | {"inertia": (1.0, 1.0, 2.1)})), "no rigid body has"),
    (
        lambda: Link((0, 1, 0), (1, 0, 0), **(ROD | {"inertia": (1.0, 1.0)})),
        "inertia: expected three moments",
    ),
    (
        lambda: Link((0, 1, 0), (1, 0, 0), **ROD, lower=1.0, upper=0.5),
        "expected lower < upper in rad, got 1.0 and 0.5",
    ),
    (lambda: Link((0, 1, 0), (1, 0, 0), **ROD, rate_limit=0.0), "rate_limit: expected a finite number > 0"),
    (lambda: SerialArm([]), "links: expected at least one Link"),
    (lambda: SerialArm(rods(), [0.0, np.nan, 0.0]), "mount: expected finite"),
    (lambda: SerialArm(rods(), base_axes=np.diag([1.0, 1.0, -1.0])), "base_axes: expected a rotation"),
    (lambda: SerialArm(rods(), home=[0, 4, 0, 0, 0]), "home: joint 1 is at 4 rad, expected -3.142 to 3.142"),
    (lambda: ARM.motion(np.zeros(4)), r"joint: expected shape \(5,\)"),
    (lambda: ARM.motion(ca.SX.sym("q", 4)), r"joint: expected a column of 5, got shape \(4, 1\)"),
    (lambda: ARM.inverse([0.3, 0.0, 0.0], elbow="left"), "elbow: expected 'down' or 'up', got 'left'"),
    (lambda: SerialArm(rods(4)).inverse([0.3, 0.0, 0.0]), "are for five joints.*got 4 joints"),
    (lambda: SerialArm(rods(axis=(1, 0, 0), at=2)).inverse([0.3, 0.0, 0.0]), "for joint 2, expected"),
    (
        lambda: SerialArm(rods(offset=(0.1, 0.1, 0), at=1)).inverse([0.3, 0.0, 0.0]),
        "for link 1, expected in the x-z",
    ),
    (
        lambda: SerialArm(rods(offset=(0.1, 0.0, 0.1), at=3)).inverse([0.3, 0.0, 0.0]),
        "for link 3, expected along x",
    ),
    (lambda: SerialArm(rods(offset=(0, 0, 0), at=2)).inverse([0.3, 0.0, 0.0]), "forearm of some length"),
    (
        lambda: ARM.check_reachable([[0.3, 0.0, -0.1], [0.7, 0.0, 0.0]]),
        r"points\[1\] = \[0.7, 0.0, 0.0\] m.*the wrist would be 0.5\d\d m from the shoulder, expected 0.010 to 0.310",
    ),
    (
        lambda: ARM.check_reachable([[-0.2, 0.0, -0.1]]),
        "joint 0 would be at 3.142 rad, expected -2.600 to 2.600",
    ),
    (lambda: ARM.check_reachable([0.3, 0.0, -0.1]), r"points: expected shape \(N, 3\)"),
]


@pytest.mark.parametrize(("make", "message"), BAD)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
