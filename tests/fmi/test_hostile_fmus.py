"""Hostile FMUs and packages at every entry point: nothing outside is loaded, and what is wrong is said in words."""

import os
import shutil
import struct
import subprocess
import threading
import warnings
import zipfile

import fmpy
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import (
    ArchiveLimits,
    Fmu,
    FmuError,
    System,
    check,
    cosimulate,
    describe,
    import_fmu,
    write_ssp,
)
from phyfilter_ctl.fmi.archive import archive_entries, extracted
from phyfilter_ctl.fmi.binding import BindingError, bind
from phyfilter_ctl.fmi.foreign_wire import decoded, receive
from phyfilter_ctl.fmi.messages import MessageLog

T = np.linspace(0.0, 1.0, 11)


def changed(source, target, *replacements):
    """A copy of an FMU in whose description words are replaced."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for entry in old.infolist():
            data = old.read(entry)
            if entry.filename == "modelDescription.xml":
                text = data.decode()
                for before, after in replacements:
                    assert before in text
                    text = text.replace(before, after)
                data = text.encode()
            new.writestr(entry.filename, data)
    return target


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    """A library whose constructor writes a file: its path without the suffix, and that of the file."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed: the library outside cannot be built")
    folder = tmp_path_factory.mktemp("outside")
    mark, source = folder / "loaded.txt", folder / "outside.c"
    source.write_text(
        "#include <stdio.h>\n"
        "__attribute__((constructor)) static void loaded(void) {\n"
        f'    FILE *file = fopen("{mark.as_posix()}", "a");\n'
        '    if (file) { fputs("loaded\\n", file); fclose(file); }\n'
        "}\n"
    )
    library = folder / f"outside{fmpy.sharedLibraryExtension}"
    subprocess.run(["gcc", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    return folder / "outside", mark


def package(fmu, target):
    """An SSP around one FMU as it is: `write_ssp` would refuse it."""
    ssd = (
        '<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
        'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" version="1.0" name="s">'
        '<ssd:System name="s"><ssd:Elements><ssd:Component name="a" type="application/x-fmu-sharedlibrary" '
        'source="resources/a.fmu"/></ssd:Elements></ssd:System></ssd:SystemStructureDescription>'
    )
    with zipfile.ZipFile(target, "w") as archive:
        archive.writestr("SystemStructure.ssd", ssd)
        archive.write(fmu, "resources/a.fmu")
    return target


ENTRIES = {
    "describe": lambda fmu, _: describe(fmu),
    "check": lambda fmu, _: check(Fmu(fmu, isolated=False)),
    "check, isolated": lambda fmu, _: check(fmu),
    "import": lambda fmu, _: import_fmu(fmu, kind="cs"),
    "import, isolated": lambda fmu, _: import_fmu(Fmu(fmu, isolated=True), kind="cs"),
    "cosimulate": lambda fmu, _: cosimulate({"a": fmu}, timepts=T),
    "package": lambda fmu, folder: cosimulate(package(fmu, folder / "a.ssp"), timepts=T),
    "command check": lambda fmu, _: main(["fmu", "check", str(fmu)]),
    "command run": lambda fmu, _: main(["fmu", "run", str(fmu)]),
}


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("form", ["relative", "absolute"])
@pytest.mark.parametrize("entry", ENTRIES)
def test_an_identifier_that_is_a_path_loads_nothing(build, outside, tmp_path, capsys, entry, form, fmi):
    library, mark = outside
    mark.unlink(missing_ok=True)
    identifier = str(library) if form == "absolute" else "../" * 12 + str(library).lstrip("/")
    fmu = changed(build(fmi), tmp_path / "a.fmu", (f'"oscillator{fmi[0]}"', f'"{identifier}"'))
    try:
        said = str(ENTRIES[entry](fmu, tmp_path))
    except (ValueError, FmuError) as error:
        said = str(error)
    assert not mark.exists()
    assert "modelIdentifier" in said + "".join(capsys.readouterr())


def test_the_binding_itself_loads_only_what_was_unpacked(build, outside, tmp_path):
    """Also through a link that somebody put among what was unpacked."""
    library, mark = outside
    mark.unlink(missing_ok=True)
    suffix = fmpy.sharedLibraryExtension
    place = tmp_path / "binaries" / fmpy.platform_tuple
    place.mkdir(parents=True)
    os.symlink(f"{library}{suffix}", place / f"linked{suffix}")
    for identifier in ("linked", str(library)):
        with pytest.raises(BindingError, match="expected a library inside"):
            bind(
                MessageLog(),
                fmi="3.0",
                kind="cs",
                folder=str(tmp_path),
                identifier=identifier,
                token="",
                name="a",
            )
    assert not mark.exists()


@pytest.mark.skipif(os.name == "nt", reason="ends of processes are named by signals")
def test_check_isolates_unless_asked_not_to(build):
    """A binary that ends its process is a finding; in this process it would be the end of the tests."""
    report = check(build(defines=("MISCHIEF_AT=0.35", "MISCHIEF=SEGFAULT")))
    assert "SIGSEGV" in str(report)


EXPERIMENT = 'stopTime="2.0" tolerance="1e-6" stepSize="0.01"'
FIXED = "canHandleVariableCommunicationStepSize"


@pytest.mark.parametrize(
    ("fmi", "before", "after", "words"),
    [
        ("3.0", FIXED, f'fixedInternalStepSize="1e-320" {FIXED}', "fixedInternalStepSize"),
        ("3.0", FIXED, f'fixedInternalStepSize="-1" {FIXED}', "fixedInternalStepSize"),
        ("2.0", EXPERIMENT, 'stopTime="1e300" stepSize="1e-300"', "more than 2\\^53 steps"),
        ("2.0", EXPERIMENT, 'stopTime="INF" stepSize="0.01"', "stopTime"),
        ("2.0", EXPERIMENT, 'stopTime="2.0" stepSize="0"', "stepSize"),
        (
            "3.0",
            "<ModelVariables>",
            '<ModelVariables><Clock name="tick" valueReference="99" causality="input" '
            'intervalVariability="constant" resolution="0" intervalCounter="1"/>',
            "resolution",
        ),
        ("2.0", 'numberOfEventIndicators="0"', 'numberOfEventIndicators="2000000000"', "event indicators"),
    ],
)
def test_numbers_that_cannot_be_are_findings(build, tmp_path, fmi, before, after, words):
    fmu = changed(build(fmi), tmp_path / "a.fmu", (before, after))
    report = check(fmu)
    assert not report.ok
    with pytest.raises(ValueError, match=words):
        describe(fmu)
    with pytest.raises(ValueError, match=words):
        import_fmu(fmu, kind="me")


def test_a_run_longer_than_memory_is_refused(build, tmp_path, capsys):
    fmu = changed(build(), tmp_path / "a.fmu", (EXPERIMENT, 'stopTime="1e9" stepSize="1e-6"'))
    assert main(["fmu", "run", str(fmu)]) == 2
    said = capsys.readouterr().err
    assert f"1000000000000000 steps of {fmu}, expected at most 20000000" in said
    assert "--max-steps" in said


def test_as_many_steps_as_are_allowed_are_run(build, capsys):
    """Its default experiment has 200."""
    assert main(["fmu", "run", str(build()), "--max-steps", "199"]) == 2
    assert "200 steps" in capsys.readouterr().err
    assert main(["fmu", "run", str(build()), "--max-steps", "200"]) == 0
    assert "201 points" in capsys.readouterr().out


def test_packages_inside_packages_share_one_limit(tmp_path):
    inner = tmp_path / "inner.ssp"
    with zipfile.ZipFile(inner, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("data.bin", bytes(900_000))
    limits = ArchiveLimits(size=1_000_000)
    with extracted(inner, limits) as folder:
        left = limits.after(folder)
    assert left.size == 100_000
    assert limits.size == 1_000_000


@pytest.mark.parametrize("part", ["../x", "a/b", "a\\b", "..", "", "/x", "c:x", "x."])
def test_write_ssp_refuses_parts_that_are_paths(build, tmp_path, part):
    target = tmp_path / "out.ssp"
    with pytest.raises(ValueError, match="expected a name"):
        write_ssp(System({part: build()}), target, name="s")
    assert not target.exists()


def test_entries_twice_with_one_content_and_names_with_a_last_dot(tmp_path):
    """As the Roberts of the Reference-FMUs has them."""
    path = tmp_path / "a.fmu"
    with warnings.catch_warnings(), zipfile.ZipFile(path, "w") as archive:
        warnings.simplefilter("ignore")  # zipfile's, of the second name
        archive.writestr("extra/list.csv", "1,2")
        archive.writestr("extra/list.csv", "1,2")
        if os.name != "nt":  # which drops the dot
            archive.writestr("extra/notes.", "a dot")
    names = [entry.filename for entry in archive_entries(path)]
    assert names == ["extra/list.csv", *(["extra/notes."] if os.name != "nt" else [])]
    with extracted(path) as folder:
        assert (folder / "extra/list.csv").read_text() == "1,2"
        assert os.name == "nt" or (folder / "extra/notes.").read_text() == "a dot"


def frame(text, arrays=b""):
    return struct.pack("<II", len(text), len(arrays)) + text + arrays


def test_malformed_frames_are_no_frames():
    for data in (frame(b"[" * 200_000), frame(b"\xff"), frame(b"1e")):
        read, write = os.pipe()
        with os.fdopen(read, "rb"), os.fdopen(write, "wb", buffering=0) as stream:
            # Larger than a pipe holds: written behind the reader's back.
            writer = threading.Thread(target=stream.write, args=(data,))
            writer.start()
            with pytest.raises(EOFError, match="no frame"):
                receive(read)
            writer.join()


@pytest.mark.parametrize(
    "word",
    [
        {"array": "q?", "length": 1},
        {"array": "d", "length": 1 << 40},
        {"array": "d", "length": -1},
        {"array": "d"},
        {"array": [], "length": 1},
        {"pointer": "x"},
    ],
)
def test_malformed_arrays_are_no_frames(word):
    with pytest.raises(EOFError, match="no frame"):
        decoded([word], b"")


def test_a_refused_package_writes_nothing_beside_it(tmp_path, capsys):
    model = tmp_path / "filter.toml"
    pf.save(model, pf.lowpass(2, 20.0).sampled(0.002))
    out = tmp_path / "out.fmu"
    assert main(["export", str(model), "--fmu", str(out), "--ssp", str(tmp_path / "out.ssp")]) == 2
    assert not out.exists()
    capsys.readouterr()
