"""The drone study: draws, diagram, scores, tuning, and the command line."""

from __future__ import annotations

import argparse
import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from phyfilter_ctl import flatten, models, simulate
from phyfilter_ctl.cli import main
from phyfilter_ctl.study import Executor, median_interval
from tests.cpu_budget import slow_but

ROOM = f"{models.__name__}.drone"
comparison = importlib.import_module(f"{ROOM}.comparison")
diagram = importlib.import_module(f"{ROOM}.diagram")
events = importlib.import_module(f"{ROOM}.events")
experiment = importlib.import_module(f"{ROOM}.experiment")
flights = importlib.import_module(f"{ROOM}.flights")
methods = importlib.import_module(f"{ROOM}.methods")
params = importlib.import_module(f"{ROOM}.params")
report = importlib.import_module(f"{ROOM}.report")
training = importlib.import_module(f"{ROOM}.training")
tuning = importlib.import_module(f"{ROOM}.tuning")

# m: Runge-Kutta at 2 ms against 0.5 ms over ten seconds.
STEP = 1e-6
# N: constant force after ten time constants, without noise.
SETTLED = 1e-3
# The margin of a tuned method, found anew by another process.
SAME = 2e-4

OBSERVER = methods.Method("observer", 2.0, 6.0)
SILENT = {
    f"vehicle.sensors.{name}": 0.0 for name in ("position", "velocity", "attitude", "rate", "specific_force")
}


def outputs(
    method: methods.Method, duration: float, settings: dict[str, object], step: float = 0.002
) -> dict[str, np.ndarray]:
    """A flight without noise."""
    flat = flatten(diagram.build(method))
    time = flights.timepts(duration)
    run = simulate(flat, time, None, experiment.start_state(), params={**method.parameters(), **SILENT, **settings},
                   method="rk4", max_step=step, backend="vm")  # fmt: skip
    assert run.success, run.message
    signals: dict[str, list[np.ndarray]] = {}
    for label, row in zip(run.output_labels, run.outputs, strict=True):
        signals.setdefault(label.split("[")[0], []).append(row)
    return {name: np.array(rows).T for name, rows in signals.items()}


@pytest.fixture(scope="module")
def still_air() -> dict[str, np.ndarray]:
    return outputs(OBSERVER, 8.0, {"vehicle.quadrotor.added_mass": 0.4})


@given(seed=st.integers(0, 10_000))
def test_mass_of_a_seed_is_the_same_with_and_without_wind(seed: int) -> None:
    still, windy = (flights.conditions([seed], kind) for kind in ("mass", "wind"))
    values = params.params()
    assert still.added_mass == windy.added_mass
    assert values.mass.low <= still.added_mass[0] <= values.mass.high
    assert not still.jet_speed.any()
    assert not still.mean.any()
    assert values.wind.jet_speed_low <= windy.jet_speed[0] <= values.wind.jet_speed_high
    np.testing.assert_allclose(np.linalg.norm(windy.mean), values.wind.mean)


def test_training_tuning_and_test_seeds_are_apart() -> None:
    seeds = params.params().seeds
    groups = [set(seeds.train), set(seeds.tune), set(range(seeds.test))]
    assert sum(len(group) for group in groups) == len(set.union(*groups))


def test_force_is_what_is_missing(still_air: dict[str, np.ndarray]) -> None:
    """m v' = g + f along a flight: the mean of g + f over a step is m dv/h."""
    vehicle, dt = params.params().vehicle, params.params().sampling.dt
    f, g, v = (still_air[name] for name in ("f_mass", "g", "v"))
    wanted = vehicle.mass * np.diff(v, axis=0) / dt
    known = 0.5 * (g[1:] + g[:-1]) + 0.5 * (f[1:] + f[:-1]) + 0.5 * np.diff(still_air["f_wind"], axis=0)
    np.testing.assert_allclose(
        known[10:], wanted[10:], atol=2e-3
    )  # trapezoids of a thrust with a lag of 40 ms


def test_observer_finds_the_weight(still_air: dict[str, np.ndarray]) -> None:
    """On the circle the vertical residual is constant: the estimate settles on it."""
    f = still_air["f_mass"] + still_air["f_wind"]
    np.testing.assert_allclose(still_air["f_hat"][-500:, 2], f[-500:, 2], atol=30 * SETTLED)
    assert abs(np.mean(still_air["f_hat"][-500:, 2]) + 0.4 * params.params().vehicle.gravity) < 0.05


def test_integration_is_converged() -> None:
    windy = {"vehicle.quadrotor.added_mass": 0.4, "vehicle.wind.jet_speed": 5.0}
    coarse, fine = (outputs(OBSERVER, 6.0, windy, step)["r"] for step in (0.002, 0.0005))
    assert np.abs(coarse - fine).max() < STEP


@pytest.mark.parametrize("name", slow_but(("baseline", "phyfilter", "indi"), methods.METHODS))
def test_every_method_flies(name: str) -> None:
    """Tuned, in the wind, with noise: within a metre of the circle after the start-up."""
    method = tuning.tuned()[name].method
    flown = experiment.fly(
        method, flights.conditions([300], "wind"), training.train("vm").model, duration=9.0, backend="vm"
    )
    assert not flown.message
    assert flown.score().total.max() < 1.0


def test_score_leaves_the_start_up_out() -> None:
    time = np.arange(0.0, 10.0, 0.5)
    r = np.zeros((1, len(time), 3))
    r[0, time < params.params().mission.left_out] = 100.0
    r[0, time >= params.params().mission.left_out] = [0.3, 0.4, 1.2]
    given_ = flights.conditions([0], "mass")
    score = experiment.Flights(OBSERVER, given_, time, {"r": r, "r_ref": np.zeros_like(r)}, "").score()
    np.testing.assert_allclose([score.total[0], score.horizontal[0], score.vertical[0]], [1.3, 0.5, 1.2])


def test_a_failed_flight_scores_infinity() -> None:
    time = np.arange(0.0, 10.0, 0.5)
    r = np.full((1, len(time), 3), np.nan)
    flown = experiment.Flights(
        OBSERVER, flights.conditions([0], "mass"), time, {"r": r, "r_ref": 0.0 * r}, "fell"
    )
    assert np.isinf(flown.score().total[0])


@given(n=st.integers(6, 40))
def test_interval_covers_the_median_with_95_per_cent(n: int) -> None:
    interval = median_interval(np.arange(float(n)))
    below = int(interval.low)  # order statistics k - 1 and n - k of 0, 1, ...
    assert 1.0 - 2.0 * binom.cdf(below, n, 0.5) >= 0.95 or below == 0
    assert 1.0 - 2.0 * binom.cdf(below + 1, n, 0.5) < 0.95
    assert interval.low + interval.high == n - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["baseline", "phyfilter"])
def test_tuned_methods_have_their_margin(name: str) -> None:
    entry = tuning.tuned()[name]
    found = tuning.modulus_margin(entry.method, training.train("vm").model)
    assert found == pytest.approx(entry.modulus_margin, abs=SAME)
    assert found >= params.params().tuning.modulus_margin


def test_all_methods_are_tuned_within_the_limits() -> None:
    values, entries = params.params().tuning, tuning.tuned()
    assert list(entries) == list(methods.METHODS)
    assert all(entry.modulus_margin >= values.modulus_margin for entry in entries.values())
    for entry in entries.values():  # no optimum on the edge of what was tried
        low, high = values.integral if entry.method.name == "integral" else values.bandwidths
        assert entry.interior
        assert not entry.method.tunable or low < entry.method.bandwidth < high
        assert values.slowest < entry.method.position_bandwidth < values.fastest
    assert entries["phyfilter"].method.seer_rate == entries["seer"].method.bandwidth


def test_filters_are_what_they_are_called() -> None:
    first = methods.filter_of(methods.Method("phyfilter", 2.0, 6.0, 1.0))
    second = methods.filter_of(methods.Method("phyfilter_type2", 2.0, 6.0, 1.0))
    assert first is not None
    assert second is not None
    assert (first.order, first.type, second.order, second.type) == (1, 1, 2, 2)
    assert methods.filter_of(methods.Method("indi", 2.0, 6.0)) is None


@pytest.mark.slow
def test_accelerometer_takes_the_same_filter_to_the_measured_residual() -> None:
    """f_hat is F on m (R a - G e_z) - g, by numpy from what the sensors gave; no model flies along."""
    method = methods.Method("accelerometer", 1.8, 40.0, with_model=False)
    found = outputs(method, 3.0, {"vehicle.quadrotor.added_mass": 0.4, "vehicle.sensors.attitude": 0.002})
    vehicle, dt = params.params().vehicle, params.params().sampling.dt
    rotation = Rotation.from_quat(found["q_m"], scalar_first=True)
    residual = vehicle.mass * (rotation.apply(found["a_m"]) - [0.0, 0.0, vehicle.gravity]) - found["g"]
    kept, expected = np.exp(-40.0 * dt), np.zeros_like(residual)
    for k in range(1, len(residual)):
        expected[k] = kept * expected[k - 1] + (1.0 - kept) * 0.5 * (residual[k] + residual[k - 1])
    np.testing.assert_allclose(found["f_hat"], expected, rtol=0.0, atol=1e-9)
    assert abs(found["f_hat"][-1, 2] + 0.4 * vehicle.gravity) < 0.3  # on its way to the payload's weight


@pytest.mark.slow
def test_payload_in_the_model_leaves_the_wind() -> None:
    """f - f_theta is m/(m + dm) f_wind and the weight where the mass is told; at hover a found mass changes nothing."""
    vehicle, added = params.params().vehicle, 0.9
    windy = {"vehicle.quadrotor.added_mass": added, "vehicle.wind.mean": [4.0, 1.0, 0.0]}
    told = replace(OBSERVER, payload="told")
    found = outputs(told, 6.0, {**windy, "estimator.told.mass": added})
    left = found["f_mass"] + found["f_wind"] - found["f_theta"] + [0.0, 0.0, added * vehicle.gravity]
    expected = vehicle.mass / (vehicle.mass + added) * found["f_wind"]
    # Drag that g knows takes the measured velocity, which has no noise here: the rotors' model is exact.
    np.testing.assert_allclose(left[50:], expected[50:], rtol=0.0, atol=2e-3)
    hover = {**windy, "controller.reference.speed": 1e-9}
    lumped, separated = (
        outputs(replace(OBSERVER, payload=form), 2.0, hover) for form in ("lumped", "separated")
    )
    np.testing.assert_array_equal(separated["f_theta"], 0.0)
    np.testing.assert_allclose(separated["r"], lumped["r"], rtol=0.0, atol=1e-9)
    with pytest.raises(ValueError, match="payload: indi has a model or no filter"):
        methods.Method("indi", 2.0, 6.0, payload="told")


def test_events_happen_when_they_are_said_to() -> None:
    """Before, the vehicle as it is; after, one without the payload, or whose first motor gets less."""
    plain, eventful = diagram.multirotor().plant(), events.with_events(diagram.multirotor().plant())
    rng = np.random.default_rng(0)
    state = plain.start_state + 0.1 * rng.standard_normal(len(plain.start_state))
    u = np.concatenate([rng.uniform(4.0, 8.0, 4), rng.standard_normal(3)])
    weaker = u * [0.5, *[1.0] * 6]
    own = {"added_mass": 0.6, "drop_time": 2.0, "weak_time": 3.0, "weak": 0.5}
    for t, mass, given_ in ((1.0, 0.6, u), (2.5, 0.0, u), (3.5, 0.0, weaker)):
        expected, found = (
            law(t, state, inputs, block.parameter_vector(params)).full()
            for block, inputs, params in ((plain, given_, {"added_mass": mass}), (eventful, u, own))
            for law in (block.functions.dynamics,)
        )
        np.testing.assert_array_equal(found, expected)


def test_seer_learned_the_mass_and_not_the_wind() -> None:
    trained = training.train("vm")
    assert trained.rmse < 0.1 * trained.label_rms
    assert trained.model.bounds is not None
    np.testing.assert_allclose(trained.model.bounds[-1], [0.0, params.params().mass.high])


@pytest.mark.release
def test_comparison_is_the_same_by_any_number_of_workers() -> None:
    options = {"methods": ("integral", "observer"), "duration": 8.0, "backend": "vm"}
    expected = comparison.compare([0, 1], **options)
    with Executor(2) as executor:
        found = comparison.compare([0, 1], **options, executor=executor)
    assert list(found.scores) == list(expected.scores)
    for key, score in expected.scores.items():
        for figure in ("total", "horizontal", "vertical"):
            np.testing.assert_array_equal(getattr(found.scores[key], figure), getattr(score, figure))
    assert [*found.estimation] == [("mass", "observer"), ("wind", "observer")]
    for key, estimation in expected.estimation.items():
        np.testing.assert_array_equal(found.estimation[key].force, estimation.force)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--speed", "12"], "fly slower than 3.9 m/s"),
        (["--payload", "-0.5", "0.2"], "0 <= LOW <= HIGH"),
        (["--payload", "0.2", "40"], "take a smaller mass"),
        (["--seeds", "0"], "1 or more"),
        (["--scheduler", "tcp://127.0.0.1:1", "--cosimulate"], "a co-simulation run here"),
        (["--checkpoint", "kept.jsonl"], "add --study"),
        (["--thrust-delay", "0.1"], "belong to --replay"),
        (["--replay", "no-such-file.csv"], "no-such-file.csv"),
        *(
            (
                ["--mission", "fast", f"--{job}", *files],
                f"--{job}: --mission would change the comparison only",
            )
            for job, files in (("study", []), ("tune", []), ("replay", ["a.csv"]), ("cosimulate", []))
        ),
        (["--tune", "--speed", "1", "--payload", "0.1", "0.2"], "--tune: --speed, --payload"),
        (["--picture", "flight.xyz"], "flight.xyz"),
        (["--out", "absent/run"], "there is no folder absent"),
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
    assert main(["run", "drone", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "folder", "picture"),
    [
        ([], "drone_run", "drone.png"),
        (["--out", "mine"], "mine", "drone.png"),
        (["--out", "mine", "--picture", "here.svg"], None, "here.svg"),
        (["--picture", "none"], None, None),
        (["--out", "none"], None, None),
    ],
)
def test_a_run_leaves_its_files_in_one_folder(
    arguments: list[str],
    folder: str | None,
    picture: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    drone = importlib.import_module("phyfilter_ctl.models.drone")
    parser = argparse.ArgumentParser()
    drone.add_arguments(parser)
    outputs = drone._outputs(parser.parse_args(arguments))
    assert (outputs.folder, outputs.picture) == (folder, picture)


def test_methods_refuse_bad_gains() -> None:
    for arguments in (
        ("baseline", 0.0),
        ("baseline", float("nan")),
        ("observer", 2.0, -1.0),
        ("nobody", 2.0),
    ):
        with pytest.raises(ValueError, match=r"expected"):
            methods.Method(*arguments)
    with pytest.raises(ValueError, match="trained SEER-I model"):
        diagram.build(methods.Method("seer", 2.0, 1.0))
    with pytest.raises(ValueError, match="scenario"):
        flights.conditions([0], "storm")
    with pytest.raises(ValueError, match="payload"):
        flights.conditions([0], "mass", payload=(0.5, 0.2))


@pytest.mark.release
@pytest.mark.usefixtures("flawless")
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two short flights a method: the table, the JSON with all its keys, the picture and the filter."""
    figures, picture, out = tmp_path / "figures.json", tmp_path / "flights.png", tmp_path / "filter"
    files = ["--json", str(figures), "--picture", str(picture), "--out", str(out)]
    code = main(["run", "drone", "--mission", "fast", "--quick", "--seeds", "2", "--quiet", *files])
    text = capsys.readouterr().out
    assert code == 0
    assert text.startswith("circle of 1.5 m at 3 m/s")
    assert "PhyFilter below, %" in text
    assert "paper" not in text  # whose figures are of 2 m/s
    found = json.loads(figures.read_text())
    assert found["circle"] == {"radius": 1.5, "speed": 3.0}
    wanted = {
        "baseline",
        "integral",
        "seer",
        "observer",
        "indi",
        "l1",
        "phyfilter",
        "phyfilter_type2",
        "accelerometer",
        "known_mass",
    }
    for key in ("mae", "mae_horizontal"):
        assert set(found[key]) == {"mass", "wind"}
        assert all(set(values) == wanted for values in found[key].values())
    for key in ("seer", "seer_mass_only", "baseline", "integral"):
        assert np.isfinite(found[f"reduction_vs_{key}_pct"])
    assert found["realtime_factor"] > 0.0
    assert picture.stat().st_size > 50_000
