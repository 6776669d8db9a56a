"""Estimate: what is said without labels holds against the force that the recording was made with."""

from __future__ import annotations

import json

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl.baselines import MomentumObserver, compare
from phyfilter_ctl.estimation.smoothing import rauch_tung_striebel
from phyfilter_ctl.estimation.spectrum import noise_level
from phyfilter_ctl.estimation.steps import steps_of

H = 0.004


def flight(
    noise: float, *, seed: int = 0, force: float = 1.0, seconds: float = 40.0, irregular: bool = False
) -> pf.Recording:
    """Gauss-Markov force (0.5 s) and two sines on x' = f, integrated on a grid five times as fine."""
    rng, fine = np.random.default_rng(seed), 5
    count = round(seconds / H) * fine
    t = H / fine * np.arange(count + 1)
    fall = np.exp(-H / fine / 0.5)
    walk = lfilter([1.0], [1.0, -fall], np.sqrt(1.0 - fall**2) * rng.standard_normal(count + 1))
    f = force * (walk + np.sin(3.0 * t) + 0.5 * np.sin(8.0 * t))
    x = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * H / fine)])
    at = np.arange(0, count + 1, fine)
    if irregular:
        at[1:-1] += rng.integers(-1, 2, len(at) - 2)
        at = np.delete(at, [*range(3000, 3020), *rng.integers(1, len(at) - 1, 100)])
    v = x[at] + noise * rng.standard_normal(len(at))
    return pf.Recording(t[at], v, label=f[at], channels=["v"], unit="m/s")


def rmse(log: pf.Recording, filter: pf.PhyFilter) -> float:
    f_hat = filter.sampled(log.dt).run(log.x, times=log.times)
    assert log.label is not None
    return float(np.sqrt(np.mean((f_hat - log.label)[1:] ** 2)))


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("noise", [pytest.param(0.002, marks=pytest.mark.slow), 0.02])
@pytest.mark.parametrize("irregular", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_suggested_filter_is_the_labelled_optimum(order: int, noise: float, irregular: bool) -> None:
    log = flight(noise, irregular=irregular)
    best = pf.estimate(log.with_signals(label=None), orders=[order]).suggestion
    rivals = [
        rmse(log, pf.lowpass(order, w, family="butterworth"))
        for w in best.bandwidth * np.geomspace(0.5, 2.0, 41)
    ]
    assert rmse(log, best.filter) <= 1.01 * min(rivals)


def test_noise_level_within_its_interval() -> None:
    """Of 20 intervals of 95 % at least 16 hold the truth: fewer happen once in 2,000 times."""
    held, any_filter = [], pf.PhyFilter([1.0]).sampled(H)
    for seed in range(20):
        found = noise_level(steps_of([flight(0.01, seed=seed, seconds=4.0)], any_filter), 0.95)
        held.append(bool(found.low[0] < 0.01 < found.high[0]))
    assert sum(held) >= 16


def test_expected_error_and_noise_band() -> None:
    log = flight(0.01)
    found = pf.estimate(log, pf.PhyFilter([20.0]))
    assert found.error.low < rmse(log, pf.PhyFilter([20.0])) < found.error.high
    still = log.with_signals(label=None)
    only = pf.Recording(log.times, log.x - flight(0.0).x, channels=["v"])
    assert np.std(found.filter.run(only.x)) == pytest.approx(found.noise_deviation[0], rel=0.05)
    assert pf.estimate(still, pf.PhyFilter([20.0])).error == found.error  # the label is not looked at


def test_a_filter_for_another_rate_is_told() -> None:
    log, F = flight(0.01, seconds=4.0), pf.PhyFilter([20.0])
    same, other = (pf.estimate(log, F.sampled(dt)) for dt in (H, 5.0 * H))
    assert not any("made for steps" in note for note in same.notes)
    assert "made for steps of 0.02 s and the recordings have 0.004 s" in other.notes[0]
    np.testing.assert_allclose(other.noise_deviation, same.noise_deviation)
    np.testing.assert_allclose(other.f_hat[0], same.f_hat[0], atol=1e-9)


def test_prediction_improves_on_none_where_there_is_a_force_alone() -> None:
    there = pf.estimate(flight(0.01)).prediction
    assert there.improves
    assert there.filter < 0.8 * there.model == 0.8 * there.still
    nothing = pf.estimate(flight(0.01, force=0.0))
    assert not nothing.prediction.improves
    assert nothing.suggestion.status == "not_identified"
    assert nothing.spectrum.crossing == 0.0
    assert any("nothing to estimate" in note for note in nothing.notes)


def test_a_model_that_is_right_leaves_nothing() -> None:
    log = flight(0.01)
    found = pf.estimate(log.with_signals(f_theta=log.label), pf.PhyFilter([5.0]))
    assert found.explained_by_model > 0.99
    assert found.missed[0] < 0.1 * np.std(log.label)
    assert not found.prediction.improves
    assert found.prediction.model < 0.2 * found.prediction.still


def test_inertia_scales_what_has_the_unit_of_f_alone() -> None:
    log = flight(0.01)
    one, two = (
        pf.estimate(pf.Recording(log.times, log.x, inertia=m), pf.PhyFilter([9.0])) for m in (1.0, 2.0)
    )
    np.testing.assert_allclose(two.noise.value, 2.0 * one.noise.value)
    np.testing.assert_allclose(two.missed, 2.0 * one.missed)
    assert two.prediction.model == pytest.approx(one.prediction.model)


@pytest.mark.slow
def test_smoothed_white_noise_is_noticed() -> None:
    log = flight(0.01)
    assert pf.estimate(log).noise.is_white
    coloured = lfilter([0.1], [1.0, -0.9], log.x, axis=0)
    found = pf.estimate(pf.Recording(log.times, coloured))
    assert not found.noise.is_white
    assert "not white" in found.notes[0]


def test_many_recordings_gaps_and_json() -> None:
    logs = [flight(0.01, seed=seed, seconds=3.0) for seed in range(5)]
    held = logs[0][:300], logs[0][400:]
    found = pf.estimate([*held, *logs[1:]])
    assert [len(f_hat) for f_hat in found.f_hat] == [log.n for log in found.recordings]
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["spectrum"]["bands"]
    assert len(repr(found).splitlines()) < 40
    plain, hertz = (found.plot(1, Hz=Hz) for Hz in (False, True))
    assert plain.axes.shape == (2, 1)
    assert hertz.axes[1, 0].get_xlabel() == "Frequency [Hz]"
    area = [
        np.trapezoid(drawn.get_ydata(), drawn.get_xdata())
        for drawn in (p.lines[1, 0][0] for p in (plain, hertz))
    ]
    assert area[1] == pytest.approx(area[0]), "densities are per unit of the axis"


@pytest.mark.parametrize("what", ["missing", "a day's gap", "1e99", "1e-99"])
def test_what_recordings_are_like(what: str) -> None:
    log = flight(0.01, seconds=8.0)
    times, x, unit = log.times.copy(), log.x.copy(), 1.0
    if what == "missing":
        x[::50] = np.nan
    elif what == "a day's gap":
        times[1000:] += 86400.0
    else:
        unit = float(what)
    found = pf.estimate(pf.Recording(times, unit * x, nonfinite="keep"), pf.PhyFilter([20.0]))
    alike = pf.estimate(log, pf.PhyFilter([20.0]))
    assert found.noise.value[0] == pytest.approx(unit * alike.noise.value[0], rel=0.1)
    assert found.missed[0] == pytest.approx(unit * alike.missed[0], rel=0.1)
    assert found.error.value == pytest.approx(unit * alike.error.value, rel=0.2)
    smoothed = pf.smooth_label(found.recordings[0]).recording.label
    assert smoothed is not None
    assert log.label is not None
    assert np.std(smoothed / unit - log.label) < 0.5 * np.std(log.label)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([],), "at least one"),
        (([flight(0.01, seconds=0.2)],), "at least 100 steps"),
        (([flight(0.01), pf.Recording([0.0, 1.0], [0.0, 1.0])],), "one robot's"),
        ((pf.Recording.from_arrays(x=np.ones(500), dt=0.1),), "constant throughout"),
        ((flight(0.01), pf.PhyFilter([1.0]).sampled(H, E=[[1.0]])), "without a direction E"),
    ],
)
def test_what_cannot_be_is_refused(arguments: tuple[object, ...], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        pf.estimate(*arguments)  # type: ignore[arg-type]


# -- the label from both sides ---------------------------------------------------------------------------------------


def dense(
    h: NDArray[np.float64], rise: NDArray[np.float64], s: float, walk: float
) -> tuple[NDArray, NDArray]:
    """The same smoother as one least-squares problem: z_0 = 0, measured sums of rises, f_0 free."""
    m = len(h)
    rows, right = [], []
    z = np.concatenate([[0.0], np.cumsum(rise)])
    for k in range(m + 1):
        row = np.zeros(2 * m + 2)
        row[2 * k] = 1.0 / s
        rows.append(row)
        right.append(z[k] / s)
    for k, step in enumerate(h):
        Q = walk**2 * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
        white = np.linalg.inv(np.linalg.cholesky(Q))
        block = np.zeros((2, 2 * m + 2))
        block[:, 2 * k : 2 * k + 2] = -white @ [[1.0, step], [0.0, 1.0]]
        block[:, 2 * k + 2 : 2 * k + 4] = white
        rows += list(block)
        right += [0.0, 0.0]
    A = np.array(rows)
    solved = lstsq(A, np.array(right))
    assert solved is not None
    return solved[0][1::2], np.sqrt(np.diag(np.linalg.inv(A.T @ A)))[1::2]


def test_smoother_beside_dense_least_squares() -> None:
    rng = np.random.default_rng(3)
    h = rng.uniform(0.5, 2.0, 60) * 0.01
    rise = 0.02 * rng.standard_normal(60)
    force, deviation = rauch_tung_striebel(h, rise, 0.01, 3.0)
    expected, width = dense(h, rise, 0.01, 3.0)
    np.testing.assert_allclose(force, expected, atol=1e-5 * np.max(np.abs(expected)))
    np.testing.assert_allclose(deviation, width, rtol=1e-5)


@pytest.mark.parametrize("irregular", [False, True])
def test_label_covers_the_truth_at_its_deviation(irregular: bool) -> None:
    """A random walk: 68.3 and 95.4 %; the samples of a walk are as good as some hundred independent ones here."""
    rng = np.random.default_rng(1)
    h = H * (rng.uniform(0.5, 1.5, 8000) if irregular else np.ones(8000))
    white = rng.standard_normal((2, 8000))
    step = 2.0 * np.sqrt(h) * white[0]
    f = np.concatenate([[1.0], 1.0 + np.cumsum(step)])
    # Over a step the integral of the walk deviates from its straight line by 2 sqrt(h^3 / 12).
    x = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * h + 2.0 * np.sqrt(h**3 / 12.0) * white[1])])
    times = np.concatenate([[0.0], np.cumsum(h)])
    found = pf.smooth_label(pf.Recording(times, x + 0.005 * rng.standard_normal(len(x))))
    assert found.noise[0] == pytest.approx(0.005, rel=0.03)
    assert found.walk[0] == pytest.approx(2.0, rel=0.1)
    assert found.recording.label is not None
    error = np.abs(found.recording.label[:, 0] - f) / found.deviation[:, 0]
    assert np.mean(error < 1.0) == pytest.approx(0.683, abs=0.05)
    assert np.mean(error < 2.0) == pytest.approx(0.954, abs=0.02)


# -- others ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_six_line_momentum_observer_is_as_good_on_a_known_arm() -> None:
    """One joint, inertia 0.4 + 0.1 cos q, gravity and motor torque known, a contact torque of 2 N m that is not."""
    dt, rng = 0.004, np.random.default_rng(0)
    t = dt * np.arange(1200)
    q, qd = 0.5 * np.sin(2.0 * t), np.cos(2.0 * t)
    M, dM = 0.4 + 0.1 * np.cos(q), -0.1 * np.sin(q) * qd
    contact = np.where((t > 1.0) & (t < 3.5), 2.0, 0.0)
    gravity = 3.0 * np.sin(q)
    torque = M * -2.0 * np.sin(2.0 * t) + 0.5 * dM * qd + gravity - contact
    measured = qd + 0.002 * rng.standard_normal(len(t))
    known = torque + 0.5 * dM * measured - gravity
    p = M * measured

    gain, total, residual = 20.0, 0.0, np.zeros(len(t))
    for k in range(1, len(t)):
        total += dt * (known[k - 1] + residual[k - 1])
        residual[k] = gain * (p[k] - p[0] - total)

    log = pf.Recording(t, p, g=known, label=contact, unit="kg m^2/s")
    ours = MomentumObserver(gain, dt).run(log.x, log.g)[:, 0]
    errors = [np.sqrt(np.mean((each - contact) ** 2)) for each in (residual, ours)]
    assert errors[1] == pytest.approx(errors[0], rel=0.1)
    found = compare(log, pf.PhyFilter([gain]), max_evaluations=5)
    name = next(name for name in found.rmse if name.startswith("momentum observer"))
    assert found.ratio[name].value < 1.05
    assert found.against == "the label"


@pytest.mark.slow
def test_comparison_without_a_label() -> None:
    log = flight(0.01, seconds=8.0).with_signals(label=None)
    found = compare(log, max_evaluations=5)
    assert found.rmse["difference"] > found.rmse["filter"]
    assert set(found.ratio) | {"filter"} == set(found.rmse) == set(found.tuned)
    assert "filter" in found.verdict
