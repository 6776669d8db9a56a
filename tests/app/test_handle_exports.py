"""Designs handed over by message: TOML both ways, FMUs that the checker accepts, C that checks itself."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl import PhyFilter, export_target, filterfile, lowpass
from phyfilter_ctl.app import exports
from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.app.handling import Session
from phyfilter_ctl.codegen import CompilerError, export_c, find_compiler
from phyfilter_ctl.fmi import check, describe

TYPE_2 = message_of([-20.0, -15 + 8j, -15 - 8j], numerator={"kind": "type", "type": 2})
SECRETS = message_of([-20.0, -30.0], numerator={"kind": "b", "b": [600.0, 12.0]}, dt=0.01, method="tustin")


def data_of(reply: dict) -> bytes:
    return base64.b64decode(reply["base64"], validate=True)


@pytest.fixture
def compiler() -> list[str]:
    try:
        return list(find_compiler().command)
    except CompilerError as error:
        pytest.skip(str(error))


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path, monkeypatch):
    """Temporary folders are private and gone afterwards."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    yield
    assert not list(tmp_path.glob("phyfilter_*"))


@pytest.mark.parametrize("message", [TYPE_2, SECRETS], ids=["type 2", "b"])
def test_saved_and_opened(message, tmp_path):
    session = Session()
    reply = answered(session, "save", design=message, name="wing.toml")
    assert (reply["name"], reply["mime"]) == (f"wing-{reply['digest']}.toml", "application/toml")
    path = tmp_path / reply["name"]
    path.write_bytes(data_of(reply))
    design = read_design(Fields({"design": message}))
    assert filterfile.load(path).filter == design.filter  # type: ignore[union-attr]  # sampled, so it has one
    back = answered(session, "open", name="wing.toml", text=path.read_text())
    assert back["messages"] == []
    again = read_design(Fields({"design": back["design"]}))
    assert again.filter == design.filter
    assert (again.dt, again.method) == (design.dt, design.method)
    assert again.numerator.kind == message["numerator"]["kind"]


def test_a_sampling_that_diverges_is_left_out_of_the_file():
    reply = answered(Session(), "save", design=message_of([-2000.0], method="euler"), name="a")
    assert "[sampled]" not in data_of(reply).decode()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("../../etc/passwd", "passwd"),
        ("C:\\temp\\a b.toml", "a_b"),
        ("..", "filter_3"),
        ("", "filter_3"),
        ("\x00\n", "filter_3"),
        (".hidden", "hidden"),
        ("x" * 200, "x" * 60),
        ("Flügel", "Fl_gel"),
    ],
)
def test_names_of_downloads_are_plain(name, expected):
    reply = answered(Session(), "save", design=TYPE_2, name=name)
    assert reply["name"] == f"{expected}-{reply['digest']}.toml"
    assert re.fullmatch(r"[0-9a-f]{8}", reply["digest"])


def test_no_two_designs_have_files_of_one_name():
    session = Session()
    designs = [
        message_of([-20.0, -30.0]),
        message_of([-20.0, -30.000000000000004]),
        message_of([-20.0, -30.0], numerator={"kind": "type", "type": 2}),
        message_of([-20.0, -30.0], dt=0.004),
        message_of([-20.0, -30.0], method="tustin"),
    ]
    saved = {answered(session, "save", design=design, name="wing")["name"] for design in designs}
    assert len(saved) == len(designs)
    assert len({answered(session, "save", design=designs[0], name="wing")["name"] for _ in range(2)}) == 1
    # What is in the file besides the filter counts too; what only the figures depend on does not.
    sources = {
        answered(session, "export", design=designs[0], kind="c", channels=channels, name=name)["name"]
        for channels, name in ((1, "wing"), (2, "wing"), (1, "tail"))
    }
    assert len(sources) == 3
    other = message_of([-20.0, -30.0], slope=5.0)
    assert answered(session, "save", design=other, name="wing")["name"] in saved


def test_a_design_that_is_a_familys_is_named_after_it():
    butterworth = message_of(lowpass(2, 20.0, family="butterworth").poles.tolist())
    reply = answered(Session(), "exports", design=butterworth)
    assert reply["name"] == "butterworth_2_20"
    assert answered(Session(), "save", design=butterworth)["name"].startswith("butterworth_2_20-")


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind == "px4" else pytest.mark.slow)
        for kind in exports.KINDS
        if not kind.startswith("fmu")
    ],
)
def test_packages_leave_as_what_the_target_builds(kind):
    """The archive holds, to the byte, what the library writes for the design, under the user's name as C takes it."""
    design = message_of([-20.0, -30.0])
    reply = answered(Session(), "export", design=design, kind=kind, channels=3, name="My Wing 2")
    assert re.fullmatch(rf"My_Wing_2-[0-9a-f]{{8}}-{kind}\.zip", reply["name"])
    sampled = read_design(Fields({"design": design})).sampled
    with tempfile.TemporaryDirectory() as parent, zipfile.ZipFile(io.BytesIO(data_of(reply))) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
        folder = Path(parent, "my_wing")
        if kind == "c":
            export_c(sampled, folder, channels=3, name="my_wing")
        else:
            export_target(sampled, kind, folder, channels=3, name="my_wing")
        files = {path for path in folder.rglob("*") if path.is_file()}
        assert held == {path.relative_to(parent).as_posix(): path.read_bytes() for path in files}


def test_what_a_target_refuses_is_said_in_words():
    def reasons(design: dict[str, object], channels: int) -> dict[str, str]:
        reply = answered(Session(), "exports", design=design, channels=channels)
        assert all(each["able"] == (not each["why"]) for each in reply["exports"])
        assert [each["kind"] for each in reply["exports"]] == list(exports.KINDS)
        return {each["kind"]: each["why"] for each in reply["exports"]}

    vehicles = ("ardupilot", "crazyflie", "px4", "ros2")
    assert not any(why for kind, why in reasons(message_of([-20.0]), 3).items() if not kind.startswith("fmu"))
    one = reasons(message_of([-20.0]), 1)
    assert {kind for kind in one if "3 channels" in one[kind]} == set(vehicles)
    general = reasons(TYPE_2, 3)
    assert {kind for kind in general if "low-pass numerator" in general[kind]} == set(vehicles)
    rate = reasons(message_of([-20.0], dt=0.003), 3)
    assert [kind for kind in rate if "1000 Hz" in rate[kind]] == ["crazyflie"]
    diverging = reasons(message_of([-2000.0], method="euler"), 3)
    assert all("diverges" in why for kind, why in diverging.items() if not kind.startswith("fmu"))
    # What is refused beforehand is refused when it is asked for all the same.
    reply = refused(Session(), "export", design=TYPE_2, kind="px4", channels=3)
    assert "low-pass numerator" in reply["error"]


def test_opening_keeps_the_assumptions_and_says_what_it_drops(tmp_path):
    session = Session()
    answered(session, "design", design=message_of([-3.0], slope=4.0, dt=0.005))
    path = tmp_path / "a.toml"
    filterfile.save(path, PhyFilter([20.0]).sampled(0.01, g="average", limit=3.0))
    reply = answered(session, "open", name="a.toml", text=path.read_text())
    assert reply["design"]["assume"]["slope"] == 4.0
    assert reply["design"]["sampling"]["dt"] == 0.01
    assert "g, limit" in reply["messages"][0]
    filterfile.save(path, PhyFilter([20.0]))
    reply = answered(session, "open", name="a.toml", text=path.read_text())
    assert reply["design"]["sampling"]["dt"] == 0.005
    # Opened, not chosen yet: the front end asks about it next.
    assert session.filter.a.tolist() == [3.0]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no filter file"),
        ("a = [", "no TOML"),
        ("[" * 3000, "no TOML"),
        ('format = "phyfilter"\nversion = 1\na = [-20]\n', "Hurwitz"),
        ('format = "phyfilter"\nversion = 1\na = [1e-9]\n', "poles: expected 1 to 8"),
        (f'format = "phyfilter"\nversion = 1\na = [{"9" * 400}]\n', ""),
        ('format = "phyfilter"\nversion = 1\na = [20]\nb = [20]\nc = 1\n', "unknown key"),
        ("x" * 300_000, "at most"),
    ],
)
def test_files_that_are_no_designs_are_refused(text, said, tmp_path):
    reply = refused(Session(), "open", name="../a.toml", text=text)
    assert said in reply["error"]
    assert str(tmp_path) not in reply["error"]
    assert "/" not in reply["error"].replace("rad/s", "")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "version"), [("fmu2", "2.0"), ("fmu3", "3.0")])
def test_fmu_is_accepted_by_the_checker(kind, version, tmp_path, compiler):
    reply = answered(Session(), "export", design=TYPE_2, kind=kind, channels=3)
    assert re.fullmatch(rf"filter_3-[0-9a-f]{{8}}-fmi{version[0]}\.fmu", reply["name"])
    path = tmp_path / "wing.fmu"
    path.write_bytes(data_of(reply))
    report = check(path)
    assert report.ok, str(report)
    assert str(describe(path).fmi) == version


def test_c_checks_itself(tmp_path, compiler):
    reply = answered(Session(), "export", design=TYPE_2, kind="c", channels=2)
    assert re.fullmatch(r"filter_3-[0-9a-f]{8}-c\.zip", reply["name"])
    with zipfile.ZipFile(io.BytesIO(data_of(reply))) as archive:
        names = archive.namelist()
        assert all(name.startswith("phyfilter/") and ".." not in name for name in names)
        archive.extractall(tmp_path)
    sources = sorted(str(path) for path in (tmp_path / "phyfilter").glob("*.c"))
    program = str(tmp_path / "check")
    subprocess.run([*compiler, "-std=c99", "-O1", "-ffp-contract=off", *sources, "-o", program], check=True)
    assert "allowed" in subprocess.run([program], check=True, capture_output=True, text=True).stdout


def test_archives_of_one_design_are_the_same():
    first, second = (answered(Session(), "export", design=TYPE_2, kind="c")["base64"] for _ in range(2))
    assert first == second


def test_without_a_compiler_there_is_no_fmu_and_it_is_said(monkeypatch):
    def none(command: object = None) -> None:
        raise CompilerError(f"no C compiler: tried {tempfile.gettempdir()}/cc; install gcc")

    monkeypatch.setattr(exports, "find_compiler", none)
    can = answered(Session(), "hello")["can"]
    assert can["fmu"] is False
    assert can["c"] is True
    assert "install gcc" in can["why"]
    reply = refused(Session(), "export", design=TYPE_2, kind="fmu3")
    assert "install gcc" in reply["error"]
    assert tempfile.gettempdir() not in reply["error"]


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"kind": "exe", "channels": 1}, "kind"),
        ({"kind": "c", "channels": 0}, "channels"),
        ({"kind": "c", "channels": 13}, "channels"),
        ({"kind": "c", "channels": 1.0}, "channels"),
        ({"kind": "../c", "channels": 1}, "kind"),
    ],
)
def test_refusals(fields, where):
    assert refused(Session(), "export", design=TYPE_2, **fields)["where"] == where


def test_a_sampled_filter_that_diverges_is_not_exported():
    reply = refused(Session(), "export", design=message_of([-2000.0], method="euler"), kind="c")
    assert "diverges" in reply["error"]


def executed(design: dict[str, object]) -> tuple[str, PhyFilter]:
    text = answered(Session(), "python", design=design)["text"]
    assert text.splitlines()[0] == "import phyfilter_ctl as pf"
    found: dict = {}
    exec(text, found)
    return text, found["sampled"].filter


def test_python_text_is_pasteable():
    text, filter = executed(TYPE_2)
    assert "type=2" in text
    assert filter == read_design(Fields({"design": TYPE_2})).filter


@pytest.mark.parametrize(
    ("fields", "line"),
    [
        ({"family": "butterworth", "order": 2}, "lowpass(2, 20.0, family='butterworth')"),
        ({"family": "bessel", "order": 5, "type": 3}, "lowpass(5, 20.0, family='bessel', type=3)"),
        ({"family": "itae", "order": 4}, "lowpass(4, 20.0, family='itae')"),
        ({"family": "binomial", "order": 3, "type": 3}, "lowpass(3, 20.0, family='binomial', type=3)"),
        (
            {"family": "bandpass", "order": 4, "band": [4.5, 9.0]},
            "bandpass(4, 4.5, 9.0, family='butterworth')",
        ),
    ],
)
def test_python_text_keeps_the_family(fields, line):
    """Asked for by name, back as that name; and still so after the browser has scaled the poles and rounded them."""
    design = answered(Session(), "family", cutoff=20.0, **fields)["design"]
    text, filter = executed(design)
    assert f"filter = pf.{line}\n" in text
    asked = read_design(Fields({"design": design})).filter
    np.testing.assert_allclose(filter.a, asked.a, rtol=1e-12)  # the cutoff is found again to its last digit
    np.testing.assert_allclose(filter.b, asked.b, rtol=1e-12)
    moved = [[re * (1.0 + 1e-13), im] for re, im in design["poles"]]
    assert f"filter = pf.{line}\n" in executed(design | {"poles": moved})[0]


def test_python_text_of_a_family_whose_pole_was_moved_is_its_poles():
    design = answered(Session(), "family", family="butterworth", order=2, cutoff=20.0)["design"]
    moved = design | {"poles": [[re * 1.001, im] for re, im in design["poles"]]}
    text, filter = executed(moved)
    assert "from_poles" in text
    assert filter == read_design(Fields({"design": moved})).filter
    # Two poles in one place are a binomial filter, of a cutoff that nobody would type.
    assert "from_poles([-20.0, -20.0])" in executed(message_of([-20.0, -20.0]))[0]


def test_python_text_of_a_high_order_has_a_line_for_each_pole():
    design = message_of([complex(-3.0 * k, sign * k) for k in range(1, 5) for sign in (1, -1)])
    text = answered(Session(), "python", design=design)["text"]
    assert max(map(len, text.splitlines())) < 80
    found: dict = {}
    exec(text, found)
    np.testing.assert_array_equal(found["filter"].a, read_design(Fields({"design": design})).filter.a)


def test_python_text_of_a_sampling_that_diverges_says_so():
    text = answered(Session(), "python", design=message_of([-2000.0], method="euler"))["text"]
    assert "# forward Euler diverges" in text
    exec(text, {})
