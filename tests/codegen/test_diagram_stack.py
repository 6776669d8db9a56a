"""The bytes of stack that a diagram's header states, against what a compiler says of every function on the way."""

import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import control as ct
import pytest
from flat_models import two_rates
from test_diagram_run import filtered
from test_diagram_step import servo

import phyfilter_ctl as pf
from phyfilter_ctl.codegen.diagram_source import diagram_model
from phyfilter_ctl.diagram import flatten

CORTEX = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-std=c99"]
# What pf_run.c calls through the model's table.
TABLE = (
    "derivatives",
    "outputs",
    "next_instant",
    "sample",
    "accepted",
    "conditions",
    "event_reset",
    "states",
    "inputs",
)
# How far a bound for every diagram may lie above one compiler's frames of one of them.
LOOSE = 2.5


@dataclass
class Frames:
    """Bytes of each function's own, and whom it calls: gcc's -fcallgraph-info=su."""

    own: dict[str, int] = field(default_factory=dict)
    calls: dict[str, set[str]] = field(default_factory=dict)

    def add(self, text: str) -> None:
        for title, label in re.findall(r'node: \{ title: "([^"]*)" label: "([^"]*)"', text):
            size = re.search(r"\\n(\d+) bytes \((static|dynamic,bounded)\)", label)
            assert size or "bytes" not in label, label
            if size:
                self.own[title] = int(size.group(1))
        for caller, called in re.findall(r'edge: \{ sourcename: "([^"]*)" targetname: "([^"]*)"', text):
            self.calls.setdefault(caller, set()).add(called)

    def deepest(self, function: str, above: tuple[str, ...] = ()) -> int:
        assert function not in above, f"{function} calls itself"
        below = [self.deepest(called, (*above, function)) for called in self.calls.get(function, ())]
        return self.own.get(function, 0) + max(below, default=0)


def ball():
    fall = ct.nlsys(
        lambda t, x, u, p: [x[1], -9.81], None, inputs=0, outputs=["z", "v"], states=["z", "v"], name="ball"
    )  # fmt: skip
    hit = pf.event(
        lambda t, x, u, p: x[0], lambda t, x, u, p: [0.0, -0.8 * x[1]], direction="falling", name="hit"
    )
    return pf.hybrid(fall, [hit])


def late():
    sampled = pf.PhyFilter.from_poles([-20.0] * 3).sampled(0.002, delay=0.0031)
    return filtered(sampled, 3, "full")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "options"),
    [
        (lambda: flatten(servo()), {"real": "float", "tunable": False}),
        (lambda: flatten(servo()), {"real": "double"}),
        (lambda: two_rates(), {"step": 0.0013}),
        (late, {"real": "float"}),
        (lambda: flatten(ball()), {}),
    ],
    ids=["float", "double", "instants between calls", "delay", "events"],
)
def test_a_step_takes_no_more_stack_than_its_header_says(make, options, tmp_path: Path):
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is not installed")
    model = diagram_model(make(), derivatives=False, **options)
    for name, text in model.sources.items():
        (tmp_path / name).write_text(text)
    stated = f'#include "{model.name}.h"\nchar stated[{model.name.upper()}_STACK_BYTES];\n'
    (tmp_path / "stated.c").write_text(stated)
    for level in ("-O2", "-Os"):
        files = [*(name for name in model.sources if name.endswith(".c")), "stated.c"]
        subprocess.run(
            [compiler, *CORTEX, level, "-fcallgraph-info=su", "-c", *files], cwd=tmp_path, check=True
        )
        frames = Frames()
        for path in tmp_path.glob("*.ci"):
            frames.add(path.read_text())
        listed = subprocess.run(
            ["arm-none-eabi-nm", "-S", "stated.o"], cwd=tmp_path, check=True, capture_output=True, text=True
        )
        frames.calls["__indirect_call"] = {
            title
            for title in frames.own
            if title.startswith(f"{model.name}.c:") and title.split(":")[-1] in TABLE
        }
        bound, measured = int(listed.stdout.split()[1], 16), frames.deepest(f"{model.name}_step")
        assert measured <= bound < LOOSE * measured, (level, measured, bound)
