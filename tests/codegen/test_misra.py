"""MISRA C:2012 over the exported C with cppcheck: no required rule is broken but those that docs/targets.md lists."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import phyfilter_ctl as pf
from tests.codegen.test_firmware_builds import height_loop

ROOT = Path(__file__).parents[2]
# All others are required or mandatory.
ADVISORY_RULES = (
    "1.2 2.3 2.4 2.5 2.6 2.7 4.2 5.9 8.7 8.9 8.11 8.13 10.5 11.4 11.5 12.1 12.3 12.4 13.3 13.4 15.1 15.4 15.5 17.5 "
    "17.8 18.4 18.5 19.2 20.1 20.5 20.10 21.12"
)
ADVISORY = set(ADVISORY_RULES.split())
# cppcheck knows no limits of the target's numbers: without them pf_ieee.h stops at its own #error.
COMMAND = [
    "cppcheck",
    "--addon=misra",
    "--std=c99",
    "--quiet",
    "--platform=arm32-wchar_t4",
    "-DDBL_MANT_DIG=53",
]
FILTER = pf.PhyFilter.from_poles([-9.0, -6.0 + 6.0j, -6.0 - 6.0j]).sampled(0.002)


def exported(kind: str, folder: Path) -> Path:
    if kind == "filter and guard":
        return pf.export_target(FILTER, "cmake", folder, real="float", channels=3, name="wing") / "src"
    if kind == "q31":
        ranges = {"x": 10.0, "g": 20.0, "f_theta": 20.0}
        return pf.export_c(FILTER, folder, real="q31", ranges=ranges, channels=3, name="wing")
    return pf.export_c(height_loop(), folder, real="float", name="loop")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["filter and guard", "q31", "diagram"])
def test_required_rules_hold_but_for_the_listed_deviations(kind, tmp_path):
    if shutil.which("cppcheck") is None:
        pytest.skip("cppcheck is not installed")
    code = exported(kind, tmp_path / "code")
    (code / "main.c").unlink(missing_ok=True)  # an example for the desk, not firmware
    done = subprocess.run([*COMMAND, "."], cwd=code, capture_output=True, text=True, check=False)
    if "misra" not in done.stderr:
        pytest.skip("cppcheck without its addon misra")
    assert "preprocessorErrorDirective" not in done.stderr
    broken: dict[str, str] = {}
    for place, rule in re.findall(r"^(\S+?): .*\[misra-c2012-([\d.]+)\]$", done.stderr, re.MULTILINE):
        broken.setdefault(rule, place)
    assert set(broken) & ADVISORY, "the addon found nothing at all"
    listed = set(re.findall(r"^\| (\d+\.\d+) \|", (ROOT / "docs" / "targets.md").read_text(), re.MULTILINE))
    assert not {rule: place for rule, place in broken.items() if rule not in ADVISORY | listed}
