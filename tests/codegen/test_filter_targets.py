"""The filter's C under sanitizers and from several compilers: no fault on any call, the same bits everywhere."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, stack
from phyfilter_ctl.codegen.compiler import compile_sources, find_compiler
from phyfilter_ctl.codegen.filter_code import FilterSource, filter_source
from tests.cpu_budget import release_but, slow_but

H = 0.002
CALLS = 10_000
DRIVER = (Path(__file__).parents[1] / "c" / "filter_calls.c").read_text()
STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"]
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]

THIRD = PhyFilter([1780.0, 289.0, 30.0], [1780.0, 200.0, 12.0])
DIRECTION = np.array([[1.0, 0.2], [0.0, 1.0], [0.5, -1.0]])


def sources() -> dict[str, FilterSource]:
    everything = {"E": DIRECTION, "delay": 0.0071, "limit": 4.0, "nonfinite": "hold"}
    mixed = [entry.sampled(H, "euler", "average", precision="float32") for entry in (PhyFilter([3.0]), THIRD)]
    return {
        "everything": filter_source(
            THIRD.sampled(H, "tustin", precision="float32", **everything),
            3,
            name="everything",
            inertia="full",
        ),
        "mixed": filter_source(stack(mixed), 2, name="mixed", inertia=[1.0, 2.0]),
        "lean": filter_source(
            PhyFilter.from_poles([-20.0] * 6).sampled(H, precision="float32"),
            3,
            name="lean",
            variable=False,
            tunable=False,
        ),
    }


SOURCES = sources()
PLAIN = filter_source(THIRD.sampled(H, nonfinite="hold"), 1, name="plain")


def run(source: FilterSource, folder: Path, *, calls: int, flags=(), compiler=None) -> tuple[str, int]:
    texts = source.sources | {"filter_calls.c": DRIVER}
    options = [*STRICT, f"-DNAME={source.name}", f'-DHEADER="{source.name}.h"', *flags]
    program = compile_sources(texts, folder / "calls", kind="program", compiler=compiler, flags=options)
    answer = subprocess.run([str(program), str(calls)], capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stdout + answer.stderr[-3000:]
    crc, refused = answer.stdout.split()
    return crc, int(refused)


@pytest.mark.slow
@pytest.mark.parametrize("name", slow_but(("everything",), SOURCES))
def test_no_call_does_harm(name, tmp_path):
    """Wrong calls are refused and change nothing; a correct run afterwards is right."""
    try:
        compile_sources(
            {"a.c": "int main(void) { return 0; }"}, tmp_path / "a", kind="program", flags=SANITIZED
        )
    except RuntimeError:
        pytest.skip("the C compiler has no address and undefined-behaviour sanitizers")
    _, refused = run(SOURCES[name], tmp_path, calls=CALLS, flags=SANITIZED)
    assert 0.01 * CALLS < refused < 0.9 * CALLS


@pytest.mark.slow
@pytest.mark.parametrize("name", SOURCES)
def test_same_bits_at_every_optimisation(name, tmp_path):
    results = {level: run(SOURCES[name], tmp_path, calls=200, flags=[level]) for level in ("-O0", "-O3")}
    assert results["-O0"] == results["-O3"]


@pytest.mark.parametrize("name", ["everything", "lean"])
def test_same_bits_from_clang(name, tmp_path):
    if find_spec("ziglang") is None:
        pytest.skip("ziglang is not installed")
    zig = [sys.executable, "-m", "ziglang", "cc"]
    assert run(SOURCES[name], tmp_path, calls=200, compiler=zig) == run(SOURCES[name], tmp_path, calls=200)


FLAGS = {
    "PX4": ["-funsafe-math-optimizations", "-fno-math-errno"],
    "ArduPilot": ["-fsingle-precision-constant"],
    "numbers only": ["-ffinite-math-only", "-fno-signed-zeros"],
    "fused": ["-O3", "-march=native", "-ffp-contract=fast"],
}


@pytest.fixture(scope="module")
def unflagged(tmp_path_factory):
    build = {**SOURCES, "plain": PLAIN}
    return {
        name: run(build[name], tmp_path_factory.mktemp(name), calls=200) for name in ("everything", "plain")
    }


@pytest.mark.parametrize("flags", release_but({"PX4"}, FLAGS))
def test_flags_of_firmware_change_no_bit(flags, unflagged, tmp_path):
    """Taken back by pf_ieee.h: parameters rounded to float, a NaN that passes for a number, sums in another order."""
    if "clang" in find_compiler().version:
        pytest.skip("clang cannot take back -ffinite-math-only, and refuses to build")
    build = {**SOURCES, "plain": PLAIN}
    for name in ("everything", "plain"):
        assert run(build[name], tmp_path, calls=200, flags=FLAGS[flags]) == unflagged[name]


def test_fast_maths_is_refused(tmp_path):
    if "clang" in find_compiler().version:
        pytest.skip("gcc's -ffast-math is what defines __FAST_MATH__ in this test")
    with pytest.raises(RuntimeError, match="ffast-math"):
        run(SOURCES["lean"], tmp_path, calls=1, flags=["-ffast-math"])
