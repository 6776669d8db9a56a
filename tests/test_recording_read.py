"""One reader of tables, with one set of rules: whatever the format, the same table is the same recording."""

from __future__ import annotations

import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl import Reading, Recording, learn
from phyfilter_ctl.recording.header import Columns, unit_in, unit_of_time

T = 0.01 * np.arange(300)
V = np.sin(3.0 * T)


def table(names=("t", "vx", "label_vx"), times=T, delimiter=",", decimal="."):
    rows = zip(times, V, 3.0 * np.cos(3.0 * T), strict=True)
    lines = [delimiter.join(names)]
    lines += [delimiter.join(repr(float(value)).replace(".", decimal) for value in row) for row in rows]
    return "\n".join(lines) + "\n"


@pytest.fixture
def csv(tmp_path):
    def written(text, name="flight.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return written


ONE = {"x": ["vx"]}


@pytest.mark.parametrize(
    "text",
    [
        table(),
        table(delimiter=";"),
        table(delimiter="\t"),
        table(delimiter=";", decimal=","),
        table(("Time", "VX", "label_VX")),
        table(("time [s]", "vx [m/s]", "label_vx [N]")),
        table(("t [ms]", "vx", "label_vx"), 1e3 * T),
        table(("stamp_us", "vx", "label_vx"), 1e6 * T),
        "# a comment\n\n" + table(),
        "\ufeff" + table(),
    ],
    ids=["plain", "semicolon", "tab", "comma", "case", "units", "ms", "us", "comment", "mark"],
)
def test_one_recording_however_it_is_written(csv, text):
    found = Recording.read(csv(text), **ONE)
    expected = Recording.from_csv(csv(table(), "plain.csv"), x=["vx"])
    assert found.channels[0].lower() == "vx"
    np.testing.assert_allclose(found.times - found.times[0], T, atol=1e-12)
    np.testing.assert_allclose(found.x, expected.x, rtol=1e-12)
    if found.channels == ("vx",):
        np.testing.assert_allclose(found.label, expected.label, rtol=1e-12)
    assert found.name == "flight"


def test_units_of_the_columns_are_those_of_the_recording(csv):
    assert Recording.read(csv(table(("t", "vx [mm/s]", "label_vx"))), **ONE).unit == "mm/s"
    assert Recording.read(csv(table(("t", "vx [mm/s]", "label_vx"))), x=["vx [mm/s]"]).channels == ("vx",)
    with pytest.raises(ValueError, match="unit: the columns of x say mm/s, got 'm/s'"):
        Recording.read(csv(table(("t", "vx [mm/s]", "label_vx"))), unit="m/s", **ONE)
    with pytest.raises(ValueError, match=r"one unit for all columns of x, got 'a \[m/s\]', 'b \[rad/s\]'"):
        Recording.read(csv(table(("t", "a [m/s]", "b [rad/s]"))), x=["a", "b"])


def test_times_that_are_no_seconds_are_asked_for(csv):
    for factor in (1e3, 1e6):
        path = csv(table(times=factor * T))
        with pytest.raises(ValueError, match=r"expected 10 us to 1 s.*say it by time_unit="):
            Recording.read(path, **ONE)
        unit = {1e3: "ms", 1e6: "us"}[factor]
        assert Recording.read(path, time_unit=unit, **ONE).dt == pytest.approx(0.01)
    with pytest.raises(ValueError, match=r"is in ms, got time_unit='us'"):
        Recording.read(csv(table(("t [ms]", "vx", "label_vx"), 1e3 * T)), time_unit="us", **ONE)
    with pytest.raises(ValueError, match="time_unit: expected one of s, ms, us, ns, got 'h'"):
        Recording.read(csv(table()), time_unit="h", **ONE)


def test_a_table_without_times_needs_the_step(csv):
    path = csv(table(("k", "vx", "label_vx"), np.arange(300.0)))
    with pytest.raises(ValueError, match="name it by time="):
        Recording.read(path, **ONE)
    assert Recording.read(path, dt=0.01, **ONE).dt == 0.01
    with pytest.raises(ValueError, match="dt: is for tables without times"):
        Recording.read(path, dt=0.01, time="k", **ONE)
    with pytest.raises(ValueError, match=r"time: no column 'when', only k, vx, label_vx"):
        Recording.read(path, time="when", **ONE)


def test_what_is_wrong_is_named_by_its_line(csv):
    lines = table().splitlines()
    lines[7] = "0.06,,1.0"
    with pytest.raises(ValueError, match=r"flight.csv, line 8|flight.csv: line 8"):
        Recording.read(csv("\n".join(lines)), **ONE)
    with pytest.raises(ValueError, match=r"no column 'vx' \(x\)"):
        Recording.read(csv(table(("t", "v", "label_v"))), **ONE)


def test_names_that_are_none_are_refused(csv):
    for given in ({"x": 3}, {"x": [3]}, {"x": []}, {"label": 3}):
        with pytest.raises(TypeError, match=f"{next(iter(given))}: expected names of columns"):
            Recording.read(csv(table()), **(ONE | given))
    with pytest.raises(ValueError, match="x: names a column twice"):
        Recording.read(csv(table()), x=["vx", "vx"])


def test_other_things_are_refused():
    for wrong in ({"t": T, "vx": V}, V, 3):
        with pytest.raises(TypeError, match="source: expected a path, or a frame"):
            Recording.read(wrong, **ONE)


def test_learn_reads_by_the_same_rules(csv):
    path = csv(table(("Time [ms]", "vx [m/s]", "label_vx"), 1e3 * T, delimiter=";"))
    found = learn([path], 1, reading=Reading(read=lambda file: Recording.read(file, **ONE), workers=1))
    log = Recording.read(path, **ONE)
    assert found.filter == pf.learn(log, 1).filter


@pytest.mark.parametrize(
    ("name", "unit", "time"),
    [
        ("vx [m/s]", "m/s", ""),
        ("t [ms]", "ms", "ms"),
        ("time_us", "", "us"),
        ("v[0]", "", ""),
        ("J[0,1]", "", ""),
        ("t (sec)", "sec", "s"),
        ("[m]", "", ""),
    ],
)
def test_units_in_names(name, unit, time):
    assert (unit_in(name), unit_of_time(name)) == (unit, time)


def test_names_that_are_alike_keep_what_tells_them_apart(tmp_path):
    columns = Columns(tmp_path, ("v [m/s]", "v [ft/s]", "a", "A", "w [rad/s]", "w"))
    assert columns.header == ("v [m/s]", "v [ft/s]", "a", "A", "w [rad/s]", "w")
    assert columns.found(["v [m/s]", "a", "A", "w"]) == ["v [m/s]", "a", "A", "w"]
    assert columns.found("V [M/S]") == "v [m/s]"
    assert columns.found("nothing") == "nothing"


def test_selected_channels_are_those_of_the_recording():
    rng = np.random.default_rng(0)
    x, g, label = (rng.standard_normal((50, 3)) for _ in range(3))
    M = np.diag([1.0, 2.0, 3.0])
    M[0, 1] = M[1, 0] = 0.2
    log = Recording.from_arrays(
        x=x, dt=0.01, g=g, label=label, inertia=M, channels=["a", "b", "c"], unit="m/s"
    )
    two = log.select(["b", "a"])
    assert (two.channels, two.unit, two.n) == (("b", "a"), "m/s", 50)
    np.testing.assert_array_equal(two.label, label[:, [1, 0]])
    np.testing.assert_array_equal(np.squeeze(two.inertia), [[2.0, 0.2], [0.2, 1.0]])
    np.testing.assert_array_equal(log.select([2]).g, g[:, [2]])
    heavy = Recording.from_arrays(x=x, dt=0.01, inertia=[1.0, 2.0, 3.0], channels=["a", "b", "c"])
    sampled = pf.PhyFilter([5.0]).sampled(0.01)
    np.testing.assert_allclose(sampled.run(heavy.select(["c"]))[:, 0], sampled.run(heavy)[:, 2], rtol=1e-12)
    with pytest.raises(ValueError, match="the inertia couples those kept with b"):
        log.select(["a", "c"])
    for wrong, error, words in (
        ("a", TypeError, "expected a sequence"),
        ([], TypeError, "expected a sequence"),
        (["d"], ValueError, "there is no 'd'; expected some of a, b, c, or 0 to 2"),
        ([3], ValueError, "there is no 3"),
        (["a", 0], ValueError, "names a channel twice"),
    ):
        with pytest.raises(error, match=words):
            heavy.select(wrong)
