"""Packages for targets as their users build them: CMake itself, Zephyr and Arduino with stubs of their headers."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, SampledPhyFilter, export_target, save
from phyfilter_ctl.cli import main
from phyfilter_ctl.codegen import find_compiler
from phyfilter_ctl.codegen.export_target import Target

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
    everything = get_args(Target) if kind == "filter" else ("arduino", "cmake", "zephyr")
    for target in everything:
        folder = make(kind, target, tmp_path)
        for path in folder.rglob("*"):
            assert "@" not in path.name
            if path.is_file() and path.suffix != ".in":  # CMake fills those
                assert not re.findall(r"@\w+@", path.read_text()), path


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
    period = 0.002 if kind == "filter" else 0.001  # no whole number of ticks, and no drift
    assert out.splitlines()[-1] == f"{round(3000 * period * 32768)} ticks"


# A body that is rolled, pitched and turned: its z axis in the frame it flies in, by angles instead of the quaternion.
ROLL, PITCH, YAW = 0.3, -0.2, 0.7


def tilted(file, order="wxyz"):
    (cr, cp, cy), (sr, sp, sy) = np.cos([ROLL, PITCH, YAW]), np.sin([ROLL, PITCH, YAW])
    body_z = cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp
    (cr, cp, cy), (sr, sp, sy) = (f(np.divide([ROLL, PITCH, YAW], 2)) for f in (np.cos, np.sin))
    q = {
        "w": cr * cp * cy + sr * sp * sy, "x": sr * cp * cy - cr * sp * sy,
        "y": cr * sp * cy + sr * cp * sy, "z": cr * cp * sy - sr * sp * cy,
    }  # fmt: skip
    attitude = ", ".join(f"{q[letter]:.9g}f" for letter in order)
    return (
        (STUBS / file)
        .read_text()
        .replace("ATTITUDE", f"{{{attitude}}}")
        .replace("BODY_Z", f"{{{', '.join(map(repr, map(float, body_z)))}}}")
    )


PX4_HEADERS = """
    lib/mathlib/mathlib.h px4_platform_common/module.h px4_platform_common/module_params.h
    px4_platform_common/px4_work_queue/ScheduledWorkItem.hpp uORB/Publication.hpp uORB/Subscription.hpp
    uORB/SubscriptionCallback.hpp uORB/SubscriptionInterval.hpp uORB/topics/actuator_motors.h uORB/topics/debug_vect.h
    uORB/topics/parameter_update.h uORB/topics/wind_estimate.h uORB/topics/vehicle_attitude.h
    uORB/topics/vehicle_land_detected.h uORB/topics/vehicle_local_position.h
"""


@pytest.mark.slow
@pytest.mark.parametrize(("pole", "refused"), [(-40.0, 0), (40.0, 1)])
def test_px4s_module_flies(pole, refused, tmp_path):
    """Against stubs of PX4's headers: poles from parameters, estimator resets, lost samples, a pole that is refused."""
    filter_ = PhyFilter.from_poles([-12.0, -20.0 + 10.0j, -20.0 - 10.0j]).sampled(0.004)
    folder = export_target(filter_, "px4", tmp_path / "px4", name="wind", channels=3)
    module = folder / "src" / "modules" / "wind"
    headers = tmp_path / "include"
    for name in PX4_HEADERS.split():
        (headers / name).parent.mkdir(parents=True, exist_ok=True)
        (headers / name).write_text('#include "px4_stub.hpp"\n')
    found = re.findall(
        r"^      (\w+):\n.*\n        type: (\w+)\n(?:.*\n)*?        default: (\S+)",
        (module / "module.yaml").read_text(),
        re.M,
    )
    assert {name for name, *_ in found} == {"WIND_T_MAX", "WIND_FF_EN", "WIND_P0R", "WIND_P1R", "WIND_P1I"}
    kinds = {"float": "float", "boolean": "bool"}
    (headers / "stub_parameters.hpp").write_text(
        "".join(
            f"struct {name} {{ static inline {kinds[kind]} value = {value}; }};\n"
            for name, kind, value in found
        )
    )
    compiler, objects = find_compiler().command, []
    flags = ["-O1", "-Wall", "-Wextra", "-Werror", "-Wdouble-promotion", "-Wfloat-equal", "-Wshadow"]
    for path in module.glob("*.c"):
        objects.append(tmp_path / f"{path.stem}.o")
        ran(*compiler, *flags, "-funsafe-math-optimizations", "-c", path, "-o", objects[-1])
    (tmp_path / "main.cpp").write_text(tilted("px4/fly.cpp").replace("POLE", f"{pole}f"))
    include = ["-I", headers, "-I", STUBS / "px4", "-I", module]
    for path in (module / "Wind.cpp", tmp_path / "main.cpp"):
        objects.append(tmp_path / f"{path.stem}_cpp.o")
        ran(
            *compiler,
            "-std=c++17",
            "-O1",
            "-Wall",
            "-Wextra",
            "-Werror",
            *include,
            "-x",
            "c++",
            "-c",
            path,
            "-o",
            objects[-1],
        )
    ran(*compiler, *objects, "-lstdc++", "-lm", "-o", tmp_path / "module")
    out = ran(tmp_path / "module")
    rows = [list(map(float, line.split())) for line in out.splitlines() if line[0].isdigit()]
    for row in rows[:-1]:
        # 2 s of poles at -12 rad/s; velocities up to 30 m/s in float, over 4 ms: 2 um/s / 4 ms.
        np.testing.assert_allclose(row[1:4], [1.0, 0.0, -0.5], atol=2e-3)
        assert row[5] == -row[1]  # the feed-forward
    assert rows[-1] == [1000, 0, 0, 0, 0, 0]  # landed: nothing is left of it
    assert [row[4] for row in rows] == [0, 0, 1, 0, 0, 0]  # health: two samples were missing
    assert ("poles kept" in out) == bool(refused)


CRAZYFLIE_HEADERS = "app FreeRTOS task controller controller_pid log param stabilizer_types usec_time debug"


@pytest.mark.slow
def test_the_crazyflies_app_flies(tmp_path):
    """Against stubs of the firmware's headers, under its warnings."""
    filter_ = PhyFilter.from_poles([-12.0, -20.0 + 10.0j, -20.0 - 10.0j]).sampled(0.002)
    folder = export_target(filter_, "crazyflie", tmp_path / "app", name="wind")
    headers = tmp_path / "include"
    headers.mkdir()
    for name in CRAZYFLIE_HEADERS.split():
        (headers / f"{name}.h").write_text('#include "crazyflie_stub.h"\n')
    (tmp_path / "main.c").write_text(tilted("crazyflie/fly.c", "xyzw"))
    built = re.findall(r"obj-y \+= (\w+)\.o", (folder / "src" / "Kbuild").read_text())
    assert sorted(built) == sorted(path.stem for path in (folder / "src").glob("*.c"))
    flags = [
        "-std=gnu11",
        "-O1",
        "-Wall",
        "-Werror",
        "-Wdouble-promotion",
        "-I",
        headers,
        "-I",
        STUBS / "crazyflie",
    ]
    sources = [*(folder / "src").glob("*.c"), tmp_path / "main.c"]
    ran(*find_compiler().command, *flags, *sources, "-lm", "-o", tmp_path / "app.out")
    flown, landed, tuned = (list(map(float, line.split())) for line in ran(tmp_path / "app.out").splitlines())
    fx, fz, health, thrust = flown
    assert landed == [0, 0, 0, 0]
    # 0.19 s after take-off with poles at -60 rad/s: gone to 1e-3; those at -12 rad/s are not there yet.
    np.testing.assert_allclose(tuned, [1.0, 0.0, 0.0, 0.0], atol=5e-3)
    np.testing.assert_allclose([fx, fz], [1.0, -0.5], atol=2e-3)
    assert health == 0
    np.testing.assert_allclose(
        thrust, (9.81 + 0.5) / 9.81, rtol=1e-3
    )  # the feed-forward carries what pulls down


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "Wind"}, "small letters"),
        ({"channels": 2}, "3 channels"),
        ({"inertia": 2.0}, "per unit of mass"),
        ({"dt": 0.0033}, "divides 1000 Hz"),
        ({"b": [3.0]}, "low-pass"),
        ({"filters": 3}, "one sampled filter"),
        ({"order": 4}, "1,644 bytes of stack where 1,800"),
    ],
)
def test_what_an_autopilot_cannot_take_is_refused(change, message, tmp_path):
    a = np.poly([-12.0] * change.pop("order", 1))[:0:-1]
    filter_ = PhyFilter(a, change.pop("b", None)).sampled(change.pop("dt", 0.002))
    filter_ = SampledPhyFilter(filter_.filters * change.pop("filters", 1), filter_.sampling)
    with pytest.raises(ValueError, match=message):
        export_target(filter_, "crazyflie", tmp_path / "a", **({"name": "wind"} | change))
    assert not (tmp_path / "a").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("pole", "refused"), [(-30.0, False), (1.0, True)])
def test_ardupilots_backend_takes_the_place_of_the_integrators(pole, refused, tmp_path):
    """Against stubs of ArduPilot's headers, under its flags: a steady push leaves no rate behind."""
    filter_ = PhyFilter.from_poles([-12.0, -20.0 + 10.0j, -20.0 - 10.0j]).sampled(0.0025)
    folder = export_target(filter_, "ardupilot", tmp_path / "ardupilot", name="wind")
    library = folder / "libraries" / "AC_CustomControl"
    headers, objects = tmp_path / "include", []
    for name in (
        "AC_CustomControl_Backend.h",
        "AP_HAL/AP_HAL.h",
        "AP_Logger/AP_Logger.h",
        "GCS_MAVLink/GCS.h",
    ):
        (headers / name).parent.mkdir(parents=True, exist_ok=True)
        (headers / name).write_text('#include "ardupilot_stub.h"\n')
    (tmp_path / "main.cpp").write_text((STUBS / "ardupilot/fly.cpp").read_text().replace("POLE", f"{pole}f"))
    for path in (library / "wind").glob("*.c"):
        objects.append(tmp_path / f"{path.stem}.o")
        ran(*find_compiler().command, *STRICT, "-fsingle-precision-constant", "-c", path, "-o", objects[-1])
    include = ["-I", headers, "-I", STUBS / "ardupilot", "-I", library]
    for path in (library / "AC_CustomControl_Wind.cpp", tmp_path / "main.cpp"):
        objects.append(tmp_path / f"{path.stem}_cpp.o")
        options = ["-std=gnu++17", *STRICT, "-fsingle-precision-constant", *include, "-x", "c++"]
        ran(*find_compiler().command, *options, "-c", path, "-o", objects[-1])
    ran(*find_compiler().command, *objects, "-lstdc++", "-lm", "-o", tmp_path / "backend")
    out = ran(tmp_path / "backend")
    rows = [list(map(float, line.split())) for line in out.splitlines() if line[0].isdigit()]
    for row in rows[:2]:
        # 5 s of poles from -12 rad/s on, behind a main controller of 10 and 4 rad/s; rates in float.
        np.testing.assert_allclose(row[1:], [-3.0, 2.0, 0.0, 0.0, 0.0], atol=2e-3)
    np.testing.assert_array_equal(
        rows[2], [4000, 0, 0, 0, 0, 4001]
    )  # on the ground it adds nothing, and logs
    assert rows[3][0] < 0.05  # of pushes of 3 rad/s^2, while a feed-forward of 10 rad/s^2 goes to and fro
    assert ("poles kept" in out) == refused


ROS2_HEADERS = """
    diagnostic_msgs/msg/diagnostic_array.hpp geometry_msgs/msg/vector3_stamped.hpp rclcpp/rclcpp.hpp
    rclcpp_components/register_node_macro.hpp
"""


def fast_after(time):
    """Step response of the poles that are set."""
    a = np.poly([-40.0, -30.0 + 5.0j, -30.0 - 5.0j]).real
    return float(ct.step_response(ct.tf([a[-1]], a), [0.0, time]).outputs[-1])


@pytest.mark.slow
def test_the_component_of_ros2_runs(tmp_path):
    """Against a stub of rclcpp: estimate, diagnostics, poles by parameters and those that are refused."""
    filter_ = PhyFilter.from_poles([-12.0, -20.0 + 10.0j, -20.0 - 10.0j]).sampled(0.002)
    folder = export_target(filter_, "ros2", tmp_path / "wind", name="wind")
    ElementTree.fromstring((folder / "package.xml").read_text())
    headers, objects = tmp_path / "include", []
    for name in ROS2_HEADERS.split():
        (headers / name).parent.mkdir(parents=True, exist_ok=True)
        (headers / name).write_text('#include "ros2_stub.hpp"\n')
    for path in (folder / "src").glob("*.c"):
        assert f"src/{path.name}" in (folder / "CMakeLists.txt").read_text()
        objects.append(tmp_path / f"{path.stem}.o")
        ran(*find_compiler().command, *STRICT, "-c", path, "-o", objects[-1])
    (tmp_path / "main.cpp").write_text(
        (STUBS / "ros2/run.cpp").read_text().replace("NODE", str(folder / "src" / "wind_node.cpp"))
    )
    include = ["-I", headers, "-I", STUBS / "ros2", "-I", folder / "src"]
    options = [
        "-std=c++17",
        *STRICT,
        *include,
        "-x",
        "c++",
        "-c",
        tmp_path / "main.cpp",
        "-o",
        tmp_path / "main.o",
    ]
    ran(*find_compiler().command, *options)
    ran(*find_compiler().command, tmp_path / "main.o", *objects, "-lstdc++", "-lm", "-o", tmp_path / "node")
    first, tuned, second, third, launched, set_, bounded = (
        list(map(float, line.split())) for line in ran(tmp_path / "node").splitlines()
    )
    assert launched == set_  # poles of a launch file are those that are set
    assert launched[0] == pytest.approx(fast_after(0.038), abs=0.03)
    assert bounded == [1]  # so is the bound: the estimate goes beyond it
    assert tuned == [0, 0, 1]
    for row, samples, level in ((first, 1000, 0), (second, 1500, 0), (third, 1995, 1)):
        assert (row[0], row[-1]) == (samples, level)  # the third says that samples were missing
        np.testing.assert_allclose(row[1:4], [1.0, 0.0, -0.5], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("real", "inertia"), [("double", None), ("float", "full")])
def test_the_crate_passes_its_tests(real, inertia, tmp_path):
    if shutil.which("cargo") is None:
        pytest.skip("cargo is not installed")
    folder = export_target(
        FILTER, "rust", tmp_path / "crate", real=real, name="wind", channels=2, inertia=inertia
    )
    out = ran("cargo", "test", "--offline", "--quiet", cwd=folder)
    assert "1 passed" in out


def test_the_page_for_users_runs_as_written(tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "targets.md").read_text()
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^phyfilter-ctl (.+)$", page, re.M)
    assert len(commands) == 10
    for command in commands:
        assert main(command.split()) == 0
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == [
        f"{target}_wind"
        for target in ("arduino", "ardupilot", "cmake", "crazyflie", "m0", "px4", "ros2", "rust", "zephyr")
    ]


@pytest.mark.slow
def test_px4s_build_finds_module_and_message(tmp_path):
    """As PX4's own CMakeLists.txt looks for them in EXTERNAL_MODULES_LOCATION."""
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    folder = export_target(FILTER, "px4", tmp_path / "px4", name="wind")
    (tmp_path / "CMakeLists.txt").write_text(f"""\
cmake_minimum_required(VERSION 3.13)
project(px4 NONE)
function(px4_add_module)
  cmake_parse_arguments(given "EXTERNAL" "MODULE;MAIN;MODULE_CONFIG" "SRCS;DEPENDS" ${{ARGN}})
  foreach(file ${{given_SRCS}} ${{given_MODULE_CONFIG}})
    if(NOT EXISTS ${{CMAKE_CURRENT_SOURCE_DIR}}/${{file}})
      message(FATAL_ERROR "${{file}} is missing")
    endif()
  endforeach()
  message(STATUS "module ${{given_MODULE}} ${{given_EXTERNAL}}")
endfunction()
add_subdirectory({folder}/src external_modules_src)
foreach(module ${{config_module_list_external}})
  add_subdirectory({folder}/src/${{module}} external_modules/${{module}})
endforeach()
add_subdirectory({folder}/msg external_msg)
foreach(message ${{config_msg_list_external}})
  file(STRINGS {folder}/msg/${{message}} lines)
  message(STATUS "message ${{message}}")
endforeach()
""")
    out = ran("cmake", "-S", tmp_path, "-B", tmp_path / "build")
    assert "module modules__wind TRUE" in out
    assert "message WindEstimate.msg" in out


def test_a_double_of_32_bits_is_refused_when_compiling(tmp_path):
    """AVR: here a float.h that says what avr-gcc's says."""
    folder = make("filter", "arduino", tmp_path, real="float")
    (tmp_path / "float.h").write_text(
        "#include_next <float.h>\n#undef DBL_MANT_DIG\n#define DBL_MANT_DIG 24\n"
    )
    command = [
        *find_compiler().command,
        "-fsyntax-only",
        "-I",
        str(tmp_path),
        str(folder / "src" / "swing.c"),
    ]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode != 0
    assert "a double of 64 bits" in answer.stderr
