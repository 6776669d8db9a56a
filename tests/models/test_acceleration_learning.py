"""The acceleration study with learned filters: the points on the map, and two ways down from the same starts."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, models
from phyfilter_ctl.cli import main
from phyfilter_ctl.recording import Recording

ROOM = f"{models.__name__}.acceleration"
experiment = importlib.import_module(f"{ROOM}.experiment")
learning = importlib.import_module(f"{ROOM}.learning")
params = importlib.import_module(f"{ROOM}.params")
study = importlib.import_module(f"{ROOM}.study")
tuning = importlib.import_module(f"{ROOM}.tuning")

# Descents end where a step promises 1e-10 of the cost; the square root of that, and some.
SETTLED = 1e-4
# The simplex of the tuner is coarser than learning, and searches the same low-pass filters.
NO_WORSE = 1e-3


def case(seed: int, *, n: int = 900, noise: float = 0.02, truth: PhyFilter | None = None):
    """A random velocity and estimate; the label is what a known filter makes of them, and noise."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(0.05 * rng.standard_normal((n, 3)), axis=0)
    f_theta = rng.standard_normal((n, 3))
    truth = PhyFilter([90.0, 21.0]) if truth is None else truth
    label = truth.sampled(0.01).run(x, f_theta=f_theta) + noise * rng.standard_normal((n, 3))
    return tuning.Case(Recording.from_arrays(x=x, dt=0.01, label=label), f_theta)


def sine_flight(speed: float, *, seed: int = 0, n: int = 300) -> Recording:
    t = 0.01 * np.arange(n)[:, None]
    omega = np.array([2.0, 3.0, 4.0])
    noise = 0.002 * np.random.default_rng(seed).standard_normal((n, 3))
    return Recording.from_arrays(
        x=speed * np.sin(omega * t + seed) + noise,
        dt=0.01,
        label=speed * omega * np.cos(omega * t + seed),
        name=f"sine {seed}",
        channels=("vx", "vy", "vz"),
    )


@pytest.fixture(scope="module")
def quick() -> experiment.Comparison:
    train = [sine_flight(v, seed=i) for i, v in enumerate((0.5, 0.7, 0.9, 1.0))]
    return experiment.compare(train, [sine_flight(1.5, seed=9)], data="recorded", effort=experiment.QUICK)


@pytest.mark.slow
def test_filters_that_made_the_labels_are_learned():
    found = learning.learn_filters([case(0, noise=0.0), case(1, noise=0.0)], [1, 2])
    np.testing.assert_allclose(found[2, "lowpass"].filter.a, [90.0, 21.0], rtol=1e-6)
    np.testing.assert_allclose(found[2, "general"].filter.b, [90.0, 0.0], rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_start_of_a_flight_is_left_out():
    clean, spoilt = case(2), case(2)
    label = np.array(spoilt.log.label)
    label[: tuning.counted(spoilt.log).start] += 50.0
    spoilt = tuning.Case(spoilt.log.with_signals(label=label), spoilt.f_theta)
    one, other = (learning.learn_filters([entry], [2])[2, "lowpass"].filter for entry in (clean, spoilt))
    np.testing.assert_allclose(one.a, other.a, rtol=1e-6)


@pytest.mark.release
def test_learned_filters_are_no_worse_than_tuned_ones(quick):
    points = {(point.order, point.form): point for point in study.order_by_pole(quick).learned}
    assert list(points) == [(n, form) for n in (1, 2, 3) for form in ("lowpass", "general")]
    for n, tuned in quick.learned.filters.items():
        assert points[n, tuned.form].tuning_rmse <= tuned.tuning_rmse * (1.0 + NO_WORSE)
        # The general form contains the lower orders, and the low-pass form of its own.
        assert points[n, "general"].tuning_rmse <= points[n, "lowpass"].tuning_rmse * (1.0 + SETTLED)
    point = points[1, "lowpass"]
    assert point.pole == pytest.approx(abs(point.result.filter.poles[0]))
    f_hat = tuning.filtered(point.result.filter, quick.test_cases(), quick.dt)
    assert point.test_rmse == tuning.rmse(f_hat, quick.test)


@pytest.mark.slow
def test_learning_comes_down_from_every_start():
    cases = [case(3), case(4)]
    found = learning.convergence(cases, 0.01, orders=(1, 2), starts=3, seconds=0.05)
    assert [descent.order for descent in found.learned] == [1, 1, 1, 2, 2, 2]
    assert found.rates == {1: params.params().convergence.rates[0], 2: params.params().convergence.rates[1]}
    for ours, adam in zip(found.learned, found.adam, strict=True):
        assert ours.start == adam.start
        for descent in (ours, adam):
            assert np.all(np.diff(descent.rmse) <= 0.0)
            assert np.all(np.diff(descent.times) >= 0.0)
            assert np.all(descent.rmse <= descent.start)
    for n in (1, 2):
        ends = [descent.rmse[-1] for descent in found.learned if descent.order == n]
        np.testing.assert_allclose(ends, ends[0], rtol=SETTLED)
    # Nothing but the noise on the label is left: its deviation, to four standard errors of 5000 samples.
    assert found.learned[-1].rmse[-1] == pytest.approx(0.02, rel=4.0 / np.sqrt(2.0 * 5394))
    # The same starts again from the same seed.
    again = learning.convergence(cases, 0.01, orders=(1, 2), starts=3, seconds=0.01)
    assert [d.start for d in again.learned] == [d.start for d in found.learned]


def test_adam_comes_down_too():
    """The paper's algorithm at order 1, where its rate is easy: more than half of the way in half a second."""
    found = learning.convergence([case(5)], 0.01, orders=(1,), starts=1, seconds=0.5)
    (ours,), (adam,) = found.learned, found.adam
    assert adam.rmse[-1] < 0.5 * (adam.start + ours.rmse[-1])
    assert ours.rmse[-1] <= adam.rmse[-1]


def test_irregular_recordings_are_resampled():
    regular = case(6)
    rng = np.random.default_rng(7)
    times = regular.log.times + 0.001 * rng.uniform(-1.0, 1.0, regular.log.n)
    log = Recording(times, regular.log.x, label=regular.log.label)
    found = learning.convergence(
        [tuning.Case(log, regular.f_theta)], 0.01, orders=(1,), starts=1, seconds=0.01
    )
    assert np.isfinite(found.learned[0].rmse[-1])
    assert found.learned[0].status == "converged"


@pytest.mark.slow
def test_command_writes_the_convergence(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for i, speed in enumerate((0.5, 0.7, 0.9, 1.5)):
        log = sine_flight(speed, seed=i)
        table = np.hstack([log.times[:, None], log.x, log.label])
        np.savetxt(f"{i}.csv", table, delimiter=",", header="t,vx,vy,vz,ax,ay,az", comments="")
    flights = ["--train", "0.csv", "1.csv", "2.csv", "--test", "3.csv"]
    options = ["--quick", "--quiet", "--json", "figures.json", "--picture", "picture.png"]
    assert main(["run", "acceleration", *flights, *options, "--convergence"]) == 0
    figures = json.loads(Path("figures.json").read_text())
    assert list(figures["study"]) == ["convergence"]
    found = figures["study"]["convergence"]
    assert [len(found[way]) for way in ("learned", "adam")] == [6, 6]
    assert set(found["rates"]) == {"1", "2", "3"}
    assert Path("picture.png").read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
