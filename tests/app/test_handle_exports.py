"""Designs handed over by message: TOML both ways, FMUs that the checker accepts, C that checks itself."""

from __future__ import annotations

import base64
import io
import subprocess
import tempfile
import zipfile

import numpy as np
import pytest
from designer_messages import answered, message_of, refused

from phyfilter_ctl import PhyFilter, filterfile
from phyfilter_ctl.app import Session
from phyfilter_ctl.app.checking import Fields
from phyfilter_ctl.app.designs import read_design
from phyfilter_ctl.codegen import CompilerError, find_compiler
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
    assert (reply["name"], reply["mime"]) == ("wing.toml", "application/toml")
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
        ("../../etc/passwd", "passwd.toml"),
        ("C:\\temp\\a b.toml", "a_b.toml"),
        ("..", "filter.toml"),
        ("", "filter.toml"),
        ("\x00\n", "filter.toml"),
        (".hidden", "hidden.toml"),
        ("x" * 200, "x" * 60 + ".toml"),
        ("Flügel", "Fl_gel.toml"),
    ],
)
def test_names_of_downloads_are_plain(name, expected):
    assert answered(Session(), "save", design=TYPE_2, name=name)["name"] == expected


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
    assert reply["name"] == "phyfilter.fmu"
    path = tmp_path / "wing.fmu"
    path.write_bytes(data_of(reply))
    report = check(path)
    assert report.ok, str(report)
    assert str(describe(path).fmi) == version


def test_c_checks_itself(tmp_path, compiler):
    reply = answered(Session(), "export", design=TYPE_2, kind="c", channels=2)
    assert reply["name"] == "phyfilter_c.zip"
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
    from phyfilter_ctl.app import exports

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


def test_python_text_is_pasteable():
    text = answered(Session(), "python", design=TYPE_2)["text"]
    assert text.splitlines()[0] == "import phyfilter_ctl as pf"
    assert "numerator=2" in text
    found: dict = {}
    exec(text, found)
    np.testing.assert_array_equal(found["sampled"].filter.a, read_design(Fields({"design": TYPE_2})).filter.a)


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
