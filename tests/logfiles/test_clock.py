"""Stamps of 64 bits keep every tick, as seconds from a zero of their own."""

from __future__ import annotations

import numpy as np
import pytest

from phyfilter_ctl.logfiles.clock import column_times, since


@pytest.mark.parametrize(
    ("zero", "kind"), [(2**63 + 12_345, np.uint64), (2**62 + 1, np.uint64), (2**62 + 1, np.int64)]
)
def test_a_nanosecond_is_seen_beyond_the_digits_of_a_double(zero: int, kind: type[np.generic]) -> None:
    """Doubles near 2^62 are 1024 ns apart."""
    ticks = np.array([zero - 2, zero, zero + 1, zero + 1001], kind)
    expected = np.array([-2.0, 0.0, 1.0, 1001.0]) / 1e9
    assert since(ticks, zero, "ns").tolist() == expected.tolist()
    times = column_times("t", ticks, "ns", zero=zero)
    assert times.seconds.tolist() == expected.tolist()
    assert times.zero == zero
    assert column_times("t", ticks[1:], "ns").seconds.tolist() == expected[1:].tolist()


def test_short_unsigned_stamps_run_back_below_the_zero() -> None:
    assert since(np.array([5, 3], np.uint32), 4, "us").tolist() == [1e-6, -1e-6]
