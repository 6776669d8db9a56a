"""Labels that have no mean and are still wrong, and a g that acts late: said by whatever reads the recording."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

import phyfilter_ctl as pf
from phyfilter_ctl.recording.agreement import lag_sums, late_g

H, FINER, N = 0.01, 10, 4000
NAMES = ("vx", "vy")
QUICK = pf.Search(starts=0, cross_validate=False)


def coloured(rng, n, h, time):
    """Of variance 1 about a mean of 0."""
    keep = np.exp(-h / time)
    found = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal((n, 2)), axis=0)
    return found - found.mean(axis=0)


def flight(seed=0, *, late=0.0, compensated=0.0, damped=0.0, noise=2e-3):
    """x' = g(t - late) + f in two channels; g of a course, of f_hat and of velocity, measured with its noise."""
    rng = np.random.default_rng(seed)
    f, course = coloured(rng, N * FINER, H / FINER, 0.3), 3.0 * coloured(rng, N, H, 0.5)
    wait = round(late / H * FINER)
    x, f_hat, held = np.zeros((N, 2)), np.zeros(2), np.zeros((N * FINER + wait, 2))
    g, now, last = np.zeros((N, 2)), np.zeros(2), np.zeros(2)
    for k in range(N):
        x[k] = now + noise * rng.standard_normal(2)
        if k:
            f_hat += (1.0 - np.exp(-20.0 * H)) * ((x[k] - last) / H - g[k - 1] - f_hat)
        last, rows = x[k], slice(k * FINER, (k + 1) * FINER)
        g[k] = course[k] - compensated * f_hat - damped * x[k]
        held[wait:][rows] = g[k]
        now = now + H * (held[rows] + f[rows]).mean(axis=0)
    return {"x": x, "dt": H, "g": g, "label": f[::FINER], "channels": NAMES}


GOOD = flight()
WRONG = {
    "label times 1000": (
        GOOD | {"label": 1e3 * GOOD["label"]},
        "v[xy] is M x' - g times (999|1e\\+03) .* another unit of x, M",
    ),
    "sign": (GOOD | {"label": -GOOD["label"]}, "v[xy] is of the other sign"),
    "x in mm/s": ({**GOOD, "x": 1e3 * GOOD["x"], "g": None}, r"v[xy] is M x' - g times 0\.00"),
    "channels": (
        GOOD | {"label": GOOD["label"][:, ::-1]},
        "label of v[xy] goes with M x' - g of v[xy] .*permuted",
    ),
    "times in ms": (
        GOOD | {"dt": 1e3 * H, "g": None},
        "v[xy] is M x' - g times .* times in ms, of which steps are 10 s",
    ),
}


@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_label_without_a_mean_is_told(fault):
    signals, words = WRONG[fault]
    if signals["g"] is None:  # a flight without g, of which x' is f
        f = signals["label"]
        x = np.cumsum(0.5 * H * (f + np.roll(f, 1, axis=0)), axis=0) * (1e3 if fault == "x in mm/s" else 1.0)
        signals = signals | {"x": x + 1e-3 * np.std(x) * np.random.default_rng(1).standard_normal(x.shape)}
    log = pf.Recording.from_arrays(**signals)
    with pytest.warns(UserWarning, match=words):
        found = pf.learn(log, 1, search=QUICK)
    assert any("the label of" in note for note in found.notes)


def test_one_wrong_flight_among_good_ones_is_told():
    logs = [pf.Recording.from_arrays(**(flight(seed) | {"name": str(seed)})) for seed in range(3)]
    logs[1] = logs[1].with_signals(label=1e3 * logs[1].label)
    with pytest.warns(UserWarning, match=r"times (999|1e\+03) .* \(in 1 of 3 flights\)"):
        pf.learn(logs, 1, search=QUICK)


@pytest.mark.parametrize(
    "loop",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"compensated": 1.0}, marks=pytest.mark.slow),
        pytest.param({"damped": 6.0}, marks=pytest.mark.slow),
        {"compensated": 0.7, "damped": 3.0},
    ],
)
@pytest.mark.parametrize(
    "noise",
    [pytest.param(1e-5, marks=pytest.mark.slow), 2e-3, pytest.param(2e-2, marks=pytest.mark.slow)],
)
def test_sound_recordings_in_and_out_of_loops_raise_no_alarm(loop, noise):
    log = pf.Recording.from_arrays(**flight(3, noise=noise, **loop))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pf.learn(log, 1, search=QUICK).notes == ()
    assert not [note for note in pf.estimate(log).notes if "late" in note]
    assert "late_g" not in [finding.suspicion for finding in log.check()]
    assert "late_g" not in [finding.suspicion for finding in log.with_signals(label=None).check()]


@pytest.mark.parametrize(
    "loop", [pytest.param({}, marks=pytest.mark.slow), {"compensated": 1.0, "damped": 3.0}]
)
def test_a_late_g_is_told_by_learn_estimate_and_the_check(loop):
    log = pf.Recording.from_arrays(**flight(4, late=0.02, **loop))
    with pytest.warns(UserWarning, match="g of v[xy] seems late by 20 ms"):
        pf.learn(log, 1, search=QUICK)
    bare = log.with_signals(label=None)
    assert any("g of vx seems late by 20 ms" in note for note in pf.estimate(bare).notes)
    for each in (log, bare):
        assert "late_g" in [finding.suspicion for finding in each.check()]


def test_delays_between_samples_and_uneven_steps():
    late = flight(5, late=0.025)
    u = np.diff(late["x"], axis=0) / H - late["g"][:-1]
    (found, _) = (late_g([sums], 1.0) for sums in lag_sums(u, late["g"][:-1], H))
    assert found is not None
    assert found.delay == pytest.approx(0.025, abs=0.0025)  # a quarter of a step
    assert found.gain == pytest.approx(1.0, abs=0.05)
    rows = np.random.default_rng(6).random(N) > 0.1
    log = pf.Recording(H * np.arange(N)[rows], late["x"][rows], g=late["g"][rows], channels=NAMES)
    assert any("g of vx seems late by" in note for note in pf.estimate(log).notes)


def test_estimate_asks_for_the_step_of_recordings_of_two_rates():
    one = pf.Recording.from_arrays(**GOOD | {"label": None})[:1500]
    two = one.decimate(2)
    with pytest.raises(
        ValueError, match=r"their steps differ, 0\.01 s to 0\.02 s .* Give estimate\(\.\.\., dt=\)"
    ):
        pf.estimate([one, two])
    assert pf.estimate([one, two], orders=[1], dt=0.01).filter.dt == 0.01
    filter = pf.PhyFilter([20.0])
    assert pf.estimate([one, two], filter.sampled(0.02), orders=[1]).filter.dt == 0.02
    with pytest.raises(ValueError, match="dt: expected it without a sampled filter"):
        pf.estimate(one, filter.sampled(0.02), dt=0.01)
