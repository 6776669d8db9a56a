"""The acceleration study: flights, tuning, scores, diagram."""

from __future__ import annotations

import importlib
import json
import tomllib
from pathlib import Path

import control as ct
import numpy as np
import pytest
from scipy import stats

from phyfilter_ctl import PhyFilter, models, save
from phyfilter_ctl.cli import main
from phyfilter_ctl.learned import Network, Windowed
from phyfilter_ctl.recording import Recording

ROOM = f"{models.__name__}.acceleration"
diagram = importlib.import_module(f"{ROOM}.diagram")
differentiator = importlib.import_module(f"{ROOM}.differentiator")
experiment = importlib.import_module(f"{ROOM}.experiment")
flights = importlib.import_module(f"{ROOM}.flights")
linear = importlib.import_module(f"{ROOM}.linear")
params = importlib.import_module(f"{ROOM}.params")
scores = importlib.import_module(f"{ROOM}.scores")
study = importlib.import_module(f"{ROOM}.study")
tuning = importlib.import_module(f"{ROOM}.tuning")

# Two recursions of the same filter, states of size 10 and 4000 steps of rounding.
SAME = 1e-9
# The label is the slope of the velocity that the noise was added to: what is left is the step of the integrator (1 ms)
# and the noise, averaged over the window of the comparison.
SLOPE = 0.05
# A bootstrap of 10,000 draws of eight units against Student's interval, in units of its half width.
STUDENT = 0.15
# Noise of a known power: 3 standard errors of its estimate over 28,000 samples that are correlated over 50.
NOISE = 0.15

METHODS = [
    "network",
    "phyfilter_1",
    "phyfilter_2",
    "phyfilter_3",
    "difference",
    "tracking_differentiator",
    "robust_differentiator",
    "kalman",
    "lowpass",
    "learned",
    "learned_axes",
    "fir",
    "fir_axes",
    "network_after",
]


@pytest.fixture(scope="module")
def quick() -> experiment.Comparison:
    """One quick comparison for all tests that look into it."""
    train, test = (flights.generate(kind, 3, share=0.25) for kind in ("train", "test"))
    return experiment.compare(train, test, data="generated", seed=3, effort=experiment.QUICK)


def sine_flight(speed: float, *, n: int = 300, seed: int = 0, name: str = "sine") -> Recording:
    t = 0.01 * np.arange(n)[:, None]
    omega = np.array([2.0, 3.0, 4.0])
    noise = 0.002 * np.random.default_rng(seed).standard_normal((n, 3))
    return Recording.from_arrays(
        x=speed * np.sin(omega * t + seed) + noise,
        dt=0.01,
        label=speed * omega * np.cos(omega * t + seed),
        name=name,
        channels=("vx", "vy", "vz"),
    )


def write(path: Path, log: Recording) -> str:
    """The log with the columns of a recording."""
    assert log.label is not None
    table = np.hstack([log.times[:, None], log.x, log.label])
    np.savetxt(path, table, delimiter=",", header="t,vx,vy,vz,ax,ay,az", comments="")
    return str(path)


# -- numbers and flights ------------------------------------------------------------------------------------------


def test_every_number_has_a_unit_and_a_reason():
    tables = tomllib.loads(Path(params.__file__).with_name("params.toml").read_text())
    for group in tables.values():
        for name, entry in group.items():
            assert set(entry) == {"value", "unit", "reason"}, name
            assert entry["unit"], name
            assert len(entry["reason"]) > 10, name


@pytest.mark.slow
def test_flights_are_as_many_as_fast_and_as_repeatable_as_said():
    train, test = flights.generate("train"), flights.generate("test")
    assert sum(log.n for log in train) == 28_000
    assert sum(log.n for log in test) == 8_400
    assert {log.dt for log in (*train, *test)} == {0.002}
    assert 1.3 < max(log.speed(100) for log in train) <= 2.0
    assert 2.0 < max(log.speed(100) for log in test) <= 3.0
    again = flights.generate("train")
    assert all(np.array_equal(one.x, other.x) for one, other in zip(train, again, strict=True))
    other = flights.generate("train", 1)
    assert not np.allclose(train[0].x, other[0].x, atol=0.05)
    # Training and test flights of one seed share nothing.
    assert not np.allclose(train[0].x[:2800], test[0].x, atol=0.05)


def test_label_is_the_slope_of_the_velocity():
    for log in flights.generate("test", 2):
        assert log.label is not None
        # Over 0.2 s the noise of 3.6 mm/s weighs little; the integral of the label is exact to the trapezoid.
        rise = (log.x[100:] - log.x[:-100]) / 0.2
        integral = np.cumsum(0.001 * (log.label[1:] + log.label[:-1]), axis=0)
        mean = (integral[99:] - np.vstack([np.zeros((1, 3)), integral[:-100]])) / 0.2
        assert np.sqrt(np.mean((rise - mean) ** 2)) < SLOPE


def test_sensor_noise_has_the_power_of_the_parameters():
    sensor = params.params().sensor
    found = np.concatenate(
        [
            log.x[1:] - log.x[:-1] - 0.001 * (log.label[1:] + log.label[:-1])
            for log in flights.generate("train", 5)
        ]
    )
    pole = np.exp(-0.002 / sensor.coloured_time_constant)
    expected = 2.0 * sensor.white**2 + 2.0 * sensor.coloured**2 * (1.0 - pole)
    assert np.var(found) == pytest.approx(expected, rel=NOISE)


@pytest.mark.parametrize(("kind", "seed", "share"), [("both", 0, 1.0), ("train", -1, 1.0), ("train", 0, 0.0)])
def test_flights_refuse_bad_options(kind, seed, share):
    with pytest.raises(ValueError, match="expected"):
        flights.generate(kind, seed, share=share)


# -- window and filters -------------------------------------------------------------------------------------------


def test_features_are_the_window_itself():
    """Summed up again, the steps give the past velocities: nothing is lost and nothing comes from the future."""
    v = np.random.default_rng(0).standard_normal((60, 3))
    window = Windowed(differentiator.least_squares_slope(8, 0.01), 8, 4)
    z = window.features(v).reshape(60, 8, 3)
    past = z[:, :1] - np.concatenate([np.zeros((60, 1, 3)), np.cumsum(z[:, 1:], axis=1)], axis=1)
    for j in range(8):
        np.testing.assert_allclose(past[40, j], v[40 - 4 * j], atol=1e-14)
    changed = v.copy()
    changed[41:] += 1.0
    np.testing.assert_array_equal(window.features(changed)[:41], window.features(v)[:41])


def test_least_squares_slope_is_polyfit():
    v = np.random.default_rng(1).standard_normal((40, 3))
    window = Windowed(differentiator.least_squares_slope(6, 0.03), 6, 3)
    t = 0.03 * np.arange(6)
    expected = np.polyfit(t, v[30 - 15 : 31 : 3], 1)[0]
    np.testing.assert_allclose(window.predict(v)[30], expected, rtol=1e-12)


@pytest.mark.slow
def test_tuner_finds_the_filter_that_made_the_labels():
    """Labels made by a known filter of order 2: the tuner gets back to it."""
    rng = np.random.default_rng(4)
    truth = PhyFilter.from_poles([-6.0, -15.0])
    cases = []
    for _ in range(2):
        x, f_theta = np.cumsum(0.05 * rng.standard_normal((1500, 3)), axis=0), rng.standard_normal((1500, 3))
        label = truth.sampled(0.01).run(x, f_theta=f_theta)
        log = Recording.from_arrays(x=x, dt=0.01, label=label)
        cases.append(tuning.Case(log, f_theta))
    found = tuning.tune_filters([1, 2], cases, 0.01)
    assert found[2].tuning_rmse < 0.03 * found[1].tuning_rmse
    # The simplex stops within 2 % of the logarithms.
    np.testing.assert_allclose(np.sort(found[2].filter.poles.real), [-15.0, -6.0], rtol=0.05)


def test_fir_finds_the_response_that_made_the_labels_at_irregular_times():
    rng = np.random.default_rng(8)
    times = np.cumsum(0.01 * rng.uniform(0.5, 1.5, 400))
    x = np.cumsum(rng.standard_normal((400, 2)), axis=0)
    slopes = np.diff(x, axis=0) / np.diff(times)[:, None]
    truth = np.array([[0.5, 0.3, -0.1, 0.2], [0.1, 0.6, 0.0, 0.3]])
    label = np.zeros_like(x)
    for i in range(2):
        label[1:, i] = np.convolve(slopes[:, i], truth[i])[:399]
    log = Recording(times, x, label=label)
    own = linear.SlopeFIR.fit([log], 4, by_axis=True)
    np.testing.assert_allclose(own.taps, truth, atol=SAME)
    np.testing.assert_allclose(own.estimate(log), label, atol=1e3 * SAME)
    shared = linear.SlopeFIR.fit([log.with_signals(label=label[:, ::-1])], 4)
    assert shared.taps.shape == (1, 4)
    # Too short a response errs more, and the length is found on the flights that it was not fitted to.
    assert linear.SlopeFIR.chosen([log, log], (1, 2, 4), by_axis=True).length == 4


@pytest.mark.slow
def test_general_form_nests_the_lowpass_form(quick):
    costs = [quick.learned.filters[n].tuning_rmse for n in (1, 2, 3)]
    for n in (1, 2, 3):
        found = quick.learned.filters[n].filter
        assert found.order == n
        assert found.type >= 1  # F(0) = 1 in both forms
        assert np.all(found.poles.real < 0.0)
    assert costs[1] <= costs[0] * 1.001
    with pytest.raises(ValueError, match="orders"):
        tuning.tune_filters([2], [], 0.002)


# -- comparison ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_network_fails_beyond_its_speeds_and_every_filter_repairs_it(quick):
    train, test = quick.train_rmse, quick.test_rmse
    assert list(test) == METHODS
    assert test["network"] > 2.0 * train["network"]
    for n in (1, 2, 3):
        assert test[f"phyfilter_{n}"] < 0.6 * test["network"]


@pytest.mark.slow
def test_other_flights_are_estimated_by_the_same_methods(quick):
    again = quick.tested_on(quick.train)
    assert again.test_rmse == quick.train_rmse
    assert again.learned is quick.learned


def test_interval_of_a_ratio_is_students_for_small_differences():
    """Squares that differ by a little: the ratio of the roots is half their mean difference."""
    rng = np.random.default_rng(4)
    excess = 1e-4 * rng.standard_normal(8)
    other = np.ones((8, 2))
    found = scores.over(other * np.stack([1.0 + excess, np.ones(8)], axis=1), other)
    half = stats.t.ppf(0.975, 7) * 0.5 * np.std(excess, ddof=1) / np.sqrt(8.0)
    assert found.value == pytest.approx(0.5 * excess.mean(), rel=1e-3)
    assert abs(found.low - (found.value - half)) < STUDENT * half
    assert abs(found.high - (found.value + half)) < STUDENT * half
    assert not found.is_ahead
    assert scores.over(other * [0.9, 1.0], other).is_ahead
    # Few flights have no interval, and no method is ahead on them.
    few = scores.over(other[:3] * [0.5, 1.0], other[:3])
    assert not few.is_ahead
    assert str(few) == "-29.3 %"


def test_best_rival_is_one_without_a_filter():
    assert scores.best_rival({"learned": 0.1, "kalman": 0.3, "fir": 0.2, "network_after": 0.05}) == "fir"
    assert set(scores.OURS) < set(METHODS)


@pytest.mark.slow
def test_every_method_is_causal(quick):
    """A change in the future changes no estimate before it."""
    log = quick.test[0]
    x = log.x.copy()
    x[500:] += 0.3
    changed = Recording.from_arrays(x=x, dt=log.dt, label=log.label)
    again = experiment.estimates([log], quick.dt, quick.learned, quick.baselines)
    again |= quick.linear.estimates([log], quick.dt)
    other = experiment.estimates([changed], quick.dt, quick.learned, quick.baselines)
    other |= quick.linear.estimates([changed], quick.dt)
    for name in METHODS:
        np.testing.assert_array_equal(other[name][0][:500], again[name][0][:500], err_msg=name)
        assert not np.allclose(other[name][0][500:], again[name][0][500:]), name


@pytest.mark.release
def test_the_test_flights_do_not_enter_the_tuning():
    train = [sine_flight(v, seed=i, name=f"t{i}") for i, v in enumerate((0.5, 0.7, 0.9, 1.0))]
    one, other = (
        experiment.compare(train, [sine_flight(v, seed=9)], data="recorded", effort=experiment.QUICK)
        for v in (1.5, 0.2)
    )
    for n in (1, 2, 3):
        assert one.learned.filters[n].filter == other.learned.filters[n].filter
    assert {k: r.differentiator for k, r in one.baselines.items()} == {
        k: r.differentiator for k, r in other.baselines.items()
    }
    assert one.train_rmse == other.train_rmse


def test_start_of_a_flight_does_not_count():
    log = sine_flight(1.0)
    estimate = log.label.copy()
    estimate[:50] += 100.0
    assert tuning.rmse([estimate], [log]) == 0.0
    estimate[50:] += 3.0
    assert tuning.rmse([estimate], [log]) == pytest.approx(3.0, rel=1e-12)


def test_filter_uses_the_times_of_an_irregular_recording():
    log = sine_flight(1.0)
    times = log.times + 0.002 * np.random.default_rng(0).uniform(-1, 1, log.n)
    irregular = Recording(times, log.x, label=log.label)
    filter = PhyFilter([400.0, 40.0])
    case = tuning.Case(irregular, np.zeros_like(log.x))
    expected = filter.sampled(0.01).run(log.x, f_theta=case.f_theta, times=times)
    np.testing.assert_array_equal(tuning.filtered(filter, [case], 0.01)[0], expected)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda log: log.with_signals(label=None), "no true acceleration"),
        (lambda log: log.segment(0, 40), "left out at its start"),
        (lambda log: log.decimate(3), "one rate"),
    ],
)
def test_unfit_flights_are_refused(change, message):
    good = [sine_flight(0.5), sine_flight(0.8, seed=1)]
    with pytest.raises(ValueError, match=message):
        experiment.compare(good, [change(sine_flight(1.0))], data="recorded")


def test_one_training_flight_is_cut_in_four():
    pieces, dt = experiment.prepare([sine_flight(1.0, n=1000)], [sine_flight(1.5)])
    assert [piece.n for piece in pieces] == [250] * 4
    assert dt == pytest.approx(0.01)


# -- studies ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_pole_map_and_intervals(quick):
    found = study.order_by_pole(quick)
    assert found.rmse.shape == (len(found.orders), len(found.poles))
    # A pole placed by hand gives the same figure by another way.
    case = quick.test_cases()
    direct = tuning.rmse(
        [PhyFilter([found.poles[3]]).sampled(0.002).run(c.log.x, f_theta=c.f_theta) for c in case], quick.test
    )
    assert found.rmse[0, 3] == pytest.approx(direct, rel=1e-9)
    assert found.tuned[1][1] == quick.test_rmse["phyfilter_1"]


@pytest.mark.slow
def test_sampling_intervals_begin_with_the_comparison(quick, monkeypatch):
    monkeypatch.setattr(study, "intervals", lambda dt: [1, 4])
    effort = experiment.Effort(iterations=10, choice_iterations=5, filter_evaluations=5)
    found = study.sampling_intervals(quick, effort=effort)
    np.testing.assert_allclose(found.dt, [0.002, 0.008])
    for name, scores in found.rmse.items():
        assert scores[0] == pytest.approx(quick.test_rmse[name], rel=1e-12)


# -- diagram ------------------------------------------------------------------------------------------------------


def test_diagram_is_the_filter_run_on_the_networks_estimate():
    train = sine_flight(1.0, seed=2)
    network = Windowed(Network(hidden=(5, 5), max_iterations=20), 4, 2).fit(train.x, train.label).model
    sampled = PhyFilter.from_poles([-10.0, -30.0]).sampled(0.01)
    system = diagram.build(network, sampled)
    v = sine_flight(1.4, n=120, seed=5).x
    response = ct.input_output_response(system, 0.01 * np.arange(120), v.T, diagram.rest_state(system, v[0]))
    f_theta = network.predict(v)
    np.testing.assert_allclose(response.outputs[3:].T, f_theta, atol=SAME)
    np.testing.assert_allclose(response.outputs[:3].T, sampled.run(v, f_theta=f_theta), atol=SAME)


def test_diagram_by_default():
    system = models.load("acceleration").build()
    assert (system.name, system.dt) == ("acceleration", 0.002)
    # Constant acceleration: the slope is exact at once where the window is full, and the filter adds nothing.
    t = 0.002 * np.arange(100)
    v = np.outer([1.0, -2.0, 0.5], t)
    response = ct.input_output_response(system, t, v, diagram.rest_state(system, v[:, 0]))
    np.testing.assert_allclose(response.outputs[3:, 40:], np.outer([1.0, -2.0, 0.5], np.ones(60)), atol=SAME)
    with pytest.raises(ValueError, match="build"):
        diagram.rest_state(ct.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]]), [0.0, 0.0, 0.0])


# -- command ------------------------------------------------------------------------------------------------------


@pytest.mark.release
@pytest.mark.usefixtures("flawless")
def test_command_on_recordings(tmp_path, capsys):
    train = [write(tmp_path / f"t{i}.csv", sine_flight(v, seed=i)) for i, v in enumerate((0.5, 0.7, 0.9))]
    test = write(tmp_path / "test.csv", sine_flight(1.5, seed=7))
    figures, image = tmp_path / "figures.json", tmp_path / "picture.png"
    options = ["--quick", "--study", "--quiet", "--json", str(figures), "--picture", str(image)]
    assert main(["run", "acceleration", "--train", *train, "--test", test, *options]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    data = json.loads(figures.read_text())
    assert (data["data"], data["seed"], data["n_train"], data["n_test"]) == ("recorded", 0, 900, 300)
    assert list(data["rmse"]) == METHODS
    for name, score in data["rmse"].items():
        assert np.isfinite(score)
        assert f"{score:.4f}" in shown.out, name
    points = data["study"]["order_by_pole"]["learned"]
    assert [(point["order"], point["form"]) for point in points][:2] == [(1, "lowpass"), (1, "general")]
    for point in points:
        assert np.isfinite([point["tuning_rmse"], point["test_rmse"], point["pole"]]).all()
    for n in (1, 2, 3):
        saved = data["filters"][f"phyfilter_{n}"]
        again = PhyFilter(saved["a"], saved["b"], poles=[complex(*p) for p in saved["poles"]])
        assert again.order == n
        assert saved["dt"] == pytest.approx(0.01)
    assert image.read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["figures.json", "picture.png", "t0.csv", "t1.csv", "t2.csv", "test.csv"]
    )


def test_command_refuses_bad_recordings(tmp_path, capsys):
    good = write(tmp_path / "good.csv", sine_flight(0.5))
    other = write(tmp_path / "other.csv", sine_flight(0.6, seed=1))
    broken = tmp_path / "broken.csv"
    broken.write_text("t,vx,vy,vz,ax,ay,az\n0,1,2,3,4,5,6\n0.01,1,2,x,4,5,6\n")
    bare = tmp_path / "bare.csv"
    bare.write_text("t,vx,vy,vz\n" + "".join(f"{0.01 * k},0,0,0\n" for k in range(100)))
    target = tmp_path / "figures.json"
    cases = {
        "line 3": ["--train", good, "--test", str(broken)],
        "no true acceleration": ["--train", good, other, "--test", str(bare)],
        "without --test": ["--train", good],
        "given twice": ["--train", good, other, "--test", good],
        "No such file": ["--train", good, "--test", str(tmp_path / "absent.csv")],
        "--seed": ["--seed", "-1"],
        "no folder": ["--picture", str(tmp_path / "absent" / "p.png")],
        "ends in": ["--picture", str(tmp_path / "p.txt")],
    }
    for message, options in cases.items():
        assert main(["run", "acceleration", "--quick", "--json", str(target), *options]) == 2, message
        shown = capsys.readouterr()
        assert message in shown.err
        assert shown.err.count("\n") == 1
        assert "Traceback" not in shown.err
    assert not target.exists()


@pytest.mark.slow
def test_a_filter_on_disk_is_scored_beside_the_tuned_ones(tmp_path, capsys):
    """The filter file of ``design`` and ``learn``, continuous or sampled at another rate, behind the same network."""
    trains = [
        write(tmp_path / f"train_{i}.csv", sine_flight(v, seed=i)) for i, v in enumerate((0.5, 0.6, 0.7))
    ]
    test = write(tmp_path / "test.csv", sine_flight(1.5, seed=9))
    chosen = PhyFilter([400.0, 40.0])
    save(tmp_path / "continuous.toml", chosen)
    save(tmp_path / "sampled.toml", chosen.sampled(0.01))
    arguments = [
        "run",
        "acceleration",
        "--quick",
        "--quiet",
        "--picture",
        "none",
        "--json",
        "-",
        "--train",
        *trains,
    ]
    arguments += ["--test", test, "--filter"]
    names = [str(tmp_path / "continuous.toml"), str(tmp_path / "sampled.toml")]
    assert main([*arguments, *names]) == 0
    given = json.loads(capsys.readouterr().out)["given"]
    assert list(given) == names
    assert given[names[0]] == given[names[1]]
    assert 0.0 < given[names[0]]["test"] < 10.0
    assert main([*arguments, str(tmp_path / "none.toml")]) == 2
    assert "none.toml" in capsys.readouterr().err


@pytest.mark.release
def test_no_method_diverges_on_faster_flights_than_it_was_tuned_on(tmp_path, capsys):
    """A recursion by forward Euler has gains that hold on slow flights and not on a fast one."""
    trains = [
        write(tmp_path / f"train_{i}.csv", sine_flight(v, seed=i)) for i, v in enumerate((0.5, 0.6, 0.7))
    ]
    test = write(tmp_path / "test.csv", sine_flight(1.5, seed=9))
    arguments = ["run", "acceleration", "--quick", "--quiet", "--train", *trains, "--test", test]
    target, picture = tmp_path / "figures.json", tmp_path / "figure.png"
    assert main([*arguments, "--json", str(target), "--picture", str(picture)]) == 0
    assert "diverged" not in capsys.readouterr().out
    figures = json.loads(target.read_text())
    # A sine of 1.5 m/s, whose acceleration is a few m/s^2: no method may be worse than ten times that.
    assert all(0.0 < value < 100.0 for scores in ("rmse", "train_rmse") for value in figures[scores].values())
    assert figures["tuned"]["robust_differentiator"]["status"] in ("converged", "at_bound", "iteration_limit")
    assert picture.stat().st_size > 0
