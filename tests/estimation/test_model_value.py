"""What a model is worth, found without labels, against the force that made the recordings."""

import control as ct
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import lfilter

from phyfilter_ctl import PhyFilter, Recording, model_value

H = 0.01
FILTER = PhyFilter([4.0])
NOISE = 3e-4


def markov(rng, rate, deviation, n=6000):
    keep = np.exp(-rate * H)
    return deviation * lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal((n, 1)), axis=0)


def recorded(f, f_theta, rng, noise=NOISE):
    v = H * np.cumsum(np.vstack([[[0.0]], 0.5 * (f[1:] + f[:-1])]), axis=0)
    return Recording.from_arrays(x=v + noise * rng.standard_normal(f.shape), f_theta=f_theta, dt=H)


def valued(log, **options):
    return model_value(log, FILTER, **{"noise": NOISE, "orders": (1,), **options})


@pytest.fixture(scope="module")
def case():
    rng, keep = np.random.default_rng(0), np.exp(-30.0 * H)
    # Smooth beside the step: a Markov force as it is changes within it by more than a fast filter leaves.
    f, missed = (
        lfilter([1.0 - keep], [1.0, -keep], force, axis=0)
        for force in (markov(rng, 3.0, 2.0), markov(rng, 2.0, 1.0))
    )
    return f, (log := recorded(f, f - missed, rng)), valued(log)


def errors(case, filter):
    """f - f_hat with the model and without it, start-up left out."""
    f, log, _ = case
    sampled = filter.sampled(H)
    return [(f - sampled.run(log.x, None, model))[200:] for model in (log.f_theta, None)]


def rms(e):
    return float(np.sqrt(np.mean(e**2)))


def test_the_ratio_is_that_of_the_errors(case):
    with_model, without = map(rms, errors(case, FILTER))
    found = case[2]
    assert found.ratio.low < with_model / without < found.ratio.high
    assert found.ratio.high - found.ratio.low < 0.3 * found.ratio.value
    assert found.error.low < with_model < found.error.high
    assert found.error_without.low < without < found.error_without.high
    assert found.pays
    assert found.best_ratio.value < 1.0


def test_the_faster_filter_errs_as_little_without_the_model(case):
    k = case[2].speed
    aim = rms(errors(case, FILTER)[0])
    # Found by expected errors, which are sure to some 5 %.
    assert rms(errors(case, PhyFilter([4.0 * k]))[1]) == pytest.approx(aim, rel=0.1)
    assert rms(errors(case, PhyFilter([2.0 * k]))[1]) > 1.2 * aim
    # By the transforms of the true forces, 1 - F = s/(s + a), no noise: the root in a.
    f, log, _ = case
    s = 2j * np.pi * np.fft.rfftfreq(len(f), H)[:, None]
    powers = [np.abs(np.fft.rfft(part, axis=0)) ** 2 for part in (f, f - log.f_theta)]

    def left(power, a):
        return np.sum(np.abs(s / (s + a)) ** 2 * power)

    assert k == pytest.approx(
        brentq(lambda k: left(powers[0], 4.0 * k) - left(powers[1], 4.0), 1, 30), rel=0.1
    )


def test_and_passes_so_much_more_noise(case):
    v = NOISE * np.random.default_rng(3).standard_normal((20000, 1))
    passed = [rms(PhyFilter([4.0 * k]).sampled(H).run(v)[2000:]) for k in (1.0, case[2].speed)]
    # As sure as 18000 samples are, of which some 2000 count at the slower filter.
    assert case[2].noise_deviation[0] == pytest.approx(passed[0], rel=0.1)
    assert case[2].speed_noise == pytest.approx(passed[1] / passed[0], rel=0.1)


def test_through_a_compliance_it_is_the_simulated_error(case):
    compliance = ct.tf(1, [1.0, 6.0, 10.0])
    times = H * np.arange(len(case[0]) - 200)
    for found, e in zip(case[2].through(compliance), errors(case, FILTER), strict=True):
        there = ct.forced_response(compliance, times, e[:, 0]).outputs
        # The lowest frequencies of 80 s are known to about a tenth.
        assert found == pytest.approx(rms(there), rel=0.12)


def test_what_is_left_adds_up_over_the_bands(case):
    found = case[2]
    total = [
        np.sqrt(sum(part[k] ** 2 for part in found.bands.values()) + np.mean(found.noise_deviation) ** 2)
        for k in (0, 1)
    ]
    assert total[0] == pytest.approx(found.error.value, rel=0.1)
    assert total[1] == pytest.approx(found.error_without.value, rel=0.1)


@pytest.mark.slow
def test_a_model_of_what_the_filter_follows_anyway_is_worth_nothing():
    rng = np.random.default_rng(1)
    slow, fast = markov(rng, 0.02, 2.0), markov(rng, 10.0, 1.0)
    found = valued(recorded(slow + fast, slow, rng))
    assert found.ratio.value > 0.97
    assert found.speed < 1.2
    plain = valued(recorded(slow + fast, np.zeros_like(slow), rng))
    assert plain.ratio.value == pytest.approx(1.0, abs=1e-12)
    assert not plain.pays
    assert plain.speed == 1.0


@pytest.mark.slow
def test_a_noise_that_is_found_gives_the_same(case):
    log = recorded(case[0], case[1].f_theta, np.random.default_rng(2), noise=5e-3)
    found, given = valued(log, noise=None), valued(log, noise=5e-3)
    assert found.noise.source == "flight"
    assert found.ratio.low < given.ratio.value < found.ratio.high


@pytest.mark.slow
def test_noise_that_cannot_be_told_from_the_residual(case):
    log = recorded(case[0], case[1].f_theta, np.random.default_rng(2), noise=1e-5)
    found = valued(log, noise=None)
    assert found.noise.status == "not_identified"
    assert (found.ratio.low, found.ratio.high) == (0.0, np.inf)
    assert not found.pays


def test_what_is_refused(case):
    log = case[1]
    with pytest.raises(ValueError, match="expected f_theta in each, got none in number 0"):
        valued(log.with_signals(f_theta=None))
    with pytest.raises(ValueError, match="confidence"):
        valued(log, confidence=1.0)
    with pytest.raises(ValueError, match="a stable system"):
        case[2].through(ct.tf(1, [1.0, 0.0]))
    with pytest.raises(TypeError, match="python-control"):
        case[2].through(1.0)


def test_plot(case):
    matplotlib.use("Agg")
    plot = case[2].plot()
    assert [line.get_label() for line in plot.lines[0, 0]] == [
        "left without the model",
        "left with it",
        "noise passed",
    ]
    plt.close(plot.figure)
