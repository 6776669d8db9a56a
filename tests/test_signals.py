"""Times in their units and masked samples, through every door that takes them."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import control as ct
import numpy as np
import pytest
from numpy.typing import NDArray

from phyfilter_ctl import PhyFilter, simulate
from phyfilter_ctl._signals import interval, seconds, unmasked
from phyfilter_ctl.baselines.observers import DisturbanceObserver
from phyfilter_ctl.learned import Network
from phyfilter_ctl.recording import Recording

F = PhyFilter([400.0, 40.0])
N = 6
NS = np.int64(1_700_000_000_000_000_000) + np.array([0, 10, 20, 31, 40, 50]) * 1_000_000
SECONDS = np.array([0.0, 0.010, 0.020, 0.031, 0.040, 0.050])
X = np.sin(3.0 * SECONDS)[:, None] * [1.0, -2.0]


def observed(x: NDArray[np.float64], times: object) -> NDArray[np.float64]:
    return DisturbanceObserver(8.0, 0.01).run(x, times=times)  # type: ignore[arg-type]


def logged(x: NDArray[np.float64], times: object) -> NDArray[np.float64]:
    return Recording.from_arrays(x=x, times=times).times[:, None]  # type: ignore[arg-type]


def simulated(x: NDArray[np.float64], times: object) -> NDArray[np.float64]:
    lag = ct.tf([1.0], [0.1, 1.0], inputs="u", outputs="y", name="lag")
    return simulate(lag, times, x[:, 0]).outputs  # type: ignore[arg-type]


def filtered(x: NDArray[np.float64], times: object) -> NDArray[np.float64]:
    return F.sampled(0.01).run(x, times=times)  # type: ignore[arg-type]


DOORS = [filtered, logged, observed, simulated]


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(
    "times",
    [
        NS.astype("datetime64[ns]"),
        (NS // 1_000_000).astype("datetime64[ms]"),
        (NS - NS[0]).astype("timedelta64[ns]"),
        ((NS - NS[0]) // 1000).astype("timedelta64[us]"),
        list(NS.astype("datetime64[ns]")),
    ],
    ids=["datetime64[ns]", "datetime64[ms]", "timedelta64[ns]", "timedelta64[us]", "list"],
)
def test_times_with_a_unit_are_seconds(door: Callable[..., NDArray[np.float64]], times: object) -> None:
    # Whole ticks over whole ticks a second: one rounding, as in the decimal text of the seconds.
    np.testing.assert_array_equal(door(X, times), door(X, SECONDS))


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("times", [NS, (NS - NS[0]).astype(np.uint64), ((NS - NS[0]) // 1000).tolist()])
def test_ticks_of_a_clock_are_no_seconds(door: Callable[..., NDArray[np.float64]], times: object) -> None:
    with pytest.raises(
        ValueError, match=r"ticks of a clock, not seconds; give them as timedelta64.*1e9 \(ns\)"
    ):
        door(X, times)


def test_whole_seconds_are_seconds() -> None:
    np.testing.assert_array_equal(seconds("t", [0, 999, 1998]), [0.0, 999.0, 1998.0])
    np.testing.assert_array_equal(seconds("t", [0.0, 3600.0]), [0.0, 3600.0])


def test_times_without_a_length_are_refused() -> None:
    for times in (np.array([1, 2], "timedelta64[M]"), np.array([1, 2], "timedelta64")):
        with pytest.raises(ValueError, match="has no length in seconds"):
            seconds("t", times)
    np.testing.assert_array_equal(seconds("t", np.array(["2024", "2025"], "datetime64[Y]")), [0, 366 * 86400])


def test_missing_times_are_named_by_their_row() -> None:
    stamps = NS.astype("datetime64[ns]")
    stamps[3] = np.datetime64("NaT")
    with pytest.raises(ValueError, match=r"times: .* got nan in row 3"):
        Recording.from_arrays(x=X, times=stamps)
    for times in (stamps, np.ma.array(NS.astype("datetime64[ns]"), mask=np.arange(N) == 3)):
        with pytest.raises(ValueError, match="row 3"):
            F.sampled(0.01).run(X, times=times)


def test_intervals_with_a_unit() -> None:
    for dt in (np.timedelta64(10, "ms"), timedelta(milliseconds=10)):
        sampled = F.sampled(dt, delay=np.timedelta64(5, "ms"))  # type: ignore[arg-type]
        assert (sampled.dt, sampled.sampling.delay) == (0.01, 0.005)
        assert Recording.from_arrays(x=X, dt=dt).dt == pytest.approx(0.01)  # type: ignore[arg-type]
        state = F.sampled(0.002).start([0.0])
        one, other = (F.sampled(0.002).step(state, [1.0], dt=h)[1] for h in (dt, 0.01))  # type: ignore[arg-type]
        assert one == other
    for wrong in (10_000_000, np.int64(10_000_000)):
        for door in (
            F.sampled,
            lambda h: Recording.from_arrays(x=X, dt=h),
            lambda h: DisturbanceObserver(8.0, h),
        ):
            with pytest.raises(ValueError, match="ticks of a clock"):
                door(wrong)
    assert interval("dt", 1) == 1.0
    for extreme in (1e-310, 1e308):
        with pytest.raises(ValueError, match="dt: expected"):
            F.sampled(extreme)


@pytest.mark.parametrize(("first", "factor"), [("0", 1e-9), ("1700000000000000000", 1e-9), ("+5", 1e-6)])
def test_ticks_in_a_file_are_refused(tmp_path: Path, first: str, factor: float) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{int(first) + k * round(0.01 / factor)},{k}.5\n" for k in range(4)]
    path.write_text("t,v\n" + "".join(rows))
    with pytest.raises(
        ValueError, match=r"log.csv: column 't': steps of .* scale=\{'t': 1e-3\} \(ms\).*1e-9 \(ns\)"
    ):
        Recording.from_csv(path, x=["v"])
    # Doubles of 1.7e9 s are 2.4e-7 s apart.
    assert Recording.from_csv(path, x=["v"], scale={"t": factor}).dt == pytest.approx(0.01, rel=1e-4)
    assert Recording.from_csv(path, x=["v"], scale={"t": 1.0}).dt == pytest.approx(0.01 / factor, rel=1e-4)
    # Written by this library, or by hand with a point, they are seconds.
    hours = Recording.from_arrays(x=X, times=3600.0 * np.arange(N), channels=["a", "b"])
    hours.to_csv(path)
    assert np.array_equal(Recording.from_csv(path, x=["a", "b"]).times, hours.times)


MASKED = np.ma.array(np.zeros((N, 2)), mask=False)
MASKED[4, 1] = np.ma.masked
MASKED.data[4, 1] = 1e6


@pytest.mark.parametrize("signal", ["x", "g", "f_theta", "inertia"])
def test_masked_samples_are_refused_by_their_row(signal: str) -> None:
    signals = {"x": np.zeros((N, 2)), signal: MASKED}
    with pytest.raises(
        ValueError, match=f"{signal}: expected finite numbers, none masked, got nan in row 4, column 1"
    ):
        F.sampled(0.01).run(**signals)
    for masked in (MASKED, list(MASKED)):
        with pytest.raises(ValueError, match="row 4"):
            Recording.from_arrays(dt=0.01, **signals | {signal: masked})


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("signal", ["x", "g", "f_theta"])
def test_masked_samples_are_held(signal: str, precision: str) -> None:
    sampled = F.sampled(0.01, nonfinite="hold", precision=precision)  # type: ignore[arg-type]
    missing = {"x": X, signal: np.where(MASKED.mask, np.nan, X)}
    masked = {"x": X, signal: np.ma.array(np.where(MASKED.mask, 1e6, X), mask=MASKED.mask)}
    large = {"x": X, signal: np.where(MASKED.mask, -1e308, X)}
    expected = sampled.run(**missing)
    for signals in (masked, large):
        np.testing.assert_array_equal(sampled.run(**signals), expected)
        assert sampled.held(**signals).any()
    # A step at a time: the row of a masked array, or a list that holds it.
    for signals in (masked, large):
        loop = [sampled.start(X[0], f_theta0=missing.get("f_theta", np.zeros((1, 2)))[0])]
        for k in range(1, N):
            row = {name: values[k - 1 if name == "g" else k] for name, values in signals.items()}
            state, f_hat = sampled.step(loop[-1], **row)
            loop.append(state)
            np.testing.assert_allclose(f_hat, expected[k], rtol=1e-5, atol=1e-5)


def test_masked_starts_and_steps_are_refused() -> None:
    sampled = F.sampled(0.01)
    row = MASKED[4]
    for keyword in ("f_hat0", "f_theta0", "g0", "inertia0"):
        with pytest.raises(ValueError, match=f"{keyword}: expected finite"):
            sampled.start([0.0, 0.0], **{keyword: row})
    with pytest.raises(ValueError, match="x0: expected finite"):
        sampled.start(row)
    state = sampled.start([0.0, 0.0])
    for keyword in ("x", "g", "f_theta", "inertia"):
        with pytest.raises(ValueError, match=f"{keyword}: expected finite numbers, none masked"):
            sampled.step(state, **{"x": [0.0, 0.0], keyword: row})
    with pytest.raises(ValueError, match="dx: expected finite"):
        sampled.shift_x(state, row)


def test_masked_samples_elsewhere() -> None:
    with pytest.raises(ValueError, match="x: expected finite numbers, none masked, got nan in row 4"):
        observed(MASKED, None)
    with pytest.raises(ValueError, match="got nan in row 4, column 1"):
        Network((3,)).fit(MASKED, np.zeros((N, 1)))


def test_what_is_not_masked_is_left_alone() -> None:
    for values in ([1.0, 2.0], X, 3.0, None):
        assert unmasked(values) is values  # type: ignore[arg-type]
    assert unmasked(np.ma.array([1, 2], mask=[False, True])).tolist()[0] == 1.0  # type: ignore[union-attr]
