"""The filter on a core without floating point: 32-bit integers beside software float and double, on a Cortex-M0.

Debian's gcc-arm-none-eabi compiles for a Cortex-M0+ what ``export_c`` writes, coefficients and step fixed, and
qemu-system-arm's microbit (a Cortex-M0: the same instructions) runs 960 steps of 3 channels on one record. Counted are
instructions of a step, mean and most, less those of an empty call; bytes of flash that the filter and what it needs of
libgcc add to a program without it; bytes of state and of stack. The f_hat of the board and of the host are compared by
CRC-32. Last, in m/s^2, the bound of |f_hat - f_hat of exact arithmetic| in integers for all signals within
|x| <= 8 m/s, |g| <= 30 and |f_theta| <= 12 m/s^2; for float and double the spacing of numbers at the largest f_hat.

    python benchmarks/fixed_point.py [--quick]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from cortex import SMALL, build, missing, run, versions

from phyfilter_ctl import FixedPoint, PhyFilter, export_c, fixed_point

Real = Literal["q31", "float", "double"]

DT = 0.002
RANGES = {"x": 8.0, "g": 30.0, "f_theta": 12.0}
ROWS, TIMES = 48, 20
INSTRUCTIONS_PER_TICK = 62.5  # SysTick at 16 MHz; with -icount shift=0 an instruction takes 1 ns
LIMIT = 0.3  # of the instructions of software float

MAIN_C = """\
#include "console.h"

#define STEPS (ROWS * TIMES)
typedef void function(void);

__attribute__((noinline)) static void nothing(void) { __asm__ volatile(""); }

#ifdef EMPTY
#define once nothing
static void prepare(int k) { (void)k; }
static void keep(void) {}
#else
#include "pf_crc.h"
#include "wing.h"
#include "record.h"

static wing filter;
static number x[CHANNELS], g[CHANNELS], f_theta[CHANNELS], f_hat[CHANNELS];
static uint32_t crc;
static int failed;

__attribute__((noinline)) static void once(void) { failed |= STEP; }

static void prepare(int k) {
  memcpy(x, record[k % ROWS], sizeof x);
  memcpy(g, record[k % ROWS] + CHANNELS, sizeof g);
  memcpy(f_theta, record[k % ROWS] + 2 * CHANNELS, sizeof f_theta);
}

static void keep(void) { crc = pf_crc32(f_hat, sizeof f_hat) ^ (crc << 1 | crc >> 31); }
#endif

static uint32_t most;

static uint32_t ticks(function *volatile called) {
  uint32_t sum = 0;
  most = 0;
  for (int k = 0; k < STEPS; k++) {
    prepare(k);
    const uint32_t begin = TICKS;
    called();
    const uint32_t taken = (begin - TICKS) & 0xFFFFFFu;
    sum += taken;
    if (taken > most) most = taken;
    if (called == once) keep();
  }
  return sum;
}

int main(void) {
#ifndef EMPTY
  if (wing_init(&filter, &wing_parameters)) return 1;
#endif
  const uint32_t empty = ticks(nothing), full = ticks(once), longest = most, stack = stack_of(once);
  put_number(full - empty);
  put_number(longest - empty / STEPS);
  put_number(stack);
#ifndef EMPTY
  if (failed) return 1;
  put_number((uint32_t)sizeof(wing));
  put_number(crc);
#endif
  put_text("\\n");
  return 0;
}
"""


@dataclass(frozen=True)
class Row:
    """One filter in one arithmetic."""

    instructions: float
    most: float
    flash: int
    state: int
    stack: int
    same: bool


def record_h(fixed: FixedPoint, real: Real) -> str:
    """The same signals for all three, on the grid of the integers."""
    rng = np.random.default_rng(1)
    ends = [fixed.most(name) for name in RANGES]
    integers = [rng.integers(-end, end + 1, (ROWS, 3)) for end in ends]
    step = "wing_step(&filter, x, g, f_theta, f_hat)"
    if real != "q31":
        integers = [fixed.reals(name, values) for name, values in zip(RANGES, integers, strict=True)]
        step = "wing_step(&filter, x, g, f_theta, 0, f_hat)"
    number = {"q31": "int32_t", "float": "float", "double": "double"}[real]
    suffix = "f" if real == "float" else ""
    rows = ",\n".join(
        "{" + ", ".join(f"{value!r}{suffix}" for value in row.tolist()) + "}" for row in np.hstack(integers)
    )
    return f"""\
typedef {number} number;
#define CHANNELS 3
#define STEP {step}
static const number record[ROWS][9] = {{{rows}}};
"""


def flash(folder: Path) -> int:
    """Bytes of the image."""
    text, data = run(("arm-none-eabi-size", "board.elf"), folder).splitlines()[1].split()[:2]
    return int(text) + int(data)


def counts(folder: Path, *, empty: bool) -> tuple[list[int], list[int], int]:
    """What the board and the host print, and the size of the image."""
    files = () if empty else tuple(path.name for path in sorted(folder.glob("*.c")) if path.name != "main.c")
    defines = f"#define ROWS {ROWS}\n#define TIMES {TIMES}\n" + ("#define EMPTY\n" if empty else "")
    (folder / "main.c").write_text(defines + MAIN_C)
    build(SMALL, (*files, "main.c"), folder)
    board = run((*SMALL.emulator(counted=True), "board.elf"), folder)
    host = run((str(folder / "host"),), folder)
    return [int(word) for word in board.split()], [int(word) for word in host.split()], flash(folder)


def measure(fixed: FixedPoint, real: Real, folder: Path, without: int) -> Row:
    written = export_c(
        fixed.sampled,
        folder / "code",
        real=real,
        ranges=RANGES if real == "q31" else None,
        channels=3,
        name="wing",
        tunable=False,
        variable=False,
    )
    work = folder / "work"
    work.mkdir()
    for path in written.glob("*.[ch]"):
        if path.name != "main.c" and not path.name.endswith("_vectors.h"):
            (work / path.name).write_text(path.read_text())
    (work / "record.h").write_text(record_h(fixed, real))
    board, host, size = counts(work, empty=False)
    full, most, stack, state, crc = board
    table = ROWS * 9 * (8 if real == "double" else 4)
    steps = ROWS * TIMES
    return Row(
        full * INSTRUCTIONS_PER_TICK / steps,
        most * INSTRUCTIONS_PER_TICK,
        size - table - without,
        state,
        stack,
        crc == host[-1],
    )


def filters(orders: tuple[int, ...]) -> list[tuple[str, int, FixedPoint]]:
    found = []
    for n in orders:
        circle = PhyFilter.from_poles(20.0 * np.exp(1j * np.pi * (2 * np.arange(n) + n + 1) / (2 * n)))
        general = PhyFilter(circle.a, circle.a * np.linspace(1.0, 0.5, n), poles=circle.poles)
        for form, filter_ in (
            ("low-pass, real", PhyFilter.from_poles([-20.0] * n)),
            ("general, complex", general),
        ):
            found.append((form, n, fixed_point(filter_.sampled(DT), **RANGES)))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="order 2, without double")
    quick = parser.parse_args().quick
    if (program := missing()) is not None:
        print(f"skipped: {program} not found")
        return 0
    print(f"{versions()}, {SMALL.machine}; 3 channels, {ROWS * TIMES} steps")
    print(
        f"{'form':<18}{'order':>5} {'real':<7}{'instructions':>12}{'most':>8}{'flash':>7}{'state':>6}{'stack':>6}"
        f"{'bound':>10}  bits as on the host"
    )
    failures = []
    with tempfile.TemporaryDirectory() as parent:
        nothing = Path(parent, "nothing")
        nothing.mkdir()
        without = counts(nothing, empty=True)[2]
        for number, (form, n, fixed) in enumerate(filters((2,) if quick else (1, 2, 3, 4, 5, 6))):
            found: dict[str, Row] = {}
            for real in get_args(Real)[: 2 if quick else 3]:
                folder = Path(parent, f"{number}_{real}")
                folder.mkdir()
                found[real] = row = measure(fixed, real, folder, without)
                kind = np.float32 if real == "float" else np.float64
                bound = fixed.error_bound if real == "q31" else float(np.spacing(kind(fixed.ranges["f_hat"])))
                print(
                    f"{form:<18}{n:>5} {real:<7}{row.instructions:>12.0f}{row.most:>8.0f}{row.flash:>7}{row.state:>6}"
                    f"{row.stack:>6}{bound:>10.1e}  {'yes' if row.same else 'NO'}",
                    flush=True,
                )
                if not row.same:
                    failures.append(f"{form} {n} {real}: other bits than on the host")
            if found["q31"].instructions > LIMIT * found["float"].instructions:
                failures.append(f"{form} {n}: q31 takes more than {LIMIT:g} of the instructions of float")
    print(
        "\n".join(failures)
        if failures
        else f"q31 takes at most {LIMIT:g} of float's instructions; all bits equal"
    )
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
