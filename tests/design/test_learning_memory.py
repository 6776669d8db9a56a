"""What a result keeps to say more of itself when asked: the same figures, in bounded memory."""

import gc
import tracemalloc

import numpy as np
import pytest
from scipy.signal import lfilter

from phyfilter_ctl import Reading, Recording, Search, Shape, learn
from phyfilter_ctl.design.learning import evidence

H = 0.01
# Sums of moments instead of sums over samples.
SAME = 1e-8
FEW = Search(starts=0, cross_validate=False)
MB = 1 << 20


def flight(seed, n=3000, channels=2, offset=0.0):
    rng = np.random.default_rng(seed)
    f = lfilter([0.3], [1.0, -0.97], rng.standard_normal((n, channels)), axis=0)
    x = np.cumsum(H * f, axis=0) + 0.01 * rng.standard_normal((n, channels))
    return Recording.from_arrays(x=x, dt=H, label=f + offset)


def figures(result):
    wiener, intervals = result.wiener, result.intervals
    found = [wiener.rmse, wiener.filter_rmse, wiener.ratio, *wiener.interval, wiener.overfit]
    found += [*wiener.taps, *wiener.filter_errors, *np.ravel(intervals.pole_errors), *intervals.rmse]
    for order in result.orders:
        found += [order.rmse, order.held_out_rmse, order.ratio, order.standard_error]
    for each in result.flights:
        found += [each.rmse, each.left_out_rmse, each.own_rmse]
    return np.array(found)


@pytest.mark.parametrize(
    ("count", "shape", "label"),
    [
        pytest.param(1, "lowpass", "offset", marks=pytest.mark.slow),
        pytest.param(3, "general", "given", marks=pytest.mark.slow),
        pytest.param(6, "lowpass", "given", marks=pytest.mark.slow),
        (6, Shape("general", dc_gain=None), "offset"),
    ],
)
def test_correlations_say_what_samples_do(count, shape, label, monkeypatch):
    logs = [flight(seed, 9000 + 500 * seed, offset=0.5 * seed * (label == "offset")) for seed in range(count)]
    options = {"shape": shape, "label": label, "search": FEW, "reading": Reading(skip=1.0 * (count > 1))}
    expected = figures(learn(logs, 2, **options))
    monkeypatch.setattr(evidence, "KEPT", 0)
    monkeypatch.setattr(evidence, "WORTH", 100.0)
    found = learn(logs, 2, **options)
    assert found._evidence.reduced is not None
    np.testing.assert_allclose(figures(found), expected, rtol=SAME)


def held(make):
    """Bytes that a result holds, and the most while it was made."""
    gc.collect()
    tracemalloc.start()
    result = make()
    most = tracemalloc.get_traced_memory()[1]
    gc.collect()
    now = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert np.isfinite(result.rmse)
    return now, most


@pytest.mark.slow
def test_a_result_does_not_keep_the_flights():
    learn(flight(0), 1, search=FEW)  # modules, tables
    n, count = 30_000, 40
    samples = 2 * 2 * 8 * n * count  # u and gamma*
    now, _ = held(lambda: learn([flight(seed, n) for seed in range(count)], 1, search=FEW))
    assert samples > 36 * MB
    assert now < samples / 5


def test_a_small_flight_is_kept_as_it_is():
    learn(flight(0), 1, search=FEW)
    now, _ = held(lambda: learn(flight(0, 20_000), 1, search=FEW))
    assert now < 1.1 * 2 * 2 * 8 * 20_000 + MB


@pytest.mark.slow
def test_a_result_of_many_files_is_as_small_as_one_of_few():
    """Files are read one by one; of all of them together no more is kept than of some."""

    def many(count):
        names = [f"{seed}" for seed in range(count)]
        how = Reading(lambda path: flight(int(path.name), 6000), workers=1)
        return held(lambda: learn(names, 1, search=FEW, reading=how))

    many(2)
    one, other = many(20), many(80)
    # What 0.2 took, which computed all at once: 13.6 and 22.0 MB.
    assert one[1] < 13 * MB
    assert other[1] < 21 * MB
    assert max(one[0], other[0]) < 5 * MB
