"""Binaries for other machines, made here."""

import re

import pytest
from exported_fmus import FILTER, oscillator

import phyfilter_ctl as pf
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.fmi.build import PLATFORMS, build_binaries, native_platform, platform_names
from phyfilter_ctl.fmi.description import fmu_interface
from phyfilter_ctl.fmi.export import export_fmu
from phyfilter_ctl.fmi.glue import fmu_sources


def test_platforms_are_named():
    with pytest.raises(ValueError, match="x86_64-windows"):
        export_fmu(FILTER, "a.fmu", platforms=("beos",))
    assert native_platform().name in PLATFORMS
    assert platform_names("native") == ("native",)
    folders = {name: platform.folder("2.0") for name, platform in PLATFORMS.items()}
    assert (folders["x86_64-linux"], folders["x86_64-windows"], folders["x86_64-darwin"]) == (
        "linux64",
        "win64",
        "darwin64",
    )


# Windows and macOS take ziglang minutes the first time: .ci and benchmarks/fmu_step.py build all five.
@pytest.mark.parametrize("platform", ["x86_64-linux", "aarch64-linux"])
def test_linux_binaries_need_no_new_c_library(platform):
    pytest.importorskip(
        "ziglang", reason="ziglang is not installed: no binaries for other platforms are built"
    )
    sources = fmu_sources(fmu_interface(diagram_model(pf.flatten(oscillator()), name="swing")), "0")
    built = build_binaries(sources, name="swing", fmi="3.0", platforms=(platform,))
    assert list(built) == [f"binaries/{platform}/swing.so"]
    content = built[f"binaries/{platform}/swing.so"]
    assert content.startswith(b"\x7fELF")
    needed = [tuple(map(int, v.decode().split("."))) for v in re.findall(rb"GLIBC_([0-9.]+)", content)]
    assert max(needed) <= (2, 17)
    assert build_binaries(sources, name="swing", fmi="3.0", platforms=(platform,)) == built
