"""FMI-LS-XCP: the page of a calibration tool, found through the A2L file as the tool finds it."""

import ctypes
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from exported_fmus import FILTER, FOLDER, PERIOD, Instance, oscillator, quick_compiler, unpacked

from phyfilter_ctl import export_fmu
from phyfilter_ctl.fmi import FmuPorts
from phyfilter_ctl.fmi.build import PLATFORMS, native_platform
from phyfilter_ctl.fmi.calibration import load_address

ROOM = "extra/org.fmi-standard.fmi-ls-xcp"
FORMATS = ("x86_64-windows", "aarch64-darwin")  # PE and Mach-O beside the ELF of this machine
LS = "{http://fmi-standard.org/fmi-ls-manifest}fmi-ls-"
ITEM = re.compile(
    r"/begin (CHARACTERISTIC|MEASUREMENT) (\S+) .*\n(?:VALUE 0x(\w+)|FLOAT64_IEEE .*\nECU_ADDRESS 0x(\w+))"
)


@cache
def calibrated(fmi, kind="filter", **options):
    system = FILTER.sampled(PERIOD) if kind == "filter" else oscillator()
    path = FOLDER / f"xcp_{kind}_{fmi[0]}_{len(options)}.fmu"
    options = {"compiler": quick_compiler(), **options}
    return export_fmu(system, path, fmi=fmi, name="wing", ports=FmuPorts(xcp=True), **options)


class Tool:
    """Reads and writes memory at the addresses of an A2L file, from where the binary is loaded."""

    def __init__(self, path, fmi):
        folder = native_platform().folder(fmi)
        text = zipfile.ZipFile(path).read(f"{ROOM}/{folder}/wing.a2l").decode()
        self.places = {name: int(first or second, 16) for _, name, first, second in ITEM.findall(text)}
        self.kinds = {name: kind for kind, name, *_ in ITEM.findall(text)}
        (library,) = (unpacked(path) / "binaries" / folder).iterdir()
        version = getattr(ctypes.CDLL(str(library)), f"fmi{fmi[0]}GetVersion")
        found = (ctypes.c_void_p * 4)()  # Dl_info: name, base, nearest symbol, its address
        assert ctypes.CDLL(None).dladdr(ctypes.cast(version, ctypes.c_void_p), found)
        self.base = found[1]

    def at(self, name):
        return ctypes.c_double.from_address(self.base + self.places[name])

    def read(self, *names):
        return np.array([self.at(name).value for name in names])

    def write(self, **values):
        for name, value in values.items():
            self.at(f"{name[0]}[{name[1:]}]").value = value


loaded_here = pytest.mark.skipif(sys.platform == "win32", reason="dladdr tells where a library is loaded")


@loaded_here
@pytest.mark.parametrize("fmi", ["3.0", pytest.param("2.0", marks=pytest.mark.slow)])
def test_a_tool_tunes_and_measures_as_the_importer_does(fmi):
    """Coefficients written one by one, not stable in between, beside an instance that the importer sets."""
    path = calibrated(fmi)
    tool, rng = Tool(path, fmi), np.random.default_rng(3)
    names = [name for name, kind in tool.kinds.items() if kind == "CHARACTERISTIC"]
    assert names == ["a[0]", "a[1]", "b[0]", "b[1]"]
    before, after = np.concatenate([FILTER.a, FILTER.b]), np.array([100.0, 15.0, 100.0, 0.0])
    with Instance(path) as tuned, Instance(path) as beside:
        assert np.array_equal(tool.read(*names), before)
        for fmu in (tuned, beside):
            fmu.start()
        for k in range(12):
            x = rng.normal()
            if k == 3:
                tool.write(a1=-1.0)  # refused
            if k == 5:
                tool.write(a0=100.0)  # still
            if k == 7:
                tool.write(a1=15.0, b0=100.0, b1=0.0)
                beside.set(a=after[:2], b=after[2:])
            tuned.step(PERIOD, x=x)
            beside.step(PERIOD, x=x)
            assert np.array_equal(tuned.get("f_hat"), beside.get("f_hat"))
            assert np.array_equal(tuned.get("a", "b"), before if k < 7 else after)
            measured = tool.read("time", "x[0]" if "x[0]" in tool.places else "x")
            assert measured == pytest.approx([tuned.time, x], rel=1e-12)
            assert tool.read("f_hat[0]" if "f_hat[0]" in tool.places else "f_hat") == tuned.get("f_hat")
        assert (
            tuned.two or sum("refused" in text for text in tuned.messages) == 2
        )  # FMPy keeps those of FMI 3
        tuned.set(a=before[:2], b=before[2:]).step(PERIOD, x=0.0)
        assert np.array_equal(tool.read(*names), before)  # and the importer's are told
        tool.write(a0=50.0)
    with Instance(path) as last:
        assert np.array_equal(tool.read(*names), before)  # another instance begins anew
        last.start().step(PERIOD, x=1.0)
        assert np.array_equal(last.get("a", "b"), before)


def test_the_archive_is_as_the_layered_standard_says():
    path = calibrated("3.0")
    archive = zipfile.ZipFile(path)
    manifest = ET.fromstring(archive.read(f"{ROOM}/fmi-ls-manifest.xml"))
    assert manifest.tag == "fmiLayeredStandardManifest"
    assert manifest.get(f"{LS}name") == "org.fmi-standard.fmi-ls-xcp"
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest.get(f"{LS}version"))
    assert manifest.get(f"{LS}description").startswith("Layered standard based on FMI 2.0 and FMI 3.0")
    (interface,) = manifest
    assert interface.get("supportsDirectMemoryAccess") == "true"
    assert interface.get("containsXCPService") is None
    definition = interface.get("definition")
    assert "/" not in definition
    texts = [
        archive.read(f"{ROOM}/{folder}{definition}").decode() for folder in ("", f"{native_platform().name}/")
    ]
    assert not any("/include" in text for text in texts)  # forbidden
    sources, binary = (ITEM.findall(text) for text in texts)
    assert [name for _, name, *_ in sources] == [name for _, name, *_ in binary]
    assert {first or second for *_, first, second in sources} == {"0"}
    offsets = [int(offset) for offset in re.findall(r'SYMBOL_LINK "wing_xcp" (\d+)', texts[0])]
    addresses = [int(first or second, 16) for *_, first, second in binary]
    assert np.array_equal(np.diff(addresses), np.diff(offsets))
    assert "page_here wing_xcp =" in archive.read("sources/wing_xcp.c").decode()
    assert "SYMBOL_LINK" not in texts[1]


@pytest.mark.slow
@loaded_here
@pytest.mark.parametrize("kind", ["cs", "me"])
def test_a_plant_shows_its_states(kind):
    path = calibrated("3.0", "plant")
    tool = Tool(path, "3.0")
    states = [name for name in tool.places if name.startswith("swing")] or list(tool.places)
    assert states
    with Instance(path, kind) as fmu:
        fmu.start()
        if kind == "cs":
            fmu.step(0.1)
            assert tool.read("time") == pytest.approx([0.1])
        known = {name: fmu.get(name) for name in tool.places if "[" not in name and name != "time"}
        assert known
        for name, value in known.items():
            assert tool.read(name) == value


@pytest.mark.release
def test_binaries_of_other_formats_have_addresses():
    pytest.importorskip("ziglang")
    path = calibrated("3.0", platforms=FORMATS, compiler=None)
    archive = zipfile.ZipFile(path)
    token = ET.fromstring(archive.read("modelDescription.xml")).get("instantiationToken").strip("{}")
    mark = bytes.fromhex(token.replace("-", ""))
    for platform in map(PLATFORMS.__getitem__, FORMATS):
        text = archive.read(f"{ROOM}/{platform.name}/wing.a2l").decode()
        address = load_address(archive.read(f"binaries/{platform.name}/wing{platform.suffix}"), mark)
        assert int(ITEM.search(text)[4], 16) == address + 16


@pytest.mark.slow
def test_another_tool_reads_it(tmp_path):
    beside = str(Path(sys.executable).parent)  # on nobody's PATH where the environment is not active
    checker = shutil.which("a2ltool") or shutil.which("a2ltool", path=beside)
    if checker is None:
        pytest.skip("a2ltool is not installed (extra: importers)")
    archive = zipfile.ZipFile(calibrated("3.0"))
    for name in [name for name in archive.namelist() if name.endswith(".a2l")]:
        file = tmp_path / "wing.a2l"
        file.write_bytes(archive.read(name))
        answer = subprocess.run(
            [checker, "--strict", "--check", str(file)], capture_output=True, text=True, check=False
        )
        assert answer.returncode == 0, answer.stdout + answer.stderr
        assert "No problems found" in answer.stdout


def test_channels_of_no_fixed_number_have_no_address(tmp_path):
    with pytest.raises(ValueError, match="fixed number of channels"):
        export_fmu(FILTER.sampled(PERIOD), tmp_path / "a.fmu", ports=FmuPorts(max_channels=2, xcp=True))
    assert not list(tmp_path.iterdir())


def test_a_binary_without_its_page_is_refused():
    for binary, what in ((b"ab", "once"), (b"abmmab" + b"mm", "once"), (b"\x7fELF mm", "ELF, PE or Mach-O")):
        with pytest.raises(ValueError, match=what):
            load_address(binary, b"mm")
