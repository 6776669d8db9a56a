"""Emulated Cortex-M boards: how C is compiled for them and run, by Debian's gcc-arm-none-eabi and qemu-system-arm."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "BOARDS",
    "DOUBLE_ADD",
    "FLAGS",
    "HOST",
    "INSTRUCTIONS_PER_TICK",
    "SMALL",
    "Board",
    "board_files",
    "build",
    "missing",
    "run",
    "versions",
]

HOST = ("cc",)
FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffunction-sections")
INSTRUCTIONS_PER_TICK = 40  # SysTick runs at 25 MHz; with -icount shift=0 an instruction takes 1 ns
_LINKING = ("-nostartfiles", "-Wl,--gc-sections", "-T", "board.ld", "board.c", "-lc", "-lgcc")
# What a core without double precision adds doubles with: libgcc's sums are not always the nearest, see the file.
DOUBLE_ADD = "double_add.c"
_SUMS = (DOUBLE_ADD, "-Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub")
_COMPILER, _EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Board:
    """A core, and the machine of the emulator that has it."""

    name: str
    machine: str
    flags: tuple[str, ...]

    @property
    def linking(self) -> tuple[str, ...]:
        """Arguments after the files of a program."""
        return _LINKING if self.flags[1] in ("-mfpu=fpv5-d16", "-mfloat-abi=soft") else (*_SUMS, *_LINKING)

    @property
    def compiler(self) -> tuple[str, ...]:
        return (_COMPILER, *self.flags, "-mthumb")

    def emulator(self, *, counted: bool) -> tuple[str, ...]:
        """Command before the image; counted: one tick of virtual time per instruction."""
        clock = ("-icount", "shift=0") if counted else ()
        return (_EMULATOR, "-M", self.machine, "-nographic", "-semihosting", *clock, "-kernel")


BOARDS = {
    "m7": Board("Cortex-M7", "mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16", "-mfloat-abi=hard")),
    "m4f": Board("Cortex-M4F", "mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard")),
}

# No floating point; 16 kB of memory. An instruction of a Cortex-M0+ is one of a Cortex-M0.
SMALL = Board(
    "Cortex-M0+",
    "microbit",
    ("-mcpu=cortex-m0plus", "-mfloat-abi=soft", "-DSTACK_TOP=0x20004000u", "-DSTACK_BYTES=0x1800u"),
)


def missing() -> str | None:
    """The first program that is not there."""
    return next((name for name in (_COMPILER, _EMULATOR, *HOST) if shutil.which(name) is None), None)


def versions() -> str:
    compiler, emulator = (
        run((name, "--version"), Path.cwd()).splitlines()[0] for name in (_COMPILER, _EMULATOR)
    )
    return f"{compiler}, {' '.join(FLAGS[:2])}\n{emulator}"


def run(command: tuple[str, ...], folder: Path, timeout: float = 300.0) -> str:
    """What a command prints; ends the benchmark where it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=timeout)
    if done.returncode:
        raise SystemExit(f"{' '.join(command[:4])} ... failed:\n{done.stdout[-500:]}{done.stderr[:3000]}")
    return done.stdout or done.stderr  # qemu writes what the board says to standard error


def board_files(folder: Path) -> None:
    """What a program for the boards includes and is linked with, into the folder."""
    for name in ("board.c", "board.ld", "console.h", DOUBLE_ADD):
        shutil.copy(_HERE / name, folder)


def build(board: Board, files: tuple[str, ...], folder: Path, flags: tuple[str, ...] = FLAGS) -> None:
    """board.elf and host, from files of the folder."""
    board_files(folder)
    run((*board.compiler, *flags, *files, *board.linking, "-o", "board.elf"), folder)
    run((*HOST, *FLAGS, *files, "-o", "host"), folder)
