"""Flattened diagrams against python-control, and against algebra by hand where python-control is wrong."""

import dataclasses
import pickle
import warnings

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from phyfilter_ctl import PhyFilter, phyfilter_block
from phyfilter_ctl.blocks import BlockFunctions
from phyfilter_ctl.diagram import FlatModel, flatten
from phyfilter_ctl.diagram.wiring import Rules, wire

ROUNDING = 1e-12  # both evaluate the same formulas; only the order of sums differs
DIFFERENCES = 1e-5  # python-control linearises by forward differences of step 1e-6
INTEGRATION = 1e-7  # two runs with relative tolerance 1e-10


def at(function, t, x, u, p, z=()):
    return np.asarray(function(t, x, u, p, z), dtype=float).reshape(-1)


def assert_same(sys, flat: FlatModel, *, points=5, p=None, params=None):
    rng = np.random.default_rng(3)
    p = flat.start_parameters() if p is None else p
    assert (len(flat.states), len(flat.inputs), len(flat.outputs)) == (sys.nstates, sys.ninputs, sys.noutputs)
    for _ in range(points):
        t, x, u = rng.uniform(0, 2), rng.normal(size=sys.nstates), rng.normal(size=sys.ninputs)
        for ours, theirs in ((flat.dynamics, sys.dynamics), (flat.output, sys.output)):
            expected = np.asarray(theirs(t, x, u) if params is None else theirs(t, x, u, params))
            np.testing.assert_allclose(at(ours, t, x, u, p), expected, rtol=ROUNDING, atol=ROUNDING)


def pendulum(name="pendulum", k=9.8, inputs="torque", outputs="angle"):
    def update(t, x, u, params):
        return [x[1], -params["k"] * np.sin(x[0]) - params.get("d", 0.1) * x[1] + u[0]]

    return ct.nlsys(
        update, lambda t, x, u, params: [x[0]], inputs=inputs, outputs=outputs, states=["q", "w"],
        params={"k": k, "d": 0.2}, name=name,
    )  # fmt: skip


def feedback(name="loop"):
    pid = ct.tf([4.0, 3.0], [0.05, 1.0], inputs="e", outputs="torque", name="pd")
    error = ct.summing_junction(["r", "-angle"], "e", name="error")
    return ct.interconnect([pendulum(), pid, error], inputs="r", outputs=["angle", "torque"], name=name)


def saturation(name, inputs, outputs):
    return ct.nlsys(None, lambda t, x, u, params: params["top"] * np.tanh(u / params["top"]), inputs=inputs,
                    outputs=outputs, params={"top": 2.0}, name=name)  # fmt: skip


def mimo_gain(D, name="mimo", dt=None):
    D = np.asarray(D, dtype=float)
    return ct.nlsys(
        None, lambda t, x, u, params: D @ u, inputs=D.shape[1], outputs=D.shape[0], name=name, dt=dt
    )


def nested():
    inner = feedback("inner")
    middle = ct.interconnect(
        [inner, saturation("sat", "v", "w")],
        connections=[["inner.r", "sat.w"]], inplist=["sat.v"], inputs="v", outlist=["inner.angle"], outputs="out",
        name="middle", ignore_outputs=["inner.torque"],
    )  # fmt: skip
    lag = ct.tf([1.0], [0.2, 1.0], inputs="s", outputs="v", name="lag")
    return ct.interconnect(
        [middle, lag], connections=[["middle.v", "lag.v", (0, 0, -0.3)]], inplist=[("lag", "s", 1.0)], inputs="s",
        outlist=["middle.out", ("lag", "v", -2.0)], outputs=["a", "b"], name="outer",
    )  # fmt: skip


def all_linear():
    plant = ct.ss([[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]],
                  inputs="f", outputs="y", name="plant")  # fmt: skip
    lead = ct.tf([3.0, 1.0], [0.1, 1.0], inputs="e", outputs="f", name="lead")
    return ct.interconnect([plant, lead, ct.summing_junction(["r", "-y"], "e", name="sum")], inputs="r", outputs="y",
                           name="linear")  # fmt: skip


def discrete(dt=0.1):
    plant = ct.ss([[0.9, 0.1], [0.0, 0.8]], [[0.0], [0.1]], [[1.0, 0.0]], [[0.0]], dt,
                  inputs="f", outputs="y", name="plant")  # fmt: skip
    law = ct.nlsys(lambda t, x, u, params: x + params["ki"] * u, lambda t, x, u, params: np.clip(x + 2 * u, -1, 1),
                   inputs="e", outputs="f", states="i", params={"ki": 0.3}, dt=dt, name="law")  # fmt: skip
    return ct.interconnect([plant, law, ct.summing_junction(["r", "-y"], "e", name="sum")], inputs="r",
                           outputs=["y", "f"], name="discrete")  # fmt: skip


def with_filter():
    mass = ct.nlsys(lambda t, x, u, params: (u[:1] - 0.4 * x * np.abs(x)) / params["m"], None, inputs=["f"],
                    outputs=["x[0]"], states=["v"], params={"m": 1.5}, name="mass")  # fmt: skip
    block = phyfilter_block(PhyFilter([60.0, 12.0]), 1, inertia=1.5)
    return ct.interconnect(
        [mass, block], inplist=[["mass.f", "phyfilter.g[0]"], "phyfilter.f_theta[0]"], inputs=["f", "f_theta"],
        connections=[["phyfilter.x[0]", "mass.x[0]"]],
        outlist=["phyfilter.f_hat[0]"], outputs="f_hat", name="estimate",
    )  # fmt: skip


ZOO = {
    "state space": lambda: ct.ss(
        [[-1.0, 2.0], [0.0, -3.0]], [[1.0], [0.5]], [[1.0, 1.0]], [[0.2]], name="plain"
    ),
    "transfer function": lambda: ct.tf([1.0, 3.0], [1.0, 2.0, 5.0], name="T"),
    "static gain": lambda: ct.ss([], [], [], [[2.0, -1.0], [0.0, 3.0]], name="K"),
    "nonlinear": pendulum,
    "feedback": feedback,
    "nested": nested,
    "all linear": all_linear,
    "discrete": discrete,
    "filter block": with_filter,
    "series": lambda: pendulum("a") * saturation("s", 1, 1),
    "parallel and gain": lambda: 3.0 * (pendulum("a") + pendulum("b")) * 0.5,
    "negative": lambda: -pendulum("a"),
    "feedback by method": lambda: pendulum("a").feedback(ct.tf([1.0], [1.0, 1.0]), sign=-1),
}


@pytest.mark.parametrize("name", ZOO)
def test_same_functions_as_python_control(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        sys = ZOO[name]()
    flat = flatten(sys)
    assert_same(ct.tf2ss(sys) if isinstance(sys, ct.TransferFunction) else sys, flat)
    assert flat.dynamics.is_a("SXFunction")
    assert flat.output.is_a("SXFunction")
    assert flat.dt == (sys.dt or 0.0)


@pytest.mark.parametrize(
    "name", ["nonlinear", "feedback", "nested", "all linear", "discrete", "filter block"]
)
def test_same_linearisation_as_python_control(name):
    sys = ZOO[name]()
    rng = np.random.default_rng(5)
    x, u = rng.normal(size=sys.nstates), rng.normal(size=sys.ninputs)
    ours, theirs = flatten(sys).linearize(x, u), sys.linearize(x, u)
    for letter in "ABCD":
        np.testing.assert_allclose(
            getattr(ours, letter), getattr(theirs, letter), atol=DIFFERENCES, rtol=DIFFERENCES
        )
    assert ours.dt == theirs.dt
    assert ours.input_labels == sys.input_labels


def test_same_time_response_as_python_control():
    sys, flat = feedback(), flatten(feedback())
    time = np.linspace(0.0, 3.0, 61)
    theirs = ct.input_output_response(
        sys, time, np.ones((1, 61)), [0.1, 0.0, 0.0], solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12}
    )
    p = flat.start_parameters()
    ours = solve_ivp(lambda t, x: at(flat.dynamics, t, x, [1.0], p), (0, 3), [0.1, 0.0, 0.0], t_eval=time, rtol=1e-10,
                     atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(ours.y, np.asarray(theirs.states), atol=INTEGRATION)


def test_names_are_paths():
    flat = flatten(nested())
    assert [v.name for v in flat.states] == [
        "middle.inner.pendulum.q", "middle.inner.pendulum.w", "middle.inner.pd.x[0]", "lag.x[0]",
    ]  # fmt: skip
    assert [v.name for v in flat.parameters] == [
        "middle.inner.pendulum.k", "middle.inner.pendulum.d", "middle.sat.top",
    ]  # fmt: skip
    assert [v.name for v in flat.inputs] == ["s"]
    assert [v.name for v in flat.outputs] == ["a", "b"]
    assert [v.name for v in flatten(pendulum()).states] == ["q", "w"]
    assert flatten(nested(), name="x").name == "x"


def test_parameters_are_the_blocks_own():
    """python-control merges: both blocks get the k of the last. Each on its own says what is right."""
    a, b = pendulum("a", 2.0, "u", "y"), pendulum("b", 5.0, "y", "z")
    sys = ct.interconnect([a, b], inputs="u", outputs="z", name="two")
    flat = flatten(sys)
    assert dict(zip([v.name for v in flat.parameters], flat.start_parameters(), strict=True)) == {
        "a.k": 2.0, "a.d": 0.2, "b.k": 5.0, "b.d": 0.2,
    }  # fmt: skip
    x, u = np.array([0.3, -0.2, 0.7, 0.1]), np.array([0.4])
    expected = np.concatenate([a.dynamics(0, x[:2], u), b.dynamics(0, x[2:], a.output(0, x[:2], u))])
    np.testing.assert_allclose(at(flat.dynamics, 0, x, u, flat.start_parameters()), expected, rtol=ROUNDING)
    assert not np.allclose(sys.dynamics(0, x, u), expected), "python-control no longer merges parameters"
    assert_same(sys, flat, p=flat.start_parameters({"a.k": 5.0}))


def test_parameters_set_on_the_diagram_go_to_all_its_blocks():
    a, b = pendulum("a", 2.0, "u", "y"), pendulum("b", 5.0, "y", "z")
    gain = ct.nlsys(
        None, lambda t, x, u, params: params.get("gain", 1.0) * u, inputs="z", outputs="out", name="g"
    )
    sys = ct.interconnect([a, b, gain], inputs="u", outputs="out", params={"k": 3.0, "gain": 4.0}, name="set")
    flat = flatten(sys)
    values = dict(zip([v.name for v in flat.parameters], flat.start_parameters(), strict=True))
    assert values == {"a.k": 3.0, "a.d": 0.2, "b.k": 3.0, "b.d": 0.2, "g.gain": 4.0}
    assert_same(sys, flat)
    assert_same(sys, flat, p=flat.start_parameters({"a.k": 7.0, "b.k": 7.0}), params={"k": 7.0})


def test_array_and_other_parameters():
    def update(t, x, u, params):
        matrix, gains = params["matrix"], params["gains"]
        return params["sign"] * (matrix @ x) + gains[0] * u[0] ** params["power"] + np.sum(params["offsets"])

    sys = ct.nlsys(update, None, inputs=1, outputs=2, states=2, name="arrays",
                   params={"matrix": np.array([[0.0, 1.0], [-2.0, -3.0]]), "gains": [2.0, 5.0], "sign": -1.0,
                           "power": 3, "offsets": np.array([0.5, 0.25, 1.0]), "mode": "fast"})  # fmt: skip
    flat = flatten(sys)
    names = [v.name for v in flat.parameters]
    assert names[:6] == ["matrix[0,0]", "matrix[0,1]", "matrix[1,0]", "matrix[1,1]", "gains[0]", "gains[1]"]
    assert names[6:] == ["sign", "power", "offsets[0]", "offsets[1]", "offsets[2]"]
    assert_same(sys, flat)
    changed = {"matrix": np.array([[1.0, 2.0], [3.0, 4.0]]), "gains": [1.0, 1.0], "sign": 2.0, "power": 2}
    p = flat.start_parameters({"matrix": changed["matrix"], "gains": [1.0, 1.0], "sign": 2.0, "power": 2.0})
    assert_same(sys, flat, p=p, params=changed)


def test_integers_that_must_be_numbers_stay_constants():
    def update(t, x, u, params):
        return sum(params["c"] * u[0] ** i for i in range(params["terms"])) - x

    sys = ct.nlsys(update, None, inputs=1, outputs=1, states=1, params={"c": 2, "terms": 3}, name="sum")
    flat = flatten(sys)
    assert [v.name for v in flat.parameters] == ["c"]
    assert_same(sys, flat)


@pytest.mark.parametrize(
    "update",
    [
        lambda t, x, u, params: np.clip(x, -0.5, 0.5) + np.where(u > 0, u, 0.1 * u),  # columns only
        lambda t, x, u, params: [x @ x, *x[1:]],  # object arrays only
        lambda t, x, u, params: np.array([np.hypot(x[0], x[1]), np.arctan2(x[0], 2 + x[1] ** 2) + u[1]]),
        lambda t, x, u, params: np.cross([x[0], x[1], 1.0], [u[0], u[1], t])[:2],
        lambda t, x, u, params: np.maximum(x, u) * np.sign(x),
        lambda t, x, u, params: [np.linalg.norm(x), np.interp(u[0], [-1.0, 0.0, 2.0], [0.0, 1.0, 0.0])],
        lambda t, x, u, params: np.array([[np.cos(x[0]), -np.sin(x[0])], [np.sin(x[0]), np.cos(x[0])]]) @ u,
        lambda t, x, u, params: [abs(x[0]) * np.exp(-t), np.log(1 + x[1] ** 2) + np.sqrt(u[0])],
    ],
    ids=["clip", "dot", "atan2", "cross", "maximum", "interp", "rotation", "sqrt of a negative"],
)
def test_ways_of_writing_a_function(update):
    sys = ct.nlsys(update, None, inputs=2, outputs=2, states=2, name="block")
    flat = flatten(sys)
    rng = np.random.default_rng(8)
    for _ in range(20):
        t, x, u = rng.uniform(0, 1), rng.normal(size=2), np.abs(rng.normal(size=2)) * [1, -1]
        np.testing.assert_allclose(
            at(flat.dynamics, t, x, u, []), sys.dynamics(t, x, u), rtol=1e-10, atol=ROUNDING
        )


def test_legal_path_that_crosses_one_block_twice():
    """u -> m[0] -> gain -> m[1]: python-control sees a loop, the block algebra does not."""
    D = [[2.0, 0.0], [0.0, 3.0]]
    sys = ct.InterconnectedSystem(
        [mimo_gain(D), ct.ss([], [], [], [[-0.5]], name="k")],
        connections=[[(1, 0), (0, 0)], [(0, 1), (1, 0)]], inplist=[(0, 0)], outlist=[(0, 1)], inputs="u", outputs="y",
        name="twice",
    )  # fmt: skip
    flat = flatten(sys)
    assert at(flat.output, 0, [], [1.0], []).tolist() == [2.0 * -0.5 * 3.0]
    chain = ct.InterconnectedSystem(
        [mimo_gain(np.diag([2.0, 3.0, 5.0, 7.0]))],
        connections=[[(0, 1), (0, 0)], [(0, 2), (0, 1)], [(0, 3), (0, 2)]], inplist=[(0, 0)], outlist=[(0, 3)],
        inputs="u", outputs="y", name="four",
    )  # fmt: skip
    with pytest.raises(RuntimeError, match="algebraic loop"):
        chain.output(0, [], [1.0])
    assert at(flatten(chain).output, 0, [], [1.0], []).tolist() == [210.0]


def test_block_that_is_infinite_at_rest():
    """1 / u is infinite until the gain before it has been evaluated; python-control takes that for a loop."""
    inverse = ct.nlsys(None, lambda t, x, u, params: 1.0 / u, inputs="v", outputs="y", name="inverse")
    offset = ct.nlsys(None, lambda t, x, u, params: u - u**2, inputs="u", outputs="v", name="gain")
    sys = ct.interconnect([inverse, offset], inputs="u", outputs="y", name="late")
    with np.errstate(all="ignore"), pytest.raises(RuntimeError, match="algebraic loop"):
        sys.output(0, [], [0.5])
    flat = flatten(sys)
    assert at(flat.output, 0, [], [0.5], []).tolist() == [4.0]


def test_chained_static_blocks_are_evaluated_once():
    calls = []

    def counted(i):
        def output(t, x, u, params):
            calls.append(i)
            return np.sin(u)

        return ct.nlsys(None, output, inputs="u", outputs="y", name=f"b{i}")

    sys = ct.InterconnectedSystem(
        [counted(i) for i in reversed(range(10))],
        connections=[[(9 - i, 0), (10 - i, 0)] for i in range(1, 10)], inplist=[(9, 0)], outlist=[(0, 0)],
        inputs="u", outputs="y", name="chain",
    )  # fmt: skip
    calls.clear()
    theirs = sys.output(0, [], [0.7])
    assert len(calls) > 50, "python-control got better"
    flat = flatten(sys)
    assert flat.output.n_instructions() == 10 + 2  # ten sines, one load, one store
    np.testing.assert_allclose(at(flat.output, 0, [], [0.7], []), theirs, rtol=ROUNDING)
    assert flat.order == tuple(f"b{i}" for i in range(10))


def test_all_linear_diagram_keeps_its_blocks():
    sys = all_linear()
    assert isinstance(sys, ct.StateSpace)
    flat = flatten(sys)
    assert [v.name for v in flat.states] == ["plant.x[0]", "plant.x[1]", "lead.x[0]"]
    assert flat.is_linear


def test_feedthrough_per_channel():
    D = np.array([[0.0, 2.0, 0.0], [1.0, 0.0, 0.0]])
    flat = flatten(ct.ss(-np.eye(2), np.ones((2, 3)), np.eye(2), D, name="d"))
    assert np.array_equal(flat.feedthrough, D != 0.0)


def test_duplicate_names_are_numbered():
    one, two = pendulum("same"), pendulum("same", 3.0)
    with pytest.warns(UserWarning, match="duplicate name"):
        sys = ct.interconnect([one, two], connections=[[(1, 0), (0, 0)]], inplist=[(0, 0)], outlist=[(1, 0)],
                              name="dup")  # fmt: skip
    flat = flatten(sys)
    assert [v.name for v in flat.states] == ["same.q", "same.w", "same_1.q", "same_1.w"]
    assert flat.start_parameters()[[0, 2]].tolist() == [9.8, 3.0]


def test_system_with_functions_is_taken_as_it_is():
    functions = flatten(pendulum("inner"))
    ready = ct.nlsys(None, lambda t, x, u, params: u, inputs="torque", outputs="angle", name="ready",
                     params={"k": 4.0})  # fmt: skip
    ready.functions = BlockFunctions(
        functions.states, functions.inputs, functions.outputs, functions.parameters,
        *(flat_function(functions, which) for which in ("dynamics", "output")),
    )  # fmt: skip
    flat = flatten(ready)
    assert [v.name for v in flat.states] == ["q", "w"]
    assert flat.start_parameters().tolist() == [4.0, 0.2], "python-control's params dict goes over the start"
    assert_same(pendulum(k=4.0), flat)


def flat_function(flat, which):
    import casadi as ca

    t, x, u, p = (
        ca.SX.sym(n, k) for n, k in zip("txup", (1, len(flat.states), 1, len(flat.parameters)), strict=True)
    )
    return ca.Function(which, [t, x, u, p], [getattr(flat, which)(t, x, u, p, [])])


def test_cost_is_linear_in_blocks():
    """Instructions and wires, which say it without a clock."""
    sizes = {}
    for n in (50, 100):
        parts = [
            ct.ss([[-1.0]], [[1.0]], [[1.0]], [[0.5]], inputs="u", outputs="y", name=f"b{i}")
            for i in range(n)
        ]
        sys = ct.InterconnectedSystem(
            parts, connections=[[(i, 0), (i - 1, 0)] for i in range(1, n)], inplist=[(0, 0)], outlist=[(n - 1, 0)],
            inputs="u", outputs="y", name="chain",
        )  # fmt: skip
        sizes[n] = flatten(sys).dynamics.n_instructions(), len(wire(sys, {}, Rules("error")).names)
    assert sizes[100][0] <= 2.1 * sizes[50][0]
    assert sizes[100][1] <= 2 * sizes[50][1]


@st.composite
def linear_diagrams(draw):
    """Random blocks, wired at random with gains; D kept small so that loops are solvable."""
    seed = draw(st.integers(0, 2**32 - 1))
    return seed, draw(st.integers(1, 5)), draw(st.booleans())


@settings(max_examples=40, deadline=None)
@given(linear_diagrams())
def test_random_linear_diagrams_against_block_algebra(case):
    """y = C x + D v, v = K y + L u eliminated with one dense solve."""
    seed, count, loops = case
    rng = np.random.default_rng(seed)
    parts, A, B, C, D = [], [], [], [], []
    for i in range(count):
        n, m, k = rng.integers(0, 4), rng.integers(1, 4), rng.integers(1, 4)
        through = 0.2 * rng.normal(size=(k, m)) * (rng.random((k, m)) < 0.5)
        matrices = rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(k, n)), through
        parts.append(ct.StateSpace(*matrices, 0, name=f"b{i}", remove_useless_states=False))
        for store, M in zip((A, B, C, D), matrices, strict=True):
            store.append(M)
    A, B, C, D = (block(M) for M in (A, B, C, D))
    K = rng.normal(size=(B.shape[1], C.shape[0])) * (rng.random((B.shape[1], C.shape[0])) < 0.3)
    if not loops:
        owners_in = np.repeat(range(count), [p.ninputs for p in parts])
        owners_out = np.repeat(range(count), [p.noutputs for p in parts])
        K *= owners_in[:, None] > owners_out[None, :]
    L, M = rng.normal(size=(B.shape[1], 2)), rng.normal(size=(2, C.shape[0] + B.shape[1]))
    sys = ct.InterconnectedSystem(parts, inplist=[(0, 0), (0, 0)], outlist=[(0, 0), (0, 0)], inputs=2, outputs=2,
                                  name="random")  # fmt: skip
    sys.set_connect_map(K)
    sys.set_input_map(L)
    sys.set_output_map(M)
    flat = flatten(sys)
    x, u = rng.normal(size=len(A)), rng.normal(size=2)
    y = np.linalg.solve(np.eye(len(D)) - D @ K, C @ x + D @ (L @ u))
    v = K @ y + L @ u
    scale = 1.0 + np.linalg.cond(np.eye(len(D)) - D @ K)
    np.testing.assert_allclose(at(flat.dynamics, 0, x, u, []), A @ x + B @ v, atol=1e-12 * scale, rtol=1e-10)
    np.testing.assert_allclose(at(flat.output, 0, x, u, []), M @ [*y, *v], atol=1e-12 * scale, rtol=1e-10)


def block(matrices):
    result = np.zeros((sum(M.shape[0] for M in matrices), sum(M.shape[1] for M in matrices)))
    row = column = 0
    for M in matrices:
        result[row : row + M.shape[0], column : column + M.shape[1]] = M
        row, column = row + M.shape[0], column + M.shape[1]
    return result


def test_a_filter_is_a_block_like_any_other():
    """flatten takes F, and what python-control makes of 1 - F."""
    F = PhyFilter([400.0, 28.0], [400.0, 10.0])
    s = 3.0j
    assert flatten(F).linearize()(s) == pytest.approx(F(s), rel=1e-12)
    assert flatten(1.0 - F).linearize()(s) == pytest.approx(1.0 - F(s), rel=1e-9)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_one_linear_system_has_functions_when_they_are_asked_for(dt):
    """By themselves, pickled, and as a block of a diagram."""
    rng = np.random.default_rng(8)
    A, B, C, D = (rng.normal(size=shape) for shape in ((4, 4), (4, 2), (3, 4), (3, 2)))
    system = ct.ss(A, B, C, D, dt, name="box", inputs=["a", "b"], outputs=3)
    alone = flatten(system)
    inside = flatten(ct.InterconnectedSystem([system], inplist=[(0, 0), (0, 1)], outlist=[(0, 0), (0, 1), (0, 2)],
                                             inputs=2, outputs=3, dt=dt, name="around"))  # fmt: skip
    x, u = rng.normal(size=4), rng.normal(size=2)
    for flat in (
        alone,
        pickle.loads(pickle.dumps(flatten(system))),
        dataclasses.replace(alone, name="other"),
        inside,
    ):
        np.testing.assert_allclose(at(flat.dynamics, 0.0, x, u, []), A @ x + B @ u, rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(at(flat.output, 0.0, x, u, []), C @ x + D @ u, rtol=1e-13, atol=1e-13)
    assert [v.name for v in alone.states] == system.state_labels
    assert [v.name for v in (*alone.inputs, *alone.outputs)] == [*system.input_labels, *system.output_labels]
    assert (alone.order, alone.dt, alone.is_linear) == (("box",), dt, True)
