"""The Berkeley Humanoid: its numbers, forces at any point of a body, statics, trials, and the command line."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

from phyfilter_ctl import models
from phyfilter_ctl.cli import main
from phyfilter_ctl.study import Executor

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")

ROOM = f"{models.__name__}.humanoid"
around = importlib.import_module(f"{ROOM}.around")
limits = importlib.import_module(f"{ROOM}.limits")
picture = importlib.import_module(f"{ROOM}.picture")
posture = importlib.import_module(f"{ROOM}.posture")
regulator = importlib.import_module(f"{ROOM}.regulator")
robot = importlib.import_module(f"{ROOM}.robot")
trial = importlib.import_module(f"{ROOM}.trial")

# N and N m: least squares stop at a cost that leaves this on the base.
BALANCED = 0.05


@pytest.fixture(scope="module")
def humanoid():
    return robot.load(robot="berkeley")


@pytest.fixture(scope="module")
def points(humanoid):
    """Set-points from -40 to 40 N forwards and -20 to 20 N to the left."""
    return regulator.schedule(humanoid, "normal", largest=20.0)


def test_mass_motors_and_dry_friction(humanoid):
    """As Hybrid Robotics' description has them; no mesh is needed."""
    assert humanoid.mass == pytest.approx(16.06, abs=0.01)
    assert humanoid.torque[6:].tolist() == 2 * [20.0, 20.0, 30.0, 30.0, 20.0, 5.0]
    assert humanoid.model.dof_frictionloss[6:].tolist() == 2 * [0.3, 0.3, 0.3, 0.8, 1.0, 0.1]
    assert humanoid.model.nmesh == 0
    assert robot.load(2.0, robot="berkeley").torque.tolist() == (2.0 * humanoid.torque).tolist()


def test_a_force_beside_the_centre_of_mass_turns_the_body(humanoid):
    """What MuJoCo makes of force and torque on the body is J' F at the point."""
    data = humanoid.data()
    data.qpos[:] = humanoid.model.key("home").qpos
    data.qpos[3:7] = [0.9, 0.1, -0.3, 0.3]
    humanoid.mujoco.mj_forward(humanoid.model, data)
    before, force = data.qfrc_smooth.copy(), [3.0, -7.0, 1.0]
    humanoid.pull(data, force)
    humanoid.mujoco.mj_forward(humanoid.model, data)
    np.testing.assert_allclose(data.qfrc_smooth - before, humanoid.hand_jacobian(data).T @ force, atol=1e-12)


@pytest.mark.slow
def test_posture_under_a_skew_force_is_balanced(humanoid):
    """Forces and moments about the origin by hand: weight, feet and the force at the torso."""
    force = np.array([15.0, -20.0, 0.0])
    found = posture.stand(humanoid, "normal", tuple(force), start=posture.stand(humanoid, "normal"))
    loads, weight = found.corner_forces.reshape(-1, 3), np.array([0.0, 0.0, -humanoid.weight])
    np.testing.assert_allclose(loads.sum(axis=0) + weight + force, 0.0, atol=BALANCED)
    moment = np.cross(found.feet.reshape(-1, 3), loads).sum(axis=0) + np.cross(found.centre, weight)
    np.testing.assert_allclose(moment + np.cross(found.hand, force), 0.0, atol=BALANCED)
    assert found.hand[2] > 0.7


@pytest.mark.slow
def test_slow_force_to_the_front_needs_the_lean(humanoid, points):
    """Beyond where the upright body tips; f_hat off the motors is no help, the moved target is."""
    tips = posture.tipping_force(humanoid, points.upright.posture, heading=0.0)
    force = 1.5 * tips
    options = {"heading": 0.0, "rise": 2.0, "duration": 12.0, "seed": 100}
    held = {mode: trial.run(humanoid, points, force, mode=mode, **options) for mode in around.ANSWERS}
    assert {mode: found.held for mode, found in held.items()} == {
        "alone": False,
        "torque": False,
        "filter": True,
        "told": True,
    }
    assert held["filter"].centre[-1, 0] < held["filter"].centre[0, 0] - 0.02
    assert limits.mean_estimate(held["filter"]) == pytest.approx(force, rel=0.2)


def test_set_points_are_bilinear(humanoid):
    """Numbers in the places of postures: the weights of the four neighbours."""
    home = humanoid.model.key("home").qpos
    rows = [_point(home, x, y) for x in (0.0, 10.0) for y in (-20.0, 0.0, 20.0)]
    law = regulator.Schedule("normal", np.array([0.0, 10.0]), np.array([-20.0, 0.0, 20.0]), tuple(rows))
    q, control, K = law.at(humanoid, (2.5, -5.0))
    assert control.tolist() == [2.5, -5.0]
    assert K.tolist() == [[2.5 - 5.0]]
    assert q[0] - home[0] == pytest.approx(2.5)
    assert q[1] - home[1] == pytest.approx(-5.0)
    assert law.at(humanoid, (99.0, -99.0))[1].tolist() == [10.0, -20.0]
    assert law.reach(90.0) == 20.0
    assert law.reach(45.0) == pytest.approx(10.0 * np.sqrt(2.0))


def _point(home, x, y):
    q = home.copy()
    q[:2] += [x, y]
    still = posture.Posture(
        q, np.array([x, y]), (x, y, 0.0), np.zeros(0), np.zeros(0), 0.0, np.zeros(3), np.zeros(3), np.zeros(0)
    )
    return regulator.SetPoint(still, q, np.array([[x + y]]), np.zeros(0), np.zeros(0))


@pytest.mark.release
@pytest.mark.usefixtures("flawless")
def test_command_line(tmp_path, capsys):
    figures, drawn = tmp_path / "f.json", tmp_path / "p.png"
    arguments = ["run", "humanoid", "--robot", "berkeley", "--quick", "--profiles", "slow", "--duration", "5"]
    arguments += ["--json", str(figures), "--picture", str(drawn), "--quiet", "--workers", "1"]
    assert main(arguments) == 0
    printed, found = capsys.readouterr().out, json.loads(figures.read_text())
    assert "Berkeley Humanoid, 16.1 kg" in printed
    assert "trials of 5 s, elliptic friction cones, velocity noise 0.003, a0 = 3 rad/s" in printed
    assert drawn.stat().st_size > 10_000
    held = {
        (each["mode"], each["heading"]): each["force"]
        for each in found["largest_held_n"]
        if each["grip"] == "torso"
    }
    assert held["alone", "front"] < held["filter", "front"]


def test_names_that_do_not_exist(humanoid):
    with pytest.raises(ValueError, match="robot: expected one of suite, berkeley, got 'tin'"):
        robot.load(robot="tin")
    with pytest.raises(ValueError, match="grip: expected one of torso, pelvis, got 'hand'"):
        robot.load(robot="berkeley", grip="hand")
    with pytest.raises(ValueError, match=r"headings: expected some of front, .*, got up"):
        around.around(("torso",), ("up",), executor=Executor(1))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robot", "berkeley", "--study"], "--robot berkeley: it has no --study"),
        (["--robot", "berkeley", "--grips", "hand"], "grip: expected one of torso, pelvis"),
        (["--grips", "torso"], "--grips, --profiles: they are those of --robot berkeley"),
        (["--noise", "-1"], "--noise: expected 0 or more"),
        (["--noise", "0.01", "--study"], "--noise: the study has its own"),
    ],
)
def test_wrong_options_say_so(arguments, words, capsys):
    assert main(["run", "humanoid", *arguments]) == 2
    assert words in capsys.readouterr().err
