"""Frames, series and labelled arrays of pandas, polars and xarray: as their numbers, never misread."""

from __future__ import annotations

import doctest
import inspect
import sys
from collections.abc import Callable
from datetime import UTC, date, datetime, timedelta
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, Recording, learn
from phyfilter_ctl._signals import labels, real, seconds
from phyfilter_ctl.baselines.observers import DisturbanceObserver

F = PhyFilter([400.0, 40.0]).sampled(0.01)
N = 50
MS = np.cumsum([0, *[9, 10, 11, 10, 12, 8, 10] * 7])
T = MS / 1000.0
X = np.sin(3.0 * T)[:, None] * [1.0, -2.0]
NAMES = ["u", "v"]
BERLIN = "Europe/Berlin"
# Summer time begins between the 20th sample and the 21st: local clocks jump an hour there, the instants do not.
STAMPS = np.datetime64("2024-03-31T00:59:59.800", "ms") + MS.astype("timedelta64[ms]")


@pytest.fixture
def pd() -> Any:
    return pytest.importorskip(
        "pandas", reason="pandas is not installed: pip install 'phyfilter-ctl[containers]'"
    )


@pytest.fixture
def pl() -> Any:
    return pytest.importorskip(
        "polars", reason="polars is not installed: pip install 'phyfilter-ctl[containers]'"
    )


@pytest.fixture
def xr() -> Any:
    return pytest.importorskip(
        "xarray", reason="xarray is not installed: pip install 'phyfilter-ctl[containers]'"
    )


def assert_runs_alike(x: Any, times: Any, expected: np.ndarray = X) -> None:
    """As the record and as the loop over its rows, bit for bit."""
    for run in (F.run, DisturbanceObserver(8.0, 0.01).run):
        np.testing.assert_array_equal(run(x, x, times=times), run(expected, expected, times=T))


# -- signals ----------------------------------------------------------------------------------------------------


def test_pandas_frames_and_series(pd: Any) -> None:
    assert_runs_alike(pd.DataFrame(X, columns=NAMES), pd.Series(T))
    assert_runs_alike(pd.DataFrame(X, index=pd.Index(T)), pd.Index(T))
    np.testing.assert_array_equal(F.run(pd.Series(X[:, 0])), F.run(X[:, :1]))
    # Columns of several types, and of pandas' own: numpy alone would make objects of them.
    mixed = pd.DataFrame({"a": [1.5, 2.0], "b": [True, False], "c": pd.array([3, None], dtype="Int64")})
    np.testing.assert_array_equal(real("x", mixed), [[1.5, 1.0, 3.0], [2.0, 0.0, np.nan]])
    np.testing.assert_array_equal(real("x", pd.Series([True, None], dtype="boolean")), [1.0, np.nan])
    np.testing.assert_array_equal(real("x", pd.Series([1.0, None], dtype="Float64")), [1.0, np.nan])


def test_polars_frames_and_series(pl: Any) -> None:
    assert_runs_alike(pl.DataFrame(X, schema=NAMES), pl.Series(T))
    np.testing.assert_array_equal(F.run(pl.Series(X[:, 0])), F.run(X[:, :1]))
    mixed = pl.DataFrame({"a": [1.5, 2.0], "b": [True, False], "c": [3, None]})
    np.testing.assert_array_equal(real("x", mixed), [[1.5, 1.0, 3.0], [2.0, 0.0, np.nan]])


def test_xarray_arrays(xr: Any) -> None:
    assert_runs_alike(xr.DataArray(X, dims=("time", "channel")), xr.DataArray(T, dims="time"))
    with pytest.raises(ValueError, match=r"x: expected samples first, got .*x.transpose\('time', ...\)"):
        F.run(xr.DataArray(X.T, dims=("channel", "time")))
    with pytest.raises(TypeError, match=r"x: .*xarray.Dataset.*create an xarray.DataArray"):
        F.run(xr.Dataset({"x": ("time", T)}))


def test_missing_entries_are_gaps_by_the_one_policy(pd: Any, pl: Any) -> None:
    x = np.round(100.0 * X[:, 0])
    missing = np.where(np.arange(N) == 7, np.nan, x)
    holding = PhyFilter([20.0]).sampled(0.01, nonfinite="hold")
    whole = [None if k == 7 else int(value) for k, value in enumerate(x)]
    for series in (pd.Series(whole, dtype="Int64"), pl.Series(whole), np.ma.masked_invalid(missing)):
        with pytest.raises(ValueError, match="x: expected finite numbers, none masked, got nan in row 7"):
            F.run(series)
        np.testing.assert_array_equal(holding.run(series), holding.run(missing))


def test_what_no_signal_can_be_is_named_by_its_column(pd: Any, pl: Any) -> None:
    instants = pd.date_range("2024", periods=2, tz="UTC")
    frame = pd.DataFrame({"v": [1.0, 2.0], "mode": ["a", "b"], "t": instants})
    for given in (frame, pl.DataFrame({"v": [1.0, 2.0], "mode": ["a", "b"], "t": [date(2024, 1, 1)] * 2})):
        with pytest.raises(
            TypeError, match=r"x: expected columns of real numbers, got 'mode' \(.*'t' \(.*leave"
        ):
            F.run(given)
    with pytest.raises(TypeError, match="dates go in as times only"):
        F.run(instants)
    with pytest.raises(TypeError, match="give its real part"):
        F.run(pd.DataFrame({"v": [1j, 2.0]}))
    with pytest.raises(ValueError, match=r"g: expected shape \(50, 2\)"):
        F.run(X, pd.DataFrame(X[:-1]))


def test_nothing_is_copied_where_the_layout_allows(pd: Any, pl: Any, xr: Any) -> None:
    n = 1000
    block = np.zeros((n, 3))
    held = [pd.DataFrame(block, copy=False), xr.DataArray(block, dims=("t", "c")), block]
    for given in held:
        assert np.shares_memory(real("x", given, copy=False), block)
        assert not np.shares_memory(real("x", given), block)
    column = pl.Series(block[:, 0])
    assert np.shares_memory(real("x", column, copy=False), column.to_numpy())
    series = pd.Series(np.zeros(n))
    assert np.shares_memory(real("x", series, copy=False), series.to_numpy())


def test_frames_are_tables(pd: Any, pl: Any) -> None:
    """By the names of their columns; of pandas also by an index of times."""
    t = 0.01 * np.arange(300)
    v = np.sin(3.0 * t)
    frame = pd.DataFrame({"time [ms]": 1e3 * t, "VX": v, "label_VX": 3.0 * np.cos(3.0 * t)})
    found = Recording.read(frame, x=["vx"])
    assert (found.n, found.channels) == (300, ("VX",))
    assert found.dt == pytest.approx(0.01)
    indexed = pd.DataFrame({"vx": v}, index=pd.to_timedelta(t, unit="s"))
    assert Recording.read(indexed, x=["vx"]).dt == pytest.approx(0.01)
    with pytest.raises(ValueError, match="its index counts rows"):
        Recording.read(pd.DataFrame({"vx": v}), x=["vx"])
    assert Recording.read(pl.DataFrame({"t": t, "vx": v}), x=["vx"]).n == 300
    with pytest.raises(ValueError, match="no column that is called t or time"):
        Recording.read(pl.DataFrame({"vx": v}), x=["vx"])
    assert Recording.read(pl.DataFrame({"vx": v}), x=["vx"], dt=0.02).dt == 0.02


def test_names_of_columns(pd: Any, pl: Any) -> None:
    assert labels(pd.DataFrame(X, columns=NAMES)) == labels(pl.DataFrame(X, schema=NAMES)) == ("u", "v")
    assert labels(pd.Series(T, name="u")) == labels(pl.Series("u", T)) == ("u",)
    for unnamed in (pd.DataFrame(X), pd.Series(T), pl.Series(T), X, [1.0]):
        assert labels(unnamed) is None


# -- times ------------------------------------------------------------------------------------------------------


def test_times_of_pandas(pd: Any) -> None:
    utc = pd.DatetimeIndex(STAMPS, tz="UTC")
    for unit in ("ns", "us", "ms"):
        for index in (utc, utc.tz_convert(BERLIN), pd.DatetimeIndex(STAMPS)):
            index = index.as_unit(unit)
            for times in (index, pd.Series(index), list(index), pd.Series(list(index), dtype=object)):
                np.testing.assert_array_equal(seconds("times", times), T)
                assert_runs_alike(pd.DataFrame(X), times)
    for lengths in (pd.to_timedelta(MS, unit="ms"), list(pd.to_timedelta(MS, unit="ms"))):
        np.testing.assert_array_equal(seconds("times", lengths), T)
    nanoseconds = [pd.Timestamp(k, tz="UTC") for k in (1_700_000_000_000_000_001, 1_700_000_000_000_000_004)]
    np.testing.assert_array_equal(seconds("times", nanoseconds), [0.0, 3e-9])


def test_times_of_polars(pl: Any) -> None:
    naive = pl.Series(STAMPS)
    utc = naive.dt.replace_time_zone("UTC")
    for times in (naive, utc, utc.dt.convert_time_zone(BERLIN), pl.Series(MS.astype("timedelta64[ms]"))):
        np.testing.assert_array_equal(seconds("times", times), T)


def test_times_of_xarray(xr: Any, pd: Any) -> None:
    for stamps in (
        STAMPS,
        pd.DatetimeIndex(STAMPS, tz="UTC").tz_convert(BERLIN),
        MS.astype("timedelta64[ms]"),
    ):
        np.testing.assert_array_equal(seconds("times", xr.DataArray(stamps, dims="time")), T)


def test_datetime_objects() -> None:
    naive = [datetime(2024, 3, 31, 0, 59, 59, 800_000) + timedelta(milliseconds=int(ms)) for ms in MS]
    utc = [each.replace(tzinfo=UTC) for each in naive]
    berlin = [each.astimezone(ZoneInfo(BERLIN)) for each in utc]
    for times in (
        naive,
        utc,
        berlin,
        [*utc[:9], *berlin[9:]],
        [timedelta(milliseconds=int(ms)) for ms in MS],
    ):
        assert_runs_alike(X, times)
        assert_runs_alike(X, np.array(times, dtype=object))
    with pytest.raises(ValueError, match="got nan in row 3"):
        F.run(X, times=[*utc[:3], None, *utc[4:]])
    with pytest.raises(ValueError, match="got nan in row 3"):
        F.run(X, times=np.ma.array(utc, mask=np.arange(N) == 3))


@pytest.mark.parametrize(
    ("times", "reason"),
    [
        (
            [datetime(2024, 1, 1, tzinfo=UTC), datetime(2024, 1, 2)],
            r"got both \(row 1 has none\); give each its tzinfo",
        ),
        ([datetime(2024, 1, 1), timedelta(1)], "datetime and timedelta"),
        (["2024-01-01", "2024-01-02"], "text may mean any format and time zone"),
        (np.array(["2024-01-01", "2024-01-02"], object), r"object \(str\); text may mean any format"),
        ([date(2024, 1, 1), date(2024, 1, 2)], r"object \(date\)"),
        ([datetime(2024, 1, 1), 3.0], r"object \(float\)"),
        (np.array([], object), r"object \(nothing\)"),
    ],
)
def test_times_that_are_ambiguous_are_refused(times: Any, reason: str) -> None:
    with pytest.raises(TypeError, match="^times: expected .*" + reason):
        seconds("times", times)


def test_times_of_other_kinds_are_refused(pd: Any, pl: Any) -> None:
    doors: list[tuple[Callable[[], Any], str]] = [
        (lambda: pd.Series(["2024-01-01", "2024-01-02"]), "text may mean"),
        (lambda: pl.Series(["2024-01-01", "2024-01-02"]), "text may mean"),
        (lambda: pd.period_range("2024", periods=2, freq="s"), "Period"),
        (
            lambda: pd.DataFrame({"t": [0.0, 1.0]}),
            r"got a frame with columns \['t'\]; give one of its columns",
        ),
        (
            lambda: pl.DataFrame({"t": [0.0, 1.0]}),
            r"got a frame with columns \['t'\]; give one of its columns",
        ),
    ]
    for make, reason in doors:
        with pytest.raises(TypeError, match="^times: expected .*" + reason):
            seconds("times", make())
    for ticks in (
        pd.Series([1, 2]) * 10**9,
        pd.array([10**9, 2 * 10**9], dtype="Int64"),
        pl.Series([10**9, 2 * 10**9]),
    ):
        with pytest.raises(ValueError, match="ticks of a clock"):
            seconds("times", ticks)
    with pytest.raises(ValueError, match="got nan in row 1"):
        F.run(X[:2], times=pd.DatetimeIndex(["2024-01-01", None], tz="UTC"))


# -- recordings -------------------------------------------------------------------------------------------------


def test_a_log_goes_to_pandas_and_back(pd: Any) -> None:
    rng = np.random.default_rng(2)
    x, g, label, inertia = rng.standard_normal((4, N, 2))
    log = Recording(T, x, g=g, label=label, inertia=inertia, channels=NAMES, name="hover", unit="m/s")
    frame = log.to_pandas()
    assert frame.index.name == "t"
    assert list(frame) == [*NAMES, "label_u", "label_v", "g_u", "g_v", "inertia_0", "inertia_1"]
    assert frame.attrs == {"name": "hover", "unit": "m/s"}
    signals = {key: frame[[f"{key}_u", f"{key}_v"]] for key in ("g", "label")}
    again = Recording(frame.index, frame[NAMES], **signals, inertia=frame[["inertia_0", "inertia_1"]])
    assert again.channels == log.channels
    for key in ("times", "x", "g", "label", "inertia"):
        assert getattr(again, key).tobytes() == getattr(log, key).tobytes(), key
    assert not np.shares_memory(frame.to_numpy(), log.x)
    frame.iloc[0, 0] = 9.0
    view = log.to_pandas(copy=False)
    assert all(np.shares_memory(view[name].to_numpy(), log.x) for name in NAMES)
    assert np.shares_memory(view["g_v"].to_numpy(), log.g)
    assert view["u"].iloc[0] == log.x[0, 0] != 9.0
    view["u"] = 0.0
    assert log.x[:, 0].any()
    with pytest.raises(ValueError, match="to_pandas: expected different columns"):
        Recording(T, x, g=g, channels=["u", "g_u"]).to_pandas()


def test_the_example_of_to_pandas_runs_where_pandas_is(pd: Any) -> None:
    text = (inspect.getdoc(Recording.to_pandas) or "").replace("  # doctest: +SKIP", "")
    example = doctest.DocTestParser().get_doctest(text, {}, "to_pandas", None, 0)
    assert len(example.examples) == 3
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0


def test_without_pandas_the_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        ImportError, match=r"to_pandas needs the package pandas: pip install 'phyfilter-ctl\[con"
    ):
        Recording(T, X).to_pandas()


def test_logs_of_frames(pd: Any, pl: Any, xr: Any) -> None:
    expected = Recording(T, X, g=X, channels=NAMES)
    utc = pd.DatetimeIndex(STAMPS, tz="UTC").tz_convert(BERLIN)
    given = [
        (utc, pd.DataFrame(X, columns=NAMES, index=utc)),
        (pl.Series(STAMPS), pl.DataFrame(X, schema=NAMES)),
    ]
    for times, frame in given:
        log = Recording(times, frame, g=frame)
        assert (log.channels, log.n) == (expected.channels, N)
        for name in ("times", "x", "g"):
            assert getattr(log, name).tobytes() == getattr(expected, name).tobytes()
        assert Recording.from_arrays(x=frame, dt=0.01).channels == ("u", "v")
        assert Recording.from_arrays(x=frame, dt=0.01, channels=["p", "q"]).channels == ("p", "q")
    labelled = xr.DataArray(X, dims=("time", "channel"), coords={"time": STAMPS})
    assert np.array_equal(Recording(labelled.time, labelled).x, X)
    assert np.array_equal(Recording(labelled.time, labelled).times, T)
    series = pd.Series(X[:, 0], name="u")
    assert Recording(T, series, label=series).channels == ("u",)


def test_a_log_of_a_frame_is_a_copy(pd: Any) -> None:
    block = X.copy()
    log = Recording(T, pd.DataFrame(block, copy=False))
    block[:] = 0.0
    assert np.array_equal(log.x, X)


def test_the_filter_learned_from_frames_is_the_same(pd: Any) -> None:
    t = 0.01 * np.arange(400)
    f = np.sin(3.0 * t) + np.sin(0.7 * t)
    x = np.cumsum(0.01 * f) + 1e-3 * np.random.default_rng(0).standard_normal(400)
    plain = Recording(t, x[:, None], label=f[:, None])
    frame = pd.DataFrame({"x": x, "f": f}, index=t)
    framed = Recording(frame.index, frame["x"], label=frame["f"])
    one, other = (learn(log, 1) for log in (plain, framed))
    assert one.filter == other.filter
