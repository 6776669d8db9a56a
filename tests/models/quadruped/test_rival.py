"""The adaptive rival by other routes, the walks it is tuned on, and the tiles of the curriculum."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest
from scipy.signal import lfilter

from phyfilter_ctl import PhyFilter, models
from phyfilter_ctl.cli import main

ROOM = f"{models.__name__}.quadruped"
adaptive = importlib.import_module(f"{ROOM}.adaptive")
params = importlib.import_module(f"{ROOM}.params")
robot = importlib.import_module(f"{ROOM}.robot")
terrain = importlib.import_module(f"{ROOM}.terrain")

P = params.params("go1")
H, KD, DAMPING = P.control.dt, P.control.kd, P.robot.damping
M = robot.joint_inertia(P)
# Of f_hat: the same recursion by other arithmetic.
ROUNDING = 1e-11


def run(choice: object, qd: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """f_hat for joint velocities (N + 1, 12) and the torques (N, 12) between them."""
    law = adaptive.AdaptiveLaw(choice, parameters=P)
    state, found = law.start(qd[0]), []
    for k, tau in enumerate(torque):
        state, f_hat = law.step(state, qd[k + 1], tau)
        found.append(f_hat)
    return np.array(found)


def signals(steps: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return np.cumsum(rng.normal(0.0, 0.1, (steps + 1, 12)), axis=0), rng.normal(0.0, 3.0, (steps, 12))


def test_without_contact_it_is_a_filter_of_second_order():
    choice = adaptive.AdaptiveChoice(2.0, corner=15.0, contact=False)
    qd, torque = signals(400)
    found = run(choice, qd, torque)
    u = M * np.diff(qd, axis=0) / H + 0.5 * DAMPING * (qd[1:] + qd[:-1]) - torque
    twice = u
    for pole in (15.0, 2.0):
        decay = np.exp(-pole * H)
        twice = lfilter([1.0 - decay], [1.0, -decay], twice, axis=0)
    assert found == pytest.approx(twice, abs=ROUNDING)
    # Against the continuous filter's unit step: no more than a sample early.
    still = run(choice, np.zeros((401, 12)), -np.ones((400, 12)))[:, 0]
    t = H * np.arange(1, 401)
    step = 1.0 - (15.0 * np.exp(-2.0 * t) - 2.0 * np.exp(-15.0 * t)) / 13.0
    assert sorted(PhyFilter((30.0, 17.0)).poles.real.round(9)) == [-15.0, -2.0]
    early = still - step
    assert np.all((early > -ROUNDING) & (early < np.max(np.diff(step))))


def test_contact_is_what_follows_the_tracking_error():
    """Joints that obey the model: the disturbance is found beside a contact of many times its size.

    The rates move little, their part of theta is the last to come.
    """
    choice = adaptive.AdaptiveChoice(8.0, corner=60.0)
    rng = np.random.default_rng(2)
    f, by_error, by_rate = 3.0, 0.6, 0.3
    law = adaptive.AdaptiveLaw(choice, parameters=P)
    qd, f_hat = np.zeros(12), np.zeros(12)
    state = law.start(qd)
    wanted = lfilter([0.1], [1.0, -0.9], rng.normal(0.0, 100.0, (2000, 12)), axis=0)
    for stiff in wanted:
        torque = stiff - KD * qd - f_hat
        push = f + by_error * stiff - by_rate * KD * qd
        # Trapezoidal, as the law measures it.
        rate = M / H + 0.5 * DAMPING
        after = ((M / H - 0.5 * DAMPING) * qd + torque + push) / rate
        state, f_hat = law.step(state, after, torque)
        qd = after
    assert f_hat == pytest.approx(np.full(12, f), abs=0.05)
    assert state.theta[..., :2] / 10.0 == pytest.approx(np.tile([by_error, by_rate], (12, 1)), abs=0.1)


def test_limit_leak_and_tracking():
    still, held = np.zeros((801, 12)), np.full((800, 12), -5.0)
    limited = run(adaptive.AdaptiveChoice(3.0, limit=4.0, contact=False), still, held)
    assert np.max(np.abs(limited)) == 4.0
    leaking = run(adaptive.AdaptiveChoice(3.0, leak=1.0, contact=False), still, held)[-1, 0]
    gain, kept = 1.0 - np.exp(-3.0 * H), np.exp(-H)
    assert leaking == pytest.approx(5.0 * gain / (1.0 - kept + gain), rel=1e-6)
    quick = adaptive.AdaptiveChoice(1.0, mix=1.0, contact=False)
    plain = adaptive.AdaptiveChoice(1.0, contact=False)
    assert run(quick, still, held)[40, 0] > 1.5 * run(plain, still, held)[40, 0], "the tracking error helps"
    for wrong in ({"rate": 0.0}, {"rate": 1.0, "leak": -1.0}, {"rate": 1.0, "limit": np.inf}):
        with pytest.raises(ValueError, match="expected"):
            adaptive.AdaptiveChoice(**wrong)


def test_tiles_rise_by_level_and_are_flat_where_robots_start():
    ground = terrain.Terrain("tiles", 1.0)
    levels, columns = np.meshgrid(np.arange(terrain.LEVELS), np.arange(len(terrain.COLUMNS)), indexing="ij")
    middle = terrain.tile_centre(levels, columns)
    assert ground.height(*(middle - [terrain.HALF_TILE, 0.0]).reshape(-1, 2).T) == pytest.approx(
        0.0, abs=1e-9
    )
    for dx in (-0.3, 0.3):
        same = ground.height(middle[..., 0] + dx, middle[..., 1]) - ground.height(*np.moveaxis(middle, -1, 0))
        assert same == pytest.approx(0.0, abs=1e-9)
    slope = terrain.COLUMNS.index("slope")
    depth = -ground.height(*middle[:, slope].T)
    wanted = np.tan(np.radians(20.0 * np.arange(1, terrain.LEVELS + 1) / terrain.LEVELS))
    assert depth == pytest.approx(wanted * (terrain.HALF_TILE - 0.5), abs=1e-5)
    stairs = -ground.height(*middle[:, terrain.COLUMNS.index("stairs")].T)
    risers = 0.01 + 0.05 * np.arange(1, terrain.LEVELS + 1) / terrain.LEVELS
    assert stairs / risers == pytest.approx(np.full(terrain.LEVELS, 7.0))


def test_grounds_side_by_side_are_those_alone():
    beside, x = terrain.Terrain("rough", 0.5, 3, count=2), np.linspace(0.0, 8.0, 30)
    for k in range(2):
        alone = terrain.Terrain("rough", 0.5, 3 + k).height(x, 0.7)
        assert beside.height(x, 0.7 + k * terrain.LANE) == pytest.approx(alone, abs=1e-12)
    with pytest.raises(ValueError, match="side by side, got 2 of slope"):
        terrain.Terrain("slope", 0.5, count=2)


@pytest.mark.slow
def test_robots_climb_where_they_arrive_and_go_down_where_they_fall():
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")
    environment = importlib.import_module(f"{ROOM}.environment")
    walk = environment.Walk(6, None, seed=0, parameters=P, curriculum=True, threads=1)
    walk.level[:] = [1, 1, 0, 2, 2, terrain.LEVELS - 1]
    walk._restart(np.arange(6))
    place = walk.batch.qpos[:, :2]
    assert place == pytest.approx(terrain.tile_centre(walk.level, walk._column))
    assert walk._above(walk.batch.motion) == pytest.approx(np.full(6, P.gait.height + P.robot.foot_radius))
    walk.batch._qpos[[0, 5], 0] += 1.01 * terrain.HALF_TILE
    walk.batch._qpos[[1, 2], 2] -= 0.25
    step = walk.step(np.zeros((6, 12)))
    assert step.done.tolist() == [True, True, True, False, False, True]
    assert step.timeout.tolist() == [True, False, False, False, False, True]
    assert walk.level.tolist()[:5] == [2, 0, 0, 2, 2]
    assert 0 <= walk.level[5] < terrain.LEVELS
    again = environment.Walk(6, None, seed=5, parameters=P, curriculum=True, threads=1)
    again.restore(walk.state())
    assert again.level.tolist() == walk.level.tolist()
    assert np.array_equal(
        again.step(np.zeros((6, 12))).observations, walk.step(np.zeros((6, 12))).observations
    )


def test_tuning_walks_on_nothing_that_is_judged():
    robustness, tuning = (importlib.import_module(f"{ROOM}.{name}") for name in ("robustness", "tuning"))
    judged = {(entry.case, entry.ground) for entry in robustness.conditions("go1")}
    assert not judged & {(entry.case, entry.ground) for entry in tuning.conditions("go1")}
    assert len(tuning.FILTERS) == len(tuning.RIVALS)
    methods = importlib.import_module(f"{ROOM}.methods")
    assert methods.TUNED in tuning.FILTERS.values()
    assert methods.RIVAL in tuning.RIVALS.values()


@pytest.mark.release
def test_command_prints_the_variants(tmp_path, capsys):
    pytest.importorskip("mujoco", reason="mujoco is not installed: nothing walks")
    policy = importlib.import_module(f"{ROOM}.policy")
    layers = ((np.zeros((12, 47)), np.zeros(12)),)
    policy.save(policy.Policy(layers, "go1", {"seed": 0, "steps": 10}), tmp_path / "base-0.json")
    target = tmp_path / "figures.json"
    command = [
        "run",
        "quadruped",
        "--tune",
        "--policies",
        str(tmp_path),
        "--quick",
        "--quiet",
        "--threads",
        "1",
    ]
    assert main([*command, "--json", str(target)]) == 0
    assert " *" in capsys.readouterr().out
    variants = json.loads(target.read_text())["variants"]
    assert all(0.0 < row["score"] < 1.5 for row in variants.values())
