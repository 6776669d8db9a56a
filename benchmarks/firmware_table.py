"""What the exported filter costs on a Cortex-M: flash, memory, stack, the most instructions of a call; cycles on paper.

Filter and guard as ``export_target`` packs them, three channels, orders 1 to 6, float and double, on emulated
Cortex-M4F and M7 cores: every call of a schedule with each kind of fault is traced instruction by instruction
(cortex/trace.py), so that the figures are the most of all calls and not a mean; the hash of every f_hat is compared
with the host's. Then order 3 in float at -Os with the flags of five projects, and the filter alone beside others of the
same transfer function: a direct form by hand, CMSIS-DSP's biquads and CasADi's C, with their errors in float. Last,
cycles on a Cortex-M7 at 216 MHz (STM32F765) from the classes of the instructions.

    python benchmarks/firmware_table.py [--quick] [--cmsis FOLDER]

FOLDER has the sources of CMSIS-DSP (Include, PrivateInclude, Source), as ``pip download --no-deps cmsisdsp`` brings
them; without it they are left out.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from cortex import BOARDS, FLAGS, HOST, Board, board_files, missing, run, versions
from cortex.rivals import TESTED_H, casadi_source, cmsis_source, direct_form
from cortex.trace import calls, cycles
from firmware_day import PERIOD, poles

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from phyfilter_ctl import PhyFilter, SampledPhyFilter, export_c, export_target
from phyfilter_ctl.codegen.filter_guard import guard_costs
from tests.codegen.test_firmware_builds import PROJECTS

MHZ = 216.0  # STM32F765
HEADROOM = 1.05  # of other versions of gcc, over what headers state
SCHEDULE = "snnnnblnngnnjnnunnnc"  # see cortex/steps.c
PLAIN = "snnnnnnnn"
# Objects of the test itself and of the board: not part of what a product has to store.
OWN = ("steps.o", "board.o", "tested.o")
GUARDED_C = """\
#include "tested.h"
#include "wing_guard.h"
static wing_guard self;
int begin(void) { return wing_guard_init(&self, &wing_parameters); }
void step(uint64_t now, const real *x, const real *g, const real *f_theta, real *f_hat) {
  wing_guard_step(&self, now, x, g, f_theta, NULL, f_hat);
}
void tune(void) {
  static const double poles[wing_ORDER][2] = POLES;
  wing_tuning tuning;
  memset(&tuning, 0, sizeof tuning);
  memcpy(tuning.poles[0], poles, sizeof poles);
  tuning.b[0][0] = B0;
  wing_guard_seal(&tuning);
  wing_guard_send(&self, &tuning);
}
void check(void) { wing_guard_check(&self); }
size_t state_bytes(void) { return sizeof self; }
"""
ALONE_C = """\
#include "tested.h"
#include "wing.h"
static wing self;
int begin(void) { return wing_init(&self, &wing_parameters); }
void step(uint64_t now, const real *x, const real *g, const real *f_theta, real *f_hat) {
  (void)now;
  wing_step(&self, x, g, f_theta, NULL, f_hat);
}
void tune(void) {}
void check(void) {}
size_t state_bytes(void) { return sizeof self; }
"""
# On the host: 400 s beside the filter in double.
DRIFT_C = """\
#include "tested.h"
#include <stdio.h>
#include "truth.h"
int main(void) {
  static truth other;
  static real x[3], g[3], f_theta[3], f_hat[3];
  double X[3], G[3], F[3], exact[3], worst = 0.0;
  uint32_t seed = 1;
  if (begin() || truth_init(&other, &truth_parameters)) return 1;
  for (uint32_t k = 0; k < 200000u; k++) {
    for (int i = 0; i < 3; i++) {
      seed = seed * 1664525u + 1013904223u;
      g[i] = (real)((int32_t)(seed >> 8) - 8388608) * (real)(1.0 / 8388608.0) - x[i] * (real)0.5;
      x[i] += (real)0.002 * ((real)((k / 2000u + (uint32_t)i) % 5u) - (real)2 + g[i]);
      X[i] = (double)x[i], G[i] = (double)g[i], F[i] = (double)f_theta[i];
    }
    step(2000u * k, x, g, f_theta, f_hat);
    truth_step(&other, X, G, F, NULL, exact);
    for (int i = 0; i < 3; i++) {
      const double off = (double)f_hat[i] - exact[i];
      if (!(off <= worst && -off <= worst)) worst = off < 0 ? -off : off;
    }
  }
  printf("%.1e\\n", worst);
  return 0;
}
"""


@dataclass(frozen=True)
class Row:
    """One image: bytes of flash, state and stack, whether the host's bits came out, and every call in its order."""

    flash: int
    state: int
    stack: int
    same: bool
    calls: list[tuple[str, int, Counter[str]]]

    def most(self, kinds: str) -> int:
        return max(count for kind, count, _ in self.calls if kind in kinds)


def measure(
    board: Board, folder: Path, schedule: str, flags: tuple[str, ...], include: tuple[str, ...] = ()
) -> Row:
    """Builds what stands in the folder (tested.h, tested.c and what they need), traces it, compares with the host."""
    board_files(folder)
    (folder / "steps.c").write_text((Path(__file__).parent / "cortex" / "steps.c").read_text())
    files = sorted(
        path.name for path in folder.glob("*.c") if path.name not in ("board.c", "double_add.c", "drift.c")
    )
    library = [name for name in files if name.replace(".c", ".o") not in OWN]
    own = [name for name in files if name.replace(".c", ".o") in OWN]
    sections = "-ffunction-sections"
    for names, given in ((library, flags), (own, ("-std=c99", "-O2", "-w"))):
        if names:
            run((*board.compiler, *given, sections, *include, "-c", *names), folder)
    linking = [argument for argument in board.linking if argument != "board.c"]
    run((*board.compiler, "-std=c99", "-O2", "-c", "board.c"), folder)
    objects = sorted({name.replace(".c", ".o") for name in files} | {"board.o"})
    run((*board.compiler, "-O2", *objects, *linking, "-Wl,-Map,board.map", "-o", "board.elf"), folder)
    run((*HOST, "-std=c99", "-O2", "-w", *include, *files, "-lm", "-o", "host"), folder)
    answer, found = calls(board, folder, ("measured", "measured_check"))
    if len(found) != len(schedule):
        raise SystemExit(f"{len(found)} calls traced, expected {len(schedule)}")
    linked = re.findall(
        r"^ \.(?:text|rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+) (\S+)$",
        (folder / "board.map").read_text(),
        re.MULTILINE,
    )
    flash = sum(int(size, 16) for size, file in linked if Path(file).name not in OWN)
    hashed, stack, state = answer.split()
    same = run((str(folder / "host"),), folder).split()[0] == hashed
    return Row(
        flash, int(state), int(stack), same, [(kind, *one) for kind, one in zip(schedule, found, strict=True)]
    )


def sampled(order: int, speed: float = 12.0) -> SampledPhyFilter:
    return PhyFilter.from_poles(poles(order, speed)).sampled(PERIOD)


def guarded(order: int, real: str, folder: Path) -> None:
    """Filter and guard as packed, and what steps.c calls of them."""
    package = export_target(
        sampled(order),
        "cmake",
        folder / "package",
        real="float" if real == "float" else "double",
        channels=3,
        name="wing",
    )
    for path in (package / "src").iterdir():
        (folder / path.name).write_text(path.read_text())
    fast = PhyFilter.from_poles(poles(order, 25.0))
    rows = ", ".join(f"{{{pole.real!r}, {pole.imag!r}}}" for pole in poles(order, 25.0))
    defines = f"#define POLES {{{rows}}}\n#define B0 {float(fast.a[0])!r}\n"
    (folder / "tested.h").write_text(TESTED_H.format(real=real, schedule=SCHEDULE))
    (folder / "tested.c").write_text(defines + GUARDED_C)


def show(title: str, row: Row) -> None:
    print(
        f"{title:<34}{row.flash:>8}{row.state:>7}{row.stack:>7}{row.most('n'):>8}{row.most('sbj'):>9}{row.most('lg'):>9}"
        f"{row.most('u'):>9}{row.most('c'):>9}  {'yes' if row.same else 'NO'}",
        flush=True,
    )


def beyond(title: str, row: Row, stated: tuple[int, int, int] | None) -> list[str]:
    """Steps that take more than the header of a package says."""
    found = (row.most("n"), row.most("lg"), row.most("u"))
    return [
        f"{title}: {count:,} instructions, stated {most:,}"
        for count, most in zip(found, stated or (), strict=False)
        if count > HEADROOM * most
    ]


def rivals(order: int, board: Board, parent: Path, cmsis: Path | None) -> list[tuple[str, Row, str]]:
    """The filter alone and the others: image and error in float."""
    found = []
    filter_ = sampled(order)
    names = ["phyfilter", "direct form by hand", "CasADi's C", *(["CMSIS-DSP biquads"] if cmsis else [])]
    for number, name in enumerate(names):
        folder = parent / f"{board.machine}_{order}_{number}"
        folder.mkdir()
        flags, include = ("-std=c99", "-O2", "-w"), ()
        (folder / "tested.h").write_text(TESTED_H.format(real="float", schedule=PLAIN))
        if number == 0:
            package = export_c(
                filter_,
                folder / "package",
                real="float",
                channels=3,
                name="wing",
                tunable=False,
                variable=False,
            )
            for path in package.iterdir():
                if path.name != "main.c":
                    (folder / path.name).write_text(path.read_text())
            text = ALONE_C
        elif number == 1:
            text = direct_form(filter_)
        elif number == 2:
            text = casadi_source(filter_, folder)
        else:
            assert cmsis is not None
            include = (f"-I{cmsis}/Include", f"-I{cmsis}/PrivateInclude", "-D__GNUC_PYTHON__")
            for part in ("", "init_"):
                source = f"arm_biquad_cascade_df2T_{part}f32.c"
                (folder / source).write_text((cmsis / "Source" / "FilteringFunctions" / source).read_text())
            text = cmsis_source(filter_)
        (folder / ("rival.c" if number else "tested.c")).write_text(text)
        row = measure(board, folder, PLAIN, flags, include)
        found.append((name, row, drift(folder, filter_, include)))
    return found


def drift(folder: Path, filter_: SampledPhyFilter, include: tuple[str, ...]) -> str:
    """Largest error of f_hat over 400 s, beside the exported filter in double."""
    truth = export_c(
        filter_, folder / "truth", real="double", channels=3, name="truth", tunable=False, variable=False
    )
    (truth / "main.c").unlink()
    (folder / "drift.c").write_text(DRIFT_C)
    files = [
        path.name for path in folder.glob("*.c") if path.name not in ("steps.c", "board.c", "double_add.c")
    ]
    exact = [str(path.relative_to(folder)) for path in truth.glob("*.c")]
    run(
        (*HOST, "-std=c99", "-O2", "-w", *include, f"-I{truth}", *files, *exact, "-lm", "-o", "drift"), folder
    )
    return run((str(folder / "drift"),), folder).strip()


def tables(orders: list[int], boards: list[str], cmsis: Path | None, quick: bool) -> list[str]:
    """Prints them; images whose bits are not the host's."""
    failures: list[str] = []
    on_m7: list[tuple[str, Row]] = []
    print(f"\n{'filter and guard, 3 channels':<34}{'flash':>8}{'state':>7}{'stack':>7}{'step':>8}", end="")
    print(f"{'restart':>9}{'late':>9}{'retuned':>9}{'check':>9}  bits as on the host")
    with tempfile.TemporaryDirectory() as parent:
        cases = [
            (board, order, real, "", FLAGS)
            for board in boards
            for order in orders
            for real in ("float", "double")
        ]
        if not quick:
            cores = {"PX4": "m7", "ArduPilot": "m7"}
            cases += [
                (
                    cores.get(project, "m4f"),
                    3,
                    "float",
                    f", {project}, -Os",
                    ("-std=c99", *flags.split(), "-Os"),
                )
                for project, flags in PROJECTS.items()
            ]
        for number, (core, order, real, more, flags) in enumerate(cases):
            folder = Path(parent, str(number))
            folder.mkdir()
            guarded(order, real, folder)
            row = measure(BOARDS[core], folder, SCHEDULE, flags)
            title = f"{BOARDS[core].name}, {order}, {real}{more}"
            show(title, row)
            failures += [] if row.same else [f"{title}: other bits than on the host"]
            if core == "m4f" and not more:
                failures += beyond(title, row, guard_costs(order, real))
            if core == "m7" and not more:
                on_m7.append((f"order {order}, {real}", row))
        print(
            f"\n{'filter alone, 3 channels, float':<44}{'flash':>8}{'state':>7}{'stack':>7}{'step':>8}{'error':>10}"
        )
        for core in boards:
            for order in [n for n in orders if n % 2 == 0]:
                for name, row, error in rivals(order, BOARDS[core], Path(parent), cmsis):
                    title = f"{BOARDS[core].name}, order {order}, {name}"
                    print(
                        f"{title:<44}{row.flash:>8}{row.state:>7}{row.stack:>7}{row.most('n'):>8}{error:>10}",
                        flush=True,
                    )
                    failures += [] if row.same else [f"{title}: other bits than on the host"]
    if cmsis is None:
        print("CMSIS-DSP skipped: no folder given (--cmsis)")
    paper(on_m7)
    return failures


def paper(rows: list[tuple[str, Row]]) -> None:
    """Cycles of a step in time and of the dearest call, as ranges, and their share of the period at MHZ."""
    print(
        f"\n{f'Cortex-M7 at {MHZ:.0f} MHz, on paper':<34}{'step, cycles':>16}{'us':>14}{'% of 2 ms':>14}",
        end="",
    )
    print(f"{'dearest step, us':>20}{'% of 2 ms':>12}{'check, us':>18}")
    for title, row in rows:
        spans = []
        for kinds in ("n", "sblgju", "c"):
            _, count, classes = max(
                (call for call in row.calls if call[0] in kinds), key=lambda call: call[1]
            )
            spans.append(cycles(count, classes))
        (low, high), dear, check = spans
        share = 100.0 / (MHZ * 1e6 * PERIOD)
        print(
            f"{title:<34}{f'{low} to {high}':>16}{f'{low / MHZ:.1f} to {high / MHZ:.1f}':>14}"
            f"{f'{low * share:.2f} to {high * share:.2f}':>14}{f'{dear[0] / MHZ:.0f} to {dear[1] / MHZ:.0f}':>20}"
            f"{f'{dear[0] * share:.0f} to {dear[1] * share:.0f}':>12}"
            f"{f'{check[0] / MHZ:.0f} to {check[1] / MHZ:.0f}':>18}"
        )
    last = next(call for call in rows[-1][1].calls if call[0] == "n")
    print(
        f"classes of a step, {rows[-1][0]}: "
        + ", ".join(f"{count} {name}" for name, count in last[2].most_common())
    )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="order 2 on the Cortex-M7")
    parser.add_argument("--cmsis", type=Path, help="folder with the sources of CMSIS-DSP")
    options = parser.parse_args()
    if (program := missing()) is not None:
        print(f"skipped: {program} not found")
        return 0
    print(versions())
    orders, boards = ([2], ["m7"]) if options.quick else ([1, 2, 3, 4, 5, 6], ["m4f", "m7"])
    failures = tables(orders, boards, options.cmsis and options.cmsis.resolve(), options.quick)
    print("\n".join(failures) if failures else "every image has the host's bits")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
