"""The replay of recorded flights, on generated recordings whose force is known in closed form."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from phyfilter_ctl import PhyFilter, models
from phyfilter_ctl.baselines import LowpassDifference
from phyfilter_ctl.learned import Chebyshev
from tests.figures import faults

ROOM = f"{models.__name__}.drone"
replay = importlib.import_module(f"{ROOM}.replay")
replay_picture = importlib.import_module(f"{ROOM}.replay_picture")
recordings = importlib.import_module(f"{ROOM}.replay_recordings")

G = 9.81
MASS = 1.7
HOVER = 0.45
H = 0.02
# Velocities are integrated with steps of 1 ms, sampled every 20 ms and taken as straight lines between: 1e-4 of
# accelerations of some m/s^2.
INTEGRATED = 5e-4
# Files hold all digits: what is left is the rounding of a few hundred steps.
ROUNDING = 1e-9
# Five points every 20 ms see motion of 1 rad/s to 1e-8; the integration above is what is left.
FIVE_POINTS = 1e-5
# The scan tries steps of 5 ms.
SCAN = 0.0051


@dataclass(frozen=True)
class Made:
    """A recording, column by column, and the force that acted."""

    columns: dict[str, np.ndarray]
    force: np.ndarray

    def write(self, path: Path, **changed: np.ndarray | None) -> Path:
        columns = {name: values for name, values in {**self.columns, **changed}.items() if values is not None}
        np.savetxt(
            path,
            np.stack(list(columns.values()), axis=1),
            delimiter=",",
            header=",".join(columns),
            comments="",
            fmt="%.17g",
        )
        return path


Force = Callable[[np.ndarray, np.ndarray], np.ndarray]


def constant_force(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.broadcast_to([1.0, -0.5, 0.25], v.shape)


def drag(t: np.ndarray, v: np.ndarray) -> np.ndarray:
    return -0.6 * v


def make(
    force: Force = constant_force,
    *,
    tilt: float = 0.2,
    thrust: float = 0.0,
    late: float = 0.0,
    seconds: float = 10.0,
    seed: int = 0,
) -> Made:
    """A flight with swinging attitude and a thrust that varies at 1.5 to 6 Hz; the label knows of no delay."""
    rng = np.random.default_rng(seed)
    fine = 0.001
    t = fine * np.arange(round(seconds / fine) + 1)
    phases, rates = rng.uniform(0.0, 2.0 * np.pi, (2, 6)), 2.0 * np.pi * rng.uniform(1.5, 6.0, 6)

    def throttle(at: np.ndarray) -> np.ndarray:
        wave = np.sin(rates[:, None] * at + phases[0][:, None]).mean(axis=0)
        return HOVER * (1.0 + thrust * wave)

    roll, pitch = tilt * np.sin(0.9 * t + phases[1, 0]), tilt * np.cos(0.7 * t + phases[1, 1])
    attitude = Rotation.from_euler("xyz", np.stack([roll, pitch, 0.3 * np.sin(0.5 * t)], axis=1))
    b3 = attitude.apply([0.0, 0.0, 1.0])
    up = np.array([0.0, 0.0, G])
    g = b3 * (G * throttle(t - late) / HOVER)[:, None] - up
    if force is constant_force:
        f = force(t, np.zeros((len(t), 3)))
        v = cumulative_trapezoid(g + f, t, axis=0, initial=0.0)
    else:  # forward Euler: the force that it applied is the one that is kept
        v, f = np.zeros((len(t), 3)), np.zeros((len(t), 3))
        for k in range(len(t) - 1):
            f[k] = force(t[k : k + 1], v[k : k + 1])[0]
            v[k + 1] = v[k] + fine * (g[k] + f[k])
        f[-1] = force(t[-1:], v[-1:])[0]
    said = g + f - (b3 * (G * throttle(t) / HOVER)[:, None] - up)
    rows = slice(None, None, round(H / fine))
    q = attitude.as_quat()
    names = {
        "v": v,
        "fa": MASS * said,
    }
    columns = {"t": t[rows]}
    columns |= {
        f"{name}{axis}": values[rows, i] for name, values in names.items() for i, axis in enumerate("xyz")
    }
    columns |= {f"q{axis}": q[rows, i] for i, axis in enumerate("xyzw")}
    columns |= {"T_sp": throttle(t)[rows], "hover_throttle": np.full(len(t[rows]), HOVER), "pwm0": t[rows]}
    return Made(columns, f[rows])


def stacked(columns: Mapping[str, np.ndarray], names: str) -> np.ndarray:
    return np.stack([columns[name] for name in names.split()], axis=1)


@pytest.fixture(scope="module")
def steady() -> Made:
    return make()


@pytest.fixture(scope="module")
def steady_path(steady: Made, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return steady.write(tmp_path_factory.mktemp("steady") / "steady.csv")


@pytest.fixture(scope="module")
def dragged(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two flights against drag: one to learn from, and one within its range to test on."""
    folder = tmp_path_factory.mktemp("drag")
    first, second = make(drag, tilt=0.3, thrust=0.15, seconds=20.0, seed=1), make(drag, thrust=0.1, seed=2)
    return first.write(folder / "learn.csv"), second.write(folder / "test.csv")


# -- what a recording says ------------------------------------------------------------------------------------------


def test_known_force_is_thrust_along_the_attitude_and_gravity(steady: Made, steady_path: Path):
    read = recordings.read(steady_path)
    b3 = Rotation.from_quat(stacked(steady.columns, "qx qy qz qw")).apply([0.0, 0.0, 1.0])
    expected = b3 * (G * steady.columns["T_sp"] / HOVER)[:, None] - [0.0, 0.0, G]
    np.testing.assert_allclose(read.g, expected, atol=ROUNDING)
    np.testing.assert_allclose(read.z, np.hstack([read.v, expected + np.array([0.0, 0.0, G])]), atol=ROUNDING)


def test_mass_is_read_off_the_label(steady_path: Path):
    read = recordings.read(steady_path)
    assert read.mass == pytest.approx(MASS, rel=FIVE_POINTS)
    assert read.misfit < FIVE_POINTS


def test_mass_as_given_scales_the_label(steady: Made, steady_path: Path):
    read = recordings.read(steady_path, mass=2.0 * MASS)
    np.testing.assert_allclose(read.label, 0.5 * steady.force, atol=INTEGRATED)
    assert read.misfit == pytest.approx(1.0, abs=FIVE_POINTS)  # m r is twice the label


def test_unit_of_the_label_changes_the_mass_and_no_score(steady: Made, steady_path: Path, tmp_path: Path):
    doubled = {name: 2.0 * steady.columns[name] for name in ("fax", "fay", "faz")}
    one = replay.replay([steady_path])
    other = replay.replay([steady.write(tmp_path / "doubled.csv", **doubled)])
    assert other.flights[0].recording.mass == pytest.approx(2.0 * one.flights[0].recording.mass, rel=1e-12)
    for name, score in one.scores.items():
        assert other.scores[name].total == pytest.approx(score.total, rel=1e-9)


@pytest.mark.parametrize("wrong", ["conjugate", "z down"])
def test_other_frames_are_refused_and_a_given_mass_overrides(steady: Made, tmp_path: Path, wrong: str):
    columns = steady.columns
    changed = {
        "conjugate": {name: -columns[name] for name in ("qx", "qy", "qz")},
        "z down": {name: -columns[name] for name in ("vy", "vz", "fay", "faz")},
    }[wrong]
    path = steady.write(tmp_path / "frames.csv", **changed)
    with pytest.raises(ValueError, match=r"frames\.csv: fax fay faz do not fit .* z up, q = \(x, y, z, w\)"):
        recordings.read(path)
    assert recordings.read(path, mass=MASS).misfit > 0.5


@pytest.mark.parametrize("late", [0.04, 0.07])
def test_scan_finds_how_late_the_thrust_acts(tmp_path: Path, late: float):
    path = make(thrust=0.3, late=late).write(tmp_path / "late.csv")
    scan = recordings.read(path, mass=MASS).delays
    assert scan.best == pytest.approx(late, abs=SCAN)
    assert scan.reduction > 0.9


def test_label_prefers_no_delay_and_the_motion_the_true_one(tmp_path: Path):
    """The label takes the thrust as it was set, so only the prediction can tell that it acts later."""
    path = make(thrust=0.3, late=0.06).write(tmp_path / "late.csv")
    prompt, late = (replay.replay([path], mass=MASS, thrust_delay=d).scores for d in (0.0, 0.06))
    for name in replay.default_filters():
        assert late[name].ahead < 0.1 * prompt[name].ahead
        assert late[name].total > prompt[name].total


# -- what the methods estimate --------------------------------------------------------------------------------------


def test_first_order_closes_in_on_a_constant_force(steady_path: Path):
    flight = replay.replay([steady_path]).flights[0]
    t = flight.recording.log.times[:, None]
    expected = np.array([1.0, -0.5, 0.25]) * (1.0 - np.exp(-10.0 * t))
    np.testing.assert_allclose(flight.estimates["phyfilter_1"], expected, atol=INTEGRATED)
    for name in replay.default_filters():
        assert flight.scores[name].total < INTEGRATED
        assert flight.scores[name].ahead < INTEGRATED


def test_no_estimate_scores_the_force_itself(steady_path: Path):
    score = replay.replay([steady_path]).scores["zero"]
    assert score.axes == pytest.approx((1.0, 0.5, 0.25), rel=FIVE_POINTS)
    rms = np.sqrt(np.mean(np.square([1.0, 0.5, 0.25])))
    assert score.total == pytest.approx(rms, rel=FIVE_POINTS)
    assert score.ahead == pytest.approx(rms, rel=INTEGRATED)


def test_first_order_is_the_low_pass_of_the_difference_with_g_taken_out(dragged: tuple[Path, Path]):
    flight = replay.replay([dragged[0]]).flights[0]
    v, g = flight.recording.v, flight.recording.g
    explained = cumulative_trapezoid(g, dx=flight.recording.log.dt, axis=0, initial=0.0)
    expected = LowpassDifference(10.0).estimate(v - explained, flight.recording.log.dt)
    np.testing.assert_allclose(flight.estimates["phyfilter_1"], expected, atol=ROUNDING)


def test_scores_are_those_of_all_samples_after_the_start_up(dragged: tuple[Path, Path]):
    result = replay.replay(list(dragged), start_up=3.0)
    errors = [
        (each.estimates["type_2"] - each.recording.label)[each.recording.log.times >= 3.0 - 1e-6]
        for each in result.flights
    ]
    assert result.scores["type_2"].total == pytest.approx(
        np.sqrt(np.mean(np.concatenate(errors) ** 2)), rel=1e-12
    )
    for each, error in zip(result.flights, errors, strict=True):
        assert each.scores["type_2"].axes == pytest.approx(np.sqrt(np.mean(error**2, axis=0)), rel=1e-12)


def test_noise_costs_the_difference_ahead_more_than_against_its_own_label(steady: Made, tmp_path: Path):
    """A label made of the noisy velocity: the plain difference wins against it, and loses where it must predict."""
    rng = np.random.default_rng(5)
    n = len(steady.columns["t"])
    v = stacked(steady.columns, "vx vy vz") + 0.01 * rng.standard_normal((n, 3))
    clean = recordings.read(steady.write(tmp_path / "clean.csv"))
    slope = np.gradient(v, H, axis=0)
    slope[2:-2] = (v[:-4] - 8.0 * v[1:-3] + 8.0 * v[3:-1] - v[4:]) / (12.0 * H)
    fa = MASS * (slope - clean.g)
    changed = {
        f"{s}{axis}": values[:, i] for s, values in (("v", v), ("fa", fa)) for i, axis in enumerate("xyz")
    }
    result = replay.replay([steady.write(tmp_path / "noisy.csv", **changed)])
    scores = result.scores
    assert result.flights[0].recording.misfit < ROUNDING
    assert scores["difference"].ahead > 3.0 * scores["phyfilter_1"].ahead
    assert scores["difference"].total < scores["difference"].ahead
    assert "no sensor of its own" in replay.table(result)


def test_model_learned_on_one_flight_helps_on_another(dragged: tuple[Path, Path]):
    learn, test = dragged
    result = replay.replay([test], train=[learn])
    assert list(result.scores) == [
        "zero",
        "difference",
        "lowpass",
        "mean",
        "model",
        "phyfilter_1",
        "phyfilter_1+model",
        "type_2",
        "type_2+model",
    ]
    assert result.train == ("learn",)
    assert result.scores["model"].total < 0.2 * result.scores["mean"].total
    assert result.scores["phyfilter_1+model"].total < 0.2 * result.scores["phyfilter_1"].total


def test_fitted_model_is_used_as_it_is(dragged: tuple[Path, Path]):
    rng = np.random.default_rng(0)
    z = rng.uniform(-20.0, 20.0, (500, 6))
    fitted = Chebyshev(1, n_d=0).fit(z, -0.6 * z[:, :3]).model
    result = replay.replay([dragged[1]], model=fitted, mass=MASS)
    assert result.model is fitted
    assert result.fit is None
    assert "mean" not in result.scores
    assert result.scores["model"].total < INTEGRATED
    with pytest.raises(ValueError, match="no coefficients yet"):
        replay.replay([dragged[1]], model=Chebyshev(1, n_d=0))


def test_model_of_another_width_is_refused(dragged: tuple[Path, Path]):
    rng = np.random.default_rng(0)
    z = rng.standard_normal((50, 6))
    with pytest.raises(ValueError, match=r"model: expected f_theta of shape \(501, 3\)"):
        replay.replay([dragged[1]], model=Chebyshev(1, n_d=0).fit(z, z[:, :2]).model)


def test_filters_as_given(dragged: tuple[Path, Path]):
    plain = PhyFilter([4.0])
    sampled = plain.sampled(H * 1.001, g="average")  # nominal interval: the recorded times count
    result = replay.replay([dragged[0]], filters={"plain": plain, "sampled": sampled})
    estimates = result.flights[0].estimates
    np.testing.assert_allclose(estimates["sampled"], estimates["plain"], atol=ROUNDING)
    assert "phyfilter_1" not in result.scores


# -- text, JSON and picture -----------------------------------------------------------------------------------------


def test_table_names_every_method_and_flight(dragged: tuple[Path, Path]):
    text = replay.table(replay.replay([dragged[1]], train=[dragged[0]], thrust_delay=0.01))
    for part in (
        "1 recorded flights, 501 samples, thrust taken 10 ms late",
        "PhyFilter, n = 2, type 2 + learned model",
        "\ntest ",
        "Model learned from learn",
        "0.2 s ahead",
    ):
        assert part in text


def test_table_does_not_call_another_label_a_difference(steady: Made, tmp_path: Path):
    rng = np.random.default_rng(1)
    noisy = {
        name: steady.columns[name] + 0.1 * rng.standard_normal(len(steady.columns["t"]))
        for name in ("fax", "fay", "faz")
    }
    result = replay.replay([steady.write(tmp_path / "sensor.csv", **noisy)])
    assert "no sensor of its own" not in replay.table(result)
    assert replay.figures(result)["label_repeats_difference"] is False


def test_figures_are_json_and_hold_the_scores(dragged: tuple[Path, Path]):
    result = replay.replay([dragged[1]], train=[dragged[0]])
    back = json.loads(json.dumps(replay.figures(result), allow_nan=False))
    assert back["scores"]["type_2"]["total"] == result.scores["type_2"].total
    assert back["scores"]["zero"]["z"] == result.scores["zero"].axes[2]
    assert back["flights"][0]["scores"]["model"]["ahead"] == result.flights[0].scores["model"].ahead
    assert back["training"]["flights"] == ["learn"]
    assert len(back["flights"][0]["thrust_late"]["delays"]) == len(back["flights"][0]["thrust_late"]["rms"])


def test_score_that_diverged_is_infinite(steady_path: Path):
    result = replay.replay([steady_path])
    broken = replace(result, scores={"zero": replace(result.scores["zero"], total=float("inf"))})
    scores = json.loads(json.dumps(replay.figures(broken), allow_nan=False))["scores"]
    assert scores["zero"]["total"] == "Infinity"


@pytest.mark.slow
def test_picture(dragged: tuple[Path, Path], tmp_path: Path):
    result = replay.replay([dragged[1]], train=[dragged[0]])
    figure = replay_picture.draw(result)
    assert not faults(figure)
    target = tmp_path / "replay.png"
    figure.savefig(target)
    assert target.stat().st_size > 10_000
    names = [text.get_text() for text in figure.axes[2].get_yticklabels()]
    assert names[0] == "no estimate (0)"
    assert len(names) == len(result.scores)


# -- bad input ------------------------------------------------------------------------------------------------------


def with_nan(values: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(values)) == 7, np.nan, values)


def gap(t: np.ndarray) -> np.ndarray:
    return t + 0.5 * (t > 4.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda c: {"faz": None},
            r"flight\.csv: no column 'faz' \(label\).*A replay takes the columns t, vx",
        ),
        (lambda c: {"hover_throttle": None}, r"flight\.csv: no column 'hover_throttle'"),
        (lambda c: {"t": None}, r"flight\.csv: no column 't' \(time\)"),
        (lambda c: {"vy": with_nan(c["vy"])}, r"flight\.csv: .*got nan in line 9, column 'vy'"),
        (lambda c: {"t": gap(c["t"])}, r"flight\.csv: column 't' is not regular.*after t = 4 s is 0\.52 s"),
        (lambda c: {"t": 0.1 * c["t"]}, r"flight\.csv: lasts 1 s, expected at least 5 s"),
        (
            lambda c: {"t": 5.0 * c["t"]},
            r"flight\.csv: column 't' has steps of 0\.1 s, expected at most 0\.05 s",
        ),
        (lambda c: {"qw": 1.1 * c["qw"]}, r"flight\.csv: qx qy qz qw at t = 0 s: expected unit length"),
        (
            lambda c: {"hover_throttle": 0.0 * c["t"]},
            r"hover_throttle at t = 0 s: expected a positive throttle",
        ),
        (lambda c: {"T_sp": c["T_sp"] - c["t"]}, r"T_sp at t = 0\.46 s: expected a throttle of 0 or more"),
        (lambda c: dict.fromkeys(("fax", "fay", "faz"), 0.0 * c["t"]), r"zero throughout"),
    ],
)
def test_bad_recordings_name_file_and_place(
    steady: Made,
    tmp_path: Path,
    change: Callable[[Mapping[str, np.ndarray]], dict[str, np.ndarray | None]],
    message: str,
):
    path = steady.write(tmp_path / "flight.csv", **change(steady.columns))
    with pytest.raises(ValueError, match=message):
        replay.replay([path])


def test_times_printed_with_few_digits_are_regular(steady: Made, tmp_path: Path):
    rounded = steady.write(tmp_path / "rounded.csv", t=np.round(steady.columns["t"] + 1e-4 * 3.3, 3))
    assert recordings.read(rounded).log.is_uniform


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"thrust_delay": -0.01}, "thrust_delay: expected 0 s or more"),
        ({"start_up": float("nan")}, "start_up: expected 0 s or more"),
        ({"horizon": 0.0}, "horizon: expected a positive number of seconds"),
        ({"mass": -1.0}, "mass: expected a positive number of kg"),
        ({"filters": {"zero": PhyFilter([1.0])}}, "filters: 'zero' names another method"),
        ({"filters": {"a+model": PhyFilter([1.0])}}, r"filters: 'a\+model' names another method"),
        ({"filters": {"slow": PhyFilter([1.0]).sampled(0.002)}}, "filter 'slow' is sampled every 0.002 s"),
    ],
)
def test_bad_options(steady_path: Path, options: dict[str, object], message: str):
    with pytest.raises(ValueError, match=message):
        replay.replay([steady_path], **options)


def test_a_flight_counts_once(steady_path: Path):
    with pytest.raises(ValueError, match=r"steady\.csv: given twice; a test on training data"):
        replay.replay([steady_path], train=[str(steady_path)])
    with pytest.raises(ValueError, match="expected at least one recorded flight"):
        replay.replay([])
    with pytest.raises(OSError, match="nowhere"):
        replay.replay(["nowhere.csv"])
