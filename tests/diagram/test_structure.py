"""Affine, curved, switching: what the instructions say, against what systems were made to be."""

import casadi as ca
import control as ct
import numpy as np
import pytest

import phyfilter_ctl as pf
from phyfilter_ctl.diagram.structure import is_affine, structure_of
from phyfilter_ctl.diagram.switches import located

SIGNALS = (0, 1, 2, 4)


def flat(law, states=1, inputs=0, **more):
    return pf.flatten(ct.nlsys(law, None, inputs=inputs, outputs=states, states=states, name="s", **more))


TABLE = np.array([1.0, 2.0, 5.0, 1.0])
# Law, states; whether it is affine; how many switches jump.
SYSTEMS = {
    "lag": (lambda t, x, u, p: [-2.0 * x[0] + 1.0], 1, True, 0),
    "oscillator": (lambda t, x, u, p: [x[1], -x[0]], 2, True, 0),
    "ramp": (lambda t, x, u, p: [t - x[0]], 1, True, 0),
    "if": (lambda t, x, u, p: [1.0 if x[0] < 1 else 2.0], 1, False, 1),
    "where": (lambda t, x, u, p: np.where(x < 1, 1.0, 2.0), 1, False, 1),
    "sign": (lambda t, x, u, p: [-np.sign(x[0])], 1, False, 1),
    "floor": (lambda t, x, u, p: [1.0 + np.floor(x[0])], 1, False, 1),
    "ceil": (lambda t, x, u, p: [1.0 + np.ceil(x[0])], 1, False, 1),
    "round": (lambda t, x, u, p: [1.0 + round(x[0])], 1, False, 1),
    "mod": (lambda t, x, u, p: [1.0 + np.mod(x[0], 1.0)], 1, False, 1),
    "fmod": (lambda t, x, u, p: [1.0 + np.fmod(x[0], 1.0)], 1, False, 1),
    "at least": (lambda t, x, u, p: [1.0 + (x[0] >= 1)], 1, False, 1),
    "step in time": (lambda t, x, u, p: [1.0 if t < 1 else 2.0], 1, False, 1),
    "square wave": (lambda t, x, u, p: [np.sign(np.sin(t)) - x[0]], 1, False, 1),
    "both": (lambda t, x, u, p: [x[1], 1.0 if x[0] > 0 and x[1] > 0 else 0.0], 2, False, 2),
    "dry friction": (lambda t, x, u, p: [x[1], -x[0] - 0.1 * np.sign(x[1])], 2, False, 1),
    "abs": (lambda t, x, u, p: [-abs(x[0])], 1, False, 0),
    "limiter": (lambda t, x, u, p: [-np.clip(x[0], -1.0, 1.0)], 1, False, 0),
    "if that bends": (lambda t, x, u, p: [-x[0] if x[0] > 0 else -2.0 * x[0]], 1, False, 0),
    "interpolation": (lambda t, x, u, p: [np.interp(x[0], [0.0, 1.0, 2.0], [1.0, 3.0, 0.0])], 1, False, 0),
    "pendulum": (lambda t, x, u, p: [x[1], -np.sin(x[0])], 2, False, 0),
    "bilinear": (lambda t, x, u, p: [x[0] * x[1], -x[1]], 2, False, 0),
    "drag": (lambda t, x, u, p: [-x[0] * abs(x[0])], 1, False, 0),
    "quotient": (lambda t, x, u, p: [1.0 / (2.0 + x[0])], 1, False, 0),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_what_systems_are(name):
    law, states, affine, jumps = SYSTEMS[name]
    model = flat(law, states)
    assert is_affine(model.dynamics, SIGNALS) is affine
    assert sum(event.switch for event in located(model).events) == jumps
    assert (located(model) is model) == (jumps == 0)


@pytest.mark.parametrize("name", SYSTEMS)
def test_frozen_at_its_own_positions_it_is_the_function(name):
    law, states, _, _ = SYSTEMS[name]
    dynamics = flat(law, states).dynamics
    found = structure_of(dynamics, SIGNALS)
    symbols, values = [], []
    for switch in found.switches:
        values.append(ca.substitute([switch.now], symbols, values)[0] if symbols else switch.now)
        symbols.append(switch.position)
    results = ca.substitute(found.results, symbols, values) if symbols else found.results
    again = ca.Function("again", found.arguments, results)
    rng = np.random.default_rng(3)
    for _ in range(50):
        point = [rng.normal(), 3.0 * rng.normal(size=states), [], [], []]
        np.testing.assert_array_equal(again(*point), dynamics(*point))


def test_table_picked_by_a_floor_has_the_floor_for_a_switch():
    model = flat(lambda t, x, u, p: [TABLE[int(x[0])]])
    assert 1 <= sum(event.switch for event in located(model).events) <= 3


def test_parameters_switch_nothing():
    law = flat(lambda t, x, u, p: [-x[0] if p["k"] > 1.0 else x[0]], params={"k": 2.0})
    assert is_affine(law.dynamics, SIGNALS)
    assert law.is_linear


def test_is_linear_knows_jumps():
    """The derivative of -sign(x) is 0 but at a point, and that of a step in time."""
    assert not flat(lambda t, x, u, p: [-np.sign(x[0])]).is_linear
    assert not flat(lambda t, x, u, p: [-x[0] + (t >= 1.0)]).is_linear
    assert flat(lambda t, x, u, p: [-x[0]]).is_linear


def test_entries_that_both_sides_share_do_not_switch():
    """The first derivative is the same on both ways through the function."""
    model = flat(lambda t, x, u, p: [x[1], 1.0] if x[0] < 1 else [x[1], -1.0], 2)
    t, x, u, p, z = (ca.SX.sym(n, model.dynamics.size1_in(i)) for i, n in enumerate("txupz"))
    first = ca.Function("first", [t, x, u, p, z], [model.dynamics(t, x, u, p, z)[0]])
    assert is_affine(first, SIGNALS)
    assert not is_affine(model.dynamics, SIGNALS)


def test_solvers_inside_are_not_looked_into():
    x, y = ca.MX.sym("x"), ca.MX.sym("y")
    solver = ca.rootfinder("solver", "newton", {"x": y, "p": x, "g": y + y**3 - x})
    inside = ca.Function("inside", [x], [solver(x0=0, p=x)["x"]])
    assert not is_affine(inside, [0])


# -- algebraic loops ----------------------------------------------------------------------------------------------


def loop(law):
    block = ct.nlsys(None, lambda t, x, u, p: [law(u[0])], inputs=["v"], outputs=["y"], name="block")
    return ct.interconnect([block], connections=[["block.v", "block.y"]], inputs=[], outlist=["block.y"])


def test_a_loop_with_a_jump_is_solved_as_one():
    """y = floor(y) / 2 + 1.9 has the solutions 2.9 and 3.4; its derivative says that it is linear and y = 2.4."""
    with pytest.warns(RuntimeWarning, match=r"= 2.9; also found: 3.4"):
        found = pf.simulate(loop(lambda y: np.floor(y) / 2.0 + 1.9), [0.0, 1.0])
    np.testing.assert_allclose(np.ravel(found.outputs), 2.9, rtol=1e-12)


def test_a_loop_without_a_solution_is_refused():
    """y = -2 sign(y) + 0.5 is -1.5 for y > 0 and 2.5 for y < 0."""
    with pytest.raises(ValueError, match="block"):
        pf.simulate(loop(lambda y: -2.0 * np.sign(y) + 0.5), [0.0, 1.0])


def test_what_depends_on_an_unsolved_loop_is_no_number():
    """y = 0 for y > 1, else x: no solution from x = 1 on, and the comparison alone would go on with x."""
    law = ct.nlsys(
        None,
        lambda t, x, u, p: [np.where(u[0] > 1.0, 0.0, u[1])],
        inputs=["y", "x"],
        outputs=["o"],
        name="law",
    )
    ramp = ct.nlsys(
        lambda t, x, u, p: [0.5], lambda t, x, u, p: [x[0]], inputs=0, outputs=["x"], states=1, name="ramp"
    )
    diagram = ct.interconnect(
        [law, ramp],
        connections=[["law.y", "law.o"], ["law.x", "ramp.x"]],
        inputs=[],
        outlist=["law.o"],
        name="diagram",
    )
    found = pf.simulate(diagram, np.linspace(0.0, 4.0, 9), None, [0.2])
    assert not found.success
    np.testing.assert_allclose(np.ravel(found.outputs)[:4], [0.2, 0.45, 0.7, 0.95], rtol=1e-12)
    assert "law.y" in found.message
