"""Blocks from CasADi functions inside python-control: values, parameters, exact derivatives, copies."""

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl import PhyFilter, phyfilter_block
from phyfilter_ctl.blocks import BlockFunctions, FunctionBlock, Variable, function_block, learned_block
from phyfilter_ctl.learned import Chebyshev, Dictionary, Koopman, Network

# Rounding of a handful of operations.
EXACT = 1e-13
TIGHT = {"rtol": 1e-9, "atol": 1e-10}


def functions(kind=ca.SX):
    """x0' = x1, x1' = -k sin x0 + G u, y = (x0 u0, t x1), G a parameter vector of two."""
    t, x, u, p = kind.sym("t"), kind.sym("x", 2), kind.sym("u", 2), kind.sym("p", 3)
    return BlockFunctions(
        (Variable("angle", 0.1), Variable("rate")),
        (Variable("u[0]"), Variable("u[1]", 0.5)),
        (Variable("product"), Variable("late")),
        (Variable("k", 2.0), Variable("G[0]", 1.0), Variable("G[1]", -1.0)),
        ca.Function("dynamics", [t, x, u, p], [ca.vertcat(x[1], -p[0] * ca.sin(x[0]) + ca.dot(p[1:], u))]),
        ca.Function("output", [t, x, u, p], [ca.vertcat(x[0] * u[0], t * x[1])]),
    )


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_values_and_derivatives(kind):
    block = function_block(functions(kind), name="block")
    x, u = np.array([0.3, -0.7]), np.array([2.0, 3.0])
    np.testing.assert_allclose(block.dynamics(1.5, x, u), [-0.7, -2.0 * np.sin(0.3) - 1.0], rtol=EXACT)
    np.testing.assert_allclose(block.output(1.5, x, u), [0.6, -1.05], rtol=EXACT)
    for linear in (
        block.linearize(x, u, 1.5, {"k": 3.0}),
        ct.linearize(block, x, u, t=1.5, params={"k": 3.0}),
    ):
        np.testing.assert_allclose(linear.A, [[0.0, 1.0], [-3.0 * np.cos(0.3), 0.0]], atol=EXACT)
        np.testing.assert_allclose(linear.B, [[0.0, 0.0], [1.0, -1.0]], atol=EXACT)
        np.testing.assert_allclose(linear.C, [[2.0, 0.0], [0.0, 1.5]], atol=EXACT)
        np.testing.assert_allclose(linear.D, [[0.3, 0.0], [0.0, 0.0]], atol=EXACT)
        assert linear.state_labels == ["angle", "rate"]
        assert linear.name == "block$linearized"
    at_start = block.linearize()
    np.testing.assert_allclose(at_start.A[1, 0], -2.0 * np.cos(0.1), rtol=EXACT)
    np.testing.assert_array_equal(at_start.C, [[0.0, 0.0], [0.0, 0.0]])
    named = block.linearize(0.0, name="small", inputs=["a", "b"], copy_names=False)
    assert (named.name, named.input_labels, named.state_labels) == ("small", ["a", "b"], ["x[0]", "x[1]"])


def test_operating_point():
    """sin x0 = G u / k = 0.25 with the inputs held."""
    block = function_block(functions(), name="block")
    point = ct.find_operating_point(block, [0.1, 0.0], [1.0, 0.5])
    np.testing.assert_allclose(np.sin(point.states[0]), 0.25, atol=1e-6)
    np.testing.assert_allclose(block.linearize(point).A[1, 0], -2.0 * np.cos(point.states[0]), rtol=EXACT)


def test_parameters_by_every_name():
    block = function_block(functions(), name="block")
    zero, u = [0.0, 0.0], [2.0, 3.0]

    def rate(params):
        return float(block.dynamics(0.0, zero, u, params)[1])

    assert rate({}) == rate(None) == -1.0
    assert rate({"G": [10.0, 1.0]}) == 23.0
    assert rate({"G[1]": 1.0}) == 5.0
    assert rate({"G": 4.0}) == 20.0  # one number for all entries
    assert rate({"G": [10.0, 1.0], "block.G[0]": 0.0}) == 3.0  # the block's own name wins
    assert rate({"other.k": 7.0, "elsewhere": 1.0}) == -1.0  # of other blocks in the diagram
    with pytest.raises(ValueError, match="parameter 'G': expected 2 finite values"):
        rate({"G": [1.0, 2.0, 3.0]})
    with pytest.raises(ValueError, match="parameter 'k': expected 1 finite value"):
        rate({"k": np.nan})
    with pytest.raises(ValueError, match=r"unknown parameter of 'block': 'kk'.*did you mean 'k'"):
        block.linearize(params={"kk": 1.0})


def test_two_blocks_with_the_same_parameter_keep_their_own():
    """python-control merges ``params`` of a diagram's blocks under bare names; the last would win."""
    t, x, u, p = (ca.SX.sym(name, size) for name, size in (("t", 1), ("x", 0), ("u", 1), ("p", 1)))
    gains = [
        function_block(
            BlockFunctions(
                (),
                (Variable(f"u{i}"),),
                (Variable(f"y{i}"),),
                (Variable("k", value),),
                ca.Function("dynamics", [t, x, u, p], [ca.SX(0, 1)]),
                ca.Function("output", [t, x, u, p], [p * u]),
            ),
            name=name,
        )
        for i, (name, value) in enumerate([("a", 2.0), ("b", 5.0)])
    ]
    both = ct.interconnect(gains, inputs=["u0", "u1"], outputs=["y0", "y1"])
    assert both.output(0.0, [], [1.0, 1.0]).tolist() == [2.0, 5.0]
    assert both.output(0.0, [], [1.0, 1.0], {"a.k": 7.0}).tolist() == [7.0, 5.0]
    assert both.output(0.0, [], [1.0, 1.0], {"k": 7.0}).tolist() == [7.0, 7.0]
    assert both.output(0.0, [], [1.0, 1.0]).tolist() == [2.0, 5.0]


def test_copies_share_nothing_that_moves():
    block = function_block(functions(), name="block")
    twin = block.copy("twin")
    assert isinstance(twin, FunctionBlock)
    assert (twin.name, twin.functions is block.functions) == ("twin", True)
    before = block.output(0.0, [1.0, 0.0], [1.0, 0.0])
    twin.output(0.0, [5.0, 0.0], [5.0, 0.0])
    assert before.tolist() == [1.0, 0.0]
    twin.dynamics(0.0, [0.0, 0.0], [0.0, 0.0], {"k": 9.0})
    assert twin.updfcn.__self__ is twin
    np.testing.assert_allclose(
        block.dynamics(0.0, [0.5, 0.0], [0.0, 0.0]), [0.0, -2.0 * np.sin(0.5)], rtol=EXACT
    )


def test_simulates_in_python_control():
    """Small oscillation of x'' = -4 x: a cosine of 2 rad/s."""
    block = function_block(functions(), name="block")
    t = np.linspace(0.0, 3.0, 31)
    response = ct.input_output_response(
        block,
        t,
        np.zeros((2, 31)),
        [1e-5, 0.0],
        params={"k": 4.0},
        solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-14},
    )
    np.testing.assert_allclose(response.states[0], 1e-5 * np.cos(2.0 * t), atol=1e-11)


def test_bad_functions_are_refused():
    good = functions()
    short = BlockFunctions(
        good.states[:1], good.inputs, good.outputs, good.parameters, good.dynamics, good.output
    )
    with pytest.raises(ValueError, match=r"dynamics takes t, x, u, p of sizes \[1, 2, 2, 3\]"):
        function_block(short, name="block")
    t = ca.SX.sym("t")
    few = ca.Function("few", [t], [t])
    with pytest.raises(ValueError, match="output takes 1 arguments"):
        function_block(
            BlockFunctions(good.states, good.inputs, good.outputs, good.parameters, good.dynamics, few),
            name="b",
        )
    block = function_block(good, name="block")
    with pytest.raises(ValueError, match="x0: expected shape"):
        block.linearize([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match="u: expected 2 values, got 3"):
        block.output(0.0, [0.0, 0.0], [1.0, 2.0, 3.0])


def test_without_inputs():
    t, x, u, p = (ca.SX.sym(name, size) for name, size in (("t", 1), ("x", 1), ("u", 0), ("p", 0)))
    rate, output = ca.Function("d", [t, x, u, p], [-3.0 * x]), ca.Function("o", [t, x, u, p], [x])
    block = function_block(
        BlockFunctions((Variable("h", 1.0),), (), (Variable("h"),), (), rate, output), name="decay"
    )
    assert block.dynamics(0.0, block.start_state, []).tolist() == [-3.0]
    with pytest.raises(ValueError, match="decay has 0 inputs"):
        block.linearize()


def test_a_derivative_that_does_not_exist_is_named():
    t, x, u, p = (ca.SX.sym(name, size) for name, size in (("t", 1), ("x", 1), ("u", 1), ("p", 0)))
    block = function_block(
        BlockFunctions(
            (Variable("h"),),
            (Variable("inflow"),),
            (Variable("h"),),
            (),
            ca.Function("dynamics", [t, x, u, p], [u - ca.sqrt(x)]),
            ca.Function("output", [t, x, u, p], [x]),
        ),
        name="tank",
    )
    with pytest.raises(ValueError, match=r"tank: the derivative of d\(h\)/dt by h is not finite"):
        block.linearize([0.0])
    assert block.linearize([4.0]).A.item() == -0.25


RNG = np.random.default_rng(5)
Z = RNG.uniform(-2.0, 2.0, (200, 2))
F = np.column_stack([np.sin(Z[:, 0]) * Z[:, 1], Z[:, 0] ** 2])
LEARNED = {
    "chebyshev": Chebyshev(3, n_d=0, outside="extrapolate").fit(Z, F).model,
    "network": Network((6,), max_iterations=20).fit(Z, F).model,
    "koopman": Koopman(Dictionary(2, degree=3), 2, dt=0.01).fit(Z, F).model,
}


@pytest.mark.parametrize("kind", LEARNED)
def test_learned_block_is_the_model(kind):
    model = LEARNED[kind]
    block = learned_block(model)
    assert (block.nstates, block.dt, block.output_labels) == (0, None, ["f_theta[0]", "f_theta[1]"])
    expected = model.predict(Z[:50])
    ours = np.array([block.output(0.0, [], row) for row in Z[:50]])
    np.testing.assert_allclose(ours, expected, atol=1e-12 * np.abs(expected).max())
    # Linearised exactly: central differences agree to their own error.
    linear = block.linearize(u0=Z[3])
    step = 1e-6 * np.eye(2)
    slopes = (model.predict(Z[3] + step) - model.predict(Z[3] - step)) / 2e-6
    np.testing.assert_allclose(linear.D, slopes.T, atol=1e-7)


@pytest.mark.parametrize("sampled", [False, True])
def test_a_learned_model_in_a_diagram_with_its_filter(sampled):
    """f_theta = model(x) computed by a block, or beforehand: the same f_hat."""
    model = LEARNED["chebyshev"]
    filter = PhyFilter([400.0, 40.0])
    repair = phyfilter_block(filter.sampled(0.01) if sampled else filter, 2)
    learned = learned_block(model, inputs=["x[0]", "x[1]"])
    diagram = ct.interconnect(
        [learned, repair], inputs=repair.input_labels[:4], outputs=["f_hat[0]", "f_hat[1]"]
    )
    t = 0.01 * np.arange(101)
    x = np.stack([np.sin(3.0 * t), np.cos(2.0 * t)])
    known = np.vstack([x, np.zeros_like(x)])
    response = ct.input_output_response(diagram, t, known, solve_ivp_kwargs={} if sampled else TIGHT)
    given = np.vstack([known, model.predict(x.T).T])
    alone = ct.forced_response(repair, t, given)
    # Continuous: f_theta between samples is a straight line for one, the model of one for the other.
    np.testing.assert_allclose(response.outputs, alone.outputs, atol=1e-12 * 40 if sampled else 2e-3)


def test_bad_models_are_refused():
    with pytest.raises(TypeError, match="expected a learned model"):
        learned_block(lambda z: z)
    with pytest.raises(ValueError, match="fit"):
        learned_block(Chebyshev(2))
    with pytest.raises(ValueError, match="inputs: expected 2 labels, got 1"):
        learned_block(LEARNED["chebyshev"], inputs=["v"])
