"""The humanoid: statics, regulator, estimate and trials."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from phyfilter_ctl import models

mujoco = pytest.importorskip("mujoco", reason="needs the extra mujoco")
pytest.importorskip("dm_control", reason="needs the extra mujoco")

ROOM = f"{models.__name__}.humanoid"
limits = importlib.import_module(f"{ROOM}.limits")
params = importlib.import_module(f"{ROOM}.params")
picture = importlib.import_module(f"{ROOM}.picture")
posture = importlib.import_module(f"{ROOM}.posture")
regulator = importlib.import_module(f"{ROOM}.regulator")
robot = importlib.import_module(f"{ROOM}.robot")
trial = importlib.import_module(f"{ROOM}.trial")

# N: least squares stop at a cost that leaves this on the base.
BALANCED = 0.05
# N, of 20: the twin's feet push back otherwise than the robot's, see the model's page.
ESTIMATED = 1.0


@pytest.fixture(scope="module")
def humanoid():
    """With dm_control's own contacts."""
    return robot.load(friction="pyramidal")


@pytest.fixture(scope="module")
def points(humanoid):
    """Set-points of the normal stance at -30, 0 and 30 N."""
    return regulator.schedule(humanoid, "normal", largest=30.0, spacing=30.0)


@pytest.fixture(scope="module")
def far(humanoid):
    """Set-points of the normal stance to 90 N."""
    return regulator.schedule(humanoid, "normal", largest=90.0, spacing=30.0)


def test_mass_and_motors(humanoid):
    assert humanoid.mass == pytest.approx(40.84, abs=0.01)
    assert humanoid.nv == 27
    assert len(humanoid.motor_dof) == 21
    assert humanoid.torque[:6].tolist() == [0.0] * 6
    assert robot.load(2.0).torque.tolist() == (2.0 * humanoid.torque).tolist()


@pytest.mark.parametrize("name", params.STANCES)
def test_stances_stand_flat_and_balanced(humanoid, name):
    """Forces and moments about the origin by hand: weight at the centre of mass, feet, nothing else."""
    found = posture.stand(humanoid, name)
    assert found.feet[..., 2] == pytest.approx(0.0, abs=1e-4)
    assert np.abs(found.control).max() < params.params().statics.torque_share
    loads = found.corner_forces.reshape(-1, 3)
    weight = np.array([0.0, 0.0, -humanoid.weight])
    np.testing.assert_allclose(loads.sum(axis=0) + weight, 0.0, atol=BALANCED)
    moment = np.cross(found.feet.reshape(-1, 3), loads).sum(axis=0) + np.cross(found.centre, weight)
    np.testing.assert_allclose(moment, 0.0, atol=BALANCED)
    assert np.all(loads[:, 2] > 0.0)


def test_wider_stances_tip_later(humanoid):
    tips = [posture.tipping_force(humanoid, posture.stand(humanoid, name), 1.0) for name in params.STANCES]
    assert tips[0] < tips[1] < tips[2]
    assert tips[0] == pytest.approx(39.0, abs=1.0)


def test_tipping_force_by_hand(humanoid):
    """The outer edge of the right foot runs from heel to toe; at the centre of mass it lies in between."""
    found = posture.stand(humanoid, "normal")
    (heel, toe), x = found.feet[0, :2, :2], found.centre[0]
    edge = heel[1] + (toe[1] - heel[1]) * (x - heel[0]) / (toe[0] - heel[0])
    expected = humanoid.weight * (found.centre[1] - edge) / found.hand[2]
    assert posture.tipping_force(humanoid, found, -1.0) == pytest.approx(expected, rel=1e-9)
    forwards = humanoid.weight * (found.feet[..., 0].max() - x) / found.hand[2]
    assert posture.tipping_force(humanoid, found, heading=0.0) == pytest.approx(forwards, rel=1e-3)


def test_posture_leans_into_the_force(humanoid, far):
    """Moments about x by hand: with 90 N at the hand the centre of pressure is still under the feet."""
    leaning = far.points[-1].posture
    assert leaning.unbalanced < BALANCED
    assert leaning.centre[1] < -0.1
    pressure = leaning.centre[1] + leaning.force[1] * leaning.hand[2] / humanoid.weight
    assert leaning.feet[..., 1].min() < pressure < leaning.feet[..., 1].max()
    assert leaning.force[1] > posture.tipping_force(humanoid, far.upright.posture, 1.0)


def test_posture_does_not_move_in_the_simulator(humanoid, far):
    """The leaning set-point under its force, regulated: an independent check of the statics."""
    point, data = far.points[-1], humanoid.data()
    data.qpos[:] = point.q
    data.xfrc_applied[humanoid.hand, :3] = point.posture.force
    for _ in range(400):
        change = humanoid.difference(point.q, data.qpos)
        data.ctrl[:] = point.posture.control - point.K @ np.concatenate([change, data.qvel])
        humanoid.mujoco.mj_step(humanoid.model, data)
    relative = data.qpos[7:] - point.q[7:]
    assert np.abs(relative).max() < 0.1  # rad; the feet creep by centimetres meanwhile


def test_lqr_is_scipys():
    rng = np.random.default_rng(1)
    A, B = np.eye(5) + 0.1 * rng.standard_normal((5, 5)), rng.standard_normal((5, 2))
    Q, R = np.eye(5), 2.0 * np.eye(2)
    P = solve_discrete_are(A, B, Q, R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(regulator.lqr(A, B, Q, R), expected, rtol=1e-9, atol=1e-12)


def test_set_points_are_interpolated(humanoid, points):
    q, control, K = points.at(humanoid, (0.0, 15.0))
    low, high = points.points[1], points.points[2]
    np.testing.assert_allclose(q[7:], 0.5 * (low.q[7:] + high.q[7:]), atol=1e-12)
    np.testing.assert_allclose(control, 0.5 * (low.posture.control + high.posture.control), atol=1e-12)
    np.testing.assert_allclose(K, 0.5 * (low.K + high.K), atol=1e-9)
    np.testing.assert_array_equal(points.at(humanoid, (7.0, 99.0))[0], points.at(humanoid, (0.0, 30.0))[0])


@pytest.mark.parametrize("force", [20.0, -20.0])
def test_force_is_estimated(humanoid, points, force):
    found = trial.run(humanoid, points, force, filter=trial.phyfilter(20.0), noise=0.0, duration=4.0)
    assert found.held
    assert abs(limits.mean_estimate(found) - force) < ESTIMATED
    before = found.time < 0.9
    assert np.abs(found.f_hat[before]).max() < 1e-6  # the twin is the robot while nothing pulls


def test_ninety_newtons_that_rise_are_stood_with_the_filter_only(humanoid, far):
    options = {
        "rise": params.params().trial.rise,
        "duration": 6.0,
        "noise": 0.0,
        "filter": trial.phyfilter(20.0),
    }
    alone = trial.run(humanoid, far, 90.0, mode="alone", **options)
    off_the_motors = trial.run(humanoid, far, 90.0, mode="torque", **options)
    filtered = trial.run(humanoid, far, 90.0, **options)
    assert not alone.stood
    assert not off_the_motors.stood
    assert filtered.stood
    assert filtered.centre[-1, 1] < -0.1


def test_sudden_ninety_newtons_are_not_held_in_the_normal_stance(humanoid, far):
    assert not trial.run(humanoid, far, 90.0, noise=0.0, filter=trial.phyfilter(20.0), duration=10.0).held


@pytest.mark.slow
def test_wider_stance_holds_ninety_newtons_on_feet_that_do_not_creep():
    """As ``run humanoid`` by default: elliptic cones and noise; a test seed, 20 s for its minute."""
    firm, rules = robot.load(), params.params().trial
    wider = regulator.schedule(firm, "wider", largest=90.0)
    options = {"rise": rules.rise, "seed": rules.test_seeds[0], "duration": 20.0}
    alone, filtered = (trial.run(firm, wider, 90.0, mode=mode, **options) for mode in ("alone", "filter"))
    assert not alone.held
    assert filtered.held
    assert filtered.slide < 0.03


def test_elliptic_cones_hold_the_feet(humanoid, points):
    """A soft contact creeps in proportion to 1/impratio; a factor of 2 for the other cone."""
    firm, rules = robot.load(friction="elliptic"), params.params()
    again = regulator.schedule(firm, "normal", largest=30.0, spacing=30.0)
    creeping, held = (
        trial.run(
            one, law, 20.0, rise=rules.trial.rise, duration=4.0, noise=0.0, filter=trial.phyfilter(20.0)
        )
        for one, law in ((humanoid, points), (firm, again))
    )
    assert held.held
    assert held.slide < 2.0 * creeping.slide / rules.contacts.impratio


def test_a_force_is_not_held_by_feet_that_slide(humanoid, points):
    """Pyramidal cones creep: the robot stands, at another place than it stood."""
    crept = trial.run(humanoid, points, 20.0, duration=20.0, noise=0.0, filter=trial.phyfilter(20.0))
    assert crept.stood
    assert crept.slide > params.params().trial.slide
    assert not crept.held


def test_bisection_brackets_the_limit(humanoid, far):
    force, capped = limits.largest_force(humanoid, far, 1.0, mode="alone", duration=4.0, seeds=(0,))
    step = params.params().trial.resolution
    assert not capped
    assert trial.run(humanoid, far, force, mode="alone", duration=4.0).held
    assert not trial.run(humanoid, far, force + step, mode="alone", duration=4.0).held


def test_trials_repeat_themselves_noise_included(humanoid, points):
    one, other = (trial.run(humanoid, points, 10.0, noise=0.01, duration=2.0) for _ in range(2))
    np.testing.assert_array_equal(one.f_hat, other.f_hat)
    assert not np.array_equal(
        one.f_hat, trial.run(humanoid, points, 10.0, noise=0.01, seed=1, duration=2.0).f_hat
    )


def test_held_force_is_held_with_every_seed(humanoid, points, monkeypatch):
    """One seed holds to 25 N, another to 10 N."""
    holds = {3: 25.0, 4: 10.0}

    def run(humanoid, points, force, *, seed, **options):
        return SimpleNamespace(held=abs(force) <= holds[seed])

    monkeypatch.setattr(limits, "run", run)
    assert limits.largest_force(humanoid, points, -1.0, seeds=(3,)) == (25.0, False)
    assert limits.largest_force(humanoid, points, -1.0, seeds=(3, 4)) == (10.0, False)
    holds[4] = holds[3] = 99.0
    assert limits.largest_force(humanoid, points, -1.0, seeds=(3, 4)) == (30.0, True)


def test_told_force_moves_the_target(humanoid, points):
    """The limit of an estimate: no filter runs, and the body leans into the force at once."""
    told = trial.run(humanoid, points, 20.0, mode="told", noise=0.0, duration=3.0)
    alone = trial.run(humanoid, points, 20.0, mode="alone", noise=0.0, duration=3.0)
    assert not told.f_hat.any()
    assert told.centre[-1, 1] < alone.centre[-1, 1] - 0.01


def test_linearised_loop_leans_against_the_force(humanoid):
    loop = models.load("humanoid").build()
    assert loop.dt == pytest.approx(0.005)
    assert loop.ninputs == 2
    push = np.linalg.matrix_power(loop.A, 100) @ loop.B[:, 0]
    assert float((loop.C @ push)[0]) > 0.0


def test_animation_without_opengl(humanoid, points, tmp_path, monkeypatch):
    found = trial.run(humanoid, points, 0.0, mode="alone", duration=0.3)
    image = picture._drawn_skeleton(humanoid, found.q[0])
    assert image.shape[2] == 3
    assert image.std() > 1.0
    target = tmp_path / "a.gif"
    assert picture.animate(humanoid, {"alone": found}, str(target)) in ("MuJoCo", "Matplotlib")
    assert target.read_bytes()[:4] == b"GIF8"


def test_wrong_arguments_say_so(humanoid, points):
    with pytest.raises(ValueError, match="force: expected three finite"):
        posture.stand(humanoid, "normal", (0.0, np.inf, 0.0))
    with pytest.raises(ValueError, match="force: expected a finite force"):
        trial.run(humanoid, points, np.nan)
    with pytest.raises(ValueError, match="mode: expected one of alone, filter, torque"):
        trial.run(humanoid, points, 1.0, mode="both")
    with pytest.raises(ValueError, match="expected rise, noise >= 0"):
        trial.run(humanoid, points, 1.0, rise=-1.0)
    with pytest.raises(ValueError, match="friction: expected one of pyramidal, elliptic"):
        robot.load(friction="dry")
    with pytest.raises(ValueError, match="0 < spacing <= largest"):
        regulator.schedule(humanoid, "normal", largest=10.0, spacing=20.0)
