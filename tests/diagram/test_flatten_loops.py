"""Algebraic loops: solved where they have one solution, refused with their path where not."""

import casadi as ca
import control as ct
import numpy as np
import pytest
from scipy.optimize import brentq

from phyfilter_ctl.blocks import BlockFunctions, Variable, function_block
from phyfilter_ctl.diagram import flatten
from phyfilter_ctl.diagram.ordering import cycle, tear

ROUNDING = 1e-13
NEWTON = 1e-10  # what the stopping rule leaves
STEP = 1e-6  # of central differences
SLOPE = 1e-7  # their error


def at(function, t, x, u, p, z=()):
    return np.asarray(function(t, x, u, p, z), dtype=float).reshape(-1)


def loop(block, gain=-1.0, name="loop"):
    """y = block(u + gain y)."""
    return ct.InterconnectedSystem([block], connections=[[(0, 0), (0, 0, gain)]], inplist=[(0, 0)], outlist=[(0, 0)],
                                   inputs="r", outputs="y", name=name)  # fmt: skip


def test_linear_loop_that_python_control_refuses():
    """x' = -x + v, y = x + v / 2, v = r - y, so y = (x + r / 2) / 1.5."""
    plant = ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.5]], name="plant")
    sys = loop(plant)
    with pytest.raises(RuntimeError, match="algebraic loop"):
        sys.output(0, [1.0], [2.0])
    flat = flatten(sys)
    x, r = 0.7, 2.0
    y = (x + 0.5 * r) / 1.5
    np.testing.assert_allclose(at(flat.output, 0, [x], [r], []), [y], rtol=ROUNDING)
    np.testing.assert_allclose(at(flat.dynamics, 0, [x], [r], []), [-x + r - y], rtol=ROUNDING)
    assert flat.is_linear
    closed = flat.linearize()
    np.testing.assert_allclose([closed.A.item(), closed.D.item()], [-1 - 1 / 1.5, 0.5 / 1.5], rtol=ROUNDING)


def test_real_loop_that_python_control_misses():
    """At zero input python-control's iteration stands still and returns 0; y = y + r has no solution or all."""
    unit = ct.nlsys(None, lambda t, x, u, params: u + 1.0 - 1.0, inputs="v", outputs="y", name="unit")
    sys = loop(unit, gain=1.0)
    assert sys.output(0, [], [0.0]).tolist() == [0.0]
    with pytest.raises(ValueError, match=r"unit\.v -> unit\.y -> unit\.v is singular"):
        flatten(sys)


def test_singular_loop_names_its_path():
    first = ct.ss([], [], [], [[2.0]], inputs="u", outputs="y", name="first")
    second = ct.ss([], [], [], [[0.5]], inputs="u", outputs="y", name="second")
    sys = ct.InterconnectedSystem(
        [first, second, ct.tf([1.0], [1.0, 1.0], name="lag")],
        connections=[[(0, 0), (1, 0)], [(1, 0), (0, 0)], [(2, 0), (0, 0)]], inplist=[(0, 0)], outlist=[(2, 0)],
        inputs="r", outputs="y", name="bad",
    )  # fmt: skip
    with pytest.raises(ValueError, match="singular") as caught:
        flatten(sys)
    text = str(caught.value)
    assert "first.u -> first.y -> second.u -> second.y -> first.u" in text
    assert "lag" not in text.split(" is singular")[0]
    assert "unit delay" in text


def test_gain_of_a_loop_that_is_a_parameter():
    """The solution stays exact for other values of the parameter."""
    gain = ct.nlsys(
        None, lambda t, x, u, params: params["k"] * u, inputs="v", outputs="y", params={"k": 3.0}, name="k"
    )
    flat = flatten(loop(gain))
    assert flat.output.is_a("SXFunction")
    for k in (3.0, 0.5, -4.0):
        value = at(flat.output, 0, [], [2.0], flat.start_parameters({"k": k}))
        np.testing.assert_allclose(value, [2.0 * k / (1 + k)], rtol=ROUNDING)
    singular = ct.nlsys(None, lambda t, x, u, params: params["k"] * u, inputs="v", outputs="y", params={"k": -1.0},
                        name="k")  # fmt: skip
    with pytest.raises(ValueError, match="singular"):
        flatten(loop(singular))


def test_a_loop_undefined_where_it_is_tried_is_not_singular():
    """y = sqrt(x - 100) (r - y), tried around x = 0 only: where it is defined it has its solution."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 0)
    dynamics = ca.Function("dynamics", [t, x, u, p], [-x])
    output = ca.Function("output", [t, x, u, p], [ca.sqrt(x - 100.0) * u])
    variables = (Variable("x"),), (Variable("v"),), (Variable("y"),), ()
    gain = function_block(BlockFunctions(*variables, dynamics, output), name="k")
    flat = flatten(loop(gain))
    assert np.isnan(at(flat.output, 0, [0.0], [3.0], []))
    np.testing.assert_allclose(at(flat.output, 0, [104.0], [3.0], []), [2.0], rtol=ROUNDING)


def test_loop_affine_with_state_dependent_gains_of_two_blocks():
    """y = M(x) v + x, v = r - K y with three signals: one small linear system per evaluation."""

    def output(t, x, u, params):
        return [u[0] * np.cos(x[0]) + u[1] * x[1], u[1] + 0.3 * u[2] * x[0], u[2] * (2 + np.sin(x[1])) + x[0]]

    block = ct.nlsys(lambda t, x, u, params: u[:2] - x, output, inputs=3, outputs=3, states=2, name="m")
    K = np.array([[0.2, 0.1, 0.0], [0.3, 0.5, 0.4], [0.1, 0.0, 0.6]])
    sys = ct.InterconnectedSystem([block], inplist=[(0, i) for i in range(3)], outlist=[(0, i) for i in range(3)],
                                  inputs=3, outputs=3, name="mimo")  # fmt: skip
    sys.set_connect_map(-K)
    flat = flatten(sys)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, r = rng.normal(size=2), rng.normal(size=3)
        M = np.array([[np.cos(x[0]), x[1], 0], [0, 1, 0.3 * x[0]], [0, 0, 2 + np.sin(x[1])]])
        y = np.linalg.solve(np.eye(3) + M @ K, M @ r + [0, 0, x[0]])
        np.testing.assert_allclose(at(flat.output, 0, x, r, []), y, rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(
            at(flat.dynamics, 0, x, r, []), (r - K @ y)[:2] - x, rtol=1e-11, atol=1e-12
        )


def tanh_block(name="sat"):
    return ct.nlsys(None, lambda t, x, u, params: params["k"] * np.tanh(u), inputs="v", outputs="y",
                    params={"k": 2.0}, name=name)  # fmt: skip


@pytest.mark.parametrize("r", [0.0, 0.3, -1.0, 5.0, 40.0])
def test_nonlinear_loop_by_newton(r):
    """y = 2 tanh(r - y); scipy's bracketing root finder says what y is."""
    flat = flatten(loop(tanh_block()))
    assert not flat.output.is_a("SXFunction")
    assert not flat.is_linear
    expected = brentq(lambda y: y - 2 * np.tanh(r - y), -3, 3, xtol=1e-15)
    np.testing.assert_allclose(at(flat.output, 0, [], [r], flat.start_parameters()), [expected], atol=NEWTON)


def test_nonlinear_loop_differentiates():
    flat = flatten(loop(tanh_block()))
    p, r = flat.start_parameters(), 0.4
    slope = (at(flat.output, 0, [], [r + STEP], p) - at(flat.output, 0, [], [r - STEP], p)) / (2 * STEP)
    np.testing.assert_allclose(flat.linearize(u0=[r]).D.item(), slope.item(), atol=SLOPE)
    assert flat.feedthrough.tolist() == [[True]]


def test_nonlinear_loops_in_a_row_and_what_comes_after():
    """Two loops, the second fed by the first through a lag-free gain; the state after sees both."""
    first, second = loop(tanh_block(), name="one"), loop(tanh_block(), name="two")
    lag = ct.tf([1.0], [1.0, 2.0], name="lag")
    sys = ct.InterconnectedSystem(
        [lag, second, first], connections=[[(1, 0), (2, 0, 3.0)], [(0, 0), (1, 0)]], inplist=[(2, 0)],
        outlist=[(2, 0), (1, 0)], inputs="r", outputs=["a", "b"], name="row",
    )  # fmt: skip
    flat = flatten(sys)

    def solved(r):
        return brentq(lambda y: y - 2 * np.tanh(r - y), -3, 3, xtol=1e-15)

    a = solved(0.8)
    b = solved(3.0 * a)
    p = flat.start_parameters()
    np.testing.assert_allclose(at(flat.output, 0, [0.5], [0.8], p), [a, b], atol=NEWTON)
    np.testing.assert_allclose(at(flat.dynamics, 0, [0.5], [0.8], p), [b - 2 * 0.5], atol=NEWTON)
    assert flat.order.index("one.sat") < flat.order.index("two.sat")


def test_nonlinear_loop_without_solution():
    """y = 50 + y^2: none at all. y = r + y^2: none above r = 1/4, where the result is not-a-number."""
    square = ct.nlsys(None, lambda t, x, u, params: 50 + u**2, inputs="v", outputs="y", name="square")
    with pytest.raises(ValueError, match=r"square\.v -> square\.y -> square\.v: no solution"):
        flatten(loop(square, gain=1.0))
    shifted = ct.nlsys(
        None, lambda t, x, u, params: u[0] + u[1] ** 2, inputs=["r", "v"], outputs="y", name="q"
    )
    sys = ct.InterconnectedSystem([shifted], connections=[[(0, 1), (0, 0)]], inplist=[(0, 0)], outlist=[(0, 0)],
                                  inputs="r", outputs="y", name="loop")  # fmt: skip
    with pytest.warns(
        RuntimeWarning, match=r"loop q\.v -> q\.y -> q\.v has several solutions.*also found: 1"
    ):
        flat = flatten(sys)
    np.testing.assert_allclose(at(flat.output, 0, [], [0.09], []), [0.1], atol=NEWTON)
    assert np.isnan(at(flat.output, 0, [], [0.5], []))


def test_loop_of_large_numbers():
    """A stopping rule in absolute terms would never be met at forces of 1e9."""
    block = ct.nlsys(
        None, lambda t, x, u, params: 1e9 * np.tanh(u / 1e9), inputs="v", outputs="y", name="big"
    )
    flat = flatten(loop(block))
    r = 1.5e9
    expected = brentq(lambda y: y - 1e9 * np.tanh((r - y) / 1e9), 0, 1e9, xtol=1e-3)
    np.testing.assert_allclose(at(flat.output, 0, [], [r], []), [expected], rtol=NEWTON)


def test_loop_through_the_borders_of_a_diagram():
    """A diagram that hands an input straight out, closed around itself: y = r - 0.5 y."""
    through = ct.InterconnectedSystem([ct.ss([], [], [], [[1.0]], name="wire")], inplist=[(0, 0)],
                                      outlist=["wire.u[0]"], inputs="in", outputs="out", name="inner")  # fmt: skip
    sys = ct.InterconnectedSystem([through], connections=[["inner.in", ("inner", "out", -0.5)]], inplist=["inner.in"],
                                  outlist=["inner.out"], inputs="r", outputs="y", name="outer")  # fmt: skip
    np.testing.assert_allclose(at(flatten(sys).output, 0, [], [3.0], []), [2.0], rtol=ROUNDING)


def table_block(name="table"):
    """y = table(v) with a lookup table, which CasADi has as a function but not as scalar operations."""
    t, x, u, p = ca.MX.sym("t"), ca.MX.sym("x", 0), ca.MX.sym("u"), ca.MX.sym("p", 0)
    table = ca.interpolant("table", "linear", [[-2.0, 0.0, 1.0, 4.0]], [-1.0, 0.0, 2.0, 3.0])
    dynamics = ca.Function("dynamics", [t, x, u, p], [ca.MX(0, 1)])
    output = ca.Function("output", [t, x, u, p], [table(u)])
    functions = BlockFunctions((), (Variable("v"),), (Variable("y"),), (), dynamics, output)
    return function_block(functions, name=name)


def test_block_without_scalar_form():
    """Beside a linear loop, and in a loop itself: y = table(r - y)."""
    beside = ct.interconnect(
        [loop(ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.5]], name="plant"), name="closed"), table_block()],
        connections=[["table.v", "closed.y"]], inplist=["closed.r"], inputs="r", outlist=["table.y"], outputs="y",
        name="beside",
    )  # fmt: skip
    flat = flatten(beside)
    y = (0.7 + 0.5 * 0.2) / 1.5
    np.testing.assert_allclose(at(flat.output, 0, [0.7], [0.2], []), [2 * y], rtol=ROUNDING)
    np.testing.assert_allclose(at(flat.dynamics, 0, [0.7], [0.2], []), [-0.7 + 0.2 - y], rtol=ROUNDING)
    closed = flatten(loop(table_block()))
    np.testing.assert_allclose(at(closed.output, 0, [], [0.9], []), [0.6], atol=NEWTON)  # y = 2 (0.9 - y)


def test_loops_are_cut_where_most_paths_cross():
    """Signal 2 feeds two others and is fed by two; cut there, nothing is left. Any other cut leaves a loop."""
    needs = {0: [1, 2, 3], 1: [2], 2: [0, 3], 3: [1]}
    assert tear([0, 1, 2, 3], needs.__getitem__, set()) == [2]


def test_a_loop_is_named_by_its_shortest_way():
    assert cycle([0, 1, 2], {0: [1, 2], 1: [2], 2: [0]}.__getitem__) == [0, 2, 0]
