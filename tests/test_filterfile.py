"""A filter on disk: it comes back bit for bit, and a file with a mistake is refused by its key."""

from __future__ import annotations

import os
import stat
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phyfilter_ctl import PhyFilter
from phyfilter_ctl._signals import LARGEST
from phyfilter_ctl.filter import SampledPhyFilter, Sampling, stack
from phyfilter_ctl.filterfile import load, save
from phyfilter_ctl.filterfile.document import read_noted

GOOD = 'format = "phyfilter"\nversion = 1\na = [400.0, 40.0]\n'
SAMPLED = GOOD + "[sampled]\ndt = 0.002\n"
TWO = (
    'format = "phyfilter"\nversion = 1\n[[filters]]\na = [20.0]\n[[filters]]\na = [400.0, 40.0]\n'
    "[sampled]\ndt = 0.002\n"
)


def assert_same_filter(one: PhyFilter, other: PhyFilter) -> None:
    for name in ("a", "b", "poles"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


@st.composite
def filters(draw: st.DrawFn) -> PhyFilter:
    """Real poles, some repeated, and complex pairs; low-pass or general; known by poles or by coefficients."""
    poles: list[complex] = []
    for _ in range(draw(st.integers(1, 3))):
        size = 10.0 ** draw(st.floats(-2.0, 3.0))
        angle = draw(st.one_of(st.just(0.0), st.floats(0.05, 1.5)))
        pole = complex(-size * np.cos(angle), size * np.sin(angle))
        pair = [pole.real] if angle == 0.0 else [pole, pole.conjugate()]
        poles += pair * draw(st.integers(1, 2))
    lowpass = PhyFilter.from_poles(poles)
    b = None
    if draw(st.booleans()):
        shares = draw(st.lists(st.floats(-2.0, 2.0), min_size=lowpass.order, max_size=lowpass.order))
        b = lowpass.a * np.array(shares) + 0.0  # without the sign of a zero, which no coefficient has
    return PhyFilter.from_poles(poles, b) if draw(st.booleans()) else PhyFilter(lowpass.a, b)


@st.composite
def sampled_filters(draw: st.DrawFn) -> SampledPhyFilter:
    parts = draw(st.lists(filters(), min_size=1, max_size=3))
    options: dict = {
        "dt": 10.0 ** draw(st.floats(-4.0, -1.0)),
        "method": draw(st.sampled_from(["exact", "tustin"])),
        "g": draw(st.sampled_from(["hold", "average"])),
        "f_theta": draw(st.sampled_from(["hold", "average"])),
        "precision": draw(st.sampled_from(["float64", "float32"])),
        "nonfinite": draw(st.sampled_from(["raise", "hold"])),
        "delay": draw(st.one_of(st.just(0.0), st.floats(1e-4, 0.1))),
        "limit": draw(
            st.one_of(
                st.none(), st.floats(0.1, 9.0), st.just(np.inf), st.just([np.inf, 2.0, 3.0][: len(parts)])
            )
        ),
    }
    if draw(st.booleans()):
        options["E"] = np.eye(4)[:, : len(parts)] * draw(st.floats(0.5, 2.0))
    E = options.pop("E", None)
    return SampledPhyFilter(parts, Sampling(**options), E=E)


# -- round trips ------------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*F = 0 is saved")
@given(filter=filters())
def test_a_filter_comes_back_bit_for_bit(tmp_path_factory, filter: PhyFilter) -> None:
    path = tmp_path_factory.getbasetemp() / "filter.toml"
    save(path, filter)
    again = load(path)
    assert isinstance(again, PhyFilter)
    assert_same_filter(again, filter)
    assert read_noted(path)[1] == {}


@pytest.mark.filterwarnings("ignore:.*F = 0 is saved")
@settings(max_examples=60)
@given(sampled=sampled_filters())
def test_a_sampled_filter_comes_back_bit_for_bit(tmp_path_factory, sampled: SampledPhyFilter) -> None:
    path = tmp_path_factory.getbasetemp() / "sampled.toml"
    save(path, sampled)
    again = load(path)
    assert isinstance(again, SampledPhyFilter)
    assert again == sampled
    for one, other in zip(again.filters, sampled.filters, strict=True):
        assert_same_filter(one, other)


@pytest.mark.parametrize(
    "sampled",
    [
        PhyFilter([20.0]).sampled(0.002, "euler"),
        PhyFilter([400.0, 40.0]).sampled(0.01, delay=0.005),
        PhyFilter([400.0, 40.0], [400.0, 40.0]).sampled(
            0.01, limit=[1.0, 2.0, np.inf], g_limit=(-np.inf, [1.0, 2.0, 3.0])
        ),
        stack(
            [PhyFilter([20.0]).sampled(0.01, g="average"), PhyFilter([9.0, 6.0]).sampled(0.01, g="average")]
        ),
        PhyFilter([20.0]).sampled(0.002, E=[[1.0], [0.5]], delay=0.01, nonfinite="hold"),
    ],
)
def test_every_option_survives(tmp_path: Path, sampled: SampledPhyFilter) -> None:
    save(tmp_path / "f.toml", sampled)
    assert load(tmp_path / "f.toml") == sampled


def test_both_forms_run_alike_after_the_file(tmp_path: Path) -> None:
    x = np.random.default_rng(4).standard_normal((200, 3))
    sampled = PhyFilter.from_poles([-3 + 4j, -3 - 4j, -20], [500.0, 100.0, 7.0]).sampled(0.01, limit=3.0)
    save(tmp_path / "f.toml", sampled)
    again = load(tmp_path / "f.toml")
    assert isinstance(again, SampledPhyFilter)
    assert np.array_equal(again.run(x), sampled.run(x))


@pytest.mark.parametrize("poles", [[-1e-8, -3e-8, -1e-5, -1e8], [-1e-8 + 1e-8j, -1e-8 - 1e-8j, -4e-6, -5e6]])
def test_poles_far_apart_come_back(tmp_path: Path, poles: list[complex]) -> None:
    filter = PhyFilter(PhyFilter.from_poles(poles * 2).a)
    save(tmp_path / "f.toml", filter)
    again = load(tmp_path / "f.toml")
    assert isinstance(again, PhyFilter)
    assert_same_filter(again, filter)


def test_found_poles_that_reading_would_refuse_are_left_out(tmp_path: Path, monkeypatch) -> None:
    # As a root finder does with poles far apart, whatever the one installed does.
    found = np.array([-10.001, -40.0], dtype=complex)
    monkeypatch.setattr("phyfilter_ctl._sections.roots_of_monic", lambda a: found.copy())
    filter = PhyFilter([400.0, 50.0])
    with pytest.raises(ValueError, match="poles do not belong to a"):
        PhyFilter(filter.a, poles=filter.poles)
    save(tmp_path / "f.toml", filter)
    assert "poles" not in (tmp_path / "f.toml").read_text()
    again = load(tmp_path / "f.toml")
    assert isinstance(again, PhyFilter)
    assert_same_filter(again, filter)


texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
numbers = st.floats(-LARGEST, LARGEST)


@given(
    units=st.tuples(texts, texts, texts), inertia=st.one_of(st.none(), numbers, st.tuples(numbers, numbers))
)
def test_signals_come_back(tmp_path_factory, units: tuple[str, str, str], inertia) -> None:
    path = tmp_path_factory.getbasetemp() / "signals.toml"
    F = PhyFilter([20.0])
    known = {"channels": ['v "x"', "ω\\"], "units": dict(zip("xgf", units, strict=True)), "inertia": inertia}
    sampled = F.sampled(0.002, **known)
    save(path, sampled)
    assert load(path) == sampled
    save(path, F, **known)
    assert load(path) == F
    assert load(path, dt=0.002) == sampled
    with pytest.raises(ValueError, match="channels: a sampled filter has its own"):
        save(path, sampled, channels=["a", "b"])


def test_a_step_is_for_a_continuous_filter(tmp_path: Path) -> None:
    save(tmp_path / "f.toml", PhyFilter([20.0]).sampled(0.002))
    with pytest.raises(
        ValueError, match=r"f\.toml: dt is for a continuous filter, and .* every 0\.002 s already"
    ):
        load(tmp_path / "f.toml", dt=0.004)


def test_control_characters_are_escaped(tmp_path: Path) -> None:
    every = "".join(map(chr, range(0x20))) + '\x7f\x80\x9f"\\\U0001f600\u2028'
    save(tmp_path / "f.toml", PhyFilter([20.0]), units={"x": every})
    raw = (tmp_path / "f.toml").read_bytes()
    assert not set(raw.replace(b"\n", b"")) & {*range(0x20), 0x7F}
    assert tomllib.loads(raw.decode())["signals"]["units"]["x"] == every


def test_inertia_of_every_shape(tmp_path: Path) -> None:
    matrix = ((1.0, 0.1), (0.1, 2.0))
    path = tmp_path / "f.toml"
    for names, inertias in (
        (["x", "y"], (1.5, [1.0, 2.0], np.array(matrix), 2)),
        (None, (1.5, [2.0], [[2.0]])),
    ):
        for M in inertias:
            save(path, PhyFilter([20.0]), channels=names, inertia=M)
            np.testing.assert_array_equal(load(path, dt=0.01).sampling.inertia, M)


# -- what the file looks like -----------------------------------------------------------------------------------


def test_the_file_is_for_reading(tmp_path: Path) -> None:
    sampled = stack(
        [PhyFilter([20.0]).sampled(0.002), PhyFilter([400.0, 40.0], [400.0, 40.0]).sampled(0.002)]
    )
    sampling = sampled.sampling.told(channels=["x", "y"], units={"x": "m/s", "f": "N"}, inertia=1.2)
    save(tmp_path / "f.toml", replace(sampled, sampling=sampling))
    assert (
        (tmp_path / "f.toml").read_text()
        == """\
# PhyFilter, one for each of 2 channels
format = "phyfilter"
version = 1

# PhyFilter, F(s) = 20/(s + 20)
[[filters]]
a = [20.0]
poles = [[-20.0, 0.0]]

# PhyFilter, F(s) = (40*s + 400)/(s**2 + 40*s + 400)
[[filters]]
a = [400.0, 40.0]
b = [400.0, 40.0]
poles = [[-20.0, 0.0], [-20.0, 0.0]]

[sampled]
dt = 0.002
method = "matched"
g = "hold"
f_theta = "average"
precision = "float64"

[signals]
channels = ["x", "y"]
units = { x = "m/s", f = "N" }
inertia = 1.2
"""
    )


def test_saves_nothing_that_reading_refuses(tmp_path: Path) -> None:
    many = SampledPhyFilter([PhyFilter([20.0])] * 1025, 0.01)
    with pytest.raises(ValueError, match="at most 1024 poles together, got 1025 filters"):
        save(tmp_path / "f.toml", many)
    wide = PhyFilter([20.0]).sampled(0.01, limit=np.full(200_000, 1.0))
    with pytest.raises(ValueError, match="at most 500000 bytes"):
        save(tmp_path / "f.toml", wide)
    assert not list(tmp_path.iterdir())
    most = SampledPhyFilter([PhyFilter.from_poles(-np.geomspace(1.0, 3.0, 64))] * 16, 0.01)
    save(tmp_path / "f.toml", most)
    assert load(tmp_path / "f.toml") == most


def test_reads_what_a_person_writes(tmp_path: Path) -> None:
    path = tmp_path / "f.toml"
    path.write_bytes(
        b"\xef\xbb\xbf# mine\r\nversion = 1\r\nformat = 'phyfilter'\r\npoles = [[-20, 0], [-20.00000001, 0]]\r\n"
        b"a = [\r\n  400, # a_0\r\n  4e1,\r\n]\r\n[signals.units]\r\nx = 'm/s'\r\n[sampled]\r\ndt = 2e-3\r\n"
    )
    again = load(path)
    # Poles typed to ten digits count before coefficients.
    assert again == PhyFilter.from_poles([-20.0, -20.00000001]).sampled(0.002, units={"x": "m/s"})


# -- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a = [400.0, 40.0\nb = 1\n", r"no TOML file: .*line 2"),
        ("s,v\n0,1\n", "no TOML file: .*line 1"),
        ("a = " + "[" * 100_000, "no TOML file"),
        ("", "format: missing: no filter file"),
        ("a = [1.0]", "format: missing"),
        (GOOD.replace("phyfilter", "bode"), "format: expected 'phyfilter', got 'bode'"),
        (GOOD.replace('"phyfilter"', "1"), "format: expected text, got an integer: 1"),
        (GOOD.replace("version = 1\n", ""), "version: missing; expected version = 1"),
        (
            GOOD.replace("version = 1", "version = 7\nspline = 3"),
            "version: this file has version 7, this library reads version 1; update phyfilter-ctl",
        ),
        (
            GOOD.replace("version = 1", "version = 0"),
            "version: this file has version 0, .*there is no such version",
        ),
        (GOOD.replace("version = 1", 'version = "1"'), "version: expected an integer, got text: '1'"),
        (GOOD.replace("version = 1", "version = true"), "version: expected an integer, got true or false"),
        (GOOD.replace("version = 1", "version = 1.0"), "version: expected an integer, got a number: 1.0"),
        (GOOD.replace("a =", "c ="), "c: unknown key; expected one of format"),
        (GOOD + "pole = [[-20.0, 0.0]]", "pole: unknown key; did you mean 'poles'"),
        (GOOD.replace("a = [400.0, 40.0]", ""), "a: missing"),
        (GOOD.replace("[400.0, 40.0]", "[]"), "a: a: expected the coefficients"),
        (GOOD.replace("[400.0, 40.0]", "20.0"), "a: expected a list of numbers, got a number: 20.0"),
        (GOOD.replace("40.0]", "'40']"), r"a\[1\]: expected a number, got text: '40'"),
        (GOOD.replace("40.0]", "true]"), r"a\[1\]: expected a number, got true or false"),
        (GOOD.replace("40.0]", "1979-05-27]"), r"a\[1\]: expected a number, got a date or time"),
        (GOOD.replace("40.0]", "[1.0]]"), r"a\[1\]: expected a number, got a list"),
        (GOOD.replace("40.0]", "nan]"), r"a\[1\]: expected a finite number, got nan"),
        (GOOD.replace("40.0]", "inf]"), r"a\[1\]: expected a finite number, got inf"),
        (GOOD.replace("40.0]", "1e999]"), r"a\[1\]: expected a finite number, got inf"),
        (GOOD.replace("40.0]", "1" + "0" * 400 + "]"), r"a\[1\]: expected a finite number, got 10{59}\.\.\."),
        (
            GOOD.replace("40.0]", "0x" + "f" * 9999 + "]"),
            r"a\[1\]: expected a finite number, got an integer of",
        ),
        (GOOD.replace("40.0]", "-40.0]"), "a: D is not Hurwitz: pole"),
        (
            GOOD.replace("40.0]", "-40.0]") + "poles = [[-20.0, 0.0], [-20.0, 0.0]]",
            "a, poles: D is not Hurwitz: a_1 = -40",
        ),
        (GOOD + "b = [1.0]", "a, b: b has 1 coefficients but a has 2"),
        (GOOD + "b = [1.0, -inf]", r"b\[1\]: expected a finite number, got -inf"),
        (GOOD + "poles = [[-20.0, 0.0], [-21.0, 0.0]]", "a, poles: poles do not belong to a"),
        (GOOD + "poles = [[-20.0, 0.0]]", "a, poles: poles: expected 2"),
        (GOOD + "poles = [[-20.0, 1.0], [-20.0, 2.0]]", "a, poles: the pole .* has no conjugate"),
        (GOOD + "poles = [-20.0, -20.0]", r"poles\[0\]: expected a list of numbers, got a number"),
        (GOOD + "poles = [[-20.0, 0.0], [-20.0]]", r"poles\[1\]: expected 2 numbers, got 1"),
        (
            GOOD + "poles = [[-20.0, nan], [-20.0, 0.0]]",
            r"poles\[0\]\[1\]: expected a finite number, got nan",
        ),
        (GOOD.replace("40.0]", "1.0, " * 2000 + "]"), "a: a: expected at most 64 coefficients, got 2001"),
        (GOOD + "# " + "x" * 500_000, "expected a filter file of at most 500000 bytes"),
        (GOOD + "[" + "a." * 2000 + "b]", "expected keys of at most 16 parts"),
        (GOOD + 'c = { "\\"" . ' + "'.' . " * 2000 + "b = 1 }", "expected keys of at most 16 parts"),
        (GOOD + "c" * 100_000 + " = 1", "c{60}: unknown key"),
        (
            TWO + "[[filters]]\na = [20.0]\n" * 1024,
            "filters: expected filters of at most 1024 poles together",
        ),
        (GOOD + "sampled = 3", "sampled: expected a table, got an integer: 3"),
        (SAMPLED.replace("dt = 0.002", ""), "sampled.dt: missing"),
        (SAMPLED.replace("0.002", "-0.002"), r"\[sampled\] dt: expected a finite number > 0 s"),
        (SAMPLED.replace("0.002", "'2 ms'"), "sampled.dt: expected a number, got text: '2 ms'"),
        (SAMPLED + "mehtod = 'exact'", "sampled.mehtod: unknown key; did you mean 'method'"),
        (SAMPLED + "method = 'exct'", r"\[sampled\] method: expected one of exact, .*got 'exct'"),
        (SAMPLED + "method = 1", "sampled.method: expected text, got an integer: 1"),
        (SAMPLED.replace("0.002", "0.2") + "method = 'euler'", r"\[sampled\] forward Euler diverges"),
        (SAMPLED + "E = [[1.0, 0.0], [0.0]]", r"sampled.E\[1\]: expected 2 numbers, got 1"),
        (SAMPLED + "E = [[1.0, 1.0], [1.0, 1.0]]", r"\[sampled\] E has rank 1"),
        (SAMPLED + "E = 1.0", "sampled.E: expected a list of rows, got a number"),
        (SAMPLED + "delay = -1.0", r"\[sampled\] delay: "),
        (SAMPLED + "delay = inf", "sampled.delay: expected a finite number"),
        (SAMPLED + "limit = 0.0", r"\[sampled\] limit: expected a positive"),
        (SAMPLED + "limit = [1.0, nan]", r"sampled.limit\[1\]: expected a finite number, got nan"),
        (
            TWO.replace("version = 1", "version = 1\na = [20.0]"),
            "a: expected either a, b, poles or .*got both",
        ),
        (TWO.replace("a = [400.0, 40.0]", "b = [1.0]"), r"filters\[1\].a: missing"),
        (TWO.replace("a = [400.0, 40.0]", "a = [4, -4]"), r"filters\[1\].a: D is not Hurwitz"),
        (TWO.replace("a = [400.0, 40.0]", "a = [4]\ndt = 1"), r"filters\[1\].dt: unknown key"),
        (GOOD.replace("a = [400.0, 40.0]", "filters = []"), "filters: expected at least one table, got none"),
        (
            GOOD.replace("a = [400.0, 40.0]", "filters = [3]"),
            r"filters\[0\]: expected a table, got an integer",
        ),
        (GOOD + "[signals]\nchanels = ['x']", "signals.chanels: unknown key; did you mean 'channels'"),
        (GOOD + "[signals]\nchannels = 'x'", "signals.channels: expected a list of text, got text: 'x'"),
        (GOOD + "[signals]\nchannels = ['x', 1]", r"signals.channels\[1\]: expected text, got an integer"),
        (GOOD + "[signals]\nchannels = ['x', 'x']", r"\[signals\] channels: expected different names"),
        (GOOD + "[signals]\nunits = {y = 'm'}", "signals.units.y: unknown key"),
        (GOOD + "[signals]\nunits = {x = 1}", "signals.units.x: expected text, got an integer"),
        (GOOD + "[signals]\ninertia = nan", "signals.inertia: expected a finite number, got nan"),
        (GOOD + "[signals]\ninertia = []", r"\[signals\] inertia: expected a number or shape"),
        (
            GOOD + "[signals]\ninertia = [[1.0], [2.0]]",
            r"\[signals\] inertia: expected a number or shape.*got shape \(2, 1\)",
        ),
        (
            GOOD + "[signals]\nchannels = ['x']\ninertia = [1.0, 2.0]",
            r"\[signals\] inertia: expected a number or shape \(1,\).*got shape \(2,\)",
        ),
        (TWO + "[signals]\nchannels = ['x']", "signals: channels: expected 2 names .*got 1"),
        (TWO + "[signals]\ninertia = [1.0, 2.0, 3.0]", "signals: inertia: expected size 2 .*got 3"),
        (SAMPLED + "E = [[1.0], [1.0]]\n[signals]\nchannels = ['x']", "signals: channels: expected 2 names"),
    ],
)
def test_refuses(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"bad\.toml: {message}"):
        load(path)


def test_refuses_what_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "f.toml").write_bytes(GOOD.encode() + b"\xff")
    with pytest.raises(ValueError, match=r"f\.toml: no TOML file: .*utf-8"):
        load(tmp_path / "f.toml")
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("told", "error", "message"),
    [
        ({"channels": ["x", "x"]}, ValueError, "channels: expected different names"),
        ({"channels": 2}, ValueError, "channels: expected names, got 2"),
        ({"inertia": np.inf}, ValueError, "inertia: expected finite"),
        ({"inertia": "full"}, ValueError, "inertia: expected numbers; .* got 'full'"),
        (
            {"channels": ["x", "y"], "inertia": np.eye(3)},
            ValueError,
            r"inertia: expected a number or shape \(2,\)",
        ),
        ({"units": {"x": 1}}, TypeError, "units: expected text for x"),
    ],
)
def test_what_cannot_be_noted(
    tmp_path: Path, told: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        save(tmp_path / "f.toml", PhyFilter([20.0]), **told)
    assert not list(tmp_path.iterdir())


# -- whole or not at all ----------------------------------------------------------------------------------------


def test_save_refuses_before_it_writes(tmp_path: Path) -> None:
    path = tmp_path / "f.toml"
    path.write_text("old")
    two = stack([PhyFilter([20.0])] * 2)
    with pytest.raises(ValueError, match="channels: expected 2 names"):
        save(path, two, channels=["x"])
    with pytest.raises(TypeError, match="filter: expected a PhyFilter"):
        save(path, [20.0])  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(UnicodeEncodeError):
        save(path, two, units={"x": "\ud800"})
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["f.toml"]


@pytest.mark.parametrize("fault", ["replace", "fsync"])
@pytest.mark.parametrize("error", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_old_file_whole(tmp_path: Path, monkeypatch, fault: str, error) -> None:
    path = tmp_path / "f.toml"
    save(path, PhyFilter([20.0]))
    before = path.read_bytes()

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(os, fault, fail)
    with pytest.raises(type(error)):
        save(path, PhyFilter([400.0, 40.0]))
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["f.toml"]


def test_a_failed_open_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        save(tmp_path / "no folder" / "f.toml", PhyFilter([20.0]))
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        save(tmp_path / "folder", PhyFilter([20.0]))
    assert os.listdir(tmp_path) == ["folder"]


@pytest.mark.skipif(os.name == "nt", reason="permissions and links of POSIX")
def test_keeps_permissions_and_links(tmp_path: Path) -> None:
    path, link = tmp_path / "f.toml", tmp_path / "link.toml"
    save(path, PhyFilter([20.0]))
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~umask
    path.chmod(0o640)
    link.symlink_to(path)
    save(link, PhyFilter([30.0]))
    assert link.is_symlink()
    assert load(path) == PhyFilter([30.0])
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_the_largest_file_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "f.toml"
    save(path, PhyFilter([20.0]))
    text = path.read_bytes()
    path.write_bytes(text + b"#" * (500_000 - len(text)))
    assert load(path) == PhyFilter([20.0])
    path.write_bytes(text + b"#" * (500_001 - len(text)))
    with pytest.raises(ValueError, match="at most 500000 bytes, got more"):
        load(path)
