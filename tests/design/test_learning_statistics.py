"""What learning says of its own answer: intervals, orders out of sample, flights, offsets of labels, how it runs."""

import numpy as np
import pytest
from reference_log import reference_log
from scipy.signal import lfilter

from phyfilter_ctl import PhyFilter, Recording, Sampling, Search, Shape
from phyfilter_ctl.design.learning import learn
from phyfilter_ctl.design.learning.correlation import Correlations, Stretch
from phyfilter_ctl.design.learning.folds import Folds
from phyfilter_ctl.design.learning.intervals import _bartlett
from phyfilter_ctl.design.learning.offsets import Offsets
from phyfilter_ctl.design.learning.parametrisation import Chain
from phyfilter_ctl.design.learning.residuals import flights_of
from phyfilter_ctl.design.learning.samples import Samples

H = 0.01
# Two routes to one sum.
ROUNDING = 1e-9
RECOVERED = 1e-5


def log_of(truth, seed, *, noise=0.3, n=2000, offset=0.0, channels=2):
    """x a random walk; the label what the truth makes of it, with coloured noise and an offset."""
    rng = np.random.default_rng(seed)
    x = 0.1 * np.cumsum(rng.standard_normal((n, channels)), axis=0)
    coloured = lfilter([np.sqrt(1.0 - 0.9**2)], [1.0, -0.9], rng.standard_normal(x.shape), axis=0)
    return Recording.from_arrays(
        x=x, dt=H, label=truth.sampled(H, "exact").run(x) + noise * coloured + offset
    )


# -- intervals -----------------------------------------------------------------------------------------------


def test_bartlett_is_newey_and_wests_sum():
    q = np.random.default_rng(0).standard_normal((40, 2))
    reach = 7
    expected = q.T @ q
    for lag in range(1, reach):
        across = q[lag:].T @ q[:-lag]
        expected += (1.0 - lag / reach) * (across + across.T)
    np.testing.assert_allclose(_bartlett(q, reach), expected, rtol=ROUNDING)


@pytest.mark.release
def test_intervals_cover_the_truth():
    """150 logs with coloured errors: the 95 % interval of the pole holds it, and that of the RMSE the noise's."""
    truth, noise, trials = PhyFilter([12.0]), 0.3, 150
    poles, errors, naive = 0, 0, 0
    for seed in range(trials):
        result = learn(log_of(truth, seed, noise=noise, n=1500, channels=1), 1, search=Search(starts=0))
        found = result.intervals
        miss = abs(result.filter.a[0] - 12.0)
        poles += miss <= found.half_widths[0, 0]
        low, high = found.rmse
        errors += low <= noise <= high
        naive += miss <= found.half_widths[0, 0] / np.sqrt((1.0 + 0.9) / (1.0 - 0.9))
    # 95 % of 150 is 142.5; a normal count of it is below 129 once in 10^6. Windows of finite length lose some.
    assert poles >= 129
    assert errors >= 125
    # As if errors were independent, intervals were too short by the root of their correlation time.
    assert naive < poles


def test_many_flights_are_the_independent_observations():
    logs = [log_of(PhyFilter([12.0]), seed, n=300, channels=1) for seed in range(12)]
    found = learn(logs, 1, search=Search(starts=0, cross_validate=False)).intervals
    assert found.kind == "12 flights"
    assert found.degrees_of_freedom == 11.0
    assert found.dc_gain == (1.0, 1.0, 1.0)
    free = learn(logs, 1, shape=Shape("general", dc_gain=None), search=Search(starts=0, cross_validate=False))
    value, low, high = free.intervals.dc_gain
    assert low < value == free.filter.dc_gain < high
    assert low < 1.0 < high


# -- orders out of sample ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_short_log_supports_no_high_order():
    """200 samples in one channel, order 8: fewer coefficients come back, and the truth is nearer."""
    truth = PhyFilter([300.0, 25.0])
    log, long = (log_of(truth, seed, n=n, noise=0.5, channels=1) for seed, n in ((1, 200), (2, 8000)))
    result = learn(log, 6, held_out=long, shape="general", search=Search(starts=1))
    unchecked = learn(log, 6, held_out=long, shape="general", search=Search(starts=1, cross_validate=False))
    assert result.status == "order_adds_nothing"
    assert "the flights do not support more" in result.message
    assert result.order_used < 6
    assert result.rmse > unchecked.rmse
    assert result.held_out_rmse < unchecked.held_out_rmse


@pytest.mark.slow
def test_of_several_orders_the_lowest_good_one_is_chosen():
    logs = [log_of(PhyFilter([300.0, 25.0]), seed, n=1200) for seed in range(3)]
    result = learn(logs, range(1, 5), shape="general", search=Search(starts=1))
    assert result.order_used == 2
    assert "the lowest that is as good as the best of 1 to 4" in result.message
    assert [score.order for score in result.orders] == [1, 2, 3, 4]
    first, second = result.orders[:2]
    assert not first.is_good
    assert second.is_good
    # On every fold by running the filter learned without it: the Wiener comparison shares the figures.
    assert result.wiener.filter_rmse == pytest.approx(second.held_out_rmse, rel=ROUNDING)
    assert second.rmse <= second.held_out_rmse
    assert len(result.flights) == 3
    assert not any(score.disagrees for score in result.flights)
    assert all(score.own_rmse <= score.rmse * (1.0 + ROUNDING) for score in result.flights)


def test_flights_that_disagree_are_warned_of():
    logs = [log_of(PhyFilter([a]), seed, noise=0.1) for seed, a in enumerate((5.0, 5.0, 40.0))]
    with pytest.warns(UserWarning, match=r"flights disagree: .* flight 2 most"):
        result = learn(logs, [1, 2], search=Search(starts=0))
    assert result.flights[2].disagrees
    assert any("flights disagree" in note for note in result.notes)


def test_folds_are_whole_flights_where_there_are_five():
    flights = flights_of([log_of(PhyFilter([9.0]), seed, n=200 + 50 * seed) for seed in range(5)])
    folds = Folds.of(flights, "exact", 1.0)
    assert folds.count == 5
    assert all(len(folds.stretches(i)) == 1 for i in range(5))
    assert Folds.of(flights[:2], "exact", 1.0).count == 8


@pytest.mark.slow
def test_a_wiener_filter_of_a_short_log_is_no_floor():
    log = reference_log(200)
    short = learn(log, 2, shape="general", search=Search(starts=0)).wiener
    assert not short.is_reliable
    assert learn(reference_log(8000), 2, shape="general", search=Search(starts=0)).wiener.is_reliable


# -- offsets of labels ---------------------------------------------------------------------------------------


def test_an_offset_of_each_flight_is_fitted_out():
    truth = PhyFilter([300.0, 25.0])
    logs = [
        log_of(truth, seed, noise=0.0, n=1000, offset=offset) for seed, offset in enumerate((-3.0, 1.0, 7.0))
    ]
    result = learn(logs, 2, search=Search(starts=0), label="offset")
    np.testing.assert_allclose(result.filter.a, truth.a, rtol=RECOVERED)
    assert result.rmse < RECOVERED
    with pytest.warns(UserWarning, match="label='offset'"):
        plain = learn(logs, 2, search=Search(starts=0, cross_validate=False))
    assert plain.rmse > 1.0


def test_moments_with_offsets_are_those_of_centred_signals():
    """Sums of correlations against states one by one, of stretches that begin and end inside a flight too."""
    (flight,) = flights_of([log_of(PhyFilter([9.0]), 3, n=400)])
    doubled = Chain(np.log([30.0, 20.0]), 0.5).doubled
    states = np.concatenate([s for _, s in Samples(flight, "exact").states(doubled)], axis=1)
    for parts in ([(0, 399)], [(50, 120), (200, 330)]):
        stretches = [Stretch(flight, a, b, 2.0) for a, b in parts]
        rows = np.concatenate([np.arange(a, b) for a, b in parts])
        G, m = Offsets([stretches], "exact").moments(doubled)
        whole = Correlations.of(stretches, "exact").moments(doubled)
        own, target = states[:, rows], flight.target[rows]
        centred, wanted = own - own.mean(axis=1, keepdims=True), target - target.mean(axis=0)
        expected = 2.0 * np.einsum("imk,jmk->ij", centred, centred)
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose(whole[0] + G, expected, atol=ROUNDING * scale)
        crossed = 2.0 * np.einsum("imk,mk->i", centred, wanted)
        np.testing.assert_allclose(whole[1] + m, crossed, atol=ROUNDING * np.max(np.abs(crossed)))
    G, m = Samples(flight, "exact", offset=True).moments(doubled)
    both = Correlations.of([Stretch(flight, 0, 399, 1.0)], "exact").moments(doubled)
    taken = Offsets([[Stretch(flight, 0, 399, 1.0)]], "exact").moments(doubled)
    np.testing.assert_allclose(G, both[0] + taken[0], atol=ROUNDING * np.max(np.abs(G)))
    np.testing.assert_allclose(m, both[1] + taken[1], atol=ROUNDING * np.max(np.abs(m)))


# -- how it runs ---------------------------------------------------------------------------------------------


def test_the_sampled_filter_has_what_was_learned_for():
    log = log_of(PhyFilter([30.0]), 4)
    result = learn(
        log, 1, sampling=Sampling(method="tustin", g="average", f_theta="hold", delay=0.02, limit=5.0)
    )
    sampling = result.sampled().sampling
    assert (sampling.method, sampling.g, sampling.f_theta) == ("tustin", "average", "hold")
    assert (sampling.dt, sampling.delay, float(sampling.limit)) == (H, 0.02, 5.0)
    assert result.sampled(0.005).dt == 0.005


def test_delay_and_direction_are_those_of_the_sampled_filter():
    truth, E = PhyFilter([200.0, 20.0]), np.array([[1.0], [2.0], [-1.0]])
    sampled = truth.sampled(H, "exact", E=E, delay=0.025)
    rng = np.random.default_rng(5)
    x = 0.1 * np.cumsum(rng.standard_normal((1500, 3)), axis=0)
    g, f_theta = rng.standard_normal((1500, 3)), rng.standard_normal((1500, 1))
    label = sampled.run(x, g, f_theta) @ E.T  # what f does to x, as logs have it
    log = Recording.from_arrays(x=x, dt=H, g=g, f_theta=f_theta @ E.T, label=label)
    result = learn(log, 2, sampling=Sampling(delay=0.025, E=E), search=Search(starts=0, cross_validate=False))
    np.testing.assert_allclose(result.filter.a, truth.a, rtol=RECOVERED)
    np.testing.assert_allclose(result.sampled().run(x, g, f_theta), sampled.run(x, g, f_theta), atol=1e-3)
    with pytest.raises(ValueError, match="with E the channels are those of f"):
        learn(log, 2, channels=[0], sampling=Sampling(E=E))


# -- the pull towards the order below ------------------------------------------------------------------------


@pytest.mark.slow
def test_regularisation_pulls_towards_the_order_below():
    log = log_of(PhyFilter([300.0, 25.0]), 6, n=600)
    orders = [
        learn(log, 2, shape="general", search=Search(regularisation=rho, cross_validate=False))
        for rho in (0.0, 1.0, 1e6)
    ]
    one = learn(log, 1, shape="general", search=Search(cross_validate=False)).filter
    omega = 1j * np.geomspace(0.1, 100.0, 50)
    apart = [float(np.max(np.abs(found.filter(omega) - one(omega)))) for found in orders]
    assert apart[0] > apart[1] > apart[2]
    assert apart[2] < 1e-2
    assert [found.rmse for found in orders] == sorted(found.rmse for found in orders)
    with pytest.raises(ValueError, match="regularisation"):
        learn(log, 2, search=Search(regularisation=-1.0))
