"""Plants from equations written once: values, names, units, exact derivatives, and what is refused."""

import math

import casadi as ca
import control as ct
import numpy as np
import pytest

from phyfilter_ctl.plants import Plant, cross, norm, plant, stack, where

# Rounding of a handful of operations.
EXACT = 1e-13


def vehicle(t, x, u, p):
    """Every shape at once: scalar, vector and matrix states, inputs and parameters."""
    return (
        {
            "v": p.J @ x.v + u.force * p.gain - norm(x.v) * x.v,
            "heat": -x.heat + t,
            "R": x.R @ p.J + u.scale * x.R,
        },
        {"power": x.v.T @ u.force, "v": x.v, "turned": x.R @ x.v, "both": stack(x.heat, x.v)},
    )


STATES = {"v": ([1.0, -2.0], "m/s", "velocity"), "heat": (0.5, "J"), "R": np.eye(2)}
INPUTS = {"force": (np.zeros(2), "N"), "scale": 1.0}
PARAMETERS = {"J": ([[1.0, 2.0], [3.0, 4.0]], "1/s"), "gain": (2.0, "1/kg")}
OUTPUTS = {"power": ("W", "into the body"), "v": "m/s", "turned": "", "both": ""}


def make():
    return plant(vehicle, states=STATES, inputs=INPUTS, outputs=OUTPUTS, params=PARAMETERS)


def by_numpy(t, x, u, J=((1.0, 2.0), (3.0, 4.0)), gain=2.0):
    v, heat, R = x[:2], x[2], x[3:].reshape(2, 2)
    force, J = u[:2], np.array(J)
    dv = J @ v + force * gain - np.linalg.norm(v) * v
    dx = np.concatenate([dv, [t - heat], (R @ J + u[2] * R).ravel()])
    return dx, np.concatenate([[v @ force], v, R @ v, [heat], v])


def test_values_names_and_units():
    block = make()
    assert block.name == "vehicle"
    assert block.state_labels == ["v[0]", "v[1]", "heat", "R[0,0]", "R[0,1]", "R[1,0]", "R[1,1]"]
    assert block.input_labels == ["force[0]", "force[1]", "scale"]
    assert block.output_labels[:5] == ["power", "v[0]", "v[1]", "turned[0]", "turned[1]"]
    assert list(block.parameters) == ["J[0,0]", "J[0,1]", "J[1,0]", "J[1,1]", "gain"]
    assert [entry.unit for entry in block.functions.states[:3]] == ["m/s", "m/s", "J"]
    assert (block.functions.outputs[0].unit, block.functions.outputs[0].description) == ("W", "into the body")
    assert block.functions.outputs[1].description == "velocity"  # as the state of that name
    np.testing.assert_array_equal(block.start_state, [1.0, -2.0, 0.5, 1.0, 0.0, 0.0, 1.0])
    rng = np.random.default_rng(2)
    for _ in range(5):
        t, x, u = float(rng.normal()), rng.normal(size=7), rng.normal(size=3)
        dx, y = by_numpy(t, x, u)
        np.testing.assert_allclose(block.dynamics(t, x, u), dx, atol=EXACT)
        np.testing.assert_allclose(block.output(t, x, u), y, atol=EXACT)
        J = rng.normal(size=(2, 2))
        dx, _ = by_numpy(t, x, u, J, 0.3)
        np.testing.assert_allclose(block.dynamics(t, x, u, {"J": J, "gain": 0.3}), dx, atol=EXACT)
        changed = block.with_parameters({"J": J, "gain": 0.3})
        assert isinstance(changed, Plant)
        np.testing.assert_allclose(changed.dynamics(t, x, u), dx, atol=EXACT)


def test_survives_copying_and_linearises_exactly():
    block = make().copy("twin")
    assert isinstance(block, Plant)
    assert block.functions.states[0].unit == "m/s"
    x, u = np.random.default_rng(3).normal(size=(2, 7))
    linear = ct.linearize(block, x, u[:3], t=0.7)
    assert linear.state_labels == block.state_labels
    # Complex step through the numpy equations: exact to rounding, by a route of its own.
    A = np.zeros((7, 7))
    B = np.zeros((7, 3))
    for i in range(7):
        A[:, i] = complex_rate(x + 1e-200j * np.eye(7)[i], u[:3] + 0j)
    for i in range(3):
        B[:, i] = complex_rate(x + 0j, u[:3] + 1e-200j * np.eye(3)[i])
    np.testing.assert_allclose(linear.A, A, atol=10 * EXACT)
    np.testing.assert_allclose(linear.B, B, atol=10 * EXACT)


def complex_rate(x, u):
    v, heat, R = x[:2], x[2], x[3:].reshape(2, 2)
    J = np.array([[1.0, 2.0], [3.0, 4.0]])
    dv = J @ v + u[:2] * 2.0 - np.sqrt(v @ v) * v
    return np.concatenate([dv, [-heat], (R @ J + u[2] * R).ravel()]).imag / 1e-200


def test_drag_at_rest_linearises():
    block = make()
    x = block.start_state
    x[:2] = 0.0
    np.testing.assert_allclose(block.linearize(x).A[:2, :2], [[1.0, 2.0], [3.0, 4.0]], atol=EXACT)


def test_states_are_the_outputs_where_none_are_given():
    lag = plant(
        lambda t, x, u, p: {"y": [u.u - x.y[0], x.y[0]]},
        states={"y": [0.0, 0.0]},
        inputs={"u": 0.0},
        name="lag",
    )
    assert lag.output_labels == ["y[0]", "y[1]"]
    assert lag.dynamics(0.0, [1.0, 2.0], [5.0]).tolist() == [4.0, 1.0]


def test_outputs_may_be_chosen_by_name():
    block = plant(vehicle, states=STATES, inputs=INPUTS, outputs=["turned", "power"], params=PARAMETERS)
    assert block.output_labels == ["turned[0]", "turned[1]", "power"]
    x, u = np.random.default_rng(4).normal(size=(2, 7))
    _, y = by_numpy(0.0, x, u[:3])
    np.testing.assert_allclose(block.output(0.0, x, u[:3]), y[[3, 4, 0]], atol=EXACT)


def test_a_static_and_a_discrete_one():
    static = plant(
        lambda t, x, u, p: ({}, {"y": where(u.u > 0.0, u.u, 0.1 * u.u)}),
        states={},
        inputs={"u": 0.0},
        name="leaky",
    )
    assert (static.nstates, static(2.0).item(), static(-2.0).item()) == (0, 2.0, -0.2)
    counter = plant(
        lambda t, x, u, p: {"n": x.n + u.step},
        states={"n": 3.0},
        inputs={"step": 1.0},
        name="counter",
        dt=0.1,
    )
    response = ct.input_output_response(counter, 0.1 * np.arange(4), np.ones(4), counter.start_state)
    assert response.outputs.tolist() == [3.0, 4.0, 5.0, 6.0]


def test_numpy_elementwise_functions_and_lists_of_lists():
    def rotation(t, x, u, p):
        R = [[np.cos(x.a), -np.sin(x.a)], [np.sin(x.a), np.cos(x.a)]]
        return {"a": 1.0}, {"R": R, "peak": np.exp(x.a)}

    block = plant(rotation, states={"a": 0.3}, inputs={"none": 0.0})
    c, s = np.cos(0.3), np.sin(0.3)
    assert block.output_labels == ["R[0,0]", "R[0,1]", "R[1,0]", "R[1,1]", "peak"]
    np.testing.assert_allclose(block.output(0.0, [0.3], [0.0]), [c, -s, s, c, np.exp(0.3)], rtol=EXACT)


def test_in_a_diagram_of_python_control():
    """v' = u - v, u = k (r - v): v goes to k/(1 + k), and exactly as exp(-(1 + k) t)."""
    lag = plant(
        lambda t, x, u, p: {"v": u.u - x.v}, states={"v": (0.0, "m/s")}, inputs={"u": 0.0}, name="lag"
    )
    gain = ct.ss([], [], [], [[4.0, -4.0]], inputs=["r", "v"], outputs="u", name="gain")
    loop = ct.interconnect([lag, gain], inputs="r", outputs="v")
    t = np.linspace(0.0, 1.0, 11)
    response = ct.input_output_response(loop, t, np.ones(11), solve_ivp_kwargs={"rtol": 1e-10, "atol": 1e-12})
    np.testing.assert_allclose(response.outputs, 0.8 * (1.0 - np.exp(-5.0 * t)), atol=1e-9)
    assert ct.linearize(loop, [0.0], [0.0]).A.item() == pytest.approx(-5.0, abs=1e-6)


def simple(**changes):
    arguments = {"states": {"v": ([0.0, 0.0], "m/s")}, "inputs": {"u": 0.0}, "params": {"m": (1.0, "kg")}}
    return arguments | changes


def branching(t, x, u, p):
    return {"v": x.v if x.v[0] > 0.0 else -x.v}


def by_math(t, x, u, p):
    return {"v": stack(math.sin(x.v[0]), 0.0)}


def assigned(t, x, u, p):
    dv = np.zeros(2)
    dv[0] = x.v[1]
    return {"v": dv}


@pytest.mark.parametrize(
    ("equations", "changes", "message"),
    [
        (lambda t, x, u, p: {}, {}, "no derivative of the state 'v'"),
        (lambda t, x, u, p: {"v": x.v, "w": x.v}, {}, "unknown state among the derivatives: 'w'"),
        (lambda t, x, u, p: {"v": x.v[0]}, {}, r"derivative of 'v': expected shape \(2,\).*got \(1, 1\)"),
        (lambda t, x, u, p: {"v": x.v.T}, {}, r"expected shape \(2,\).*got \(1, 2\)"),
        (lambda t, x, u, p: {"v": "fast"}, {}, "derivative of 'v': expected a number, a CasADi column"),
        (lambda t, x, u, p: {"v": ca.MX.sym("m", 2)}, {}, "got MX"),
        (lambda t, x, u, p: {"v": ca.SX.sym("m", 2)}, {}, "symbols of another model: m_0"),
        (lambda t, x, u, p: 3.0, {}, "return a dict of derivatives"),
        (lambda t, x, u, p: ({}, {}, {}), {}, "return a dict of derivatives"),
        (lambda t, x, u, p: {"v": x.velocity}, {}, "unknown state: 'velocity'; expected one of v"),
        (lambda t, x, u, p: {"v": x.v * p.mm}, {}, "unknown parameter: 'mm'.*did you mean 'm'"),
        (lambda t, x, u, p: {"v": u.missing}, {}, "unknown input: 'missing'"),
        (lambda t, x, u, p: {"v": cross(x.v, x.v)}, {}, "equations failed on CasADi columns"),
        (branching, {}, "branching: the equations failed.*`if` on a state"),
        (by_math, {}, "by_math: derivative of 'v' lost its symbols and became NaN.*math.sin"),
        (assigned, {}, "assigned: derivative of 'v' lost its symbols"),
        (lambda t, x, u, p: {"v": x.v}, {"states": {"v": np.nan}}, "states: v: expected finite values"),
        (
            lambda t, x, u, p: {"v": x.v},
            {"states": {"v": ("fast", "m/s")}},
            "states: v: expected a number or an array",
        ),
        (lambda t, x, u, p: {"v": x.v}, {"states": {"v": (0.0, "m", "x", 3)}}, "states: v: expected start"),
        (lambda t, x, u, p: {"v": x.v}, {"states": {"v": np.zeros((2, 2, 2))}}, "at most two dimensions"),
        (lambda t, x, u, p: {"v": x.v}, {"states": ["v"]}, "states: expected a dict"),
        (lambda t, x, u, p: {"v": x.v}, {"inputs": {"for": 0.0}}, "inputs: 'for' cannot be written"),
        (lambda t, x, u, p: {"v": x.v}, {"params": {"_m": 0.0}}, "params: '_m' cannot be written"),
        (lambda t, x, u, p: {"v": x.v}, {"outputs": {"w": "m"}}, "unknown output: 'w'; expected one of v"),
        (lambda t, x, u, p: {"v": x.v}, {"outputs": "v"}, "got the text 'v'"),
        (lambda t, x, u, p: ({"v": x.v}, {"a b": x.v}), {}, "outputs: 'a b' cannot be written"),
    ],
)
def test_bad_equations_are_refused(equations, changes, message):
    with pytest.raises((ValueError, TypeError), match=message):
        plant(equations, **simple(**changes))


def test_parameters_are_checked():
    with pytest.raises(ValueError, match=r"unknown parameter of 'vehicle': 'gian'.*did you mean 'gain'"):
        make().with_parameters({"gian": 1.0})
    with pytest.raises(ValueError, match="parameter 'J': expected 4 finite values"):
        make().with_parameters({"J": [1.0, 2.0]})
    table = make().describe()
    assert "parameter  gain" in table
    assert "W       into the body" in table
