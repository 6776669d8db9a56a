"""What an image executes: every instruction of every call of a function, their classes, and cycles on a Cortex-M7."""

from __future__ import annotations

import re
from collections import Counter
from itertools import pairwise
from pathlib import Path

from . import Board, run

__all__ = ["LATENCY", "MISPREDICTED", "calls", "cycles"]

# Cycles until the result of an instruction can be used, from the scheduling model of the Cortex-M7 that Arm
# contributed to LLVM (llvm/lib/Target/ARM/ARMScheduleM7.td): an in-order core that issues two instructions a cycle to
# two load pipes, one for stores, two for integers, one for products, one for branches and one for floating point.
# Where the model gives a range, the most: operands of an address are needed a cycle earlier, shifts may take one more.
LATENCY = {
    "integer": 2,
    "multiply": 3,
    "integer divide": 20,  # the model schedules for 7; the time depends on the numbers
    "load": 3,
    "store": 2,
    "branch": 2,
    "move to or from the FPU": 3,
    "single": 3,
    "single multiply-add": 6,
    "single divide": 16,
    "double": 4,
    "double multiply": 7,
    "double multiply-add": 11,
    "double divide": 30,
}
MISPREDICTED = 6  # cycles more, for a branch forwards
_FLOATING = ("move to or from the FPU", "single", "double")
_TRACED = re.compile(r"/([0-9a-f]{8})/[0-9a-f]+/[0-9a-f]+\]")
_DISASSEMBLED = re.compile(r"^\s*([0-9a-f]+):\t[0-9a-f ]+\t(\S+)(?:\t(.*))?$", re.MULTILINE)
_BRANCHES = re.compile(
    r"(b|bl|blx|bx|cbz|cbnz|tbb|tbh|b(eq|ne|cs|cc|hs|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le))(\.[nw])?$"
)


def _classes(mnemonic: str, operands: str) -> Counter[str]:
    """What one instruction asks the core for: a load of three registers is three loads."""
    base, _, kind = mnemonic.partition(".")
    listed = re.search(r"\{(.*?)\}", operands)
    count = 1
    if listed:
        count = 0
        for part in listed[1].split(","):
            ends = [int(end) for end in re.findall(r"[ds](\d+)", part)]
            count += ends[1] - ends[0] + 1 if len(ends) == 2 else 1
    elif base.startswith(("ldrd", "strd")):
        count = 2
    if base.startswith(("vldr", "vldm", "vpop", "ldr", "ldm", "pop")):
        jumps = "pc" in (listed[1] if listed else operands.split(",")[0])
        return Counter({"load": count, "branch": int(jumps)})
    if base.startswith(("vstr", "vstm", "vpush", "str", "stm", "push")):
        return Counter({"store": count})
    if base.startswith("v"):
        if base.startswith(("vmov", "vmrs", "vmsr")):
            return Counter({"move to or from the FPU": 1})
        precision = "double" if "f64" in kind else "single"
        if base.startswith(("vdiv", "vsqrt")):
            return Counter({f"{precision} divide": 1})
        if base.startswith(("vmla", "vmls", "vfma", "vfms", "vnml", "vfnm")):
            return Counter({f"{precision} multiply-add": 1})
        return Counter({"double multiply" if precision == "double" and "mul" in base else precision: 1})
    if _BRANCHES.match(mnemonic):
        return Counter({"branch": 1})
    if base.startswith(("sdiv", "udiv")):
        return Counter({"integer divide": 1})
    if base.startswith(("mul", "mla", "mls", "umull", "smull", "umlal", "smlal", "umaal", "smul", "smla")):
        return Counter({"multiply": 1})
    return Counter({"integer": 1})


def calls(
    board: Board, folder: Path, functions: tuple[str, ...]
) -> tuple[str, list[tuple[int, Counter[str]]]]:
    """What board.elf prints, and of each call of the functions the instructions and their classes.

    The emulator writes down every instruction (-singlestep -d exec); a call ends where the caller goes on.
    """
    listing = run(("arm-none-eabi-objdump", "-d", "board.elf"), folder)
    classes = {
        int(at, 16): _classes(what, operands or "") for at, what, operands in _DISASSEMBLED.findall(listing)
    }
    symbols = [line.split() for line in run(("arm-none-eabi-nm", "board.elf"), folder).splitlines()]
    entries = {int(parts[0], 16) & ~1 for parts in symbols if parts[-1] in functions}
    log = folder / "trace.log"
    answer = run(
        (
            *board.emulator(counted=False)[:-1],
            "-singlestep",
            "-d",
            "exec,nochain",
            "-D",
            log.name,
            "-kernel",
            "board.elf",
        ),
        folder,
    )
    found: list[tuple[int, Counter[str]]] = []
    addresses = sorted(classes)
    following = dict(pairwise(addresses))
    back = before = -1
    inside: list[int] = []
    with log.open() as lines:
        for line in lines:
            traced = _TRACED.search(line)
            if traced is None:
                continue
            at = int(traced[1], 16)
            if back < 0 and at in entries:
                back, inside = following[before], []
            elif at == back:
                total: Counter[str] = Counter()
                for address, times in Counter(inside).items():
                    for name, count in classes[address].items():
                        total[name] += times * count
                found.append((len(inside), total))
                back = -1
            if back >= 0:
                inside.append(at)
            before = at
    log.unlink()
    return answer, found


def cycles(instructions: int, classes: Counter[str]) -> tuple[int, int]:
    """Least and most cycles of a call on a Cortex-M7 whose memory answers at once.

    Least: two instructions a cycle, or what the busiest pipe has to do. Most: each waits for the result of the one
    before it, and every branch was predicted wrongly.
    """
    floating = sum(count for name, count in classes.items() if name.startswith(_FLOATING))
    pipes = (floating, classes["store"], classes["branch"], classes["multiply"], (classes["load"] + 1) // 2)
    most = sum(LATENCY[name] * count for name, count in classes.items()) + MISPREDICTED * classes["branch"]
    return max((instructions + 1) // 2, *pipes), most
