"""A day of firmware on emulated cores: the filter behind its guard at 500 Hz, a fault every 20 s, the host's bits.

What ``export_target`` packs (filter, guard, runtime) is compiled for a Cortex-M7 and a Cortex-M4F and run by
qemu-system-arm beside an undisturbed twin for 43.2 million steps. Faults in turn: samples that are not finite, a stuck
and a spiking sensor, time stamps that jump ahead and back, missed ticks, other poles, poles that are damaged on their
way, a bit that flips in the states, one in the coefficients. A line an hour has the CRC-32 of every f_hat; all of
it must be the host's. Then, in a short run with one tick of virtual time per instruction: most instructions of a step
by kind, and bytes of stack.

    python benchmarks/firmware_day.py [--steps 43200000] [--cores m7 m4f] [--orders 3 6] [--real float] [--quick]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from cortex import BOARDS, INSTRUCTIONS_PER_TICK, Board, build, missing, run, versions

from phyfilter_ctl import PhyFilter, export_target

DAY = 43_200_000
COUNTED = 120_000  # steps: every kind of fault once
PERIOD = 0.002
COLUMNS = (
    "step",
    "CRC-32",
    "faults",
    "wrong",
    "off (1e-6)",
    "missed",
    "bad",
    "jumps",
    "refused",
    "implausible",
)
# Of forces up to 2 N, in float: the rounding of a velocity of 4 m/s over 2 ms is 1.2e-4 N, before the filter.
SETTLED = {"float": 5000, "double": 5}  # millionths


def poles(order: int, speed: float) -> list[complex]:
    """Pairs on a circle, one real for an odd order; conjugates in a row."""
    pairs = [complex(speed * np.exp(1j * angle)) for angle in np.linspace(2.2, 2.8, order // 2)]
    return [
        *([complex(-speed)] if order % 2 else []),
        *(p for pole in pairs for p in (pole, pole.conjugate())),
    ]


def braces(values: list[complex]) -> str:
    return "{" + ", ".join(f"{{{value.real!r}, {value.imag!r}}}" for value in values) + "}"


def write(order: int, real: str, steps: int, folder: Path, **more: str) -> Path:
    """The package and day.c, which is told how many steps, which poles, and what else it lets one define."""
    filter_ = PhyFilter.from_poles(poles(order, 12.0)).sampled(PERIOD)
    precision = "float" if real == "float" else "double"
    package = export_target(filter_, "cmake", folder / "package", real=precision, channels=3, name="wing")
    work = folder / f"{steps}"
    work.mkdir()
    day = (Path(__file__).parent / "cortex" / "day.c").read_text()
    given = {"STEPS": f"{steps}u", "POLES": braces(poles(order, 12.0)), "TUNING": braces(poles(order, 25.0))}
    defines = "".join(f"#define {name} {value}\n" for name, value in (given | more).items())
    (work / "day.c").write_text(defines + day)
    for path in (package / "src").iterdir():
        (work / path.name).write_text(path.read_text())
    return work


def prepare(board: Board, order: int, real: str, steps: int, folder: Path) -> None:
    work = write(order, real, steps, folder)
    build(board, (*(path.name for path in sorted(work.glob("*.c")) if path.name != "day.c"), "day.c"), work)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=DAY)
    parser.add_argument("--cores", nargs="+", choices=tuple(BOARDS), default=list(BOARDS))
    parser.add_argument("--orders", nargs="+", type=int, default=[3])
    parser.add_argument("--real", nargs="+", choices=("float", "double"), default=["float"])
    parser.add_argument("--quick", action="store_true", help="4 minutes of flight on the Cortex-M4F")
    options = parser.parse_args()
    if options.quick:
        options.steps, options.cores = COUNTED, ["m4f"]
    if (program := missing()) is not None:
        print(f"skipped: {program} not found")
        return 0
    print(versions())
    failures: list[str] = []
    for core in options.cores:
        for order in options.orders:
            for real in options.real:
                failures += day(BOARDS[core], order, real, options.steps)
    good = "every f_hat is the host's, what the guard can see was said, every fault was forgotten"
    print("\n".join(failures) if failures else good)
    return int(bool(failures))


def day(board: Board, order: int, real: str, steps: int) -> list[str]:
    """Runs and prints one filter on one core; what is not as it should be."""
    title = f"{board.name}, order {order}, {real}"
    failures = []
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent)
        prepare(board, order, real, steps, folder)
        work = folder / f"{steps}"
        host = run((str(work / "host"),), work, timeout=36_000).splitlines()
        emulated = run((*board.emulator(counted=False), "board.elf"), work, timeout=36_000).splitlines()
        print(f"\n{title}: {steps:,} steps, {steps * PERIOD / 3600:.2f} h")
        print("".join(f"{name:>12}" for name in COLUMNS))
        for line in host[-3:]:
            print("".join(f"{word:>12}" for word in line.split()))
        if emulated[: len(host)] != host:
            failures.append(f"{title}: other numbers than on the host")
        last = dict(zip(COLUMNS, map(int, host[-1].split()), strict=True))
        if last["wrong"]:
            failures.append(f"{title}: {last['wrong']} statuses or numbers are wrong")
        if last["off (1e-6)"] > SETTLED[real]:
            failures.append(f"{title}: {last['off (1e-6)']} millionths off after settling")
        if steps != COUNTED:
            prepare(board, order, real, COUNTED, folder)
        counted = folder / f"{COUNTED}"
        answer = run((*board.emulator(counted=True), "board.elf"), counted).splitlines()[-1].split()
        nominal, longer, restarted, tuned, checked, stack, size = map(int, answer)
        most = [INSTRUCTIONS_PER_TICK * ticks for ticks in (nominal, longer, restarted, tuned, checked)]
        print(
            "most instructions: step {}, after missing samples {}, restart {}, with other poles {}, check {}; ".format(
                *most
            )
            + f"stack {stack} bytes with the main loop's, state {size} bytes"
        )
    return failures


if __name__ == "__main__":
    sys.exit(main())
