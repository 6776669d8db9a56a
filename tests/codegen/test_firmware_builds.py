"""Exports under the flags that firmware is built with: no warning, and the numbers of a plain build."""

import shutil
import subprocess
from pathlib import Path

import control as ct
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.codegen import find_compiler
from tests.cpu_budget import release_but

# The warnings and the arithmetic that each project's own build asks for, as far as they concern C.
PROJECTS = {
    "PX4": "-Wall -Wextra -Werror -Warray-bounds -Wcast-align -Wdisabled-optimization -Wdouble-promotion -Wfloat-equal "
    "-Wformat-security -Winit-self -Wlogical-op -Wpointer-arith -Wshadow -Wuninitialized -Wunknown-pragmas "
    "-Wunused-variable -Wno-missing-field-initializers -Wno-unused-parameter -Wbad-function-cast -Wnested-externs "
    "-Wstrict-prototypes -funsafe-math-optimizations -fno-math-errno -fno-strict-aliasing -fno-common",
    "ArduPilot": "-Wall -Wextra -Werror -Wcast-align -Wundef -Wpointer-arith -Wfloat-equal -Wformat=2 "
    "-Wstrict-prototypes -Wmissing-prototypes -fsingle-precision-constant -fno-strict-aliasing",
    "Crazyflie": "-std=gnu11 -Wall -Wmissing-braces -Werror -Wdouble-promotion -fno-strict-aliasing",
    "Zephyr": "-Wall -Wextra -Werror -Wdouble-promotion -Wundef -Wpointer-arith -Wexpansion-to-defined "
    "-Wno-unused-parameter -Wno-sign-compare -fno-common -ffreestanding -fno-strict-aliasing",
    "AUTOSAR-like": "-std=c99 -Wall -Wextra -Wpedantic -Werror -Wshadow -Wcast-qual -Wconversion -Wdouble-promotion "
    "-Wundef -Wmissing-prototypes -Wswitch-default",
}
CORTEX = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]


def height_loop() -> ct.InputOutputSystem:
    """A drone's height: plant with drag, PI law at 50 Hz, filter at 500 Hz."""
    drag = pf.plant(
        lambda t, x, u, p: {"v": (u.thrust - p.drag * x.v * (x.v**2 + 1.0) ** 0.5) / p.mass},
        states={"v": (0.0, "m/s")}, inputs={"thrust": (0.0, "N")},
        params={"drag": (0.3, "kg/m"), "mass": (1.2, "kg")}, name="plant",
    )  # fmt: skip
    law = ct.ss(
        [1.0], [[0.02, -0.02]], [3.0], [[4.0, -4.0]], dt=0.02, inputs=["goal", "v"], outputs=["u"], name="law"
    )
    observer = pf.PhyFilter.from_poles([-9.0, -6.0 + 6.0j, -6.0 - 6.0j]).sampled(0.002)
    return ct.interconnect(
        [drag, pf.sampled_block(law, name="law"), pf.sampled_block(observer, channels=1, name="observer")],
        connections=[
            ["plant.thrust", "law.u"], ["law.v", "plant.v"], ["observer.x[0]", "plant.v"],
            ["observer.g[0]", "law.u"],
        ],
        inplist=["law.goal", "observer.f_theta[0]"], inputs=["goal", "f_theta"],
        outlist=["plant.v", "observer.f_hat[0]"], outputs=["v", "f_hat"], name="loop",
    )  # fmt: skip


@pytest.fixture(scope="module", params=release_but(["float"], ["double", "float"]))
def folder(request, tmp_path_factory) -> Path:
    return pf.export_c(height_loop(), tmp_path_factory.mktemp(request.param) / "code", real=request.param)


def built(folder: Path, program: Path, flags: list[str]) -> str:
    """What the example prints that comes with the export."""
    sources = sorted(str(path) for path in folder.glob("*.c"))
    command = [*find_compiler().command, "-O2", *flags, *sources, "-lm", "-o", str(program)]
    build = subprocess.run(command, capture_output=True, text=True, check=False)
    assert build.returncode == 0, build.stderr[:3000]
    return subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("project", PROJECTS)
def test_no_warning_and_the_same_numbers(folder, project, tmp_path):
    if "gcc" not in find_compiler().version.lower() and "cc" not in find_compiler().command[-1]:
        pytest.skip("the flags are gcc's")
    flags = [flag for flag in PROJECTS[project].split() if flag != "-ffreestanding"]
    main = (folder / "main.c").read_text().replace("%.9g", "%a")  # to the last bit
    main = main.replace("int main(void)", "int main(void);\nint main(void)")
    main = main.replace(
        "  const long steps", "  u[0] = (pf_real)0.75;\n  u[1] = (pf_real)0.125;\n  const long steps"
    )
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    (copy / "main.c").write_text(main)
    plain = built(copy, tmp_path / "plain", ["-std=c99"])
    assert abs(float.fromhex(plain.split()[-1])) > 0.01, "nothing moves"
    assert built(copy, tmp_path / "flags", flags) == plain


@pytest.mark.parametrize("project", PROJECTS)
def test_no_warning_on_a_cortex(folder, project):
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is not installed")
    for path in sorted(folder.glob("*.c")):
        if path.name != "main.c":
            command = [
                compiler,
                *CORTEX,
                "-O2",
                *PROJECTS[project].split(),
                "-c",
                str(path),
                "-o",
                "/dev/null",
            ]
            build = subprocess.run(command, capture_output=True, text=True, check=False)
            assert build.returncode == 0, build.stderr[:3000]


@pytest.mark.slow
def test_several_exports_fit_into_one_image(tmp_path):
    """Two filters and a diagram each in double and float, C and C++: every symbol is called after its model."""
    filter_ = pf.PhyFilter.from_poles([-9.0, -6.0])
    lag = ct.ss([-1.0], [1.0], [1.0], [0.0], name="lag")
    names = ["slow", "fast", "lag_d", "lag_f"]
    for name, system in zip(names, [filter_.sampled(0.01), filter_.sampled(0.002), lag, lag], strict=True):
        pf.export_c(system, tmp_path / name, real="float" if name.endswith("f") else "double", name=name)
        (tmp_path / name / "main.c").unlink()
    flags = ["-std=c99", "-O1", "-c"]
    for name in names:
        for path in (tmp_path / name).glob("*.c"):
            command = [
                *find_compiler().command,
                *flags,
                str(path),
                "-o",
                str(tmp_path / f"{name}_{path.stem}.o"),
            ]
            subprocess.run(command, check=True)
    main = "".join(f'#include "{name}/{name}.h"\n' for name in names[:3])
    main += "int main(void) { static lag_d self; return lag_d_init(&self) + !pf_filter_message(0); }\n"
    (tmp_path / "main.cpp").write_text(main)
    objects = [str(path) for path in tmp_path.glob("*.o")]
    program = str(tmp_path / "program")
    subprocess.run(
        [*find_compiler().command, "-x", "c++", "-c", str(tmp_path / "main.cpp"), "-o", program + ".o"],
        check=True,
    )
    subprocess.run([*find_compiler().command, *objects, program + ".o", "-o", program], check=True)
    subprocess.run([program], check=True)
    (tmp_path / "both.c").write_text('#include "lag_d/lag_d.h"\n#include "lag_f/lag_f.h"\n')
    both = subprocess.run(
        [*find_compiler().command, *flags, str(tmp_path / "both.c"), "-o", program + ".o"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "lag_f_needs_pf_real_to_be_float" in both.stderr
