"""Means over windows that begin and end between samples, against fine summation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl.filter.windows import fill_forward, mean_weights, window_means

FINE = 20_000  # points of a quadrature


@pytest.mark.parametrize("delay", [0.0, 0.25, 0.5, 1.0, 1.7, 3.0])
@pytest.mark.parametrize("rule", ["hold", "average"])
def test_weights_of_a_delayed_mean(rule, delay):
    """v_0 ... v_5, the newest last: its mean from 4 - delay to 5 - delay, as it runs between the samples."""
    v = np.array([1.0, -2.0, 0.5, 4.0, -1.0, 3.0])
    t = 5.0 - delay - 1.0 + (np.arange(FINE) + 0.5) / FINE
    between = v[np.floor(t).astype(int)] if rule == "hold" else np.interp(t, np.arange(6), v)
    weights = mean_weights(rule, delay)
    assert weights.sum() == pytest.approx(1.0, abs=1e-15)
    assert weights @ v[::-1][: len(weights)] == pytest.approx(between.mean(), abs=5e-4)  # of the quadrature
    assert len(weights) == 2 + int(np.ceil(delay)), "no sample that has no weight"


@given(st.lists(st.floats(-5.0, 5.0) | st.just(float("nan")), min_size=1, max_size=12), st.floats(-2.0, 2.0))
def test_filling_forward(values, start):
    filled, last = fill_forward(np.array(values)[:, None], start)[:, 0], start
    for value, found in zip(values, filled, strict=True):
        last = last if np.isnan(value) else value
        assert found == last


def test_nothing_to_fill_is_not_copied():
    values = np.ones((3, 2))
    assert fill_forward(values) is values


@pytest.mark.parametrize("ends", [0.4, 1.0, 3.3, 4.0])
@pytest.mark.parametrize("length", [0.05, 1.0, 2.9, 6.0])
def test_means_of_windows(ends, length):
    """Intervals of unequal length, each a straight line of its own; the first value holds before the record."""
    times = np.array([0.0, 0.5, 0.7, 2.0, 4.0])
    first = np.array([[1.0], [3.0], [-2.0], [0.0]])
    last = np.array([[2.0], [3.0], [5.0], [1.0]])
    t = ends - length + length * (np.arange(FINE) + 0.5) / FINE
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, 3)
    share = (t - times[k]) / np.diff(times)[k]
    along = np.where(t < 0.0, 1.0, first[k, 0] + share * (last - first)[k, 0])
    mean = window_means(times, first, last, np.array([ends - length]), np.array([ends]))
    assert mean[0, 0] == pytest.approx(along.mean(), abs=2e-3)  # of the quadrature, at the jumps
