"""The master's loop in C beside the one in Python: call for call the same run."""

import numpy as np
import pytest
from foreign_fmus import oscillator

from phyfilter_ctl.fmi import FmuError, cosimulate
from phyfilter_ctl.fmi.cosimulation_run import Run
from phyfilter_ctl.fmi.master import FastMaster

T = np.linspace(0.0, 2.0, 21)
RING = [
    ("a.place", "b.x"),
    ("b.place", "c.x[0]", "-a.x"),
    ("c.place[0]", "a.x"),
    ("c.place[1]", "b.x"),
]
DRIVEN = [("a.place", "b.x"), ("b.place", "c.x[0]"), ("c.place[0]", "a.x")]


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    return {
        "a": oscillator(folder, name="a"),
        "b": oscillator(folder, name="b"),
        "c": oscillator(folder, "3.0", name="c"),
    }


@pytest.fixture
def both(monkeypatch):
    """A run in C and in Python; whether the first one was in C."""

    def run(parts, wires, **options):
        made = []
        build = FastMaster.over
        monkeypatch.setattr(
            FastMaster, "over", lambda self, *given: (made.append(self), build(self, *given))[1]
        )
        compiled = cosimulate(parts, wires, timepts=T, **options)
        monkeypatch.setattr(Run, "in_c", False)
        plain = cosimulate(parts, wires, timepts=T, **options)
        monkeypatch.undo()
        assert len(made) == 1
        return compiled, plain

    return run


@pytest.mark.parametrize(
    ("wires", "options"),
    [
        (RING, {"step": 0.007}),
        (RING, {"step": 0.007, "scheme": "gauss-seidel", "order": ["c", "a", "b"]}),
        (RING, {"step": 0.007, "threads": 3}),
        (DRIVEN, {"step": 0.02, "inputs": {"c.place[1]": np.sin(3.0 * T)}}),
        (DRIVEN, {"inputs": {"c.place[1]": lambda t: 0.2 * t}}),
        (RING, {"tolerance": 1e-4}),
        (DRIVEN, {"tolerance": 1e-3, "inputs": {"c.place[1]": np.sin(3.0 * T)}, "scheme": "gauss-seidel"}),
    ],
)
def test_the_same_run(parts, both, wires, options):
    compiled, plain = both(parts, wires, parameters={"b.v": 0.2}, **options)
    assert np.array_equal(compiled.outputs, plain.outputs)
    assert (compiled.steps, compiled.rejected) == (plain.steps, plain.rejected)
    if "inputs" in options:
        assert np.array_equal(compiled.inputs, plain.inputs)


def test_functions_of_time_under_step_control_run_in_python(parts, monkeypatch):
    monkeypatch.setattr(FastMaster, "over", None)
    found = cosimulate({"a": parts["a"]}, timepts=[0.0, 0.1], inputs={"a.place": lambda t: t}, tolerance=1e-2)
    assert found.success


@pytest.mark.parametrize("threads", [1, 2])
def test_the_failing_part_is_named(parts, tmp_path, threads):
    broken = oscillator(tmp_path, defines=("FAIL_AT=0.35",))
    wires = [("a.place", "b.x"), ("b.place", "a.x")]
    with pytest.raises(FmuError, match=r"FMU 'b': fmi2DoStep: error: at t = 0.3; .*spring broke at t = 0.3"):
        cosimulate({"a": parts["a"], "b": broken}, wires, timepts=T, threads=threads)


def test_without_a_compiler(parts, monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.fmi.master._library", lambda: None)
    assert cosimulate({"a": parts["a"]}, timepts=T).success


def test_threads_are_checked(parts):
    with pytest.raises(ValueError, match="threads: expected at least 1, got 0"):
        cosimulate({"a": parts["a"]}, timepts=T, threads=0)


def test_long_intervals_are_run_in_pieces(parts, both, monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.fmi.master._PIECE", 7)
    compiled, plain = both(parts, RING, step=0.007)
    assert np.array_equal(compiled.outputs, plain.outputs)
    assert compiled.steps == plain.steps
