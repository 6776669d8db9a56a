"""A filter as a folder of C that checks itself on recorded signals."""

import shutil
import subprocess

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, stack
from phyfilter_ctl.codegen.compiler import compile_sources, find_compiler
from phyfilter_ctl.codegen.export import export_c
from phyfilter_ctl.codegen.filter_folder import export_filter
from tests.cpu_budget import slow_but

H = 0.002
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SECOND = PhyFilter([400.0, 40.0])
GENERAL = PhyFilter([1780.0, 289.0, 30.0], [1780.0, 200.0, 12.0])
EXPORTS = {
    "usual": (SECOND.sampled(H), {}),
    "lean": (SECOND.sampled(H), {"variable": False, "tunable": False}),
    "everything": (
        GENERAL.sampled(
            H,
            "tustin",
            g="average",
            E=[[1.0, 0.2], [0.0, 1.0], [0.5, -1.0]],
            delay=0.0071,
            limit=3.0,
            nonfinite="hold",
        ),
        {"inertia": "full"},
    ),
    "stack": (stack([PhyFilter([3.0]).sampled(H), SECOND.sampled(H), GENERAL.sampled(H)]), {"inertia": 1.3}),
}


@pytest.mark.parametrize("real", slow_but(["float"], ["double", "float"]))
@pytest.mark.parametrize("name", slow_but(("everything",), EXPORTS))
def test_exported_folder_checks_itself(name, real, tmp_path):
    sampled, settings = EXPORTS[name]
    folder = export_filter(sampled, tmp_path / "out", 3, real=real, name="wing", **settings)
    files = {path.name: path.read_text() for path in folder.iterdir()}
    program = compile_sources(files, tmp_path / "wing", kind="program", flags=STRICT)
    answer = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
    assert "40 samples" in answer.stdout
    worst = float(answer.stdout.split("within ")[1].split()[0])
    assert worst < 40 * np.finfo(np.float32 if real == "float" else float).eps


@pytest.mark.parametrize("real", ["double", "float"])
def test_constants_rounded_to_single_do_not_fail_the_check(real, tmp_path):
    """ArduPilot's flag rounds no number of the recorded signals: the filter, which takes it back, is right."""
    if "clang" in find_compiler().version:
        pytest.skip("-fsingle-precision-constant is gcc's")
    folder = export_filter(SECOND.sampled(H), tmp_path / "out", 3, real=real, name="wing")
    files = {path.name: path.read_text() for path in folder.iterdir()}
    flags = [*STRICT, "-fsingle-precision-constant"]
    program = compile_sources(files, tmp_path / "wing", kind="program", flags=flags)
    answer = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout
    assert "40 samples" in answer.stdout


def test_a_wrong_coefficient_is_found(tmp_path):
    """The test on the target can fail: as it must with a filter that is not the recorded one."""
    folder = export_filter(SECOND.sampled(H), tmp_path / "out", 3, name="wing")
    files = {path.name: path.read_text() for path in folder.iterdir()}
    other = export_filter(PhyFilter([400.0, 40.001]).sampled(H), tmp_path / "other", 3, name="wing")
    files["wing.c"] = (other / "wing.c").read_text()
    program = compile_sources(files, tmp_path / "wing", kind="program", flags=STRICT)
    assert subprocess.run([str(program)], capture_output=True, check=False).returncode == 1


def test_header_says_what_it_is(tmp_path):
    units = {"x": "m/s", "g": "N", "f": "N"}
    sampled = GENERAL.sampled(H, limit=2.0, channels=["x", "y"], units=units)
    folder = export_filter(sampled, tmp_path / "out", 2, name="wing")
    header = (folder / "wing.h").read_text()
    for part in ("1780", "s**3 + 30*s**2", "m/s", "channels: x, y", "dt = 0.002 s", "|f_hat| <= 2"):
        assert part in header, part
    assert max(map(len, header.splitlines())) <= 120


def test_same_twice_and_no_strangers(tmp_path):
    """Same input, same bytes; lean code needs no pf_tune; foreign files are left alone."""
    first = export_filter(SECOND.sampled(H), tmp_path / "out", 3)
    texts = {path.name: path.read_bytes() for path in first.iterdir()}
    again = export_filter(SECOND.sampled(H), tmp_path / "out", 3)
    assert {path.name: path.read_bytes() for path in again.iterdir()} == texts
    lean = export_filter(SECOND.sampled(H), tmp_path / "out", 3, variable=False, tunable=False)
    assert not (lean / "pf_tune.c").exists()
    (lean / "mine.txt").write_text("keep")
    with pytest.raises(FileExistsError, match=r"mine\.txt"):
        export_filter(SECOND.sampled(H), tmp_path / "out", 3)
    assert (lean / "mine.txt").read_text() == "keep"


@pytest.mark.slow
def test_symbols_stay_with_the_filter(tmp_path):
    """Everything that a linker sees starts with the filter's name or pf_; no heap, no libm, nothing that changes."""
    if shutil.which("nm") is None:
        pytest.skip("nm is not installed")
    sampled, settings = EXPORTS["everything"]
    folder = export_filter(sampled, tmp_path / "out", 3, name="wing", **settings)
    files = {path.name: path.read_text() for path in folder.iterdir() if path.name != "main.c"}
    library = compile_sources(files, tmp_path / "wing.so", flags=["-fvisibility=default"])
    listing = subprocess.run(["nm", str(library)], capture_output=True, text=True, check=True).stdout
    rows = [line.split()[-2:] for line in listing.splitlines()]
    ours = [name for kind, name in rows if kind in "TDBRC" and not name.startswith("_")]
    assert ours
    assert all(name.startswith(("wing_", "pf_")) for name in ours), ours
    assert not [name for kind, name in rows if kind in "DdBb" and name.startswith(("wing", "pf_"))]
    needed = {name.split("@")[0] for kind, name in rows if kind == "U"}
    assert needed <= {"memset", "memcpy", "memcmp", "memmove", "__stack_chk_fail"}, needed


def test_one_call_for_filters_and_diagrams(tmp_path):
    lag = ct.tf([1.0], [1.0, 1.0], inputs="u", outputs="y", name="lag")
    assert (export_c(lag, tmp_path / "lag") / "lag.h").is_file()
    two = export_c(stack([SECOND.sampled(H), GENERAL.sampled(H)]), tmp_path / "two")
    assert "#define phyfilter_N_X 2" in (two / "phyfilter.h").read_text()
    with pytest.raises(TypeError, match="sampled"):
        export_c(SECOND, tmp_path / "no")
    with pytest.raises(ValueError, match="channels"):
        export_c(lag, tmp_path / "no", channels=3)
    assert not (tmp_path / "no").exists()
