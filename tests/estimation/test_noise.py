"""Noise of any colour: given, at rest, told from the residual, refused; and the intervals that rest on it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.signal.windows import tukey

import phyfilter_ctl as pf
from phyfilter_ctl.estimation.levels import separate
from phyfilter_ctl.estimation.prediction import ahead
from phyfilter_ctl.estimation.spectrum import SHARED
from phyfilter_ctl.estimation.steps import steps_of
from phyfilter_ctl.estimation.suggestion import Unlabelled

H = 0.004
Array = NDArray[np.float64]


def autoregression(pole: float, count: int, rng: np.random.Generator) -> Array:
    """Of variance 1."""
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], rng.standard_normal(count + 500)))[500:]


def flight(
    noise: float, pole: float = 0.0, *, seed: int = 0, seconds: float = 20.0, late: int = 0
) -> pf.Recording:
    """Gauss-Markov force (0.5 s) and a sine on x' = f, exact at the samples; x is measured ``late`` samples late."""
    rng, fine = np.random.default_rng(seed), 5
    count = round(seconds / H) * fine
    t = H / fine * np.arange(count + 1)
    fall = np.exp(-H / fine / 0.5)
    f = np.asarray(lfilter([np.sqrt(1.0 - fall**2)], [1.0, -fall], rng.standard_normal(count + 1))) + np.sin(
        3.0 * t
    )
    x = np.concatenate([[0.0], np.cumsum(0.5 * (f[1:] + f[:-1]) * H / fine)])[::fine]
    v = noise * autoregression(pole, len(x), rng)
    label = f[::fine][late:]
    return pf.Recording(t[::fine][late:], (x[: len(label)] + v[: len(label)]), label=label)


def rmse(log: pf.Recording, filter: pf.SampledPhyFilter) -> float:
    assert log.label is not None
    return float(np.sqrt(np.mean((filter.run(log.x) - log.label)[1:] ** 2)))


def over_the_best(log: pf.Recording, found: pf.Estimate) -> float:
    """RMSE of the suggested filter over the least near it."""
    best = found.suggestion
    rivals = [
        rmse(
            log,
            found.filter.with_filter(pf.lowpass(best.filter.order, best.bandwidth * s, family="butterworth")),
        )
        for s in np.geomspace(0.4, 2.5, 21)
    ]
    return rmse(log, found.filter.with_filter(best.filter)) / min(rivals)


def test_noise_of_f_hat_beside_its_impulse_response() -> None:
    """phi' R phi with the taps of F and the covariance of v_k - v_(k-1); and the closed form for white noise."""
    log, pole = flight(0.01, seconds=4.0), 0.7
    sampled = pf.lowpass(2, 30.0, family="butterworth").sampled(H)
    r = 0.01**2 * pole ** np.arange(400.0)
    found = pf.estimate(log, sampled, noise=pf.Noise.known(covariance=r[:60]))
    step = np.zeros((2000, 1))
    step[1:] = H
    phi = sampled.run(np.cumsum(step, axis=0) - step)[
        :, 0
    ]  # of a rise by H: the taps, from the third sample on
    taps = np.diff(phi, prepend=0.0)[2:600]
    n = (2.0 * r[:300] - np.abs(np.r_[r[1], r[:299]]) - r[1:301]) / H**2
    lags = np.abs(np.subtract.outer(np.arange(300), np.arange(300)))
    assert found.noise_deviation[0] == pytest.approx(np.sqrt(taps[:300] @ n[lags] @ taps[:300]), rel=1e-3)
    white = pf.estimate(log, sampled, noise=0.01).noise_deviation[0]
    assert white**2 == pytest.approx(pf.error_variance(sampled, pf.Gaussian(noise=0.01)).noise, rel=1e-3)


@pytest.mark.slow
def test_a_colour_is_found_and_the_filter_with_it() -> None:
    log = flight(0.01, 0.6)
    found = pf.estimate(log)
    assert found.noise.status == "converged"
    assert not found.noise.is_white
    assert found.noise.low[0] < 0.01 < found.noise.high[0]
    assert found.noise.covariance[1, 0] / found.noise.covariance[0, 0] == pytest.approx(0.6, abs=0.1)
    assert over_the_best(log, found) < 1.01
    assert (
        over_the_best(log, pf.estimate(log, noise=float(np.std(np.diff(log.x[:, 0])) / np.sqrt(2.0)))) > 1.02
    )


def test_x_measured_late_asks_for_another_filter() -> None:
    log, sampled = flight(0.01, late=5), pf.lowpass(2, 20.0).sampled(H, delay=5 * H)
    found = pf.estimate(log, sampled)
    assert over_the_best(log, found) < 1.01
    truth = rmse(log, sampled.with_filter(found.suggestion.filter))
    assert found.suggestion.error.low < truth < found.suggestion.error.high
    assert truth > 1.2 * pf.estimate(log, sampled.with_filter(found.suggestion.filter).filters[0]).error.value


def test_a_g_that_reacts_to_the_noise_of_x_changes_nothing() -> None:
    """x' = g + f with g = -5 x as measured 20 ms before: u is that of the same force and noise without g."""
    log, back = flight(0.01, seconds=6.0), 5
    rise, v = np.diff(flight(0.0, seconds=6.0).x[:, 0]), log.x[:, 0] - flight(0.0, seconds=6.0).x[:, 0]
    x, g = np.zeros(log.n), np.zeros(log.n)
    for k in range(log.n - 1):
        seen = max(k - back, 0)
        g[k] = -5.0 * (x[seen] + v[seen])
        x[k + 1] = x[k] + rise[k] + H * g[k]
    closed, sampled = pf.Recording(log.times, x + v, g=g), pf.lowpass(2, 40.0).sampled(H)
    one, other = (steps_of([each], sampled)[0].u for each in (log, closed))
    np.testing.assert_allclose(other, one, atol=1e-9 * np.max(np.abs(one)))


@pytest.mark.slow
def test_where_the_noise_is_in_doubt_the_nearer_future_decides() -> None:
    log = flight(0.02, 0.95)
    found = pf.estimate(log, horizon=0.2)
    assert found.suggestion.message.startswith("it predicts x 0.1 s ahead best")
    assert over_the_best(log, found) < 1.02


def test_a_horizon_is_a_step_at_least() -> None:
    log = pf.Recording.from_arrays(x=np.random.default_rng(0).standard_normal((200, 1)), dt=0.5)
    (part,) = steps_of([log], pf.PhyFilter([1.0]).sampled(0.5))
    here, later = ahead(part, 0.1)
    np.testing.assert_array_equal(later, here + 1)


def test_share_of_a_bin_of_the_window() -> None:
    """Variance of the mean of a white periodogram over that of as many independent values."""
    window = tukey(4002, 0.5)[1:-1]
    assert pytest.approx(len(window) * np.sum(window**4) / np.sum(window**2) ** 2, rel=1e-3) == SHARED


@pytest.mark.slow
def test_what_shares_a_band_is_refused() -> None:
    """Noise of a corner at 5 rad/s and a force of 2: no spectrum tells them apart."""
    found = pf.estimate(flight(0.3, 0.98, seconds=8.0))
    assert found.noise.status == "not_identified"
    assert (found.error.low, found.error.high) == (0.0, np.inf)
    assert any("give the noise" in note for note in found.notes)


def test_a_record_without_noise_says_that_none_is_seen() -> None:
    found = pf.estimate(pf.Recording.from_arrays(x=np.sin(5.0 * H * np.arange(600))[:, None], dt=H))
    assert found.noise.status == "not_identified"
    assert "up to the Nyquist frequency: no noise is seen; give the noise" in found.noise.message


def test_noise_at_rest() -> None:
    v = 0.02 * autoregression(0.8, 4000, np.random.default_rng(1))
    found = pf.Noise.at_rest(pf.Recording.from_arrays(x=v[:, None] + 3.0, dt=H), start=1.0)
    assert found.status == "converged"
    assert found.low[0] < 0.02 < found.high[0]
    lags = np.arange(6)
    np.testing.assert_allclose(found.covariance[:6, 0], 0.02**2 * 0.8**lags, atol=0.15 * 0.02**2)
    told = pf.estimate(flight(0.02, 0.8, seed=2), noise=found)
    assert told.noise.source == "rest"
    assert told.error.low < rmse(flight(0.02, 0.8, seed=2), told.filter) < told.error.high


def test_noise_by_spectrum_and_covariance() -> None:
    omega = np.linspace(0.0, np.pi / H, 4000)
    power = 1e-4 * (1.0 - 0.36) / np.abs(1.0 - 0.6 * np.exp(-1j * omega * H)) ** 2 * H / np.pi
    found = pf.Noise.known(spectrum=(omega, power), dt=H)
    np.testing.assert_allclose(found.covariance[:8, 0], 1e-4 * 0.6 ** np.arange(8), rtol=1e-3)
    again = pf.Noise.known(covariance=1e-4 * 0.6 ** np.arange(40))
    np.testing.assert_allclose(again.value, found.value, rtol=1e-4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({}, "expected one of"),
        ({"deviation": 1.0, "covariance": [1.0]}, "expected one of"),
        ({"deviation": -1.0}, "numbers > 0"),
        ({"covariance": [1.0, 0.9]}, "spectrum >= 0"),
        ({"spectrum": ([0.0, 1.0], [1.0, 1.0])}, "dt"),
        ({"spectrum": ([1.0, 0.0], [1.0, 1.0]), "dt": 0.1}, "rising omega"),
    ],
)
def test_noise_that_is_none_is_refused(arguments: dict[str, object], words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=words):
        pf.Noise.known(**arguments)  # type: ignore[arg-type]


def test_a_stretch_that_shows_no_noise_is_refused() -> None:
    log = flight(0.01, seconds=1.0)
    with pytest.raises(ValueError, match="at least 50 samples"):
        pf.Noise.at_rest(log, end=0.1)
    with pytest.raises(ValueError, match="for 1 or 1 channels"):
        pf.estimate(log, noise=[1.0, 2.0])
    with pytest.raises(ValueError, match="noise in them"):
        pf.Noise.at_rest(pf.Recording.from_arrays(x=np.ones((100, 1)), dt=H))


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """Of 40 intervals of 95 % fewer than 35 hold it once in 70 times; the filter is the same for all."""
    sampled = pf.lowpass(2, 80.0, family="butterworth").sampled(H)
    error, noise, off, width = [], [], [], []
    for seed in range(40):
        log = flight(0.005, seed=seed)
        parts = steps_of([log], sampled)
        found = separate(parts, None, 0.95)[0]
        interval = Unlabelled(parts, found).interval(sampled, 0.95)
        error.append(interval.low < rmse(log, sampled) < interval.high)
        noise.append(bool(found.noise.low[0] < 0.005 < found.noise.high[0]))
        off.append(np.log(interval.value / rmse(log, sampled)))
        width.append(np.log(interval.value / interval.low))
    assert sum(error) >= 35
    assert sum(noise) >= 35
    # A deviation of 40 is known to 25 % (95 %): the intervals are as wide as they need to be.
    assert np.median(width) == pytest.approx(2.0 * np.std(off), rel=0.5)
    assert abs(np.mean(off)) < 0.5 * np.std(off)
