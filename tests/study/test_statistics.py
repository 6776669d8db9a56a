"""Median and interval of a few flights."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from phyfilter_ctl.study import median_interval, reduction, score_methods


def test_interval_covers_the_median_as_often_as_it_says() -> None:
    """Of 4000 draws of 20 from a skewed law, at least 95 % of the intervals hold its median (95.9 % expected)."""
    rng = np.random.default_rng(0)
    truth = np.log(2.0)
    held = 0
    for row in rng.exponential(1.0, (4000, 20)):
        interval = median_interval(row)
        held += interval.low < truth < interval.high
    assert 0.95 < held / 4000 < 0.968


def test_few_values_give_their_range() -> None:
    interval = median_interval([3.0, 1.0, 2.0])
    assert (interval.value, interval.low, interval.high) == (2.0, 1.0, 3.0)


@pytest.mark.parametrize("values", [[], [[1.0, 2.0]]])
def test_no_row_of_numbers_is_refused(values: list[object]) -> None:
    with pytest.raises(ValueError, match=r"values: expected shape \(B,\)"):
        median_interval(np.asarray(values, dtype=float))


def test_reduction_is_taken_flight_by_flight() -> None:
    ours, theirs = np.array([1.0, 8.0, 1.0]), np.array([2.0, 10.0, 1.0])
    found = reduction(ours, theirs)
    np.testing.assert_allclose([found.value, found.low, found.high], [20.0, 0.0, 50.0], atol=1e-12)
    with pytest.raises(ValueError, match="same flights"):
        reduction(ours, theirs[:2])


def test_methods_are_scored_case_by_case_and_the_middle_flight_is_shown() -> None:
    errors = {"pd": np.array([0.3, 0.1, 0.2]), "filter": np.array([0.1, 0.05, 0.1])}
    said: list[str] = []

    def fly(name: str, case: str) -> SimpleNamespace:
        return SimpleNamespace(error=errors[name] * (2.0 if case == "wind" else 1.0))

    scores = score_methods(("pd", "filter"), ("still", "wind"), fly, report=said.append)
    assert said == ["pd, still", "pd, wind", "filter, still", "filter, wind"]
    assert scores.interval("wind", "pd", "error") == median_interval([0.6, 0.2, 0.4])
    assert scores.middle("still", "pd", "error") == 2
    assert scores.reduction("wind", "pd", of="filter", figure="error").value == pytest.approx(50.0)
