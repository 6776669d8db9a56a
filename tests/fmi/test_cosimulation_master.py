"""The master's loop in C beside the one in Python: call for call the same run."""

import control as ct
import numpy as np
import pytest
from foreign_fmus import oscillator

from phyfilter_ctl.fmi import Fmu, FmuError, Master, System, cosimulate, import_fmu
from phyfilter_ctl.fmi.cosimulation_run import Run
from phyfilter_ctl.fmi.master import FastMaster
from tests.fmi.stepping import with_master

T = np.linspace(0.0, 2.0, 21)
RING = [
    ("a.place", "b.x"),
    ("b.place", "c.x[0]", "-a.x"),
    ("c.place[0]", "a.x"),
    ("c.place[1]", "b.x"),
]
# Sums in another order, and the residual of a loop that is solved anew in one run and with old slopes in the other.
ROUNDING, SOLVED = 1e-12, 1e-8
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
        system = System(parts, wires, units=options.pop("units", "raise"))
        compiled = cosimulate(system, T, **with_master(options))
        monkeypatch.setattr(Run, "in_c", False)
        plain = cosimulate(system, T, **with_master(options))
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
        (RING, {"step": 0.02, "hold": "first"}),
        pytest.param(
            RING, {"tolerance": 1e-3, "scheme": "gauss-seidel", "hold": "first"}, marks=pytest.mark.slow
        ),
        pytest.param(
            DRIVEN, {"tolerance": 1e-3, "inputs": {"c.place[1]": lambda t: 0.2 * t}}, marks=pytest.mark.slow
        ),
        (DRIVEN, {"tolerance": 1e-3, "inputs": {"c.place[1]": np.sin(3.0 * T)}, "scheme": "gauss-seidel"}),
    ],
)
def test_the_same_run(parts, both, wires, options):
    compiled, plain = both(parts, wires, parameters={"b.v": 0.2}, **options)
    assert (compiled.master, plain.master) == ("C", "Python")
    assert np.array_equal(compiled.outputs, plain.outputs)
    assert (compiled.steps, compiled.rejected) == (plain.steps, plain.rejected)
    if "inputs" in options:
        assert np.array_equal(compiled.inputs, plain.inputs)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_failing_part_is_named(parts, tmp_path, threads):
    broken = oscillator(tmp_path, defines=("FAIL_AT=0.35",))
    wires = [("a.place", "b.x"), ("b.place", "a.x")]
    with pytest.raises(FmuError, match=r"FMU 'b': fmi2DoStep: error: at t = 0.3; .*spring broke at t = 0.3"):
        cosimulate(System({"a": parts["a"], "b": broken}, wires), T, master=Master(threads=threads))


def test_without_a_compiler(parts, monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.fmi.master._library", lambda: None)
    found = cosimulate({"a": parts["a"]}, timepts=T)
    assert found.success
    assert found.master == "Python: no C compiler for 64 bits"


def test_threads_are_checked(parts):
    with pytest.raises(ValueError, match="threads: expected at least 1, got 0"):
        cosimulate({"a": parts["a"]}, T, master=Master(threads=0))


def test_long_intervals_are_run_in_pieces(parts, both, monkeypatch):
    monkeypatch.setattr("phyfilter_ctl.fmi.master._PIECE", 7)
    compiled, plain = both(parts, RING, step=0.007)
    assert np.array_equal(compiled.outputs, plain.outputs)
    assert compiled.steps == plain.steps


def curved(name="curved"):
    """A nonlinear system of one state."""
    return ct.nlsys(
        lambda t, x, u, params: [u[0] - x[0] ** 3],
        lambda t, x, u, params: [x[0]],
        inputs="u",
        outputs="y",
        states=1,
        name=name,
    )


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"step": 0.02}, marks=pytest.mark.slow),
        {"step": 0.05, "scheme": "gauss-seidel", "hold": "first"},
        pytest.param({"tolerance": 1e-3}, marks=pytest.mark.slow),
    ],
)
def test_python_control_parts(parts, both, options):
    """A linear system is run in C, a nonlinear one called."""
    lag = ct.ss(
        [[-2.0, 0.3], [0.0, -1.0]], [[0.5], [1.0]], [[1.0, 0.0]], [[0.0]], inputs="u", outputs="y", name="lag"
    )
    wires = [("a.place", "lag.y"), ("lag.u", "curved.y", "-a.v"), ("curved.u", "a.x")]
    start = np.array([0.3, -0.2])
    compiled, plain = both(
        {"a": parts["a"], "lag": lag, "curved": curved()}, wires, initial_state={"lag": start}, **options
    )
    assert compiled.master == "C, calling Python for curved (with equations in Python)"
    assert np.allclose(compiled.outputs, plain.outputs, rtol=0.0, atol=ROUNDING)
    assert (compiled.steps, compiled.rejected) == (plain.steps, plain.rejected)
    assert start.tolist() == [0.3, -0.2]


def test_discrete_parts(both, parts):
    """Five samples a step, and none of a system without states."""
    sums = ct.ss(
        [[0.9]], [[0.1]], [[1.0], [0.0]], [[0.0], [1.0]], dt=0.02, inputs="u", outputs=["y", "z"], name="sums"
    )
    compiled, plain = both(
        {
            "a": parts["a"],
            "sums": sums,
            "gain": ct.ss([], [], [], [[-1.0]], inputs="u", outputs="y", name="gain"),
        },
        [("a.place", "sums.y"), ("gain.u", "sums.z"), ("sums.u", "a.x")],
        inputs={},
        step=0.1,
    )
    assert np.allclose(compiled.outputs, plain.outputs, rtol=0.0, atol=ROUNDING)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"step": 0.01}, {"tolerance": 1e-3}, {"step": 0.01, "hold": "first"}])
def test_algebraic_loops(parts, both, options):
    """force = 3 (place - x) of both masses, each the other's place by a nonlinear gain."""
    bend = ct.nlsys(None, lambda t, x, u, params: np.tanh(0.1 * u), inputs=2, outputs=2, name="bend")
    wires = [
        ("a.place", "bend.y[0]"),
        ("b.place", "bend.y[1]"),
        ("bend.u[0]", "b.force"),
        ("bend.u[1]", "a.force"),
    ]
    compiled, plain = both({"a": parts["a"], "b": parts["b"], "bend": bend}, wires, units="ignore", **options)
    assert np.allclose(compiled.outputs, plain.outputs, rtol=0.0, atol=SOLVED)
    times = compiled.master.partition("Python), and ")[2].removesuffix(
        " times to solve an algebraic loop anew"
    )
    assert 1 <= int(times) < 0.1 * compiled.steps, "C solves it with old slopes, nearly always"


def test_a_loop_that_goes_away_in_c(parts, both):
    """u = u^2 + d has no solution beyond d = 1/4."""
    square = ct.nlsys(None, lambda t, x, u, params: u**2, inputs="e", outputs="u", name="square")
    pass_on = ct.ss([], [], [], [[1.0]], inputs="e", outputs="u", name="d")
    for run in both(
        {"a": parts["a"], "square": square, "d": pass_on},
        [("square.e", "square.u", "d.u")],
        inputs={"d.e": lambda t: 0.4 * t},
    ):
        assert "algebraic loop through square.e at t = 0.7: no solution was found" in run.message
        assert np.flatnonzero(np.isnan(run.outputs[0]))[0] == 7


@pytest.mark.slow
def test_what_an_fmu_left_out_shows_late(tmp_path, both):
    """Place does act on force, which begins at rest; the loop is found on the way."""
    path = oscillator(tmp_path, declared=False)
    compiled, plain = both(
        {"a": path}, [("a.place", "a.force")], parameters={"a.x": 0.0, "a.v": 1.0}, units="ignore", step=0.01
    )
    assert compiled.master.startswith("C, and to hand on signals: an output depends on an input")
    assert compiled.success
    assert np.allclose(compiled.outputs, plain.outputs, rtol=0.0, atol=SOLVED)


def test_errors_pass_through_c(parts):
    def rate(t, x, u, params):
        raise KeyError("no table of winds")

    broken = ct.nlsys(rate, None, inputs="u", states=1, name="broken")
    with pytest.raises(KeyError, match="no table of winds"):
        cosimulate(System({"a": parts["a"], "broken": broken}, [("broken.u", "a.x")]), T)


@pytest.mark.slow
def test_an_fmu_that_ends_its_run_does_so_under_step_control(tmp_path, both):
    """FMI 2.0 says it by discarding the step, which step control must not take for one that is too long."""
    path = oscillator(tmp_path, defines=("ENDS_AT=0.35",))
    for run in both({"a": path}, [], tolerance=1e-2, inputs={"a.place": 0.1}):
        assert run.message.endswith("the FMU asks to end the run at t = 0.35")


@pytest.mark.slow
def test_fmus_that_c_must_not_call(build, both):
    """One in a process of its own, one with items of enumerations to check."""
    typed = build("3.0", numbers=True, modes=True)
    compiled, plain = both(
        {
            "a": build(),
            "typed": typed,
            "ours": import_fmu(Fmu(build(interpolates=True), isolated=True), kind="cs"),
        },
        [("a.place", "ours.x"), ("ours.place", "typed.x[0]"), ("typed.place[0]", "a.x")],
        step=0.02,
        hold="first",
    )
    assert (
        compiled.master == "C, calling Python for typed (with enumerations), ours (in a process of its own)"
    )
    assert np.array_equal(compiled.outputs, plain.outputs)


@pytest.mark.slow
def test_nothing_is_called_after_a_fatal_error(tmp_path, monkeypatch):
    path = oscillator(tmp_path, defines=("FAIL_AT=0.35", "FAILS_WITH=fmi2Fatal"))
    for in_c in (True, False):
        monkeypatch.setattr(Run, "in_c", in_c)
        with pytest.raises(FmuError, match="fmi2DoStep: fatal: at t = ") as caught:
            cosimulate({"a": path}, T, master=Master(tolerance=1e-2))
        assert caught.value.results is not None
        assert not any("after a fatal" in message for message in caught.value.results.messages["a"])
