"""FMUs run together, against the closed form of the coupled system and against loops by hand."""

import json
import tempfile
import warnings

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm

from phyfilter_ctl.cli import main
from phyfilter_ctl.fmi import Fmu, FmuError, Master, System, Wire, cosimulate, import_fmu
from phyfilter_ctl.fmi.cosimulation_parts import SystemPart
from phyfilter_ctl.fmi.cosimulation_wiring import wire_up
from tests.fmi.stepping import with_master

M, K, D, C = 2.0, 8.0, 0.4, 3.0
T = np.linspace(0.0, 2.0, 21)
COUPLED = [("a.place", "b.x"), ("b.place", "a.x")]
START = {"b.x": -0.5, "b.v": 0.2}
SHOWN = ["a.x", "a.v", "b.x", "b.v"]
# Halving the step of a method of order one halves the error, to this.
ORDER_ONE = 0.1
# The FMU makes RK4 steps of at most 1 ms, the hand-written loops the exact step: error about h^4.
INTEGRATED = 1e-9


def exact(times=T):
    k, d, c = (K + C) / M, D / M, C / M
    A = np.array([[0, 1, 0, 0], [-k, -d, c, 0], [0, 0, 0, 1], [c, 0, -k, -d]])
    return np.array([expm(A * t) @ [1.0, 0.0, -0.5, 0.2] for t in times]).T


def system(name):
    """The oscillator as a python-control system."""
    A = [[0.0, 1.0], [-(K + C) / M, -D / M]]
    C_, D_ = [[1.0, 0.0], [0.0, 1.0], [-C, 0.0]], [[0.0], [0.0], [C]]
    return ct.ss(A, [[0.0], [C / M]], C_, D_, inputs=["place"], outputs=["x", "v", "force"], name=name)


def run(parts, **options):
    given = {"parameters": START, "outputs": SHOWN} | options
    return cosimulate(System(parts, COUPLED), given.pop("timepts", T), **with_master(given))


@pytest.mark.parametrize("scheme", ["jacobi", "gauss-seidel"])
def test_first_order_convergence(build, scheme):
    parts = {"a": build(), "b": build()}
    errors = [
        float(np.max(np.abs(run(parts, step=h, scheme=scheme).outputs - exact())))
        for h in (0.02, 0.01, 0.005)
    ]
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all(np.abs(ratios - 2.0) < ORDER_ONE)


def held_loop(h, *, sequential):
    """The same by hand: exact steps on held inputs."""
    d = ct.c2d(system("hand"), h, "zoh")
    xa, xb = np.array([1.0, 0.0]), np.array([-0.5, 0.2])
    rows = [np.concatenate([xa, xb])]
    for _ in range(round(2.0 / h)):
        new_a = d.A @ xa + d.B[:, 0] * xb[0]
        xb = d.A @ xb + d.B[:, 0] * (new_a if sequential else xa)[0]
        xa = new_a
        rows.append(np.concatenate([xa, xb]))
    return np.array(rows).T[:, :: round(0.1 / h)]


@pytest.mark.parametrize("scheme", ["jacobi", "gauss-seidel"])
def test_same_as_a_loop_by_hand(build, scheme):
    expected = held_loop(0.02, sequential=scheme == "gauss-seidel")
    fmus = run({"a": build(), "b": build()}, step=0.02, scheme=scheme)
    assert fmus.steps == 100
    assert np.max(np.abs(fmus.outputs - expected)) < INTEGRATED
    mixed = run(
        {"a": build(), "b": system("b")},
        step=0.02,
        scheme=scheme,
        parameters={},
        initial_state={"b": [-0.5, 0.2]},
    )
    assert np.max(np.abs(mixed.outputs - expected)) < INTEGRATED
    blocks = {
        "a": import_fmu(build(), kind="cs", step=0.1),
        "b": import_fmu(Fmu(build(kinds="me"), parameters={"x": -0.5})),
    }
    given = {"step": 0.02, "scheme": scheme, "parameters": {}, "initial_state": {"b": [-0.5, 0.2]}}
    assert np.max(np.abs(run(blocks, **given).outputs - expected)) < INTEGRATED


def test_order_of_gauss_seidel(build):
    parts = {"a": build(), "b": build()}
    first = run(parts, step=0.02, scheme="gauss-seidel", order=["a", "b"]).outputs
    second = run(parts, step=0.02, scheme="gauss-seidel", order=["b", "a"]).outputs
    swapped = run({"b": build(), "a": build()}, step=0.02, scheme="gauss-seidel").outputs
    assert not np.array_equal(first, second)
    assert np.array_equal(second, swapped)


def test_step_control(build):
    parts = {"a": build(), "b": build("2.0")}
    runs = [run(parts, scheme="gauss-seidel", tolerance=tolerance) for tolerance in (1e-3, 1e-4, 1e-5)]
    errors = [float(np.max(np.abs(entry.outputs - exact()))) for entry in runs]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 5e-3
    assert runs[0].steps < runs[1].steps < runs[2].steps
    assert all(entry.rejected > 0 for entry in runs), "the first step is too long, on purpose"
    # Steps by the error: fewer than equal steps of the same accuracy need.
    equal = run(parts, scheme="gauss-seidel", step=2.0 / runs[2].steps)
    assert errors[2] < 1.5 * np.max(np.abs(equal.outputs - exact()))


@pytest.mark.slow
def test_warnings_of_an_fmu_are_shown(build, capsys):
    """They do not end a run; a parameter that the FMU replaced with another value does."""
    path = str(build(defines=("WARNS",)))
    assert main(["fmu", "run", path, "--out", "-"]) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("time,x,v,force")
    assert shown.err == "phyfilter-ctl: the FMU says: [warning] warning: stiff spring\n"
    assert main(["fmu", "check", path, "--json", "-"]) == 0
    assert "stiff spring" in json.loads(capsys.readouterr().out)["findings"][0]["message"]
    with pytest.raises(FmuError, match=r"d is 0, not -1: \[warning\].* no damping below 0"):
        run({"a": path, "b": path}, parameters={"a.d": -1.0})


def test_step_control_retries_what_an_fmu_discards(build):
    picky = build(defines=("DISCARD_ABOVE=0.03",))
    found = run({"a": picky, "b": build()}, tolerance=1e-2)
    assert found.rejected > 0
    assert np.max(np.abs(found.outputs - exact())) < 0.1
    with pytest.raises(FmuError, match="'a': fmi2DoStep: discard: at t = 0"):
        run({"a": picky, "b": build()}, step=0.05)


def test_what_a_rejected_step_handed_on_is_handed_on_again():
    """A part switches to 1 at 0.45 s, another integrates what it gets: it is 0.55 at 1 s, by the size of a step."""
    switch = ct.nlsys(
        lambda t, x, u, p: [1.0], lambda t, x, u, p: [np.where(x[0] >= 0.45, 1.0, 0.0)],
        inputs=0, outputs="y", states=1, name="switch",
    )  # fmt: skip
    sum_ = ct.nlsys(
        lambda t, x, u, p: [u[0]], lambda t, x, u, p: [x[0]], inputs="u", outputs="y", states=1, name="sum"
    )
    found = cosimulate(
        System({"a": switch, "b": sum_}, [("b.u", "a.y")]),
        np.linspace(0.0, 1.0, 6),
        outputs=["b.y"],
        master=Master(tolerance=1e-3),
    )
    assert found.rejected > 0
    assert found.outputs[0, -1] == pytest.approx(0.55, abs=2e-3)


def test_step_control_needs_rollback(build):
    rigid = build(state=False, variable_step=False, defines=("NO_STATE",))
    with pytest.raises(ValueError, match=r"b cannot put back a state.*b cannot make steps of any length"):
        run({"a": build(), "b": rigid}, tolerance=1e-3)
    assert run({"a": build(), "b": rigid}, step=0.02).steps == 100
    with pytest.raises(ValueError, match=r"b: all communication steps must be equal, got 0.1 to 0.15 s"):
        run({"a": build(), "b": rigid}, timepts=[0.0, 0.1, 0.25])


def test_arrays_and_inputs_from_outside(build):
    """A vector by its base name, signals from outside as number, array and function."""
    places = np.array([0.1, -0.2])
    source = ct.ss([], [], [], np.eye(2), inputs=2, outputs=["p[0]", "p[1]"], name="source")
    whole = cosimulate(
        System({"three": build("3.0"), "source": source}, [("three.place", "source.p")]),
        T,
        inputs={"source.u[0]": 0.1, "source.u[1]": lambda t: -0.2},
        outputs=["three.x[0]", "three.x[1]"],
        master=Master(0.01),
    )
    direct = cosimulate(
        {"three": build("3.0")},
        T,
        inputs={"three.place[0]": 0.1, "three.place[1]": np.full(len(T), -0.2)},
        outputs=["three.x[0]", "three.x[1]"],
        master=Master(0.01),
    )
    assert np.array_equal(whole.outputs, direct.outputs)
    assert direct.input_labels == ["three.place[0]", "three.place[1]"]
    assert np.array_equal(direct.inputs, np.tile(places[:, None], len(T)))
    for i in range(2):
        expected = ct.forced_response(system("x"), T, np.full(len(T), places[i]), [1.0 + i, 0.0]).outputs[0]
        assert np.max(np.abs(direct.outputs[i] - expected)) < INTEGRATED


@pytest.mark.parametrize("first", [True, False])
def test_outside_inputs_pass_through_parts_without_delay(first):
    """A moving signal through a static block acts as if it were wired straight, in any order of the parts."""
    front = {"front": ct.ss([], [], [], [[1.0]], inputs="e", outputs="u", name="front")}
    lag = {"lag": ct.ss([[-2.0]], [[2.0]], [[1.0]], [[0.0]], inputs="u", outputs="y", name="lag")}
    given = {"timepts": T, "master": Master(0.01), "outputs": ["lag.y"]}
    through = cosimulate(
        System(front | lag if first else lag | front, [("lag.u", "front.u")]),
        inputs={"front.e": np.sin(3.0 * T)},
        **given,
    )
    straight = cosimulate(lag, inputs={"lag.u": np.sin(3.0 * T)}, **given)
    assert np.array_equal(through.outputs, straight.outputs)


def test_sums_signs_and_direct_feedthrough(build):
    """force depends on place at once: a chain of two static blocks behind it is right at every point, also at t0."""
    double = ct.ss([], [], [], [[2.0]], inputs="e", outputs="u", name="double")
    summed = ct.ss([], [], [], [[1.0]], inputs="e", outputs="u", name="sum")
    found = cosimulate(
        System(
            {"sum": summed, "double": double, "mass": build()},
            [("double.e", "mass.force"), ("sum.e", "double.u", "-mass.x", "mass.v")],
        ),
        T,
        inputs={"mass.place": np.sin(T)},
        outputs=["sum.u", "mass.x", "mass.v", "mass.force"],
        master=Master(0.01),
    )
    u, x, v, force = found.outputs
    assert np.allclose(u, 2.0 * force - x + v, rtol=0.0, atol=1e-12)
    assert np.allclose(force, C * (np.sin(T) - x), atol=1e-12)
    assert force[0] == -3.0


def test_offset_and_gain_of_a_wire(build):
    found = cosimulate(
        System({"a": build(), "b": build()}, [Wire("b.place", "a.x", gain=-2.0, offset=0.5)]),
        T,
        outputs=["a.x", "b.x", "b.force"],
    )
    a, b, force = found.outputs
    assert np.allclose(force, C * (-2.0 * a + 0.5 - b), atol=1e-12)


def test_discrete_parts(build):
    """An integrator at 0.05 s: its updates fit into the steps, or the run is refused."""
    accumulate = ct.ss([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.05, inputs="e", outputs="u", name="accumulate")
    parts = {"mass": build(), "sum": accumulate}
    found = cosimulate(System(parts, [("sum.e", "mass.x")]), T, outputs=["sum.u", "mass.x"])
    total, x = found.outputs
    assert np.allclose(np.diff(total), 2.0 * x[:-1], atol=1e-12)
    with pytest.raises(ValueError, match=r"sum: communication steps must be multiples of 0.05 s, got 0.02"):
        cosimulate(System(parts, [("sum.e", "mass.x")]), T, master=Master(0.02))


def test_units(build):
    metres, newtons = build(), build(unit="N")
    with pytest.raises(ValueError, match=r"'b.place' is in N and 'a.x' in m: they measure different things"):
        cosimulate(System({"a": metres, "b": newtons}, [("b.place", "a.x")]), T)
    with pytest.warns(UserWarning, match="measure different things"):
        cosimulate(System({"a": metres, "b": newtons}, [("b.place", "a.x")], units="warn"), T)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cosimulate(System({"a": metres, "b": newtons}, [("b.place", "a.x")], units="ignore"), T)


def test_units_of_one_dimension_are_converted(build):
    """x in m drives a place in thousandths of an inch from half a metre on: m = 2.54e-5 thou - 0.5."""
    parts = {"a": build(), "b": build(unit="thou")}
    given = {"timepts": T, "outputs": ["a.x", "b.x", "b.force"]}
    with pytest.raises(ValueError, match=r"differ by a factor of 39370.1 and by 19685. .* units=\"convert\""):
        cosimulate(System(parts, [("b.place", "a.x")]), **given)
    wired = System(parts, [Wire("b.place", "a.x", gain=2.0, offset=7.0)], units="convert")
    found = cosimulate(wired, **given)
    place = 2.0 * (found.outputs[0] + 0.5) / 2.54e-5 + 7.0
    assert np.allclose(found.outputs[2], C * (place - found.outputs[1]), rtol=1e-12)
    with pytest.raises(ValueError, match="measure different things"):
        cosimulate(System({"a": build(), "b": build(unit="N")}, [("b.place", "a.x")], units="convert"), T)


@pytest.mark.parametrize(
    ("sink", "sources"),
    [
        ("Float64", "Float64 Float32 Int8 UInt64 Enumeration Boolean"),
        ("Float32", "Float64 Float32 Int8 UInt64 Enumeration Boolean"),
        ("Int8", "Int8 UInt64 Enumeration Boolean"),
        ("Enumeration", "Enumeration"),
        ("Boolean", "Boolean"),
    ],
)
def test_types_on_a_wire(sink, sources):
    """What an input of a type takes; a block of python-control, whose signals have none, gives and takes all."""
    for source in ("Float64", "Float32", "Int8", "UInt64", "Enumeration", "Boolean", ""):
        typed = [Static("a", sink), Static("b", source)]
        if source in sources.split() or not source:
            wire_up(typed, [("a.u", "b.y")])
        else:
            with pytest.raises(
                ValueError, match=rf"'a.u' is {sink} and 'b.y' {source}, which it cannot take"
            ):
                wire_up(typed, [("a.u", "b.y")])


class Static(SystemPart):
    """A gain of one whose signals have a type."""

    def __init__(self, name, kind):
        super().__init__(name, ct.ss([], [], [], [[1.0]], inputs="u", outputs="y"), params={})
        self.kind = kind

    def type(self, label):
        return self.kind


@pytest.mark.parametrize(
    ("connections", "message"),
    [
        ([("a.plaec", "b.x")], r"'a.plaec' is not an input of a part; .*a.place"),
        ([("a.place", "b.y")], r"'b.y' is not an output of a part"),
        ([("a.place", "b.x"), ("a.place", "b.v")], r"'a.place' is driven twice"),
        ([("a.place",)], r'expected \("part.input", "part.output", ...\)'),
        (["a.place"], r'expected \("part.input"'),
        ([("a.x", "b.x")], r"'a.x' is not an input"),
    ],
)
def test_wrong_connections(build, connections, message):
    with pytest.raises(ValueError, match=message):
        cosimulate(System({"a": build(), "b": build()}, connections, units="ignore"), T)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"timepts": [0.0]}, "timepts: expected at least two times"),
        ({"timepts": [0.0, 0.0, 1.0]}, "increasing"),
        ({"step": -1.0}, "step: expected seconds > 0"),
        ({"tolerance": 0.0}, "tolerance: expected a number > 0"),
        ({"scheme": "newton"}, 'expected "jacobi" or "gauss-seidel"'),
        ({"scheme": "gauss-seidel", "order": ["a"]}, "expected each part once"),
        ({"order": ["a", "b"]}, 'means nothing to scheme="jacobi"'),
        ({"inputs": {"a.place": 1.0}}, "'a.place' is driven already"),
        ({"inputs": {"c.place": 1.0}}, "'c.place' is not an input"),
        ({"parameters": {"k": 1.0}}, "'k' names no part"),
        ({"parameters": {"a.q": 1.0}}, "there is no variable 'q'"),
        ({"initial_state": {"c": [0.0]}}, "'c' names no part"),
        ({"outputs": ["a.y"]}, "'a.y' is not an output"),
    ],
)
def test_wrong_arguments(build, options, message):
    with pytest.raises(ValueError, match=message):
        run({"a": build(), "b": build()}, **options)


def test_wrong_signals(build):
    with pytest.raises(
        ValueError, match=r"21 finite values \(one per time\) or a function of time, got shape \(3,\)"
    ):
        cosimulate({"a": build()}, timepts=T, inputs={"a.place": [1.0, 2.0, 3.0]})
    with pytest.raises(TypeError, match="expected an FMU file, an imported FMU or a python-control system"):
        cosimulate({"a": 3.0}, timepts=T)  # type: ignore[dict-item]  # the error is the point
    with pytest.raises(ValueError, match=r"b: initial_state: expected 2 finite values, got shape \(1,\)"):
        cosimulate({"b": system("b")}, timepts=T, initial_state={"b": [0.0]})


def test_a_failing_fmu_frees_all(build, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    broken = build(defines=("FAIL_AT=0.35",))
    with pytest.raises(
        FmuError, match=r"FMU 'b': fmi2DoStep: error: at t = 0.3; .*spring broke at t = 0.3: too long"
    ):
        run({"a": build(), "b": broken})
    assert not list(tmp_path.iterdir())


def test_result_is_python_controls(build):
    found = run({"a": build(), "b": build()})
    assert isinstance(found, ct.TimeResponseData)
    assert found.output_labels == SHOWN
    assert found.messages == {"a": (), "b": ()}
    assert np.array_equal(found.time, T)
    everything = run({"a": build(), "b": build()}, outputs=None)
    assert everything.output_labels == ["a.x", "a.v", "a.force", "b.x", "b.v", "b.force"]


def test_progress_bar(build, capsys):
    run({"a": build(), "b": build()}, progress=True)
    assert "co-simulation" in capsys.readouterr().err


def test_a_tolerance_that_cannot_be_kept(build):
    """An input that jumps: across the jump only a step of 1e-15 s would do."""
    found = cosimulate(
        {"mass": build()},
        np.linspace(0.0, 1.0, 5),
        inputs={"mass.place": lambda t: 1e6 * (t > 0.3)},
        outputs=["mass.v"],
        master=Master(1e-3, tolerance=1e-9),
    )
    assert not found.success
    assert "at t = 0.3: loosen the tolerance, or look for a jump in a signal" in found.message
    assert np.array_equal(np.isnan(found.outputs[0]), [False, False, True, True, True])
