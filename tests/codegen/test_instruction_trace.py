"""The trace of an emulated Cortex-M7 counts a function that was written instruction by instruction."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAIN = """\
#include "console.h"
__attribute__((naked, noinline)) void measured(void) {
  __asm__ volatile("movs r0, #1\\n ldr r1, [sp]\\n push {r4, r5}\\n vmov s0, r0\\n vadd.f32 s0, s0, s0\\n"
                   "vdiv.f32 s1, s0, s0\\n pop {r4, r5}\\n bics r0, r0\\n bx lr");
}
__attribute__((noinline)) void other(int n) {
  for (volatile int i = 0; i < n; i++) {}
}
int main(void) {
  for (int i = 0; i < 3; i++) measured(), other(i);
  put_text("done\\n");
  return 0;
}
"""


@pytest.mark.slow
def test_every_instruction_of_every_call_is_counted(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import cortex
    from cortex import trace

    if (program := cortex.missing()) is not None:
        pytest.skip(f"{program} is not installed")
    board = cortex.BOARDS["m7"]
    cortex.board_files(tmp_path)
    (tmp_path / "main.c").write_text(MAIN)
    cortex.run((*board.compiler, "-O1", "main.c", *board.linking, "-o", "board.elf"), tmp_path)
    said, found = trace.calls(board, tmp_path, ("measured",))
    assert said == "done\n"
    instructions = {
        "integer": 2, "load": 3, "store": 2, "move to or from the FPU": 1, "single": 1, "single divide": 1, "branch": 1,
    }  # fmt: skip
    assert [(count, dict(+classes)) for count, classes in found] == [(9, instructions)] * 3
    # Two a cycle; each by itself, as cortex/trace.py has the latencies, and one branch predicted wrongly.
    assert trace.cycles(*found[0]) == (5, 2 * 2 + 3 * 3 + 2 * 2 + 3 + 3 + 16 + 2 + 6)
