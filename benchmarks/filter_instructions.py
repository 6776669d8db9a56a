"""One step of an exported filter and of an exported diagram: instructions and bytes, and the same bits as here.

Debian's gcc-arm-none-eabi compiles what ``export_c`` writes, qemu-system-arm runs it with one tick of virtual time
per instruction (-icount), and SysTick counts 999 steps; the same loop around an empty function is subtracted. Filters
have 3 channels and run on a Cortex-M7 (mps2-an500). The diagram, a PI law, a filter of order 6 and a plant of two
states, runs on a Cortex-M4F (mps2-an386). The outputs of both machines are compared by CRC-32. Counted are
instructions, not cycles: the M7 issues up to two at once, and its memory decides the rest.

    python benchmarks/filter_instructions.py [--quick]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import control as ct
import numpy as np
from cortex import BOARDS, INSTRUCTIONS_PER_TICK, build, missing, run, versions

from phyfilter_ctl import PhyFilter, SampledPhyFilter, export_c, plant, sampled_block
from phyfilter_ctl.codegen.filter_code import FilterSource, filter_source

BOARD = BOARDS["m7"]
STEPS = 999
DT = 0.002
LIMIT = 600  # instructions of a step of 3 channels, order 6, float, low-pass, fixed coefficients
DIAGRAM_LIMIT, DIAGRAM_STACK = 1000, 600  # of the diagram in float: instructions, bytes of stack with main's

MAIN_C = """\
#include "wing.h"
#include "console.h"
#include "pf_crc.h"

#define STEPS 999
typedef int step_of(wing *, const wing_real *, const wing_real *, const wing_real *, const wing_real *, wing_real *);

static wing filter;
static wing_real x[STEPS + 1][wing_N_X], g[STEPS + 1][wing_N_X], f_theta[STEPS + 1][wing_N_F];
static wing_real f_hat[STEPS + 1][wing_N_F];
static uint32_t seed = 1;
static step_of nothing;
__attribute__((noinline)) static int nothing(wing *self, const wing_real *a, const wing_real *b, const wing_real *c,
                                             const wing_real *d, wing_real *e) {
  (void)self, (void)a, (void)b, (void)c, (void)d, (void)e;
  __asm__ volatile("");
  return 0;
}

static wing_real noise(void) {
  seed = seed * 1664525u + 1013904223u;
  return (wing_real)(int32_t)(seed >> 8) * (wing_real)(1.0 / 8388608.0) - (wing_real)1;
}

static uint32_t ticks_of(step_of *volatile step) {
  const uint32_t begin = TICKS;
  for (int k = 1; k <= STEPS; k++) step(&filter, x[k], g[k - 1], f_theta[k], 0, f_hat[k]);
  return (begin - TICKS) & 0xFFFFFFu;
}

int main(void) {
  uint32_t crc = 0, empty, full;
  for (int k = 0; k <= STEPS; k++) {
    for (int i = 0; i < wing_N_X; i++) {
      x[k][i] = (k ? x[k - 1][i] : (wing_real)0) + (wing_real)0.01 * noise();
      g[k][i] = noise();
    }
    for (int i = 0; i < wing_N_F; i++) f_theta[k][i] = noise();
  }
  if (wing_init(&filter, &wing_parameters)) return 1;
  empty = ticks_of(nothing);
  wing_start(&filter, x[0], 0, f_theta[0], 0, 0);
  full = ticks_of(wing_step);
  for (int k = 1; k <= STEPS; k++)
#if wing_FLOAT
    crc = pf_crc32_float(crc, f_hat[k], wing_N_F);
#else
    crc = pf_crc32_double(crc, f_hat[k], wing_N_F);
#endif
  put_number(full);
  put_number(empty);
  put_number(crc);
  put_number((uint32_t)sizeof(wing));
  put_number((uint32_t)sizeof(wing_params));
  put_text("\\n");
  return 0;
}
"""

DIAGRAM_C = """\
#include "loop.h"
#include "console.h"
#include "pf_crc.h"

#define STEPS 999
typedef int step_of(loop *, const pf_real *, pf_real *);

static loop self;
static pf_real y[STEPS + 1][LOOP_N_Y];
static step_of nothing;
__attribute__((noinline)) static int nothing(loop *s, const pf_real *u, pf_real *out) {
  (void)s, (void)u, (void)out;
  __asm__ volatile("");
  return 0;
}

static uint32_t ticks_of(step_of *volatile step) {
  const pf_real u[LOOP_N_U] = {(pf_real)0.5, (pf_real)0.125};
  const uint32_t begin = TICKS;
  for (int k = 1; k <= STEPS; k++) step(&self, u, y[k]);
  return (begin - TICKS) & 0xFFFFFFu;
}

int main(void) {
  const pf_real u[LOOP_N_U] = {(pf_real)0.5, (pf_real)0.125};
  if (loop_init(&self) || loop_step(&self, u, y[0])) return 1;
  const uint32_t empty = ticks_of(nothing);
  put_number(ticks_of(loop_step) - empty);
  put_number(pf_crc32(y, sizeof y));
  put_number((uint32_t)sizeof(loop));
  put_number((uint32_t)LOOP_STACK_BYTES);
#ifdef __arm__
  put_number(stack_used());
#endif
  put_text("\\n");
  return 0;
}
"""


@dataclass(frozen=True)
class Row:
    """One filter: instructions of a step, bytes of code, memory and parameters, and whether both machines agree."""

    instructions: float
    code: int
    memory: int
    parameters: int
    same: bool


def measure(source: FilterSource, folder: Path) -> Row:
    for file, text in {**source.sources, "main.c": MAIN_C}.items():
        (folder / file).write_text(text)
    build(BOARD, (*(file for file in source.sources if file.endswith(".c")), "main.c"), folder)
    full, empty, crc, memory, parameters = map(
        int, run((*BOARD.emulator(counted=True), "board.elf"), folder).split()
    )
    host_crc = int(run((str(folder / "host"),), folder).split()[2])
    run((*BOARD.compiler, "-std=c99", "-O2", "-ffunction-sections", "-c", "wing.c", "-o", "wing.o"), folder)
    symbols = run(("arm-none-eabi-nm", "-S", "wing.o"), folder).splitlines()
    sizes = {parts[3]: int(parts[1], 16) for line in symbols if len(parts := line.split()) == 4}
    # The step and what it calls; the checks of the parameters, start, shift and retuning are not in it.
    code = sum(
        size for name, size in sizes.items() if name.startswith(("wing_step", "wing_take_", "wing_begin_"))
    )
    return Row((full - empty) * INSTRUCTIONS_PER_TICK / STEPS, code, memory, parameters, crc == host_crc)


def filters(orders: tuple[int, ...]) -> list[tuple[str, int, SampledPhyFilter, bool]]:
    """(form, order, filter, tunable): repeated poles in the low-pass form, Butterworth in the general one, any a, b."""
    found = []
    for n in orders:
        circle = PhyFilter.from_poles(20.0 * np.exp(1j * np.pi * (2 * np.arange(n) + n + 1) / (2 * n)))
        general = PhyFilter(circle.a, circle.a * np.linspace(1.0, 0.5, n), poles=circle.poles)
        found += [
            ("low-pass, real poles", n, PhyFilter.from_poles([-20.0] * n).sampled(DT), False),
            ("general, complex poles", n, general.sampled(DT), False),
            ("tunable", n, general.sampled(DT), True),
        ]
    return found


def diagram() -> ct.InputOutputSystem:
    """A PI law at 500 Hz, a filter of order 6 that takes the drag of a mass on a spring away, and that."""
    mass = plant(
        lambda t, x, u, p: {"q": x.v, "v": (u.force - 0.3 * x.v - 4.0 * x.q) / 1.2},
        states={"q": (0.0, "m"), "v": (0.0, "m/s")}, inputs={"force": (0.0, "N")}, name="mass",
    )  # fmt: skip
    law = ct.ss(
        [1.0], [[0.02, -0.02]], [3.0], [[4.0, -4.0]], dt=DT, inputs=["goal", "q"], outputs=["u"], name="pi"
    )
    observer = PhyFilter.from_poles([-20.0] * 6).sampled(DT)
    return ct.interconnect(
        [mass, sampled_block(law, name="pi"), sampled_block(observer, channels=1, name="observer")],
        connections=[
            ["mass.force", "pi.u", "-observer.f_hat[0]"], ["pi.q", "mass.q"], ["observer.x[0]", "mass.v"],
            ["observer.g[0]", "pi.u"],
        ],
        inplist=["pi.goal", "observer.f_theta[0]"], inputs=["goal", "f_theta"],
        outlist=["mass.q", "observer.f_hat[0]"], outputs=["q", "f_hat"], name="loop",
    )  # fmt: skip


def diagrams(parent: Path, quick: bool) -> list[str]:
    """Prints a line per form of the diagram; what misses its aim."""
    board, failures = BOARDS["m4f"], []
    print(f"\n{board.machine}; PI law, filter of order 6, plant of two states")
    print(
        f"{'real':<8}{'tunable':<9}{'instructions':>12}{'state':>7}{'stack, stated':>15}{'with init, main':>17}  bits"
    )
    forms: list[tuple[Literal["float", "double"], bool]] = [("float", False)]
    for real, tunable in forms if quick else [*forms, ("float", True), ("double", False)]:
        folder = export_c(diagram(), parent / f"{real}_{tunable}", real=real, name="loop", tunable=tunable)
        (folder / "main.c").write_text(DIAGRAM_C)
        build(board, tuple(sorted(path.name for path in folder.glob("*.c"))), folder)
        answer = run((*board.emulator(counted=True), "board.elf"), folder).split()
        ticks, crc, state, stated, used = map(int, answer)
        same = crc == int(run((str(folder / "host"),), folder).split()[1])
        count = ticks * INSTRUCTIONS_PER_TICK / STEPS
        print(
            f"{real:<8}{'yes' if tunable else 'no':<9}{count:>12.0f}{state:>7}{stated:>15}{used:>17}  "
            f"{'as on the host' if same else 'OTHERS'}",
            flush=True,
        )
        if not same:
            failures.append(f"diagram, {real}: other bits than on the host")
        if real == "float" and (count >= DIAGRAM_LIMIT or stated >= DIAGRAM_STACK):
            failures.append(
                f"diagram: expected below {DIAGRAM_LIMIT} instructions and {DIAGRAM_STACK} bytes of stack"
            )
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="orders 2 and 6, diagram: float only")
    quick = parser.parse_args().quick
    if (program := missing()) is not None:
        print(f"skipped: {program} not found")
        return 0
    print(f"{versions()}, {BOARD.machine}; 3 channels")
    print(
        f"{'form':<24}{'real':<8}{'order':>5}{'instructions':>14}{'code':>7}{'RAM':>6}{'constants':>11}"
        "  bits as on the host"
    )
    failures = []
    with tempfile.TemporaryDirectory() as parent:
        for precision in ("float32",) if quick else ("float32", "float64"):
            for number, (form, n, sampled, tunable) in enumerate(
                filters((2, 6) if quick else (1, 2, 3, 4, 5, 6))
            ):
                source = filter_source(
                    sampled.filter.sampled(DT, precision=precision),
                    3,
                    name="wing",
                    variable=tunable,
                    tunable=tunable,
                )
                folder = Path(parent, f"{precision}_{number}")
                folder.mkdir()
                row = measure(source, folder)
                print(
                    f"{form:<24}{source.real:<8}{n:>5}{row.instructions:>14.0f}{row.code:>7}{row.memory:>6}"
                    f"{row.parameters:>11}  {'yes' if row.same else 'NO'}",
                    flush=True,
                )
                if not row.same:
                    failures.append(f"{form} {n} {source.real}: other bits than on the host")
                if source.real == "float" and n == 6 and not tunable and row.instructions >= LIMIT:
                    failures.append(
                        f"{form} {n}: {row.instructions:.0f} instructions, expected below {LIMIT}"
                    )
        failures += diagrams(Path(parent), quick)
    print(
        "\n".join(failures)
        if failures
        else f"order 6, float, fixed coefficients: below {LIMIT}; the diagram in float: below {DIAGRAM_LIMIT}, stack "
        f"below {DIAGRAM_STACK} bytes; all bits equal"
    )
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
