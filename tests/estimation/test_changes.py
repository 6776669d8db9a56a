"""Sudden changes of a part: when nothing changes the tests are chi-square, and a jump is found where it is."""

import numpy as np
import pytest
from scipy.stats import chi2

import phyfilter_ctl as pf
from phyfilter_ctl.estimation import ColouredForce, Payload, Regressor, SteadyForce, separate

H = 0.01


def hanging(rng, n=400, drop=np.inf, payload=0.6, mass=3.0):
    """A body in gusts as declared, 1-D, its weight and payload carried; the payload drops at ``drop`` s."""
    t = H * np.arange(n)
    w, v, x = 0.5 * rng.standard_normal(), 0.0, np.zeros(n)
    stay = np.exp(-5.0 * H)
    g = payload * 9.81 + 2.0 * np.sin(3.0 * t)
    for k in range(n):
        x[k] = v + 0.01 * rng.standard_normal()
        added = payload if t[k] < drop else 0.0
        following = stay * w + 0.5 * np.sqrt(1.0 - stay**2) * rng.standard_normal()
        v += H * (g[k] - added * 9.81 + 0.5 * (w + following)) / (mass + added)
        w = following
    return pf.Recording.from_arrays(x=x, g=g, dt=H, inertia=mass)


PARTS = [Payload(1.0, gravity=[9.81]), ColouredForce(0.5, bandwidth=5.0)]


def test_a_drop_is_found():
    found = separate(hanging(np.random.default_rng(0), drop=2.0), PARTS, noise=0.03, causal=True)
    changes = found.changes("payload")
    assert len(changes.alarms) >= 1
    assert 2.0 < changes.alarms[0] <= 2.3
    assert abs(changes.onsets[0] - 2.0) <= 0.1
    assert changes.jumps[0, 0] == pytest.approx(-0.6, abs=0.25)
    quiet = found.changes("payload", false_alarms=1e-6)
    assert quiet.threshold > changes.threshold


def test_threshold_is_that_of_the_tests_in_an_hour():
    found = separate(hanging(np.random.default_rng(1), n=60), PARTS, noise=0.03, causal=True)
    # Jumps every 10 ms, at ages of 50, 100, 200 and 300 ms: 1.44 million tests an hour.
    assert found.changes("payload", false_alarms=2.0).threshold == pytest.approx(chi2.isf(2.0 / 1.44e6, 1))
    assert found.changes("wind").threshold == pytest.approx(chi2.isf(1.0 / 1.44e6, 1))


@pytest.mark.slow
def test_without_a_change_the_tests_are_chi_square():
    """Of 12 flights: quantiles of the tests by age. About 12 x 4 of them are independent of each other per age, and the
    share above the median of chi-square has a deviation of 0.07 or less: 0.25 is more than three of those.
    """
    rng, values = np.random.default_rng(3), []
    for _ in range(12):
        found = separate(hanging(rng), PARTS, noise=0.03, causal=True)
        values.append(found.changes("payload", within=0.01).statistic)
    values = np.concatenate(values)
    values = values[values > 0.0]
    assert np.mean(values > chi2.isf(0.5, 1)) == pytest.approx(0.5, abs=0.25)
    assert np.mean(values > chi2.isf(0.01, 1)) < 0.03


def test_a_part_that_is_not_there_is_tested_without_harm():
    """A regressor that is 0 leaves no signature: no alarm, no division by nothing."""
    log = hanging(np.random.default_rng(2), n=80)
    found = separate(log, [*PARTS, Regressor(np.zeros((80, 1)), 1.0, name="loss")], noise=0.03, causal=True)
    assert found.changes("loss").statistic.max() == 0.0


def test_what_is_refused():
    log = hanging(np.random.default_rng(2), n=40)
    found = separate(log, [SteadyForce(5.0)], noise=0.03, causal=True)
    with pytest.raises(ValueError, match="part: expected one of steady, got 'wind'"):
        found.changes("wind")
    with pytest.raises(ValueError, match="within: expected less than the recording"):
        found.changes("steady", within=1.0)
    with pytest.raises(ValueError, match="false_alarms"):
        found.changes("steady", false_alarms=0.0)
    with pytest.raises(ValueError, match="causal=True"):
        separate(log, [SteadyForce(5.0)], noise=0.03).changes("steady")
