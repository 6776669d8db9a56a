"""Hostile and damaged archives are refused before anything is written."""

import io
import re
import stat
import struct
import zipfile

import fmpy
import pytest
from foreign_fmus import description
from hypothesis import given
from hypothesis import strategies as st

from phyfilter_ctl.fmi import ArchiveLimits, check, describe
from phyfilter_ctl.fmi.archive import archive_entries, extracted, parse_xml, read_entry, unpack
from phyfilter_ctl.fmi.archive_write import write_archive

BOMB = """<?xml version="1.0"?>
<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>
<fmiModelDescription fmiVersion="2.0" modelName="&c;"/>"""
EXTERNAL = '<?xml version="1.0"?><!DOCTYPE x SYSTEM "file:///etc/passwd"><x/>'
LEAK = '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY p SYSTEM "file:///etc/hostname">]><x>&p;</x>'


def archive(path, *entries, compress=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compress) as file:
        for name, data in entries:
            file.writestr(name, data)
    return path


def link(name, target):
    entry = zipfile.ZipInfo(name)
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return entry, target


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../outside.txt", "leads out"),
        ("resources/../../outside.txt", "leads out"),
        ("/etc/outside.txt", "absolute"),
        ("C:/outside.txt", "drive letter"),
        ("resources\\outside.txt", "backslash"),
        ("resources//outside.txt", "empty part"),
        ("./outside.txt", "empty part"),
        ("resources/outside.txt ", "ends in a dot"),
        ("resources/a\nb", "control character"),
        ("resources/" + "a" * 256, "longer than 255 bytes"),
    ],
)
def test_names_that_lead_elsewhere(tmp_path, name, message):
    path = archive(tmp_path / "x.fmu", (zipfile.ZipInfo(name), "x"))
    folder = tmp_path / "in"
    folder.mkdir()
    with pytest.raises(ValueError, match=message):
        unpack(path, folder)
    assert not list(folder.iterdir()), "nothing is written when one entry is bad"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["in", "x.fmu"]


def test_nul_in_a_name(tmp_path):
    """zipfile cuts names there: what is checked must be what the archive says."""
    path = archive(tmp_path / "x.fmu", ("aXb", "x"))
    path.write_bytes(path.read_bytes().replace(b"aXb", b"a\0b"))
    with pytest.raises(ValueError, match="control character"):
        archive_entries(path)


def test_links_and_devices(tmp_path):
    with pytest.raises(ValueError, match="is a link"):
        archive_entries(archive(tmp_path / "x.fmu", link("resources/passwd", "/etc/passwd")))
    device = zipfile.ZipInfo("resources/null")
    device.external_attr = (stat.S_IFCHR | 0o666) << 16
    with pytest.raises(ValueError, match="neither a file nor a folder"):
        archive_entries(archive(tmp_path / "y.fmu", (device, "")))


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_names_that_meet(tmp_path):
    twice = archive(tmp_path / "a.fmu", ("modelDescription.xml", "1"), ("modelDescription.xml", "2"))
    case = archive(tmp_path / "b.fmu", ("modelDescription.xml", "1"), ("ModelDescription.XML", "2"))
    both = archive(tmp_path / "c.fmu", ("resources", "1"), ("resources/x", "2"))
    for path in (twice, case):
        with pytest.raises(ValueError, match="two entries of one name"):
            archive_entries(path)
    with pytest.raises(ValueError, match="a file and a folder"):
        archive_entries(both)


def test_limits(tmp_path):
    zeros = archive(tmp_path / "a.fmu", ("resources/zeros", bytes(4 << 20)))
    with pytest.raises(ValueError, match="times its size"):
        archive_entries(zeros)
    assert archive_entries(zeros, ArchiveLimits(ratio=1e6))
    with pytest.raises(ValueError, match="bytes unpacked, expected at most 1000000"):
        archive_entries(zeros, ArchiveLimits(ratio=1e6, size=1_000_000))
    many = archive(tmp_path / "b.fmu", *((f"resources/{k}", "") for k in range(30)))
    with pytest.raises(ValueError, match="30 entries, expected at most 20"):
        archive_entries(many, ArchiveLimits(entries=20))


def test_entry_that_lies_about_its_size(tmp_path):
    """1 MB behind an entry that says 10 bytes."""
    path = archive(tmp_path / "x.fmu", ("resources/data", bytes(range(256)) * 4096))
    raw = bytearray(path.read_bytes())
    size = struct.pack("<I", 256 * 4096)
    while (at := raw.find(size)) >= 0:
        raw[at : at + 4] = struct.pack("<I", 10)
    path.write_bytes(bytes(raw))
    with pytest.raises(ValueError, match="cannot be read"):
        read_entry(path, "resources/data")


def test_damage(tmp_path):
    good = archive(
        tmp_path / "good.fmu", ("modelDescription.xml", description()), compress=zipfile.ZIP_STORED
    )
    raw = bytearray(good.read_bytes())
    raw[100] ^= 0xFF
    (tmp_path / "flipped.fmu").write_bytes(bytes(raw))
    with pytest.raises(ValueError, match=r"modelDescription.xml' cannot be read.*CRC"):
        describe(tmp_path / "flipped.fmu")
    (tmp_path / "cut.fmu").write_bytes(good.read_bytes()[:-30])
    with pytest.raises(ValueError, match="no ZIP archive, or a damaged one"):
        describe(tmp_path / "cut.fmu")
    (tmp_path / "empty.fmu").write_bytes(b"")
    with pytest.raises(ValueError, match="no ZIP archive"):
        describe(tmp_path / "empty.fmu")
    with pytest.raises(FileNotFoundError, match="no such file"):
        describe(tmp_path / "none.fmu")
    with pytest.raises(ValueError, match="got a folder"):
        describe(tmp_path)


def test_encrypted_and_unusual_compression(tmp_path):
    path = archive(tmp_path / "x.fmu", ("a", "x"), compress=zipfile.ZIP_BZIP2)
    with pytest.raises(ValueError, match="compressed by method 12"):
        archive_entries(path)
    raw = bytearray(archive(tmp_path / "y.fmu", ("a", "x")).read_bytes())
    raw[raw.find(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "y.fmu").write_bytes(bytes(raw))
    with pytest.raises(ValueError, match="is encrypted"):
        archive_entries(tmp_path / "y.fmu")


@pytest.mark.parametrize("text", [BOMB, EXTERNAL, LEAK], ids=["bomb", "external", "leak"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_document_types_are_refused(tmp_path, text, encoding):
    data = text.encode(encoding)
    with pytest.raises(ValueError, match="declares a document type"):
        parse_xml(data, "x")
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", data))
    with pytest.raises(ValueError, match="declares a document type"):
        describe(path)


@pytest.mark.parametrize("inside", ["sources/buildDescription.xml", "terminalsAndIcons/t.xml", "a/b.ssv"])
def test_document_types_in_other_documents(tmp_path, inside):
    """Other readers parse these later, with less care."""
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", description()), (inside, BOMB))
    with pytest.raises(ValueError, match=f"{inside}: declares a document type"), extracted(path):
        pass


def test_malformed_and_large_documents():
    with pytest.raises(ValueError, match="not a well-formed XML document"):
        parse_xml(b"<a><b></a>", "x")
    for encoding in (b"utf-0", b"utf-7", b"shift_jis", b"idna", b"hex"):
        with pytest.raises(ValueError, match="x: not a well-formed XML document"):
            parse_xml(b'<?xml version="1.0" encoding="' + encoding + b'"?><a/>', "x")
    with pytest.raises(ValueError, match="expected at most 10"):
        parse_xml(b"<a>" + b" " * 20 + b"</a>", "x", ArchiveLimits(xml=10))


def test_folder_is_private_and_goes_away(tmp_path):
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", description()), ("resources/a/b.txt", "b"))
    with extracted(path) as folder:
        assert (folder / "resources/a/b.txt").read_text() == "b"
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert not folder.exists()
    folder = None
    with pytest.raises(RuntimeError, match="mine"), extracted(path) as folder:
        raise RuntimeError("mine")
    assert folder is not None
    assert not folder.exists()


def refusal(path):
    """Why a file is refused; None if it is read."""
    try:
        describe(path)
    except ValueError as error:
        return str(error)
    return None


@given(st.binary(max_size=300))
def test_any_bytes_are_an_archive_or_a_clear_error(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("any") / "x.fmu"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"x\.fmu"):
        describe(path)


@given(st.data())
def test_one_wrong_byte(tmp_path_factory, data):
    """A flipped byte in a description is read, or refused by ValueError: no other exception."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("modelDescription.xml", description("3.0"))
    raw = bytearray(buffer.getvalue())
    raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("flip") / "x.fmu"
    path.write_bytes(bytes(raw))
    message = refusal(path)
    assert message is None or str(path) in message


@given(st.data())
def test_one_wrong_byte_in_the_xml(tmp_path_factory, data):
    """As above, past the checksum: what fmpy stumbles over becomes a ValueError too."""
    text = bytearray(description(data.draw(st.sampled_from(["2.0", "3.0"]))).encode())
    at = data.draw(st.integers(0, len(text) - 1))
    text[at] = data.draw(st.sampled_from(b'<>"=/ 0129aZ&'))
    path = archive(tmp_path_factory.mktemp("xml") / "x.fmu", ("modelDescription.xml", bytes(text)))
    message = refusal(path)
    assert message is None or str(path) in message


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('modelIdentifier="o', 'modelIdentifier="&gt;', "expected a name without a path"),
        ('modelIdentifier="o', 'fixedInternalStepSize="-1" modelIdentifier="o', "fixedInternalStepSize"),
    ],
)
def test_what_the_schema_allows_and_the_reader_does_not_names_the_file(tmp_path, before, after, words):
    text = description("3.0").replace(before, after)
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", text.encode()))
    with pytest.raises(ValueError, match=re.escape(str(path)) + ".*" + words):
        describe(path)


def test_description_of_both_versions(tmp_path):
    binary = f"binaries/{fmpy.platform_tuple}/oscillator3.so"
    three = archive(tmp_path / "3.fmu", ("modelDescription.xml", description("3.0")), (binary, "x"))
    found = describe(three)
    assert (found.fmi, found.name, set(found.kinds), found.platforms) == (
        "3.0",
        "Oscillators",
        {"me", "cs"},
        (fmpy.platform_tuple,),
    )
    (place,) = found.of("input")
    assert (place.labels, place.starts, place.unit) == (("place[0]", "place[1]"), (0.0, 0.0), "m")
    assert found.state_labels == ("x[0]", "x[1]", "v[0]", "v[1]")
    assert found.dependencies["force"] == ("place", "x")
    assert found.units["N"].exponents == {"kg": 1, "m": 1, "s": -2}
    two = archive(
        tmp_path / "2.fmu",
        ("modelDescription.xml", description()),
        ("sources/a.c", ""),
        ("binaries/linux64/oscillator2.so", "x"),
        ("binaries/win64/oscillator2.dll", "x"),
    )
    found = describe(two)
    assert found.platforms == ("x86_64-linux", "x86_64-windows")
    assert found.sources
    assert (found.step, found.stop_time, found.tolerance) == (0.01, 2.0, 1e-6)
    assert "place [m] = 0   Where the coupling spring ends" in str(found)
    assert '"name": "Oscillator"' in found.as_json()


@pytest.mark.parametrize("version", ["1.0", "4.0", "", "3.1"])
def test_other_versions(tmp_path, version):
    text = description().replace('fmiVersion="2.0"', f'fmiVersion="{version}"')
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", text))
    with pytest.raises(ValueError, match=r"FMI version .*; expected 2.0 or 3.0"):
        describe(path)


def test_what_other_tools_write(tmp_path):
    """The folder itself as an entry; a constant parameter, which FMI forbids and FMPy cannot read."""
    text = description()
    assert text.count('causality="parameter" variability="fixed"') == 1
    constant = text.replace(
        'causality="parameter" variability="fixed"', 'causality="parameter" variability="constant"'
    )
    path = archive(tmp_path / "x.fmu", ("./", ""), ("modelDescription.xml", constant))
    found = describe(path)
    assert found.entries == 1
    (mass,) = [entry for entry in found.variables if entry.name == "m"]
    assert (mass.variability, mass.initial, mass.start) == ("constant", "exact", (2.0,))
    with extracted(path) as folder:
        assert [entry.name for entry in folder.iterdir()] == ["modelDescription.xml"]
    (error,) = check(path, run=False).errors
    assert 'illegal combination of causality="parameter"' in error.message
    assert error.rule == "FMI 2.0, 2.2.7"


def test_other_names_of_a_variable(tmp_path):
    text = description("3.0").replace(
        'unit="m">\n      <Dimension start="2"/>',
        'unit="m"><Dimension start="2"/><Alias name="where" displayUnit="mm"/>',
    )
    path = archive(tmp_path / "x.fmu", ("modelDescription.xml", text))
    x, where = (entry for entry in describe(path).variables if entry.name in ("x", "where"))
    assert (where.reference, where.start, where.unit, where.display_unit) == (
        x.reference,
        (1.0, 2.0),
        "m",
        "mm",
    )
    assert check(path, run=False).ok


def test_not_an_fmu(tmp_path):
    with pytest.raises(ValueError, match=r"no modelDescription\.xml inside: not an FMU"):
        describe(archive(tmp_path / "x.fmu", ("readme.txt", "")))
    with pytest.raises(ValueError, match="starts with <html>"):
        describe(archive(tmp_path / "y.fmu", ("modelDescription.xml", "<html/>")))
    text = description().replace('causality="input"', 'causality="inputs"')
    with pytest.raises(ValueError, match=r"is not valid:\n.*inputs"):
        describe(archive(tmp_path / "z.fmu", ("modelDescription.xml", text)))


# -- archives that we write ---------------------------------------------------------------------------------------


def test_what_is_written(tmp_path):
    entries = {"resources/b.txt": "ü", "binaries/linux64/a.so": b"\x00\x01", "modelDescription.xml": "<x/>"}
    path = write_archive(tmp_path / "a.fmu", entries)
    with zipfile.ZipFile(path) as written:
        infos = written.infolist()
        assert [info.filename for info in infos] == sorted(entries)
        assert {info.filename: written.read(info) for info in infos} == {
            name: data.encode() if isinstance(data, str) else data for name, data in entries.items()
        }
    assert {info.date_time for info in infos} == {(1980, 1, 1, 0, 0, 0)}, (
        "the same bytes whenever it is written"
    )
    assert {info.create_system for info in infos} == {3}, "Unix, on every system"
    rights = {info.filename: stat.filemode(info.external_attr >> 16) for info in infos}
    assert rights == {
        "binaries/linux64/a.so": "-rwxr-xr-x",
        "modelDescription.xml": "-rw-r--r--",
        "resources/b.txt": "-rw-r--r--",
    }
    assert {info.compress_type for info in infos} == {zipfile.ZIP_DEFLATED}
    assert [entry.filename for entry in archive_entries(path)] == sorted(entries), "and we take what we write"


def test_where_no_archive_can_be_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such folder to write a\.fmu to; make it first"):
        write_archive(tmp_path / "none" / "a.fmu", {})
    with pytest.raises(IsADirectoryError, match="is a folder; expected the name of a file"):
        write_archive(tmp_path, {})
    assert not list(tmp_path.iterdir())


def test_as_many_entries_as_the_limit_are_taken(tmp_path):
    path = archive(tmp_path / "x.zip", ("a", "1"), ("b", "2"))
    assert len(archive_entries(path, ArchiveLimits(entries=2))) == 2
    with pytest.raises(ValueError, match="2 entries, expected at most 1"):
        archive_entries(path, ArchiveLimits(entries=1))


def test_a_document_that_is_nested_without_end(tmp_path):
    deep = b"<a>" * 10_000 + b"</a>" * 10_000
    with pytest.raises(ValueError, match=r"x\.xml"):
        parse_xml(deep, "x.xml")


def test_an_entry_that_is_not_there(tmp_path):
    path = archive(tmp_path / "x.zip", ("resources/a b.txt", "1"))  # a blank is no control character
    assert read_entry(path, "resources/a b.txt") == b"1"
    with pytest.raises(ValueError, match="expected an entry 'b'; there is none"):
        read_entry(path, "b")


def test_an_empty_folder_is_unpacked(tmp_path):
    path = archive(tmp_path / "x.zip", ("resources/empty/", ""))
    with extracted(path) as folder:
        assert (folder / "resources" / "empty").is_dir()
