"""Signals that depend on themselves at one instant: solved, against closed forms, or refused."""

import control as ct
import numpy as np
import pytest

from phyfilter_ctl.fmi import Master, System, cosimulate
from phyfilter_ctl.fmi.cosimulation_parts import FmuPart, make_part

T = np.linspace(0.0, 1.0, 5)
# The residual that a loop may leave, as a part of its largest signal, times the amplification of the cases below.
SOLVED = 1e-8
C = 3.0


def static(gain, name, inputs="e", outputs="u"):
    return ct.ss([], [], [], np.atleast_2d(gain), inputs=inputs, outputs=outputs, name=name)


def function(f, name):
    return ct.nlsys(None, lambda t, x, u, params: np.atleast_1d(f(u)), inputs="e", outputs="u", name=name)


@pytest.mark.parametrize("scheme", ["jacobi", "gauss-seidel"])
@pytest.mark.parametrize("gains", [(-2.0, 1.0), (0.5, 1.0), (2.0, 3.0), (-2000.0, 5.0), (0.999, 1.0)])
def test_linear_loops(gains, scheme):
    """Far beyond where handing on would settle; a loop of -2 once ended in 174,762."""
    a, b = gains
    parts = {"a": static(a, "a"), "b": static(b, "b"), "r": static(1.0, "r")}
    wires = [("a.e", "b.u", "r.u"), ("b.e", "a.u")]
    found = cosimulate(
        System(parts, wires), T, inputs={"r.e": 1.0 + T}, outputs=["a.u"], master=Master(scheme=scheme)
    )
    assert found.success
    assert np.allclose(found.outputs[0], a / (1.0 - a * b) * (1.0 + T), rtol=SOLVED, atol=0.0)


def test_one_loop_behind_another():
    """A loop, a chain of two, a second loop that sees it, a chain behind: in one instant."""
    parts = {
        name: static(gain, name)
        for name, gain in {"a": -2.0, "b": 3.0, "c": 5.0, "d": -4.0, "e": 7.0}.items()
    }
    wires = [("e.e", "d.u"), ("d.e", "c.u", "d.u"), ("c.e", "b.u"), ("b.e", "a.u"), ("a.e", "r.u", "a.u")]
    found = cosimulate(
        System(parts | {"r": static(1.0, "r")}, wires), T, inputs={"r.e": np.sin(T)}, outputs=["e.u"]
    )
    assert np.allclose(
        found.outputs[0], 7.0 * (-4.0 / 5.0) * 15.0 * (-2.0 / 3.0) * np.sin(T), rtol=SOLVED, atol=1e-12
    )


def test_a_nonlinear_loop():
    found = cosimulate(System({"c": function(np.cos, "c")}, [("c.e", "c.u")]), T)
    assert np.allclose(found.outputs, 0.7390851332151607, rtol=0.0, atol=SOLVED)  # Dottie's number


@pytest.mark.parametrize("gains", [(1.0, 1.0), (-1.0, -1.0), (2.0, 0.5)])
def test_a_gain_of_one_is_refused(gains):
    parts = {"a": static(gains[0], "a"), "b": static(gains[1], "b"), "r": static(1.0, "r")}
    wires = [("a.e", "b.u", "r.u"), ("b.e", "a.u")]
    with pytest.raises(ValueError, match=r"algebraic loop through a\.e, b\.e at t = 0: its gain is one"):
        cosimulate(System(parts, wires), T, inputs={"r.e": 1.0})


def test_a_loop_without_a_solution_is_refused():
    relay = function(lambda u: -np.sign(u - 0.3), "relay")
    with pytest.raises(ValueError, match=r"through relay\.e at t = 0: no solution was found"):
        cosimulate(System({"relay": relay}, [("relay.e", "relay.u")]), T)


def test_a_solution_that_goes_away_is_no_success():
    """u = u^2 + d has none beyond d = 1/4, at t = 0.5."""
    square = function(lambda u: u**2, "square")
    found = cosimulate(
        System({"square": square, "d": static(1.0, "d")}, [("square.e", "square.u", "d.u")]),
        np.linspace(0.0, 1.0, 11),
        inputs={"d.e": lambda t: 0.5 * t},
        outputs=["square.u"],
    )
    assert not found.success
    assert "algebraic loop through square.e at t = 0.6: no solution was found" in found.message
    d = 0.05 * np.arange(5)
    assert np.allclose(found.outputs[0, :5], (1.0 - np.sqrt(1.0 - 4.0 * d)) / 2.0 - d, rtol=0.0, atol=SOLVED)
    assert np.all(np.isnan(found.outputs[0, 6:]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fmi", "options"),
    [
        ("2.0", {}),
        ("2.0", {"declared": None}),
        ("2.0", {"declared": False}),
        ("3.0", {}),
        ("3.0", {"derivatives": True}),
        ("3.0", {"adjoint": True}),
    ],
)
def test_an_fmu_on_its_own_force(build, fmi, options):
    """place = force = c (place - x), so place = c x / (c - 1)."""
    path = build(fmi, **options)
    own = [("a.place", "a.force")]
    found = cosimulate(System({"a": path}, own, units="ignore"), T, master=Master(0.05))
    x, _, force = (found.outputs[i] for i in ((0, 1, 2) if fmi == "2.0" else (0, 2, 4)))
    assert np.allclose(force, C * x / (C - 1.0), rtol=SOLVED, atol=1e-12)


@pytest.mark.slow
def test_slopes_of_parts(build):
    """Directional or adjoint derivatives where the FMU has them, matrices where the system is linear, else unknown."""
    columns = np.array([1])
    for options in ({"derivatives": True}, {"adjoint": True}):
        part = make_part("a", build("3.0", **options), {})
        assert isinstance(part, FmuPart)
        slopes = part.slopes(columns)
        assert slopes is not None
        assert slopes[:, 0].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, C]
        part.close()
    plain = make_part("a", build("3.0"), {})
    assert plain.slopes(columns) is None
    plain.close()
    linear = make_part("b", static([[1.0, 2.0]], "b", inputs=["e", "f"]), {}).slopes(columns)
    assert linear is not None
    assert linear.tolist() == [[2.0]]


@pytest.mark.slow
def test_a_loop_that_is_only_declared_is_none(build):
    """Where nothing is said every output counts as passing every input through; the run is that of one that says it."""
    wires = [("a.place", "b.force", "b.x"), ("b.place", "a.x")]
    options = {"timepts": T, "master": Master(0.01)}
    runs = [
        cosimulate(
            System({name: build(declared=declared) for name in "ab"}, wires, units="ignore"), **options
        )
        for declared in (True, None)
    ]
    assert np.allclose(runs[0].outputs, runs[1].outputs, rtol=SOLVED, atol=SOLVED)


@pytest.mark.slow
def test_a_loop_under_step_control(build):
    own = [("a.place", "a.force")]
    found = cosimulate(System({"a": build()}, own, units="ignore"), T, master=Master(tolerance=1e-3))
    assert found.success
    assert np.allclose(found.outputs[2], C * found.outputs[0] / (C - 1.0), rtol=SOLVED, atol=1e-12)
    with pytest.raises(ValueError, match="its gain is one"):
        cosimulate(
            System({"a": build()}, own, units="ignore"),
            T,
            parameters={"a.c": 1.0},
            master=Master(tolerance=1e-3),
        )
