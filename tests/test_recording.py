"""Recording: what goes in comes out, and what is wrong is named by its place."""

from __future__ import annotations

import inspect
from dataclasses import FrozenInstanceError, fields
from datetime import timedelta
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from phyfilter_ctl import PhyFilter
from phyfilter_ctl.recording import Recording, split

# Interpolation is a difference, a product and a sum of numbers of size 1: a few roundings.
ROUNDING = 1e-14

GOOD = "t,vx,vy,vz,ax,ay,az\n0.0,1,2,3,4,5,6\n0.1,1.5,2.5,3.5,4.5,5.5,6.5\n0.3,7,8,9,10,11,12\n"
SIGNALS = ("times", "x", "g", "f_theta", "label", "features", "inertia")

finite = st.floats(-1e150, 1e150)


def log_of(n: int = 6, n_x: int = 2, seed: int = 0) -> Recording:
    """A log with all signals and unequal steps."""
    rng = np.random.default_rng(seed)
    x, g, f_theta, label = rng.standard_normal((4, n, n_x))
    return Recording.from_arrays(
        x=x,
        times=np.cumsum(rng.uniform(0.01, 0.03, n)),
        g=g,
        f_theta=f_theta,
        label=label,
        features=rng.standard_normal((n, 4)),
        inertia=rng.standard_normal((n, n_x)),
        name="flight",
        channels=["a", "b", "c"][:n_x],
        unit="m/s",
    )


def written(tmp_path: Path, text: str, encoding: str = "utf-8") -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    return path


def assert_same(one: Recording, other: Recording, names: tuple[str, ...] = SIGNALS) -> None:
    """Bit for bit, the sign of zero included."""
    for name in names:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            assert a.shape == b.shape, name
            assert a.tobytes() == b.tobytes(), name


# -- construction -----------------------------------------------------------------------------------------------


def test_arrays_are_copied_and_read_only() -> None:
    x = np.zeros((3, 2))
    log = Recording.from_arrays(x=x, dt=0.1, g=x, inertia=[1.0, 2.0])
    x[0, 0] = 7.0
    assert log.x[0, 0] == 0.0
    for value in (log.times, log.x, log.g, log.inertia):
        assert value is not None
        with pytest.raises(ValueError, match="read-only"):
            value[0] = 1.0
    with pytest.raises(FrozenInstanceError):
        log.name = "other"  # type: ignore[misc]  # that it is refused is the test


def test_reads_off_its_figures() -> None:
    log = Recording.from_arrays(x=np.zeros((4, 3)), times=[1.0, 1.1, 1.2, 2.0])
    assert (log.n, log.n_x, log.duration, log.is_uniform) == (4, 3, 1.0, False)
    assert log.dt == pytest.approx(0.1, rel=1e-12)  # the median step, not the mean 1/3
    assert log.channels == ("x[0]", "x[1]", "x[2]")
    assert "dt about" in repr(log)


@pytest.mark.parametrize("dt", [0.002, 0.01, 1.0 / 3.0])
@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_uniform_in_spite_of_rounded_times(dt: float, start: float) -> None:
    log = Recording.from_arrays(x=np.zeros((5000, 1)), times=start + dt * np.arange(5000))
    assert log.is_uniform
    assert log.dt == pytest.approx(dt, rel=1e-6)


@pytest.mark.parametrize(("jitter", "uniform"), [(0.5e-6, True), (4e-6, False)])
def test_uniform_to_the_stated_tolerance(jitter: float, uniform: bool) -> None:
    times = 0.01 * np.arange(100)
    times[50] += 0.01 * jitter
    assert Recording.from_arrays(x=np.zeros((100, 1)), times=times).is_uniform is uniform


@pytest.mark.parametrize("shape", [(), (2,), (2, 2), (5, 2), (5, 2, 2)])
def test_inertia_of_any_shape_and_sign(shape: tuple[int, ...]) -> None:
    inertia = -np.ones(shape)
    log = Recording.from_arrays(x=np.zeros((5, 2)), dt=0.1, inertia=inertia)
    assert log.inertia is not None
    assert np.array_equal(log.inertia, inertia)
    assert log.inertia.shape == shape


def bad(row: int, column: int, value: float, shape: tuple[int, int] = (5, 2)) -> np.ndarray:
    array = np.zeros(shape)
    array[row, column] = value
    return array


ZERO = np.zeros((5, 2))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"x": np.zeros((5, 2, 2)), "dt": 0.1}, r"x: expected shape \(N, n_x\), got \(5, 2, 2\)"),
        ({"x": 1.0, "dt": 0.1}, r"x: expected shape \(N, n_x\), got \(\)"),
        ({"x": np.zeros(1), "dt": 0.1}, "at least 2 samples, got 1"),
        ({"x": np.zeros((5, 0)), "dt": 0.1}, r"x: expected shape .* got \(5, 0\)"),
        ({"x": np.zeros((1, 2)), "dt": 0.1}, "at least 2 samples, got 1"),
        ({"x": np.zeros((0, 2)), "dt": 0.1}, r"x: expected shape \(N, n_x\), got \(0, 2\)"),
        ({"x": ZERO}, "exactly one of times and dt, got neither"),
        ({"x": ZERO, "dt": 0.1, "times": np.arange(5.0)}, "exactly one of times and dt, got both"),
        ({"x": ZERO, "dt": 0.0}, "dt: expected a finite number > 0 s"),
        ({"x": ZERO, "dt": np.nan}, "dt: expected a finite number > 0 s"),
        ({"x": ZERO, "times": np.arange(4.0)}, r"times: expected shape \(5,\).*got \(4,\)"),
        ({"x": ZERO, "times": [0.0, 1.0, 1.0, 2.0, 3.0]}, "times: .*row 2 .*stands still"),
        ({"x": ZERO, "times": [0.0, 1.0, 2.0, 1.5, 1.5]}, "row 3 .*runs back.*row 4 .*stands still"),
        (
            {"x": ZERO, "times": [0.0, 1.0, np.inf, 2.0, 3.0]},
            "times: expected finite.* got inf in row 2",
        ),
        (
            {"x": bad(3, 1, np.nan), "dt": 0.1},
            r"x: expected finite numbers, none masked, got nan in row 3, x\[1\]",
        ),
        ({"x": bad(3, 1, np.nan), "dt": 0.1, "channels": ["u", "w"]}, "x: .* got nan in row 3, w;"),
        ({"x": ZERO, "dt": 0.1, "g": bad(4, 0, -np.inf)}, r"g: .* got -inf in row 4, x\[0\]"),
        (
            {"x": ZERO, "dt": 0.1, "f_theta": np.zeros((5, 3))},
            r"f_theta: expected shape \(5, 2\).*got \(5, 3\)",
        ),
        ({"x": ZERO, "dt": 0.1, "label": np.zeros(5)}, r"label: expected shape \(5, 2\).*got \(5,\)"),
        (
            {"x": ZERO, "dt": 0.1, "features": np.zeros((4, 3))},
            r"features: expected shape \(5, n_z\).*got \(4, 3\)",
        ),
        (
            {"x": ZERO, "dt": 0.1, "features": bad(1, 2, np.nan, (5, 3))},
            "features: .* got nan in row 1, column 2",
        ),
        (
            {"x": ZERO, "dt": 0.1, "inertia": np.ones(3)},
            r"inertia: expected a number or shape.*got shape \(3,\)",
        ),
        ({"x": ZERO, "dt": 0.1, "inertia": np.ones((4, 2))}, r"got shape \(4, 2\)"),
        ({"x": ZERO[:2], "dt": 0.1, "inertia": np.eye(2)}, "inertia: .*ambiguous where N == n_x"),
        (
            {"x": ZERO, "dt": 0.1, "inertia": [1.0, np.inf]},
            "inertia: expected finite numbers, none masked, got inf in entry 1",
        ),
        ({"x": ZERO, "dt": 0.1, "inertia": bad(2, 1, np.nan)}, r"inertia: .* got nan in row 2, column 1"),
        ({"x": ZERO, "dt": 0.1, "channels": ["a"]}, "channels: expected 2 names.*got 1"),
        ({"x": ZERO, "dt": 0.1, "channels": ["a", "a"]}, "channels: expected different names"),
        ({"x": ZERO, "dt": 0.1, "channels": ["a", " b"]}, "channels: expected printable names"),
        ({"x": ZERO, "dt": 0.1, "channels": ["a", "b\n"]}, "channels: expected printable names"),
    ],
)
def test_refuses(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Recording.from_arrays(**arguments)  # type: ignore[arg-type]  # wrong on purpose


def test_refuses_what_is_not_real() -> None:
    for x in ([[1.0, 2.0], [3.0]], [["a"], ["b"]], np.zeros((3, 1), dtype=complex)):
        with pytest.raises(TypeError, match="x: expected an array of real numbers"):
            Recording.from_arrays(x=x, dt=0.1)
    with pytest.raises(TypeError, match="channels: expected 2 names"):
        Recording.from_arrays(x=ZERO, dt=0.1, channels="ab")


def test_counts_many_bad_samples() -> None:
    with pytest.raises(ValueError, match="10 such values in all"):
        Recording.from_arrays(x=np.full((5, 2), np.nan), dt=0.1)
    with pytest.raises(ValueError, match=r"row 5 .* and 4 more"):
        Recording.from_arrays(x=np.zeros((10, 1)), times=np.zeros(10))


# -- files ------------------------------------------------------------------------------------------------------


def test_reads_the_default_columns(tmp_path: Path) -> None:
    log = Recording.from_csv(written(tmp_path, GOOD))
    assert log.times.tolist() == [0.0, 0.1, 0.3]
    assert log.x.tolist() == [[1, 2, 3], [1.5, 2.5, 3.5], [7, 8, 9]]
    assert log.label is not None
    assert log.label[2].tolist() == [10, 11, 12]
    assert (log.name, log.channels, log.unit) == ("log", ("vx", "vy", "vz"), "m/s")
    assert log.g is None
    assert log.inertia is None


def test_reads_columns_by_name_in_any_order(tmp_path: Path) -> None:
    path = written(tmp_path, "mode;f;ms;v;p\nhover;1;0;2;3\nland;4;10;5;6\n")
    log = Recording.from_csv(
        path,
        time="ms",
        x=["v"],
        g=["f"],
        features=["p", "v"],
        scale={"ms": 1e-3, "f": 2.0},
        delimiter=";",
        inertia=1.5,
        unit="m/s",
    )
    assert log.times.tolist() == [0.0, 0.01]
    assert log.x.tolist() == [[2.0], [5.0]]
    assert log.g is not None
    assert log.g.tolist() == [[2.0], [8.0]]
    assert log.features is not None
    assert log.features.tolist() == [[3.0, 2.0], [6.0, 5.0]]
    assert log.inertia == 1.5
    assert (log.name, log.channels, log.unit, log.label) == (path.stem, ("v",), "m/s", None)


def test_a_single_name_is_one_column(tmp_path: Path) -> None:
    log = Recording.from_csv(written(tmp_path, GOOD), x="vx", label="ax")
    assert log.channels == ("vx",)
    assert log.unit == ""


def test_label_none_leaves_it_out(tmp_path: Path) -> None:
    assert Recording.from_csv(written(tmp_path, GOOD), label=None).label is None


def test_dt_for_a_file_without_times(tmp_path: Path) -> None:
    path = written(tmp_path, "vx,vy,vz\n1,2,3\n1,2,3\n")
    assert Recording.from_csv(path, time=None, dt=0.5).times.tolist() == [0.0, 0.5]
    with pytest.raises(ValueError, match=r"exactly one of time .* got time='t' and dt=0.5"):
        Recording.from_csv(path, dt=0.5)
    with pytest.raises(ValueError, match=r"exactly one of time .* got neither"):
        Recording.from_csv(path, time=None)


def test_inertia_by_columns(tmp_path: Path) -> None:
    text = "t,u,w,m1,m2,j\n0,1,2,3,4,5\n1,1,2,6,7,8\n2,1,2,9,10,11\n"
    diagonal = Recording.from_csv(written(tmp_path, text), x=["u", "w"], inertia=["m1", "m2"])
    assert diagonal.inertia is not None
    assert diagonal.inertia.tolist() == [[3, 4], [6, 7], [9, 10]]
    with pytest.raises(ValueError, match="inertia: expected 2 or 4 columns for the 2 of x, got 3"):
        Recording.from_csv(written(tmp_path, text), x=["u", "w"], inertia=["m1", "m2", "j"])


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (GOOD, "utf-8-sig"),
        ("# recorded on the bench\n\n" + GOOD, "utf-8"),
        ("# recorded on the bench\n" + GOOD, "utf-8-sig"),
        (GOOD.replace("0.1,", "# pause, 5\n\n0.1,"), "utf-8"),
        (GOOD.replace("\n", "\r\n"), "utf-8"),
        (GOOD.replace(",", " , "), "utf-8"),
        (GOOD.replace("t,vx", '"t","vx"').replace("0.1,1.5", '"0.1","1.5"'), "utf-8"),
        (GOOD.replace("\n", ",\n"), "utf-8"),
        (GOOD.rstrip("\n"), "utf-8"),
        (GOOD + "\n  \n", "utf-8"),
    ],
    ids=[
        "bom",
        "comment",
        "bom+comment",
        "comment inside",
        "crlf",
        "spaces",
        "quotes",
        "trailing",
        "no end",
        "blank",
    ],
)
def test_tolerates(tmp_path: Path, text: str, encoding: str) -> None:
    plain = Recording.from_csv(written(tmp_path, GOOD))
    assert_same(Recording.from_csv(written(tmp_path, text, encoding)), plain)


HEAD = "t,vx,vy,vz\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "log.csv: the file is empty"),
        ("# only\n\n# comments\n", "the file is empty"),
        (HEAD, "no rows follow the header on line 1"),
        ("# c\n" + HEAD + "# c\n", "no rows follow the header on line 2"),
        (HEAD + "0,1,2,3\n", "at least 2 rows, got 1"),
        ("0,1,2,3\n1,1,2,3\n", "line 1 holds numbers, expected a header"),
        ("t,vx,vx,vz\n0,1,2,3\n", "line 1 names columns more than once: 'vx'"),
        ("t,vx,vz\n0,1,2\n", r"no column 'vy' \(x\); line 1 has t, vx, vz"),
        ("time,vx,vy,vz\n0,1,2,3\n", r"no column 't' \(time\)"),
        (HEAD + "0,1,2,3\n1,1,2\n2,1,2,3\n", "line 3 has 3 fields, expected 4 as in the header: '1,1,2'"),
        (HEAD + "0,1,2,3\n1,1,2,3,4\n", "line 3 has 5 fields, expected 4"),
        (HEAD + "0,1,2\n1,1,2\n", "line 2 has 3 fields, expected 4"),
        (HEAD + "# c\n\n0,1,2,3\n1,1,two,3\n", "line 5, column 'vy': 'two' is not a number"),
        (HEAD + "0,1,2,3\n1,1, ,3\n", "line 3, column 'vy': the field is empty"),
        (HEAD + "0,1,2,3\n1,1_0,2,3\n", "line 3, column 'vx': '1_0' is not a number"),
        (HEAD + "0,1,2,3\n1,1#0,2,3\n", "line 3, column 'vx': '1#0' is not a number"),
        (HEAD + "0,1,2,3\n1,1\x00,2,3\n", "line 3, column 'vx': .* is not a number"),
        (HEAD + '0,1,2,3\n1,"1"0,2,3\n', "line 3: .*expected after"),
        (
            HEAD + "0,1,2,3\n1,1,2," + "9" * 30 + "x" * 99 + "\n",
            r"line 3, column 'vz': '9{30}x{30}\.\.\.' is not",
        ),
        (HEAD + "# c\n0,1,2,3\n1,nan,2,3\n2,inf,2,3\n", "got nan in line 4, column 'vx'.*2 such values"),
        (HEAD + "0,1,2,3\n1,1e999,2,3\n", "got inf in line 3, column 'vx'"),
        (
            HEAD + "# c\n0,1,2,3\n0,1,2,3\n1,1,2,3\n0.5,1,2,3\n",
            "column 't': .*line 4 .*stands still.*line 6 .*runs",
        ),
        ("t,vx,vy,vz,ax,az\n0,1,2,3,4,5\n", "has ax, az but no ay; name the columns of label="),
        ("t,vx,vy,vz,feature_0,feature_2\n0,1,2,3,4,5\n", "has feature_0, feature_2 but no feature_1"),
        ("t,vx,vy,vz\n0,1,2,3\n1,\xe9,2,3\n", "line 3, column 'vx': 'é' is not a number"),
    ],
)
def test_refuses_a_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Recording.from_csv(written(tmp_path, text))


def test_refuses_what_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(GOOD.encode() + b"\xff\xfe")
    with pytest.raises(ValueError, match=f"not UTF-8 text .*byte {len(GOOD)}"):
        Recording.from_csv(path)
    with pytest.raises(FileNotFoundError):
        Recording.from_csv(tmp_path / "none.csv")


def test_numbers_beyond_reckoning_are_named_by_their_line(tmp_path: Path) -> None:
    """numpy would warn of an overflow somewhere later, and go on with infinities."""
    for text, message in (
        (
            "t,v\n0,1\n1,-1e308\n2,1\n",
            r"log.csv: expected finite numbers up to 1e\+150, got -1e\+308 in line 3, column 'v'; choose another",
        ),
        ("t,v\n-1e308,1\n0,1\n1e308,1\n", r"got -1e\+308 in line 2, column 't'.*2 such values"),
        ("t,v\n0,1\n1e-310,1\n1,1\n", r"line 3 \(0 s, then 1e-310 s: stands still\)"),
    ):
        with pytest.raises(ValueError, match=message):
            Recording.from_csv(written(tmp_path, text), x=["v"])
    path = written(tmp_path, "t,v\n0,0\n1,1e200\n")
    with pytest.raises(ValueError, match="got inf in line 3, column 'v'"):
        Recording.from_csv(path, x=["v"], scale={"v": 1e200})
    assert Recording.from_csv(path, x=["v"], scale={"v": 1e-100}).speed(100) == pytest.approx(1e100)
    edge = np.array([[1e150], [-1e150], [1e150]])
    log = Recording.from_arrays(x=edge, dt=1e-3, label=edge, f_theta=-edge)
    assert np.isfinite(log.compare({"none": 0.0 * edge}).rmse["f_theta"])
    assert np.isfinite(log.resample(5e-4).x).all()
    assert np.isfinite(PhyFilter([400.0, 40.0]).sampled(1e-3).run(log.x, f_theta=log.f_theta)).all()


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"x": []}, TypeError, "x: expected names of columns"),
        ({"x": ["vx", "vx"]}, ValueError, "x: names a column twice"),
        ({"g": ["vx"]}, ValueError, "g: expected 3 columns for the 3 of x, got 1"),
        ({"g": ["gx", "gy", "gz"]}, ValueError, r"no column 'gx' \(g\), 'gy' \(g\), 'gz' \(g\)"),
        ({"scale": {"vq": 2.0}}, ValueError, "scale: no column 'vq' is read"),
        ({"scale": {"vx": 0.0}}, ValueError, "scale: expected a finite factor other than 0 for 'vx'"),
        ({"delimiter": ",,"}, ValueError, "delimiter: expected one character"),
        ({"delimiter": "."}, ValueError, "delimiter: expected one character"),
        ({"delimiter": ";"}, ValueError, "no column 't'.*check the delimiter"),
    ],
)
def test_refuses_options(tmp_path: Path, options: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        Recording.from_csv(written(tmp_path, GOOD), **options)


@given(
    data=st.data(), n=st.integers(2, 6), n_x=st.integers(1, 3), wanted=st.sets(st.sampled_from(SIGNALS[2:6]))
)
def test_round_trip_is_bit_exact(tmp_path_factory, data, n: int, n_x: int, wanted: set[str]) -> None:
    steps = data.draw(arrays(float, n - 1, elements=st.floats(1e-9, 1e3)))
    signals = {name: data.draw(arrays(float, (n, n_x), elements=finite), name) for name in wanted}
    log = Recording.from_arrays(
        x=data.draw(arrays(float, (n, n_x), elements=finite)),
        times=np.concatenate([[0.0], np.cumsum(steps)]),
        channels=data.draw(st.sampled_from([("vx", "vy", "vz"), ("u,v", '"', "#w")]))[:n_x],
        **signals,
    )
    path = tmp_path_factory.getbasetemp() / "round.csv"
    delimiter = data.draw(st.sampled_from(",;\t"))
    log.to_csv(path, delimiter=delimiter)
    assert_same(Recording.from_csv(path, x=log.channels, delimiter=delimiter), log)


@pytest.mark.parametrize(
    ("n", "shape"),
    [(5, ()), (5, (2,)), (5, (2, 2)), (5, (5, 2)), (5, (5, 2, 2)), (2, ()), (2, (2,)), (2, (2, 2, 2))],
)
def test_inertia_survives_the_file(tmp_path: Path, n: int, shape: tuple[int, ...]) -> None:
    inertia = np.random.default_rng(3).standard_normal(shape)
    log = Recording.from_arrays(x=np.zeros((n, 2)), dt=0.1, inertia=inertia)
    log.to_csv(tmp_path / "log.csv")
    read = Recording.from_csv(tmp_path / "log.csv", x=log.channels).inertia
    assert read is not None
    assert np.array_equal(as_matrices(read, n), as_matrices(inertia, n))


def as_matrices(inertia: np.ndarray | float, n: int) -> np.ndarray:
    inertia = np.asarray(inertia)
    if inertia.ndim == 3 or inertia.shape == (2, 2):
        return np.broadcast_to(inertia, (n, 2, 2))
    return np.broadcast_to(inertia[..., None] * np.eye(2), (n, 2, 2))


def test_to_csv_refuses_one_name_twice(tmp_path: Path) -> None:
    log = Recording.from_arrays(x=np.zeros((3, 2)), dt=0.1, channels=["t", "u"])
    with pytest.raises(ValueError, match="columns would have one name: 't'"):
        log.to_csv(tmp_path / "log.csv")
    with pytest.raises(ValueError, match="would make the header a comment"):
        log.to_csv(tmp_path / "log.csv", time="#")
    assert not (tmp_path / "log.csv").exists()
    log.to_csv(tmp_path / "log.csv", time="s")
    assert_same(Recording.from_csv(tmp_path / "log.csv", time="s", x=["t", "u"]), log)


# -- parts of a log ---------------------------------------------------------------------------------------------


def test_segment_and_split_cut_every_signal() -> None:
    log = log_of(10)
    first, rest = log.split(0.4)
    assert (first.n, rest.n) == (4, 6)
    assert (rest.name, rest.channels, rest.unit) == ("flight", ("a", "b"), "m/s")
    for name in SIGNALS:
        assert np.array_equal(
            np.concatenate([getattr(first, name), getattr(rest, name)]), getattr(log, name)
        ), name
    assert_same(log.segment(4), rest)


@pytest.mark.parametrize(("start", "stop"), [(-1, None), (0, 1), (3, 3), (0, 7), (5, None)])
def test_segment_refuses(start: int, stop: int | None) -> None:
    with pytest.raises(ValueError, match=r"segment: expected 0 <= start, start \+ 2 <= stop <= 6"):
        log_of(6).segment(start, stop)


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, float("nan"), 0.1, 0.9])
def test_split_refuses(fraction: float) -> None:
    with pytest.raises(ValueError, match="fraction"):
        log_of(6).split(fraction)


def test_a_part_with_as_many_samples_as_channels_keeps_its_inertia() -> None:
    rng = np.random.default_rng(5)
    diagonal, matrix = rng.standard_normal((6, 2)), rng.standard_normal((2, 2))
    varying = Recording.from_arrays(x=np.zeros((6, 2)), dt=0.1, inertia=diagonal).segment(3, 5).inertia
    constant = Recording.from_arrays(x=np.zeros((6, 2)), dt=0.1, inertia=matrix).decimate(3).inertia
    assert varying is not None
    assert constant is not None
    assert np.array_equal(varying, [np.diag(row) for row in diagonal[3:5]])
    assert np.array_equal(constant, [matrix, matrix])


def test_slices_are_those_of_a_list() -> None:
    log = log_of(10)
    assert len(log) == log.n == 10
    for part in (slice(None), slice(2, 6), slice(-4, None), slice(1, 99), slice(0, None, 3), slice(None, -2)):
        for name in SIGNALS:
            assert np.array_equal(getattr(log[part], name), getattr(log, name)[part]), (part, name)
    assert_same(log[2:6], log.segment(2, 6))
    assert_same(log[::3], log.decimate(3))
    for part in (slice(3, 4), slice(20, 30), slice(None, None, -1), slice(6, 2)):
        with pytest.raises(ValueError, match=r"log\[...\]: expected at least 2 of 10 samples, forwards"):
            log[part]
    with pytest.raises(TypeError, match=r"expected a slice .*, got 3; one sample is log.x\[3\]"):
        log[3]  # type: ignore[index]  # wrong on purpose
    with pytest.raises(TypeError, match="expected a slice"):
        list(log)  # type: ignore[call-overload]  # wrong on purpose


def test_between_takes_both_ends() -> None:
    log = Recording.from_arrays(x=np.arange(11.0), dt=0.125)
    for start, stop in ((0.25, 0.75), (0.2, 0.8), (timedelta(milliseconds=250), np.timedelta64(750, "ms"))):
        assert_same(log.between(start, stop), log[2:7])
    assert_same(log.between(0.25), log[2:])
    assert_same(log.between(stop=0.75), log[:7])
    assert_same(log.between(-5.0, 99.0), log)
    for start, stop in ((0.8, 0.2), (0.25, 0.25), (9.0, 10.0)):
        with pytest.raises(
            ValueError, match=r"between: expected at least 2 samples .* runs from 0 s to 1.25 s"
        ):
            log.between(start, stop)
    with pytest.raises(ValueError, match="start: expected a finite number"):
        log.between(np.nan)
    with pytest.raises(TypeError, match="stop: expected a number"):
        log.between(0.0, "1")  # type: ignore[arg-type]  # wrong on purpose


def test_signals_of_one_channel_may_have_no_column() -> None:
    one, n = np.arange(6.0), 6
    log = Recording(0.1 * one, one, g=one, f_theta=one, label=one, features=one)
    for name in ("x", "g", "f_theta", "label", "features"):
        assert getattr(log, name).shape == (n, 1)
    assert_same(log.with_signals(label=one[:, None]), log)
    assert log.compare({"held": one}).rmse == {"held": 0.0, "f_theta": 0.0}


def test_describe_tells_rate_jitter_and_gaps() -> None:
    even = Recording.from_arrays(
        x=np.zeros((100, 2)), dt=0.125, channels=["a", "long name"], unit="m/s", inertia=2.0
    )
    text = even.describe()
    assert "100 samples, 12.375 s" in text
    assert "8 Hz (median step 0.125 s), uniform" in text
    assert "gaps      none" in text
    assert "    a          0 to 0 m/s" in text
    assert "    long name  0 to 0 m/s" in text
    assert "inertia (constant)" in text
    kept = np.delete(np.arange(100), [10, 40, 41, 42])
    holes = Recording(even.times[kept], even.x[kept], features=np.zeros((96, 3)), name="f").describe()
    assert "Recording 'f': 96 samples" in holes
    assert "gaps      2, 4 samples missing; the longest 0.5 s, after 4.875 s" in holes
    assert "signals   features (3)" in holes
    assert "x alone" in Recording([0.0, 1.0], [0.0, 1.0]).describe()


def test_plot_draws_what_the_log_has() -> None:
    log = log_of(20)
    plot = log.plot()
    assert plot.axes.shape == plot.lines.shape == (4, 1)
    for i in range(2):
        assert np.array_equal(plot.lines[2 * i, 0][0].get_ydata(), log.x[:, i])
        drawn = {line.get_label(): line.get_ydata() for line in plot.lines[2 * i + 1, 0]}
        assert list(drawn) == ["g", r"$f_\theta$", "label"]
        for values, name in zip(drawn.values(), ("g", "f_theta", "label"), strict=True):
            assert np.array_equal(values, getattr(log, name)[:, i])
        assert np.array_equal(plot.lines[2 * i, 0][0].get_xdata(), log.times)
    assert plot.axes[0, 0].get_ylabel() == "a [m/s]"
    assert plot.axes[0, 0].get_title("left") == "flight"
    assert [text.get_text() for text in plot.legend.get_texts()] == ["g", r"$f_\theta$", "label"]
    bare = Recording(log.times, log.x)
    again = bare.plot(ax=list(plot.axes[:2, 0]))
    assert again.axes.shape == (2, 1)
    assert again.legend is None
    with pytest.raises(ValueError, match="ax: expected 2 axes, x of each of the 2 channels, got 3"):
        bare.plot(ax=list(plot.axes[:3, 0]))
    plt.close(plot.figure)


def test_decimate_takes_every_kth_sample() -> None:
    log = log_of(7)
    thinned = log.decimate(3)
    for name in SIGNALS:
        assert np.array_equal(getattr(thinned, name), getattr(log, name)[[0, 3, 6]]), name
    assert_same(log.decimate(1), log)
    for k in (0, 7):
        with pytest.raises(ValueError, match="k: expected 1 to 6"):
            log.decimate(k)


def test_resample_follows_straight_lines_and_holds_g() -> None:
    log = log_of(40)
    even = log.resample(0.013)
    assert even.is_uniform
    assert even.times[0] == log.times[0]
    assert log.times[-1] - even.times[-1] < 0.013
    for name in ("x", "f_theta", "label", "features", "inertia"):
        expected = [np.interp(even.times, log.times, column) for column in getattr(log, name).T]
        assert np.allclose(getattr(even, name).T, expected, rtol=0.0, atol=ROUNDING), name
    assert log.g is not None
    assert even.g is not None
    held = [log.g[np.flatnonzero(log.times <= t + 1e-12)[-1]] for t in even.times]
    assert np.array_equal(even.g, held)
    linear = log.resample(0.013, g="linear").g
    assert linear is not None
    expected = [np.interp(even.times, log.times, column) for column in log.g.T]
    assert np.allclose(linear.T, expected, rtol=0.0, atol=ROUNDING)


@pytest.mark.parametrize("start", [0.0, 123.4])
def test_resample_at_its_own_rate_changes_nothing(start: float) -> None:
    rng = np.random.default_rng(8)
    x, g = rng.standard_normal((2, 1000, 2))
    log = Recording.from_arrays(x=x, g=g, times=start + 0.002 * np.arange(1000))
    again = log.resample(0.002)
    assert again.n == 1000
    assert again.g is not None
    assert np.array_equal(again.g, g)
    assert np.allclose(
        again.x, x, rtol=0.0, atol=1e-9
    )  # times near 123 s are rounded to 1e-14 s, 1e-11 of a step


def test_resample_keeps_what_is_constant() -> None:
    log = Recording.from_arrays(x=np.full((9, 1), 0.1), dt=0.3, label=np.full((9, 1), 1 / 3), inertia=2.0)
    even = log.resample(0.07)
    assert np.all(even.x == 0.1)
    assert np.all(even.label == 1 / 3)
    assert even.inertia == 2.0


def test_resample_refuses() -> None:
    log = log_of(6)
    with pytest.raises(ValueError, match="dt: expected at most the duration"):
        log.resample(10.0)
    with pytest.raises(ValueError, match="dt: expected a finite number > 0 s"):
        log.resample(-0.1)
    with pytest.raises(ValueError, match="g: expected 'hold' or 'linear', got 'average'"):
        log.resample(0.01, g="average")  # type: ignore[arg-type]  # wrong on purpose


def test_with_signals_replaces_what_is_named() -> None:
    log = log_of(6)
    new = log.with_signals(f_theta=np.ones((6, 2)), label=None)
    assert np.all(new.f_theta == 1.0)
    assert new.label is None
    assert_same(new, log, ("times", "x", "g", "features", "inertia"))
    assert log.label is not None
    with pytest.raises(ValueError, match=r"f_theta: expected shape \(6, 2\)"):
        log.with_signals(f_theta=np.ones((5, 2)))
    with pytest.raises(TypeError, match="unexpected keyword"):
        log.with_signals(lable=None)  # type: ignore[call-arg]  # wrong on purpose


def test_every_field_is_named_in_the_docstring() -> None:
    text = inspect.getdoc(Recording) or ""  # without the indentation, which Python 3.13 takes away by itself
    for entry in fields(Recording):
        assert f"\n{entry.name} : " in text, entry.name


# -- many flights -----------------------------------------------------------------------------------------------


def flight(speed: float, name: str = "") -> Recording:
    x = np.zeros((200, 2))
    x[:, 0], x[:, 1] = 0.6 * speed, -0.8 * speed
    x[0] = 100.0  # one outlier in 200 samples lies above the 99th percentile
    return Recording.from_arrays(x=x, dt=0.01, name=name)


@given(speeds=st.lists(st.floats(0.1, 10.0), min_size=2, max_size=9), fraction=st.floats(0.05, 0.95))
def test_split_by_speed(speeds: list[float], fraction: float) -> None:
    flights = [flight(speed, str(i)) for i, speed in enumerate(speeds)]
    slower, faster = split(flights, fraction=fraction)
    assert slower
    assert faster
    assert sorted(log.name for log in (*slower, *faster)) == sorted(log.name for log in flights)
    figures = [log.speed() for log in (*slower, *faster)]
    assert figures == sorted(figures)
    assert abs(len(slower) - fraction * len(flights)) <= 1.0


def test_speed_is_a_percentile_of_the_norm() -> None:
    assert flight(3.0).speed() == pytest.approx(3.0, rel=1e-12)
    assert flight(3.0).speed(100.0) == pytest.approx(100.0 * np.sqrt(2.0), rel=1e-12)
    with pytest.raises(ValueError, match="percentile: expected 0 to 100"):
        flight(3.0).speed(101.0)


def test_split_by_any_figure() -> None:
    flights = [log_of(n) for n in (9, 5, 7, 5)]
    short, long = split(flights, by=lambda log: log.n)
    assert short == (flights[1], flights[3])
    assert long == (flights[2], flights[0])


def test_split_of_several_refuses() -> None:
    with pytest.raises(ValueError, match="recordings: expected at least 2"):
        split([log_of()])
    with pytest.raises(TypeError, match="recordings: expected a sequence of them, got one"):
        split(log_of())  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(ValueError, match="fraction: expected"):
        split([log_of(), log_of()], fraction=1.0)
    with pytest.raises(ValueError, match="by: expected a finite figure"):
        split([log_of(), log_of()], by=lambda log: float("nan"))
    with pytest.raises(ValueError, match='by: expected "speed" or a function'):
        split([log_of(), log_of()], by="height")  # type: ignore[arg-type]  # wrong on purpose
