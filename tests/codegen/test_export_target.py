"""Packages for targets as their users build them: CMake itself, Zephyr and Arduino with stubs of their headers."""

import shutil
import subprocess
from pathlib import Path

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, export_target, save
from phyfilter_ctl.cli import main
from phyfilter_ctl.codegen import find_compiler

FILTER = PhyFilter.from_poles([-20.0, -30.0 + 10.0j, -30.0 - 10.0j]).sampled(0.002)
STUBS = Path(__file__).parents[1] / "c" / "stubs"
STRICT = ["-O1", "-Wall", "-Wextra", "-Werror"]


def system(kind):
    return FILTER if kind == "filter" else ct.nlsys(
        lambda t, x, u, params: np.array([x[1], u[0] - np.sin(x[0])]), inputs=1, states=2, name="swing"
    )  # fmt: skip


@pytest.fixture(params=["filter", "diagram"])
def kind(request):
    return request.param


def make(kind, target, folder, **options):
    if kind == "filter":
        options |= {"channels": 3, "name": "swing"}
    return export_target(system(kind), target, folder / target, **options)


def ran(*command, cwd=None):
    answer = subprocess.run(
        [str(word) for word in command], cwd=cwd, capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stdout[-2000:] + answer.stderr[-2000:]
    return answer.stdout


def test_nothing_is_left_open_in_a_template(kind, tmp_path):
    for target in ("arduino", "cmake", "zephyr"):
        folder = make(kind, target, tmp_path)
        for path in folder.rglob("*"):
            assert "@" not in path.name
            if path.is_file() and path.suffix != ".in":
                assert not [word for word in ("@name@", "@NAME@", "@usage@") if word in path.read_text()]


def test_the_command_writes_it(tmp_path, capsys):
    save(tmp_path / "filter.toml", FILTER)
    folder = tmp_path / "package"
    assert (
        main(["export", str(tmp_path / "filter.toml"), "--target", "cmake", str(folder), "--channels", "3"])
        == 0
    )
    assert (folder / "src" / "phyfilter_guard.c").is_file()
    assert str(folder) in capsys.readouterr().out
    assert main(["export", str(tmp_path / "filter.toml"), "--target", "px5", str(tmp_path / "b")]) != 0


@pytest.mark.slow
def test_cmake_builds_tests_installs_and_is_found(kind, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    folder, build, prefix = make(kind, "cmake", tmp_path), tmp_path / "build", tmp_path / "prefix"
    ran("cmake", "-S", folder, "-B", build, f"-DCMAKE_C_FLAGS={' '.join(STRICT)}")
    ran("cmake", "--build", build)
    ran("ctest", "--output-on-failure", cwd=build)
    ran("cmake", "--install", build, "--prefix", prefix)
    user = tmp_path / "user"
    user.mkdir()
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.13)\nproject(user C)\nfind_package(swing 0.1 REQUIRED)\n"
        "add_executable(user main.c)\ntarget_link_libraries(user swing::swing)\n"
    )
    header = "swing_guard.h" if kind == "filter" else "swing.h"
    call = "swing_guard_init(&self, &swing_parameters)" if kind == "filter" else "swing_init(&self)"
    type_name = "swing_guard" if kind == "filter" else "swing"
    text = f'#include "{header}"\nint main(void) {{ static {type_name} self; return {call}; }}\n'
    (user / "main.c").write_text(text)
    ran("cmake", "-S", user, "-B", user / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    ran("cmake", "--build", user / "build")
    ran(user / "build" / "user")
    if shutil.which("pkg-config"):
        (pc,) = prefix.rglob("swing.pc")
        flags = ran(
            "env", f"PKG_CONFIG_PATH={pc.parent}", "pkg-config", "--cflags", "--libs", "swing"
        ).split()
        ran(*find_compiler().command, user / "main.c", *flags, "-o", user / "by_pkg_config")


@pytest.mark.slow
@pytest.mark.parametrize("real", ["double", "float"])
def test_the_sketch_compiles_and_runs(kind, real, tmp_path):
    folder = make(kind, "arduino", tmp_path, real=real)
    (sketch,) = folder.glob("examples/*/*.ino")
    program = tmp_path / "main.cpp"
    loops = "int main() { setup(); for (int i = 0; i < 4000; i++) loop(); }\n"
    program.write_text(f'#include "Arduino.h"\n#include "{sketch}"\n{loops}')
    objects = []
    for path in folder.glob("src/*.c"):
        objects.append(tmp_path / f"{path.stem}.o")
        ran(*find_compiler().command, *STRICT, "-std=gnu99", "-c", path, "-o", objects[-1])
    compiler = find_compiler().command
    include = ["-I", STUBS / "arduino", "-I", folder / "src"]
    ran(*compiler, *STRICT, "-x", "c++", *include, "-c", program, "-o", tmp_path / "main.o")
    ran(*compiler, tmp_path / "main.o", *objects, "-lm", "-o", tmp_path / "main")
    last = ran(tmp_path / "main").splitlines()[-1].split()
    assert last[-1] == "0"  # health, or status


@pytest.mark.slow
def test_zephyrs_sample_compiles_and_runs(kind, tmp_path):
    folder = make(kind, "zephyr", tmp_path)
    named = (folder / "zephyr" / "CMakeLists.txt").read_text()
    sources = [path for path in sorted(folder.glob("src/*.c")) if path.name in named]
    assert len(sources) == len(list(folder.glob("src/*.c")))
    # STUBS itself: the headers are included as <zephyr/kernel.h>.
    command = [*find_compiler().command, *STRICT, "-std=gnu11", "-I", STUBS, "-I", folder / "src", *sources]
    ran(*command, folder / "samples" / "estimate" / "src" / "main.c", "-lm", "-o", tmp_path / "sample")
    out = ran(tmp_path / "sample")
    assert out.splitlines()[0].startswith("0: health 0" if kind == "filter" else "0: status 0")
