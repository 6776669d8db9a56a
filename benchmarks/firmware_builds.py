"""Exported C under three compilers and five levels of optimisation: without a warning, and to the same bit.

A filter behind its guard, flown through every fault (cortex/day.c), and a control loop as a diagram, each in float and
in double, are compiled by gcc, clang and arm-none-eabi-gcc (Cortex-M4F) at -O0 to -O3 and -Os with WARNINGS as errors,
then the guarded filter under the flags of PX4, ArduPilot, Crazyflie, Zephyr and an AUTOSAR-like build. Every program is
run, the Cortex's by qemu-system-arm, and prints the CRC-32 of its outputs.

    python benchmarks/firmware_builds.py [--quick]
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from cortex import BOARDS, DOUBLE_ADD, board_files
from firmware_day import write

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import phyfilter_ctl as pf
from tests.codegen.test_firmware_builds import PROJECTS, height_loop

WARNINGS = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wshadow",
    "-Wdouble-promotion",
    "-Wfloat-equal",
    "-Werror",
]
LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")
BOARD = BOARDS["m4f"]
COMPILERS = {"gcc": ("gcc",), "clang": ("clang",), "arm-none-eabi-gcc": BOARD.compiler}
# clang knows no -Wlogical-op and no -fsingle-precision-constant.
UNKNOWN_TO_CLANG = ("-Wno-unknown-warning-option", "-Wno-ignored-optimization-argument")
STEPS = 2_400  # every kind of fault once
DIAGRAM_MAIN = """\
#include "wing.h"
#include "console.h"
#include "pf_crc.h"

int main(void) {
  static wing self;
  uint32_t crc = 0;
  if (wing_init(&self)) return 1;
  for (uint32_t k = 0; k < 2000u; k++) {
    pf_real u[WING_N_U] = {(pf_real)(k / 250u % 4u), (pf_real)0.125}, y[WING_N_Y];
    if (wing_step(&self, u, y)) return 1;
    for (int i = 0; i < WING_N_Y; i++) {
      const double value = (double)y[i];
      crc = pf_crc32_double(crc, &value, 1);
    }
  }
  put_number(crc);
  put_text("\\n");
  return 0;
}
"""


def exports(parent: Path) -> dict[str, Path]:
    """Folders with an export each and the program around it, main.c."""
    folders = {}
    for real in ("float", "double"):
        filter_folder = parent / f"filter_{real}"
        filter_folder.mkdir()
        work = write(3, real, STEPS, filter_folder, EVERY="200u", SETTLED="180u")
        (work / "day.c").rename(work / "main.c")
        folders[f"filter, guard; {real}"] = work
        loop = pf.export_c(height_loop(), parent / f"loop_{real}", real=real, name="wing")
        (loop / "main.c").write_text(DIAGRAM_MAIN)
        folders[f"diagram; {real}"] = loop
    for folder in folders.values():
        board_files(folder)
    return folders


def outcome(compiler: str, flags: list[str], folder: Path) -> str:
    """What the program prints, or the first complaint of the compiler."""
    embedded = compiler == "arm-none-eabi-gcc"
    files = sorted(
        path.name for path in folder.glob("*.c") if path.name not in ("main.c", "board.c", DOUBLE_ADD)
    )
    objects = [file.replace(".c", ".o") for file in files]
    more = UNKNOWN_TO_CLANG if compiler == "clang" else ()
    level = next((flag for flag in flags if flag in LEVELS), "-O2")
    linking = BOARD.linking if embedded else ()
    for command in (
        [*COMPILERS[compiler], *flags, *more, "-c", *files],
        [*COMPILERS[compiler], level, "-std=c99", "main.c", *objects, *linking, "-lm", "-o", "program"],
    ):
        built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if built.returncode:
            return next((line for line in built.stderr.splitlines() if "error" in line), built.stderr[:200])
    command = [*BOARD.emulator(counted=False), "program"] if embedded else [str(folder / "program")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    if done.returncode:
        return f"the program fails: {done.returncode}"
    lines = (done.stdout or done.stderr).splitlines()
    return lines[0] if lines else "the program prints nothing"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="three levels, each compiler with one export")
    quick = parser.parse_args().quick
    programs = {"arm-none-eabi-gcc": ("arm-none-eabi-gcc", "qemu-system-arm")}
    compilers = []
    for compiler in COMPILERS:
        lacking = [name for name in programs.get(compiler, (compiler,)) if shutil.which(name) is None]
        print(f"{compiler} skipped: {lacking[0]} not found") if lacking else compilers.append(compiler)
    failures: list[str] = []
    ran = 0
    with tempfile.TemporaryDirectory() as parent:
        folders = exports(Path(parent))
        names = list(folders)
        levels = ("-O0", "-O2", "-Os") if quick else LEVELS
        flagged = [(level, [*WARNINGS, level], name) for level in levels for name in names]
        if not quick:
            flagged += [(project, ["-O2", *flags.split()], names[0]) for project, flags in PROJECTS.items()]
        bits: dict[str, str] = {}  # of each export, from whoever came first
        print(f"{'':<24}{'':<14}" + "".join(f"{compiler:>20}" for compiler in compilers))
        for row, (title, flags, name) in enumerate(flagged):
            cells = []
            for column, compiler in enumerate(compilers):
                if quick and (row + row // len(names) + column) % len(names):
                    cells.append("")
                    continue
                answer = outcome(compiler, flags, folders[name])
                good = bits.setdefault(name, answer) == answer and answer.split()[0].isdigit()
                cells.append("same bits" if good else "NO")
                ran += 1
                if not good:
                    failures.append(f"{name} {title} {compiler}: {answer}, elsewhere {bits[name]}")
            print(f"{name:<24}{title:<14}" + "".join(f"{cell:>20}" for cell in cells), flush=True)
    print("\n".join(failures) if failures else f"{ran} builds: no warning, the same bits")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
