"""The aerial manipulator's study: references, diagram, features, training, scores, tuning, and the command line."""

from __future__ import annotations

import importlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import flatten, models, simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.controllers import arm_controller
from phyfilter_ctl.plants import allocation_matrix, coupling_force, coupling_torque, rotate, rotate_back
from phyfilter_ctl.study import median_interval
from tests.cpu_budget import slow_but
from tests.result_cells import row_of

pytestmark = pytest.mark.slow  # the default suite has other tests of the same code

ROOM = f"{models.__name__}.aerial_manipulator"
comparison = importlib.import_module(f"{ROOM}.comparison")
diagram = importlib.import_module(f"{ROOM}.diagram")
experiment = importlib.import_module(f"{ROOM}.experiment")
features = importlib.import_module(f"{ROOM}.features")
methods = importlib.import_module(f"{ROOM}.methods")
mission = importlib.import_module(f"{ROOM}.mission")
params = importlib.import_module(f"{ROOM}.params")
report = importlib.import_module(f"{ROOM}.report")
study = importlib.import_module(f"{ROOM}.study")
training = importlib.import_module(f"{ROOM}.training")
tuning = importlib.import_module(f"{ROOM}.tuning")
vehicle = importlib.import_module(f"{ROOM}.vehicle")

# Rounding of a few dozen operations.
ROUNDING = 1e-9
# m: Runge-Kutta at 2 ms against 1 ms over two seconds.
STEP = 1e-6
# Instants a sample where forces are integrated.
PARTS = 4
# m: limits of the workspace hold at the plan's instants; between them 2 m/s^2 bend the path by a h^2/8, h = 70 ms.
KEPT = 1.3e-3
# m/s and rad/s: the plan starts within the solver's 1e-7 m of where it is.
AT_REST = 1e-6
# N and N m: Milne's rule over 2 ms, and Runge-Kutta, with servos of 80 1/s.
MISSING = 2e-4
# The margin of a tuned method, found anew by another process.
SAME = 5e-4

OBSERVER = methods.Method("observer", 2.0, 4.0, 8.0)
SILENT = {
    f"vehicle.sensors.{name}": 0.0
    for name in ("position", "velocity", "attitude", "rate", "joint", "joint_rate")
}
STILL = {"vehicle.wind.jet_speed": 0.0}


def outputs(
    method: methods.Method,
    duration: float,
    given_: dict[str, object],
    step: float = 0.002,
    *,
    parts: int = 1,
    held: bool = False,
) -> dict[str, np.ndarray]:
    """The first part of a mission, without noise, at ``parts`` instants a sample; ``held``: the goal stays put."""
    flat = flatten(diagram.build(method))
    wanted = mission.reference().inputs()[:, : len(mission.timepts(duration))]
    if held:
        wanted = np.tile(wanted[:, :1], wanted.shape[1])
        wanted[3:12] = 0.0  # neither velocity nor acceleration nor jerk
    inputs = np.zeros((44, parts * (wanted.shape[1] - 1) + 1))
    inputs[:19] = np.repeat(wanted, parts, axis=1)[:, : inputs.shape[1]]
    time = np.arange(inputs.shape[1]) * params.params().sampling.dt / parts
    run = simulate(flat, time, inputs, experiment.start_state(), params={**method.parameters(), **SILENT, **given_},
                   method="rk4", max_step=step, interpolation="hold", backend="vm")  # fmt: skip
    assert run.success, run.message
    signals: dict[str, list[np.ndarray]] = {}
    for label, row in zip(run.output_labels, run.outputs, strict=True):
        signals.setdefault(label.split("[")[0], []).append(np.asarray(row))
    return {name: np.array(rows).T for name, rows in signals.items()}


@pytest.fixture(scope="module")
def approach() -> dict[str, np.ndarray]:
    """Three seconds of the approach with a load, in still air."""
    return outputs(OBSERVER, 3.0, {**STILL, "vehicle.load.held": 0.2}, parts=PARTS)


@pytest.mark.slow
def test_references_are_each_others_derivatives() -> None:
    goals, dt = mission.reference(), params.params().sampling.dt
    inner = slice(50, -50)
    for value, rate, most in (
        (goals.r, goals.v, 1e-5),
        (goals.v, goals.a, 5e-3),
        (goals.offset, goals.offset_rate, 1e-4),
    ):
        slope = np.gradient(value, dt, axis=0)
        np.testing.assert_allclose(slope[inner], rate[inner], rtol=0.0, atol=most)
    np.testing.assert_allclose(goals.a[0] + dt * goals.j[:-1].cumsum(axis=0), goals.a[1:], atol=ROUNDING)


def test_plan_is_on_the_spot_in_both_windows_and_keeps_its_limits() -> None:
    goals, values = mission.reference(), params.params()
    task = values.mission
    for window, place in ((task.grasp, task.pick), (task.settle, task.place)):
        inside = (goals.time >= window[0]) & (goals.time <= window[1])
        assert np.abs(goals.end_effector[inside] - place).max() < 2e-3
    assert set(goals.path.statuses) == {"optimal"}
    low, high = np.array(values.planner.workspace) + mission.arm().mount
    assert np.all(goals.offset >= low - KEPT)
    assert np.all(goals.offset <= high + KEPT)
    assert np.abs(goals.a).max() <= values.planner.platform_acceleration


def test_load_comes_after_the_first_window_and_goes_after_the_second() -> None:
    goals, values = mission.reference(), params.params().mission
    hangs = goals.taken > 0.0
    assert not hangs[goals.time <= values.grasp[1]].any()
    assert goals.taken[(goals.time >= values.settle[0]) & (goals.time <= values.settle[1])].min() == 1.0
    assert goals.taken[-1] == 0.0
    quick = mission.reference(mission.changed(transfer=0.2))
    assert np.ptp(goals.time[(quick.taken > 0.0) & (quick.taken < 1.0)][:95]) < 0.2


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"place": [9.0, 0.0, 1.0]}, "out of reach"),
        ({"payload": -0.1}, "payload: expected 0 kg or more"),
        ({"payload": 5.0}, "take a lighter load"),
        ({"transfer": -1.0}, "transfer: expected 0 s or more"),
    ],
)
def test_missions_that_cannot_be_flown_are_refused(change: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        mission.check(mission.changed(**change))


def test_times_out_of_order_are_refused() -> None:
    with pytest.raises(ValueError, match="times in order"):
        mission.check(replace(params.params().mission, load=7.5))


def test_force_and_torque_are_what_is_missing(approach: dict[str, np.ndarray]) -> None:
    """x_k - x_(k-1) = h times the means of g and f, for the force and for the torque.

    The means are Milne's rule, which needs the inner instants only: joint commands jump at the samples, and with them
    the force of the arm.
    """
    dt, mass, J = params.params().sampling.dt, vehicle.nominal().mass, np.array(vehicle.nominal().J)
    A = allocation_matrix(params.params().vehicle.rotor_arm, params.params().vehicle.torque_ratio)
    wrench = _rotors(approach["thrust"][::PARTS]) @ A.T
    drag, gravity = np.array(params.params().vehicle.drag), np.array([0.0, 0.0, 9.81])
    pairs = zip(approach["q"], approach["v"], wrench[:, 0], strict=True)
    known = np.array([rotate(q, [0.0, 0.0, T] - drag * rotate_back(q, v)) for q, v, T in pairs])
    force = known - mass * gravity + sum(approach[f"f_{what}"] for what in ("coupling", "payload", "wind"))
    omega = approach["omega"]
    torque = wrench[:, 1:] - np.cross(omega, J * omega) + approach["tau_coupling"] + approach["tau_payload"]
    for momentum, total in ((mass * approach["v"], force), (J * omega, torque)):
        rate = np.diff(momentum[::PARTS], axis=0) / dt
        inner = (total[part : len(total) - 1 : PARTS] for part in (1, 2, 3))
        mean = sum(weight * value for weight, value in zip((2.0, -1.0, 2.0), inner, strict=True)) / 3.0
        np.testing.assert_allclose(rate, mean, rtol=0.0, atol=MISSING)
    for name in ("f_coupling", "f_payload", "tau_coupling", "tau_payload"):
        assert np.abs(approach[name]).max() > 50.0 * MISSING  # one that was missing would show


def _rotors(commands: np.ndarray) -> np.ndarray:
    """Thrusts of the rotors behind delay and lag at all parts of the samples, exact for held commands."""
    dt, lag = params.params().sampling.dt, params.params().vehicle.motor_lag
    steps = vehicle.nominal().delay_steps(dt)
    level, most = vehicle.level_thrusts(), params.params().vehicle.rotor_max
    delayed = np.vstack([np.tile(level, (steps, 1)), commands])[: len(commands)]
    rotor, kept = [level], np.exp(-dt / PARTS / lag)
    for command in np.repeat(np.clip(delayed, 0.0, most)[:-1], PARTS, axis=0):
        rotor.append(kept * rotor[-1] + (1.0 - kept) * command)
    return np.array(rotor)


def test_it_stays_at_rest() -> None:
    """Level thrusts and the known trim hold platform and arm; nothing moves until the reference does."""
    found = outputs(methods.Method("baseline", 2.0), 0.4, STILL, held=True)
    assert np.abs(found["v"]).max() < AT_REST
    assert np.abs(found["omega"]).max() < AT_REST


def test_observer_finds_load_and_its_torque() -> None:
    found = outputs(OBSERVER, 0.9, {**STILL, "vehicle.load.held": 0.05})
    settled = slice(-25, None)
    assert np.abs(found["f_hat"][settled, 2] + 0.05 * 9.81).max() < 0.1
    true = found["tau_coupling"] + found["tau_payload"] - features.trim_torque()
    np.testing.assert_allclose(found["tau_hat"][settled], true[settled], atol=0.02)


@pytest.mark.slow
def test_integration_is_converged() -> None:
    coarse, fine = (outputs(OBSERVER, 2.0, {}, step)["r_e"] for step in (0.002, 0.001))
    assert np.abs(coarse - fine).max() < STEP


@given(yaw=st.floats(-1.0, 1.0), seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_seen_along_the_arm_the_coupling_does_not_know_the_heading(yaw: float, seed: int) -> None:
    """Hovering level, force and torque about the base depend on the base yaw by rotation alone."""
    arm, rng = mission.arm(), np.random.default_rng(seed)
    joint, rate, acceleration = arm.home.copy(), rng.normal(0.0, 0.5, 5), rng.normal(0.0, 2.0, 5)
    weight = np.array([0.0, 0.0, arm.mass * 9.81])

    def seen(angle: float) -> tuple[np.ndarray, np.ndarray]:
        joint[0] = angle
        motion = arm.motion(joint, rate, joint_acceleration=acceleration)
        at_rest = dict.fromkeys(("omega", "v_rate", "omega_rate"), np.zeros(3))
        at_rest["q"] = np.array([1.0, 0.0, 0.0, 0.0])
        force = np.asarray(coupling_force(motion, **at_rest)) + weight
        torque = np.asarray(coupling_torque(motion, **at_rest)) - np.cross(arm.mount, force - weight)
        outward = (arm.base_axes @ [np.cos(angle), np.sin(angle), 0.0])[:2]
        return tuple(np.asarray(features.along_arm(outward, part)) for part in (force, torque))

    for one, other in zip(seen(0.0), seen(yaw), strict=True):
        np.testing.assert_allclose(one, other, atol=ROUNDING)


def test_from_arm_is_the_inverse_of_along_arm() -> None:
    outward, vector = np.array([np.cos(0.7), np.sin(0.7)]), np.array([1.0, -2.0, 3.0])
    back = features.from_arm(outward, np.asarray(features.along_arm(outward, vector)))
    np.testing.assert_allclose(np.asarray(back), vector, atol=ROUNDING)


def test_training_path_is_the_papers() -> None:
    goals = training.circling(duration=6.0)
    arm, t = mission.arm(), goals.time
    base = np.array([np.asarray(arm.to_base(p)) for p in goals.offset])
    late = t >= 2.0
    phi = 2.5 * t + (4.5 - 2.5) * t**2 / (2.0 * 6.0)
    circle = np.column_stack([np.sin(phi) / 5**0.5, np.sin(phi) / 1.25**0.5, np.cos(phi)])
    wanted = np.array([0.28, 0.0, 0.105]) + 0.1 * circle
    np.testing.assert_allclose(base[late], wanted[late], atol=ROUNDING)
    slope = np.gradient(goals.offset, t, axis=0)
    np.testing.assert_allclose(slope[5:-5], goals.offset_rate[5:-5], atol=1e-4)


@pytest.fixture(scope="module")
def trained() -> training.Training:
    return training.train()


@pytest.mark.slow
def test_seer_learns_the_arm_and_errs_elsewhere(trained: training.Training) -> None:
    assert trained.chosen_torque.train < 0.1 * trained.label_torque
    assert trained.chosen_torque.held_out < 0.2 * trained.label_torque
    errors = training.off_distribution(trained)
    assert errors["path"]["torque"] == pytest.approx(trained.chosen_torque.train, rel=0.1)
    assert errors["faster"]["force"] > 2.0 * errors["path"]["force"]
    assert errors["wind"]["torque"] > 2.0 * errors["path"]["torque"]
    assert all(fit.held_out >= trained.chosen_force.held_out for fit in trained.force)


def test_seeds_are_apart() -> None:
    values = params.params()
    groups = [set(values.training.train), set(values.training.held_out), set(values.tuning.seeds)]
    groups.append(set(range(values.test.seeds)))
    assert sum(len(group) for group in groups) == len(set.union(*groups))


def cell(label: str, method: str) -> list[float]:
    """Numbers of a cell of the results: median, worst, and how many of 20 were within the tolerance."""
    return [
        float(v) for v in re.findall(r"[0-9.]+", row_of("**The aerial manipulator** (`run", label)[method])
    ]


@pytest.mark.parametrize("name", slow_but(("baseline", "observer"), methods.METHODS))
def test_every_method_is_tuned_and_flies(name: str, request: pytest.FixtureRequest) -> None:
    entry = tuning.tuned()[name]
    assert entry.modulus_margin >= params.params().tuning.modulus_margin
    assert entry.jitter <= params.params().tuning.jitter
    assert entry.interior
    learned = name in ("seer", "phyfilter")
    flown = experiment.fly(entry.method, (320,), request.getfixturevalue("trained").seer if learned else None)
    assert not flown.message
    assert flown.score().largest.max() < 0.6
    if name == "baseline":  # whose missions hardly differ: the results' cell, to the spread of its twenty
        median, worst = cell("grasp window", "PD")[:2]
        assert abs(100.0 * flown.score().grasp[0] - median) <= 2.0 * (worst - median)


def test_no_optimum_is_on_the_edge_of_what_was_tried() -> None:
    values = params.params().tuning
    for entry in tuning.tuned().values():
        method = entry.method
        force = values.integral if method.name == "integral" else values.force
        assert entry.interior
        assert not method.bandwidth or force[0] < method.bandwidth < force[1]
        assert not method.torque_bandwidth or values.torque[0] < method.torque_bandwidth < values.torque[1]


@pytest.mark.slow
def test_result_cells_of_the_observer_hold() -> None:
    """The 20 missions of the command: within the interval of the median, and as many within the tolerance."""
    score = experiment.fly(tuning.tuned()["observer"].method, tuple(range(20)), None).score()
    for label, values, passed in (
        ("grasp window", score.grasp, score.grasped),
        ("place window", score.settle, score.placed),
    ):
        median, worst, count = cell(label, "observer")
        interval = median_interval(100.0 * values)
        assert interval.low - 0.05 <= median <= interval.high + 0.05  # the cell has one digit
        assert worst == pytest.approx(100.0 * values.max(), rel=0.1)
        assert abs(passed.sum() - count) <= 1


@pytest.mark.slow
def test_tuned_methods_have_their_margin() -> None:
    entry = tuning.tuned()["observer"]
    found = tuning.modulus_margin(entry.method)
    assert found == pytest.approx(entry.modulus_margin, abs=SAME)


@pytest.mark.slow
def test_phyfilter_beats_the_baseline_and_grasps(trained: training.Training) -> None:
    entries = tuning.tuned()
    ours, theirs = (
        experiment.fly(entries[name].method, (321, 322), trained.seer).score()
        for name in ("phyfilter", "baseline")
    )
    assert ours.grasped.all()
    assert not theirs.grasped.any()
    assert np.all(ours.mean < 0.3 * theirs.mean)


def flown(error: np.ndarray) -> experiment.Score:
    """Score of flights whose end effector is off along x by ``error`` (B, N)."""
    goals = mission.reference()
    off = np.zeros((*error.shape, 3))
    off[..., 0] = error
    signals = {"r_e": goals.end_effector + off}
    seeds = tuple(range(len(error)))
    return experiment.Flights(OBSERVER, seeds, params.params().mission, goals, signals, "").score()


def test_score() -> None:
    values, time = params.params().mission, mission.reference().time
    error = np.zeros((4, len(time)))
    error[0, time < values.left_out] = 1.0  # not counted
    error[1, time == 7.5] = 0.03  # dropped
    error[2, time == 16.5] = 0.03  # not placed
    error[3] = np.nan
    score = flown(error)
    assert score.mean[0] == 0.0
    assert score.grasped.tolist() == [True, False, True, False]
    assert score.placed.tolist() == [True, False, False, False]
    np.testing.assert_allclose(score.windows[1:3], 0.03, atol=2e-3)
    assert np.isinf(score.mean[3])


def test_arm_controller_refuses_nonsense() -> None:
    make = arm_controller
    with pytest.raises(ValueError, match="share: expected 0 to 1"):
        make(mission.arm(), tilt_bandwidth=5.0, share=2.0, dt=0.002)
    with pytest.raises(ValueError, match="tilt_bandwidth: expected a positive"):
        make(mission.arm(), tilt_bandwidth=0.0, dt=0.002)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("nobody", 2.0), "expected one of"),
        (("baseline", -1.0), "position_bandwidth"),
        (("observer", 2.0), "bandwidth: expected a positive"),
        (("phyfilter", 2.0, 4.0), "torque_bandwidth"),
    ],
)
def test_methods_refuse_bad_gains(arguments: tuple[object, ...], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        methods.Method(*arguments)


def test_seer_is_asked_for() -> None:
    with pytest.raises(ValueError, match="trained SEER-I models"):
        diagram.build(methods.Method("seer", 2.0))


def test_swaying_attitude_is_a_rotation() -> None:
    R, omega = study.swaying(0.0, np.zeros(12), np.array([0.5, -0.3, 0.2, 0.0, 0.0, 0.0]))
    R = np.asarray(R)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=ROUNDING)
    assert np.linalg.det(R) > 0.0
    assert not np.any(omega)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pick", "9", "0", "1"], "out of reach"),
        (["--payload", "9"], "take a lighter load"),
        (["--seeds", "0"], "1 or more"),
        (["--study", "--payload", "0.1"], "leave out --study"),
        (["--tune", "--out", "fmus"], "leave out --study and --tune"),
        (["--mission", "fast", "--payload", "0.1"], "a table of its own"),
        (["--out", "nowhere/fmus"], "no folder nowhere"),
        (["--picture", "mission.xyz"], "mission.xyz"),
    ],
)
def test_bad_input_is_refused_before_anything_flies(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["run", "aerial_manipulator", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.release
@pytest.mark.usefixtures("flawless")
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figures, picture = tmp_path / "figures.json", tmp_path / "mission.png"
    files = ["--json", str(figures), "--picture", str(picture)]
    assert main(["run", "aerial_manipulator", "--quick", "--seeds", "2", "--quiet", *files]) == 0
    text = capsys.readouterr().out
    assert "PhyFilter below, %" in text
    found = json.loads(figures.read_text())
    for key in ("max_error_cm", "mean_error_cm", "grasped", "placed"):
        assert set(found[key]) == set(methods.METHODS)
    assert 0.0 < found["planner_ms"]["p50"] <= found["planner_ms"]["p99"]
    assert found["realtime_factor"] > 0.0
    assert picture.stat().st_size > 50_000


@pytest.mark.slow
@pytest.mark.usefixtures("flawless")
def test_while_the_arm_turns_the_model_pays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Beyond the rates it was trained on; 20 flights say 17.2 % [17.0, 17.3] below the observer."""
    picture = tmp_path / "turning.png"
    arguments = ["--mission", "fast", "--quick", "--seeds", "2", "--quiet", "--json", "-"]
    assert main(["run", "aerial_manipulator", *arguments, "--picture", str(picture)]) == 0
    assert picture.stat().st_size > 20_000
    found = json.loads(capsys.readouterr().out)
    assert found["reduction_pct"]["6.5"]["observer"]["value"] == pytest.approx(17.2, abs=0.5)
    assert found["mean_error_cm"]["6.5"]["phyfilter"] == pytest.approx(1.41, abs=0.03)
    assert importlib.import_module(f"{ROOM}.turning").steps(("6.5",)) == len(methods.METHODS)
